"""Job of one material of a run: the work, and the record of its completion."""

from __future__ import annotations

import hashlib
import time
import traceback
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from matcam.batch.recipe import Recipe
from matcam.batch.store import StoreRow
from matcam.core.errors import ArgumentError, FileFormatError, MatcamError, described
from matcam.core.io import all_or_nothing, check_output, plain, reading, where_written, write_json
from matcam.core.readers.names import check_name
from matcam.core.readers.texts import read_json
from matcam.core.threads import import_behind
from matcam.core.workspace import Workspace
from matcam.exchange.contents import read_recorded_table
from matcam.files.datasets import write_netcdf
from matcam.files.merl import check_channels, write_merl
from matcam.inverse.correction.corrected_table import supported_values, zeroed_noise
from matcam.numerics.budget import write_budgets


@dataclass(frozen=True)
class Job:
    """Job for one table.

    Attributes:
        source: MERL file to read.
        output: MERL file to write. Files with the same name and the suffixes .nc, .json and, if the recipe requires a page,
            .html are also written. If the name of `output` ends in .nc, no MERL file is written.
        recipe: settings of the correction.
        force: True to replace existing files. Default: False.
        key: key of the run's settings. In a run, a thumbnail (.png) is written for the index, too. Default: None, the job
            does not belong to a run.
        row: row of the run's Zarr store to fill. Default: None, no store.
        budget: file for the uncertainty budgets (.json, .csv). Default: None, not written.
    """

    source: Path
    output: Path
    recipe: Recipe
    force: bool = False
    key: str | None = None
    row: StoreRow | None = None
    budget: Path | None = None

    @property
    def name(self) -> str:
        return self.output.stem

    @property
    def record(self) -> Path:
        """Path of the record, which is written last. If the record exists, the other files are complete."""
        return self.output.with_suffix(".json")

    @property
    def writes_merl(self) -> bool:
        return self.output.suffix.lower() != ".nc"

    @property
    def files(self) -> list[Path]:
        merl = [self.output] if self.writes_merl else []
        page = [".html"] if self.recipe.page else []
        thumbnail = [".png"] if self.key is not None else []
        return [
            *merl,
            *(self.output.with_suffix(suffix) for suffix in (".nc", *page, *thumbnail)),
            *([self.budget] if self.budget else []),
            self.record,
        ]

    def finished_record(self) -> dict[str, Any] | None:
        """Read the record on disk.

        The result is None if the record cannot be read, if its settings differ from those of the job, or if a listed file
        does not have the listed size.
        """
        try:
            document = read_json(self.record, "a material's record")
            run = document["run"]
            if self.key is None or run["settings"] != self.key:
                return None
            whole = all((self.output.parent / name).stat().st_size == size for name, size in run["files"].items())
        except (FileFormatError, OSError, KeyError, TypeError, AttributeError, ValueError):
            return None
        return document if whole else None

    def is_finished(self) -> bool:
        """Check whether the files are complete, and result from the settings of the job and the current input.

        The input is read only if its modification time differs from that in the record, because hashing all tables of a
        large run is slow.
        """
        try:
            known = (self.finished_record() or {})["input"]
            status = self.source.stat()
            if status.st_size != known["bytes"]:
                return False
            return status.st_mtime_ns == known["mtime_ns"] or fingerprint(self.source)["sha256"] == known["sha256"]
        except (OSError, KeyError, TypeError, FileFormatError):
            return False


class Outcome(NamedTuple):
    """Outcome of a job.

    Attributes:
        source: the job's input.
        seconds: duration, s.
        reason: reason of a failure, in one line; None: success. Default: None.
        trace: traceback, if the failure is a fault of matcam. Default: None, no such fault.

    Example:
        >>> import pathlib
        >>> outcome = matcam.batch.Outcome(pathlib.Path("gold.binary"), 12.5)
        >>> outcome.reason is None
        True
    """

    source: Path
    seconds: float
    reason: str | None = None
    trace: str | None = None


def failed(source: Path, reason: str) -> Outcome:
    return Outcome(source, 0.0, f"{source}: {reason}")


def attempt(job: Job, workspace: Workspace | None = None) -> Outcome:
    """Run a job, and report errors as its outcome, so that other jobs continue.

    `workspace` is the workspace of the worker. Default: None, that of the job.
    """
    started = time.perf_counter()

    def failure(reason: str, trace: str | None = None) -> Outcome:
        return Outcome(job.source, time.perf_counter() - started, reason, trace)

    try:
        write_corrected(job, workspace)
    except MatcamError as error:
        text = " ".join(str(error).split())
        return failure(text if str(job.source) in text else f"{job.source}: {text}")
    except MemoryError:
        return failure(f"{job.source}: not enough memory: use fewer workers")
    except Exception as error:
        text = described(error)
        return failure(f"{job.source}: a fault of matcam, not of your input: {text}", traceback.format_exc())
    return Outcome(job.source, time.perf_counter() - started)


def write_corrected(job: Job, workspace: Workspace | None = None) -> dict[str, Any]:
    """Correct one table, write its files, and return its record.

    `workspace` is the workspace of the worker. Default: None, that of the job.

    Raises:
        ArgumentError: the recipe is of another version of matcam, or an output cannot have the required format.
        OutputError: a file exists and `force` is False, or a file cannot be written.
        FileFormatError: the input is not a table, or changed while it was read.
        MatcamError: an error of the corrector.
    """
    version = metadata.version("matcam")
    if job.recipe.version != version:
        raise ArgumentError(
            f"this worker has matcam {version}, but the run was started by matcam {job.recipe.version}: install "
            "the same version"
        )
    check_name(job.source)
    for path in job.files:
        check_output(path, force=job.force, inputs=[job.source])
    started = time.perf_counter()
    before = fingerprint(job.source)
    table = read_recorded_table(job.source, sampling=job.recipe.sampling)
    if fingerprint(job.source) != before:
        raise FileFormatError(
            f"{job.source}: the file changed while it was read; correct it again when the file is complete"
        )
    if job.writes_merl:
        check_channels(table)
    if job.recipe.page:
        import_behind("matcam.figures.pages")
    options = job.recipe.options
    if workspace is not None:
        options = options._replace(workspace=workspace)
    done = job.recipe.corrector(table, job.recipe.rig, options)
    with all_or_nothing():
        if job.writes_merl:
            write_merl(job.output, supported_values(done.table, table), force=job.force)
        write_netcdf(job.output.with_suffix(".nc"), done.table, force=job.force, compress=job.recipe.compress)
        if job.recipe.page:
            done.write_page(job.output.with_suffix(".html"), job.source.name, job.force)
        if job.budget is not None:
            write_budgets(job.budget, done.budgets, force=job.force)
        if job.key is not None:
            from matcam.figures.spheres import write_thumbnail

            write_thumbnail(job.output.with_suffix(".png"), table, done.table["brdf"], force=job.force)
        if job.row is not None:
            job.row.write(done.table)
        document = {"file": str(job.source), **done.document, "input": before}
        if job.writes_merl:
            remarks = [remark.to_dict() for remark in zeroed_noise(table)]
            document["remarks"] = [*document.get("remarks", ()), *remarks]
        if job.key is not None:
            sizes = {path.name: where_written(path).stat().st_size for path in job.files[:-1]}
            document["run"] = {"settings": job.key, "files": sizes, "seconds": time.perf_counter() - started}
        write_json(job.record, plain(document), force=job.force)
        if job.force:  # an old record must not describe new files
            job.record.unlink(missing_ok=True)
    return document


def fingerprint(path: Path) -> dict[str, Any]:
    """Compute size (bytes), modification time (ns) and SHA-256 of a file.

    A FileFormatError is raised if the file cannot be read.
    """
    with reading(path, "a table"):
        status = path.stat()
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"bytes": status.st_size, "mtime_ns": status.st_mtime_ns, "sha256": digest}
