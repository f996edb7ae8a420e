"""Check of the input files of a command, before slow imports."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from matcam.core.io import reading


def check_inputs(paths: Iterable[Path], what: str = "") -> None:
    """Check that input files exist, before any work. Otherwise a FileFormatError is raised.

    `what` is the expected content, such as "a table"; if it is not empty, a folder is an error, too.
    """
    for path in paths:
        with reading(path, what):
            pass
