"""Unit of merged values, and the light of each image, from a white patch that faces the camera.

The patch is beside the sphere, or in separate images.

A patch has reflectance R, position p (radii) and normal n. The direction of the lamp is l, its distance from the centre of
the sphere is Q (radii), and its irradiance there is E. The radiance of the patch is R/pi E g with g = n.w / |w|^3 and
w = l - p/Q (docs/model.md 10). The recorded value is U G R/pi g. U is the value per radiance under unit irradiance, and G is
the light of the image relative to the mean. The prior mean of ln G is 0, and its prior standard deviation is the specified
scatter of the lamp's light. The errors of position and tilt of the patch are common to all images. The errors of the lamp
directions are independent. The distance Q is not an unknown here, because the images of the sphere determine it better:
the result is for one value of Q, and includes its derivatives with respect to 1/Q.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.acquisition.light.picture_light import PictureLight
from matcam.acquisition.mirror_ball import MirrorBall, unit
from matcam.files.capture import Region, Stated

GRAZING = 0.2
"""Cosine of incidence below which the patch is not used, because it does not determine the light of a lamp at grazing
incidence.
"""
_STEP = 1e-5
"""Step of numerical derivatives, radii or rad."""
_UNKNOWN_DEPTH = Stated(0.0, 0.5)
"""Distance of the patch in front of the centre of the sphere, radii, if the capture does not specify it."""


class ReferencePatch(NamedTuple):
    """White patch beside the sphere.

    Attributes:
        region: first column, first row, width, height in the whole frame, px.
        reflectance: reflectance of the patch with standard deviation, no unit; None if unknown. Default: None.
        depth: distance in front of the centre of the sphere, towards the camera, with standard deviation, radii.
            Default: 0 ± 0.5.
        tilt_std: standard deviation of the angle between the normal of the patch and the camera's axis, about each of two
            axes, rad. Default: 1 degree.
    """

    region: Region
    reflectance: Stated | None = None
    depth: Stated = _UNKNOWN_DEPTH
    tilt_std: float = float(np.radians(1.0))

    def position(self, ball: MirrorBall, depth: float) -> np.ndarray:
        """Compute the position of the patch relative to the sphere, radii (3,): x right, y up, z to the camera."""
        column, row, width, height = self.region
        across = np.array([column + (width - 1) / 2 - ball.column, ball.row - row - (height - 1) / 2]) / ball.radius
        q = 1 / ball.distance
        return np.append(across * (1 - q * depth) / np.sqrt(1 - q**2), depth)


def patch_geometry(
    lamps: np.ndarray, nearness: float, position: np.ndarray, tilt: tuple[float, float] = (0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the relative irradiance of a patch, and the cosine of incidence.

    The irradiance is relative to that of a surface at the centre of the sphere that faces the lamp.

    Args:
        lamps: unit vectors from the sphere's centre, (n, 3).
        nearness: inverse distance of the lamp, 1/radii; 0 for a distant lamp.
        position: position of the patch, radii, (3,).
        tilt: x and y of the normal divided by z, no unit. Default: the patch faces the camera.

    Example:
        >>> patch_geometry(np.array([[0.0, 0.0, 1.0]]), 0.0, np.array([1.5, 0.0, 0.0]))
        (array([1.]), array([1.]))
    """
    normal = np.array([*tilt, 1.0]) / np.sqrt(1 + tilt[0] ** 2 + tilt[1] ** 2)
    way = lamps - nearness * position
    far = np.linalg.norm(way, axis=1)
    cosine = way @ normal / far
    return cosine / far**2, cosine


def patch_light(
    patch: ReferencePatch,
    light: Sequence[Sequence[Stated]],
    ball: MirrorBall,
    lamps: np.ndarray,
    lamp_nearness: float,
    *,
    lamp_std: np.ndarray,
    gain_std: float,
    exposure_std: float = 0.0,
    between: float = 0.0,
) -> PictureLight | None:
    """Estimate the light of images and the unit of their values from a patch.

    Args:
        patch: the patch.
        light: merged value of the patch in each image and channel with standard deviation; NaN if it is not usable.
        ball: the sphere, the origin of the position of the patch.
        lamps: directions to the lamps, unit vectors, (pictures, 3).
        lamp_nearness: inverse distance of the lamp, 1/radii, as exact.
        lamp_std: standard deviation of each lamp's direction along each of two tangents, rad, (pictures,).
        gain_std: specified relative scatter of the light of an image.
        exposure_std: relative standard deviation that exposure ratios add to the unit. Default: 0.
        between: standard deviation of the change of light between an image of the patch and one of the sphere,
            relative. Default: 0, one frame shows both.

    Returns:
        The light of the images, its covariance, and the units; None if the patch is not usable in any image.
    """
    value = np.array([[one.value for one in channels] for channels in light])
    std = np.array([[one.std for one in channels] for channels in light])
    count, errors = len(lamps), np.array([patch.depth.std, patch.tilt_std, patch.tilt_std])

    def log_of(lamps: np.ndarray, depth: float, right: float, up: float, nearness: float) -> np.ndarray:
        geometry, cosine = patch_geometry(lamps, nearness, patch.position(ball, depth), (right, up))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(cosine > GRAZING / 2, np.log(geometry), np.nan)

    start = np.array([patch.depth.value, 0.0, 0.0, lamp_nearness])
    _, cosine = patch_geometry(lamps, start[3], patch.position(ball, start[0]))
    used = np.isfinite(value).all(1) & (value > 3 * std).all(1) & (cosine > GRAZING)
    if not used.any():
        return None
    mean = value[used].mean(1)
    noise = np.sqrt((std[used] ** 2).sum(1)) / value.shape[1] / mean
    at = lamps[used]
    usual = log_of(at, *start)
    slopes = [(log_of(at, *(start + s)) - log_of(at, *(start - s))) / (2 * _STEP) for s in _STEP * np.eye(4)]
    own = noise**2 + between**2
    for axis in np.eye(3):  # a step along the direction itself has no effect
        own = own + (lamp_std[used] * (log_of(unit(at + _STEP * axis), *start) - usual) / _STEP) ** 2
    # unknowns: ln G of every image, the errors of the patch, ln U
    size = count + len(errors) + 1
    rows = np.zeros((used.sum(), size))
    rows[np.arange(len(rows)), np.flatnonzero(used)] = 1.0
    rows[:, count:-1] = np.column_stack(slopes[:3])
    rows[:, -1] = 1.0
    weight = 1 / np.maximum(own, 1e-12)
    prior = np.append(np.full(count, 1 / max(gain_std, 1e-5) ** 2), 1 / np.maximum(errors, 1e-9) ** 2)
    covariance = np.linalg.inv((rows.T * weight) @ rows + np.diag(np.append(prior, 0.0)))
    found = covariance @ (rows.T @ (weight * (np.log(mean) - usual)))
    by_nearness = -covariance @ (rows.T @ (weight * slopes[3]))
    units = None
    if patch.reflectance is not None and patch.reflectance.value > 0:
        share = value[used].sum(0) / value[used].mean(1).sum()
        own_noise = np.sqrt((std[used] ** 2).sum(0)) / value[used].sum(0)
        spread = covariance[-1, -1] + (patch.reflectance.std / patch.reflectance.value) ** 2 + exposure_std**2
        level = np.exp(found[-1]) * np.pi / patch.reflectance.value
        units = tuple(
            Stated(float(level * s), float(np.sqrt(spread + n**2))) for s, n in zip(share, own_noise, strict=True)
        )
    gain, among = np.exp(found[:count]), covariance[:count, :count]
    unit_by_nearness = 0.0 if units is None else float(by_nearness[-1])
    return PictureLight(gain, among, by_nearness[:count], unit_by_nearness, units)
