"""What an input was when it was read: enough to tell later whether it still is.

What is done to one table: `correction`, and what a reader is told of it.

One material: a table goes in, its files come out. What a worker is told is a `Job`, and what it does `corrected_files`.
"""

from __future__ import annotations

import hashlib
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from matcam.batch.store import write_row
from matcam.core.errors import ArgumentError, FileFormatError, MatcamError
from matcam.core.grid import Sampling
from matcam.core.io import check_output, reading
from matcam.core.json import plain, write_json
from matcam.figures.correction_page import write_correction_page
from matcam.figures.spheres import write_thumbnail
from matcam.files.datasets import write_netcdf
from matcam.files.merl import read_merl, write_merl
from matcam.inverse.correction.correction import Correction
from matcam.rigs import Rig


class Fingerprint(NamedTuple):
    """A file's size (bytes), time of change (ns) and SHA-256."""

    bytes: int
    mtime_ns: int
    sha256: str

    def document(self) -> dict[str, Any]:
        """As plain numbers and texts."""
        return {**self._asdict()}


def fingerprint(path: Path) -> Fingerprint:
    """Of a file's content. FileFormatError where it cannot be read."""
    with reading(path, "a table"):
        status = path.stat()
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    return Fingerprint(status.st_size, status.st_mtime_ns, digest)


def unchanged(path: Path, known: Any) -> bool:
    """Whether a file still is what `known`, a fingerprint's document, says. Its content is read only where its time is not
    the same: hashing a hundred thousand tables would take an hour, and looking at their times takes seconds."""
    try:
        status = path.stat()
        if status.st_size != known["bytes"]:
            return False
        return status.st_mtime_ns == known["mtime_ns"] or fingerprint(path).sha256 == known["sha256"]
    except (OSError, KeyError, TypeError, FileFormatError):
        return False


class Options(NamedTuple):
    """How a table is corrected: family of the lobe or "auto"; masking or None; share of light that the lens may scatter."""

    ndf: str = "auto"
    masking: Any = "smith"
    glare: float = 1e-3


class Corrected(NamedTuple):
    """A table corrected: Dataset (brdf, brdf_std, supported, response), what is to be said of it as plain numbers and texts,
    and write_page(path, name, force), which draws the page to read."""

    table: xr.Dataset
    document: dict[str, Any]
    write_page: Callable[[Path, str, bool], None]


Corrector = Callable[[xr.DataArray, Rig, Options], Corrected]
"""Does the work on one table. Workers are told its name, so it stands at the top of a module that they can import."""


def corrected(table: xr.DataArray, rig: Rig, options: Options) -> Corrected:
    """The table that a perfect camera would have measured. Errors as `correct`'s."""
    done = Correction.of(table, rig, options.ndf, masking=options.masking, glare=options.glare)
    document = {"camera": rig.camera.profile(), "glare": options.glare, **done.to_dict()}

    def write_page(path: Path, name: str, force: bool) -> None:
        write_correction_page(path, table, done, name, force=force)

    return Corrected(done.table, document, write_page)


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
    was changed while it was read; `correct`'s errors.
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
