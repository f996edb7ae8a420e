"""Interface of materials: BRDF and albedo."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from matcam.core import checks
from matcam.core.arrays import xp
from matcam.core.arrays.module import Module
from matcam.core.errors import ArgumentError
from matcam.core.grid import Sampling, below_horizon, cosines, merl_grid
from matcam.core.remark import Remark
from matcam.core.shading import Shading, local_shading, vector

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_AZIMUTHS = 64  # number of phi_h of the half vectors of the albedo
_QUARTER = np.pi / 2 * (1 + 1e-9)  # largest half or difference angle, rad, with a margin for rounding


class Material(Module):
    """Opaque surface with a BRDF. Channels, if any, are the last axis of every result."""

    @abstractmethod
    def reflected(self, shading: Shading) -> jax.Array:
        """Compute the BRDF times both cosines, 1/sr.

        The result is finite up to the horizon, 0 if light or view is below the horizon, and NaN for missing data.

        Args:
            shading: directions of light and view; its arrays broadcast.

        Returns:
            Shape of `shading`, followed by (channels,) if the material has channels.
        """

    @property
    @abstractmethod
    def finest(self) -> jax.Array:
        """Narrowest angular scale of the lobe, rad, shape ().

        This scale determines the grading of quadratures.
        """

    @property
    def rings(self) -> tuple[int, float]:
        """Number of half angles of the albedo, and their position.

        The half angles are evenly spaced in sqrt(theta_h). The position in an interval is a number from 0 to 1. 720 half
        angles resolve lobes down to a width of 1e-4 rad.
        """
        return 720, 0.5

    @property
    def elongation(self) -> float:
        """Ratio of length to width of the lobe, no unit."""
        return 1.0

    def brdf(self, theta_h: ArrayLike, theta_d: ArrayLike, phi_d: ArrayLike, phi_h: ArrayLike = 0.0) -> jax.Array:
        """Evaluate the BRDF, 1/sr, at half and difference angles, which broadcast.

        Args:
            theta_h: angle between half vector and normal, rad.
            theta_d: angle between light and half vector, rad.
            phi_d: azimuth of the light about the half vector, rad.
            phi_h: azimuth of the half vector about the normal, from the first tangent, rad. Only anisotropic materials
                depend on it. Default: 0.

        Returns:
            Shape of the angles, followed by (channels,) if the material has channels; NaN below the horizon and for
            missing data.

        Raises:
            ArgumentError: an angle is not finite, `theta_h` or `theta_d` is beyond 90 degrees, or the shapes do not
                broadcast.

        Source:
            Rusinkiewicz (1998); docs/model.md 1.
        """
        for name, angle in (("theta_h", theta_h), ("theta_d", theta_d)):
            checks.within(name, angle, -_QUARTER, _QUARTER, "rad")
        shading = shading_at(theta_h, theta_d, phi_d, phi_h)
        reflected = self.reflected(shading)
        above = (shading.cos_i > 0) & (shading.cos_o > 0)
        foreshortening = xp.where(above, shading.cos_i * shading.cos_o, 1.0)
        if reflected.ndim > above.ndim:
            above, foreshortening = above[..., None], foreshortening[..., None]
        return xp.where(above, reflected / foreshortening, xp.nan)


def check_material(material: Material) -> None:
    """Raise ArgumentError if an argument is not a material."""
    checks.instance("material", material, Material, "Microfacet(GGX(0.1), 0.9)")  # type: ignore[type-abstract]


def shading_at(theta_h: ArrayLike, theta_d: ArrayLike, phi_d: ArrayLike, phi_h: ArrayLike = 0.0) -> Shading:
    """Compute the shading at half and difference angles, rad, which broadcast."""
    theta_h, theta_d, phi_d, phi_h = checks.broadcastable(theta_h=theta_h, theta_d=theta_d, phi_d=phi_d, phi_h=phi_h)
    cos_i, cos_o = cosines(theta_h, theta_d, phi_d)
    slope = xp.tan(theta_h)
    along, across = xp.broadcast_arrays(slope * xp.cos(phi_h), slope * xp.sin(phi_h), cos_i)[:2]
    return Shading(cos_i, cos_o, along, across, theta_d, phi_d)


def cell_values(material: Material, sampling: Sampling) -> jax.Array:
    """Evaluate a BRDF at the cells of the MERL grid, as the mean of both reciprocal configurations.

    The result has shape (90, 90, 180, channels), unit 1/sr, and is NaN below the horizon.
    """
    theta_h, theta_d, phi_d = np.meshgrid(*merl_grid(sampling), indexing="ij")
    values = (material.brdf(theta_h, theta_d, phi_d) + material.brdf(theta_h, theta_d, phi_d + np.pi)) / 2
    values = values if values.ndim == 4 else values[..., None]
    return xp.where(below_horizon(sampling)[..., None], xp.nan, values)


def above_horizon(shading: Shading) -> tuple[Shading, jax.Array]:
    """Replace directions of `shading` below the horizon by directions above it.

    The result is the shading, and a mask of the directions that are above the horizon in `shading`. The replacement prevents
    NaN in an unused branch, which would affect derivatives.
    """
    above = (shading.cos_i > 0) & (shading.cos_o > 0)
    cos_i, cos_o = (xp.where(above, c, 0.5) for c in (shading.cos_i, shading.cos_o))
    along, across = (xp.where(above, s, 0.0) for s in (shading.slope_along, shading.slope_across))
    return shading._replace(cos_i=cos_i, cos_o=cos_o, slope_along=along, slope_across=across), above


def theta_h_of(shading: Shading) -> jax.Array:
    """Compute the angle of the half vector to the normal, rad."""
    slope2 = shading.slope_along**2 + shading.slope_across**2
    mirror = slope2 == 0  # the derivative of the root is infinite there
    return xp.where(mirror, 0.0, xp.arctan(xp.sqrt(xp.where(mirror, 1.0, slope2))))


def albedo(material: Material, theta: ArrayLike) -> np.ndarray:
    """Compute the directional albedo of a material, no unit.

    The directional albedo, or directional-hemispherical reflectance, is the integral of BRDF cos theta_i over the directions of
    the light. A midpoint rule is used for half vectors that are evenly spaced in sqrt(theta_h). The solid angle of the light is
    4 cos theta_d times that of the half vector, where theta_d is the angle between light and half vector. The rule resolves
    lobes down to a width of 1e-4 rad. For a table, the nodes are the theta_h of its values, because the interpolation between
    the values of a narrow lobe is inaccurate.

    Args:
        material: any material. Directions of light with missing values (NaN) are omitted, so the albedo is then a lower bound.
            `matcam inspect` shows the share of these directions.
        theta: viewing angle to the normal, at azimuth 0, rad, [0, pi/2), shape (n,).

    Returns:
        Albedo, no unit, shape (n, channels); one channel for a material without channels. NaN if all values are missing.

    Raises:
        ArgumentError: an angle lies outside its range, theta has a wrong shape, or `material` is not a material.

    Source:
        Nicodemus et al. (1977), directional-hemispherical reflectance.

    Example:
        >>> white = matcam.Microfacet(matcam.GGX(0.3), 0.0, diffuse=0.5)
        >>> matcam.material.albedo(white, [0.0]).round(3)
        array([[0.5]])
    """
    return albedo_and_missing(material, theta)[0]


def albedo_and_missing(material: Material, theta: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Compute the directional albedo, and the share of the light whose values are missing.

    The arguments are those of `albedo`. The share is that of uniform diffuse light, no unit, (n, channels).
    """
    angles = np.atleast_1d(np.asarray(checks.viewing_angle("theta", theta)))
    if angles.ndim != 1 or not angles.size:
        raise ArgumentError(f"theta must have shape (n,) with at least one angle, got shape {angles.shape}")
    checks.instance("material", material, Material)  # type: ignore[type-abstract]
    count, shift = material.rings
    u = ((np.arange(count) + shift) / count)[:, None]
    phi = ((np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS * 2 * np.pi)[None, :]
    theta_h = u**2 * np.pi / 2
    half = np.sin(theta_h) * np.cos(phi), np.sin(theta_h) * np.sin(phi), np.cos(theta_h) + 0 * phi
    solid = np.sin(theta_h) * np.pi * u / count * 2 * np.pi / _AZIMUTHS
    albedos, missing = [], []
    for angle in angles:
        view = np.sin(angle), 0.0, np.cos(angle)
        towards = half[0] * view[0] + half[2] * view[2]
        light = vector(*(2 * towards * h - v for h, v in zip(half, view, strict=True)))
        reflected = material.reflected(local_shading(light, vector(*view)))
        values = np.asarray(reflected).reshape(count, _AZIMUTHS, -1)
        weight = np.where(towards > 0, 4 * towards * solid, 0.0)
        unknown, diffuse = np.isnan(values), weight * np.maximum(2 * towards * half[2] - view[2], 0.0)
        share = (unknown * diffuse[..., None]).sum(axis=(0, 1)) / diffuse.sum()
        known = np.nansum(values * weight[..., None], axis=(0, 1)) / view[2]
        albedos.append(np.where((unknown | (diffuse == 0)[..., None]).all(axis=(0, 1)), np.nan, known))
        missing.append(share)
    return np.stack(albedos), np.stack(missing)


def albedo_remarks(largest: float) -> tuple[Remark, ...]:
    """Remark on a table whose largest directional albedo exceeds 1."""
    if largest <= 1:
        return ()
    text = f"the recorded table reflects up to {largest:.3g} times the light that it receives: check its unit (1/sr) and scale"
    return (Remark("albedo", text),)
