"""A run's folder is one run's at a time, and holds no leftovers of one that was killed."""

from __future__ import annotations

import contextlib
import fcntl
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from matcam.errors import OutputError

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
