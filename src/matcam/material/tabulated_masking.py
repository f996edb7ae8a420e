"""Lobes and materials whose Smith Lambda is interpolated in a table, for evaluation in many directions.

The quadrature of Lambda evaluates the lobe at 201 slopes for each direction. With the table, 1 / (1 + Lambda) has an
error of 3e-6 (`lambda_table.py`).
"""

from __future__ import annotations

import equinox as eqx
import numpy as np

from matcam.core.jax import jax, jnp
from matcam.core.programs import kept_program
from matcam.core.shading import Shading
from matcam.material.lambda_table import cots_of_table, lambda_at, table_of
from matcam.material.material import Material
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.beckmann import Beckmann
from matcam.material.ndf.distribution import NDF, SlopeDistribution
from matcam.material.ndf.free_lobe import ShadowedNDF
from matcam.material.ndf.ggx import GGX

COTS = cots_of_table(187)
"""Cotangents of the directions of a table. With this number of entries, 1 / (1 + Lambda) has an error of 3e-6."""


def has_closed_lambda(ndf: NDF) -> bool:
    return isinstance(ndf, GGX | Beckmann | ShadowedNDF)


def lobe_table(ndf: NDF) -> jax.Array:
    return table_of(jnp.asarray(ndf.smith_lambda(COTS / np.sqrt(1 + COTS**2))))


compiled_table = kept_program(lobe_table)
"""Compiled `lobe_table`."""


def quick_table(ndf: NDF) -> jax.Array | None:
    """Compute the table of Smith's Lambda of a lobe; None if Lambda has a closed form."""
    return None if has_closed_lambda(ndf) else lobe_table(ndf)


def quick_lambda(ndf: NDF, cos: jax.Array, table: jax.Array | None = None) -> jax.Array:
    """Compute Smith's Lambda in closed form or from a table.

    cos: cosines of the angles of the directions to the normal, > 0. table: result of `quick_table`. Default: None,
    `quick_table` is called.
    """
    table = quick_table(ndf) if table is None else table
    return ndf.smith_lambda(cos) if table is None else lambda_at(table, cos)


class TabulatedMasking(SlopeDistribution):
    """Distribution of slopes whose Smith Lambda is interpolated in a table.

    Attributes:
        ndf: distribution without a closed form of Lambda.
        table: table of Lambda, as returned by `lobe_table`.
    """

    ndf: NDF
    table: jax.Array

    def density(self, along: jax.Array, across: jax.Array) -> jax.Array:
        return self.ndf.density(along, across)

    def lambdas(self, shading: Shading) -> tuple[jax.Array, jax.Array]:
        return lambda_at(self.table, shading.cos_i), lambda_at(self.table, shading.cos_o)

    @property
    def finest(self) -> jax.Array:
        return self.ndf.finest


def with_tabulated_masking(material: Material) -> Material:
    """Replace the quadrature of Smith's Lambda in a material by a table, for evaluation in many directions.

    A material that requires no quadrature is returned unchanged.
    """
    if not isinstance(material, Microfacet) or material.masking is None:
        return material
    if not isinstance(material.ndf, NDF) or has_closed_lambda(material.ndf):
        return material
    tabulated = TabulatedMasking(material.ndf, compiled_table(material.ndf))
    return eqx.tree_at(lambda one: one.ndf, material, tabulated)
