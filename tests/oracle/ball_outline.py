"""Photographs of a sphere, by following rays through a grid finer than the pixels: lit by near lamps, or dark before a field.

World: x right, y up, z to the camera, origin in the sphere's centre, lengths in its radii. The camera is a pinhole whose axis
may miss the sphere; blur and pixels come after. No series, no limb, no model of an edge.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

FINE = 6


class Ball(NamedTuple):
    """centre (row, column) and radius, px, that the outline would have if the camera looked at the centre; distance, radii;
    axis: (row, column) of the camera's axis, default the centre."""

    row: float
    column: float
    radius: float
    distance: float = 1e6
    axis: tuple | None = None


def rays(ball, shape):
    """Of every fine sample: point on the sphere (h, w, 3), NaN beside it, and the ray's direction."""
    focal = ball.radius * np.sqrt(ball.distance**2 - 1)
    row0, column0 = ball.axis or (ball.row, ball.column)
    rows = (np.arange(shape[0] * FINE) + 0.5) / FINE - 0.5
    columns = (np.arange(shape[1] * FINE) + 0.5) / FINE - 0.5
    towards = np.stack(
        [*np.meshgrid((columns - column0) / focal, (row0 - rows) / focal), -np.ones((len(rows), len(columns)))], axis=-1
    )
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    centre = np.array([(ball.column - column0) / focal, (row0 - ball.row) / focal, -1.0])
    centre *= ball.distance / np.linalg.norm(centre)
    # the foot of the perpendicular keeps the digits that the distance eats
    off = towards - centre / ball.distance
    along = ball.distance * (1 - (off**2).sum(-1) / 2)
    foot = off * along[..., None] + centre * (along / ball.distance - 1)[..., None]
    left = 1 - (foot**2).sum(-1)
    with np.errstate(invalid="ignore"):
        point = foot - np.sqrt(left)[..., None] * towards
    return point, towards


def dielectric(cosine, n=1.5):
    other = np.sqrt(1 - (1 - cosine**2) / n**2)
    s, p = (cosine - n * other) / (cosine + n * other), (n * cosine - other) / (n * cosine + other)
    return (s**2 + p**2) / 2


def lit(ball, shape, lamp, *, diffuse=1.0, alpha=None, glossy=1.0, coat=False, background=0.0):
    """Radiance before the lens: a lamp at a place in radii (its length matters), Lambert, and a GGX lobe of constant F."""
    point, towards = rays(ball, shape)
    way = np.asarray(lamp, float) - point
    far = np.linalg.norm(way, axis=-1, keepdims=True)
    light, view = way / far, -towards
    cos_i, cos_o = (light * point).sum(-1), (view * point).sum(-1)
    irradiance = np.maximum(cos_i, 0) * (np.linalg.norm(lamp) / far[..., 0]) ** 2
    brdf = diffuse / np.pi * np.ones_like(cos_i)
    with np.errstate(invalid="ignore", divide="ignore"):
        if coat:
            brdf = brdf * (1 - dielectric(np.clip(cos_o, 0, 1))) * (1 - dielectric(np.clip(cos_i, 0, 1)))
        if alpha is not None:
            half = light + view
            half /= np.linalg.norm(half, axis=-1, keepdims=True)
            cos_h2 = (half * point).sum(-1) ** 2
            d = alpha**2 / np.pi / (cos_h2 * (alpha**2 - 1) + 1) ** 2
            masking = 1 + sum((np.sqrt(1 + alpha**2 * (1 / c**2 - 1)) - 1) / 2 for c in (cos_i, cos_o))
            brdf = brdf + glossy * d / masking / (4 * cos_i * cos_o)
        radiance = np.where(cos_i > 0, brdf * irradiance, 0.0)
    return np.where(np.isnan(point[..., 0]), background, radiance)


def backlit(ball, shape, *, reach=0.0, n=1.5, inside=0.01):
    """A field of radiance 1 that reaches `reach` rad beyond the limb: the sphere mirrors it at grazing incidence."""
    point, towards = rays(ball, shape)
    cosine = -(point * towards).sum(-1)
    away = 1 - 2 * cosine**2  # cosine of the angle by which the ray is turned
    mirrored = np.where(away > np.cos(reach), dielectric(np.clip(cosine, 0, 1), n), 0.0) if reach else 0.0
    return np.where(np.isnan(point[..., 0]), 1.0, inside + mirrored)


def photographed(radiance, sigma):
    """Means over square pixels, after a Gaussian lens."""
    blurred = gaussian_filter(radiance, sigma * FINE, mode="nearest", truncate=6)
    height, width = (n // FINE for n in radiance.shape)
    return blurred.reshape(height, FINE, width, FINE).mean((1, 3))


def exposed(picture, electrons, rng, read=3.0, colours=None):
    """Poisson and read noise, and the noise's standard deviation; colours: sensitivities of the first 2 x 2 pixels."""
    mean = picture * electrons
    if colours is not None:
        pattern = np.tile(colours, (picture.shape[0] // 2 + 1, picture.shape[1] // 2 + 1))
        mean = mean * pattern[: picture.shape[0], : picture.shape[1]]
    values = rng.poisson(np.maximum(mean, 0)) + rng.normal(0, read, mean.shape)
    return values, np.sqrt(np.maximum(values, 0) + read**2)
