"""`matcam reconstruct`: material of a sphere or another sample from a folder of photographs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.options import AsJson, Budget, FamilyOrAuto, Force, Masking, option, use_caches
from matcam.core.errors import ArgumentError
from matcam.core.io import check_outputs, plain, user_cache_folder, write_json


def command(
    capture: Annotated[Path, typer.Argument(metavar="DIR", help="Capture: a folder with capture.toml and frames.csv.")],
    ndf: FamilyOrAuto = "auto",
    masking: Masking = "smith",
    diffuse: Annotated[
        bool, typer.Option("--diffuse/--no-diffuse", help="Allow a Lambertian part of the material.")
    ] = True,
    rig_from: Annotated[
        Path | None,
        option(
            "--rig-from",
            "FILE",
            "JSON file of an earlier reconstruction by the same rig, whose lens, distances and lamps are the prior.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        option(
            "--output -o",
            "FILE",
            "MERL file to write, with -pinhole.binary, .nc, .json and .html beside it. Default: DIR-reconstructed.binary.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        option(
            "--workers",
            "N",
            "Number of lamp positions whose frames are read at a time. Default: one for each core, at most 4.",
            min=1,
        ),
    ] = None,
    budget: Budget = None,
    force: Force = False,
    json: AsJson = False,
) -> int:
    """Reconstruct a material from photographs of a sphere, cylinder or flat sample, with standard deviations.

    If frames are unusable, they are left out and listed, the results are written, and the exit code is 1. After an
    interruption, the same command does not read again the frames that were already read.

    For a cylinder, no table without lens correction (-pinhole.binary) is written. An anisotropic material is written only
    to the .nc file, because only this format has the azimuth of the half vector. For a flat sample, the maps are written to
    the .nc file.

    Example: `matcam reconstruct shots/ -o chrome.binary`
    """
    from matcam.numerics.budget import write_budgets

    target = output or Path(f"{capture.resolve().name}-reconstructed.binary")
    if target.suffix.lower() != ".binary":
        raise ArgumentError(f"{target}: the reconstructed table is a MERL file, whose name must end in .binary")
    files = {
        "table": target,
        "pinhole": target.with_name(f"{target.stem}-pinhole.binary"),
        "data": target.with_suffix(".nc"),
        "document": target.with_suffix(".json"),
        "page": target.with_suffix(".html"),
    }
    check_outputs([*files.values(), budget], force=force)
    from matcam.files.capture import read_capture

    described = read_capture(capture)
    use_caches()
    from matcam.reconstruction.from_capture import reconstruct

    with show.stepping() as watch:
        result: Any = reconstruct(
            described,
            ndf,
            masking=masking,
            diffuse=diffuse,
            rig_from=rig_from,
            progress=watch,
            workers=workers or min(os.cpu_count() or 1, 4),
            keep=user_cache_folder() / "captures",
        )
    files = {name: path for name, path in files.items() if name in _files_of(result)}
    if budget:
        files["budget"] = budget
    document = plain({**result.to_dict(), "files": [*files.values()]})
    if result.sample == "flat":
        _write_maps(result, document, files, force)
    else:
        _write(result, document, files, capture, force)
    if budget:
        write_budgets(budget, result.uncertainty_budgets(), force=force)
    if json:
        show.as_json(document)
    else:
        _print(result, document)
    return 0 if result.complete else 1


def _files_of(result: Any) -> tuple[str, ...]:
    if result.sample == "flat":
        return "data", "document"
    table = () if "phi_h" in result.table.dims else ("table",)  # a MERL file has no azimuth of the half vector
    return (*table, *(() if result.pinhole is None else ("pinhole",)), "data", "document", "page")


def _write_maps(result: Any, document: dict[str, Any], files: dict[str, Path], force: bool) -> None:
    from matcam.files.datasets import write_netcdf

    write_netcdf(files["data"], result.maps, force=force)
    write_json(files["document"], document, force=force)


def _write(result: Any, document: dict[str, Any], files: dict[str, Path], capture: Path, force: bool) -> None:
    from matcam.acquisition.outline import stacked
    from matcam.figures.fitted_windows import fitted_windows
    from matcam.figures.reconstruction_page import write_reconstruction_page
    from matcam.files.datasets import write_netcdf
    from matcam.files.merl import write_merl

    data = result.table
    if "table" in files:
        write_merl(files["table"], data["brdf"], force=force)
    if "pinhole" in files:
        # noise about 0 may be negative, which the format does not support; the NetCDF file keeps it
        write_merl(files["pinhole"], result.pinhole.clip(min=0.0, keep_attrs=True), force=force)
        data = data.assign(pinhole=result.pinhole)
    if result.sample == "sphere":
        data = data.merge(fitted_windows(result))
    write_netcdf(files["data"], data, force=force)
    write_json(files["document"], document, force=force)
    exposures = [(name, value, std / value) for name, (value, std) in document["radiometry"]["exposures"].items()]
    write_reconstruction_page(
        files["page"],
        result,
        capture.resolve().name,
        overview=stacked(result.captured.pictures),
        exposures=exposures,
        force=force,
    )


def _print(result: Any, document: dict[str, Any]) -> None:
    from matcam.core.results.summary import Quantity
    from matcam.reconstruction.stated.captured_scene import INCOMPLETE

    show.quantities([Quantity(name, *pair) for name, pair in result.parameters.items()])
    if result.sample != "flat":
        show.quantities(result.length_quantities, head="outline and distances")
        columns = [("ratio", "F at grazing, %"), ("level", "absolute F, %"), ("roughness", "roughness, %")]
        columns = [column for column in columns if column[0] in result.budget["total"]]
        show.table(
            ("source of error", *(words for _, words in columns)),
            [(source, *(f"{100 * parts[key]:.2g}" for key, _ in columns)) for source, parts in result.budget.items()],
        )
    show.say(document["verdict"])
    for one in result.remarks:
        show.say(f"{'left out' if one.code in INCOMPLETE else 'note'}: {one}")
    show.written(document["files"])
