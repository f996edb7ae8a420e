"""Veiling glare round an edge: is there any, how much, and how wide?

Glare is a wide Gaussian. A row of radii is tried on what the free curve leaves; where one raises the likelihood by 5 sigma,
the radius is refined and joins the fit. Free glare that is not there would cost every MTF50 half of its accuracy.
"""

from __future__ import annotations

from typing import NamedTuple

from matcam._jax import jax, jnp
from matcam.calibration.free_core import glare_edge, scale
from matcam.calibration.free_fit import COLUMN, PRECISIONS, PRIOR_GLARE, FreeCurve, LinearFit, per_step
from matcam.calibration.maximum_likelihood import scaled_inverse

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
