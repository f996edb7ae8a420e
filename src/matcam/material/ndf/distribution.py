"""Normal distribution functions: the tilts of a rough surface's microfacets (docs/model.md 6).

A facet's tilt is a slope: minus the gradient of the surface's height. P22 is the density of slopes. D = P22 / cos^4
theta_h is the density of normals per solid angle, and the integral of D cos theta_h over the hemisphere is 1. The record of a
lobe by a camera depends on the lobe as a function of a tangent-plane coordinate r,

    D(theta_h) = D(0) flattening(theta_h) shape(r),     r = coordinate(theta_h),

and has a closed form if the shape is a mixture of Gaussians (forward/peaks/tangent_plane.py).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from matcam.core import checks
from matcam.core.arrays import xp
from matcam.core.arrays.module import Module
from matcam.core.shading import Shading

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_SMOOTHEST = 1e-60  # smallest roughness: far below that of any surface, but its powers are positive numbers
_FLAT = 1e-30  # squared sine below which a direction is the normal itself


class SlopeDistribution(Module):
    """Distribution of the slopes of microfacets, isotropic or not."""

    @abstractmethod
    def density(self, along: jax.Array, across: jax.Array) -> jax.Array:
        """Compute P22, the density of slopes; its integral over slopes is 1.

        Args:
            along: slope along the first tangent of the surface, no unit.
            across: slope across the first tangent, no unit.
        """

    @abstractmethod
    def lambdas(self, shading: Shading) -> tuple[jax.Array, jax.Array]:
        """Compute Smith's Lambda of light and view.

        Args:
            shading: directions of light and view, both above the horizon.
        """

    @property
    @abstractmethod
    def finest(self) -> jax.Array:
        """Smallest scale of slopes on which P22 changes, no unit, shape ()."""

    @property
    def elongation(self) -> float:
        """Ratio of length to width of P22, no unit."""
        return 1.0


class NDF(SlopeDistribution):
    """Isotropic distribution of microfacet normals.

    Attributes:
        family: name of the family, as in `FAMILIES`.
        largest: upper limit of the roughness, which is the first argument of the constructor.
    """

    family: ClassVar[str]
    largest: ClassVar[float]

    @abstractmethod
    def d(self, theta_h: ArrayLike) -> jax.Array:
        """Compute D, the density of facet normals, 1/sr.

        The integral of D cos theta_h over the hemisphere is 1.

        Args:
            theta_h: angle between half vector and surface normal, rad.
        """

    @abstractmethod
    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """Compute P22, the density of slopes.

        Args:
            slope2: squared slope, tan^2 theta_h, no unit.
        """

    @abstractmethod
    def coordinate(self, theta_h: jax.Array) -> jax.Array:
        """Compute the tangent-plane coordinate r, an angle or a slope.

        Args:
            theta_h: angle between half vector and surface normal, rad.
        """

    @abstractmethod
    def shape(self, r: jax.Array) -> jax.Array:
        """Evaluate the lobe at a tangent-plane coordinate, 1 at the peak.

        Args:
            r: coordinate, an angle or a slope.
        """

    @abstractmethod
    def flattening(self, theta_h: jax.Array) -> jax.Array:
        """Compute the ratio of D to D(0) shape(r).

        The ratio is 1 at the peak. The tangent plane approximation assumes that it is 1 everywhere.

        Args:
            theta_h: angle between half vector and surface normal, rad.
        """

    @abstractmethod
    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """Compute Smith's Lambda.

        Args:
            cos: cosine of the angle of the direction to the normal, above 0.
        """

    @property
    @abstractmethod
    def roughness(self) -> jax.Array:
        """First parameter, the scale of the slopes of the facets."""

    def g1(self, theta: ArrayLike) -> jax.Array:
        """Compute Smith's masking: the share of visible facets.

        Args:
            theta: angle of the direction to the normal, rad, [0, pi/2].

        Raises:
            ArgumentError: theta lies outside its range.
        """
        return 1 / (1 + self.smith_lambda(xp.cos(checks.within("theta", theta, 0, np.pi / 2, "rad"))))

    def density(self, along: jax.Array, across: jax.Array) -> jax.Array:
        """Compute P22, which is the same in every direction."""
        return self.slope_density(along**2 + across**2)

    def lambdas(self, shading: Shading) -> tuple[jax.Array, jax.Array]:
        """Compute Smith's Lambda of light and view.

        Lambda of a direction depends only on the angle of the direction to the normal.
        """
        return self.smith_lambda(shading.cos_i), self.smith_lambda(shading.cos_o)

    @property
    def finest(self) -> jax.Array:
        """Narrowest scale on which P22 changes: the roughness."""
        return self.roughness


class SlopeNDF(NDF):
    """NDF that is defined by a density of slopes."""

    def d(self, theta_h: ArrayLike) -> jax.Array:
        """Compute D = P22 / cos^4 theta_h, 1/sr."""
        slope2 = xp.tan(checks.number("theta_h", theta_h)) ** 2
        return self.slope_density(slope2) * (1 + slope2) ** 2

    def coordinate(self, theta_h: jax.Array) -> jax.Array:
        """Compute the slope tan theta_h."""
        return xp.tan(theta_h)

    def shape(self, r: jax.Array) -> jax.Array:
        """Compute the density of slopes divided by its value at slope 0."""
        return self.slope_density(r**2) / self.slope_density(xp.zeros(()))

    def flattening(self, theta_h: jax.Array) -> jax.Array:
        """Compute cos^-4 theta_h, which converts slopes to solid angle."""
        return xp.cos(theta_h) ** -4


class MixtureNDF(NDF):
    """NDF that is a mixture of Gaussians in the tangent-plane coordinate.

    shape(r) = sum_j weight_j exp(-r^2 / (2 width_j^2)). A camera's record of such a lobe has a closed form.
    `GaussianNDF`, `Beckmann`, `GGX` and `SGD` are such lobes.

    Source:
        docs/model.md 4.

    Example:
        >>> from matcam.material.ndf.distribution import MixtureNDF
        >>> [isinstance(lobe, MixtureNDF) for lobe in (matcam.GGX(0.1), matcam.EPD(0.1, 0.5))]
        [True, False]
    """

    @abstractmethod
    def mixture(self) -> tuple[jax.Array, jax.Array]:
        """Compute weights and widths of the Gaussians in r.

        Each has shape (n,); the weights sum to 1.
        """


class StretchedSlopes(SlopeDistribution):
    """Isotropic distribution of slopes, stretched by alpha_along and alpha_across.

    In a direction of azimuth phi, a stretched surface has the Smith masking of an isotropic surface of roughness alpha, where
    alpha^2 = alpha_along^2 cos^2 phi + alpha_across^2 sin^2 phi (Heitz 2014).
    """

    alpha_along: jax.Array
    alpha_across: jax.Array

    def __init__(self, alpha_along: ArrayLike, alpha_across: ArrayLike):
        self.alpha_along = checked_roughness("alpha_along", alpha_along)
        self.alpha_across = checked_roughness("alpha_across", alpha_across)

    @abstractmethod
    def unit_density(self, slope2: jax.Array) -> jax.Array:
        """Compute P22 of the surface of roughness 1.

        Args:
            slope2: squared slope, no unit.
        """

    @abstractmethod
    def unit_lambda(self, nu: jax.Array) -> jax.Array:
        """Compute Smith's Lambda of the surface of roughness 1.

        Args:
            nu: cot theta of the direction.
        """

    def density(self, along: jax.Array, across: jax.Array) -> jax.Array:
        """Compute P22 from the slopes divided by their roughnesses."""
        stretched2 = (along / self.alpha_along) ** 2 + (across / self.alpha_across) ** 2
        return self.unit_density(stretched2) / (self.alpha_along * self.alpha_across)

    def lambdas(self, shading: Shading) -> tuple[jax.Array, jax.Array]:
        """Compute Smith's Lambda from the roughness of each direction."""
        (x, y), (offset_x, offset_y) = _tangents(shading)
        return tuple(  # type: ignore[return-value]
            self._lambda(cos, offset_x + sign * x, offset_y + sign * y)
            for cos, sign in ((shading.cos_i, 1), (shading.cos_o, -1))
        )

    def _lambda(self, cos: jax.Array, along: jax.Array, across: jax.Array) -> jax.Array:
        alpha_tan = xp.sqrt((self.alpha_along * along) ** 2 + (self.alpha_across * across) ** 2 + _FLAT)
        return self.unit_lambda(xp.maximum(cos, _FLAT) / alpha_tan)

    @property
    def finest(self) -> jax.Array:
        """Narrowest scale on which P22 changes: the smaller roughness."""
        return xp.minimum(self.alpha_along, self.alpha_across)

    @property
    def elongation(self) -> float:
        """Ratio of the larger to the smaller roughness, no unit."""
        along, across = (checks.outside_jit(a, "the roughnesses") for a in (self.alpha_along, self.alpha_across))
        return max(along / across, across / along)


def checked_roughness(name: str, value: ArrayLike, largest: float = 1.0, unit: str = "") -> jax.Array:
    """Check that a roughness is a single number in (0, largest], and at least 1e-60.

    Otherwise an ArgumentError is raised. The powers of smaller roughnesses would be rounded to 0.
    """
    checks.within(name, value, 0, largest, unit, open_low=True)
    return checks.scalar(name, checks.within(name, value, _SMOOTHEST, largest, unit))


def _tangents(shading: Shading) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
    """Compute (part, offset), vectors along the two tangents of the surface.

    The components of light and view along the tangents are offset + part and offset - part.
    """
    slope2 = shading.slope_along**2 + shading.slope_across**2
    mirror = slope2 == 0  # there the azimuth of the half vector is treated as 0
    slope = xp.sqrt(xp.where(mirror, 1.0, slope2))
    cos_phi, sin_phi = (
        xp.where(mirror, 1.0, shading.slope_along / slope),
        xp.where(mirror, 0.0, shading.slope_across / slope),
    )
    cos_h = 1 / xp.sqrt(1 + slope2)
    away = xp.sin(shading.theta_d) * xp.cos(shading.phi_d) * cos_h
    beside = xp.sin(shading.theta_d) * xp.sin(shading.phi_d)
    offset = xp.cos(shading.theta_d) * cos_h
    part = away * cos_phi - beside * sin_phi, away * sin_phi + beside * cos_phi
    return part, (offset * shading.slope_along, offset * shading.slope_across)
