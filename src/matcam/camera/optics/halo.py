"""Lens with veiling glare, which is light scattered far from the image of a point (docs/model.md 2)."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.optics import Optics, Rule, checked_isotropic
from matcam.core import checks
from matcam.core.arrays import is_concrete, xp
from matcam.core.arrays.module import leaves_of
from matcam.core.errors import ArgumentError

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax


class HaloOptics(Optics):
    """Lens with veiling glare: a wide Gaussian halo around its PSF.

    The PSF is (1 - fraction) times the PSF of the core, plus fraction times the Gaussian PSF of the halo. Highlights are
    1e3 to 1e6 times brighter than their surroundings, so a fraction of 1e-3 is visible as haze.

    The core may be another HaloOptics, because stray light of several ranges is described by a sum of Gaussians. The
    factor 1 - fraction of the outer lens then applies to the whole PSF of the inner lens, including the inner halo.

    Args:
        core: the lens without glare.
        fraction: fraction of the light in the halo, no unit, [0, 1).
        radius: standard deviation of the halo, px, positive.

    Raises:
        ArgumentError: a parameter is out of range or not a single number, or the core is not Optics.

    Source:
        ISO 9358 (veiling glare); docs/model.md 2.

    Example:
        >>> lens = matcam.HaloOptics(matcam.GaussianOptics(0.5), fraction=0.01, radius=30.0)
        >>> round(float(lens.mtf(0.1) / lens.core.mtf(0.1)), 4)
        0.99
    """

    core: Optics
    fraction: jax.Array
    halo: GaussianOptics

    profile_fields = MappingProxyType({"core": "core", "fraction": "fraction", "radius_px": "halo.sigma"})

    def __init__(self, core: Optics, fraction: ArrayLike, radius: ArrayLike):
        if not isinstance(core, Optics):
            raise ArgumentError(f"core must be Optics, got {type(core).__name__}")
        self.core = core
        self.fraction = checks.scalar("fraction", checks.within("fraction", fraction, 0, 1, open_high=True))
        self.halo = GaussianOptics(checks.scalar("radius", checks.positive("radius", radius, "px")))

    @property
    def radius(self) -> jax.Array:
        """Standard deviation of the halo, px."""
        return self.halo.sigma

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Compute the point spread function, 1/px^2, without the pixel.

        It is (1 - fraction) core.psf(x, y) + fraction halo.psf(x, y).
        """
        return (1 - self.fraction) * self.core.psf(x, y) + self.fraction * self.halo.psf(x, y)

    def lsf(self, x: ArrayLike) -> jax.Array:
        """Compute the line spread function, 1/px, without the pixel.

        It is (1 - fraction) core.lsf(x) + fraction halo.lsf(x).

        Raises:
            ArgumentError: the core is not isotropic; use `Camera.lsf` with an angle.
        """
        core = checked_isotropic(self.core, "lsf without an angle")
        return (1 - self.fraction) * core.lsf(x) + self.fraction * self.halo.lsf(x)

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Compute the signed transfer function, without the pixel.

        It is (1 - fraction) core.mtf(f) + fraction halo.mtf(f). The MTF of the halo is a narrow Gaussian around frequency 0
        with the standard deviation 1 / (2 pi radius), cycles/px.

        Raises:
            ArgumentError: the core is not isotropic; use `otf`.
        """
        core = checked_isotropic(self.core, "mtf without an angle")
        return (1 - self.fraction) * core.mtf(f) + self.fraction * self.halo.mtf(f)

    def otf(self, fx: ArrayLike, fy: ArrayLike) -> jax.Array:
        """Compute the transfer function in the plane, without the pixel.

        It is (1 - fraction) core.otf(fx, fy) + fraction halo.otf(fx, fy).
        """
        return (1 - self.fraction) * self.core.otf(fx, fy) + self.fraction * self.halo.otf(fx, fy)

    @property
    def isotropic(self) -> bool:
        """True if the core is isotropic, achromatic and uniform."""
        return self.core.isotropic

    def band(self) -> float:
        """Compute the larger of the bands of core and halo, cycles/px."""
        return max(self.core.band(), self.halo.band())

    def resolved_share(self) -> float:
        """Compute the share of the band that the lens resolves, no unit.

        It is the share of the core, or 1 if the band of the halo is larger than the band of the core.
        """
        return self.core.resolved_share() if self.halo.band() <= self.core.band() else 1.0

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Build the quadrature of the core on panels graded towards frequency 0.

        Each panel is half as wide as the next, so that the panels resolve the narrow MTF of the halo. If the band of the
        halo is larger than the band of the core, the quadrature is extended to the band of the halo.
        """
        known = all(map(is_concrete, leaves_of(self)))
        # for traced parameters, 18 octaves resolve the spike of a halo of 1000 px in a band of 40 cycles/px
        octaves = 2 + max(0, int(np.log2(self.core.band() / self.halo.band()))) if known else 18
        rule = self.core.rule_on(np.union1d(borders, 2.0 ** -np.arange(octaves + 2)))
        if known and self.halo.band() <= self.core.band():
            return rule
        # the band of a halo that is narrower than its core exceeds that of the core; the weights of a rule sum to its range
        start, beyond = xp.sum(rule.weight), self.halo.rule_on(borders)
        end = xp.sum(beyond.weight)
        share = xp.maximum(end - start, 0) / end
        return Rule(
            xp.concatenate([xp.asarray(rule.frequency), start + share * beyond.frequency]),
            xp.concatenate([xp.asarray(rule.weight), share * beyond.weight]),
        )

    def components(self) -> tuple[tuple[jax.Array, Optics], ...]:
        """List the components of core and halo, each with its weight."""
        core = tuple(((1 - self.fraction) * weight, part) for weight, part in self.core.components())
        return (*core, (self.fraction, self.halo))
