"""Fit of the model-free edge response to the bins: a linear least-squares problem with priors, optional ghost and glare.

If the bins do not determine a coefficient, a normal prior keeps the edge response near the pilot. The prior standard
deviation is 10 % of the step for the centre of the core. It decreases with the distance from the edge, because lenses
deviate most from Gaussians in the core. The covariance is that of the estimator under noise, A^-1 X W V W X' A^-1 with
A = X W X' + prior. X contains the derivatives of the model, W the weights of the bins, V the variances of the bins, and
the prior the inverse variances of the coefficients. This covariance describes the scatter of repeated images, and is
smaller than the posterior covariance. docs/edge.md gives the measured bias of the priors.

A ghost is a second, weaker edge. Its basis functions are tested at several distances on the residual of the free curve.
They are added to the fit if they increase the likelihood enough. The same basis functions also describe wings of the
lens beyond the core.

Glare is a wide Gaussian. Several radii are tested on the residual of the free curve. If the increase of the likelihood
has a significance of 5 sigma, glare with a refined radius is added. A fit of glare that is absent would halve the
accuracy of every MTF50.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import chdtri

from matcam.calibration.edge.free_curve import (
    CENTRES,
    EVEN,
    GHOST_WIDTH,
    GHOSTS,
    GLARE,
    ODD,
    SPACING,
    CoreShape,
    FreeCurve,
    edge_basis,
    glare_edge,
    line_width,
)
from matcam.calibration.edge.geometry import TERMS, EdgeCells
from matcam.calibration.edge.maximum_likelihood import ADDED, SHIFT, EdgeModel, Noise, lit_edge
from matcam.calibration.photograph.uneven_light import GLARE_STD
from matcam.core.arrays import changed, first_axis_map, last_of, linalg, slope_along, special, xp
from matcam.numerics.linalg import lifted_inverse
from matcam.numerics.normal import IMPROBABLE, SIGNIFICANT

if TYPE_CHECKING:
    from matcam.core.jax import jax

FOUND = SIGNIFICANT**2
"""Increase of 2 ln likelihood above which glare is accepted: that of one significant parameter."""
_PRIOR_GHOST = 0.3
"""Prior standard deviation of the coefficients of a ghost, relative to the step. Ghosts are weaker than the edge."""
VEIL = 0.25
"""Radius, relative to the width of a region, beyond which glare resembles uneven light or another edge."""
_COLUMN = SHIFT + GLARE
"""Index of the column of the glare. The column is 0 until glare is tested."""


class LinearFit(NamedTuple):
    """Linear least-squares problem of the free curve without glare, and its solution, for n bins and p columns.

    Attributes:
        shape: parameters of the basis.
        cells: cells with distances from the edge of the pilot.
        pilot: (n,) edge response P.
        step: (n,) bright minus dark level in the light of each bin.
        levels: (LINEAR,) `State.linear` at which the problem is linearised.
        used: (LINEAR,) 1 for free parameters, else 0.
        weight: (n,) weights.
        variance: (n,) variance of a pixel.
        residual: (n,) residual before the fit.
        columns: (p, n) columns of the levels, the light, and the even and odd coefficients; 0 for fixed parameters.
        normal: (p, p) normal matrix of the bins, without the prior.
        inverse: (p, p) inverse A^-1 of the normal matrix with the prior.
        strength: (p,) fitted coefficients.
    """

    shape: CoreShape
    cells: EdgeCells
    pilot: jax.Array
    step: jax.Array
    levels: jax.Array
    used: jax.Array
    weight: jax.Array
    variance: jax.Array
    residual: jax.Array
    columns: jax.Array
    normal: jax.Array
    inverse: jax.Array
    strength: jax.Array

    @property
    def left(self) -> jax.Array:
        """Residual after the fit (n,)."""
        return self.residual - self.strength @ self.columns

    def misfit(self, curve: FreeCurve) -> jax.Array:
        """Compute the residual (n,) of the cells relative to a curve with the basis functions of this fit."""
        columns = changed(self.columns, _COLUMN, _column(self, xp.log(curve.shape.radius)))[SHIFT:] / self.step
        response = self.pilot + curve.coefficients @ columns
        return self.cells.value - lit_edge(response, curve.levels, self.cells.terms).value

    @property
    def chi2(self) -> jax.Array:
        """Chi-square of the bins after the fit, for the noise in `variance`."""
        return (self.cells.pixels / self.variance * self.left**2).sum()

    @property
    def degrees(self) -> jax.Array:
        """Degrees of freedom: number of bins minus the effective number of fitted parameters."""
        return xp.maximum((self.cells.pixels > 0).sum() - xp.trace(self.inverse @ self.normal), 1.0)

    @property
    def noisy(self) -> jax.Array:
        """Squared weight times the variance of the mean of each bin (n,)."""
        return self.weight**2 * self.variance / xp.maximum(self.cells.pixels, 1.0)

    def solved(self, columns: jax.Array) -> LinearFit:
        normal = (columns * self.weight) @ columns.T
        inverse = lifted_inverse(normal + xp.diag(_PRECISIONS))
        strength = inverse @ (columns @ (self.weight * self.residual))
        return self._replace(columns=columns, normal=normal, inverse=inverse, strength=strength)


def linear_fit(
    cells: EdgeCells, at: EdgeModel, noise: Noise, shape: CoreShape, ghost: jax.Array | float = 0.0
) -> LinearFit:
    """Fit the free curve, and select the polynomial orders of the light.

    `at`: Gaussian model, with light of all orders, at which the problem is linearised. `ghost`: 1 if the fit includes a
    ghost, else 0.
    """
    state, unknown = at.state, xp.zeros(())
    cells = cells._replace(distance=cells.distance + state.linear[SHIFT])
    pilot, free = edge_basis(shape, cells.distance, cells.spread)
    ghosts = np.append(GHOSTS, EVEN + GHOSTS)
    free = changed(changed(free, GLARE, 0.0), ghosts, free[ghosts] * ghost)
    variance = noise.variance(at.value, cells.dim)
    # The error of an approximation by basis functions 0.6 s wide is 2e-4 of the step. It affects only images with less
    # noise.
    weight = cells.pixels / (variance + cells.pixels * (2e-4 * (state.linear[1] - state.linear[0])) ** 2)

    def problem(linear: jax.Array, used: jax.Array) -> LinearFit:
        lit = lit_edge(pilot, linear, cells.terms)
        columns = xp.concatenate([lit.columns * used[:SHIFT, None], free * lit.step])
        known = (pilot, lit.step, linear, used, weight, variance, cells.value - lit.value, columns)
        return LinearFit(shape, cells, *known, *[unknown] * 3).solved(columns)

    used = _chosen_light(state.linear, cells, problem)

    def corrected(linear: jax.Array, _: int) -> tuple[jax.Array, LinearFit]:
        fit = problem(linear, used)
        return changed(linear, slice(SHIFT), linear[:SHIFT] + fit.strength[:SHIFT]), fit

    # The light multiplies the curve, so the second pass starts from the light that the first pass has corrected.
    return last_of(corrected, state.linear * used, np.arange(2))


def ghost_found(fit: LinearFit, glare: tuple[jax.Array, jax.Array], known: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Test for a ghost, and find its most probable distance from the edge, px.

    Glare is fitted first, so that it is not mistaken for a ghost. `glare`: result of `glare_candidate`. `known`: whether the
    noise is known. Unknown noise is estimated from the residual.
    """
    log_radius, rise = glare
    beside = fit.solved(changed(fit.columns, _COLUMN, xp.where(rise > FOUND, _column(fit, log_radius), 0.0)))
    # A ghost beyond 0.3 of the width of the region resembles uneven light.
    first = 2.2 * line_width(fit.shape)
    # Ghosts beyond 25 px are part of the light (`uneven_light.py`).
    last = xp.minimum(25.0, 0.3 * _width(fit.cells))
    positions = xp.linspace(first, last, 60)

    rises = _rises(beside, _ghosts(beside, positions), _PRIOR_GHOST)
    best = xp.argmax(rises)
    left = (beside.chi2 - rises[best]) / beside.degrees
    # At one position, noise increases 2 ln likelihood by more than 24 with probability 1/2,000.
    found = rises[best] > 24.0 * xp.where(known, 1.0, xp.maximum(left, 1.0))
    # In the images of tests/oracle, ghosts explain at least 80 % of the excess of chi-square, and dust and banding
    # mostly less than 55 %.
    found &= rises[best] > 0.7 * (beside.chi2 - beside.degrees)
    return found & (first < last), positions[best]


def _ghosts(fit: LinearFit, positions: jax.Array) -> jax.Array:
    """Compute the even and odd columns (m, 6, n) of ghosts with coefficient 1. `positions`: distances (m,), px."""
    s = line_width(fit.shape)
    at = (positions[:, None] + SPACING * s * xp.arange(GHOSTS.size))[..., None]
    right, left = (glare_edge(GHOST_WIDTH * s, fit.cells.distance - sign * at, fit.cells.spread) for sign in (1, -1))
    return xp.concatenate([(right + left) / 2 - fit.pilot, (left - right) / 2], 1) * fit.step


def _width(cells: EdgeCells) -> jax.Array:
    distance = xp.where(cells.pixels > 0, cells.distance, 0.0)
    return distance.max() - distance.min()


def misfit_probability(fit: LinearFit, tested: EdgeModel) -> jax.Array:
    """Compute the probability of residuals at least as large as those of the model `tested` if this model is correct.

    The free curve is fitted to the residuals. The test statistic is the quadratic form s' A^-1 s of the scores s, where
    A is the normal matrix with the prior. If the tested model is correct, the covariance of the scores is the
    information minus the part that the tested fit has absorbed. The distribution of the statistic is approximated by a
    scaled chi-square with the same mean and variance (Satterthwaite 1946). The probability is NaN if nothing was
    fitted.
    """
    score = fit.columns @ (fit.weight * (fit.cells.value - tested.value))
    shared = (fit.columns * fit.weight) @ tested.design.T
    absorbed = shared @ lifted_inverse((tested.design * fit.weight) @ tested.design.T) @ shared.T
    spread = fit.inverse @ (fit.normal - absorbed)
    mean, variance = xp.trace(spread), 2 * xp.sum(spread * spread.T)
    known = (variance > 0) & (mean > 0)  # NaN if nothing was fitted
    mean, variance = xp.where(known, mean, 1.0), xp.where(known, variance, 1.0)
    found = xp.maximum(score @ fit.inverse @ score, 0.0)
    return xp.where(known, special.gammaincc(mean**2 / variance, found * mean / variance), xp.nan)


def _chosen_light(
    linear: jax.Array, cells: EdgeCells, problem: Callable[[jax.Array, jax.Array], LinearFit]
) -> jax.Array:
    """Select the linear parameters (LINEAR,) that are free.

    The selected entry of `LIGHTS` minimises the Bayesian information criterion (Schwarz 1978). Each entry is
    tested with and without glare, because uneven light and glare resemble each other. `linear`: parameters with light
    of all orders. `problem`: function that fits the free curve at given parameters, with a mask of the free parameters.
    """

    def tested(linear: jax.Array, used: jax.Array) -> jax.Array:
        """Compute chi-square with the priors, and the decrease of chi-square by glare, (1, 2)."""
        fit = problem(linear[0], used[0])
        radii = _radii(fit.shape)
        # Glare with a radius beyond `VEIL` resembles uneven light, which is more frequent. It requires a larger
        # increase of 2 ln likelihood.
        unlikely = xp.where(xp.exp(radii) > VEIL * _width(cells), 4.0, 0.0)
        rise = xp.maximum((_glare_rises(fit, radii) - unlikely).max(), 0.0)
        return xp.stack([(fit.weight * fit.residual * fit.left).sum(), rise])[None]

    chi2, rise = first_axis_map(tested, (LIGHTS * linear, LIGHTS), 1).T
    per_parameter = xp.log(xp.maximum(cells.pixels.sum(), 2.0))
    # Structure that neither light nor glare explains is treated as noise.
    degrees = xp.maximum((cells.pixels > 0).sum() - len(_PRECISIONS), 1.0)
    scatter = xp.maximum(xp.min(chi2 - rise) / degrees, 1.0)
    chi2, rise = chi2 / scatter, rise / scatter
    # Noise increases 2 ln likelihood by more than the smallest cost with probability `IMPROBABLE`.
    by_parameter = xp.maximum(per_parameter, chdtri(1, IMPROBABLE)) * LIGHTS.sum(1)
    cost = chi2 + by_parameter - xp.where(rise > FOUND, rise - 2 * per_parameter, 0.0)
    return xp.asarray(xp.take(LIGHTS, xp.argmin(cost), axis=0))


def glare_candidate(fit: LinearFit) -> tuple[jax.Array, jax.Array]:
    """Find the most probable glare.

    The result contains ln of the radius of the glare in px, and the increase of 2 ln likelihood.
    """
    radii = _radii(fit.shape)
    rises = _glare_rises(fit, radii)
    best = xp.argmax(rises)
    return radii[best], rises[best]


def fitted_curve(fit: LinearFit, log_radius: jax.Array, glares: jax.Array) -> FreeCurve:
    """Fit the curve, with glare of a fitted radius if `glares` is true. `log_radius`: ln of the initial radius in px."""
    radii = _radii(fit.shape)
    # 17 radii are tested. A parabola through the best radius and its neighbours determines the maximum.
    step = (radii[1] - radii[0]) / 8
    nearby = log_radius + step * np.arange(-8, 9)
    rises = _glare_rises(fit, nearby)
    best = xp.clip(xp.argmax(rises), 1, 15)
    before, at, after = (xp.take(rises, best + k) for k in (-1, 0, 1))
    bend = before - 2 * at + after
    vertex = xp.clip((before - after) / xp.where(bend < 0, 2 * bend, -xp.inf), -1, 1)
    log_radius = xp.clip(xp.take(nearby, best) + step * vertex, radii[0], radii[-1])
    glaring = fit.solved(changed(fit.columns, _COLUMN, xp.where(glares, _column(fit, log_radius), 0.0)))
    slope = slope_along(lambda r: _column(fit, r), log_radius, 1.0)
    # The radius is already optimal. The additional column only provides its covariance.
    full = xp.concatenate([glaring.columns, glaring.strength[_COLUMN] * slope[None]])
    # Normal prior of ln of the radius with a standard deviation of 1.
    inverse = lifted_inverse((full * fit.weight) @ full.T + xp.diag(xp.append(_PRECISIONS, 1.0)))
    covariance = inverse @ ((full * fit.noisy) @ full.T) @ inverse
    return _per_step(fit, glaring.strength, covariance, xp.where(glares, xp.exp(log_radius), 1.0))


def _per_step(fit: LinearFit, strength: jax.Array, covariance: jax.Array, radius: jax.Array) -> FreeCurve:
    """Convert fitted coefficients to a curve relative to the fitted step, and include the uncertainty of the step.

    `covariance`: covariance matrix of size p + 1, whose last parameter is ln of the glare radius.
    """
    before = fit.levels[1] - fit.levels[0]
    now = before + strength[1] - strength[0]
    relative = strength[SHIFT:] * before / now
    scaling = xp.append(xp.full(EVEN + ODD, before / now), 1.0)
    by_step = xp.append(relative, 0.0) / now
    jacobian = xp.concatenate(
        [by_step[:, None], -by_step[:, None], xp.zeros((EVEN + ODD + 1, SHIFT - 2)), xp.diag(scaling)], 1
    )
    shape = fit.shape._replace(radius=radius)
    levels = fit.levels[:SHIFT] + strength[:SHIFT]
    return FreeCurve(shape, relative, levels, jacobian @ covariance @ jacobian.T)


def _glare_rises(fit: LinearFit, log_radii: jax.Array) -> jax.Array:
    """Compute the increase of 2 ln likelihood by glare of each radius. Glare with a negative share is excluded."""
    return _rises(fit, _column(fit, log_radii[:, None])[:, None], GLARE_STD, 0.0)


def _rises(fit: LinearFit, columns: jax.Array, std: float, least: float = -np.inf) -> jax.Array:
    """Compute the increase of 2 ln likelihood (m,) that results from adding columns (m, q, n) to the model.

    All other parameters are refitted. `std`: prior standard deviation of the coefficients. `least`: lower limit of the
    scores.
    """
    weighted = columns * fit.weight
    cross, score = weighted @ fit.columns.T, xp.maximum(weighted @ fit.left, least)[..., None]
    alone = weighted @ columns.swapaxes(1, 2) - cross @ fit.inverse @ cross.swapaxes(1, 2)
    return (score * linalg.solve(alone + std**-2 * np.eye(columns.shape[1]), score)).sum((1, 2))


def _column(fit: LinearFit, log_radius: jax.Array) -> jax.Array:
    return (glare_edge(xp.exp(log_radius), fit.cells.distance, fit.cells.spread) - fit.pilot) * fit.step


def _radii(shape: CoreShape) -> jax.Array:
    """Compute ln of the radii in px at which glare is tested."""
    # The narrowest glare has a radius of 4 px or 3 s, whichever is larger.
    narrowest = xp.maximum(4.0, 3.0 * line_width(shape))
    return xp.linspace(xp.log(narrowest), xp.log(110.0), 9)


def _lights() -> np.ndarray:
    """List masks (6, LINEAR) of the free linear parameters of each light model, in ascending order of complexity.

    The polynomial of the multiplicative light has order 1, 2 or 3, and that of the additive light order 0, 1 or 2. The two
    levels and the shift of the edge are always free.
    """
    factor, addend = {1: 2, 2: 4, 3: 7}, {0: 0, 1: 2, 2: 4}
    lights = []
    for m, a in ((1, 0), (2, 0), (1, 1), (2, 1), (2, 2), (3, 2)):
        multiplied, added = np.arange(TERMS) < factor[m], np.arange(ADDED) < addend[a]
        lights.append(np.concatenate([[1, 1], multiplied, added, [1]]).astype(float))
    return np.stack(lights)


LIGHTS = _lights()
"""Masks of the linear parameters that are free in each model of the light (6, LINEAR)."""


def _precisions() -> np.ndarray:
    """Compute the precisions of the priors (p,). They are 0 for the levels, the light and the position of the edge."""
    # Lenses deviate most from Gaussians in the core: the standard deviation is 10 % of the step at the edge, and
    # decreases as a Gaussian with a standard deviation of 1.6 s.
    core, ghosts = 0.1 * np.exp(-((CENTRES / 1.6) ** 2) / 2), np.full(GHOSTS.size, _PRIOR_GHOST)
    odd = np.minimum(core, 0.03)
    even = np.concatenate([core, ghosts, [0.3, GLARE_STD]])
    return np.concatenate([np.zeros(SHIFT), even**-2, odd**-2, ghosts**-2, [0.0]])


_PRECISIONS = _precisions()
"""Precisions of the priors of all columns (p,)."""
