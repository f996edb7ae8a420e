"""Run: parallel, resumable correction of many tables of one rig into one folder."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx

from matcam.batch.executors import Executor
from matcam.batch.executors.cluster import ClusterExecutor
from matcam.batch.executors.local import ProcessExecutor
from matcam.batch.folder import RunFolder
from matcam.batch.job import Job, Outcome
from matcam.batch.recipe import (
    Corrector,
    Options,
    Recipe,
    correct_table,
    fit_shared_camera,
    rig_description,
    settings_key,
)
from matcam.camera.camera import Camera
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import SAMPLINGS, Sampling
from matcam.core.io import one_by_one
from matcam.core.readers.names import is_there
from matcam.core.registry import FAMILIES
from matcam.core.threads import available_cores
from matcam.core.workspace import Workspace
from matcam.figures.pages import INLINE, write_run_index
from matcam.inverse.fit.fit_setup import AUTO
from matcam.inverse.operator.lobe_operator import check_rig
from matcam.material.masking import MASKINGS, Masking
from matcam.rigs import Rig


class Progress(NamedTuple):
    """Progress of a run.

    Attributes:
        kept: number of materials that were finished before the run.
        corrected: number of materials that the run has corrected.
        failed: number of materials that failed.
        total: number of all materials of the run.
        last: outcome of the last finished job; None at the start of the run.

    Example:
        >>> progress = matcam.batch.Progress(kept=3, corrected=2, failed=1, total=10, last=None)
        >>> f"{progress.kept + progress.corrected} of {progress.total}"
        '5 of 10'
    """

    kept: int
    corrected: int
    failed: int
    total: int
    last: Outcome | None


@dataclass(frozen=True)
class Run:
    """Result of a run.

    Attributes:
        folder: the run's output folder.
        corrected: inputs that the run corrected.
        kept: inputs that were finished before the run.
        failures: outcomes of the inputs that failed, each with its reason in one line.

    Example:
        >>> import pathlib
        >>> matcam.batch.Run(pathlib.Path("out"), corrected=(), kept=(), failures=()).to_dict()["failed"]
        []
    """

    folder: Path
    corrected: tuple[Path, ...]
    kept: tuple[Path, ...]
    failures: tuple[Outcome, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the run in types of JSON.

        Returns:
            The fields by name; "failed" contains the file and the reason of each failure.
        """
        return {
            "folder": str(self.folder),
            "corrected": [str(path) for path in self.corrected],
            "kept": [str(path) for path in self.kept],
            "failed": [{"file": str(failure.source), "reason": failure.reason} for failure in self.failures],
        }


def correct_all(
    paths: Iterable[str | Path],
    rig: Rig,
    output: str | Path,
    ndf: str = "auto",
    *,
    masking: Masking = "smith",
    glare: float = 1e-3,
    force_correction: bool = False,
    sampling: Sampling = "centre",
    workers: int | None = None,
    cluster: str | None = None,
    pages: bool = True,
    compress: bool = True,
    zarr: bool = False,
    fit_camera: bool = False,
    time_limit: float = 3600.0,
    force: bool = False,
    watch: Callable[[Progress], None] = lambda progress: None,
    corrector: Corrector = correct_table,
    workspace: Workspace | None = None,
) -> Run:
    """Correct many MERL tables of one rig into one folder.

    The results of an input NAME.binary are the files NAME.binary, NAME.nc, NAME.html, NAME.png and NAME.json in the folder.
    The JSON file is written last. For the whole run, settings.json contains the settings, failed.json lists failures with
    reasons, and index.html shows all materials.

    A material is not corrected again if its files are complete, and result from the same settings and the current input. A
    run that was killed therefore resumes when it is started again. A material that fails, or kills its worker, does not
    affect other materials. Workers store compiled functions, and results that depend on the rig alone, in the cache folder
    of the user.

    Workers are new processes that import the calling script: call this function under `if __name__ == "__main__":` in
    the script.

    Args:
        paths: MERL files, and folders. A folder stands for the *.binary files that it contains.
        rig: the rig that recorded the tables: distant camera and lamp, and a sphere.
        output: folder to fill.
        ndf: family of the lobe; "auto" uses the more probable of "ggx" and "epd" for each material. Default: "auto".
        masking: masking function, as for `correct`; None: no masking. Default: "smith".
        glare: share of light in an unspecified halo of the lens, in [0, 0.5] (no unit). It limits the supported entries
            beside a highlight; increase it for a lens that scatters more. Default: 1e-3.
        force_correction: True to correct tables even if their data contradict the rig. Default: False, such tables are not
            changed.
        sampling: sampling position of a value in its cell, "centre" or "edge". MERL files do not specify the position.
            Default: "centre".
        workers: number of worker processes of one core each, in [1, 1024]. Default: None, one for each core that this
            process may use.
        cluster: Dask cluster to use instead of local processes: "local:2" for two workers on this machine, or the address
            of a scheduler. Each worker must have one thread, access to the same folders, and the same versions of packages.
            Default: None, no cluster.
        pages: True to write a page for each material. Default: True.
        compress: True to compress each NetCDF file, without loss. Default: True.
        zarr: True to also write all materials to one Zarr store, run.zarr. Default: False.
        fit_camera: True to fit the blur of the camera jointly to at most 4 materials with narrow lobes. All materials are
            then corrected with the fitted blur and its covariance, which camera.json contains. Default: False.
        time_limit: time limit for one material, s. After this time the worker process is killed, and the material has
            failed. The limit does not apply to clusters. Default: 3600.
        force: True to replace existing files and correct everything again. Default: False.
        watch: function that is called with a `Progress` at the start and after each material.
            Default: a function that does nothing.
        corrector: function (table, rig, options) that corrects one table. The function must be at the top level of a
            module, because workers import it. Default: the correction of `correct`.
        workspace: cache of results that depend on the rig alone, in this process; workers use the cache of the user.
            Default: None, the cache of the process.

    Returns:
        Corrected, kept and failed materials.

    Raises:
        ArgumentError: if an argument is out of its range, or `paths` contain no table.
        OutputError: if the folder belongs to a run with other settings, or is in use by another run. The message contains
            the first setting that differs. The error is also raised if an output would replace its own input, or a file
            that no run wrote.
        FitError: if `fit_camera` is True, and the tables do not determine the blur or cannot be read.
        MatcamError: if no worker can be started, or the cluster cannot be used.

    Source:
        docs/batch.md; for the correction of one table, docs/model.md section 8.

    Example:
        >>> import tempfile
        >>> folder = tempfile.mkdtemp()
        >>> matcam.correct_all([folder], matcam.rigs.merl(), folder)
        Traceback (most recent call last):
        ...
        matcam.core.errors.ArgumentError: ...: there is no *.binary file: give MERL files, or folders with such files
    """
    check_rig(rig)
    checks.choice("ndf", ndf, (AUTO, *FAMILIES))
    checks.choice("masking", masking, MASKINGS)
    checks.within("glare", glare, 0, 0.5)
    checks.choice("sampling", sampling, SAMPLINGS)
    checks.whole_number("workers", workers, 1, 1024, optional=True)
    switches = {
        "force_correction": force_correction,
        "pages": pages,
        "compress": compress,
        "zarr": zarr,
        "fit_camera": fit_camera,
        "force": force,
    }
    for name, switch in switches.items():
        checks.flag(name, switch)
    checks.positive("time_limit", time_limit, "s")
    executor = _executor(workers, cluster, time_limit)
    if zarr:
        checks.extra("a run's Zarr store", "scale", "zarr")
    recipe = Recipe(
        rig, Options(ndf, masking, glare, force_correction, workspace), sampling, pages, compress, corrector
    )
    _check_picklable(recipe)
    settings = recipe.settings(fit_camera=fit_camera)
    folder = RunFolder(Path(output))
    outputs, refused = folder.outputs(paths)
    with folder.locked(), one_by_one():
        key = settings_key(settings)
        jobs = [Job(source, target, recipe, force=True, key=key) for source, target in outputs.items()]
        ours = folder.check(settings, jobs, force=force)
        fitted: Camera | None = None
        if fit_camera and (force or not ours or not is_there(folder.camera)):
            fitted = fit_shared_camera(recipe, list(outputs))
        # from here on the folder belongs to this run; a run that cannot start does not change the folder
        if not ours:
            folder.claim(settings)
        folder.sweep(jobs)
        if fitted is not None:
            fitted.save(folder.camera, force=True)
        if fit_camera:
            rig = eqx.tree_at(lambda r: r.camera, rig, Camera.load(folder.camera))
            recipe = replace(recipe, rig=rig)
            key = settings_key({**settings, "fitted": rig_description(rig)})
            jobs = [replace(job, recipe=recipe, key=key) for job in jobs]
        kept = [] if force else [job.source for job in jobs if job.is_finished()]
        kept_before = set(kept)
        waiting = [job for job in jobs if job.source not in kept_before]
        if zarr:
            waiting = folder.assign_rows(jobs, waiting)
        run = _run_jobs(folder, waiting, Run(folder.path, (), tuple(kept), tuple(refused)), executor, watch)
        whole = {*run.kept, *run.corrected}  # without old files of an input that has changed and fails
        finished = sorted((job for job in jobs if job.source in whole), key=lambda job: job.name.casefold())
        write_run_index(
            folder.index,
            ((job.name, record) for job in finished if (record := job.finished_record()) is not None),
            [failure.reason or "" for failure in run.failures],
            summary=recipe.in_words(),
            inline=len(finished) <= INLINE,
            force=True,
        )
        return run


def _run_jobs(
    folder: RunFolder, jobs: Sequence[Job], run: Run, executor: Executor, watch: Callable[[Progress], None]
) -> Run:
    total = len(jobs) + len(run.kept) + len(run.failures)
    corrected: list[Path] = []
    failures = list(run.failures)
    watch(Progress(len(run.kept), 0, len(failures), total, None))
    try:
        with closing(executor.outcomes(jobs)) as outcomes:  # workers end with this function in any case
            for outcome in outcomes:
                if outcome.reason is None:
                    corrected.append(outcome.source)
                else:
                    failures.append(outcome)
                watch(Progress(len(run.kept), len(corrected), len(failures), total, outcome))
    finally:
        folder.write_failures(failures)
    return replace(run, corrected=tuple(corrected), failures=tuple(failures))


def _executor(workers: int | None, cluster: str | None, time_limit: float) -> Executor:
    if cluster is not None:
        chosen = ClusterExecutor(cluster)
        if workers is not None:
            raise ArgumentError("workers and cluster must not be given together: give one of them")
        return chosen
    return ProcessExecutor(workers or available_cores(), time_limit)


def _check_picklable(recipe: Recipe) -> None:
    try:
        pickle.dumps((recipe.corrector, recipe.corrector.__qualname__))
    except Exception:
        raise ArgumentError(
            f"corrector must be a function at the top level of a module, got {recipe.corrector!r:.80}"
        ) from None
    try:
        pickle.dumps(recipe)
    except Exception as error:
        raise ArgumentError(
            f"rig and workspace must support pickle, because workers receive a copy, got the error: {error!s:.120}"
        ) from None
