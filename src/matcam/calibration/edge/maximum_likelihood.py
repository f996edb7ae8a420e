"""Maximum likelihood for an edge of known profile: the profile's parameters, the levels, uneven light, the edge's curve.

A pixel is modelled as  [dark (1 - E(d)) + bright E(d)] (1 + sum of m_k t_k) + sum of a_k t_k,  E the edge response at
distance d, t_k the terms of the light in two dimensions: m_k of a lamp or a lens's vignetting, which multiply the scene, a_k
of flare or haze, which add to it. `State.used` says which of them are free. A pixel's
variance is the MODEL's, gain * value + read^2, held fixed within a step (iteratively reweighted least squares: the fixed
point is the maximum of the Poisson likelihood where variance and mean are one, and nothing is biased by noise in weights,
docs/model.md 8).

Fisher scoring uses a fixed number of steps: every step is the same small program, so that a thousand edges run in
parallel under `vmap`. A search with a stopping rule (Optimistix) would wait for the slowest edge. Profile and levels
are fitted to the cells, the curve to the pixels near the edge. The curve's shift is fitted along with the profile, its
slope and bow are orthogonal to everything else by symmetry, so that the two fits may alternate.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.calibration.edge.geometry import (
    CURVE,
    TERMS,
    EdgeCells,
    PhasedRows,
    edge_slope,
    legendre,
    light_terms,
)
from matcam.calibration.edge.start import to_coefficients, to_strengths
from matcam.core.arrays import changed, linalg, xp
from matcam.numerics.linalg import lifted_inverse

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray, jax

ADDED = 4
"""Number of terms of the light that may be added to the scene: the first terms."""
SHIFT = 2 + TERMS + ADDED
"""Index of the shift of the edge in the linear parameters, the last of them."""
LINEAR = SHIFT + 1
"""Number of parameters that every profile has: dark, bright, multiplied light, added light, shift."""

Profile = Callable[[EdgeCells, "jax.Array"], tuple["jax.Array", "jax.Array", "jax.Array"]]
"""(cells, parameters (k,)) -> means over the cells of E, of dE/dd, and of dE/dparameters (k, n)."""


class Noise(NamedTuple):
    """Noise of a pixel, in the picture's own units.

    Attributes:
        gain: system gain; NaN: to be estimated.
        read: standard deviation of the read noise; NaN: to be estimated.
    """

    gain: AnyArray | np.float64
    read: AnyArray | np.float64

    def variance(self, value: AnyArray, dim: AnyArray | float = 1.0) -> jax.Array:
        """Return the variance of a pixel with the expected value `value`.

        `dim`: factor that made the light even.
        """
        return xp.asarray(self.gain * xp.maximum(value, 0.0) * dim + (self.read * dim) ** 2)


UNKNOWN_NOISE = Noise(np.float64(np.nan), np.float64(np.nan))


class State(NamedTuple):
    """Parameters of the fit.

    Attributes:
        linear: (LINEAR,) dark, bright, m_k (of x and y in 1/px), a_k, shift in px (added to every distance).
        profile: (k,) the profile's own.
        used: (LINEAR,) 1 where a linear parameter is free, 0 where it stays.
    """

    linear: jax.Array
    profile: jax.Array
    used: AnyArray


class EdgeModel(NamedTuple):
    """Model of all cells, and its derivatives.

    Attributes:
        state: the parameters.
        value: (n,).
        edge: (n,) E.
        light: (n,) by which the scene is multiplied.
        design: (LINEAR + k, n) derivatives by the parameters; 0 for those that are not free.
    """

    state: State
    value: jax.Array
    edge: jax.Array
    light: jax.Array
    design: jax.Array


class Light(NamedTuple):
    """Effect of the light on a scene: `factor` times the scene plus `addend`."""

    factor: jax.Array
    addend: jax.Array


def light_of(linear: jax.Array, terms: jax.Array) -> Light:
    """Return the light for its terms `terms` (TERMS, ...).

    `linear`: as in `State`.
    """
    factor = 1 + xp.tensordot(linear[2 : 2 + TERMS], terms, 1)
    return Light(factor, xp.tensordot(linear[2 + TERMS : SHIFT], terms[:ADDED], 1))


def edge_model(cells: EdgeCells, state: State, profile: Profile) -> EdgeModel:
    """Return the model values of the cells."""
    dark, bright, shift = state.linear[0], state.linear[1], state.linear[SHIFT]
    edge, line, slopes = profile(cells._replace(distance=cells.distance + shift), state.profile)
    light = light_of(state.linear, cells.terms)
    level = dark + (bright - dark) * edge
    step = (bright - dark) * light.factor
    levels = xp.stack([(1 - edge) * light.factor, edge * light.factor])
    design = xp.concatenate([levels, level * cells.terms, cells.terms[:ADDED], (step * line)[None]])
    design = xp.concatenate([design * xp.asarray(state.used)[:, None], step * slopes])
    return EdgeModel(state, level * light.factor + light.addend, edge, light.factor, design)


def scoring_step(cells: EdgeCells, state: State, profile: Profile, noise: Noise, longest: jax.Array) -> State:
    """Return the parameters after a step of Fisher scoring.

    longest: (k,) largest change of the profile's parameters.
    """
    at = edge_model(cells, state, profile)
    weight = cells.pixels / noise.variance(at.value, cells.dim)
    inverse = lifted_inverse((at.design * weight) @ at.design.T)
    change = inverse @ (at.design @ (weight * (cells.value - at.value)))
    shift = xp.clip(change[SHIFT], -1.0, 1.0)
    return state._replace(
        linear=state.linear + changed(change[:LINEAR], SHIFT, shift),
        profile=state.profile + xp.clip(change[LINEAR:], -longest, longest),
    )


class CurveStep(NamedTuple):
    """Step of the curve of the edge from the pixels near it.

    Attributes:
        curve: (CURVE,) coefficients.
        covariance: (CURVE, CURVE) of them, for these levels and this profile.
        residual: standard deviation of the pixels about their model.
        roughness: px, standard deviation of the edge's place in single rows, beyond the noise; 0 where noise makes as much.
    """

    curve: jax.Array
    covariance: jax.Array
    residual: jax.Array
    roughness: jax.Array


_CLEAR = 4.0  # standard deviations above which an edge is rough
_STIFF = 0.3  # px: standard deviation of the prior for a change of the higher orders of a curve
_BOWS = 3  # orders of a straight edge with a bow; higher orders describe an S, dirt or a torn border
_BENT = 16.3  # smallest rise of 2 ln likelihood for all higher orders together: by chance once in 1,000


def curve_step(phased: PhasedRows, cells: EdgeCells, at: EdgeModel, noise: Noise, length: jax.Array) -> CurveStep:
    """Return the curve after a step of Fisher scoring, from single pixels.

    A pixel's model is its cell's, moved along the slope: within a cell the distances differ by a sixteenth of a px, and
    the residual of second order is even in the distance, and does not affect the position. The orders beyond the bow
    are free if they are significant: if they are fitted to the noise of few rows, the edge seems sharper or more
    blurred than it is.
    """
    aligned, curve, state = phased.rows, phased.curve, at.state
    near = aligned.near
    shape = (phased.member.shape[0], near.stop - near.start)
    size = shape[0] * shape[1]
    of_row = lambda a: a[:size].reshape(shape)[phased.phase]  # noqa: E731
    y, distance = aligned.y[:, None], phased.distance[:, near]
    terms = xp.stack(light_terms(aligned.x[:, near], y, distance, aligned.length))
    light = light_of(state.linear, terms)
    of_cell = light_of(state.linear, cells.terms)
    slope = of_row(at.design[SHIFT] / at.light) * light.factor
    scene = of_row((at.value - of_cell.addend) / at.light)
    expected = scene * light.factor + light.addend + slope * (distance - of_row(cells.distance))
    weight = aligned.valid[:, near] / noise.variance(expected, 1 / aligned.light[:, None])
    # moving the curve by +1 px along x moves the bright side by c px
    tilt = 1 / xp.sqrt(1 + edge_slope(curve, aligned.y) ** 2)
    by_row = -slope * tilt[:, None]
    information = (weight * by_row**2).sum(1)
    residual = aligned.valid[:, near] * (aligned.value[:, near] - expected)
    score = (weight * by_row * residual).sum(1)
    powers = legendre(aligned.y / length, CURVE)
    normal = (powers * information) @ powers.T
    stiff = xp.where(xp.arange(CURVE) < _BOWS, 0.0, _STIFF**-2)
    normal = normal + xp.diag(stiff + 1e-9 * xp.trace(normal) + 1e-300)
    covariance, change, orders = _of_seen_orders(normal, powers @ score, to_strengths(curve, length))
    change = xp.clip(change, -1.0, 1.0)
    rms = xp.sqrt((residual**2).sum() / xp.maximum(aligned.valid[:, near].sum(), 1.0))
    by = xp.stack([to_coefficients(unit, length) for unit in xp.eye(CURVE)])
    # the position in each row, relative to the new curve
    shift = score / xp.where(information > 0, information, 1.0) - powers.T @ change
    count = xp.maximum((information > 0).sum() - orders, 1.0)
    weight = information / xp.maximum(information.sum(), 1e-300) * ((information > 0).sum() / count)
    expected = (information > 0).sum() / xp.maximum(information.sum(), 1e-300)
    extra = (weight * shift**2).sum() - expected
    rough = xp.where(extra > _CLEAR * expected * xp.sqrt(2 / count), xp.sqrt(xp.maximum(extra, 0.0)), 0.0)
    return CurveStep(curve + to_coefficients(change, length), by.T @ covariance @ by, rms, rough)


def _of_seen_orders(
    normal: jax.Array, score: jax.Array, strengths: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the covariance of the strengths of a curve, their change, and the number of free ones.

    The strengths beyond the bow are 0 if noise explains them. `normal`: (CURVE, CURVE) information. `score`: (CURVE,)
    of the present `strengths`.
    """
    free = linalg.inv(normal)
    change = free @ score
    beyond = (strengths + change)[_BOWS:]
    seen = beyond @ linalg.solve(free[_BOWS:, _BOWS:], beyond) > _BENT
    # towards a curve without them
    without = xp.where(xp.arange(CURVE) < _BOWS, 0.0, -strengths)
    bow = xp.pad(linalg.inv(normal[:_BOWS, :_BOWS]), (0, CURVE - _BOWS))
    bowed = without + bow @ (score - normal @ without)
    return xp.where(seen, free, bow), xp.where(seen, change, bowed), xp.where(seen, CURVE, _BOWS)
