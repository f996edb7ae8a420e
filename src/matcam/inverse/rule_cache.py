"""What depends on a rig alone, kept on disk between runs under a name made of its content."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import numpy as np

from matcam.atomic import replacing
from matcam.errors import OutputError

_MOST_FILES = 12
_folder: Path | None = None


def use_folder(folder: Path | None) -> None:
    """Keep rules in `folder` from now on; None: nowhere, as a library does until it is told."""
    global _folder
    _folder = folder


def kept(description: str, made: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The arrays of `made()`, from disk if this very description was kept by this version of the package."""
    if _folder is None:
        return made()
    name = hashlib.sha256(f"{metadata.version('matcam')}\n{description}".encode()).hexdigest()[:32]
    path = _folder / f"{name}.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            return {key: file[key] for key in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        pass  # not there, or not whole: made again
    arrays = made()
    try:
        with replacing(path, force=True) as temporary:
            np.savez(temporary, **arrays)  # type: ignore[arg-type]
        for old in sorted(_folder.glob("*.npz"), key=lambda p: p.stat().st_mtime)[:-_MOST_FILES]:
            old.unlink(missing_ok=True)
    except (OutputError, OSError):
        pass  # a full or read-only disk must not stop a fit
    return arrays
