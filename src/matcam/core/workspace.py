"""Cache of results that depend on a rig alone: in memory, and on disk between processes.

Caching is explicit: functions that cache take a `Workspace`. The default is `default_workspace()`, which has no files
on disk. The command line and the workers of a run use `Workspace.user()`.

Results that do not depend on a rig are cached by `functools.cache`. These are tables of the package (metals, checksums,
the peak of an EPD lobe), and functions of a few numbers, such as the basis of a spline.
"""

from __future__ import annotations

import hashlib
import io
import math
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

_SUFFIX = ".arrays"
_ALIGNED = 64
"""Arrays begin at multiples of this number of bytes, as in .npy files."""

T = TypeVar("T")


@dataclass(frozen=True)
class Workspace:
    """Cache of results that depend on a rig alone, in memory and on disk.

    Args:
        folder: folder on disk for arrays that other processes may use; it is created on first use. Default: None, no
            files.
        entries: largest number of results of each kind in memory, no unit. The results that were used last are kept. If
            `entries` is 0, no results are kept. Default: 6, enough for the rigs and slices of one correction.
        files: largest number of files in `folder`, no unit. The files that were written last are kept. Default: 12, at
            most a few hundred MB.

    Raises:
        ArgumentError: `entries` or `files` is not a whole number >= 0.

    Example:
        >>> from matcam.core.workspace import Workspace
        >>> workspace = Workspace()
        >>> workspace.remember("squares", 3, lambda: 3**2)
        9
        >>> workspace.remember("squares", 3, lambda: print("not computed again"))
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
        return type(self), (self.folder, self.entries, self.files)

    @classmethod
    def user(cls) -> Workspace:
        """Return this process's workspace in the user's cache folder.

        Only programs may use this workspace, because a library must not write files that its caller did not request.

        Returns:
            The workspace with files in the folder `rules` of `user_cache_folder`. Every call returns the same object.
        """
        return _user_workspace(user_cache_folder() / "rules")

    def remember(self, kind: str, key: Hashable, make: Callable[[], T], most: int | None = None) -> T:
        """Return the cached result of a key, or compute it.

        Args:
            kind: kind of the result; each kind has its own memory.
            key: all dependencies of the result.
            make: function that computes the result.
            most: largest number of results of this kind in memory, for large results. `entries` is also an upper limit.
                Default: None, the limit is `entries`.

        Returns:
            The result, which is shared and must not be changed.
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
        """Return the arrays of a description from disk, or compute and store them.

        The name of the file is a hash of the description and of the version of the package. The file ends in a SHA-256
        hash of the description, the version and the content. If the file is damaged, or another user may change it, one
        line is logged and the arrays are computed again. A file that cannot be written is skipped. An empty
        result is not stored. Without a folder, every call computes the arrays.

        Args:
            description: text with all dependencies of the arrays.
            make: function that computes the arrays.

        Returns:
            The arrays by name. Arrays from disk are read-only.
        """
        if self.folder is None:
            return make()
        key = _key(description)
        path = self.folder / _file_name(key)
        stored = read_sealed(path, key)
        if stored is not None:
            return _unpacked(stored)
        arrays = make()
        if not arrays:
            return arrays
        write_sealed(path, key, _packed(arrays))
        by_age = sorted((of.st_mtime, name) for name, of in sealed_files(self.folder).items() if is_kept(name))
        remove_sealed(self.folder, [name for _, name in by_age[: max(len(by_age) - self.files, 0)]])
        return arrays


def kept_file(folder: Path, description: str) -> Path:
    return folder / _file_name(_key(description))


def is_kept(name: str) -> bool:
    """Check whether a file contains stored arrays, by its name.

    Files of earlier versions count, too, so that they are removed.
    """
    return name.endswith((_SUFFIX, ".npz"))


def _packed(arrays: dict[str, np.ndarray]) -> memoryview:
    """Write arrays as a sequence of .npy files; the first one contains the names."""
    file = io.BytesIO()
    for array in (np.array(list(arrays)), *arrays.values()):
        np.save(file, array, allow_pickle=False)
        file.write(bytes(-file.tell() % _ALIGNED))
    return file.getbuffer()


def _unpacked(stored: memoryview) -> dict[str, np.ndarray]:
    """View the arrays that `_packed` wrote, without copying them in memory."""
    arrays: list[np.ndarray] = []
    start = 0
    while start < len(stored):
        head = io.BytesIO(stored[start : start + 4096])  # headers of .npy files have 128 bytes
        np.lib.format.read_magic(head)
        shape, by_columns, dtype = np.lib.format.read_array_header_1_0(head)
        start += head.tell()
        array = np.frombuffer(stored, dtype, math.prod(shape), start)
        arrays.append(array.reshape(shape, order="F" if by_columns else "C"))
        start += array.nbytes
        start += -start % _ALIGNED
    names, *values = arrays
    return dict(zip(names.tolist(), values, strict=True))


def _key(description: str) -> bytes:
    return f"{metadata.version('matcam')}\n{description}".encode()


def _file_name(key: bytes) -> str:
    return f"{hashlib.sha256(key).hexdigest()[:32]}{_SUFFIX}"


@cache
def default_workspace() -> Workspace:
    """Return the default workspace of the process, which has no files on disk."""
    return Workspace()


@cache
def _user_workspace(folder: Path) -> Workspace:
    return Workspace(folder)
