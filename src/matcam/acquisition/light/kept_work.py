"""Cache on disk of results from the frames of a capture, so that an interrupted computation resumes.

The key of a file contains the settings, the version of the package, and a fingerprint of the frames. The fingerprint
depends on the name, the size, the time of change, and the first and last 64 KiB of each frame. Only complete files are used
(core/sealed.py). A successful computation removes its own files, and all files that are older than two weeks.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from matcam.core.sealed import remove_sealed, sealed_files
from matcam.core.workspace import Workspace, is_kept, kept_file

_PIECE = 1 << 16  # number of bytes at either end of a frame that its fingerprint includes


@dataclass
class KeptWork:
    """Cache of arrays of one computation.

    Attributes:
        folder: folder of the files; it is created with the first file.

    Example:
        >>> import tempfile
        >>> kept = KeptWork(Path(tempfile.mkdtemp()))
        >>> kept.store("squares", lambda: {"of three": np.array(9)})["of three"]
        array(9)
        >>> kept.store("squares", lambda: {})["of three"]  # loaded, not computed again
        array(9)
    """

    folder: Path
    _files: set[Path] = field(default_factory=set)

    def store(self, description: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Load the arrays for a description from disk, or compute and store them.

        Args:
            description: text that contains all dependencies of the arrays.
            make: function that computes the arrays.
        """
        self._files.add(kept_file(self.folder, description))
        # in effect unlimited, because files are removed by their age
        return Workspace(self.folder, files=100_000).store(description, make)

    def clear(self) -> None:
        # files of other computations are removed after two weeks
        since = time.time() - 14 * 86400.0
        old = [name for name, of in sealed_files(self.folder).items() if of.st_mtime < since and is_kept(name)]
        remove_sealed(self.folder, [*(path.name for path in self._files), *old])


def identity(paths: Iterable[Path]) -> str:
    """Compute a fingerprint of the files: one line for each file, with name, size, time of change and a hash."""
    lines = []
    for path in paths:
        try:
            about = path.stat()
            with path.open("rb") as file:
                digest = hashlib.sha256(file.read(_PIECE))
                file.seek(max(about.st_size - _PIECE, 0))
                digest.update(file.read(_PIECE))
        except OSError as error:  # reading the file will report the error
            lines.append(f"{path.name} {error.strerror}")
            continue
        lines.append(f"{path.name} {about.st_size} {about.st_mtime_ns} {digest.hexdigest()}")
    return "\n".join(lines)


def fingerprint(*values: object) -> str:
    digest = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray):
            digest.update(f"{value.dtype} {value.shape}".encode())
            digest.update(np.ascontiguousarray(value).data)
        else:
            digest.update(repr(value).encode())
    return digest.hexdigest()
