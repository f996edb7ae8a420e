"""The pixel: how its light-sensitive area weighs the light that falls on it (MODEL 2).

A response is separable, r(x) r(y), each factor of unit area: a flat field reads its own radiance. Separable is not
isotropic: `Camera` keeps the square a square at any angle.

Lines and edges with a Gaussian profile, seen by a square pixel at any angle: closed forms.

Seen along a direction at an angle to the grid, a square is the sum of two boxes, half widths p |cos| and p |sin|. A
Gaussian through two boxes is a second difference of H, the integral of the normal distribution function; an edge, of the
integral of H. Both are split into a polynomial for x > 0 and a remainder that dies out, so that no large numbers cancel.
Where the short box is a sliver of the Gaussian, the second difference would lose digits: its mean is then taken by
quadrature. At x = 0, where the two parts have kinks that cancel, both take the left-hand derivative.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import AnyArray, is_concrete, jax, jnp

_NARROW = 0.02  # half width / std below which differences of erf lose more digits than a series
_GAUSS4 = np.polynomial.legendre.leggauss(4)
_GAUSS48 = np.polynomial.legendre.leggauss(48)


class PixelResponse(eqx.Module):
    """One pixel's response, without the lens. (In astronomy PRF means *point* response function: not this.)"""

    half_width: eqx.AbstractVar[jax.Array]

    @abstractmethod
    def response(self, x: ArrayLike) -> jax.Array:
        """One-dimensional response at x px from the pixel's centre, 1/px; integrates to 1."""

    @abstractmethod
    def mtf(self, f: ArrayLike) -> jax.Array:
        """Fourier transform of the one-dimensional response at f cycles/px, signed."""

    @abstractmethod
    def of_gaussian(self, x: ArrayLike, std: ArrayLike) -> jax.Array:
        """What the pixel reads, x px away, of a line whose profile is a unit-area Gaussian of `std` px: 1/px."""


class BoxPixel(PixelResponse):
    """Uniform response over a square.

    half_width: half the side of the light-sensitive square, px; (0, 0.5], because pixels do not overlap. 0.5 is a
    linear fill of 100 %.
    """

    half_width: jax.Array

    def __init__(self, half_width: ArrayLike = 0.5):
        self.half_width = _checked_half_width(half_width)

    def response(self, x: ArrayLike) -> jax.Array:
        """1 / (2 half_width) inside, 0 outside."""
        return jnp.where(jnp.abs(checks.number("x", x)) <= self.half_width, 0.5 / self.half_width, 0.0)

    def mtf(self, f: ArrayLike) -> jax.Array:
        """sin(2 pi half_width f) / (2 pi half_width f)."""
        return jnp.sinc(2 * self.half_width * checks.number("f", f))

    def of_gaussian(self, x: ArrayLike, std: ArrayLike) -> jax.Array:
        """[erf((x + p) / (sqrt2 std)) - erf((x - p) / (sqrt2 std))] / (4 p), p = half_width (MODEL 2)."""
        return gaussian_over_interval(jnp.asarray(x), self.half_width, jnp.asarray(std))

    def __repr__(self) -> str:
        return f"BoxPixel(half_width={self.half_width!s})"


class WindowedGaussianPixel(PixelResponse):
    """Response that falls off from the pixel's centre: a Gaussian cut off at the pixel's border, of unit area.

    sigma: standard deviation of the uncut Gaussian, px, positive. half_width: where it is cut, px, (0, 0.5].
    """

    sigma: jax.Array
    half_width: jax.Array

    def __init__(self, sigma: ArrayLike, half_width: ArrayLike = 0.5):
        self.sigma = checks.scalar("sigma", checks.positive("sigma", sigma, "px"))
        self.half_width = _checked_half_width(half_width)

    def response(self, x: ArrayLike) -> jax.Array:
        """exp(-x^2 / (2 sigma^2)) inside, scaled to unit area; 0 outside."""
        x = checks.number("x", x)
        inside = jax.scipy.stats.norm.pdf(x, scale=self.sigma) / self._kept
        return jnp.where(jnp.abs(x) <= self.half_width, inside, 0.0)

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Fourier transform by 48 Gauss-Legendre nodes: rounding to |f| half_width = 12 cycles, 1e-9 to 14."""
        nodes, weights = (jnp.asarray(a) for a in _GAUSS48)
        t = self.half_width * nodes
        weight = self.half_width * weights * self.response(t)
        return jnp.cos(2 * jnp.pi * checks.number("f", f)[..., None] * t) @ weight

    def of_gaussian(self, x: ArrayLike, std: ArrayLike) -> jax.Array:
        """Product of two Gaussians, completed to one, over the window."""
        x, std = jnp.abs(jnp.asarray(x)), jnp.asarray(std)  # even; on this side the difference keeps its digits
        total = jnp.hypot(std, self.sigma)
        centre = x * (self.sigma / total) ** 2
        width = self.sigma * std / total
        inside = jax.scipy.special.ndtr((self.half_width - centre) / width)
        inside -= jax.scipy.special.ndtr((-self.half_width - centre) / width)
        return jax.scipy.stats.norm.pdf(x, scale=total) * inside / self._kept

    @property
    def _kept(self) -> jax.Array:
        """Share of the uncut Gaussian inside the window."""
        return jax.scipy.special.erf(self.half_width / (jnp.sqrt(2) * self.sigma))

    def __repr__(self) -> str:
        return f"WindowedGaussianPixel(sigma={self.sigma!s}, half_width={self.half_width!s})"


def gaussian_over_interval(x: jax.Array, half_width: ArrayLike, std: jax.Array) -> jax.Array:
    """Mean over [x - half_width, x + half_width] of a unit-area Gaussian of `std`; 14 digits for any ratio of the two."""
    x = jnp.where(x < 0, -x, x)  # even; in the right tail the difference keeps its digits
    ratio = half_width / std
    wide = ratio > _NARROW
    if jnp.ndim(ratio):
        return jnp.where(wide, _by_difference(x, jnp.where(wide, half_width, std), std), _by_series(x, ratio, std))
    if is_concrete(ratio):
        return _by_difference(x, half_width, std) if wide else _by_series(x, ratio, std)
    return jax.lax.cond(
        wide,
        lambda: _by_difference(x, jnp.where(wide, half_width, std), std),
        lambda: _by_series(x, ratio, std),
    )


def _by_difference(x: jax.Array, half_width: ArrayLike, std: jax.Array) -> jax.Array:
    unit = jnp.sqrt(2) * std
    ends = (jax.scipy.special.erfc((x + side * half_width) / unit) for side in (-1, 1))
    return (next(ends) - next(ends)) / (4 * half_width)


def _by_series(x: jax.Array, ratio: AnyArray, std: jax.Array) -> jax.Array:
    # Taylor's series of the mean about x, in Hermite polynomials: the next term is ratio^8 / 9! He8
    z2, r2 = (x / std) ** 2, ratio**2
    series = 1 + r2 * ((z2 - 1) / 6 + r2 * (((z2 - 6) * z2 + 3) / 120 + r2 * (((z2 - 15) * z2 + 45) * z2 - 15) / 5040))
    return jnp.exp(-z2 / 2) / (jnp.sqrt(2 * jnp.pi) * std) * series


def mean_over_interval(function: Callable[[jax.Array], jax.Array], x: jax.Array, half_width: jax.Array) -> jax.Array:
    """Mean of a function over [x - half_width, x + half_width], by 4 Gauss-Legendre nodes on a trailing axis: for
    functions that hardly bend over the interval."""
    nodes, weights = (jnp.asarray(a) for a in _GAUSS4)
    return function(x[..., None] + half_width[..., None] * nodes) @ (weights / 2)


def _checked_half_width(half_width: ArrayLike) -> jax.Array:
    unit = "px (a pixel is no wider than the pitch)"
    return checks.scalar("half_width", checks.within("half_width", half_width, 0, 0.5, unit, open_low=True))


_SLIVER = 0.05  # short half width / std
_THINNEST = 1e-3  # px, short half width in `edge_and_slopes`: 2e-7 px^2 of blur too much, no digits lost


def line(x: jax.Array, angle: jax.Array, half_width: jax.Array, std: jax.Array) -> jax.Array:
    """What the pixel reads of a line whose profile is a unit-area Gaussian, x px away, normal at `angle`; 1/px."""
    long, sliver, short = _boxes(angle, half_width, std)
    safe = jnp.where(sliver, std, short)  # the branch not taken must not divide by 0, nor its gradient
    polynomial = _polynomial_difference(lambda u: jnp.where(u > 0, u, 0), x, long, safe, far=0.0)
    remainder = _second_difference(lambda u: _first_remainder(u, std), x, long, safe)
    closed = (polynomial + remainder) / (4 * long * safe)
    by_sliver = mean_over_interval(lambda u: gaussian_over_interval(u, long[..., None], std), x, short)
    return jnp.where(sliver, by_sliver, closed)


def edge(x: jax.Array, angle: jax.Array, half_width: jax.Array, std: jax.Array) -> jax.Array:
    """What the pixel reads x px inside the bright side of a Gaussian-blurred 0-1 edge."""
    long, sliver, short = _boxes(angle, half_width, std)
    safe = jnp.where(sliver, std, short)
    polynomial = _polynomial_difference(lambda u: jnp.where(u > 0, (u**2 + std**2) / 2, 0), x, long, safe, far=1.0)
    remainder = _second_difference(lambda u: _second_remainder(u, std), x, long, safe)
    closed = (polynomial + remainder) / (4 * long * safe)

    def box_edge(u: jax.Array) -> jax.Array:
        wide = long[..., None]
        upper, lower = u + wide, u - wide
        ramp = jnp.where(upper > 0, upper, 0) - jnp.where(lower > 0, lower, 0)
        # to the right of the whole box the difference is its width, exactly
        ramp = jnp.where(lower > 0, 2 * wide, ramp)
        return (ramp + _first_remainder(upper, std) - _first_remainder(lower, std)) / (2 * wide)

    return jnp.where(sliver, mean_over_interval(box_edge, x, short), closed)


def _boxes(angle: jax.Array, half_width: jax.Array, std: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Long box, whether the short one is a sliver, short box."""
    a, b = half_width * jnp.abs(jnp.cos(angle)), half_width * jnp.abs(jnp.sin(angle))
    long, short = jnp.maximum(a, b), jnp.minimum(a, b)
    return long, short < _SLIVER * std, short


def _second_difference(
    function: Callable[[jax.Array], jax.Array], x: jax.Array, long: jax.Array, short: jax.Array
) -> jax.Array:
    return (
        function(x + long + short)
        - function(x + long - short)
        - function(x - long + short)
        + function(x - long - short)
    )


def _polynomial_difference(
    function: Callable[[jax.Array], jax.Array], x: jax.Array, long: jax.Array, short: jax.Array, far: float
) -> jax.Array:
    """Second difference of a function that is 0 for x < 0; beyond the boxes it is 0 or far * 4 long short, exactly."""
    reach = long + short
    inside = jnp.abs(x) < reach
    near = _second_difference(function, jnp.where(inside, x, 0.0), long, short)
    return jnp.where(inside, near, jnp.where(x > 0, far * 4 * long * short, 0.0))


def _first_remainder(x: jax.Array, std: jax.Array) -> jax.Array:
    """H(x), the integral of the normal distribution function from -infinity to x, less max(x, 0)."""
    t = jnp.where(x > 0, x, -x) / std
    return std * (jax.scipy.stats.norm.pdf(t) - t * jax.scipy.special.ndtr(-t))


def _second_remainder(x: jax.Array, std: jax.Array) -> jax.Array:
    """The integral of H, less (x^2 + std^2) / 2 where x > 0."""
    t = jnp.where(x > 0, x, -x) / std
    tail = std**2 / 2 * ((t**2 + 1) * jax.scipy.special.ndtr(-t) - t * jax.scipy.stats.norm.pdf(t))
    return jnp.where(x > 0, -tail, tail)


def edge_and_slopes(
    x: jax.Array, angle: jax.Array, half_width: jax.Array, std: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """`edge`, and its derivatives by x and by std, for the price of one: for fits, which need all three again and again.

    The plain second difference, good to 1e-9 of the step up to 100 px: H solves the heat equation, so all three are made
    of one normal distribution function and one density per corner of the square.
    """
    long, _, short = _boxes(angle, half_width, std)
    short = jnp.where(short > _THINNEST, short, _THINNEST)
    sums = [jnp.zeros(()), jnp.zeros(()), jnp.zeros(())]
    for corner, sign in ((long + short, 1), (long - short, -1), (short - long, -1), (-long - short, 1)):
        t = (x + corner) / std
        phi = jnp.exp(-(t**2) / 2) / jnp.sqrt(2 * jnp.pi)
        below = (1 + jax.scipy.special.erf(t / jnp.sqrt(2.0))) / 2
        parts = (std**2 / 2 * ((t**2 + 1) * below + t * phi), std * (t * below + phi), std * below)
        sums = [total + sign * part for total, part in zip(sums, parts, strict=True)]
    area = 4 * long * short
    return sums[0] / area, sums[1] / area, sums[2] / area
