"""`matcam fit`: parameters of a material, estimated through the camera that recorded it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from matcam.cli import show
from matcam.cli.inputs import check_inputs
from matcam.cli.options import (
    AsJson,
    Budget,
    Family,
    Force,
    FresnelModel,
    Masking,
    option,
    use_caches,
)
from matcam.cli.rig_options import RigOptions, TableRig
from matcam.core.errors import ArgumentError
from matcam.core.io import check_outputs, plain, write_json


def command(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Tables to read (.binary, .nc, .csv); several tables of one rig are fitted with one camera."
        ),
    ],
    ndf: Family = "ggx",
    fresnel: FresnelModel = "conductor",
    diffuse: Annotated[bool, typer.Option("--diffuse", help="Add a Lambertian part.")] = False,
    per_channel: Annotated[bool, typer.Option("--per-channel", help="Fit a lobe for each channel.")] = False,
    lens: Annotated[
        Literal["auto", "fixed", "prior", "free"],
        typer.Option(
            "--lens",
            help="Lens blur: fixed as in the profile, fitted within its uncertainty (prior), or free; auto: prior if the "
            "profile has an uncertainty, otherwise fixed.",
        ),
    ] = "auto",
    blind: Annotated[bool, typer.Option("--no-camera", help="Fit as if the camera were perfect.")] = False,
    spline: Annotated[
        float,
        option(
            "--spline",
            "STRENGTH",
            "Prior standard deviation of the departure from the family, 0 to 10 (no unit); 1: non-parametric.",
        ),
    ] = 0.0,
    rival: Annotated[
        bool,
        typer.Option("--rival", help="Also fit with free shadowing instead of the camera, and compare both fits."),
    ] = False,
    slice_step: Annotated[int, option("--slice-step", "N", "Use every n-th slice of theta_d.")] = 1,
    masking: Masking = "smith",
    rig: TableRig = RigOptions(),
    output: Annotated[Path | None, option("--output -o", "FILE", "JSON file of the result to write.")] = None,
    budget: Budget = None,
    force: Force = False,
    json: AsJson = False,
) -> dict[str, Any]:
    """Fit a microfacet material through the camera, jointly at all difference angles; print parameters and their errors.

    Example: `matcam fit chrome.binary --ndf epd --fresnel free`
    """
    from matcam.numerics.budget import write_budgets

    if blind and lens != "auto":
        raise ArgumentError("--no-camera omits the lens that --lens describes: give one of these options")
    if rival and (blind or len(files) > 1):
        raise ArgumentError(
            "--rival compares two fits of one table, with the camera and with free shadowing: give one file, and omit "
            "--no-camera"
        )
    inputs = [*files, *rig.files]
    check_inputs(inputs, "a table")
    check_outputs([output, budget], force=force, inputs=inputs)
    workspace = use_caches()
    from matcam.exchange.contents import read_recorded_table, read_table
    from matcam.inverse.fit.fit_setup import fit

    recorded: Any = None if blind else rig.of_table()
    read = read_table if blind else read_recorded_table
    with show.working(f"fitting {', '.join(str(f) for f in files)} through the camera"):
        tables = [read(file, sampling=rig.sampling) for file in files]
        found = fit(
            tables,
            recorded,
            ndf,
            fresnel=fresnel,
            diffuse=diffuse,
            per_channel=per_channel,
            masking=masking,
            camera_parameters=None if lens == "auto" else lens,
            spline=spline,
            slice_step=slice_step,
            workspace=workspace,
        )
    document = {"files": files, **found.to_dict()}
    if rival:
        from matcam.inverse.rival_fits import rivals

        with show.working(f"fitting {files[0]} with free shadowing instead"):
            found_rivals = rivals(tables[0], recorded, ndf, slice_step=slice_step, workspace=workspace)
        document["rival"] = found_rivals.to_dict()
    if output:
        write_json(output, plain(document), force=force)
    if budget:
        write_budgets(budget, found.uncertainty_budgets(), force=force)
    if json:
        show.as_json(document)
    else:
        print_fit(found.to_dict(), ", ".join(file.name for file in files))
        if rival:
            show.notes([document["rival"]["verdict"]])
        written = [str(path) for path in (output, budget) if path]
        if written:
            show.written(written)
    return {"channels": tables[0].sizes["channel"]}


def print_fit(summary: dict[str, Any], name: str) -> None:
    from matcam.camera.sensor import PixelNoise
    from matcam.core.results.summary import half_width, parameters
    from matcam.inverse.fit.fit_data import LEAST_FLOOR, noise_text

    modified = "spline-modified " if summary["spline_modified"] else ""
    show.quantities(parameters(summary["params"], summary["std"]), f"{name}: {modified}{summary['ndf']}")
    width = half_width(summary["hwhm_rad"], summary["hwhm_std_rad"])
    show.say(f"{width.name}: {width.text}")
    noise = PixelNoise(**summary["noise"])
    show.say(
        f"noise of a pixel: {noise_text(noise, 2)} of its value and {noise.floor:.2%} of the image's peak; noise of the gain "
        f"of an image: {noise.picture_gain:.2%}"
    )
    show.say(
        f"ratio of the residual of a cell to its expected standard deviation: {math.sqrt(summary['misfit']):.2f} rms, "
        f"{summary['degrees_of_freedom']} degrees of freedom. The expected standard deviation is that of this noise, and at "
        f"least {LEAST_FLOOR:g} of the image's peak, so faint cells lower the ratio. The noise is estimated from the "
        "residuals, so the ratio is not a test of the model"
    )
    show.notes(remark["text"] for remark in summary["remarks"])
