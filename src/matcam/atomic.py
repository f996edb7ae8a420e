"""Safe writing: a file appears under its final name whole, or not at all; nothing is destroyed unasked."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from matcam.errors import OutputError


def check_output(path: str | Path, *, force: bool = False, inputs: Iterable[str | Path] = ()) -> Path:
    """Refuse, before any work, an output that could not be written or that would destroy something.

    Raises OutputError when `path` is a folder, has a file as parent, is one of `inputs` (even with `force`), or
    exists and `force` is not set.
    """
    path = Path(path)
    for source in inputs:
        if path.exists() and Path(source).exists() and path.samefile(source):
            raise OutputError(f"output {path} is the input itself: choose another name")
    if path.is_dir():
        raise OutputError(f"output {path} is a folder: give a file name inside it")
    for parent in path.parents:
        if parent.exists():
            if not parent.is_dir():
                raise OutputError(f"output {path} cannot be written: {parent} is a file, not a folder")
            break
    if path.exists() and not force:
        raise OutputError(f"output {path} exists: use --force (force=True) to replace it")
    return path


@contextlib.contextmanager
def replacing(path: str | Path, *, force: bool = False, inputs: Iterable[str | Path] = ()) -> Iterator[Path]:
    """Yield a temporary name beside `path`; on success it becomes `path`, on any exception it vanishes.

    The temporary name keeps the suffix, because writers choose their format by it.
    """
    path = check_output(path, force=force, inputs=inputs)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise OutputError(f"output {path} cannot be written: {error.strerror}") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes private files; give the result the permissions that an ordinary open() would have given
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"output {path} cannot be written: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
