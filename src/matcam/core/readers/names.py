"""Checks of names of files and folders from callers and documents.

A document of unknown origin may name only files in the folder of the document.
"""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath

from matcam.core.errors import FileFormatError


def is_there(path: Path) -> bool:
    """Check whether a file or folder exists.

    A name that the system rejects, such as a name that is too long, does not exist.
    """
    return os.path.exists(path)  # noqa: PTH110  # Path.exists raises an error for such a name


def is_file(path: Path) -> bool:
    """Check whether a path is a file.

    A name that the system rejects is not the name of a file.
    """
    return os.path.isfile(path)  # noqa: PTH113


def is_folder(path: Path) -> bool:
    """Check whether a path is a folder.

    A name that the system rejects is not the name of a folder.
    """
    return os.path.isdir(path)  # noqa: PTH112


def is_link(path: Path) -> bool:
    """Check whether a path is a link.

    A name that the system rejects is not the name of a link.
    """
    return os.path.islink(path)  # noqa: PTH114


def check_folder(path: Path, hint: str = ": give a folder") -> None:
    """Raise FileFormatError for a path that is not a folder.

    `hint` is the end of the message, with the remedy.
    """
    if is_there(path) and not is_folder(path):
        raise FileFormatError(f"{path}: the input is not a folder{hint}")
    try:
        path.stat()
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such folder") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:
        raise FileFormatError(f"{printable(str(path))}: the path is not valid: remove the special characters") from None


UNPRINTABLE = "[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
"""Characters that move the cursor of a terminal or change its state, and bytes that are not text."""


def printable(text: str) -> str:
    return re.sub(UNPRINTABLE, lambda found: found[0].encode("unicode_escape").decode(), text)


def check_name(path: Path) -> None:
    """Raise FileFormatError for an input whose name is not plain text."""
    if re.search(UNPRINTABLE, path.name):
        raise FileFormatError(f"{printable(str(path))}: its name is not plain text: rename it")


def check_within(path: Path, folder: Path) -> None:
    """Raise FileFormatError if `path` is a link to a file outside `folder`.

    Otherwise the author of a folder could cause the reading of any file of the user who opens the folder.
    """
    if is_link(path) and not (target := path.resolve()).is_relative_to(folder.resolve()):
        raise FileFormatError(f"{path}: the file is a link to {target}, outside its folder: give the target instead")


def listed_file(folder: Path, name: str, what: str) -> Path:
    """Build the path of a file that is named in a document.

    Args:
        folder: folder of the document.
        name: path of the file relative to the folder, with parts separated by "/".
        what: name of the folder, such as "the capture's folder".

    Raises:
        FileFormatError: the name is not plain text of at most 200 characters, or specifies a file outside the folder,
            directly or by a link.
    """
    pure = PurePosixPath(name)
    path = folder / name
    # file systems allow 255 bytes for each part of a path
    if not pure.parts or not name.isprintable() or len(name) > 200:
        raise FileFormatError(
            f"{folder}: file {name[:40]!r} has a name that is not plain text of at most 200 characters: rename it"
        )
    if pure.is_absolute() or ".." in pure.parts or "\\" in name or re.match(r"[A-Za-z]:", name):
        raise FileFormatError(f"{path}: the path leads out of {what}: give a file inside that folder")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise FileFormatError(
            f"{path}: the path is a link to a file outside {what}: replace the link by a copy of the file"
        )
    return path
