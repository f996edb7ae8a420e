"""What the containers of labelled arrays share: what they may say that they hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from matcam.errors import FileFormatError

_MOST_TIMES, _MOST_VARIABLES, _SPARE = 4, 256, 1 << 16


def check_stored_sizes(path: Path, size: int, variables: Mapping[str, tuple[tuple[int, ...], Any]]) -> None:
    """FileFormatError where arrays of these shapes and types are more than four times the file's bytes together: damaged, or
    compressed beyond what is trusted."""
    if len(variables) > _MOST_VARIABLES:
        raise FileFormatError(f"{path}: {len(variables)} variables: damaged, or not a result")
    total = 0
    for name, (shape, kind) in variables.items():
        # text and lists of any length say nothing of their size: eight bytes each
        each = np.dtype(kind).itemsize if isinstance(kind, np.dtype) else 8
        total += math.prod(shape) * max(each, 1)
        if total > _MOST_TIMES * size + _SPARE:
            raise FileFormatError(
                f"{path}: variable {name!r:.60} of {' x '.join(map(str, shape))} values does not fit into {size} bytes: "
                "damaged, or compressed beyond what is trusted"
            )


def one_line(error: Exception) -> str:
    """What a library complained about, cut short."""
    return " ".join(str(error).split())[:120] or type(error).__name__
