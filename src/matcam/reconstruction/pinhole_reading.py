"""Classical binning of the images, with the geometry of the joint fit."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import xarray as xr

from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.pinhole_table import PinholeTable
from matcam.reconstruction.sphere_fit import SphereFit


def pinhole_reading(pictures: Iterable[MergedPicture], fit: SphereFit, units: np.ndarray) -> xr.DataArray:
    """Bin the pixels of all images as if the camera were perfect.

    Args:
        pictures: images in the order of the fit.
        fit: fit with outline, lamps, distances and the gain of each image.
        units: unit of each channel: value per radiance under unit irradiance at the centre of the sphere.

    Returns:
        Table on the MERL grid, 1/sr; NaN in cells without pixels.
    """
    p, layout = fit.solution.p, fit.layout
    _, radius, camera, lamp = p[layout.scene]
    distance, far = (1 / nearness if nearness > 0 else np.inf for nearness in (camera, lamp))
    table = PinholeTable(fit.channels)
    for k, (picture, direction) in enumerate(zip(pictures, fit.lamps, strict=True)):
        column, row = p[layout.own(k)][:2]
        circle = float(column), float(row), float(radius)
        if fit.scene.camera.field is not None:
            # apparent outline for a perfect camera
            circle = fit.scene.camera.field.seen_circle(*circle)
        ball = MirrorBall(circle[1], circle[0], circle[2], float(distance))
        table.add(picture, ball, direction, float(far), irradiance=units * float(np.exp(p[layout.gain(k)])))
    return table.table()
