"""Model-free edge response: a flexible core, a diffraction tail and glare, in closed form (docs/model.md 7).

    E(d) = P(d) + sum of c_k [B_k(d) - P(d)] + sum of o_k O_k(d)

d is the distance from the edge, and c_k and o_k are fitted coefficients. P, the pilot, is the edge response of the
best-fitting Gaussian lens and the exact pixel; the deviation of E from P is free. Lengths are in units of s, the
standard deviation of the line spread function of P, so that the same settings apply to every blur:

- core: pairs of Gaussian basis functions of the line spread function, with a standard deviation and a spacing of 0.6 s,
  up to 3.9 s on both sides. Their even combinations B_k determine the MTF, and their odd combinations O_k determine the
  asymmetry of the lens (coma). The last O_k shifts the edge.
- ghosts: three more pairs of basis functions, with a standard deviation of 0.7 s and a spacing of 0.6 s. A search
  determines their distance from the edge. They are used only if a ghost is found.
- tail: a Cauchy line spread function, which decreases as 1/d^2, as for every lens with a sharply bounded pupil.
- glare: a wide Gaussian, used only if glare is found.

The edge spread function (ESF), the line spread function (LSF) and the MTF of every term have closed forms at any
distance and frequency. The variance of the distances in a bin acts as additional blur. Therefore neither a correction
for a bin width nor a window is required.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.camera.kernel import edge_and_slopes
from matcam.core.arrays import changed, slope_along, special, xp

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray, jax

PAIRS = 7
"""Number of pairs of basis functions in the core. With a spacing of 0.6 s, their centres extend to 3.9 s on both sides."""
SPACING, GHOST_WIDTH = 0.6, 0.7
"""Spacing of neighbouring basis functions, which is also the standard deviation of those of the core, and standard deviation of
those of a ghost, in units of s."""
CENTRES = SPACING * (np.arange(PAIRS) + 0.5)
"""Centres of the basis functions of the core, in units of s."""
GHOSTS = np.arange(PAIRS, PAIRS + 3)
"""Indices of the ghost coefficients, both among the even and among the odd coefficients."""
EVEN = PAIRS + GHOSTS.size + 2
"""Number of even coefficients, which determine the MTF: those of the core, the ghosts, the tail and the glare."""
GLARE = EVEN - 1
"""Index of the glare among the even coefficients."""
ODD = PAIRS + GHOSTS.size + 1
"""Number of odd coefficients: those of the core and the ghosts, and the shift of the edge."""
FREQUENCIES = np.arange(81) / 64
"""Frequencies at which an MTF is tabulated, cycles/px."""
_TAIL = 1.5
"""Half width at half maximum of the Cauchy line spread function of the tail, in units of s."""


class EdgeSamples(NamedTuple):
    """Measured edge response of an image.

    Values are means over n bins, each with pixels at similar distances from the edge.

    Attributes:
        distance: distance from the edge (n,), px, negative on the dark side.
        value: edge response corrected for uneven light, 0 on the dark and 1 on the bright side (n,) (no unit).
        std: standard deviation of `value` (n,) (no unit).
        parametric: prediction of the parametric fit for the same bins (n,) (no unit).

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> result = matcam.edge_mtf(100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y))))
        >>> bool((np.diff(result.samples.distance) >= 0).all())
        True
    """

    distance: np.ndarray
    value: np.ndarray
    std: np.ndarray
    parametric: np.ndarray


class CoreShape(NamedTuple):
    """Parameters of the basis functions: scalars for one edge, arrays (n,) for n edges.

    Attributes:
        sigma: standard deviation of the Gaussian lens of the pilot P, px.
        angle: angle between the edge normal and the rows of the region, rad.
        half_width: half the side of the sensitive area of a pixel, px.
        radius: standard deviation of the glare, px.
        apart: distance of the centre of the nearest ghost basis function from the edge, px.
    """

    sigma: jax.Array
    angle: jax.Array
    half_width: jax.Array
    radius: jax.Array
    apart: jax.Array


class FreeCurve(NamedTuple):
    """Fitted edge response.

    Attributes:
        shape: parameters of the basis.
        coefficients: (EVEN + ODD,) even coefficients, then odd coefficients, relative to the step. The coefficients of a
            ghost or of glare are 0 if it was not found.
        levels: (SHIFT,) dark level, bright level and coefficients of the light, as in `State.linear`.
        covariance: covariance matrix of the coefficients and of ln of the glare radius in px.
    """

    shape: CoreShape
    coefficients: jax.Array
    levels: jax.Array
    covariance: jax.Array


class SampledCurve(NamedTuple):
    """Sampled values and standard deviations of a curve, two arrays of equal shape."""

    value: AnyArray
    std: AnyArray


def line_width(shape: CoreShape) -> jax.Array:
    """Compute the standard deviation s of the line spread function of the pilot, px.

    The angle of the edge is not required, because the variance of a square pixel is the same in all directions.
    """
    return xp.sqrt(shape.sigma**2 + shape.half_width**2 / 3)


def edge_basis(shape: CoreShape, distance: AnyArray, spread: AnyArray) -> tuple[jax.Array, jax.Array]:
    """Evaluate the basis as edge responses: P (n,), then the columns B_k - P and O_k (EVEN + ODD, n).

    `distance`: distances (n,) from the edge, px. `spread`: variance of the distances in each bin, px^2.
    """
    positions, width = _bumps(shape)
    blurred = xp.sqrt(shape.sigma**2 + spread)
    pilot, line, _ = edge_and_slopes(distance, shape.angle, shape.half_width, blurred)
    wide = xp.sqrt(width[:, None] ** 2 + spread)
    right, left = (special.ndtr((distance - sign * positions[:, None]) / wide) for sign in (1, -1))
    tail_width = _TAIL * line_width(shape)
    # The Cauchy function is not Gaussian, so the variance of the distances multiplies half the second derivative of the ESF.
    curvature = -2 * distance * tail_width / (xp.pi * (distance**2 + tail_width**2) ** 2)
    tail = 0.5 + xp.arctan(distance / tail_width) / xp.pi + spread / 2 * curvature
    moved = line_width(shape) * line
    even = xp.concatenate([(right + left) / 2, xp.stack([tail, glare_edge(shape.radius, distance, spread)])])
    return pilot, xp.concatenate([even - pilot, (left - right) / 2, moved[None]])


def glare_edge(radius: jax.Array, distance: AnyArray, spread: AnyArray) -> jax.Array:
    """Evaluate the edge response of Gaussian glare. `radius`, `distance`: px. `spread`: variance of the distances, px^2."""
    return special.ndtr(distance / xp.sqrt(radius**2 + spread))


def transfer_basis(shape: CoreShape, f: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Evaluate the Fourier transforms of the line spread functions of `edge_basis` at f cycles/px.

    The transforms of P and B_k are real. Those of O_k are imaginary, and their imaginary parts are returned.
    """
    positions, width = _bumps(shape)
    gauss = lambda std: xp.exp(-2 * (xp.pi * std * f) ** 2)  # noqa: E731
    box = 2 * shape.half_width * f
    pilot = gauss(shape.sigma) * xp.sinc(box * xp.cos(shape.angle)) * xp.sinc(box * xp.sin(shape.angle))
    turn, bump = 2 * xp.pi * f * positions[:, None], gauss(width[:, None])
    tail = xp.exp(-2 * xp.pi * _TAIL * line_width(shape) * xp.abs(f))
    moved = 2 * xp.pi * f * line_width(shape) * pilot
    even = xp.concatenate([bump * xp.cos(turn), xp.stack([tail, gauss(shape.radius)])])
    return pilot, xp.concatenate([even - pilot, bump * xp.sin(turn), moved[None]])


def edge_response(curve: FreeCurve, distance: AnyArray) -> SampledCurve:
    """Evaluate the edge spread function, 0 to 1, at distances (n,) from the edge, px."""
    return _combined(curve, *edge_basis(curve.shape, distance, xp.zeros(())))


def line_response(curve: FreeCurve, distance: jax.Array) -> SampledCurve:
    """Evaluate the line spread function, 1/px, at distances (n,) from the edge, px."""
    width = line_width(curve.shape)
    slopes = slope_along(lambda d: edge_basis(curve.shape, d, xp.zeros(())), distance, width)
    return _combined(curve, *(slope / width for slope in slopes))


def transfer(curve: FreeCurve, f: jax.Array) -> tuple[SampledCurve, SampledCurve]:
    """Evaluate the MTF along the normal, with and without glare.

    Noise increases the modulus of a complex number. Therefore the noise power is subtracted. `f`: frequencies, cycles/px.
    """
    pilot, columns = transfer_basis(curve.shape, f)
    is_even = (np.arange(EVEN + ODD) < EVEN)[:, None]
    even = columns * is_even
    total, odd = _combined(curve, pilot, even), _combined(curve, 0 * pilot, columns * ~is_even)
    share = curve.coefficients[GLARE]
    # The MTF without glare is (M - g M_glare) / (1 - g), where g is the share of glare.
    core_value = (total.value - share * (pilot + even[GLARE])) / (1 - share)
    core = SampledCurve(core_value, _std(curve, changed(even, GLARE, core_value - pilot) / (1 - share)))
    return _modulus(total, odd), _modulus(core, SampledCurve(odd.value / (1 - share), odd.std / (1 - share)))


class Ghost(NamedTuple):
    """Ghost of an edge: a second, weaker step on one side of the edge. The values are scalars, or arrays (n,) for n edges.

    Attributes:
        share: height of the second step relative to the step of the edge, no unit.
        std: standard deviation of `share`.
        position: distance of the ghost from the edge, px.
        bright: whether the ghost lies on the bright side.
    """

    share: np.ndarray
    std: np.ndarray
    position: np.ndarray
    bright: np.ndarray


def ghost_of(curve: FreeCurve) -> Ghost:
    """Compute the ghost of a fitted curve or of n curves.

    The share of the ghost is 0 if no ghost was found.
    """
    at = EVEN + GHOSTS
    odd = -np.asarray(curve.coefficients)[..., at]
    share, covariance = odd.sum(-1), curve.covariance[..., at[:, None], at]
    step = SPACING * line_width(curve.shape)[..., None] * np.arange(GHOSTS.size)
    weight = np.maximum(odd * np.sign(share)[..., None], 0.0)
    position = curve.shape.apart + (weight * step).sum(-1) / np.maximum(weight.sum(-1), 1e-300)
    return Ghost(np.abs(share), np.sqrt(np.maximum(covariance.sum((-1, -2)), 0.0)), position, share > 0)


def half_frequency(value: AnyArray, response: Callable[[jax.Array], SampledCurve]) -> SampledCurve:
    """Find the lowest frequency at which an MTF is one half, cycles/px.

    The interval of `FREQUENCIES` that contains the crossing is sampled more finely, and interpolated linearly. The result
    is NaN if the MTF does not fall to one half. `value`: MTF at `FREQUENCIES`. `response`: function that evaluates the MTF
    and its standard deviation at any frequency.
    """
    below = changed(value < 0.5, 0, False)
    i = xp.argmax(below)
    first, last = xp.take(FREQUENCIES, i - 1, mode="wrap"), xp.take(FREQUENCIES, i)
    # Over one tenth of an interval (1.6e-3 cycles/px), an MTF deviates from a straight line by 1e-6.
    grid = first + (last - first) * np.linspace(0, 1, 11)
    fine = response(grid)
    k = xp.argmax(changed(fine.value <= 0.5, 0, False))
    before, after, width = fine.value[k - 1], fine.value[k], grid[1] - grid[0]
    f = grid[k - 1] + width * (before - 0.5) / (before - after)
    std = (fine.std[k - 1] + fine.std[k]) / 2 / (before - after) * width
    return SampledCurve(xp.where(below.any(), f, xp.nan), xp.where(below.any(), std, xp.nan))


def _bumps(shape: CoreShape) -> tuple[AnyArray, AnyArray]:
    """Compute the centres of the basis functions on the bright side, and their standard deviations, px."""
    s = line_width(shape)
    ghosts = shape.apart + SPACING * s * xp.arange(GHOSTS.size)
    return xp.concatenate([CENTRES * s, ghosts]), np.repeat([SPACING, GHOST_WIDTH], [PAIRS, GHOSTS.size]) * s


def _combined(curve: FreeCurve, pilot: jax.Array, columns: jax.Array) -> SampledCurve:
    return SampledCurve(pilot + curve.coefficients @ columns, _std(curve, columns))


def _std(curve: FreeCurve, columns: jax.Array) -> jax.Array:
    return xp.sqrt(xp.maximum(xp.sum(columns * (curve.covariance[:-1, :-1] @ columns), 0), 0.0))


def _modulus(even: SampledCurve, odd: SampledCurve) -> SampledCurve:
    """Compute the modulus of a noisy complex number, with the noise power subtracted."""
    power = even.value**2 - even.std**2 + odd.value**2 - odd.std**2
    size = xp.sqrt(xp.maximum(power, 0.0))
    safe = xp.where(size > 0, size, 1.0)
    std = xp.hypot(even.value * even.std, odd.value * odd.std) / safe
    return SampledCurve(size, xp.where(size > even.std, std, xp.hypot(even.std, odd.std)))
