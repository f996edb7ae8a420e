"""Check of the input files of a command, before its heavy imports."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from matcam.core.io import reading


def check_inputs(paths: Iterable[Path], what: str = "") -> None:
    """Raise FileFormatError for missing files, before any work.

    `what` is the expected content, as for `reading`.
    """
    for path in paths:
        with reading(path, what):
            pass
