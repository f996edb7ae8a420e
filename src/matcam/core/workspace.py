"""A thing with the key by which it is told from others: for caches of what is not hashable itself.

What depends on a rig alone, kept on disk between runs under a name made of its content.

What is worth keeping on disk between processes: compiled functions, and what depends on a rig alone.
"""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Callable, Hashable
from importlib import metadata
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from matcam.core.errors import OutputError
from matcam.core.io import replacing

T = TypeVar("T")


class Keyed(Generic[T]):
    """`thing`, equal to another of the same key."""

    def __init__(self, key: Hashable, thing: T):
        self.key, self.thing = key, thing

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Keyed) and self.key == other.key


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


def keep_rules() -> None:
    """Keep both in the user's cache folder from now on. A process of ours may; a library must not choose this for its user."""
    from matcam.core.jax import use_compilation_cache

    use_compilation_cache()
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    use_folder(Path(root) / "matcam" / "rules")
