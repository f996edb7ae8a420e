"""`matcam correct`: correction of one table, or of a database, for the camera."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.fit import print_fit
from matcam.cli.inputs import check_inputs
from matcam.cli.options import (
    AsJson,
    Budget,
    Device,
    FamilyOrAuto,
    Force,
    ForceCorrection,
    Masking,
    choose_device,
    option,
    use_caches,
)
from matcam.cli.rig_options import RigOptions, TableRig
from matcam.core.errors import ArgumentError
from matcam.core.io import check_outputs, where_written
from matcam.core.readers.names import is_folder


def command(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH...", help="Tables to read (.binary, .nc, .csv), or folders, whose *.binary files are read."
        ),
    ],
    ndf: FamilyOrAuto = "auto",
    glare: Annotated[
        float,
        option(
            "--glare",
            "SHARE",
            "Share of the light in a possible halo of the lens that the profile does not contain (no unit).",
        ),
    ] = 1e-3,
    masking: Masking = "smith",
    rig: TableRig = RigOptions(),
    output: Annotated[
        Path | None,
        option(
            "--output -o",
            "FILE",
            "MERL file to write, with .nc, .json and .html beside it; a name that ends in .nc: without MERL file; or the "
            "folder of a run. Default: FILE-corrected.binary.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        option("--workers", "N", "Number of processes of a run, one core each. Default: one for each core.", min=1),
    ] = None,
    device: Device = None,
    cluster: Annotated[
        str | None,
        option("--cluster", "WHERE", "Run on Dask: local:N, or a scheduler's address (tcp://host:8786)."),
    ] = None,
    pages: Annotated[bool, typer.Option("--pages/--no-pages", help="Write a page for each material.")] = True,
    compress: Annotated[
        bool, typer.Option("--compress/--no-compress", help="Compress each NetCDF file without loss.")
    ] = True,
    zarr: Annotated[
        bool, typer.Option("--zarr", help="Also write all materials of a run to one Zarr store, FOLDER/run.zarr.")
    ] = False,
    fit_camera: Annotated[
        bool,
        typer.Option(
            "--fit-camera",
            help="Fit the camera's blur jointly to a few materials of a run, and use the result for all.",
        ),
    ] = False,
    time_limit: Annotated[
        float,
        option(
            "--time-limit",
            "SECONDS",
            "Time limit for one material of a run, s. A material that exceeds it is reported as failed.",
        ),
    ] = 3600.0,
    layers: Annotated[
        Path | None,
        option(
            "--layers",
            "FILE",
            "OpenEXR file to write with layers recorded, corrected, std, supported: the slice at phi_d 90°, "
            "half angle to the right, difference angle down.",
        ),
    ] = None,
    budget: Budget = None,
    force_correction: ForceCorrection = False,
    force: Force = False,
    json: AsJson = False,
) -> int | dict[str, Any]:
    """Correct a table for the camera that recorded it, with uncertainty; write MERL, NetCDF, JSON and a page.

    Several files, or a folder, form a run, which writes its results to the folder of `-o`. A run that was killed
    resumes when it is started again. Tables that fail are listed at the end and do not affect other tables. If a table
    fails, the exit code is 1, or 2 if no table was corrected.

    Example: `matcam correct chrome.binary -o chrome-corrected.binary`, `matcam correct brdfs/ -o corrected/`
    """
    from matcam.core import checks

    one_file = len(paths) == 1 and not is_folder(paths[0])
    alone = one_file and (output is None or (bool(output.suffix) and not is_folder(output)))
    if alone and output and output.suffix.lower() not in (".binary", ".nc"):
        raise ArgumentError(
            f"{output}: the corrected table is a MERL or NetCDF file, whose name must end in .binary or .nc"
        )
    if alone and (workers is not None or cluster is not None or zarr or fit_camera):
        raise ArgumentError(
            "--workers, --cluster, --zarr and --fit-camera are for a run: give an output folder with -o, or omit them"
        )
    if budget and not alone:
        raise ArgumentError("--budget is for one table: give one input file and no output folder, or omit --budget")
    if layers and (not alone or layers.suffix.lower() != ".exr"):
        raise ArgumentError(f"--layers requires a single table and a file name that ends in .exr, got {layers}")
    if not alone and (output is None or output.suffix.lower() == ".binary"):
        raise ArgumentError("several tables, or a folder of tables, require an output folder: give -o FOLDER")
    for wanted, what, module in ((zarr, "a run's Zarr store", "zarr"), (cluster, "a cluster", "distributed")):
        if wanted:
            checks.extra(what, "scale", module)
    if device == "gpu" and not alone:
        raise ArgumentError(
            "--device gpu is for one table: omit it for a run, because one process per processor core is as fast"
        )
    check_inputs(paths)
    choose_device(device)
    workspace = use_caches()
    recorded = rig.of_table()
    how: dict[str, Any] = {
        "ndf": ndf,
        "masking": masking,
        "glare": glare,
        "force_correction": force_correction,
    }
    if alone:
        from matcam.batch.job import Job, write_corrected
        from matcam.batch.recipe import Options, Recipe

        target = output or Path(f"{paths[0].stem}-corrected.binary")
        job = Job(
            paths[0],
            target,
            Recipe(recorded, Options(**how), rig.sampling, pages, compress),
            force=force,
            budget=budget,
        )
        check_outputs([*job.files, layers], force=force, inputs=[paths[0], *rig.files])
        with show.working(f"{paths[0]}: correcting"):
            document = write_corrected(job, workspace)
            if layers:
                _write_layers(paths[0], target, layers, rig.sampling, force)
        files = [*job.files, *([layers] if layers else [])]
        _print_table({**document, "files": files}, paths[0].name, json)
        return {"withheld": document["withheld"]}
    from matcam.batch.run import correct_all

    with show.tallying("correcting") as watch:

        def show_progress(progress: Any) -> None:
            watch(progress.kept + progress.corrected + progress.failed, progress.total)
            if progress.last is not None and progress.last.reason is not None:
                show.remark(progress.last.reason)

        run = correct_all(
            paths, recorded, output or "", sampling=rig.sampling, workers=workers, cluster=cluster, pages=pages,
            compress=compress, zarr=zarr, fit_camera=fit_camera, time_limit=time_limit, force=force,
            watch=show_progress, workspace=workspace, **how,
        )  # fmt: skip
    _print_run(run, json)
    if not run.failures:
        return 0
    return 1 if run.corrected or run.kept else 2


def _write_layers(recorded: Path, target: Path, path: Path, sampling: Any, force: bool) -> None:
    import numpy as np

    from matcam.exchange.contents import read_table
    from matcam.files.datasets import read_netcdf
    from matcam.files.float_pictures import write_exr_layers

    corrected = read_netcdf(where_written(target.with_suffix(".nc")))
    pictures = {"recorded": read_table(recorded, sampling=sampling), "corrected": corrected["brdf"]}
    pictures |= {"std": corrected["brdf_std"], "supported": corrected["supported"].all("channel")}
    shown = {}
    for name, table in pictures.items():
        one = table.isel(phi_d=90).transpose("theta_d", "theta_h", ...)
        shown[name] = np.asarray(one.values, float)
    write_exr_layers(path, shown, force=force)


def _print_table(document: dict[str, Any], name: str, json: bool) -> None:
    if json:
        show.as_json(document)
        return
    print_fit(document["fit"], name)
    show.say(document["verdict"])
    if not document["withheld"]:
        show.say(f"the peak at 75° was raised by a factor of {document['peak_gain_75']:.2f}")
    of_fit = document["fit"]["remarks"]  # printed with the fit
    show.notes(remark["text"] for remark in document["remarks"] if remark not in of_fit)
    show.written(document["files"])


def _print_run(run: Any, json: bool) -> None:
    if json:
        show.as_json(run.to_dict())
        return
    kept = f", {len(run.kept)} finished before" if run.kept else ""
    show.say(f"{run.folder}: {len(run.corrected)} corrected{kept}, {len(run.failures)} failed")
    for failure in run.failures:
        show.say(f"failed: {failure.reason}")
