"""One family of errors: each says what was wrong, where, and what would be right."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class MatcamError(Exception):
    """Base of every error that a user's input can cause. Its text is one line."""


class ArgumentError(MatcamError, ValueError):
    """An argument is out of its range, of the wrong shape, or of the wrong kind."""


class FileFormatError(MatcamError):
    """A file is not what it should be. The message names the file and the byte or field."""


class OutputError(MatcamError):
    """An output cannot be written where it was asked for, or would destroy something."""


class DownloadError(MatcamError):
    """A file could not be fetched, or what came is not what its checksum says."""


class FitError(MatcamError):
    """The data do not determine what was asked of them."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> ArgumentError:
    """Error for a `name` that is none of the `known` ones; suggests the nearest of them."""
    known = sorted(known)
    by_lowercase = {candidate.lower(): candidate for candidate in known}
    nearest = difflib.get_close_matches(name.lower(), by_lowercase, n=1, cutoff=0.5)
    hint = f"did you mean {by_lowercase[nearest[0]]!r}?" if nearest else f"known: {', '.join(known)}"
    return ArgumentError(f"unknown {kind} {name!r}; {hint}")
