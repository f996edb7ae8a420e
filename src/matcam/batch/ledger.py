"""Which materials are finished: what lies on disk says it, so that a killed run goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from matcam.batch.fingerprint import unchanged
from matcam.batch.job import Job
from matcam.errors import FileFormatError
from matcam.json_file import read_json


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
