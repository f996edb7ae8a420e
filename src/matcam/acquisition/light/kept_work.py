"""Keep what was read of a capture's frames on disk, so that a run that was cut off goes on where it was.

A file belongs to what it was made of: the frames (name, size, time of change, first and last 64 KiB of each), the settings,
and the package's version. It is believed only whole (core/sealed.py). A run that ends well removes its files; what is older
than two weeks is removed by the next.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from matcam.core.sealed import remove_sealed, sealed_files
from matcam.core.workspace import Workspace, kept_file

_PIECE = 1 << 16  # bytes of either end of a frame
_OLD = 14 * 86400.0  # s
_MOST = 100_000  # files: age decides what goes


@dataclass
class KeptWork:
    """Keep arrays of one run.

    Attributes:
        folder: where files lie; it is made when something is kept.

    Example:
        >>> import tempfile
        >>> kept = KeptWork(Path(tempfile.mkdtemp()))
        >>> kept.store("squares", lambda: {"of three": np.array(9)})["of three"]
        array(9)
        >>> kept.store("squares", lambda: {})["of three"]  # it is not made again
        array(9)
    """

    folder: Path
    _files: set[Path] = field(default_factory=set)

    def store(self, description: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Return the arrays that `make` returned for this description before, from disk, or call it.

        Args:
            description: text that holds all that the arrays depend on.
            make: function that computes the arrays.
        """
        self._files.add(kept_file(self.folder, description))
        return Workspace(self.folder, files=_MOST).store(description, make)

    def clear(self) -> None:
        """Remove what this run kept, and what others left long ago."""
        since = time.time() - _OLD
        old = [
            one.name for one in sealed_files(self.folder) if one.status.st_mtime < since and one.name.endswith(".npz")
        ]
        remove_sealed(self.folder, [*(path.name for path in self._files), *old])


def identity(paths: Iterable[Path]) -> str:
    """Return what tells these files from others, and from themselves once they have changed."""
    lines = []
    for path in paths:
        try:
            about = path.stat()
            with path.open("rb") as file:
                digest = hashlib.sha256(file.read(_PIECE))
                file.seek(max(about.st_size - _PIECE, 0))
                digest.update(file.read(_PIECE))
        except OSError as error:  # whoever reads it will say what is wrong
            lines.append(f"{path.name} {error.strerror}")
            continue
        lines.append(f"{path.name} {about.st_size} {about.st_mtime_ns} {digest.hexdigest()}")
    return "\n".join(lines)


def fingerprint(*values: object) -> str:
    """Return a hash of arrays and of plain values."""
    digest = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype} {value.shape}".encode())
            digest.update(np.ascontiguousarray(value).data)
        else:
            digest.update(repr(value).encode())
    return digest.hexdigest()
