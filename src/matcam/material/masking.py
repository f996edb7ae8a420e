"""Masking and shadowing: how much of a rough surface hides the rest (MODEL 6)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from matcam._jax import jax, jnp

Masking = Literal["smith", "smith-separable", "van-ginneken"] | None
MASKINGS: tuple[Masking, ...] = ("smith", "smith-separable", "van-ginneken", None)

_STEPS = np.linspace(-3.7, 3.7, 121)


def smith_lambda(slope_density: Callable[[jax.Array], jax.Array], scale: jax.Array, theta: jax.Array) -> jax.Array:
    """Smith's Lambda of any isotropic slope density P22 at `theta` rad from the normal.

    Lambda = (2 / mu) integral over r > mu of r P22(r) [sqrt(r^2 - mu^2) - mu acos(mu / r)], mu = cot theta; written
    over the height y = sqrt(r^2 - mu^2), on an exp-sinh grid (double exponential rule) about the scale on which P22
    falls. Relative error below 1e-10 for GGX and Gaussian slopes (tests).
    """
    mu = jnp.clip(1 / jnp.tan(jnp.maximum(theta, 1e-9)), 1e-300)[..., None]  # 1e-9 rad: Lambda is 0 long before
    log_y = np.pi / 2 * np.sinh(_STEPS)
    y = jnp.sqrt(scale**2 + mu**2) * np.exp(log_y)
    step = (_STEPS[1] - _STEPS[0]) * np.pi / 2 * np.cosh(_STEPS)
    ratio = y / mu
    # y - mu atan(y / mu), without cancellation where y is much smaller
    excess = jnp.where(
        ratio < 1e-2, mu * ratio**3 * (1 / 3 - ratio**2 * (1 / 5 - ratio**2 / 7)), y - mu * jnp.arctan(ratio)
    )
    inside = slope_density(jnp.hypot(mu, y)) * excess * y**2 * step
    return 2 / mu[..., 0] * jnp.sum(inside, axis=-1)


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
