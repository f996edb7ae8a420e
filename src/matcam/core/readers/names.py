"""Names of files and folders as callers and documents give them: which are there, and which are refused.

A document that others may have made names files of its own folder alone.
"""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath

from matcam.core.errors import FileFormatError

_LONGEST = 200
"""Characters of a name in a document, at most: file systems allow 255 bytes for each of its parts."""


def is_there(path: Path) -> bool:
    """Check whether there is a file or folder. A name that the system refuses, such as one that is too long, names none."""
    return os.path.exists(path)  # noqa: PTH110  # Path.exists raises an error for such a name


def is_file(path: Path) -> bool:
    """Check whether there is a file, as `is_there` does."""
    return os.path.isfile(path)  # noqa: PTH113


def is_folder(path: Path) -> bool:
    """Check whether there is a folder, as `is_there` does."""
    return os.path.isdir(path)  # noqa: PTH112


def is_link(path: Path) -> bool:
    """Check whether there is a link, as `is_there` does."""
    return os.path.islink(path)  # noqa: PTH114


def check_folder(path: Path, hint: str = "") -> None:
    """Refuse what is no folder. FileFormatError; `hint` states what to give instead."""
    if is_there(path) and not is_folder(path):
        raise FileFormatError(f"{path}: is no folder{hint}")
    try:
        path.stat()
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such folder") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:
        raise FileFormatError(f"{printable(str(path))}: is no name of a file") from None


UNPRINTABLE = "[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
"""Characters that move a terminal's cursor or change its state, and bytes of a name that are no text."""


def printable(text: str) -> str:
    """Return text without characters that a terminal obeys, or that are no characters: each as its escape."""
    return re.sub(UNPRINTABLE, lambda found: found[0].encode("unicode_escape").decode(), text)


def check_name(path: Path) -> None:
    """Refuse an input whose name could not be written down. FileFormatError."""
    if re.search(UNPRINTABLE, path.name):
        raise FileFormatError(f"{printable(str(path))}: its name is not plain text: rename it")


def check_within(path: Path, folder: Path) -> None:
    """Refuse a file of a folder that is a link to elsewhere: who fills a folder must not choose among the reader's files.

    FileFormatError where following the links of `path` leads out of `folder`.
    """
    if is_link(path) and not (target := path.resolve()).is_relative_to(folder.resolve()):
        raise FileFormatError(f"{path}: is a link out of its folder, to {target}: name that file itself")


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
