"""Maximum likelihood fit of an edge: parameters of its profile, levels, uneven light, and its curve.

A pixel is modelled as  [dark (1 - E(d)) + bright E(d)] (1 + sum of m_k t_k) + sum of a_k t_k.  E is the edge response
at distance d, and t_k are the polynomial terms of the light in two dimensions. The coefficients m_k describe light that
multiplies the scene (uneven illumination, vignetting), and a_k light that is added (flare, haze). `State.used` marks
the free coefficients. The variance of a pixel is gain * value + read^2, where value is the value of the model and read
the read noise. The variance is held fixed within a step (iteratively reweighted least squares). For Poisson noise, the
fixed point is the maximum of the likelihood, and noise in the weights does not cause a bias (docs/model.md 8).

Fisher scoring uses a fixed number of steps. Every step is the same small program, so that many edges run in parallel
under `vmap`; with a stopping rule, all edges would wait for the slowest one. Profile and levels are fitted to the bins,
and the curve to the pixels near the edge. The shift of the curve is fitted together with the profile. By symmetry, the
slope and the curvature of the edge are uncorrelated with all other parameters, so that the two fits can alternate.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import chdtri

from matcam.calibration.edge.geometry import (
    CURVE,
    TERMS,
    EdgeCells,
    PhasedRows,
    edge_slope,
    light_terms,
)
from matcam.core.arrays import changed, linalg, xp
from matcam.numerics.linalg import lifted_inverse
from matcam.numerics.normal import IMPROBABLE

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray, jax

ADDED = 4
"""Number of terms of the additive light. They are the first of the `TERMS` light terms."""
SHIFT = 2 + TERMS + ADDED
"""Index of the shift of the edge, the last of the linear parameters."""
LINEAR = SHIFT + 1
"""Number of linear parameters: the two levels, the coefficients of multiplicative and additive light, and the shift."""

Profile = Callable[[EdgeCells, "jax.Array"], tuple["jax.Array", "jax.Array", "jax.Array"]]
"""Function of bins and parameters (k,) that computes the means of E, dE/dd and dE/dparameters (k, n) over the bins."""


class Noise(NamedTuple):
    """Noise of a pixel, in the units of the image.

    Attributes:
        gain: system gain. Default: NaN, estimated from the image.
        read: standard deviation of the read noise. Default: NaN, estimated from the image.
    """

    gain: AnyArray | np.float64 = np.float64(np.nan)
    read: AnyArray | np.float64 = np.float64(np.nan)

    def variance(self, value: AnyArray, dim: AnyArray | float = 1.0) -> jax.Array:
        """Compute the variance of a pixel with the expected value `value`.

        `dim`: factor by which the pixel was multiplied to correct uneven light.
        """
        return self.gain * xp.maximum(value, 0.0) * dim + (self.read * dim) ** 2


class State(NamedTuple):
    """Parameters of the fit.

    Attributes:
        linear: (LINEAR,) dark level, bright level, coefficients m_k of the light that multiplies the scene (1/px for
            the terms x and y), coefficients a_k of the added light, and the shift that is added to every distance, px.
        profile: (k,) parameters of the profile.
        used: (LINEAR,) 1 for free linear parameters, 0 for fixed linear parameters.
    """

    linear: jax.Array
    profile: jax.Array
    used: AnyArray


class EdgeModel(NamedTuple):
    """Model of all bins, and its derivatives.

    Attributes:
        state: parameters.
        value: (n,) model values.
        design: (LINEAR + k, n) derivatives with respect to the parameters; 0 for fixed parameters.
    """

    state: State
    value: jax.Array
    design: jax.Array


class LitEdge(NamedTuple):
    """Values at n points of an edge in uneven light.

    Attributes:
        value: (n,) expected values.
        step: (n,) bright minus dark level in this light.
        columns: (SHIFT, n) derivatives with respect to the levels and the light.
    """

    value: jax.Array
    step: jax.Array
    columns: jax.Array


def light_of(linear: jax.Array, terms: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Evaluate the factor of the light and the added light, (n,) each.

    `linear`: parameters `State.linear`. `terms`: (TERMS, n) polynomial terms.
    """
    return 1 + linear[2 : 2 + TERMS] @ terms, linear[2 + TERMS : SHIFT] @ terms[:ADDED]


def lit_edge(edge: jax.Array, linear: jax.Array, terms: jax.Array) -> LitEdge:
    """Apply levels and light to an edge response (n,). `linear`, `terms`: as in `light_of`."""
    factor, addend = light_of(linear, terms)
    step = linear[1] - linear[0]
    level = linear[0] + step * edge
    parts = [((1 - edge) * factor)[None], (edge * factor)[None], level * terms, terms[:ADDED]]
    return LitEdge(level * factor + addend, step * factor, xp.concatenate(parts))


def edge_model(cells: EdgeCells, state: State, profile: Profile) -> EdgeModel:
    moved = cells._replace(distance=cells.distance + state.linear[SHIFT])
    edge, line, slopes = profile(moved, state.profile)
    lit = lit_edge(edge, state.linear, cells.terms)
    design = xp.concatenate([lit.columns, (lit.step * line)[None], lit.step * slopes])
    free = xp.concatenate([state.used, xp.ones(len(slopes))])
    return EdgeModel(state, lit.value, design * free[:, None])


def scoring_step(cells: EdgeCells, state: State, profile: Profile, noise: Noise, longest: AnyArray) -> State:
    """Update the parameters by a step of Fisher scoring.

    `longest`: (LINEAR + k,) largest change of each parameter.
    """
    at = edge_model(cells, state, profile)
    weight = cells.pixels / noise.variance(at.value, cells.dim)
    inverse = lifted_inverse((at.design * weight) @ at.design.T)
    change = xp.clip(inverse @ (at.design @ (weight * (cells.value - at.value))), -longest, longest)
    return state._replace(linear=state.linear + change[:LINEAR], profile=state.profile + change[LINEAR:])


class CurveStep(NamedTuple):
    """Update of the curve of an edge from the pixels near it.

    Attributes:
        curve: (CURVE,) coefficients.
        covariance: (CURVE, CURVE) covariance of `curve` at fixed levels and profile.
        residual: root mean square of the residuals of the pixels.
        roughness: standard deviation of the position of the edge in single rows beyond the noise, px; 0 if it is not
            significant.
    """

    curve: jax.Array
    covariance: jax.Array
    residual: jax.Array
    roughness: jax.Array


_BOWS = 3
"""Number of coefficients of the curve up to the second order. Higher orders describe an S shape, dirt or a torn border."""


def curve_step(phased: PhasedRows, cells: EdgeCells, at: EdgeModel, noise: Noise) -> CurveStep:
    """Update the curve by a step of Fisher scoring on single pixels.

    The model of a pixel is that of its bin, extrapolated linearly in the distance. Distances in a bin differ from the
    mean by at most a sixteenth of a px; the neglected second-order term is even in the distance, and does not bias the
    position. The coefficients of the curve above the second order are free only if they are significant. Otherwise they
    would fit the noise of a few rows, and bias the blur.
    """
    aligned, curve, state = phased.rows, phased.curve, at.state
    near = aligned.near
    shape = (phased.member.shape[0], near.stop - near.start)
    size = shape[0] * shape[1]
    of_row = lambda a: a[:size].reshape(shape)[phased.phase]  # noqa: E731
    y, distance = aligned.y[:, None], phased.distance[:, near]
    terms = light_terms(aligned.x[:, near], y, distance, aligned.length).reshape(TERMS, -1)
    factor, addend = (part.reshape(distance.shape) for part in light_of(state.linear, terms))
    cell_factor, cell_addend = light_of(state.linear, cells.terms)
    slope = of_row(at.design[SHIFT] / cell_factor) * factor
    scene = of_row((at.value - cell_addend) / cell_factor)
    expected = scene * factor + addend + slope * (distance - of_row(cells.distance))
    weight = aligned.valid[:, near] / noise.variance(expected, 1 / aligned.light[:, None])
    # A shift of the curve by 1 px along x changes the distance by `tilt` px.
    tilt = 1 / xp.sqrt(1 + edge_slope(curve, aligned.powers, aligned.length) ** 2)
    by_row = -slope * tilt[:, None]
    information = (weight * by_row**2).sum(1)
    residual = aligned.valid[:, near] * (aligned.value[:, near] - expected)
    score = (weight * by_row * residual).sum(1)
    powers = aligned.powers[:CURVE]
    normal = (powers * information) @ powers.T
    # The prior standard deviation of a change of the higher orders is 0.3 px.
    stiff = np.where(np.arange(CURVE) < _BOWS, 0.0, 0.3**-2)
    normal = normal + xp.diag(stiff + 1e-9 * xp.trace(normal) + 1e-300)
    covariance, change, orders = _of_seen_orders(normal, powers @ score, curve)
    change = xp.clip(change, -1.0, 1.0)
    rms = xp.sqrt((residual**2).sum() / xp.maximum(aligned.valid[:, near].sum(), 1.0))
    # The shift of a row is the position of its edge relative to the new curve.
    shift = score / xp.where(information > 0, information, 1.0) - powers.T @ change
    count = xp.maximum((information > 0).sum() - orders, 1.0)
    weight = information / xp.maximum(information.sum(), 1e-300) * ((information > 0).sum() / count)
    expected = (information > 0).sum() / xp.maximum(information.sum(), 1e-300)
    extra = (weight * shift**2).sum() - expected
    # Noise rarely exceeds 4 standard deviations.
    rough = xp.where(extra > 4.0 * expected * xp.sqrt(2 / count), xp.sqrt(xp.maximum(extra, 0.0)), 0.0)
    return CurveStep(curve + change, covariance, rms, rough)


def _of_seen_orders(normal: jax.Array, score: jax.Array, curve: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Compute the covariance, the change and the number of the free coefficients of a curve.

    The coefficients above the second order are set to 0 if noise explains them. `normal`: (CURVE, CURVE) information. `score`:
    (CURVE,) score at the current coefficients `curve`.
    """
    free = linalg.inv(normal)
    bow = changed(np.zeros((CURVE, CURVE)), np.s_[:_BOWS, :_BOWS], linalg.inv(normal[:_BOWS, :_BOWS]))
    change = free @ score
    # The inverse covariance of the higher orders is a Schur complement.
    beyond, inverse = (curve + change)[_BOWS:], (normal - normal @ bow @ normal)[_BOWS:, _BOWS:]
    seen = beyond @ inverse @ beyond > chdtri(CURVE - _BOWS, IMPROBABLE)
    # This change of the coefficients sets the higher orders to 0.
    without = xp.where(np.arange(CURVE) < _BOWS, 0.0, -curve)
    bowed = without + bow @ (score - normal @ without)
    return xp.where(seen, free, bow), xp.where(seen, change, bowed), xp.where(seen, CURVE, _BOWS)
