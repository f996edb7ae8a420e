"""One camera for all materials of a run: fitted jointly to a few of them, because they were taken by one rig."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from matcam.batch.job import Options
from matcam.camera.camera import Camera
from matcam.camera.uncertainty import Provenance
from matcam.core.errors import FitError, MatcamError
from matcam.core.grid import Sampling
from matcam.exchange.inspection import lobe_widths
from matcam.files.merl import read_merl
from matcam.inverse.fit.fit_setup import candidate_fits, free_setup, likeliest
from matcam.inverse.operator.rig_axes import LENS
from matcam.rigs import Rig

FITTED, LOOKED_AT = 4, 16
"""Materials that are fitted, the narrowest lobes of those that are looked at: a lens hardly shows in a broad lobe."""
KNOWN = 0.25
"""Relative standard deviation up to which a fitted blur is used: a correction takes it for small."""


def shared_camera(rig: Rig, inputs: Sequence[Path], options: Options, sampling: Sampling) -> Camera:
    """The rig's camera, its blur as these tables say, with its variance. FitError where no table can be read, or they do not
    determine the blur to a quarter."""
    chosen = _narrowest(inputs, sampling)
    tables = [table for _, table in chosen]
    setup = free_setup(tables, rig, masking=options.masking, camera_parameters="free")
    found = likeliest(candidate_fits(setup, options.ndf))
    value, std = found.params[LENS], found.std[LENS]
    names = ", ".join(file.name for file, _ in chosen)
    camera = found.camera
    if camera is None or not std < KNOWN * value:
        raise FitError(
            f"{names} do not determine the camera's blur ({value:.3g} +- {std:.2g} px): give its profile instead (--camera), "
            "or tables with narrower lobes"
        )
    source = Provenance(
        source=f"blur fitted jointly to {names}, a {found.family} lobe for each",
        notes="; ".join(map(str, found.remarks)),
    )
    return Camera(camera.optics, camera.pixel, camera.sensor, uncertainty=camera.uncertainty, provenance=source)


def _narrowest(inputs: Sequence[Path], sampling: Sampling) -> list[tuple[Path, xr.DataArray]]:
    """Of tables spread evenly over the inputs, those whose lobes are the narrowest; what cannot be read will be said when
    its turn comes."""
    places = np.unique(np.linspace(0, max(len(inputs) - 1, 0), min(LOOKED_AT, len(inputs))).astype(int))
    widths: list[tuple[float, Path]] = []
    for place in places:
        try:
            table = read_merl(inputs[place], sampling=sampling)
        except MatcamError:
            continue
        seen = lobe_widths(table).across
        width = float(np.nanmedian(seen)) if np.isfinite(seen).any() else np.inf
        widths.append((width, inputs[place]))
    if not widths:
        raise FitError("no table can be read: there is nothing to fit a camera to")
    order = sorted(widths, key=lambda entry: entry[0])[:FITTED]
    return [(file, read_merl(file, sampling=sampling)) for _, file in order]
