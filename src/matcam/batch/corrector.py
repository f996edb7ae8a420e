"""What is done to one table: `correction`, and what a reader is told of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from matcam.figures.correction_page import verdict, write_correction_page
from matcam.inverse.correction import correction
from matcam.rigs import Rig

_ANGLES = (5, 45, 75)
"""Degrees of theta_d at which the peak's loss is told."""


class Options(NamedTuple):
    """How a table is corrected: family of the lobe or "auto"; masking or None; share of light that the lens may scatter."""

    ndf: str = "auto"
    masking: Any = "smith"
    glare: float = 1e-3


class Corrected(NamedTuple):
    """A table corrected: Dataset (brdf, brdf_std, supported, response), what is to be said of it as plain numbers and texts,
    and write_page(path, name, force), which draws the page to read."""

    table: xr.Dataset
    document: dict[str, Any]
    write_page: Callable[[Path, str, bool], None]


Corrector = Callable[[xr.DataArray, Rig, Options], Corrected]
"""Does the work on one table. Workers are told its name, so it stands at the top of a module that they can import."""


def corrected(table: xr.DataArray, rig: Rig, options: Options) -> Corrected:
    """The table that a perfect camera would have measured. Errors as `correction`'s."""
    done = correction(table, rig, options.ndf, masking=options.masking, glare=options.glare)
    there = np.isfinite(table.values)
    response = done.table["response"].values[0, :, 90]
    document = {
        "camera": rig.camera.profile(),
        "fit": done.fit.summary(),
        "doubts": {doubt.axis.name: {**doubt.fit.summary(), "contradicts": doubt.contradicts} for doubt in done.doubts},
        "shape": {"strength": done.shape.strength, "b": done.shape.b},
        "glare": options.glare,
        "supported_share": float(done.table["supported"].values[there].mean()),
        "peak_gain_75": float(1 / response[75]),
        "peak_lost": {str(angle): float(1 - response[angle]) for angle in _ANGLES},
        "verdict": verdict(table, done),
        "remarks": list(done.remarks),
    }

    def write_page(path: Path, name: str, force: bool) -> None:
        write_correction_page(path, table, done, name, force=force)

    return Corrected(done.table, document, write_page)
