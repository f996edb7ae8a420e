"""A grid of dots: the point spread function at every dot, how it varies over the field, and the MTF that it means.

Each dot is fitted as disc x Gaussian x square pixel (place, content, ground, sigma); its size comes from the lattice that all
dots form, so that the print's scale in the picture needs not be known. What the dots of a zone have in common beyond that, as
far as second and fourth derivatives see it, makes the zone's MTF, which then is no longer that of a Gaussian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.chart.chart import Dots
from matcam.calibration.chart.registration import Projection, check_projection_given
from matcam.calibration.photograph import region
from matcam.calibration.photograph.linear_image import LinearImage, region_of
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.targets import dot_lattice
from matcam.calibration.targets.dot_fit import SHARED, DotFit, fit_dots
from matcam.calibration.targets.dot_lattice import FEWEST, Lattice
from matcam.calibration.targets.mtf_samples import MTFSamples
from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError
from matcam.core.jax import FloatArray
from matcam.files.photographs import Photograph

_REACH = 8  # px around a dot
_ZONE = 60  # dots that a zone should have at least
_FIELD = 6  # terms of the variance over the field, of second order
_FREQUENCY = np.array([0.2, 0.2, 0.4, 0.4, 0.4])
_DIRECTION = np.radians([0.0, 90.0, 0.0, 90.0, 45.0])


@dataclass(frozen=True, eq=False)
class DotGrid:
    """What a grid of n dots says."""

    x: FloatArray
    y: FloatArray
    """(n,) px in the picture."""
    sigma: FloatArray
    """(n,) px: of the lens as a Gaussian behind a pixel of the stated half width."""
    sigma_std: FloatArray
    samples: tuple[MTFSamples, ...]
    """The MTF of lens and pixel in zones of the field, free of the Gaussian."""
    field: FloatArray
    """(6,) of sigma^2 over u, v: 1, u, v, u^2, u v, v^2; u, v = px from the grid's middle over its half width."""
    field_covariance: FloatArray
    middle: tuple[float, float]
    half: float
    radius: float
    """px, mean of the dots' radii as they should be in the picture."""
    gain: float
    read_variance: float
    """Noise as found: a pixel's variance is gain * value + read_variance."""

    def sigma_at(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """sigma and its standard deviation, px, at places of the picture, px: by the smooth field."""
        terms = _terms(
            (np.asarray(x, float) - self.middle[0]) / self.half, (np.asarray(y, float) - self.middle[1]) / self.half
        )
        square = np.maximum(terms @ self.field, 1e-6)
        variance = ((terms @ self.field_covariance) * terms).sum(-1)
        return np.sqrt(square), np.sqrt(np.maximum(variance, 0) / square) / 2


def dot_grid(
    image: ArrayLike | Photograph | LinearImage,
    roi: Sequence[int] | None = None,
    *,
    dots: Dots | None = None,
    projection: Projection | None = None,
    radius: float | None = None,
    half_width: float = 0.5,
    cfa: str | None = None,
    channel: str | None = None,
    tone: Tone = "linear",
    aperture: float | None = None,
    source: str = "",
) -> DotGrid:
    """PSF and MTF of a camera over the field, from a square grid of round dots, dark or bright (MODEL 7).

    image, roi, cfa, channel, tone: as for `edge_mtf`; the region holds nothing but the grid. dots, projection: a chart's
    dots and where the page's points lie in the picture, both or neither; they replace roi and radius. radius: of the dots
    over their pitch. half_width: of the pixel's sensitive area, px, (0, 0.5]: sigma depends on it, the MTF does not.

    Raises ArgumentError, and FitError where there is no grid that can be measured.
    """
    check_projection_given("dots", dots, projection)
    half_width = float(
        checks.scalar("half_width", checks.within("half_width", half_width, 0, 0.5, "px", open_low=True))
    )
    if dots is not None and projection is not None:
        picture, lattice = _as_printed(LinearImage.of(image, channel, cfa, tone), dots, projection)
        size = dots.radius
    else:
        if radius is None:
            raise ArgumentError(
                "radius of the dots over their pitch must be given: the blur cannot be told from their size"
            )
        size = float(checks.scalar("radius", checks.within("radius", radius, 0, 0.5, open_low=True, open_high=True)))
        picture = region_of(image, roi, channel=channel, cfa=cfa, tone=tone)
        if problem := region.flaw(picture.values):
            raise FitError(problem)
        lattice = dot_lattice.lattice_of(*dot_lattice.find_dots(picture.values))
    fit = fit_dots(picture.values, lattice, size, half_width)
    aperture = picture.f_number if aperture is None else aperture
    return _result(fit, picture.corner, half_width, picture.channel, aperture, source or picture.source)


def _as_printed(whole: LinearImage, dots: Dots, projection: Projection) -> tuple[LinearImage, Lattice]:
    """The grid's region, and its dots where the registration expects them."""
    printed = np.array(dots.centres)
    seen = projection(printed)
    inside = (seen > 2).all(1) & (seen < np.array(whole.shape[1::-1]) - 3).all(1)
    if inside.sum() < FEWEST:
        raise FitError("the grid of dots lies outside the picture")
    printed, seen = printed[inside], seen[inside]
    low = np.maximum(np.floor(seen.min(0)).astype(int) - _REACH, 0)
    high = np.minimum(np.ceil(seen.max(0)).astype(int) + _REACH + 1, whole.shape[1::-1])
    box = (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
    u, v = printed.T
    return region_of(whole, box), Lattice(seen[:, 0] - low[0], seen[:, 1] - low[1], u, v)


def _terms(u: FloatArray, v: FloatArray) -> FloatArray:
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)


def _result(
    fit: DotFit, corner: tuple[int, int], half_width: float, channel: str, aperture: float | None, source: str
) -> DotGrid:  # fmt: skip
    x, y, square = fit.parameters[:, 4] + corner[0], fit.parameters[:, 5] + corner[1], fit.parameters[:, 6]
    middle = (float((x.min() + x.max()) / 2), float((y.min() + y.max()) / 2))
    half = float(max(np.ptp(x), np.ptp(y)) / 2)
    terms = _terms((x - middle[0]) / half, (y - middle[1]) / half)
    terms = terms[:, : _FIELD if len(x) >= 4 * _FIELD else 1]
    # errors of like dots are alike: a dot's own, from its own noise, would favour those that look sharp by chance
    weight = 1 / np.median(fit.std[:, 6]) ** 2
    inverse = np.linalg.inv(terms.T @ terms * weight)
    found, covariance = np.zeros(_FIELD), np.zeros((_FIELD, _FIELD))
    found[: terms.shape[1]] = inverse @ (terms.T @ (weight * square))
    covariance[: terms.shape[1], : terms.shape[1]] = inverse
    across = int(max(1, min(3, np.sqrt(len(x) / _ZONE))))
    edges = [np.quantile(a, np.linspace(0, 1, across + 1)[1:-1]) for a in (x, y)]
    zone = np.searchsorted(edges[0], x) + across * np.searchsorted(edges[1], y)
    samples = tuple(
        _samples(
            fit,
            zone == k,
            (float(x[zone == k].mean()), float(y[zone == k].mean())),
            half_width,
            channel,
            aperture,
            source,
        )
        for k in range(across * across)
        if (zone == k).sum() >= FEWEST
    )
    sigma = np.sqrt(square)
    return DotGrid(
        x,
        y,
        sigma,
        fit.std[:, 6] / (2 * sigma),
        samples,
        found,
        covariance,
        middle,
        half,
        fit.radius,
        fit.gain,
        fit.read,
    )


def _samples(
    fit: DotFit,
    zone: FloatArray,
    place: tuple[float, float],
    half_width: float,
    channel: str,
    aperture: float | None,
    source: str,
) -> MTFSamples:
    """A zone's MTF: that of its mean Gaussian, times 1 + a polynomial of the frequencies, which its dots share."""
    own = fit.design[zone][:, :, :6]
    weight, shared = fit.weight[zone], fit.shared[zone]
    pilot = fit.parameters[zone, 6]
    mean = float(np.mean(pilot))
    # about one sigma for all: what a dot's own adds to it is taken back, to first order
    residual = fit.residual[zone] + fit.design[zone][:, :, 6] * (pilot - mean)[:, None]
    a = np.einsum("npi,np,npj->nij", own, weight, own)
    b = np.einsum("npi,np,npj->nij", own, weight, shared)
    r = np.einsum("npi,np->ni", own, weight * residual)
    solved = np.linalg.solve(a, np.concatenate([b, r[..., None]], axis=2))
    normal = (np.einsum("npi,np,npj->nij", shared, weight, shared) - b.transpose(0, 2, 1) @ solved[:, :, :5]).sum(0)
    right = (np.einsum("npi,np->ni", shared, weight * residual) - np.einsum("nji,nj->ni", b, solved[:, :, 5])).sum(0)
    covariance = np.linalg.inv(normal)
    found = covariance @ right
    wx, wy = (2 * np.pi * _FREQUENCY * t for t in (np.cos(_DIRECTION), np.sin(_DIRECTION)))
    turned = np.stack([(1 if (i + j) % 4 == 0 else -1) * wx**i * wy**j for i, j in SHARED], axis=-1)
    box = np.sinc(half_width * wx / np.pi) * np.sinc(half_width * wy / np.pi)
    gaussian = np.exp(-mean * (wx**2 + wy**2) / 2) * box
    rows = gaussian[:, None] * turned
    covariance = rows @ covariance @ rows.T
    return MTFSamples(
        "dots",
        place,
        _FREQUENCY,
        _DIRECTION,
        gaussian + rows @ found,
        (covariance + covariance.T) / 2,
        channel,
        aperture,
        source,
    )
