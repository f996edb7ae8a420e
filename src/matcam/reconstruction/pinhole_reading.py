"""Binning of the pixels of the images as for a perfect camera, with the geometry of the joint fit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import xarray as xr

from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.pinhole_table import PinholeTable
from matcam.files.capture_settings import Stated
from matcam.reconstruction.sphere_fit import SphereFit
from matcam.reconstruction.sphere_scene import mirror_ball


def pinhole_reading(pictures: Iterable[MergedPicture], fit: SphereFit, units: Sequence[Stated]) -> xr.DataArray:
    """Bin the pixels of all images as if the camera were perfect.

    Args:
        pictures: images in the order of the fit. Images that the fit does not contain are omitted.
        fit: fit with outline, lamps, distances and the gain of each image.
        units: unit of each channel, which is the image value per radiance under unit irradiance at the centre of the
            sphere.

    Returns:
        BRDF on the MERL grid, 1/sr; NaN in cells without pixels.
    """
    p, layout = fit.solution.p, fit.layout
    table = PinholeTable(fit.channels)
    fitted = [one for one in pictures if one.name in fit.names]
    value = np.array([unit.value for unit in units])
    for k, (picture, direction) in enumerate(zip(fitted, fit.lamps, strict=True)):
        ball, far = mirror_ball(layout, p, k)
        if fit.scene.camera.field is not None:
            # apparent outline for a perfect camera
            column, row, radius = fit.scene.camera.field.seen_circle(ball.column, ball.row, ball.radius)
            ball = MirrorBall(row, column, radius, ball.distance)
        table.add(picture, ball, direction, far, irradiance=value * float(np.exp(p[layout.gain(k)])))
    return table.table()
