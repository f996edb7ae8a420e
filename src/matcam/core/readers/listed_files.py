"""Files that a document names, which others may have made: each lies in the folder of the document."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

from matcam.core.errors import FileFormatError

_LONGEST = 200
"""Characters of a name, at most: file systems allow 255 bytes for each of its parts."""


def listed_file(folder: Path, name: str, what: str) -> Path:
    """Return the path of a file that a document of a folder names.

    Args:
        folder: of the document.
        name: relative to the folder, parts divided by "/".
        what: the folder in words, such as "the capture's folder".

    Raises:
        FileFormatError: the name is not plain text, or leads out of the folder, by itself or by a link.
    """
    pure = PurePosixPath(name)
    path = folder / name
    if not pure.parts or not name.isprintable() or len(name) > _LONGEST:
        raise FileFormatError(f"{folder}: file {name[:40]!r} has no name that is plain text")
    if pure.is_absolute() or ".." in pure.parts or "\\" in name or re.match(r"[A-Za-z]:", name):
        raise FileFormatError(f"{path}: leads out of {what}: give a name inside it")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise FileFormatError(f"{path}: is a link out of {what}: put the file itself there")
    return path
