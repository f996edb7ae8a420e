"""Departure of a diffuse part from Lambert's law: smooth, isotropic and reciprocal.

Polynomials of the second order model roughness and scattering below the surface (Koenderink and van Doorn 1998). Two
fifth powers model the loss in a clear coat at grazing light and view (Burley 2012). All terms vanish if light and view
are along the normal.
"""

from __future__ import annotations

from jax.typing import ArrayLike

from matcam.core.arrays.elementary import inverse_root, sine
from matcam.core.jax import jax, jnp

TERMS = 6
"""Number of terms of the departure: four polynomials and two fifth powers."""


def departure(coefficients: ArrayLike, cos_i: ArrayLike, cos_o: ArrayLike, theta_d: ArrayLike) -> jax.Array:
    """Compute the ratio of diffuse to Lambertian reflection, no unit.

    The ratio is 1 at normal incidence and view, and at least 0 everywhere.

    Args:
        coefficients: factors of the terms in the order of `terms`, no unit, (TERMS,), or (0,) for a Lambertian part.
        cos_i: cosine of the angle of incidence, no unit.
        cos_o: cosine of the viewing angle, no unit.
        theta_d: half the angle between light and view, rad.

    Returns:
        The ratio, in the shape to which the arguments broadcast; shape () for a Lambertian part.

    Source:
        Koenderink and van Doorn, "Phenomenological description of bidirectional surface reflection", JOSA A 15 (1998);
        rho^2 of this paper is 1 - cos theta. Burley, SIGGRAPH course 2012.

    Example:
        >>> float(departure([0.0, 0.0, 0.0, 0.0, -0.5, 0.0], 1.0, 0.0, 0.4))
        0.5
    """
    coefficients, cos_i, cos_o = (jnp.asarray(one) for one in (coefficients, cos_i, cos_o))
    if coefficients.size == 0:
        return jnp.ones(())
    return jnp.maximum(1 + sum(c * t for c, t in zip(coefficients, terms(cos_i, cos_o, theta_d), strict=True)), 0.0)


def terms(cos_i: jax.Array, cos_o: jax.Array, theta_d: ArrayLike) -> tuple[jax.Array, ...]:
    """Compute the terms that `departure` multiplies by the coefficients. The arguments are those of `departure`."""
    low_i, low_o = 1 - jnp.clip(cos_i, 0.0, 1.0), 1 - jnp.clip(cos_o, 0.0, 1.0)
    # sin_i sin_o cos(azimuth difference), divided by the factor that converts sin_i sin_o to rho_i rho_o
    towards = (1 - 2 * sine(jnp.asarray(theta_d)) ** 2 - cos_i * cos_o) * inverse_root((2 - low_i) * (2 - low_o))
    return (
        low_i + low_o,
        low_i * low_o,
        towards,
        2 * towards**2 - low_i * low_o,
        low_i**5 + low_o**5,
        low_i**5 * low_o**5,
    )
