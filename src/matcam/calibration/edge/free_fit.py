"""The free curve fitted to the cells: one linear solve, and what noise does to its result.

Normal priors keep what the cells do not determine near the pilot: 10 % of the step on a strength in the middle of the core,
falling off with the distance, because that is where a lens that is not Gaussian differs most. The covariance is
that of the estimator under noise, A^-1 X W V W X' A^-1 with A = X W X' + prior, not the wider one of a belief: it is what
repeated pictures show. What the priors bias stands in docs/edge.md, by test.

Veiling glare round an edge: is there any, how much, and how wide?

Glare is a wide Gaussian. A row of radii is tried on what the free curve leaves; where one raises the likelihood by 5 sigma,
the radius is refined and joins the fit. Free glare that is not there would cost every MTF50 half of its accuracy.

What a fitted edge response says: ESF, LSF, MTF and MTF50, each with its standard deviation under noise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from matcam.calibration.edge.free_basis import (
    EVEN,
    GLARE,
    ODD,
    PLACES,
    Shape,
    edge_basis,
    glare_edge,
    line_basis,
    scale,
    transfer_basis,
)
from matcam.calibration.edge.geometry import Cells
from matcam.calibration.edge.maximum_likelihood import Model, Noise, State
from matcam.core.jax import jax, jnp
from matcam.numerics.linalg import scaled_inverse

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


FOUND = 25.0
"""Rise of 2 ln likelihood, 5 sigma, that glare must bring to be believed."""
_PRIOR_RADIUS = 1.0  # of ln radius
_NARROWEST, _NARROWEST_OF_SCALE, _WIDEST = 4.0, 3.0, 110.0  # px, s, px: radii that are tried
_CANDIDATES, _REFINEMENTS = 9, 3


class Look(NamedTuple):
    """The best of a row of radii."""

    log_radius: jax.Array
    gain: jax.Array
    """Rise of 2 ln likelihood."""
    spacing: jax.Array
    """Of the row, in ln radius."""


def look(fit: LinearFit) -> Look:
    """Try a row of radii."""
    narrowest = _narrowest(fit)
    spacing = (jnp.log(_WIDEST) - narrowest) / (_CANDIDATES - 1)
    radii = narrowest + spacing * jnp.arange(_CANDIDATES)
    gains = _gains(fit, radii)
    best = jnp.argmax(gains)
    return Look(radii[best], gains[best], spacing)


def with_glare(fit: LinearFit, seen: Look) -> FreeCurve:
    """The curve with glare near a radius that was seen; its radius is one more parameter."""

    def refine(_: int, at: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        middle, width = at
        nearby = middle + width / 2 * jnp.array([-1.0, 0.0, 1.0])
        three = _gains(fit, nearby)
        bend = three[0] - 2 * three[1] + three[2]
        vertex = middle + width / 2 * jnp.clip((three[0] - three[2]) / jnp.where(bend < 0, 2 * bend, -1.0), -1, 1)
        better = jnp.where(bend < 0, vertex, nearby[jnp.argmax(three)])
        return jnp.clip(better, _narrowest(fit), jnp.log(_WIDEST)), width / 2

    log_radius, _ = jax.lax.fori_loop(0, _REFINEMENTS, refine, (seen.log_radius, seen.spacing))
    column, slope = jax.jvp(lambda r: _column(fit, r), (log_radius,), (jnp.ones(()),))
    full = fit.columns.at[COLUMN].set(column)
    strength = scaled_inverse((full * fit.weight) @ full.T + jnp.diag(PRECISIONS)) @ (
        full @ (fit.weight * fit.residual)
    )
    # at its best already: it only takes its part of the covariance
    full = jnp.concatenate([full, strength[COLUMN] * slope[None]])
    inverse = scaled_inverse((full * fit.weight) @ full.T + jnp.diag(jnp.append(PRECISIONS, _PRIOR_RADIUS**-2)))
    return per_step(fit, strength, inverse @ ((full * fit.noisy) @ full.T) @ inverse, jnp.exp(log_radius))


def _gains(fit: LinearFit, log_radii: jax.Array) -> jax.Array:
    """Rise of 2 ln likelihood by glare of each radius, all else refitted; there is no glare of negative strength."""
    columns = jax.vmap(lambda r: _column(fit, r))(log_radii)
    weighted = columns * fit.weight
    cross = weighted @ fit.columns.T
    alone = (weighted * columns).sum(1) + PRIOR_GLARE**-2 - ((cross @ fit.inverse) * cross).sum(1)
    return jnp.maximum(weighted @ fit.left, 0.0) ** 2 / alone


def _column(fit: LinearFit, log_radius: jax.Array) -> jax.Array:
    return (glare_edge(jnp.exp(log_radius), fit.cells.distance, fit.cells.spread) - fit.pilot) * fit.step


def _narrowest(fit: LinearFit) -> jax.Array:
    return jnp.log(jnp.maximum(_NARROWEST, _NARROWEST_OF_SCALE * scale(fit.shape)))


FREQUENCIES = np.arange(81) / 64
"""cycles/px, at which an MTF is tabulated."""
_FINE = 11  # samples within one of their intervals: over 1.6e-3 cycles/px a curve bends by 1e-6


class Sampled(NamedTuple):
    """A curve and its standard deviation."""

    value: jax.Array
    std: jax.Array


def edge_response(curve: FreeCurve, distance: jax.Array) -> Sampled:
    """ESF at px from the edge: 0 on the dark side, 1 on the bright one."""
    basis = edge_basis(curve.shape, distance, jnp.zeros(()))
    return _combined(curve, basis.pilot, basis.even - basis.pilot, basis.odd)


def line_response(curve: FreeCurve, distance: jax.Array) -> Sampled:
    """LSF at px from the edge, 1/px."""
    basis = line_basis(curve.shape, distance)
    return _combined(curve, basis.pilot, basis.even - basis.pilot, basis.odd)


def transfer(curve: FreeCurve, f: jax.Array) -> tuple[Sampled, Sampled]:
    """Total MTF at f cycles/px along the normal, and that of the core alone, without glare.

    The modulus of a noisy number is too large by its noise: the noise's power is subtracted.
    """
    basis = transfer_basis(curve.shape, f)
    towards = basis.even - basis.pilot
    total = _combined(curve, basis.pilot, towards, jnp.zeros((ODD, f.size)))
    glare, share = basis.even[GLARE], curve.even[GLARE]
    # (M - g M_glare) / (1 - g)
    core_value = (total.value - share * glare) / (1 - share)
    slopes = towards.at[GLARE].set(core_value - basis.pilot) / (1 - share)
    core = Sampled(core_value, _std(curve, jnp.concatenate([slopes, jnp.zeros((ODD + 1, f.size))])))
    odd = _combined(curve, jnp.zeros(f.shape), jnp.zeros((EVEN, f.size)), basis.odd)
    return _modulus(total, odd), _modulus(core, Sampled(odd.value / (1 - share), odd.std / (1 - share)))


def half(value: jax.Array, response: Callable[[jax.Array], Sampled]) -> Sampled:
    """Lowest frequency, cycles/px, at which an MTF is one half, and its standard deviation; NaN where there is none.

    value: the MTF at `FREQUENCIES`. The interval in which it falls through one half is divided
    once more, so finely that a straight line does for the rest.
    """
    below = (value < 0.5).at[0].set(False)
    i, coarse = jnp.argmax(below), jnp.asarray(FREQUENCIES)
    grid = coarse[i - 1] + (coarse[i] - coarse[i - 1]) * jnp.linspace(0, 1, _FINE)
    fine = response(grid)
    k = jnp.argmax((fine.value <= 0.5).at[0].set(False))
    before, after, width = fine.value[k - 1], fine.value[k], grid[1] - grid[0]
    f = grid[k - 1] + width * (before - 0.5) / (before - after)
    std = (fine.std[k - 1] + fine.std[k]) / 2 / (before - after) * width
    return Sampled(jnp.where(below.any(), f, jnp.nan), jnp.where(below.any(), std, jnp.nan))


def _combined(curve: FreeCurve, pilot: jax.Array, even: jax.Array, odd: jax.Array) -> Sampled:
    columns = jnp.concatenate([even, odd, jnp.zeros((1, pilot.size))])
    return Sampled(pilot + curve.even @ even + curve.odd @ odd, _std(curve, columns))


def _std(curve: FreeCurve, columns: jax.Array) -> jax.Array:
    return jnp.sqrt(jnp.maximum(jnp.sum(columns * (curve.covariance @ columns), 0), 0.0))


def _modulus(even: Sampled, odd: Sampled) -> Sampled:
    power = even.value**2 - even.std**2 + odd.value**2 - odd.std**2
    size = jnp.sqrt(jnp.maximum(power, 0.0))
    safe = jnp.where(size > 0, size, 1.0)
    std = jnp.hypot(even.value * even.std, odd.value * odd.std) / safe
    return Sampled(size, jnp.where(size > even.std, std, jnp.hypot(even.std, odd.std)))
