"""A lobe of a known family, bent: its density of slopes times a smooth factor, so that it can follow data of any family.

A lobe whose masking is free: not Smith's, which follows from the lobe, but any smooth function of the angle.

Bagher, Snyder & Nowrouzezahrai (2016) explain measured materials by such "free shadowing"; it is what a camera's loss at
grazing angles has to be told from.
"""

from __future__ import annotations

import numpy as np
from jax.typing import ArrayLike

from matcam.core.jax import jax, jnp
from matcam.material.masking import tabulated_lambda
from matcam.material.ndf.distribution import NDF, SlopeNDF
from matcam.numerics.interpolate import combined, cubic_basis

KNOTS = 12
"""Numbers of a bend."""
_FINEST, _LAST = 0.0015, 1.0
"""Slopes at which the knots become even in the logarithm, and at which they end."""
_END = float(np.arcsinh(_LAST / _FINEST))
_NODES = np.polynomial.legendre.leggauss(160)


class BentNDF(SlopeNDF):
    """P22 of `base` times exp(sum_k bends_k B_k), normalised again; B_k: cubic B-splines even in asinh(slope / 0.0015), the
    first with slope 0 at the peak, constant beyond a slope of 1. bends: shape (KNOTS,); 0 leaves the base as it is."""

    base: NDF
    bends: jax.Array
    norm: jax.Array

    family = "bent"
    largest = 1.0

    def __init__(self, base: NDF, bends: jax.Array):
        self.base, self.bends = base, bends
        # the integral of P22 over the plane of slopes, on a grid that is even in asinh(slope / scale)
        scale = jnp.minimum(base.roughness, 0.3) / 4
        t = jnp.arcsinh(2e3 / scale) * (_NODES[0] + 1) / 2
        slope = scale * jnp.sinh(t)
        area = 2 * jnp.pi * slope * scale * jnp.cosh(t) * jnp.arcsinh(2e3 / scale) / 2 * _NODES[1]
        self.norm = jnp.sum(area * base.slope_density(slope**2) * jnp.exp(_bend(bends, slope**2)))

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """Base times bend over their integral."""
        return self.base.slope_density(slope2) * jnp.exp(_bend(self.bends, slope2)) / self.norm

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """By the integral over slopes."""
        return tabulated_lambda(self.slope_density, self.base.roughness, cos)

    @property
    def roughness(self) -> jax.Array:
        """The base's."""
        return self.base.roughness

    def __repr__(self) -> str:
        return f"BentNDF({self.base!r}, {jnp.asarray(self.bends).tolist()!r})"


def bend_basis(slope2: jax.Array) -> list[jax.Array]:
    """The KNOTS functions B_k at squared slopes: cubic B-splines, local, smooth to the second derivative; mirrored at 0."""
    small = slope2 < 1e-24  # the root's derivative at 0
    slope = jnp.where(small, 0.0, jnp.sqrt(jnp.where(small, 1.0, slope2)))
    place = jnp.minimum(jnp.arcsinh(slope / _FINEST) / _END, 1.0) * (KNOTS - 1)
    return cubic_basis(place, KNOTS)


def _bend(bends: jax.Array, slope2: jax.Array) -> jax.Array:
    return combined(bends, bend_basis(slope2))


SHADOWS = 8
"""Numbers of a free masking."""


class ShadowedNDF(NDF):
    """D of `base`; ln G1 = -sum_k shadows_k B_k(1 - cos theta), shape (SHADOWS,), for "smith-separable" masking. G1 may
    exceed 1: what the strength of each picture leaves to it is its shape."""

    base: NDF
    shadows: jax.Array

    family = "shadowed"
    largest = 1.0

    def d(self, theta_h: ArrayLike) -> jax.Array:
        """The base's."""
        return self.base.d(theta_h)

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """The base's."""
        return self.base.slope_density(slope2)

    def coordinate(self, theta_h: jax.Array) -> jax.Array:
        """The base's."""
        return self.base.coordinate(theta_h)

    def flattening(self, theta_h: jax.Array) -> jax.Array:
        """The base's."""
        return self.base.flattening(theta_h)

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """1 / G1 - 1."""
        place = (1 - jnp.clip(cos, 0.0, 1.0)) * (SHADOWS - 1)
        return jnp.expm1(combined(self.shadows, cubic_basis(place, SHADOWS)))

    @property
    def roughness(self) -> jax.Array:
        """The base's."""
        return self.base.roughness

    def __repr__(self) -> str:
        return f"ShadowedNDF({self.base!r}, {jnp.asarray(self.shadows).tolist()!r})"
