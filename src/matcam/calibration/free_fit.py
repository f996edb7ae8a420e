"""The free curve fitted to the cells: one linear solve, and what noise does to its result.

Normal priors keep what the cells do not determine near the pilot: 10 % of the step on a strength in the middle of the core,
falling off with the distance, because that is where a lens that is not Gaussian differs most. The covariance is
that of the estimator under noise, A^-1 X W V W X' A^-1 with A = X W X' + prior, not the wider one of a belief: it is what
repeated pictures show. What the priors bias stands in docs/edge.md, by test.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam._jax import jax, jnp
from matcam.calibration.cells import Cells
from matcam.calibration.free_core import EVEN, GLARE, ODD, PLACES, Shape, edge_basis
from matcam.calibration.maximum_likelihood import Model, Noise, State, scaled_inverse

_PRIOR, _REACH = 0.1, 1.6  # of the step, on strengths of the core; falls off as a Gaussian of 1.6 s
_PRIOR_ODD = 0.03  # of the step, at most
_PRIOR_TAIL = 0.3  # of the step
PRIOR_GLARE = 0.1  # of the step
_MISFIT = 2e-4  # of the step: what bumps of 0.6 s cannot describe; weighs only in pictures with less noise than that
_LEVELS = 4
COLUMN = _LEVELS + GLARE
"""Where glare stands among the columns; 0 until it is looked for."""


class LinearFit(NamedTuple):
    """The solution without glare, and all that is needed to ask what glare would change. n cells, p columns."""

    shape: Shape
    cells: Cells
    """About the pilot's edge."""
    pilot: jax.Array
    step: jax.Array
    """(n,) bright less dark, in this light."""
    levels: jax.Array
    """(5,) State.linear about which the columns stand."""
    weight: jax.Array
    noisy: jax.Array
    """(n,) weight^2 times the variance of a cell."""
    columns: jax.Array
    """(p, n): levels and light, even strengths, odd strengths."""
    inverse: jax.Array
    """(p, p) A^-1."""
    residual: jax.Array
    """(n,) before, and"""
    left: jax.Array
    """after the fit."""
    strength: jax.Array
    """(p,)"""
    chi2: jax.Array
    """Of the cells, under the noise."""
    degrees: jax.Array
    """Of freedom: cells less what the fit has taken up."""


class FreeCurve(NamedTuple):
    """A fitted edge response."""

    shape: Shape
    even: jax.Array
    """(EVEN,) strengths, relative to the step; the last one, glare's, is 0 where none was found."""
    odd: jax.Array
    """(ODD,)"""
    levels: jax.Array
    """(4,) dark, bright, and the light's relative change per px in x and y."""
    covariance: jax.Array
    """(EVEN + ODD + 1,) squared: of the even strengths, the odd ones, and ln of the glare's radius."""


class Structure(NamedTuple):
    """What the free curve finds in the residuals of another fit: is that fit's model wrong?"""

    found: jax.Array
    """Rise of 2 ln likelihood."""
    mean: jax.Array
    variance: jax.Array
    """Of the same quantity, if the other model were right."""


def solve(
    cells: Cells, state: State, at: Model, noise: Noise, shape: Shape, tested: Model
) -> tuple[LinearFit, Structure]:
    """Fit the free curve around the Gaussian one (`state`, `at`), and judge the model `tested` by it."""
    cells = cells._replace(distance=cells.distance + state.linear[4])
    basis = edge_basis(shape, cells.distance, cells.spread)
    even, odd = (basis.even - basis.pilot).at[GLARE].set(0.0), basis.odd
    variance = noise.variance(at.value)
    weight = cells.pixels / (variance + cells.pixels * (_MISFIT * (state.linear[1] - state.linear[0])) ** 2)

    def solved(linear: jax.Array, _: None) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        light = 1 + linear[2] * cells.x + linear[3] * cells.y
        step = (linear[1] - linear[0]) * light
        level = linear[0] + (linear[1] - linear[0]) * basis.pilot
        levels = jnp.stack([(1 - basis.pilot) * light, basis.pilot * light, level * cells.x, level * cells.y])
        columns = jnp.concatenate([levels, even * step, odd * step])
        normal = (columns * weight) @ columns.T
        inverse = scaled_inverse(normal + jnp.diag(PRECISIONS))
        residual = cells.value - level * light
        strength = inverse @ (columns @ (weight * residual))
        return linear.at[:_LEVELS].add(strength[:_LEVELS]), (linear, step, columns, normal, inverse, residual, strength)

    # light is a factor: where the pilot has got it wrong, the second pass starts from the right one
    _, passes = jax.lax.scan(solved, state.linear, None, length=2)
    levels, step, columns, normal, inverse, residual, strength = (a[-1] for a in passes)
    left = residual - strength @ columns
    degrees = jnp.maximum((cells.pixels > 0).sum() - jnp.trace(inverse @ normal), 1.0)
    linear_fit = LinearFit(
        shape=shape,
        cells=cells,
        pilot=basis.pilot,
        step=step,
        levels=levels,
        weight=weight,
        noisy=weight**2 * variance / jnp.maximum(cells.pixels, 1.0),
        columns=columns,
        inverse=inverse,
        residual=residual,
        left=left,
        strength=strength,
        chi2=(cells.pixels / variance * left**2).sum(),
        degrees=degrees,
    )
    return linear_fit, _structure(columns, weight, inverse, normal, cells.value - tested.value, tested.design)


def without_glare(fit: LinearFit) -> FreeCurve:
    """The curve as it is."""
    covariance = fit.inverse @ ((fit.columns * fit.noisy) @ fit.columns.T) @ fit.inverse
    return per_step(fit, fit.strength, jnp.pad(covariance, ((0, 1), (0, 1))), jnp.ones(()))


def per_step(fit: LinearFit, strength: jax.Array, covariance: jax.Array, radius: jax.Array) -> FreeCurve:
    """The curve relative to the fitted step, whose own error is included. covariance: (p + 1,) squared, ln radius last."""
    before = fit.levels[1] - fit.levels[0]
    now = before + strength[1] - strength[0]
    relative = strength[_LEVELS:] * before / now
    scaling = jnp.append(jnp.full(EVEN + ODD, before / now), 1.0)
    by_step = jnp.append(relative, 0.0) / now
    jacobian = jnp.concatenate(
        [by_step[:, None], -by_step[:, None], jnp.zeros((EVEN + ODD + 1, 2)), jnp.diag(scaling)], 1
    )
    shape = fit.shape._replace(radius=radius)
    levels = fit.levels[:_LEVELS] + strength[:_LEVELS]
    return FreeCurve(shape, relative[:EVEN], relative[EVEN:], levels, jacobian @ covariance @ jacobian.T)


def _structure(
    columns: jax.Array, weight: jax.Array, inverse: jax.Array, normal: jax.Array, residual: jax.Array, design: jax.Array
) -> Structure:
    """Quadratic form of the scores, s' A^-1 s; under noise their covariance is F less what the tested fit has taken up."""
    score = columns @ (weight * residual)
    shared = (columns * weight) @ design.T
    taken = shared @ scaled_inverse((design * weight) @ design.T) @ shared.T
    spread = inverse @ (normal - taken)
    return Structure(score @ inverse @ score, jnp.trace(spread), 2 * jnp.sum(spread * spread.T))


def _precisions() -> np.ndarray:
    """Of the priors, on levels and light (none), even and odd strengths, and the edge's place (none)."""
    core = _PRIOR * np.exp(-((PLACES / _REACH) ** 2) / 2)
    odd = np.minimum(core, _PRIOR_ODD)
    return np.concatenate([np.zeros(_LEVELS), core**-2, [_PRIOR_TAIL**-2, PRIOR_GLARE**-2], odd**-2, [0.0]])


PRECISIONS = _precisions()
"""(p,)"""
