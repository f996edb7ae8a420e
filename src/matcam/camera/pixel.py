"""Pixel: sensitivity over its area (docs/model.md 2).

A response is separable, r(x) r(y). Each factor integrates to 1, so the value of a pixel in a field of uniform radiance is
that radiance. A separable response need not be isotropic: the response of a square pixel depends on the direction, which
`Camera` takes into account.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from matcam.core import checks
from matcam.core.arrays import is_concrete, special, xp
from matcam.core.arrays.elementary import erfc
from matcam.core.arrays.module import Module
from matcam.numerics.normal import normal_density

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import AnyArray, jax

PIXELS_SHARE = 0.3
"""Standard deviation of the blur that a pixel adds to the image of a disc, divided by the half width of the pixel.

It is below the 0.58 of a box, because the border of the disc is a step in a sharp image.
"""
_GAUSS4 = np.polynomial.legendre.leggauss(4)
_GAUSS48 = np.polynomial.legendre.leggauss(48)


class PixelResponse(Module):
    """Sensitivity of one pixel over its area, without the lens.

    The pixel response function differs from the *point* response function (PRF) of astronomy, which includes the lens.

    Attributes:
        profile_fields: attribute for each field in a camera profile, such as {"half_width_px": "half_width"}. The
            fields are in the order of the constructor's arguments.
    """

    if TYPE_CHECKING:
        half_width: jax.Array
    profile_fields: ClassVar[Mapping[str, str]]

    @abstractmethod
    def response(self, x: ArrayLike) -> jax.Array:
        """Compute the one-dimensional response of the pixel, 1/px, without the lens.

        The two-dimensional response is response(x) response(y), 1/px^2. Each factor integrates to 1.

        Args:
            x: distance from the centre of the pixel, px, any shape.

        Raises:
            ArgumentError: x is not finite.
        """

    @abstractmethod
    def mtf(self, f: ArrayLike) -> jax.Array:
        """Compute the signed transfer function of the pixel along a row, without the lens.

        Args:
            f: frequency, cycles/px, any shape.

        Raises:
            ArgumentError: f is not finite.
        """

    @abstractmethod
    def of_gaussian(self, x: ArrayLike, std: ArrayLike) -> jax.Array:
        """Compute the value of a pixel for a Gaussian line profile, 1/px.

        The area of the profile is 1.

        Args:
            x: distance of the line from the centre of the pixel, px.
            std: standard deviation of the profile, px, positive; broadcasts with x.
        """

    @abstractmethod
    def until_gaussian(self, x: ArrayLike, std: ArrayLike) -> jax.Array:
        """Integrate `of_gaussian` up to x, no unit.

        The integral begins at minus infinity, and its value lies between 0 and 1. The difference of the integrals up to
        two positions is the value of the pixel for a uniform strip of radiance 1. The strip extends between these
        positions and is blurred by the Gaussian.

        Args:
            x: end of the integral, relative to the centre of the pixel, px.
            std: standard deviation of the Gaussian, px, positive; broadcasts with x.
        """


class BoxPixel(PixelResponse):
    """Ideal square pixel of uniform sensitivity.

    Args:
        half_width: half the side of the light-sensitive square, px, (0, 0.5], because pixels do not overlap.
            Default: 0.5, a linear fill factor of 100 %. Use less for known gaps between pixels.

    Raises:
        ArgumentError: the half width is out of range, or not a single number.

    Source:
        Holzschuch & Pacanowski (2017), section 3 (their sigma_p is the half width).

    Example:
        >>> pixel = matcam.BoxPixel()
        >>> float(pixel.response(0.2)), float(pixel.response(0.7))
        (1.0, 0.0)
    """

    half_width: jax.Array

    profile_fields = MappingProxyType({"half_width_px": "half_width"})

    def __init__(self, half_width: ArrayLike = 0.5):
        self.half_width = _checked_half_width(half_width)

    def response(self, x: ArrayLike) -> jax.Array:
        """Compute the response, 1/px: 1 / (2 half_width) inside, 0 outside."""
        return xp.where(xp.abs(checks.number("x", x)) <= self.half_width, 0.5 / self.half_width, 0.0)

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Compute the signed transfer function of the box, without the lens.

        It is sin(2 pi half_width f) / (2 pi half_width f). It first changes sign at f = 1 / (2 half_width), cycles/px.
        """
        return xp.sinc(2 * self.half_width * checks.number("f", f))

    def of_gaussian(self, x: ArrayLike, std: ArrayLike) -> jax.Array:
        """Compute the value of a pixel for a Gaussian line profile, 1/px.

        It is [erf((x + p) / (sqrt(2) std)) - erf((x - p) / (sqrt(2) std))] / (4 p), where p = half_width (docs/model.md
        2).
        """
        return gaussian_over_interval(xp.asarray(x), self.half_width, xp.asarray(std))

    def until_gaussian(self, x: ArrayLike, std: ArrayLike) -> jax.Array:
        """Integrate `of_gaussian` up to x, no unit.

        The integral is [g((x + p) / std) - g((x - p) / std)] std / (2 p), where p = half_width and g(z) = z Phi(z) + phi(z).
        Phi and phi are the distribution function and the density of the standard normal distribution.
        """
        ends = ((xp.asarray(x) + side * self.half_width) / std for side in (1, -1))
        above, below = (z * _normal_until(z) + xp.exp(-(z**2) / 2) / np.sqrt(2 * np.pi) for z in ends)
        return (above - below) * std / (2 * self.half_width)


class WindowedGaussianPixel(PixelResponse):
    """Pixel with a Gaussian sensitivity, truncated at its border.

    The response decreases from the centre, as under a microlens, and has unit area.

    Args:
        sigma: standard deviation of the Gaussian before truncation, px, 1e-12 to 1e6.
        half_width: distance from the centre at which the Gaussian is truncated, px, (0, 0.5]. Default: 0.5, the border
            of the pixel.

    Raises:
        ArgumentError: a parameter is out of range, or not a single number.

    Source:
        docs/model.md 2.

    Example:
        >>> pixel = matcam.WindowedGaussianPixel(0.3)
        >>> float(pixel.response(0.0)) > 1 > float(pixel.response(0.45)) > 0
        True
    """

    sigma: jax.Array
    half_width: jax.Array

    profile_fields = MappingProxyType({"sigma_px": "sigma", "half_width_px": "half_width"})

    def __init__(self, sigma: ArrayLike, half_width: ArrayLike = 0.5):
        checks.positive("sigma", sigma, "px")
        # the response is a point at the lower limit of sigma, and a box at the upper limit
        self.sigma = checks.scalar("sigma", checks.within("sigma", sigma, 1e-12, 1e6, "px"))
        self.half_width = _checked_half_width(half_width)

    def response(self, x: ArrayLike) -> jax.Array:
        """Compute the truncated Gaussian of unit area, 1/px; 0 outside the window."""
        x = checks.number("x", x)
        inside = normal_density(x, self.sigma) / self._share_inside
        return xp.where(xp.abs(x) <= self.half_width, inside, 0.0)

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Compute the signed transfer function along a row, without the lens.

        It is the Fourier transform of the response, computed with 48 Gauss-Legendre nodes. The error is at the level of
        rounding for |f| half_width <= 12 cycles, and below 1e-9 for |f| half_width <= 14 cycles. If half_width exceeds
        8 sigma, truncation is negligible, and the transfer function of the Gaussian is used.
        """
        nodes, weights = (xp.asarray(a) for a in _GAUSS48)
        t = self.half_width * nodes
        weight = self.half_width * weights * self.response(t)
        f = checks.number("f", f)
        # a response too narrow for the nodes requires no truncation: its share beyond eight sigma is 1e-15
        uncut = xp.exp(-2 * xp.square(xp.pi * self.sigma * f))
        return xp.where(self.half_width > 8 * self.sigma, uncut, xp.cos(2 * xp.pi * f[..., None] * t) @ weight)

    def of_gaussian(self, x: ArrayLike, std: ArrayLike) -> jax.Array:
        """Compute the value of a pixel for a Gaussian line profile, 1/px.

        It is the integral of response times line profile over the window. The product of two Gaussians is a Gaussian, so
        the integral has a closed form.
        """
        x, std = xp.abs(xp.asarray(x)), xp.asarray(std)  # symmetric; for x > 0 the difference loses no digits
        total = xp.hypot(std, self.sigma)
        centre = x * (self.sigma / total) ** 2
        width = self.sigma * std / total
        inside = _normal_until((self.half_width - centre) / width)
        inside -= _normal_until((-self.half_width - centre) / width)
        return normal_density(x, total) * inside / self._share_inside

    def until_gaussian(self, x: ArrayLike, std: ArrayLike) -> jax.Array:
        """Integrate `of_gaussian` up to x, no unit.

        The average over the window uses 48 Gauss-Legendre nodes, or a closed form if half_width exceeds 8 sigma.
        """
        nodes, weights = (xp.asarray(a) for a in _GAUSS48)
        at = self.half_width * nodes
        share = self.half_width * weights * self.response(at)
        x, std = xp.asarray(x), xp.asarray(std)
        cut = sum((w * _normal_until((x - a) / std) for a, w in zip(at, share, strict=True)), xp.zeros(()))
        uncut = _normal_until(x / xp.hypot(std, self.sigma))  # too narrow for the nodes
        return xp.where(self.half_width > 8 * self.sigma, uncut, cut)

    @property
    def _share_inside(self) -> jax.Array:
        return special.erf(self.half_width / (xp.sqrt(2) * self.sigma))


def _normal_until(z: jax.Array) -> jax.Array:
    """Evaluate the standard normal distribution function. This is faster than `ndtr`."""
    return erfc(-z / np.sqrt(2)) / 2


def gaussian_over_interval(x: jax.Array, half_width: ArrayLike, std: jax.Array) -> jax.Array:
    """Average a Gaussian of unit area over [x - half_width, x + half_width], 1/px.

    The result has 14 accurate digits for any std. All arguments are in px.
    """
    x = xp.where(x < 0, -x, x)  # symmetric; in the right tail the difference loses no digits
    ratio = half_width / std
    wide = ratio > 0.02

    def mixed() -> jax.Array:
        # for half widths below 0.02 standard deviations, a series is more accurate than differences of erf
        return xp.where(wide, _by_difference(x, xp.where(wide, half_width, std), std), _by_series(x, ratio, std))

    if is_concrete(wide):
        return _by_difference(x, half_width, std) if np.all(wide) else mixed()
    from matcam.core.jax import jax

    return jax.lax.cond(xp.all(wide), lambda: _by_difference(x, half_width, std), mixed)


def _by_difference(x: jax.Array, half_width: ArrayLike, std: jax.Array) -> jax.Array:
    per_unit = 1 / (xp.sqrt(2) * std)
    ends = (erfc((x + side * half_width) * per_unit) for side in (-1, 1))
    return (next(ends) - next(ends)) * (0.25 / half_width)


def _by_series(x: jax.Array, ratio: AnyArray, std: jax.Array) -> jax.Array:
    # Taylor series of the mean about x, in Hermite polynomials; the next term is ratio^8 / 9! He8
    # beyond 100 standard deviations a Gaussian underflows to 0
    z2, r2 = xp.minimum(xp.square(xp.divide(x, std)), 1e4), ratio**2
    series = 1 + r2 * ((z2 - 1) / 6 + r2 * (((z2 - 6) * z2 + 3) / 120 + r2 * (((z2 - 15) * z2 + 45) * z2 - 15) / 5040))
    return xp.exp(-z2 / 2) / (xp.sqrt(2 * xp.pi) * std) * series


def mean_over_interval(function: Callable[[jax.Array], jax.Array], x: jax.Array, half_width: jax.Array) -> jax.Array:
    """Average a function over an interval with 4 Gauss-Legendre nodes.

    The interval is [x - half_width, x + half_width]. The argument of `function` has a last axis for the nodes. The function
    must be nearly a polynomial of degree 7 over the interval.
    """
    nodes, weights = (xp.asarray(a) for a in _GAUSS4)
    return function(x[..., None] + half_width[..., None] * nodes) @ (weights / 2)


def _checked_half_width(half_width: ArrayLike) -> jax.Array:
    unit = "px (a pixel is no wider than the pitch)"
    return checks.scalar("half_width", checks.within("half_width", half_width, 0, 0.5, unit, open_low=True))
