"""Errors that a user's input can cause; each message contains the fault, its location and the remedy."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable


class MatcamError(Exception):
    """Error that a user's input can cause.

    All errors of the package derive from this class. The text of an error is one line with the fault, its location and the
    remedy.

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
    """Argument that is out of its range, of the wrong shape, or of the wrong kind."""


class FileFormatError(MatcamError):
    """File that cannot be read, or has invalid content. The message names the file."""


class OutputError(MatcamError):
    """Output file that cannot be written, or that would overwrite another file."""


class DownloadError(MatcamError):
    """File that could not be fetched, or has a wrong checksum."""


class FitError(MatcamError):
    """Data that do not determine the requested result."""


class RegionError(FitError):
    """Region of an image without a measurable edge, although the image may have one elsewhere."""


def one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__


def described(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def unknown_name(kind: str, name: object, known: Iterable[str]) -> ArgumentError:
    known = sorted(known)
    listed = ", ".join(known[:30]) + (f" and {len(known) - 30} others" if len(known) > 30 else "")
    if not isinstance(name, str):
        return ArgumentError(f"{kind} must be a name, got {' '.join(repr(name).split())[:60]}; known: {listed}")
    by_lowercase = {candidate.lower(): candidate for candidate in known}
    nearest = difflib.get_close_matches(name.lower(), by_lowercase, n=1, cutoff=0.5)
    hint = f"did you mean {by_lowercase[nearest[0]]!r}?" if nearest else f"known: {listed}"
    return ArgumentError(f"unknown {kind} {name!r}; {hint}")
