"""Mixture of two lobes, such as a coat over a base or facets of two finishes. Each lobe is between GGX and Beckmann."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matcam.core.arrays import xp
from matcam.material.ndf.beckmann import Beckmann
from matcam.material.ndf.distribution import SlopeNDF
from matcam.material.ndf.ggx import GGX

if TYPE_CHECKING:
    from matcam.core.jax import jax


class TwoLobes(SlopeNDF):
    """Mixture of two lobes, each a mixture of GGX and Beckmann.

    Both components of a lobe have the same roughness. P22 and Smith's Lambda are linear in the shares, and both have
    closed forms. Fitting the share of Beckmann, which determines the tails of each lobe, replaces the choice of a
    family.

    Attributes:
        alpha: roughness of the first lobe, a slope, shape ().
        other_alpha: roughness of the other lobe, a slope, shape ().
        other_share: share of the facets in the other lobe, [0, 1].
        beckmann: share of Beckmann in the first lobe, [0, 1]; the remainder is GGX.
        other_beckmann: share of Beckmann in the other lobe, [0, 1].
    """

    alpha: jax.Array
    other_alpha: jax.Array
    other_share: jax.Array
    beckmann: jax.Array
    other_beckmann: jax.Array

    family = "two-lobes"
    largest = 1.0

    def slope_density(self, slope2: jax.Array) -> jax.Array:
        return sum((share * lobe.slope_density(slope2) for share, lobe in self._parts()), xp.zeros(()))

    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        return sum((share * lobe.smith_lambda(cos) for share, lobe in self._parts()), xp.zeros(()))

    @property
    def roughness(self) -> jax.Array:
        return xp.minimum(self.alpha, self.other_alpha)

    def _parts(self) -> list[tuple[jax.Array, GGX | Beckmann]]:
        return [
            (share * part, lobe(alpha))
            for share, alpha, rest in (
                (1 - self.other_share, self.alpha, self.beckmann),
                (self.other_share, self.other_alpha, self.other_beckmann),
            )
            for part, lobe in ((1 - rest, GGX), (rest, Beckmann))
        ]
