"""Normal distribution functions: how a rough surface's microfacets are tilted (MODEL 6).

A facet's tilt is a slope: minus the gradient of the surface's height. P22 is the density of slopes, and
D = P22 / cos^4 theta_h that of normals per solid angle, with the integral of D cos over the hemisphere 1. What a camera
does to a lobe depends on the lobe as a function of a tangent-plane coordinate r,

    D(theta_h) = D(0) flattening(theta_h) shape(r),     r = coordinate(theta_h),

and has a closed form where the shape is a mixture of Gaussians (forward/lobe.py).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading


class SlopeDistribution(eqx.Module):
    """What a microfacet material needs of its facets, isotropic or not."""

    @abstractmethod
    def density(self, along: jax.Array, across: jax.Array) -> jax.Array:
        """P22 at a slope's components along the surface's first tangent and across it; integrates to 1 over the plane."""

    @abstractmethod
    def lambdas(self, seen: Shading) -> tuple[jax.Array, jax.Array]:
        """Smith's Lambda of light and view, both above the horizon."""

    @property
    @abstractmethod
    def finest(self) -> jax.Array:
        """Narrowest scale on which P22 changes, a slope, shape ()."""


class NDF(SlopeDistribution):
    """An isotropic distribution of microfacet normals; the integral of D cos over the hemisphere is 1."""

    family: ClassVar[str]
    """Its name where a family of NDFs is asked for: on the command line, in `fresnel`."""
    largest: ClassVar[float]
    """Largest value of its roughness, the constructor's first argument."""

    @abstractmethod
    def d(self, theta_h: ArrayLike) -> jax.Array:
        """D, 1/sr, at angle theta_h (rad) from the surface normal."""

    @abstractmethod
    def slope_density(self, slope2: jax.Array) -> jax.Array:
        """P22 at the squared slope `slope2` = tan^2 theta_h."""

    @abstractmethod
    def coordinate(self, theta_h: jax.Array) -> jax.Array:
        """Tangent-plane coordinate r of theta_h (an angle or a slope)."""

    @abstractmethod
    def flattening(self, theta_h: jax.Array) -> jax.Array:
        """D divided by D(0) and by the shape in r: what the tangent plane leaves out; 1 at the peak."""

    @abstractmethod
    def smith_lambda(self, cos: jax.Array) -> jax.Array:
        """Smith's Lambda in directions of cosine `cos` > 0 to the normal."""

    @property
    @abstractmethod
    def roughness(self) -> jax.Array:
        """The one number that its width goes with; also the scale of the facets' slopes."""

    def g1(self, theta: ArrayLike) -> jax.Array:
        """Smith masking: share of the facets seen from `theta` (rad, [0, pi/2]) that others do not hide."""
        return 1 / (1 + self.smith_lambda(jnp.cos(checks.within("theta", theta, 0, np.pi / 2, "rad"))))

    def density(self, along: jax.Array, across: jax.Array) -> jax.Array:
        """P22: the same in every direction."""
        return self.slope_density(along**2 + across**2)

    def lambdas(self, seen: Shading) -> tuple[jax.Array, jax.Array]:
        """Each depends on its direction's angle to the normal alone."""
        return self.smith_lambda(seen.cos_i), self.smith_lambda(seen.cos_o)

    @property
    def finest(self) -> jax.Array:
        """The roughness."""
        return self.roughness


class SlopeNDF(NDF):
    """An NDF that is given as a density of slopes."""

    def d(self, theta_h: ArrayLike) -> jax.Array:
        """P22 / cos^4 theta_h, 1/sr."""
        slope2 = jnp.tan(checks.number("theta_h", theta_h)) ** 2
        return self.slope_density(slope2) * (1 + slope2) ** 2

    def coordinate(self, theta_h: jax.Array) -> jax.Array:
        """The slope tan theta_h."""
        return jnp.tan(theta_h)

    def flattening(self, theta_h: jax.Array) -> jax.Array:
        """cos^-4 theta_h, from slopes to solid angle."""
        return jnp.cos(theta_h) ** -4


class MixtureNDF(NDF):
    """An NDF whose shape in the tangent plane is a mixture of Gaussians,
    sum_j weight_j exp(-r^2 / (2 width_j^2))."""

    @abstractmethod
    def mixture(self) -> tuple[jax.Array, jax.Array]:
        """(weights, widths) of the Gaussians in r, each shape (n,); weights sum to 1."""
