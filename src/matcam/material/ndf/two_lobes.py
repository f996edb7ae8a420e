"""Mixture of two lobes, such as those of a coat and its base, or of two finishes on one surface."""

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

    Both components of a lobe have the same roughness. The density of slopes and Smith's Lambda are linear in each share, and
    have closed forms. The share of Beckmann determines the tails of a lobe. A fit of this share replaces the choice of a
    family.

    Attributes:
        alpha: roughness of the first lobe, a slope, no unit, shape ().
        other_alpha: roughness of the second lobe, a slope, no unit, shape ().
        other_share: share of the facets in the second lobe, no unit, [0, 1], shape ().
        beckmann: share of Beckmann in the first lobe, no unit, [0, 1], shape (); the remainder is GGX.
        other_beckmann: share of Beckmann in the second lobe, no unit, [0, 1], shape (); the remainder is GGX.
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
