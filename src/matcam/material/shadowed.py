"""A lobe whose masking is free: not Smith's, which follows from the lobe, but any smooth function of the angle.

Bagher, Snyder & Nowrouzezahrai (2016) explain measured materials by such "free shadowing"; it is what a camera's loss at
grazing angles has to be told from.
"""

from __future__ import annotations

from jax.typing import ArrayLike

from matcam._jax import jax, jnp
from matcam.material.ndf import NDF
from matcam.material.splines import combined, cubic_basis

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
