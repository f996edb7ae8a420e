"""Record of a specular lobe around its peak, in the tangent plane (docs/model.md 4).

On a curved sample, the angle of the normal is approximated by a linear function of the offset t from the peak, px:
theta = theta_o + t / (r_s cos theta_o) (Holzschuch and Pacanowski 2017, (7)). Here theta_o is the viewing angle of the
peak, and r_s is the radius of the sample, px. The lobe on the sensor is therefore stretched by `px_per_rad` of the sample.
The record is an integral over frequencies for every lobe and every single lens (`lobe_quadrature.py`). It has a closed
form if both the lens and the lobe are sums of Gaussians, and the plane of incidence is parallel to rows or columns of the
pixels. For one Gaussian of the lobe and one of the lens, it is the product over both directions of

    b(u; s) = sqrt(2 pi) s pixel.of_gaussian(u, sqrt(s^2 + sigma^2)).

Here u is the offset from the peak. The standard deviations on the sensor are s for the lobe and sigma for the lens, px.
The closed form is 30 times as fast as the integral, which matters because a table requires the record at a million positions
around the peak.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from matcam.camera.optics.gaussian import GaussianOptics
from matcam.core.arrays import first_axis_map, xp
from matcam.core.errors import ArgumentError
from matcam.forward.peaks.disc_points import DiscPoints, has_discs, mean_over_discs
from matcam.forward.peaks.lobe_quadrature import line_record, plane_record
from matcam.material.ndf.distribution import NDF, MixtureNDF, SlopeDistribution
from matcam.sample.curved import Cylinder
from matcam.sample.shape import Curved

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray, jax
    from matcam.rigs import Rig

_PARALLEL = 1e-9
"""Largest sine of twice the azimuth of the lamp for a plane of incidence that is parallel to rows or columns of the pixels."""
_VALUES = 1 << 20
"""Largest number of values of the Gaussians of a lobe that are stored at a time, which take 8 MiB."""

Gaussians = list[tuple["jax.Array", "jax.Array"]]
"""Weights and standard deviations, px, of a lens that is a sum of Gaussians."""


def response_at_peak(rig: Rig, ndf: SlopeDistribution, theta: jax.Array, dims: int) -> jax.Array:
    """Compute the record at the peak divided by the true peak, (n,).

    Args:
        rig: the rig.
        ndf: the lobe.
        theta: viewing angles of the peak, rad, (n,).
        dims: 2 for a real sample, 1 for the direction towards the limb only.

    Raises:
        ArgumentError: the lobe is not isotropic, the lens has several colours or varies over the field, or the sample is
            smaller than a pixel.
    """
    if not isinstance(ndf, NDF):
        raise ArgumentError(f"the tangent plane needs an isotropic lobe, not {type(ndf).__name__}: use exact=True")
    sample = rig.sample
    if isinstance(sample, Curved):
        sample.check_resolved(rig.camera.pixel.half_width)
    # in a distant rig, all rows across the axis of a cylinder are equal
    one_plane = dims == 2 and isinstance(sample, Cylinder) and sample.distant and rig.lamp.nearness is None
    lens = _gaussians_of(rig)
    if lens is not None and isinstance(ndf, MixtureNDF):
        if dims == 1 or one_plane:
            return _closed_line(rig, ndf, lens, theta, one_plane)
        centre = xp.zeros((theta.size, 1))
        return _closed_record(rig, ndf, lens, theta, (centre, centre))[:, 0]
    if dims == 1 or one_plane:
        return line_record(rig, ndf, theta, one_plane)
    return plane_record(rig, ndf, theta, None)[:, 0]


def lobe_record(rig: Rig, ndf: NDF, theta_o: AnyArray, x: AnyArray, y: AnyArray) -> jax.Array:
    """Compute the record of a lobe at offsets from its peak, relative to the true peak.

    Args:
        rig: the rig. A flat sample records the lobe unchanged.
        ndf: the lobe.
        theta_o: viewing angle of the peak, rad, (slices,).
        x: offsets towards the limb, px, (slices, points).
        y: offsets perpendicular to the direction of `x`, px, (slices, points).

    Returns:
        Relative record, (slices, points), no unit. At the offset (0, 0), it is the response at the peak.
    """
    positions = xp.asarray(x), xp.asarray(y)
    lens = _gaussians_of(rig)
    if lens is not None and isinstance(ndf, MixtureNDF):
        return _closed_record(rig, ndf, lens, xp.asarray(theta_o), positions)
    return plane_record(rig, ndf, xp.asarray(theta_o), positions)


def _gaussians_of(rig: Rig) -> Gaussians | None:
    """Compute the Gaussians of a lens, widened by the jitter.

    The result is None if the lens is not a sum of Gaussians, or if the plane of incidence is not parallel to rows or columns.
    """
    parts = rig.camera.optics.components()
    if abs(np.sin(2 * float(rig.azimuths()))) > _PARALLEL or not all(
        isinstance(part, GaussianOptics) for _, part in parts
    ):
        return None
    return [(weight, xp.sqrt(part.sigma**2 + rig.jitter**2)) for weight, part in parts]  # type: ignore[attr-defined]


def _closed_record(
    rig: Rig, ndf: MixtureNDF, lens: Gaussians, theta: jax.Array, positions: tuple[jax.Array, jax.Array]
) -> jax.Array:
    """Compute the record of a lobe divided by the true peak, shape (slices, points).

    positions: x and y offsets from the peak, px, (slices, points) each.
    """
    if not has_discs(rig):
        return _closed_in_focus(rig, ndf, lens, theta, positions)

    def mean(slices: np.ndarray, points: DiscPoints) -> jax.Array:
        at = [
            (position[slices][..., None] - point[:, None]).reshape(slices.size, -1)
            for position, point in zip(positions, (points.x, points.y), strict=True)
        ]
        records = _closed_in_focus(rig, ndf, lens, theta[slices], (at[0], at[1]))
        return records.reshape(slices.size, positions[0].shape[1], -1) @ points.share

    return mean_over_discs(rig, theta, mean)


def _closed_in_focus(
    rig: Rig, ndf: MixtureNDF, lens: Gaussians, theta: jax.Array, positions: tuple[jax.Array, jax.Array]
) -> jax.Array:
    """Compute the results of `_closed_record` under a point lamp, through a lens in focus."""
    weights, widths = ndf.mixture()

    def record(scale_x: jax.Array, scale_y: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
        lines = [
            [_line(rig, at[..., None], (scale[:, None] * widths)[:, None], std) for _, std in lens]
            for at, scale in ((x, scale_x), (y, scale_y))
        ]
        products = (along * across for along, across in zip(*lines, strict=True))
        return sum((share * (product @ weights) for (share, _), product in zip(lens, products, strict=True)))

    together = max(1, _VALUES // (positions[0].shape[1] * widths.size))
    return first_axis_map(record, (*rig.px_per_rad(theta), *positions), together)


def _closed_line(rig: Rig, ndf: MixtureNDF, lens: Gaussians, theta: jax.Array, one_plane: bool) -> jax.Array:
    """Compute the response at the peak in one dimension, (slices,), towards the limb (Holzschuch & Pacanowski 2017).

    one_plane: see `line_record`.
    """
    weights, widths = ndf.mixture()
    scale = rig.px_per_rad(theta)[0]

    def response(scale: jax.Array, x: jax.Array, weights: jax.Array) -> jax.Array:
        stds = (scale[:, None] * widths)[:, None]
        return sum(share * xp.sum(_line(rig, x[..., None], stds, std) * weights, axis=-1) for share, std in lens)

    if not has_discs(rig):
        return response(scale, xp.zeros((theta.size, 1)), weights)[:, 0]

    def mean(slices: np.ndarray, points: DiscPoints) -> jax.Array:
        missed = xp.exp(-0.5 * (points.aside[..., None] / widths) ** 2) if one_plane else 1.0
        return response(scale[slices], points.x, weights * missed) @ points.share

    return mean_over_discs(rig, theta, mean, ndf.roughness if one_plane else None)


def _line(rig: Rig, u: jax.Array, std: jax.Array, lens: jax.Array) -> jax.Array:
    """Evaluate the one-dimensional record of a Gaussian whose peak is 1, no unit; 1 for an infinite standard deviation.

    u: offset from the peak, px. std: standard deviation of the Gaussian, px. lens: standard deviation of the lens, px.
    """
    uniform = xp.isinf(std)
    std = xp.where(uniform, 1.0, std)
    record = np.sqrt(2 * np.pi) * std * rig.camera.pixel.of_gaussian(u, xp.sqrt(std**2 + lens**2))
    return xp.where(uniform, 1.0, record)
