"""Departure of a diffuse part from Lambert's law: smooth, isotropic and reciprocal.

Polynomials of the second order model roughness and scattering below the surface (Koenderink and van Doorn 1998), two
fifth powers the loss in a clear coat at grazing light and view (Burley 2012). All vanish if both directions are the
normal.
"""

from __future__ import annotations

from jax.typing import ArrayLike

from matcam.core.jax import jax, jnp

TERMS = 6
"""Number of terms."""


def departure(coefficients: ArrayLike, cos_i: ArrayLike, cos_o: ArrayLike, theta_d: ArrayLike) -> jax.Array:
    """Compute a diffuse part over the Lambertian one of its albedo at normal incidence, no unit, at least 0.

    Args:
        coefficients: coefficients of the terms, no unit, (TERMS,), or (0,) for a Lambertian part.
        cos_i: cosine of the angle of incidence, no unit.
        cos_o: cosine of the viewing angle, no unit.
        theta_d: half the angle between light and view, rad.

    Returns:
        The ratio, of the common shape of the angles. Source: Koenderink and van Doorn, "Phenomenological description of
        bidirectional surface reflection", JOSA A 15 (1998), their rho^2 being 1 - cos; Burley, SIGGRAPH course 2012.

    Example:
        >>> float(departure([0.0, 0.0, 0.0, 0.0, -0.5, 0.0], 1.0, 0.0, 0.4))
        0.5
    """
    coefficients, cos_i, cos_o = (jnp.asarray(one) for one in (coefficients, cos_i, cos_o))
    if coefficients.size == 0:
        return jnp.ones(())
    return jnp.maximum(1 + sum(c * t for c, t in zip(coefficients, terms(cos_i, cos_o, theta_d), strict=True)), 0.0)


def terms(cos_i: jax.Array, cos_o: jax.Array, theta_d: ArrayLike) -> tuple[jax.Array, ...]:
    """Compute the terms of `departure`. Arguments as there."""
    low_i, low_o = 1 - jnp.clip(cos_i, 0.0, 1.0), 1 - jnp.clip(cos_o, 0.0, 1.0)
    # sin sin cos of the azimuth between the two, over the factor that makes it rho_i rho_o cos
    towards = (jnp.cos(2 * jnp.asarray(theta_d)) - cos_i * cos_o) / jnp.sqrt((2 - low_i) * (2 - low_o))
    return (
        low_i + low_o,
        low_i * low_o,
        towards,
        2 * towards**2 - low_i * low_o,
        low_i**5 + low_o**5,
        low_i**5 * low_o**5,
    )
