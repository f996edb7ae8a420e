"""One material: a table goes in, its files come out. What a worker is told is a `Job`, and what it does `corrected_files`."""

from __future__ import annotations

import threading
import time
import traceback
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from matcam.angles import Sampling
from matcam.atomic import check_output
from matcam.batch.corrector import Corrected, Corrector, Options, corrected
from matcam.batch.fingerprint import Fingerprint, fingerprint
from matcam.batch.store import write_row
from matcam.errors import ArgumentError, FileFormatError, MatcamError
from matcam.figures.thumbnails import write_thumbnail
from matcam.files.merl import read_merl, write_merl
from matcam.files.netcdf import write_netcdf
from matcam.json_file import plain, write_json
from matcam.rigs import Rig

_WRITING = threading.Lock()
"""Materials that are done side by side are written one after the other: neither HDF5 nor Matplotlib's styles know threads."""


@dataclass(frozen=True)
class Job:
    """A table to correct. source: MERL file. output: MERL file to write; .nc, .json and, unless told otherwise, .html go
    beside it. rig, sampling, options: how. corrector: what does it.

    In a run: key, of the run's settings; thumbnail: write a .png for its index; store, row: where its Zarr is, and which
    row is this material's; version: of the matcam that describes it. force: replace what is there.
    """

    source: Path
    output: Path
    rig: Rig
    options: Options
    sampling: Sampling = "centre"
    page: bool = True
    force: bool = False
    corrector: Corrector = corrected
    key: str | None = None
    thumbnail: bool = False
    store: Path | None = None
    row: int = 0
    version: str = ""

    @property
    def name(self) -> str:
        """Of the material: its output's, without suffix."""
        return self.output.stem

    @property
    def record(self) -> Path:
        """The file that is written last: where it is, the others are whole."""
        return self.output.with_suffix(".json")

    @property
    def files(self) -> list[Path]:
        """All that will be written, the record last."""
        suffixes = [".nc", *([".html"] if self.page else []), *([".png"] if self.thumbnail else [])]
        return [self.output, *(self.output.with_suffix(suffix) for suffix in suffixes), self.record]


def corrected_files(job: Job) -> dict[str, Any]:
    """Correct one table and write its files; what its record says.

    ArgumentError, OutputError before any work where a file could not be written; FileFormatError for what is no table, or
    was changed while it was read; `correction`'s errors.
    """
    if job.version and job.version != metadata.version("matcam"):
        raise ArgumentError(
            f"this worker has matcam {metadata.version('matcam')}, the run was started by {job.version}"
        )
    for path in job.files:
        check_output(path, force=job.force, inputs=[job.source])
    started = time.perf_counter()
    before = fingerprint(job.source)
    table = read_merl(job.source, sampling=job.sampling)
    if fingerprint(job.source) != before:
        raise FileFormatError(f"{job.source}: changed while it was read: correct it again when it is whole")
    done = job.corrector(table, job.rig, job.options)
    with _WRITING:
        return _written(job, table, done, before, started)


def _written(job: Job, table: xr.DataArray, done: Corrected, before: Fingerprint, started: float) -> dict[str, Any]:
    # an old record must not vouch for new files
    if job.force:
        job.record.unlink(missing_ok=True)
    write_merl(job.output, done.table["brdf"], force=job.force)
    write_netcdf(job.output.with_suffix(".nc"), done.table, force=job.force)
    if job.page:
        done.write_page(job.output.with_suffix(".html"), job.source.name, job.force)
    if job.thumbnail:
        write_thumbnail(job.output.with_suffix(".png"), table, done.table["brdf"], force=job.force)
    if job.store is not None:
        write_row(job.store, job.row, done.table)
    document = {"file": str(job.source), **done.document, "input": before.document()}
    if job.key is not None:
        sizes = {path.name: path.stat().st_size for path in job.files[:-1]}
        seconds = time.perf_counter() - started
        document["run"] = {"settings": job.key, "files": sizes, "seconds": seconds}
    write_json(job.record, plain(document), force=job.force)
    return document


class Outcome(NamedTuple):
    """How a job ended. reason: None, or one line; trace: of a fault of ours."""

    source: Path
    seconds: float
    reason: str | None = None
    trace: str | None = None


def attempted(job: Job) -> Outcome:
    """Do a job; what goes wrong is its outcome and stops nobody else."""
    started = time.perf_counter()

    def failed(reason: str, trace: str | None = None) -> Outcome:
        return Outcome(job.source, time.perf_counter() - started, reason, trace)

    try:
        corrected_files(job)
    except MatcamError as error:
        text = " ".join(str(error).split())
        return failed(text if str(job.source) in text else f"{job.source}: {text}")
    except MemoryError:
        return failed(f"{job.source}: not enough memory")
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return failed(f"{job.source}: a fault of matcam, not of your input: {text}", traceback.format_exc())
    return Outcome(job.source, time.perf_counter() - started)
