"""The edge response without a model: a free core, a diffraction tail and glare, as closed forms (docs/model.md 7).

    E(d) = P(d) + sum of c_k [B_k(d) - P(d)] + sum of o_k O_k(d)

P is the best Gaussian lens through the exact pixel; its deviation from the edge is free. Lengths are in units of s, the
standard deviation of P's line spread function, so that one setting serves every blur:

- core: pairs of Gaussian bumps of the line spread function, 0.6 s wide and 0.6 s apart, to 3.9 s on both sides. Their even
  combinations B_k carry the MTF, their odd ones O_k a lens that is not symmetric (coma). The last O_k moves the edge.
- ghosts: three more pairs of bumps, 0.7 s wide and 0.6 s apart, at a distance that is found, used where there is one;
- tail: a Cauchy line spread function, which falls as 1/d^2 as that of every lens with an edge to its pupil does;
- glare: a wide Gaussian, used where it is found.

All are Gaussian or rational, so that ESF, LSF and MTF are closed forms at any distance and frequency, and the spread of
a cell's distances is one more blur. Neither bins nor windows are used.
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
PLACES = 0.6 * (np.arange(PAIRS) + 0.5)
"""Places of the bumps, in s."""
GHOSTS = np.arange(PAIRS, PAIRS + 3)
"""Indices of the ghosts' strengths, among the even ones and the odd ones."""
GHOST_STEP, GHOST_WIDTH = 0.6, 0.7
"""Distance and width of the ghosts' bumps, in s."""
EVEN = PAIRS + GHOSTS.size + 2
"""Strengths that shape the MTF: the core's, the ghosts', the tail's, the glare's."""
GLARE = EVEN - 1
"""Index of the glare in the even strengths."""
ODD = PAIRS + GHOSTS.size + 1
FREQUENCIES = np.arange(81) / 64
"""Frequencies at which an MTF is tabulated, cycles/px."""
_WIDTH = 0.6  # s
_TAIL = 1.5  # s, half width at half maximum of the Cauchy
_FINE = 11  # samples within an interval of `FREQUENCIES`: over 1.6e-3 cycles/px a curve deviates from a straight line by 1e-6


class EdgeSamples(NamedTuple):
    """Measured edge response of a picture.

    Values are means over n cells of pixels at nearly one distance from the edge.

    Attributes:
        distance: distance from the edge (n,), px, negative on the dark side.
        value: 0 on the dark side, 1 on the bright one, light made even (n,) (no unit).
        std: standard deviation of `value` (n,).
        parametric: what the parametric fit expects of the same cells (n,) (no unit).

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
    """Parameters of the basis: scalars.

    Attributes:
        sigma: px, of the pilot P.
        angle: rad, of the edge's normal to the grid.
        half_width: px, of the pixel.
        radius: px, standard deviation of the glare.
        apart: px, of the nearer ghosts from the edge.
    """

    sigma: jax.Array
    angle: jax.Array
    half_width: jax.Array
    radius: jax.Array
    apart: jax.Array


class Basis(NamedTuple):
    """Basis: P (n,), B_k (EVEN, n), O_k (ODD, n)."""

    pilot: jax.Array
    even: jax.Array
    odd: jax.Array


class FreeCurve(NamedTuple):
    """Fitted edge response.

    Attributes:
        shape: of the basis.
        even: (EVEN,) strengths, relative to the step; ghosts and glare are 0 where none was found.
        odd: (ODD,).
        levels: (SHIFT,) dark, bright, and the light: `State.linear` of the fit.
        covariance: (EVEN + ODD + 1,) squared, of the even strengths, the odd ones, and ln of the glare's radius.
    """

    shape: CoreShape
    even: jax.Array
    odd: jax.Array
    levels: jax.Array
    covariance: jax.Array


class SampledCurve(NamedTuple):
    """Curve and its standard deviation, of one shape."""

    value: AnyArray
    std: AnyArray


def line_width(shape: CoreShape) -> jax.Array:
    """Return the unit of length s, px.

    The variance of a square along any direction is that along its side.
    """
    return xp.sqrt(shape.sigma**2 + shape.half_width**2 / 3)


def edge_basis(shape: CoreShape, distance: jax.Array, spread: jax.Array) -> Basis:
    """Return the basis as edge responses at `distance` px.

    spread: px^2, of the distances in each cell.
    """
    places, width = _bumps(shape)
    blurred = xp.sqrt(shape.sigma**2 + spread)
    pilot, line, _ = edge_and_slopes(distance, shape.angle, shape.half_width, blurred)
    wide = xp.sqrt(width[:, None] ** 2 + spread)
    right, left = (_step((distance - sign * places[:, None]) / wide) for sign in (1, -1))
    reach = _TAIL * line_width(shape)
    # this function is not Gaussian: the spread is included through its second derivative
    bend = -2 * distance * reach / (xp.pi * (distance**2 + reach**2) ** 2)
    tail = 0.5 + xp.arctan(distance / reach) / xp.pi + spread / 2 * bend
    moved = line_width(shape) * line
    even = xp.concatenate([(right + left) / 2, tail[None], glare_edge(shape.radius, distance, spread)[None]])
    return Basis(pilot, even, xp.concatenate([(left - right) / 2, moved[None]]))


def glare_edge(radius: jax.Array, distance: jax.Array, spread: jax.Array) -> jax.Array:
    """Return the edge response of a Gaussian glare."""
    return _step(distance / xp.sqrt(radius**2 + spread))


def transfer_basis(shape: CoreShape, f: jax.Array) -> Basis:
    """Return the Fourier transforms of the basis at f cycles/px.

    They are the real part of P and B_k, and the imaginary part of O_k.
    """
    places, width = _bumps(shape)
    gauss = lambda std: xp.exp(-2 * (xp.pi * std * f) ** 2)  # noqa: E731
    box = 2 * shape.half_width * f
    pilot = gauss(shape.sigma) * xp.sinc(box * xp.cos(shape.angle)) * xp.sinc(box * xp.sin(shape.angle))
    turn, bump = 2 * xp.pi * f * places[:, None], gauss(width[:, None])
    tail = xp.exp(-2 * xp.pi * _TAIL * line_width(shape) * xp.abs(f))
    moved = 2 * xp.pi * f * line_width(shape) * pilot
    even = xp.concatenate([bump * xp.cos(turn), tail[None], gauss(shape.radius)[None]])
    return Basis(pilot, even, xp.concatenate([bump * xp.sin(turn), moved[None]]))


def edge_response(curve: FreeCurve, distance: jax.Array) -> SampledCurve:
    """Return the ESF at px from the edge.

    It goes from 0 on the dark side to 1 on the bright one.
    """
    basis = edge_basis(curve.shape, distance, xp.zeros(()))
    return _combined(curve, basis.pilot, basis.even - basis.pilot, basis.odd)


def line_response(curve: FreeCurve, distance: jax.Array) -> SampledCurve:
    """Return the LSF at px from the edge, 1/px."""
    width = line_width(curve.shape)
    slopes = slope_along(lambda d: tuple(edge_basis(curve.shape, d, xp.zeros(()))), distance, width)
    pilot, even, odd = (slope / width for slope in slopes)
    return _combined(curve, pilot, even - pilot, odd)


def transfer(curve: FreeCurve, f: jax.Array) -> tuple[SampledCurve, SampledCurve]:
    """Return the MTF along the normal, with and without glare.

    f: cycles/px. Noise increases the modulus of a number: the power of the noise is subtracted.
    """
    basis = transfer_basis(curve.shape, f)
    towards = basis.even - basis.pilot
    total = _combined(curve, basis.pilot, towards, xp.zeros((ODD, f.size)))
    glare, share = basis.even[GLARE], curve.even[GLARE]
    # (M - g M_glare) / (1 - g)
    core_value = (total.value - share * glare) / (1 - share)
    slopes = changed(towards, GLARE, core_value - basis.pilot) / (1 - share)
    core = SampledCurve(core_value, _std(curve, xp.concatenate([slopes, xp.zeros((ODD + 1, f.size))])))
    odd = _combined(curve, xp.zeros(f.shape), xp.zeros((EVEN, f.size)), basis.odd)
    return _modulus(total, odd), _modulus(core, SampledCurve(odd.value / (1 - share), odd.std / (1 - share)))


class Ghost(NamedTuple):
    """Second, weaker step that one side of an edge has and the other has not: numbers, or (n,).

    Attributes:
        share: of the step.
        std: its standard deviation.
        place: px from the edge.
        bright: whether it lies on the bright side.
    """

    share: np.ndarray
    std: np.ndarray
    place: np.ndarray
    bright: np.ndarray


def ghost_of(curve: FreeCurve) -> Ghost:
    """Return the ghost of a fitted curve, or of n curves; its share is 0 if none was found."""
    odd, at = -np.asarray(curve.odd)[..., GHOSTS], EVEN + GHOSTS
    share, covariance = odd.sum(-1), np.asarray(curve.covariance)[..., at[:, None], at]
    step = GHOST_STEP * np.asarray(line_width(curve.shape))[..., None] * np.arange(GHOSTS.size)
    weight = np.maximum(odd * np.sign(share)[..., None], 0.0)
    place = np.asarray(curve.shape.apart) + (weight * step).sum(-1) / np.maximum(weight.sum(-1), 1e-300)
    return Ghost(np.abs(share), np.sqrt(np.maximum(covariance.sum((-1, -2)), 0.0)), place, share > 0)


def half_frequency(value: AnyArray, response: Callable[[jax.Array], SampledCurve]) -> SampledCurve:
    """Return the lowest frequency at which an MTF is one half.

    It is in cycles/px, and NaN where there is none. value: the MTF at `FREQUENCIES`. response: value and standard
    deviation at any frequencies. The interval in which the MTF falls through one half is divided once more, so finely
    that linear interpolation is accurate enough.
    """
    below = changed(value < 0.5, 0, False)
    i = xp.argmax(below)
    first, last = xp.take(FREQUENCIES, i - 1, mode="wrap"), xp.take(FREQUENCIES, i)
    grid = first + (last - first) * np.linspace(0, 1, _FINE)
    fine = response(grid)
    k = xp.argmax(changed(fine.value <= 0.5, 0, False))
    before, after, width = fine.value[k - 1], fine.value[k], grid[1] - grid[0]
    f = grid[k - 1] + width * (before - 0.5) / (before - after)
    std = (fine.std[k - 1] + fine.std[k]) / 2 / (before - after) * width
    return SampledCurve(xp.where(below.any(), f, xp.nan), xp.where(below.any(), std, xp.nan))


def _bumps(shape: CoreShape) -> tuple[jax.Array, jax.Array]:
    """Return the places of the right-hand bumps, and their widths, px."""
    s = line_width(shape)
    ghosts = shape.apart + GHOST_STEP * s * xp.arange(GHOSTS.size)
    widths = xp.concatenate([xp.full(PAIRS, _WIDTH), xp.full(GHOSTS.size, GHOST_WIDTH)])
    return xp.concatenate([xp.asarray(PLACES) * s, ghosts]), widths * s


def _step(t: jax.Array) -> jax.Array:
    """Return the integral of a normal density."""
    return (1 + special.erf(t / xp.sqrt(2.0))) / 2


def _combined(curve: FreeCurve, pilot: jax.Array, even: jax.Array, odd: jax.Array) -> SampledCurve:
    """Return a curve from its columns, with its standard deviation."""
    columns = xp.concatenate([even, odd, xp.zeros((1, pilot.size))])
    return SampledCurve(pilot + curve.even @ even + curve.odd @ odd, _std(curve, columns))


def _std(curve: FreeCurve, columns: jax.Array) -> jax.Array:
    """Return the standard deviation of a sum of columns."""
    return xp.sqrt(xp.maximum(xp.sum(columns * (curve.covariance @ columns), 0), 0.0))


def _modulus(even: SampledCurve, odd: SampledCurve) -> SampledCurve:
    """Return the modulus of a noisy complex number, without its noise."""
    power = even.value**2 - even.std**2 + odd.value**2 - odd.std**2
    size = xp.sqrt(xp.maximum(power, 0.0))
    safe = xp.where(size > 0, size, 1.0)
    std = xp.hypot(even.value * even.std, odd.value * odd.std) / safe
    return SampledCurve(size, xp.where(size > even.std, std, xp.hypot(even.std, odd.std)))
