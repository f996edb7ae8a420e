"""One camera for all materials of a run: its blur is fitted jointly to a few of them, because one rig recorded all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from matcam.batch.recipe import Recipe
from matcam.camera.camera import Camera
from matcam.camera.uncertainty import Provenance
from matcam.core.errors import FitError, MatcamError
from matcam.core.grid import Sampling
from matcam.exchange.trace import lobe_widths
from matcam.files.merl import read_merl
from matcam.inverse.fit.fit_setup import candidate_fits, free_setup, likeliest
from matcam.inverse.operator.rig_axes import LENS

_FITTED, _EXAMINED = 4, 16
"""Materials that are fitted: the narrowest lobes of those that are examined, because a lens hardly shows in a broad lobe."""
_KNOWN = 0.25
"""Relative standard deviation up to which a fitted blur is used: a correction assumes that it is small."""


def fit_shared_camera(recipe: Recipe, inputs: Sequence[Path]) -> Camera:
    """Return the recipe's camera with the blur that these tables show, and its variance.

    FitError if no table can be read, or they do not determine the blur to a quarter.
    """
    chosen = _narrowest(inputs, recipe.sampling)
    tables = [table for _, table in chosen]
    options = recipe.options
    setup = free_setup(
        tables, recipe.rig, masking=options.masking, camera_parameters="free", workspace=options.workspace
    )
    best = likeliest(candidate_fits(setup, options.ndf))
    value, std = best.params[LENS], best.std[LENS]
    names = ", ".join(file.name for file, _ in chosen)
    camera = best.camera
    if camera is None or not std < _KNOWN * value:
        raise FitError(
            f"{names} do not determine the camera's blur ({value:.3g} +- {std:.2g} px): give the rig the camera's profile "
            "instead of fit_camera=True, or tables with narrower lobes"
        )
    source = Provenance(
        source=f"blur fitted jointly to {names}, a {best.family} lobe for each", notes="; ".join(map(str, best.remarks))
    )
    return Camera(camera.optics, camera.pixel, camera.sensor, uncertainty=camera.uncertainty, provenance=source)


def _narrowest(inputs: Sequence[Path], sampling: Sampling) -> list[tuple[Path, xr.DataArray]]:
    """Return the tables with the narrowest lobes, out of some that are spread evenly over the inputs.

    Tables that cannot be read are skipped: their own jobs will report them.
    """
    places = np.unique(np.linspace(0, max(len(inputs) - 1, 0), min(_EXAMINED, len(inputs))).astype(int))
    widths: list[tuple[float, Path]] = []
    for place in places:
        try:
            table = read_merl(inputs[place], sampling=sampling)
        except MatcamError:
            continue
        across = lobe_widths(table).across
        width = float(np.nanmedian(across)) if np.isfinite(across).any() else np.inf
        widths.append((width, inputs[place]))
    if not widths:
        raise FitError("no table can be read: there is nothing to fit a camera to")
    narrowest = sorted(widths, key=lambda entry: entry[0])[:_FITTED]
    return [(file, read_merl(file, sampling=sampling)) for _, file in narrowest]
