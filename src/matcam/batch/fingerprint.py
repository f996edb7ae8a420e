"""What an input was when it was read: enough to tell later whether it still is."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, NamedTuple

from matcam.errors import FileFormatError
from matcam.input_file import reading


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
