"""A run: many tables of one rig corrected into one folder by workers side by side, taken up again where it was stopped."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx

from matcam.batch.executors import cluster as dask
from matcam.batch.executors import processes, threads
from matcam.batch.executors.processes import cores
from matcam.batch.folder import STORE, held, is_finished, records, sweep, with_rows
from matcam.batch.inputs import (
    CAMERA,
    FAILED,
    INDEX,
    SETTINGS,
    belongs,
    claim,
    inputs_of,
    key_of,
    named,
    numbers_of,
    settings_of,
)
from matcam.batch.job import Corrector, Job, Options, Outcome, corrected
from matcam.batch.shared_camera import shared_camera
from matcam.camera.camera import Camera
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import SAMPLINGS, Sampling
from matcam.core.io import check_output
from matcam.core.json import write_json
from matcam.figures.run_index import INLINE, write_run_index
from matcam.inverse.operator.lobe_operator import check_rig
from matcam.material.masking import MASKINGS, Masking
from matcam.material.registry import FAMILIES
from matcam.rigs import Rig


class Progress(NamedTuple):
    """How far a run is: materials finished before and by it, failed, and in all; the last one's outcome, None at its start."""

    kept: int
    corrected: int
    failed: int
    total: int
    last: Outcome | None


@dataclass(frozen=True)
class Run:
    """What a run did. folder: its output. corrected: inputs done by it. kept: inputs that were finished before. failures: what
    was not done, each with one line that says why."""

    folder: Path
    corrected: tuple[Path, ...]
    kept: tuple[Path, ...]
    failures: tuple[Outcome, ...]


def correct_all(
    paths: Iterable[str | Path],
    rig: Rig,
    output: str | Path,
    ndf: str = "auto",
    *,
    masking: Masking = "smith",
    glare: float = 1e-3,
    sampling: Sampling = "centre",
    workers: int | None = None,
    cluster: str | None = None,
    pages: bool = True,
    zarr: bool = False,
    fit_camera: bool = False,
    force: bool = False,
    watch: Callable[[Progress], None] = lambda progress: None,
    corrector: Corrector = corrected,
) -> Run:
    """Correct many MERL tables of one rig into the folder `output`: of NAME.binary there NAME.binary, .nc, .html, .png and,
    last, NAME.json; settings.json says how, failed.json what was not done and why, index.html shows them all.

    paths: files, and folders whose *.binary are meant. ndf, masking, glare: as for `correct`. sampling: as for `read_merl`.
    workers: processes of one core each; None: one for each core that this process may use, or, where JAX has a GPU, this
    process with many materials side by side on it. cluster: do it on Dask instead, "local:2" for workers on this machine, or
    the address of a scheduler whose workers have one thread, see the same folders
    and hold the same versions. pages: a page for each material. zarr: all materials as one Zarr besides, run.zarr. fit_camera:
    the rig's blur is fitted jointly to a few of the materials, those with the narrowest lobes, and used for all with its
    covariance; kept as camera.json. watch: called at the start and after each material. corrector: what does the work, the
    top-level function of a module.

    A material whose files are whole, made with these settings from its input as it is now, is not done again: a run that was
    killed goes on. What fails, or takes its worker with it, stops nothing else. force: replace what is in the folder and do
    everything again. Compiled functions and rules of the rig are kept in the user's cache folder by the workers.

    Workers are new processes that import the script which called this: there, call it under `if __name__ == "__main__":`.

    ArgumentError for wrong arguments, OutputError for a folder of a run with other settings (which is named), one that another
    run works in, one that holds an input, or files that are no run's; FitError where a camera was to be fitted and cannot.
    """
    folder = Path(output)
    check_rig(rig)
    options = Options(*_checked(ndf, masking, glare, sampling), glare)
    count = _count(workers, cluster)
    inputs = inputs_of(paths)
    settings = settings_of(rig, options, sampling=sampling, pages=pages, fit_camera=fit_camera, corrector=corrector)
    with held(folder):
        found, refused = named(inputs, folder)
        plan = Job(
            source=Path(), output=Path(), rig=rig, options=options, sampling=sampling, page=pages, corrector=corrector,
            force=True, key=key_of(settings), thumbnail=True, version=metadata.version("matcam"),
        )  # fmt: skip
        _check_picklable(plan)
        jobs = [replace(plan, source=path, output=folder / f"{name}.binary") for name, path in found.items()]
        ours = _checked_folder(folder, settings, jobs, force)
        fitted: Camera | None = None
        if fit_camera and (force or not ours or not (folder / CAMERA).exists()):
            fitted = shared_camera(rig, list(found.values()), options, sampling)
        # from here on the folder is this run's; before, a run that cannot start has changed nothing
        if not ours:
            claim(folder, settings)
        sweep(folder, [*found, *(Path(name).stem for name in (SETTINGS, FAILED, INDEX, CAMERA))])
        if fitted is not None:
            fitted.save(folder / CAMERA, force=True)
        if fit_camera:
            rig = eqx.tree_at(lambda r: r.camera, rig, Camera.load(folder / CAMERA))
            key = key_of({**settings, "fitted": numbers_of(rig)})
            jobs = [replace(job, rig=rig, key=key) for job in jobs]
        kept = [] if force else [job.source for job in jobs if is_finished(job)]
        done_before = set(kept)
        waiting = [job for job in jobs if job.source not in done_before]
        if zarr:
            waiting = with_rows(folder / STORE, jobs, waiting)
        if cluster:
            outcomes = dask.outcomes(waiting, cluster)
        elif workers is None and threads.gpu_at_hand():
            outcomes = threads.outcomes(waiting)
        else:
            outcomes = processes.outcomes(waiting, count)
        run = _done(folder, waiting, kept, refused, outcomes, watch)
        finished = {*run.kept, *run.corrected}  # not what lies there of an input that has changed and fails now
        ordered = sorted((job for job in jobs if job.source in finished), key=lambda job: job.name.casefold())
        failures = [(str(failure.source), failure.reason or "") for failure in run.failures]
        write_run_index(
            folder / INDEX,
            records(ordered),
            failures,
            said=_in_words(options, rig),
            inline=len(ordered) <= INLINE,
            force=True,
        )
        return run


def _checked_folder(folder: Path, settings: dict[str, Any], jobs: Sequence[Job], force: bool) -> bool:
    """Whether the folder already is this run's. OutputError where it must not be used."""
    if not (folder / SETTINGS).exists():  # nobody's folder: what is in it is not ours to replace
        for path in (
            *(path for job in jobs for path in job.files),
            *(folder / name for name in (INDEX, FAILED, CAMERA)),
        ):
            check_output(path, force=force)
    return belongs(folder, settings, force=force)


def _done(
    folder: Path,
    waiting: Sequence[Job],
    kept: list[Path],
    refused: list[Outcome],
    outcomes: Generator[Outcome],
    watch: Callable[[Progress], None],
) -> Run:
    """Hear the outcomes to the end, and write down what failed."""
    total = len(waiting) + len(kept) + len(refused)
    good: list[Path] = []
    failures = list(refused)
    watch(Progress(len(kept), 0, len(failures), total, None))
    try:
        with closing(outcomes):  # whatever ends this, no worker goes on
            for outcome in outcomes:
                if outcome.reason is None:
                    good.append(outcome.source)
                else:
                    failures.append(outcome)
                watch(Progress(len(kept), len(good), len(failures), total, outcome))
    finally:
        _write_failures(folder / FAILED, failures)
    return Run(folder, tuple(good), tuple(kept), tuple(failures))


def _write_failures(path: Path, failures: Sequence[Outcome]) -> None:
    if not failures:
        path.unlink(missing_ok=True)
        return
    listed = [{"file": str(f.source), "reason": f.reason, "trace": f.trace} for f in failures]
    write_json(path, {"failed": listed}, force=True)


def _in_words(options: Options, rig: Rig) -> str:
    family = "GGX or EPD, the likelier" if options.ndf == "auto" else options.ndf
    known = "its uncertainty stated" if rig.camera.uncertainty else "taken as exact"
    return (
        f"Lobe: {family}; masking: {options.masking or 'none'}; camera: {rig.camera.optics!r}, {known}; {rig.sample!r}."
    )


def _checked(ndf: str, masking: Masking, glare: float, sampling: Sampling) -> tuple[str, Masking]:
    """Wrong arguments should not fail a hundred times."""
    checks.choice("ndf", ndf, ("auto", *FAMILIES))
    checks.choice("masking", masking, MASKINGS)
    checks.within("glare", glare, 0, 0.5)
    checks.choice("sampling", sampling, SAMPLINGS)
    return ndf, masking


def _count(workers: int | None, cluster: str | None) -> int:
    if cluster is not None:
        dask.check_address(cluster)
        if workers is not None:
            raise ArgumentError("workers are of this machine, cluster says where others are: give one of them")
    if workers is None:
        return cores()
    if type(workers) is not int or not 1 <= workers <= 1024:
        raise ArgumentError(f"workers must be a whole number in [1, 1024], got {workers!r}")
    return workers


def _check_picklable(job: Job) -> None:
    try:
        pickle.dumps(job)
    except Exception:
        raise ArgumentError(f"corrector must stand at the top of a module, got {job.corrector!r:.80}") from None
