"""Microfacet materials: F D G / (4 cos_i cos_o) + diffuse / pi (Cook & Torrance 1982, with 4 instead of pi)."""

from __future__ import annotations

import equinox as eqx
from jax.typing import ArrayLike

from matcam.core import checks
from matcam.core.arrays.module import static_field
from matcam.core.errors import ArgumentError
from matcam.core.grid import azimuth_difference
from matcam.core.jax import jax, jnp
from matcam.core.shading import Shading
from matcam.material.masking import MASKINGS, Masking, g2
from matcam.material.material import Material, above_horizon, theta_h_of
from matcam.material.ndf.distribution import SlopeDistribution
from matcam.material.reflectance import Reflectance, as_reflectance, per_channel


class Microfacet(Material):
    """Rough surface: a lobe of microfacets and a Lambertian part.

    BRDF = F D G / (4 cos_i cos_o) + diffuse / pi.

    Args:
        ndf: distribution D of the facet normals, such as `GGX(0.1)`.
        fresnel: reflectance F of a facet: `Conductor`, `Schlick`, `Dielectric` or `Sampled`, or constants in [0, 1]: a single
            value or one per channel.
        diffuse: albedo of the Lambertian part, no unit, [0, 1], a single value or one per channel. Default: 0.
        masking: name of the model of the masking G: "smith" (height-correlated), "smith-separable" or "van-ginneken"; None:
            no masking, G = 1. Default: "smith". Renderers use different models; for a comparison, choose the model of the
            renderer.

    Raises:
        ArgumentError: a parameter is of the wrong kind, out of range, or neither a single value nor one per channel.

    Source:
        Cook & Torrance (1982), with 4 instead of pi; Walter et al. (2007), equation (20); docs/model.md 6.

    Example:
        >>> chrome = matcam.Microfacet(matcam.GGX(0.1), matcam.Conductor(3.1, 3.3))
        >>> float(chrome.brdf(0.0, 0.5, 0.0)) > float(chrome.brdf(0.1, 0.5, 0.0))
        True
    """

    ndf: SlopeDistribution
    fresnel: Reflectance
    diffuse: jax.Array
    masking: Masking = static_field()

    def __init__(
        self,
        ndf: SlopeDistribution,
        fresnel: Reflectance | ArrayLike,
        diffuse: ArrayLike = 0.0,
        masking: Masking = "smith",
    ):
        if not isinstance(ndf, SlopeDistribution):
            raise ArgumentError(f"ndf must be an NDF such as GGX(0.1), got {type(ndf).__name__}")
        self.ndf = ndf
        self.fresnel = as_reflectance(fresnel)
        self.diffuse = per_channel("diffuse", checks.within("diffuse", diffuse, 0, 1))
        self.masking = checks.choice("masking", masking, MASKINGS)
        if self.diffuse.size > 1:
            channels = jax.eval_shape(self.fresnel.at, jnp.zeros(())).shape
            if channels not in ((), (1,), self.diffuse.shape):
                raise ArgumentError(
                    f"fresnel and diffuse must have the same number of channels, or one, got {channels[0]} and "
                    f"{self.diffuse.size}"
                )

    @eqx.filter_jit
    def reflected(self, shading: Shading) -> jax.Array:
        """Compute the BRDF times both cosines, 1/sr.

        The result is F D G / 4 + diffuse cos_i cos_o / pi.
        """
        shading, above = above_horizon(shading)
        lambert = jnp.where(above, shading.cos_i * shading.cos_o / jnp.pi, 0.0)
        facets = jnp.where(above, self.ndf.density(shading.slope_along, shading.slope_across), 0.0)
        facets *= (1 + shading.slope_along**2 + shading.slope_across**2) ** 2 * self._joint_masking(shading) / 4
        reflectance = self.fresnel.at(shading.theta_d)
        in_channels = reflectance.ndim > shading.theta_d.ndim
        if in_channels or self.diffuse.ndim:
            facets, lambert = facets[..., None], lambert[..., None]
            reflectance = reflectance if in_channels else reflectance[..., None]
        return reflectance * facets + self.diffuse * lambert

    @property
    def finest(self) -> jax.Array:
        """Narrowest scale of the slopes of the facets, approximately rad."""
        return self.ndf.finest

    @property
    def elongation(self) -> float:
        """Ratio of the largest to the smallest roughness, no unit."""
        return self.ndf.elongation

    def _joint_masking(self, shading: Shading) -> jax.Array:
        if self.masking is None:
            return jnp.ones_like(shading.cos_i * shading.cos_o)
        azimuth = azimuth_difference(theta_h_of(shading), shading.theta_d, shading.phi_d)
        return g2(self.masking, *self.ndf.lambdas(shading), azimuth)
