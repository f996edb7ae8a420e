"""Microfacet materials: F D G / (4 cos_i cos_o) + diffuse / pi (Cook & Torrance 1982, with 4 for their pi)."""

from __future__ import annotations

import equinox as eqx
from jax.typing import ArrayLike

from matcam import checks
from matcam._jax import jax, jnp
from matcam.angles import azimuth_difference, cosines
from matcam.errors import ArgumentError
from matcam.material.masking import MASKINGS, Masking, g2, smith_lambda
from matcam.material.ndf import NDF
from matcam.material.reflectance import Reflectance, as_reflectance


class Microfacet(eqx.Module):
    """A rough surface.

    ndf: distribution of its facets. fresnel: `Reflectance`, or a number per channel. diffuse: albedo of a Lambertian
    part, a number or one per channel. masking: "smith" (height-correlated), "smith-separable", "van-ginneken", None.
    """

    ndf: NDF
    fresnel: Reflectance
    diffuse: jax.Array
    masking: Masking = eqx.field(static=True)

    def __init__(
        self, ndf: NDF, fresnel: Reflectance | ArrayLike, diffuse: ArrayLike = 0.0, masking: Masking = "smith"
    ):
        if not isinstance(ndf, NDF):
            raise ArgumentError(f"ndf must be an NDF such as GGX(0.1), got {type(ndf).__name__}")
        self.ndf = ndf
        self.fresnel = as_reflectance(fresnel)
        self.diffuse = checks.within("diffuse", diffuse, 0, 1)
        self.masking = checks.choice("masking", masking, MASKINGS)

    def brdf(self, theta_h: ArrayLike, theta_d: ArrayLike, phi_d: ArrayLike) -> jax.Array:
        """BRDF, 1/sr, shape of the broadcast angles and (channels,) behind it if there are any; NaN below the horizon."""
        theta_h, theta_d, phi_d = (
            checks.number(name, a) for name, a in (("theta_h", theta_h), ("theta_d", theta_d), ("phi_d", phi_d))
        )
        specular, above = self.without_d(theta_h, theta_d, phi_d)
        d = self.ndf.d(theta_h)
        if specular.ndim > above.ndim:
            d, above = jnp.asarray(d)[..., None], above[..., None]
        return jnp.where(above, specular * d + self.diffuse / jnp.pi, jnp.nan)

    def without_d(self, theta_h: jax.Array, theta_d: jax.Array, phi_d: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(F G / (4 cos_i cos_o), whether both directions are above the horizon)."""
        cos_i, cos_o = cosines(theta_h, theta_d, phi_d)
        above = (cos_i > 0) & (cos_o > 0)
        cos_i, cos_o = jnp.where(above, cos_i, 0.5), jnp.where(above, cos_o, 0.5)
        factor = self.joint_masking(cos_i, cos_o, azimuth_difference(theta_h, theta_d, phi_d)) / (4 * cos_i * cos_o)
        reflected = self.fresnel.at(theta_d)
        if reflected.ndim > jnp.ndim(theta_d):
            factor = factor[..., None]
        return reflected * factor, above

    def joint_masking(self, cos_i: jax.Array, cos_o: jax.Array, azimuth: jax.Array) -> jax.Array:
        """G of a pair of directions, given their cosines to the normal and their azimuth difference."""
        if self.masking is None:
            return jnp.ones_like(cos_i * cos_o)
        lambda_i, lambda_o = (
            smith_lambda(self.ndf.slope_density, self.ndf.roughness, jnp.arccos(jnp.clip(c, -1, 1)))
            for c in (cos_i, cos_o)
        )
        return g2(self.masking, lambda_i, lambda_o, azimuth)
