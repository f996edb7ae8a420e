"""Reading a user's file: what the system refuses is said in one line, the same for every format."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from matcam.errors import FileFormatError


@contextlib.contextmanager
def reading(path: Path, what: str = "") -> Iterator[None]:
    """Context in which `path` is opened and read. FileFormatError, naming it, where there is no such file, where it cannot be
    read, and, if `what` says what it should be ("a picture"), where it is a folder."""
    try:
        if what and path.is_dir():
            raise FileFormatError(f"{path}: is a folder, not {what}")
        yield
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror or error}") from None
