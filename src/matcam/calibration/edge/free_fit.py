"""The free curve fitted to the cells: one linear solve, veiling glare where there is any, and what noise does to the result.

Normal priors keep what the cells do not determine near the pilot: 10 % of the step on a strength in the middle of the core,
falling off with the distance, because that is where a lens that is not Gaussian differs most. The covariance is that of the
estimator under noise, A^-1 X W V W X' A^-1 with A = X W X' + prior, not the wider one of a belief: it is what repeated pictures
show. What the priors bias stands in docs/edge.md, by test.

Glare is a wide Gaussian. A row of radii is tried on what the free curve leaves; where one raises the likelihood by 5 sigma,
the radius is refined and joins the fit. Free glare that is not there would cost every MTF50 half of its accuracy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.calibration.edge.free_curve import (
    EVEN,
    GLARE,
    ODD,
    PLACES,
    CoreShape,
    FreeCurve,
    edge_basis,
    glare_edge,
    line_width,
)
from matcam.calibration.edge.geometry import EdgeCells
from matcam.calibration.edge.maximum_likelihood import EdgeModel, Noise
from matcam.core.jax import jax, jnp
from matcam.numerics.linalg import scaled_inverse

FOUND = 25.0
"""Rise of 2 ln likelihood, 5 sigma, that glare must bring to be believed."""
_PRIOR, _REACH = 0.1, 1.6  # of the step, on strengths of the core; falls off as a Gaussian of 1.6 s
_PRIOR_ODD = 0.03  # of the step, at most
_PRIOR_TAIL = 0.3  # of the step
_PRIOR_GLARE = 0.1  # of the step
_MISFIT = 2e-4  # of the step: what bumps of 0.6 s cannot describe; weighs only in pictures with less noise than that
_LEVELS = 4
_COLUMN = _LEVELS + GLARE
"""Where glare stands among the columns; 0 until it is looked for."""
_PRIOR_RADIUS = 1.0  # of ln radius
_NARROWEST, _NARROWEST_OF_SCALE, _WIDEST = 4.0, 3.0, 110.0  # px, s, px: radii that are tried
_CANDIDATES, _REFINEMENTS = 9, 3


class LinearFit(NamedTuple):
    """Hold the solution without glare: n cells, p columns.

    Attributes:
        shape: of the basis.
        cells: about the pilot's edge.
        pilot: (n,) P.
        step: (n,) bright less dark, in this light.
        levels: (5,) `State.linear` about which the columns stand.
        weight: (n,).
        noisy: (n,) weight^2 times the variance of a cell.
        columns: (p, n) levels and light, even strengths, odd strengths.
        inverse: (p, p) A^-1.
        residual: (n,) before the fit.
        left: (n,) after the fit.
        strength: (p,).
        chi2: of the cells, under the noise.
        degrees: of freedom: cells less what the fit has taken up.
    """

    shape: CoreShape
    cells: EdgeCells
    pilot: jax.Array
    step: jax.Array
    levels: jax.Array
    weight: jax.Array
    noisy: jax.Array
    columns: jax.Array
    inverse: jax.Array
    residual: jax.Array
    left: jax.Array
    strength: jax.Array
    chi2: jax.Array
    degrees: jax.Array


class Structure(NamedTuple):
    """Hold what the free curve finds in another fit's residuals.

    Attributes:
        found: rise of 2 ln likelihood.
        mean: of the same quantity, if the other model were right.
        variance: of the same quantity, if the other model were right.
    """

    found: jax.Array
    mean: jax.Array
    variance: jax.Array


class GlareCandidate(NamedTuple):
    """Hold the best of a row of radii.

    Attributes:
        log_radius: ln px.
        rise: of 2 ln likelihood.
        spacing: of the row, in ln radius.
    """

    log_radius: jax.Array
    rise: jax.Array
    spacing: jax.Array


def linear_fit(
    cells: EdgeCells, at: EdgeModel, noise: Noise, shape: CoreShape, tested: EdgeModel
) -> tuple[LinearFit, Structure]:
    """Fit the free curve, and judge another model by it.

    at: Gaussian model about which the curve is fitted. tested: the model that is judged.
    """
    state = at.state
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
        inverse = scaled_inverse(normal + jnp.diag(_PRECISIONS))
        residual = cells.value - level * light
        strength = inverse @ (columns @ (weight * residual))
        return linear.at[:_LEVELS].add(strength[:_LEVELS]), (linear, step, columns, normal, inverse, residual, strength)

    # light is a factor: where the pilot has got it wrong, the second pass starts from the right one
    _, passes = jax.lax.scan(solved, state.linear, None, length=2)
    levels, step, columns, normal, inverse, residual, strength = (a[-1] for a in passes)
    left = residual - strength @ columns
    degrees = jnp.maximum((cells.pixels > 0).sum() - jnp.trace(inverse @ normal), 1.0)
    fit = LinearFit(
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
    return fit, _structure(columns, weight, inverse, normal, cells.value - tested.value, tested.design)


def curve_without_glare(fit: LinearFit) -> FreeCurve:
    """Return the curve as it is."""
    covariance = fit.inverse @ ((fit.columns * fit.noisy) @ fit.columns.T) @ fit.inverse
    return _per_step(fit, fit.strength, jnp.pad(covariance, ((0, 1), (0, 1))), jnp.ones(()))


def glare_candidate(fit: LinearFit) -> GlareCandidate:
    """Return the likeliest glare of a row of radii."""
    narrowest = _narrowest(fit)
    spacing = (jnp.log(_WIDEST) - narrowest) / (_CANDIDATES - 1)
    radii = narrowest + spacing * jnp.arange(_CANDIDATES)
    rises = _rises(fit, radii)
    best = jnp.argmax(rises)
    return GlareCandidate(radii[best], rises[best], spacing)


def curve_with_glare(fit: LinearFit, seen: GlareCandidate) -> FreeCurve:
    """Return the curve with glare near a candidate.

    The radius of the glare is one more parameter.
    """

    def refine(_: int, at: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        middle, width = at
        nearby = middle + width / 2 * jnp.array([-1.0, 0.0, 1.0])
        three = _rises(fit, nearby)
        bend = three[0] - 2 * three[1] + three[2]
        vertex = middle + width / 2 * jnp.clip((three[0] - three[2]) / jnp.where(bend < 0, 2 * bend, -1.0), -1, 1)
        better = jnp.where(bend < 0, vertex, nearby[jnp.argmax(three)])
        return jnp.clip(better, _narrowest(fit), jnp.log(_WIDEST)), width / 2

    log_radius, _ = jax.lax.fori_loop(0, _REFINEMENTS, refine, (seen.log_radius, seen.spacing))
    column, slope = jax.jvp(lambda r: _column(fit, r), (log_radius,), (jnp.ones(()),))
    full = fit.columns.at[_COLUMN].set(column)
    strength = scaled_inverse((full * fit.weight) @ full.T + jnp.diag(_PRECISIONS)) @ (
        full @ (fit.weight * fit.residual)
    )
    # at its best already: it only takes its part of the covariance
    full = jnp.concatenate([full, strength[_COLUMN] * slope[None]])
    inverse = scaled_inverse((full * fit.weight) @ full.T + jnp.diag(jnp.append(_PRECISIONS, _PRIOR_RADIUS**-2)))
    return _per_step(fit, strength, inverse @ ((full * fit.noisy) @ full.T) @ inverse, jnp.exp(log_radius))


def _per_step(fit: LinearFit, strength: jax.Array, covariance: jax.Array, radius: jax.Array) -> FreeCurve:
    """Return the curve relative to the fitted step.

    The step's own error is included. covariance: (p + 1,) squared, ln radius last.
    """
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
    """Return the scores' quadratic form s' A^-1 s and its moments.

    Under noise the covariance of the scores is the information less what the tested fit has absorbed.
    """
    score = columns @ (weight * residual)
    shared = (columns * weight) @ design.T
    absorbed = shared @ scaled_inverse((design * weight) @ design.T) @ shared.T
    spread = inverse @ (normal - absorbed)
    return Structure(score @ inverse @ score, jnp.trace(spread), 2 * jnp.sum(spread * spread.T))


def _rises(fit: LinearFit, log_radii: jax.Array) -> jax.Array:
    """Return the rise of 2 ln likelihood by glare of each radius.

    All else is refitted. There is no glare of negative strength.
    """
    columns = jax.vmap(lambda r: _column(fit, r))(log_radii)
    weighted = columns * fit.weight
    cross = weighted @ fit.columns.T
    alone = (weighted * columns).sum(1) + _PRIOR_GLARE**-2 - ((cross @ fit.inverse) * cross).sum(1)
    return jnp.maximum(weighted @ fit.left, 0.0) ** 2 / alone


def _column(fit: LinearFit, log_radius: jax.Array) -> jax.Array:
    """Return what glare of full strength would change."""
    return (glare_edge(jnp.exp(log_radius), fit.cells.distance, fit.cells.spread) - fit.pilot) * fit.step


def _narrowest(fit: LinearFit) -> jax.Array:
    """Return ln of the smallest radius that is tried, px."""
    return jnp.log(jnp.maximum(_NARROWEST, _NARROWEST_OF_SCALE * line_width(fit.shape)))


def _precisions() -> np.ndarray:
    """Return the priors' precisions (p,).

    Levels, light and the edge's place have none.
    """
    core = _PRIOR * np.exp(-((PLACES / _REACH) ** 2) / 2)
    odd = np.minimum(core, _PRIOR_ODD)
    return np.concatenate([np.zeros(_LEVELS), core**-2, [_PRIOR_TAIL**-2, _PRIOR_GLARE**-2], odd**-2, [0.0]])


_PRECISIONS = _precisions()
