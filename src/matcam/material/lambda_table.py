"""Smith's Lambda of a lobe in many directions, from a small table with the same directions for all lobes.

The position of a direction in the table does not depend on the lobe. A fit evaluates successive lobes in the same
directions, so it computes each position once. 1 / (1 + Lambda) is accurate to 3e-6 for roughnesses from 1e-4 to 1,
and to 1e-5 for lobes as steep as an EPD with a power of 1.8.
"""

from __future__ import annotations

import numpy as np

from matcam.core.jax import jax, jnp
from matcam.core.programs import kept_program
from matcam.material.ndf.beckmann import Beckmann
from matcam.material.ndf.distribution import NDF
from matcam.material.ndf.free_lobe import ShadowedNDF
from matcam.material.ndf.ggx import GGX
from matcam.numerics.approximation import AnyValues, between_entries, four_about

STEEPEST = 1e-4
"""Smallest cotangent of a direction in the table; the cosine of this direction is the same to 1e-8."""
_LEVEL = 1e4  # largest cotangent of the table, at which masking is negligible
_ENTRIES = 161  # number of directions of the table
_LAST = _ENTRIES - 1.0
_STEP = float(np.log(_LEVEL / STEEPEST) / _LAST)

COTS = STEEPEST * np.exp(_STEP * np.arange(_ENTRIES))
"""Cotangents of the directions of the table, equally spaced in the logarithm."""


def quick_lambda(ndf: NDF, cos: jax.Array, table: jax.Array | None = None) -> jax.Array:
    """Compute Smith's Lambda in closed form or from a table.

    cos: cosines of the angles of the directions to the normal, > 0. table: result of `quick_table`. Default: None, it
    is computed.
    """
    table = quick_table(ndf) if table is None else table
    return ndf.smith_lambda(cos) if table is None else lambda_at(table, position_of(cos))


def has_closed_lambda(ndf: NDF) -> bool:
    """Check whether Lambda of a lobe has a closed form."""
    return isinstance(ndf, GGX | Beckmann | ShadowedNDF)


def quick_table(ndf: NDF) -> jax.Array | None:
    """Compute ln(1 + Lambda) in the directions of the table.

    The result is None for lobes whose Lambda has a closed form.
    """
    if has_closed_lambda(ndf):
        return None
    return jnp.log1p(ndf.smith_lambda(COTS / np.sqrt(1 + COTS**2)))


@kept_program
def compiled_table(ndf: NDF) -> jax.Array:
    """Compute `quick_table` of a lobe without a closed form of Lambda."""
    table = quick_table(ndf)
    assert table is not None
    return table


def position_of(cos: AnyValues) -> AnyValues:
    """Compute the positions of directions in the table, counted from 0.

    The result is a NumPy array if `cos` is a NumPy array.
    """
    numbers = np if isinstance(cos, np.ndarray) else jnp
    sin2 = numbers.maximum((1 - cos) * (1 + cos), _LEVEL**-2)
    return numbers.log(cos / numbers.sqrt(sin2) / STEEPEST) / _STEP


def lambda_at(table: jax.Array, position: jax.Array) -> jax.Array:
    """Interpolate Lambda at positions of a table by cubics through four entries.

    In directions steeper than those of the table, 1 + Lambda is proportional to 1 / cot.
    """
    log = between_entries(table, jnp.clip(position, 0.0, _LAST))
    return jnp.maximum(jnp.exp(log + _STEP * jnp.maximum(-position, 0.0)) - 1, 0.0)


def by_entries(position: jax.Array, by_log: jax.Array) -> jax.Array:
    """Differentiate a sum with respect to table entries, (cells, entries).

    Each cell has its own sum. position: positions in the table, (cells, ...). by_log: derivatives of the sum with
    respect to ln(1 + Lambda) at each position, same shape.
    """
    first, shares = four_about(jnp.clip(position, 0.0, _LAST), _ENTRIES)
    cell = jnp.arange(position.shape[0]).reshape(-1, *[1] * (position.ndim - 1))
    total = jnp.zeros((position.shape[0], _ENTRIES))
    for k, share in enumerate(shares):
        total = total.at[cell, first + k].add(by_log * share, mode="promise_in_bounds")
    return total
