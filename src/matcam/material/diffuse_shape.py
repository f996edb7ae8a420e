"""How a diffuse part departs from Lambert's law: smooth in both directions, isotropic, and the same when they change places.

Polynomials of the second order follow what roughness and scattering below the surface do (Koenderink and van Doorn 1998), two
fifth powers what a clear coat takes at grazing light and view (Burley 2012). All vanish where both directions are the normal.
"""

from __future__ import annotations

from jax.typing import ArrayLike

from matcam.core.jax import jax, jnp

TERMS = 6
"""Number of terms."""


def departure(coefficients: ArrayLike, cos_i: ArrayLike, cos_o: ArrayLike, theta_d: ArrayLike) -> jax.Array:
    """Return a diffuse part over Lambert's of the albedo that it has along the normal, no unit, at least 0.

    Args:
        coefficients: of the terms, no unit, (TERMS,) or (0,): none, it is Lambert's.
        cos_i: cosine of the light's angle to the normal, no unit.
        cos_o: cosine of the view's angle to the normal, no unit.
        theta_d: half the angle between light and view, rad.

    Returns:
        The ratio, of the shape that the angles have together. Source: Koenderink and van Doorn, "Phenomenological description
        of bidirectional surface reflection", JOSA A 15 (1998), their rho^2 being 1 - cos; Burley, SIGGRAPH course 2012.

    Example:
        >>> float(departure([0.0, 0.0, 0.0, 0.0, -0.5, 0.0], 1.0, 0.0, 0.4))
        0.5
    """
    coefficients, cos_i, cos_o = (jnp.asarray(one) for one in (coefficients, cos_i, cos_o))
    if coefficients.size == 0:
        return jnp.ones(())
    return jnp.maximum(1 + sum(c * t for c, t in zip(coefficients, terms(cos_i, cos_o, theta_d), strict=True)), 0.0)


def terms(cos_i: jax.Array, cos_o: jax.Array, theta_d: ArrayLike) -> tuple[jax.Array, ...]:
    """Return the terms of `departure`. Arguments as there."""
    low_i, low_o = 1 - jnp.clip(cos_i, 0.0, 1.0), 1 - jnp.clip(cos_o, 0.0, 1.0)
    # sin sin cos of the azimuth between the two, over what makes it rho_i rho_o cos
    towards = (jnp.cos(2 * jnp.asarray(theta_d)) - cos_i * cos_o) / jnp.sqrt((2 - low_i) * (2 - low_o))
    return (
        low_i + low_o,
        low_i * low_o,
        towards,
        2 * towards**2 - low_i * low_o,
        low_i**5 + low_o**5,
        low_i**5 * low_o**5,
    )
