"""Materials whose Lambda is interpolated in a table, for evaluation in many directions.

The quadrature of Lambda takes 200 evaluations of the lobe in each direction. The table is accurate to 3e-6 of 1 / (1 + Lambda)
(`lambda_table.py`).
"""

from __future__ import annotations

import equinox as eqx

from matcam.core.jax import jax
from matcam.core.shading import Shading
from matcam.material.lambda_table import compiled_table, has_closed_lambda, lambda_at, position_of
from matcam.material.material import Material
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import NDF, SlopeDistribution


class TabulatedMasking(SlopeDistribution):
    """Distribution of slopes whose Lambda is interpolated in a table.

    Attributes:
        ndf: the distribution.
        table: result of `quick_table`.
    """

    ndf: NDF
    table: jax.Array

    def density(self, along: jax.Array, across: jax.Array) -> jax.Array:
        """Return P22 of the distribution."""
        return self.ndf.density(along, across)

    def lambdas(self, shading: Shading) -> tuple[jax.Array, jax.Array]:
        """Return Smith's Lambda of light and view from the table."""
        first, second = (lambda_at(self.table, position_of(cos)) for cos in (shading.cos_i, shading.cos_o))
        return first, second

    @property
    def finest(self) -> jax.Array:
        """Narrowest scale on which P22 changes, a slope."""
        return self.ndf.finest


def with_tabulated_masking(material: Material) -> Material:
    """Replace the quadrature of Lambda by a table, in a material that is evaluated in many directions."""
    if not isinstance(material, Microfacet) or material.masking is None:
        return material
    if not isinstance(material.ndf, NDF) or has_closed_lambda(material.ndf):
        return material
    tabulated = TabulatedMasking(material.ndf, compiled_table(material.ndf))
    return eqx.tree_at(lambda one: one.ndf, material, tabulated)
