"""A material's sphere before and after, as small as a row of a table is high."""

from __future__ import annotations

from pathlib import Path

import imagecodecs
import numpy as np
import xarray as xr

from matcam.atomic import replacing
from matcam.figures.ball import ball, body_white, shown

SIZE = 64
"""Height of the picture and width of each half, px."""


def write_thumbnail(path: str | Path, raw: xr.DataArray, corrected: xr.DataArray, *, force: bool = False) -> None:
    """Write a PNG of 128 x 64 px: a sphere under one lamp from the recorded table (left) and from the corrected one (right),
    at one exposure."""
    before, after = (ball(table.values, SIZE) for table in (raw, corrected))
    white = body_white(after)
    both = np.concatenate([shown(half, white) for half in (before, after)], axis=1)
    if both.shape[-1] != 3:
        both = np.repeat(both[..., :1], 3, axis=-1)
    encoded = imagecodecs.png_encode(np.ascontiguousarray((both * 255 + 0.5).astype(np.uint8)))
    with replacing(path, force=force) as temporary:
        temporary.write_bytes(encoded)
