"""Masking and shadowing: how much of a rough surface hides the rest (MODEL 6)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.numerics.interpolate import lagrange_basis

Masking = Literal["smith", "smith-separable", "van-ginneken"] | None
MASKINGS: tuple[Masking, ...] = ("smith", "smith-separable", "van-ginneken", None)

SlopeDensity = Callable[[jax.Array], jax.Array]
"""P22 of an isotropic surface as a function of the SQUARED slope."""

_STEPS = np.linspace(-3.7, 3.7, 201)  # of the exp-sinh rule: rounding even for a P22 as steep as exp(-slope^8)
_FARTHEST = 1e9  # cot theta: Lambda is 0 long before
_NEAREST = 1e-30  # cosine: keeps Lambda finite at the horizon, where 1 / Lambda is 0 for every purpose

# The table's grid: even in asinh(cot / (scale _KNEE)), that is in cot close to the horizon and in its logarithm elsewhere
_NODES, _KNEE, _REACH = 2048, 1e-2, 1e4


def smith_lambda(slope_density: SlopeDensity, scale: jax.Array, cot: jax.Array) -> jax.Array:
    """Smith's Lambda of any isotropic slope density at mu = cot theta, by its integral (MODEL 6).

    Lambda = (2 / mu) integral over r > mu of r P22(r) [sqrt(r^2 - mu^2) - mu acos(mu / r)]; written over the height
    y = sqrt(r^2 - mu^2), on an exp-sinh grid (double exponential rule) about the scale on which P22 falls. Relative
    error below 1e-10 (tests).
    """
    scale = jax.lax.stop_gradient(scale)  # where the integrand is looked at does not change the integral
    mu = jnp.clip(cot, _NEAREST, _FARTHEST)[..., None]
    y = jnp.sqrt(scale**2 + mu**2) * np.exp(np.pi / 2 * np.sinh(_STEPS))
    step = (_STEPS[1] - _STEPS[0]) * np.pi / 2 * np.cosh(_STEPS)
    ratio = y / mu
    # y - mu atan(y / mu), without cancellation where y is much smaller
    excess = jnp.where(
        ratio < 1e-2, mu * ratio**3 * (1 / 3 - ratio**2 * (1 / 5 - ratio**2 / 7)), y - mu * jnp.arctan(ratio)
    )
    inside = slope_density(mu**2 + y**2) * excess * y**2 * step
    return 2 / mu[..., 0] * jnp.sum(inside, axis=-1)


def tabulated_lambda(slope_density: SlopeDensity, scale: jax.Array, cos: jax.Array) -> jax.Array:
    """`smith_lambda` in directions of cosine `cos` > 0 to the normal: for a few by the integral, for more than a table
    has nodes by a table and cubic interpolation, to 1e-9 of 1 / (1 + Lambda) for scales from 1e-4 to 1."""
    cot = cot_of(cos)
    if cot.size <= _NODES:
        return smith_lambda(slope_density, scale, cot)
    return interpolated_lambda(lambda cot: smith_lambda(slope_density, scale, cot), scale, cot, _NODES)


def interpolated_lambda(
    function: Callable[[jax.Array], jax.Array], scale: jax.Array, cot: jax.Array, nodes: int
) -> jax.Array:
    """Lambda at cot theta > 0 from a table of `function` (Lambda of cot theta) at so many nodes; 256 give 1 / (1 + Lambda)
    to 1e-6."""
    scale = jax.lax.stop_gradient(scale)  # nor do the table's places change the function
    spacing = np.arcsinh(_REACH / _KNEE) / (nodes - 1)
    nus = np.maximum(_KNEE * np.sinh(spacing * np.arange(nodes)), 1e-11)
    # nu (1 + Lambda) has a finite limit at the horizon, and is nu itself far from it
    table = jnp.log(nus * (1 + function(scale * nus)))
    nu = jnp.minimum(cot / scale, _REACH)
    place = jnp.arcsinh(nu / _KNEE) / spacing
    return jnp.maximum(jnp.exp(_cubic(table, place)) / nu - 1, 0.0)


def _cubic(table: jax.Array, place: jax.Array) -> jax.Array:
    """Lagrange's cubic through the four entries around `place`."""
    left = jax.lax.stop_gradient(jnp.clip(jnp.floor(place), 1, table.size - 3))
    first = left.astype(int) - 1
    weights = lagrange_basis(np.arange(-1.0, 3.0), place - left)
    return sum((table[first + k] * weight for k, weight in enumerate(weights)), jnp.zeros(()))


def cot_of(cos: jax.Array) -> jax.Array:
    """cot theta of directions with cos theta in (0, 1]; large but finite along the normal."""
    cos = jnp.maximum(cos, _NEAREST)
    return cos / jnp.sqrt(jnp.maximum((1 - cos) * (1 + cos), _FARTHEST**-2))


def g2(masking: Masking, lambda_i: jax.Array, lambda_o: jax.Array, azimuth: jax.Array) -> jax.Array:
    """Joint masking of light and view from their Lambdas; azimuth: between them about the normal, rad, in [0, pi].

    "smith": height-correlated 1 / (1 + L_i + L_o) (Ross et al. 2005; Heitz 2014, (99)). "smith-separable":
    G1(i) G1(o). "van-ginneken": 1 / (1 + max + lambda(azimuth) min), lambda = 4.41 a / (4.41 a + 1) (van Ginneken et
    al. 1998; Heitz 2014, section 5.3): no double counting where light and view share a side. None: 1.
    """
    if masking is None:
        return jnp.ones_like(lambda_i + lambda_o)
    if masking == "smith":
        return 1 / (1 + lambda_i + lambda_o)
    if masking == "smith-separable":
        return 1 / ((1 + lambda_i) * (1 + lambda_o))
    correlation = 4.41 * azimuth / (4.41 * azimuth + 1)
    return 1 / (1 + jnp.maximum(lambda_i, lambda_o) + correlation * jnp.minimum(lambda_i, lambda_o))
