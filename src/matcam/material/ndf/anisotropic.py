"""Facets that tilt more one way than the other: brushed metal, and whatever is turned on a lathe (Heitz 2014)."""

from __future__ import annotations

from abc import abstractmethod

import equinox as eqx
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading
from matcam.material.ndf.beckmann import beckmann_lambda
from matcam.material.ndf.distribution import SlopeDistribution
from matcam.material.ndf.ggx import ggx_lambda

_FLAT = 1e-30  # squared sine of a direction that is the normal itself


class StretchedSlopes(SlopeDistribution):
    """An isotropic distribution of slopes, stretched by alpha_along and alpha_across.

    Smith's masking of a stretched surface is that of the isotropic one at the roughness projected on the direction,
    alpha^2 = alpha_along^2 cos^2 phi + alpha_across^2 sin^2 phi (Heitz 2014).
    """

    alpha_along: eqx.AbstractVar[jax.Array]
    alpha_across: eqx.AbstractVar[jax.Array]

    @abstractmethod
    def unit_density(self, slope2: jax.Array) -> jax.Array:
        """P22 of the surface of roughness 1 at its squared slope."""

    @abstractmethod
    def unit_lambda(self, nu: jax.Array) -> jax.Array:
        """Its Lambda at cot theta = nu."""

    def density(self, along: jax.Array, across: jax.Array) -> jax.Array:
        """P22 of the slopes divided by their roughnesses."""
        stretched2 = (along / self.alpha_along) ** 2 + (across / self.alpha_across) ** 2
        return self.unit_density(stretched2) / (self.alpha_along * self.alpha_across)

    def lambdas(self, seen: Shading) -> tuple[jax.Array, jax.Array]:
        """At each direction's projected roughness."""
        (x, y), (offset_x, offset_y) = _tangents(seen)
        return tuple(  # type: ignore[return-value]
            self._lambda(cos, offset_x + sign * x, offset_y + sign * y)
            for cos, sign in ((seen.cos_i, 1), (seen.cos_o, -1))
        )

    def _lambda(self, cos: jax.Array, along: jax.Array, across: jax.Array) -> jax.Array:
        alpha_tan = jnp.sqrt((self.alpha_along * along) ** 2 + (self.alpha_across * across) ** 2 + _FLAT)
        return self.unit_lambda(jnp.maximum(cos, _FLAT) / alpha_tan)

    @property
    def finest(self) -> jax.Array:
        """The smaller roughness."""
        return jnp.minimum(self.alpha_along, self.alpha_across)


class AnisotropicGGX(StretchedSlopes):
    """GGX with two roughnesses, along the surface's first tangent and across it: slopes, (0, 1]."""

    alpha_along: jax.Array
    alpha_across: jax.Array

    def __init__(self, alpha_along: ArrayLike, alpha_across: ArrayLike):
        self.alpha_along, self.alpha_across = _checked(alpha_along, alpha_across)

    def unit_density(self, slope2: jax.Array) -> jax.Array:
        """1 / (pi (1 + slope^2)^2)."""
        return 1 / (jnp.pi * (1 + slope2) ** 2)

    def unit_lambda(self, nu: jax.Array) -> jax.Array:
        """GGX's closed form."""
        return ggx_lambda(nu)

    def __repr__(self) -> str:
        return f"AnisotropicGGX(alpha_along={self.alpha_along!s}, alpha_across={self.alpha_across!s})"


class AnisotropicBeckmann(StretchedSlopes):
    """Beckmann with two roughnesses, along the surface's first tangent and across it: slopes, (0, 1]."""

    alpha_along: jax.Array
    alpha_across: jax.Array

    def __init__(self, alpha_along: ArrayLike, alpha_across: ArrayLike):
        self.alpha_along, self.alpha_across = _checked(alpha_along, alpha_across)

    def unit_density(self, slope2: jax.Array) -> jax.Array:
        """exp(-slope^2) / pi."""
        return jnp.exp(-slope2) / jnp.pi

    def unit_lambda(self, nu: jax.Array) -> jax.Array:
        """Beckmann's closed form."""
        return beckmann_lambda(nu)

    def __repr__(self) -> str:
        return f"AnisotropicBeckmann(alpha_along={self.alpha_along!s}, alpha_across={self.alpha_across!s})"


def _tangents(seen: Shading) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
    """Light and view along the surface's tangents are offset + and - a part; returns (part, offset)."""
    slope2 = seen.slope_along**2 + seen.slope_across**2
    mirror = slope2 == 0  # there the half vector's azimuth counts as 0
    slope = jnp.sqrt(jnp.where(mirror, 1.0, slope2))
    cos_phi, sin_phi = (
        jnp.where(mirror, 1.0, seen.slope_along / slope),
        jnp.where(mirror, 0.0, seen.slope_across / slope),
    )
    cos_h = jax.lax.rsqrt(1 + slope2)
    away = jnp.sin(seen.theta_d) * jnp.cos(seen.phi_d) * cos_h
    beside = jnp.sin(seen.theta_d) * jnp.sin(seen.phi_d)
    offset = jnp.cos(seen.theta_d) * cos_h
    part = away * cos_phi - beside * sin_phi, away * sin_phi + beside * cos_phi
    return part, (offset * seen.slope_along, offset * seen.slope_across)


def _checked(alpha_along: ArrayLike, alpha_across: ArrayLike) -> tuple[jax.Array, jax.Array]:
    along = checks.scalar("alpha_along", checks.within("alpha_along", alpha_along, 0, 1, open_low=True))
    across = checks.scalar("alpha_across", checks.within("alpha_across", alpha_across, 0, 1, open_low=True))
    return along, across
