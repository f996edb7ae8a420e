"""Masking and shadowing: the visible share of a rough surface (docs/model.md 6).

Smith's Lambda of a direction is the ratio of masked to visible facets. It is computed in closed form, by an integral
over the slopes of the lobe, or from a table of that integral. `g2` combines the Lambdas of light and view.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from matcam.core.arrays import constant, xp
from matcam.core.arrays.elementary import inverse_root
from matcam.core.registry import MASKING_MODELS

if TYPE_CHECKING:
    from matcam.core.jax import jax

Masking = str | None
"""Name of a masking model, one of `MASKING_MODELS`; None for no masking."""

MASKINGS: tuple[Masking, ...] = (*MASKING_MODELS, None)
"""Names of all masking models."""

SlopeDensity = Callable[["jax.Array"], "jax.Array"]
"""P22 of an isotropic surface as a function of the SQUARED slope."""

# steps of the exp-sinh rule, which is accurate to rounding even for a P22 as steep as exp(-slope^8)
_STEPS = np.linspace(-3.7, 3.7, 201)
_FARTHEST = 1e9  # largest cot theta; Lambda is 0 to rounding at smaller angles
NEAREST = 1e-30
"""Smallest cosine and cot theta. It keeps Lambda finite at the horizon, where 1 / Lambda is effectively 0."""


def smith_lambda(slope_density: SlopeDensity, scale: jax.Array, cot: jax.Array) -> jax.Array:
    """Compute Smith's Lambda of an isotropic slope density by quadrature (`smith_rule`).

    Args:
        slope_density: P22 as a function of the squared slope.
        scale: scale of the slope on which P22 decreases, shape ().
        cot: cot theta of the directions.
    """
    slope2, weight = smith_rule(scale, cot)
    return xp.sum(slope_density(slope2) * weight, axis=-1)


def smith_rule(scale: jax.Array, cot: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Compute squared slopes and weights of a quadrature of Lambda.

    Lambda is the sum of weight * P22(squared slope) over the last axis.

    Lambda = (2 / mu) integral over r > mu of r P22(r) [sqrt(r^2 - mu^2) - mu acos(mu / r)], where r is the slope and mu is
    cot theta. The variable of integration is y = sqrt(r^2 - mu^2), on an exp-sinh grid (double exponential rule) about the
    scale on which P22 decreases. The relative error is below 1e-10.

    Args:
        scale: scale of the slope on which P22 decreases, shape ().
        cot: cot theta of the directions.

    Source:
        docs/model.md 6.
    """
    scale = constant(scale)  # the nodes do not affect the integral
    mu = xp.clip(cot, NEAREST, _FARTHEST)[..., None]
    y = xp.sqrt(scale**2 + mu**2) * np.exp(np.pi / 2 * np.sinh(_STEPS))
    step = (_STEPS[1] - _STEPS[0]) * np.pi / 2 * np.cosh(_STEPS)
    ratio = y / mu
    # y - mu atan(y / mu), without cancellation where y is much smaller than mu
    excess = xp.where(
        ratio < 1e-2, mu * ratio**3 * (1 / 3 - ratio**2 * (1 / 5 - ratio**2 / 7)), y - mu * xp.arctan(ratio)
    )
    return mu**2 + y**2, 2 / mu * excess * y**2 * step


def cot_of(cos: jax.Array) -> jax.Array:
    """Compute cot theta from cos theta in (0, 1].

    Along the normal the result is large but finite.
    """
    cos = xp.maximum(cos, NEAREST)
    return cos * inverse_root(xp.maximum((1 - cos) * (1 + cos), _FARTHEST**-2))


def g2(masking: Masking, lambda_i: Any, lambda_o: Any, azimuth: Any) -> Any:
    """Compute the joint masking of light and view from their Lambdas.

    Args:
        masking: name of the model; None: no masking, the result is 1.
        lambda_i: Lambda of the light.
        lambda_o: Lambda of the view.
        azimuth: angle between light and view about the normal, rad, [0, pi].
    """
    if masking is None:
        return xp.ones_like(lambda_i + lambda_o)
    return MASKING_MODELS[masking](lambda_i, lambda_o, azimuth)


def height_correlated(lambda_i: jax.Array, lambda_o: jax.Array, azimuth: jax.Array) -> jax.Array:
    """Compute the height-correlated masking, 1 / (1 + lambda_i + lambda_o).

    The masking of both directions depends on the height of a facet (Ross et al. 2005; Heitz 2014, equation 99).
    """
    return 1 / (1 + lambda_i + lambda_o)


def separable(lambda_i: jax.Array, lambda_o: jax.Array, azimuth: jax.Array) -> jax.Array:
    """Compute the separable masking, 1 / ((1 + lambda_i) (1 + lambda_o)).

    The masking of the light is assumed to be independent of the masking of the view.
    """
    return 1 / ((1 + lambda_i) * (1 + lambda_o))


def azimuth_correlated(lambda_i: jax.Array, lambda_o: jax.Array, azimuth: jax.Array) -> jax.Array:
    """Compute the azimuth-correlated masking (van Ginneken et al. 1998; Heitz 2014).

    It is 1 / (1 + max + c min), where max and min are the larger and the smaller Lambda, and c is 4.41 azimuth / (4.41
    azimuth + 1). If light and view have the same azimuth, c is 0, and only the stronger masking applies.
    """
    correlation = 4.41 * azimuth / (4.41 * azimuth + 1)
    return 1 / (1 + xp.maximum(lambda_i, lambda_o) + correlation * xp.minimum(lambda_i, lambda_o))
