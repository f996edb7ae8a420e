"""`matcam correct`: tables as a perfect camera would have measured them, one or a whole database."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from matcam.cli import show
from matcam.cli.fit import print_fit
from matcam.cli.options import (
    Anyway,
    AsJson,
    CameraProfile,
    FamilyOrAuto,
    Force,
    LampRadius,
    Masking,
    Radius,
    Sampling,
    rig_of,
)

SOME_FAILED, NONE_DONE = 1, 2


def command(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH...", help="Tables to read (.binary, .nc, .csv), and folders that stand for their *.binary."
        ),
    ],
    ndf: FamilyOrAuto = "auto",
    glare: Annotated[
        float,
        typer.Option(
            "--glare", help="Share of light that the lens may scatter without its profile saying so (no unit)."
        ),
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
            help="MERL file to write (.nc, .json, .html go beside it), or a run's folder. Default: FILE-corrected.binary.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", help="Number of a run's processes, one core each. Default: one for each core.", min=1
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            "--cluster",
            metavar="WHERE",
            help="Do the run on Dask: local:N, or a scheduler's address (tcp://host:8786).",
        ),
    ] = None,
    pages: Annotated[bool, typer.Option("--pages/--no-pages", help="Write a page to read for each material.")] = True,
    zarr: Annotated[
        bool, typer.Option("--zarr", help="Write all materials of a run to one Zarr besides, FOLDER/run.zarr.")
    ] = False,
    fit_camera: Annotated[
        bool,
        typer.Option(
            "--fit-camera", help="Fit the camera's blur jointly to a few materials of a run, and use it for all."
        ),
    ] = False,
    time_limit: Annotated[
        float, typer.Option("--time-limit", help="Time for one material of a run, s; what takes longer has failed.")
    ] = 3600.0,
    anyway: Anyway = False,
    force: Force = False,
    json: AsJson = False,
) -> None:
    """Correct a table for its camera, with uncertainty: MERL, NetCDF, JSON and a page to read.

    Several files, or a folder, are a run: `-o` names the folder that it fills. A run that was killed goes on where it was
    when it is started again. What fails is listed at the end and stops nothing else (exit code 1; 2 if nothing was
    corrected).

    Example: `matcam correct chrome.binary -o chrome-corrected.binary`, `matcam correct brdfs/ -o corrected/`
    """
    from matcam.core.errors import ArgumentError

    one_file = len(paths) == 1 and not paths[0].is_dir()
    alone = one_file and (output is None or (bool(output.suffix) and not output.is_dir()))
    if alone and output and output.suffix.lower() != ".binary":
        raise ArgumentError(f"{output}: the corrected table is a MERL file, whose name must end in .binary")
    if alone and (workers is not None or cluster is not None or zarr or fit_camera):
        raise ArgumentError(
            "--workers, --cluster, --zarr and --fit-camera are for a run: name an output folder with -o"
        )
    if not alone and (output is None or output.suffix.lower() == ".binary"):
        raise ArgumentError("several tables need an output folder: -o FOLDER")
    from matcam.core.jax import use_compilation_cache
    from matcam.core.workspace import Workspace

    use_compilation_cache()
    workspace = Workspace.user()
    rig = rig_of(camera, radius, lamp, cell_value=sampling)
    how: dict[str, Any] = {
        "ndf": ndf,
        "masking": None if masking == "none" else masking,
        "glare": glare,
        "anyway": anyway,
    }
    if alone:
        from matcam.batch.job import Job, write_corrected
        from matcam.batch.recipe import Options, Recipe
        from matcam.core.io import check_output

        target = output or Path(f"{paths[0].stem}-corrected.binary")
        job = Job(paths[0], target, Recipe(rig, Options(**how), sampling, pages), force=force)
        for path in job.files:
            check_output(path, force=force, inputs=[paths[0], *([camera] if camera else [])])
        with show.working(f"{paths[0]}: correcting"):
            document = write_corrected(job, workspace)
        _print_table({**document, "files": [str(path) for path in job.files]}, paths[0].name, json)
        return
    from matcam.batch.run import correct_all

    with show.tallying("correcting") as watch:

        def show_progress(progress: Any) -> None:
            watch(progress.kept + progress.corrected + progress.failed, progress.total)
            if progress.last is not None and progress.last.reason is not None:
                show.remark(progress.last.reason)

        run = correct_all(
            paths, rig, output or "", sampling=sampling, workers=workers, cluster=cluster, pages=pages, zarr=zarr,
            fit_camera=fit_camera, time_limit=time_limit, force=force, watch=show_progress, workspace=workspace, **how,
        )  # fmt: skip
    _print_run(run, json)
    if run.failures:
        raise typer.Exit(SOME_FAILED if run.corrected or run.kept else NONE_DONE)


def _print_table(document: dict[str, Any], name: str, json: bool) -> None:
    """Print what was found of one table."""
    if json:
        show.as_json(document)
        return
    print_fit(document["fit"], name)
    show.say(
        f"supported entries (correction known to 5 %): {document['supported_share']:.0%}; peak at 75° raised by "
        f"{document['peak_gain_75']:.2f}"
    )
    for remark in document["remarks"]:
        if remark not in document["fit"]["remarks"]:  # printed with the fit
            show.say(f"note: {remark['text']}")
    show.say("written: " + ", ".join(document["files"]))


def _print_run(run: Any, json: bool) -> None:
    """Print what a run did."""
    if json:
        show.as_json(run.to_dict())
        return
    kept = f", {len(run.kept)} finished before" if run.kept else ""
    show.say(f"{run.folder}: {len(run.corrected)} corrected{kept}, {len(run.failures)} failed")
    for failure in run.failures:
        show.say(f"failed: {failure.reason}")
