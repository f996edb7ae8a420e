"""Edges of a sphere's limb in an image, one for each sector of azimuth, fitted with the blur of the lens.

The sphere is foreshortened near the limb. At a distance t inside a limb of radius r, both in px, the cosine of the viewing
angle is sqrt(2 t / r) to first order. The radiance of a lit sphere inside the limb is therefore a series in powers of
sqrt(t): a + b sqrt(t) + c t + ... Outside the limb, the radiance is that of the background. A dark sphere in front of a
bright field is a step. Both models are blurred by the line spread function (LSF) of lens and pixel. The coefficients and the
position of the edge are fitted to the pixels of a sector.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import erf

_STEP = 0.05  # spacing of the table of blurred powers, px
_HALF_WIDTH = 0.5  # half width of a pixel, px
_INDEX = 1.5  # refractive index of a clear coat
_TURNS = 5  # largest number of iterations
_FAR = 0.5  # px: largest change of a position in one iteration


class LimbSectors(NamedTuple):
    """Edges of a limb, one for each sector.

    Attributes:
        azimuth: azimuth of the middle of each sector, from +column towards +row, rad (n,).
        offset: distance of the edge outside the assumed curve, px (n,); NaN without an edge.
        std: standard deviation of `offset` due to noise, px (n,).
        misfit: chi squared per degree of freedom (n,).
        contrast: light above the background 2 px inside the limb, divided by the standard deviation of this light (n,).
        chi2: chi squared (n,).
        freedom: degrees of freedom of `chi2` (n,); 0 without an edge.
    """

    azimuth: np.ndarray
    offset: np.ndarray
    std: np.ndarray
    misfit: np.ndarray
    contrast: np.ndarray
    chi2: np.ndarray
    freedom: np.ndarray


class BlurredPowers:
    """Table of powers of the distance inside an edge, blurred by a Gaussian lens and a square pixel.

    Args:
        sigma: standard deviation of the lens's blur, px.
        exponents: exponents of the powers; the first must be 0, the step of light at the edge.
        coated: radius of the limb of a sphere under a clear coat, px. The radiance is multiplied by the transmittance of
            the coat. Default: None, no coat.

    Example:
        >>> powers = BlurredPowers(0.5, (0, 0.5))
        >>> powers(np.array([-3.0, 0.0, 4.0]))[0].round(3)
        array([[0.   , 0.5  , 1.   ],
               [0.   , 0.313, 1.995]])
    """

    def __init__(self, sigma: float, exponents: Sequence[float], coated: float | None = None):
        self.exponents = tuple(exponents)
        self.variance = sigma**2 + _HALF_WIDTH**2 / 3
        # largest distance inside the edge, px
        self.positions = np.arange(-8.0, 24.0, _STEP)
        end = 8 * np.sqrt(self.variance)
        root2 = np.sqrt(2) * max(sigma, 1e-3)
        nodes, weights = np.polynomial.legendre.leggauss(80)
        # u = s^2, the distance inside the edge, removes the infinite slope of the root
        t = self.positions[:, None]
        top, bottom = (np.sqrt(np.maximum(t + side, 0.0)) for side in (end, -end))
        s = bottom + (top - bottom) * (nodes + 1) / 2
        lsf = (erf((t - s**2 + _HALF_WIDTH) / root2) - erf((t - s**2 - _HALF_WIDTH) / root2)) / (4 * _HALF_WIDTH)
        lsf = lsf * 2 * s * weights * (top - bottom) / 2
        if coated is not None:
            lsf = lsf * _transmitted(np.minimum(np.sqrt(2 / coated) * s, 1.0))
        self.columns = np.array([(lsf * s ** (2 * power)).sum(1) for power in self.exponents])
        self.slopes = np.gradient(self.columns, _STEP, axis=1)

    def __call__(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Interpolate the blurred powers, (exponents, n), and their derivatives with respect to `t`, (exponents, n).

        Args:
            t: distance inside the edge, px (n,).
        """
        position = np.clip((t - self.positions[0]) / _STEP, 0, len(self.positions) - 1.001)
        low = position.astype(int)
        share = position - low
        values = self.columns[:, low] * (1 - share) + self.columns[:, low + 1] * share
        slopes = self.slopes[:, low] * (1 - share) + self.slopes[:, low + 1] * share
        return values, slopes


blurred_powers = lru_cache(maxsize=16)(BlurredPowers)
"""`BlurredPowers` from a cache, because a search uses the same table repeatedly."""


def _transmitted(cosine: np.ndarray) -> np.ndarray:
    """Compute the transmittance of glass of index 1.5 for unpolarised light from the cosine of the angle of incidence."""
    refracted = np.sqrt(1 - (1 - cosine**2) / _INDEX**2)
    across = (cosine - _INDEX * refracted) / (cosine + _INDEX * refracted)
    along = (_INDEX * cosine - refracted) / (_INDEX * cosine + refracted)
    return 1 - (across**2 + along**2) / 2


class BandPixels(NamedTuple):
    """Pixels near a limb.

    Attributes:
        inside: distance inside the assumed curve, px (n,).
        azimuth: azimuth, from +column towards +row, rad (n,).
        values: linear radiance in the unit of the image (n,).
        std: standard deviation of `values` (n,).
        channel: index of the colour (n,).
        radius: radius of the assumed curve, px, which determines the effect of curvature on the blurred edge.
    """

    inside: np.ndarray
    azimuth: np.ndarray
    values: np.ndarray
    std: np.ndarray
    channel: np.ndarray
    radius: float


def _channel_levels(pixels: BandPixels, channels: np.ndarray) -> np.ndarray:
    """Compute the step of light at the limb in the colour of each pixel, relative to the step in the first colour (n,)."""
    gain = np.ones(len(pixels.values))
    first = None
    for one in channels:
        of = pixels.channel == one
        inner, outer = of & (pixels.inside > 2), of & (pixels.inside < -2)
        if len(channels) > 1 and inner.any() and outer.any():
            step = float(np.mean(pixels.values[inner]) - np.mean(pixels.values[outer]))
            first = step if first is None else first
            gain[of] = step / first if step * first > 0 else 1.0
    return gain


def sector_edges(pixels: BandPixels, powers: BlurredPowers, count: int) -> LimbSectors:
    """Fit the edge of every sector.

    Gauss-Newton iterations determine the position of the edge. Each iteration solves for the coefficients of the radiance.

    Args:
        pixels: pixels near the limb.
        powers: powers of the light inside the limb: two for a step in front of a bright field, more for a lit sphere.
        count: number of sectors.

    Returns:
        One edge for each sector; NaN for a sector without an edge.
    """
    width = 2 * np.pi / count
    middle = (np.arange(count) + 0.5) * width
    turned = np.mod(pixels.azimuth, 2 * np.pi)
    sector = np.minimum((turned / width).astype(int), count - 1)
    channels = np.unique(pixels.channel)
    gain = _channel_levels(pixels, channels)
    powers_at = len(channels) + 1
    columns = powers_at + len(powers.columns) + 1
    number = np.bincount(sector, minlength=count)
    freedom = number - columns - 1
    # each row contains the pixels of one sector; padding has weight 0
    order = np.argsort(sector, kind="stable")
    rank = np.arange(len(order)) - np.repeat(np.cumsum(number) - number, number)

    def rows(of: np.ndarray) -> np.ndarray:
        out = np.zeros((count, max(number.max(initial=0), columns + 1)))
        out[sector[order], rank] = of[order]
        return out

    inside, values, weight = rows(pixels.inside), rows(pixels.values / gain), rows(gain / pixels.std)
    along, colour = rows((turned - middle[sector]) / width), rows(pixels.channel.astype(float))
    masks = [(colour == one) * weight for one in channels]
    target = values * weight
    # the prior bounds the coefficients of light; otherwise a limb without a step of light could be at any position
    bright = np.where(weight > 0, np.abs(values), 0.0)
    level = np.maximum(np.percentile(bright, 90, axis=1), 1e-300)
    prior = np.zeros((count, columns, columns))
    for j, exponent in enumerate(powers.exponents):
        if exponent > 0:
            # 10 times the radiance in the band: the largest coefficient of a glass sphere, in powers of
            # the cosine, is 6 times
            prior[:, powers_at + j, powers_at + j] = (pixels.radius / 2) ** -exponent / (10.0 * level)
    target = np.concatenate([target, np.zeros((count, prior.shape[1]))], axis=1)
    shift = np.zeros(count)
    for turn in range(_TURNS):
        t = inside + shift[:, None] - powers.variance / (2 * pixels.radius)
        blurred, slopes = powers(t.ravel())
        blurred, slopes = blurred.reshape(-1, *t.shape), slopes.reshape(-1, *t.shape)
        # each colour has its own background; the light of the sphere is common, up to the gains of the colours
        light = [np.minimum(t, 0.0) / 10, *blurred, blurred[0] * along]
        matrix = np.stack([*masks, *(column * weight for column in light)], axis=2)
        matrix = np.concatenate([matrix, prior], axis=1)
        scale = np.linalg.norm(matrix, axis=1)
        good = (scale > 0).all(1) & (freedom > number / 4)
        scale[scale == 0] = 1.0
        q, r = np.linalg.qr(matrix / scale[:, None])
        good &= np.abs(np.diagonal(r, axis1=1, axis2=2)).min(1) > 1e-9
        r[~good] = np.eye(r.shape[1])
        solution = np.linalg.solve(r, np.einsum("spc,sp->sc", q, target)[..., None])[..., 0] / scale
        residual = target - np.einsum("spc,sc->sp", matrix, solution)
        # derivative of the model with respect to the position of the edge, with free coefficients of light
        moved = [(t < 0) / 10, *slopes, slopes[0] * along]
        slope = weight * sum(
            c[:, None] * column for c, column in zip(solution[:, len(channels) :].T, moved, strict=True)
        )
        slope = np.concatenate([slope, np.zeros(prior.shape[:2])], axis=1)
        slope = slope - np.einsum("spc,sc->sp", q, np.einsum("spc,sp->sc", q, slope))
        power = (slope**2).sum(1)
        good &= power > 0
        move = np.where(good, (slope * residual).sum(1) / np.where(good, power, 1.0), 0.0)
        if turn == _TURNS - 1 or np.abs(move).max(initial=0.0) < 1e-3:
            break
        shift += np.clip(move, -_FAR, _FAR)
    chi2 = ((residual - slope * move[:, None]) ** 2).sum(1)
    # excess of light over the background two pixels inside the limb, divided by its standard deviation
    within = slice(powers_at, columns - 1)
    inverse = np.linalg.inv(r) / scale[:, :, None]
    at = 2.0 ** np.array(powers.exponents)
    noise = np.sqrt((np.einsum("p,spc->sc", at, inverse[:, within]) ** 2).sum(1))
    contrast = np.abs(solution[:, within] @ at) / noise
    nothing = np.where(good, 0.0, np.nan)
    return LimbSectors(
        middle,
        shift + np.clip(move, -_FAR, _FAR) + nothing,
        np.where(good, power, np.nan) ** -0.5,
        chi2 / np.where(good, freedom, np.nan),
        contrast + nothing,
        chi2 + nothing,
        np.where(good, freedom, 0),
    )
