"""Where results that depend on a rig alone are kept: in memory, and on disk between processes.

Nothing is kept behind a caller's back: functions that keep something take a `Workspace`. Libraries that name none share the one
that `default_workspace` returns, which keeps nothing on disk. The command line and a run's workers name `Workspace.user()`.

Tables that come with the package (metals, checksums, EPD's peak) and what depends on a few plain numbers alone (a spline's
basis, a lens model) are constants, whoever asks: they stay in `functools.cache` where they are made.
"""

from __future__ import annotations

import hashlib
import io
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from matcam.core import checks
from matcam.core.io import user_cache_folder
from matcam.core.sealed import read_sealed, remove_sealed, sealed_files, write_sealed

T = TypeVar("T")


@dataclass(frozen=True)
class Workspace:
    """Keep what depends on a rig alone, for the next call in this process and for the next process.

    Args:
        folder: folder on disk for arrays that other processes may use; it is made when something is kept. Default: None,
            nothing is kept on disk.
        entries: results of each kind kept in memory, the latest used; 0: none (no unit). Default: 6, enough for the rigs and
            slices of one correction.
        files: files kept in `folder`, the latest written (no unit). Default: 12, at most some hundred MB.

    Raises:
        ArgumentError: `entries` or `files` is not a whole number >= 0.

    Example:
        >>> from matcam.core.workspace import Workspace
        >>> workspace = Workspace()
        >>> workspace.remember("squares", 3, lambda: 3**2)
        9
        >>> workspace.remember("squares", 3, lambda: print("not asked again"))
        9
    """

    folder: Path | None = None
    entries: int = 6
    files: int = 12
    _memory: dict[str, OrderedDict[Hashable, Any]] = field(default_factory=dict, init=False, repr=False, compare=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("entries", "files"):
            checks.whole_number(name, getattr(self, name), 0)
        if self.folder is not None:
            object.__setattr__(self, "folder", Path(self.folder))

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel to another process without what is in memory."""
        return type(self), (self.folder, self.entries, self.files)

    @classmethod
    def user(cls) -> Workspace:
        """Return this process's workspace in the user's cache folder.

        A program may choose this for its user; a library must not.

        Returns:
            The workspace that keeps files in the folder `rules` of `user_cache_folder`, always the same one.
        """
        return _user_workspace(user_cache_folder() / "rules")

    def remember(self, kind: str, key: Hashable, make: Callable[[], T], most: int | None = None) -> T:
        """Return what `make` returned for this key before, or call it.

        Args:
            kind: what is kept; each kind has a memory of its own.
            key: all that the result depends on.
            make: function that computes the result.
            most: results of this kind kept in memory, where they are too large for `entries` of them. Default: None.

        Returns:
            The result, which callers share: it must not be changed.
        """
        with self._lock:
            memory = self._memory.setdefault(kind, OrderedDict())
            if key in memory:
                memory.move_to_end(key)
                return memory[key]
        result = make()
        with self._lock:
            memory[key] = result
            while len(memory) > min(self.entries, self.entries if most is None else most):
                memory.popitem(last=False)
        return result

    def store(self, description: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return the arrays that `make` returned for this description before, from disk, or call it.

        The file's name is a hash of the description and of the package's version. It ends in a SHA-256 of both and of its
        content, so that a file that is damaged, or another's, is not believed: it is made again, and one line is logged. One
        that cannot be written is not: a full disk must not stop a fit. Where there are no arrays nothing is kept.

        Args:
            description: text that holds all that the arrays depend on.
            make: function that computes the arrays.

        Returns:
            The arrays by name.
        """
        if self.folder is None:
            return make()
        key = _key(description)
        path = self.folder / _file_name(key)
        stored = read_sealed(path, key)
        if stored is not None:
            with np.load(io.BytesIO(stored), allow_pickle=False) as file:
                return {name: file[name] for name in file.files}
        arrays = make()
        if not arrays:
            return arrays
        packed = io.BytesIO()
        np.savez(packed, **arrays)  # type: ignore[arg-type]
        write_sealed(path, key, packed.getvalue())
        by_age = sorted(
            (one.status.st_mtime, one.name) for one in sealed_files(self.folder) if one.name.endswith(".npz")
        )
        remove_sealed(self.folder, [name for _, name in by_age[: max(len(by_age) - self.files, 0)]])
        return arrays


def kept_file(folder: Path, description: str) -> Path:
    """Return where a workspace of this folder keeps what has this description."""
    return folder / _file_name(_key(description))


def _key(description: str) -> bytes:
    return f"{metadata.version('matcam')}\n{description}".encode()


def _file_name(key: bytes) -> str:
    return f"{hashlib.sha256(key).hexdigest()[:32]}.npz"


@cache
def default_workspace() -> Workspace:
    """Return the workspace of a process that names none.

    It keeps results in memory and nothing on disk. It is made here and nowhere else.
    """
    return Workspace()


@cache
def _user_workspace(folder: Path) -> Workspace:
    return Workspace(folder)
