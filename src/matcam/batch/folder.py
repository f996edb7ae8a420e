"""A run's folder is one run's at a time, and holds no leftovers of one that was killed.

Which materials are finished: what lies on disk says it, so that a killed run goes on where it was.

Which material of a run stands in which row of its Zarr.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from matcam.batch.job import Job, unchanged
from matcam.batch.store import open_rows, whole_rows, write_row
from matcam.core.errors import FileFormatError, OutputError
from matcam.core.json import read_json
from matcam.files.datasets import read_netcdf

_LOCK = ".lock"
_TEMPORARY = re.compile(r"\.(.+)-[a-z0-9_]{8}\.(?:binary|nc|json|html|png)")


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold a folder, made where it is not there, until the end. The system lets go of it when this process dies, however that
    comes about. OutputError where another run holds it, or it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / _LOCK).open("w")
    except OSError as error:
        raise OutputError(f"output folder {folder} cannot be written: {error.strerror}") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(
                f"output folder {folder} is in use by another run: wait for it, or choose another"
            ) from None
        except OSError:
            pass  # a file system without locks, as some network ones
        yield


def sweep(folder: Path, stems: Iterable[str]) -> None:
    """Remove the temporary files of `atomic.replacing` that a killed process left beside files of these names."""
    known = set(stems)
    for path in folder.iterdir():
        found = _TEMPORARY.fullmatch(path.name)
        if found and found[1] in known:
            path.unlink(missing_ok=True)


def record_of(path: Path, key: str) -> dict[str, Any] | None:
    """A material's record, if it is one of the run with this key and all its files are there with the sizes that they had."""
    try:
        document = read_json(path, "a material's record")
        run = document["run"]
        if run["settings"] != key:
            return None
        whole = all((path.parent / name).stat().st_size == size for name, size in run["files"].items())
    except (FileFormatError, OSError, KeyError, TypeError, AttributeError, json.JSONDecodeError):
        return None
    return document if whole else None


def is_finished(job: Job) -> bool:
    """Whether a job's files are all there, whole, made with its settings from its input as it is now."""
    if job.key is None:
        return False
    document = record_of(job.record, job.key)
    return document is not None and unchanged(job.source, document.get("input"))


def records(jobs: Iterable[Job]) -> Iterator[tuple[str, dict[str, Any]]]:
    """(name, record) of those of a run's jobs that are finished."""
    for job in jobs:
        document = record_of(job.record, job.key or "")
        if document is not None:
            yield job.name, document


STORE = "run.zarr"


def with_rows(store: Path, jobs: Sequence[Job], waiting: Sequence[Job]) -> list[Job]:
    """The jobs that are waiting, each told its row. Rows of finished materials that are not whole, because the Zarr was asked
    for later, or lost, are copied from their NetCDF. Errors as `open_rows`'s and `write_row`'s."""
    if not jobs:
        return list(waiting)
    rows = open_rows(store, [job.name for job in jobs], jobs[0].sampling)
    whole = whole_rows(store)
    later = {job.name for job in waiting}
    for job in jobs:
        if job.name not in later and not whole[rows[job.name]]:
            write_row(store, rows[job.name], read_netcdf(job.output.with_suffix(".nc")))
    return [replace(job, store=store, row=rows[job.name]) for job in waiting]
