"""The family of errors that a user's input can cause: each says what was wrong, where, and what would be right."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable


class MatcamError(Exception):
    """Report an error that a user's input can cause.

    All errors of the family are of this class. Their text is one line: what was wrong, where, and what would be right.

    Example:
        >>> try:
        ...     matcam.GGX(2.0)
        ... except matcam.MatcamError as error:
        ...     print(error)
        alpha must lie in (0, 1], got 2
    """

    def __init__(self, *args: object):
        super().__init__(*(re.sub(r"\s*[\r\n]\s*", " ", one) if isinstance(one, str) else one for one in args))


class ArgumentError(MatcamError, ValueError):
    """Report an argument that is out of its range, of the wrong shape, or of the wrong kind."""


class FileFormatError(MatcamError):
    """Report a file that is not what it should be. The message names the file and the byte or field."""


class OutputError(MatcamError):
    """Report an output that cannot be written where it was asked for, or would destroy something."""


class DownloadError(MatcamError):
    """Report a file that could not be fetched, or is not what its checksum says."""


class FitError(MatcamError):
    """Report data that do not determine what was asked of them."""


def one_line(error: Exception) -> str:
    """Return a library's complaint as one line, cut short."""
    return " ".join(str(error).split())[:120] or type(error).__name__


def unknown_name(kind: str, name: object, known: Iterable[str]) -> ArgumentError:
    """Return the error for a `name` that is none of the `known` ones; it suggests the nearest of them."""
    known = sorted(known)
    if not isinstance(name, str):
        return ArgumentError(
            f"{kind} must be a name, got {' '.join(repr(name).split())[:60]}; known: {', '.join(known)}"
        )
    by_lowercase = {candidate.lower(): candidate for candidate in known}
    nearest = difflib.get_close_matches(name.lower(), by_lowercase, n=1, cutoff=0.5)
    hint = f"did you mean {by_lowercase[nearest[0]]!r}?" if nearest else f"known: {', '.join(known)}"
    return ArgumentError(f"unknown {kind} {name!r}; {hint}")
