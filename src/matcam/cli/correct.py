"""`matcam correct`: a whole table as a perfect camera would have measured it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from matcam.cli import show
from matcam.cli.fit import print_fit
from matcam.cli.options import AsJson, CameraProfile, Force, LampRadius, Masking, Radius, Sampling, kept_rules, rig_of


def command(
    file: Annotated[Path, typer.Argument(help="MERL file.")],
    ndf: Annotated[
        Literal["auto", "ggx", "epd", "sgd", "beckmann", "gaussian"],
        typer.Option("--ndf", help="Family of the lobe; auto: ggx or epd, the likelier."),
    ] = "auto",
    glare: Annotated[
        float, typer.Option("--glare", help="Share of light that the lens may scatter without its profile saying so.")
    ] = 1e-3,
    masking: Masking = "smith",
    camera: CameraProfile = None,
    radius: Radius = None,
    lamp: LampRadius = 0.0,
    sampling: Sampling = "centre",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="MERL file to write; .nc, .json and .html go beside it. Default: FILE-corrected.binary.",
        ),
    ] = None,
    force: Force = False,
    json: AsJson = False,
) -> None:
    """The table that a perfect camera would have measured, with its uncertainty: MERL, NetCDF, JSON and a page to read.

    Example: `matcam correct chrome.binary -o chrome-corrected.binary`
    """
    from matcam.atomic import check_output
    from matcam.errors import ArgumentError

    output = output or Path(f"{file.stem}-corrected.binary")
    if output.suffix.lower() != ".binary":
        raise ArgumentError(f"{output}: the corrected table is a MERL file, whose name must end in .binary")
    beside = [output.with_suffix(suffix) for suffix in (".nc", ".json", ".html")]
    inputs = [path for path in (file, camera) if path]
    for path in (output, *beside):
        check_output(path, force=force, inputs=inputs)
    with show.working(f"{file}: correcting"):
        table, done, document = _compute(file, ndf, glare, masking, camera, radius, lamp, sampling)
        _write(table, done, document, output, beside, force, file)
    if json:
        show.as_json({**document, "files": [str(path) for path in (output, *beside)]})
    else:
        print_fit(done.fit, file.name)
        show.say(
            f"supported entries (std under 5 %): {document['supported_share']:.0%}; peak at 75° raised by "
            f"{document['peak_gain_75']:.2f}"
        )
        for remark in document["remarks"]:
            show.say(f"note: {remark}")
        show.say("written: " + ", ".join(str(path) for path in (output, *beside)))


def _compute(file, ndf, glare, masking, camera, radius, lamp, sampling):  # type: ignore[no-untyped-def]
    import numpy as np

    kept_rules()
    from matcam.files.merl import read_merl
    from matcam.inverse.correction import correction

    rig = rig_of(camera, radius, lamp, cell_value=sampling)
    table = read_merl(file, sampling=sampling)
    done = correction(table, rig, ndf, masking=None if masking == "none" else masking, glare=glare)
    there = np.isfinite(table.values)
    document: dict[str, Any] = {
        "file": str(file),
        "camera": rig.camera.profile(),
        "fit": done.fit.summary(),
        "doubts": {doubt.axis.name: {**doubt.fit.summary(), "contradicts": doubt.contradicts} for doubt in done.doubts},
        "shape": {"strength": done.shape.strength, "b": done.shape.b},
        "glare": glare,
        "supported_share": float(done.table["supported"].values[there].mean()),
        "peak_gain_75": float(1 / done.table["response"].values[0, 75, 90]),
        "remarks": done.remarks,
    }
    return table, done, document


def _write(
    table: Any, done: Any, document: dict[str, Any], output: Path, beside: list[Path], force: bool, file: Path
) -> None:
    from matcam.figures.correction_page import write_correction_page
    from matcam.files.merl import write_merl
    from matcam.files.netcdf import write_netcdf
    from matcam.json_file import write_json

    write_merl(output, done.table["brdf"], force=force)
    write_netcdf(beside[0], done.table, force=force)
    write_json(beside[1], show.plain(document), force=force)
    write_correction_page(beside[2], table, done, document["remarks"], file.name, force=force)
