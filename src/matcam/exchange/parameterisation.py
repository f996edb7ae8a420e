"""Isotropic materials in RGL's adaptive parameterisation (Dupuy & Jakob 2018), which renderers can sample.

The format divides the BRDF by functions such that the tabulated remainder is smooth. i is the direction of the light, o
that of the view, and m the half vector:

- `ndf`: the facet distribution D(theta_h). Here it is the mean over difference angles of 4 BRDF cos theta_i cos theta_o,
  which also includes the Fresnel term, masking and any other part of the BRDF. Its nodes are equally spaced in
  sqrt(theta_h), with at least twice the density of a MERL table. They therefore include the grid points of such a
  table, where the interpolated BRDF has kinks.
- `sigma`: the projected area of facets with the distribution D. The integral over azimuth has a closed form.
- `vndf`: density of visible normals, D max(0, i . m) / sigma. It is mixed with a density proportional to
  sqrt(D) cos theta_h, which resolves the tail, and with a uniform density. Visible normals alone would assign only a
  few per cent of the square to the tail.
- `rgb`: BRDF cos theta_o 4 sigma / D. For views below the horizon it is extrapolated linearly in cos theta_o, so that
  interpolation is correct above the horizon. Negative values are set to 0, because renderers would reject them.
- `luminance`: the density of samples on the square after the map by `vndf`. With this density, samples are distributed as
  BRDF cos theta_o.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import CHANNELS
from matcam.core.shading import local_shading, vector
from matcam.material.material import Material, check_material
from matcam.material.measured import Adaptive, Warp
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import NDF

_HALF_PI = np.pi / 2


def _light_angles(below: int, beyond: int) -> np.ndarray:
    """Choose angles theta of the light to the normal, rad, with a spacing proportional to cos theta.

    `below` is the number of angles up to 82 degrees, and `beyond` the number of angles from 82 to 89 degrees. For broad
    lobes, `sigma` leaves a factor 1 / cos theta in the tabulated values. The relative error of linear interpolation of
    this factor is h^2 (1 + 2 tan^2 theta) / 8 for a spacing of h rad.
    """
    log_tan = lambda degrees: np.log(np.tan(np.pi / 4 + np.radians(degrees) / 2))  # noqa: E731  the integral of 1 / cos
    effort = np.concatenate([np.linspace(0, log_tan(82), below), np.linspace(log_tan(82), log_tan(89), beyond + 1)[1:]])
    return 2 * np.arctan(np.exp(effort)) - _HALF_PI


class GridSize(NamedTuple):
    """Numbers of nodes of an RGL file.

    Attributes:
        angles: number of angles of the light up to 82 degrees, and number of angles beyond 82 degrees.
        square: number of nodes of the tabulated square along each side.
        azimuths: number of azimuths at which visible normals are tabulated.
        normals: number of angles theta_h at which visible normals are tabulated; 0: the number of nodes of D, the facet
            distribution.
    """

    angles: tuple[int, int]
    square: int
    azimuths: int
    normals: int


SQUARE = 192
"""Number of nodes of the tabulated square along each side; the file takes 36 MB."""
_FINEST = GridSize((36, 8), SQUARE, 65, 0)
GRID_SIZES = (
    GridSize((12, 4), 20, 9, 46),
    GridSize((12, 4), 30, 9, 46),
    GridSize((12, 4), 36, 9, 46),
    GridSize((22, 8), 40, 9, 61),
    GridSize((12, 4), 44, 9, 46),
    GridSize((24, 8), 64, 17, 91),
    GridSize((28, 8), 96, 33, 181),
    _FINEST,
)
"""Grids from which the first one that satisfies a given error is chosen. Angles of the light that the peak requires are
added to each. A file of the first two grids takes 0.2 to 1 MB, of the first five at most 2 MB, of the last 36 to 70 MB.
"""
_FAINTEST = 1e-9  # smallest divisor, as a share of the peak of D


def check_isotropic(material: Material) -> None:
    """Raise ArgumentError if an argument is not a material, or if the material is anisotropic."""
    check_material(material)
    if isinstance(material, Microfacet) and not isinstance(material.ndf, NDF):
        raise ArgumentError(
            f"only isotropic materials can be resampled, but {material.ndf!r} is anisotropic: give a material with an "
            "isotropic NDF"
        )
    if isinstance(material, Adaptive) and material.mirrored:
        raise ArgumentError(
            "only isotropic materials can be resampled, but this Adaptive material is anisotropic: give an isotropic material"
        )


def adaptive_grid(material: Material, *, description: str = "", square: int = SQUARE) -> xr.Dataset:
    """Resample an isotropic material to the fields of an RGL file.

    The format does not support missing values. These are interpolated along theta_h, and extrapolated at the ends.
    `convert` reports the difference of the result from the material.

    Args:
        material: isotropic material with one or three channels, such as `Tabulated(table)`.
        description: text for the file. Default: "", which means "made by matcam".
        square: nodes of the tabulated square along each side, an even number from 8 to 512. Default: 192, a file of 36
            MB; fewer nodes give a smaller and coarser file.

    Returns:
        Dataset of the fields, as returned by `read_rgl` and accepted by `write_rgl` and `Adaptive`. Attribute
        `missing_share` is the share of missing values among all values above the horizon.

    Raises:
        ArgumentError: the material is anisotropic or black, or has neither one nor three channels; or `square` or
            `description` is invalid.

    Source:
        Dupuy and Jakob (2018), *An Adaptive Parameterization for Efficient Material Acquisition and Rendering*.

    Example:
        >>> fields = matcam.exchange.adaptive_grid(matcam.Microfacet(matcam.GGX(0.3), 0.9), square=8)
        >>> fields["rgb"].dims, fields["rgb"].shape
        (('phi_i', 'theta_i', 'channel', 'row', 'column'), (1, 44, 3, 8, 8))
    """
    check_isotropic(material)
    if type(square) is not int or square % 2 or not 8 <= square <= 512:
        raise ArgumentError(f"square must be an even number from 8 to 512, got {square!r}")
    return resampled_grid(material, _FINEST._replace(square=square), description)


def resampled_grid(
    material: Material, size: GridSize, description: str = "", *, peak_error: float | None = None
) -> xr.Dataset:
    """Resample a material that `adaptive_grid` supports to an RGL grid of the given size.

    `peak_error` is the largest permitted relative error, no unit, of a peak that is interpolated between two angles of the
    light up to 45 degrees. Angles are added until the error does not exceed this limit. Default: None, no angles are added.
    """
    square, light_angles = size.square, _light_angles(*size.angles)
    if peak_error is not None:
        needed = peak_angles(material, peak_error)
        # one of two angles suffices if they are closer than a cell of a MERL table
        apart = np.abs(light_angles[:, None] - needed).min(axis=1) > np.radians(0.75)
        light_angles = np.sort(np.concatenate([needed, light_angles[apart]]))
    u = np.linspace(0, 1, _nodes(material))
    facets = _facets(material, u)
    area = _projected_area(u, facets, u**2 * _HALF_PI)
    seen_area = np.interp(np.sqrt(light_angles / _HALF_PI), u, area)
    coarse = np.linspace(0, 1, size.normals) if size.normals else u
    visible = _visible(coarse, np.interp(coarse, u, facets), light_angles, size.azimuths)
    warp = Warp(visible)
    grid = np.linspace(0, 1, square)
    # the other half of the square is the mirror image of the first half
    position_u, position_v, tabulated_density = warp.inverse(grid, grid[: square // 2])
    theta_m, phi_m = position_u**2 * _HALF_PI, (2 * position_v - 1) * np.pi
    outgoing, cos_o, missing = _outgoing(material, theta_m, phi_m, light_angles)
    d = np.interp(position_u, u, facets)
    values = np.maximum(_fill_gaps(outgoing * (4 * seen_area[:, None, None] / d)[..., None], cos_o), 0)
    # density of samples: BRDF cos_o times the solid angle of views, which is 4 i . m times that of half vectors, over the
    # density of the warp
    light = light_angles[:, None, None]
    cos = np.cos(light) * np.cos(theta_m) + np.sin(light) * np.sin(theta_m) * np.cos(phi_m)
    solid = d * np.maximum(cos, 0) * _jacobian(position_u)
    density = values.mean(axis=-1) * solid / np.where(tabulated_density > 0, tabulated_density, 1.0)
    whole = lambda half, axis: np.concatenate([half, np.flip(half, axis)], axis).astype(np.float32)  # noqa: E731
    note = (checks.instance("description", description, str) or "made by matcam").encode()
    return xr.Dataset(
        {
            "description": ("description_0", np.frombuffer(note, dtype=np.uint8)),
            "sigma": (("sigma_phi", "sigma_theta"), np.tile(area, (2, 1)).astype(np.float32)),
            "ndf": (("ndf_phi", "ndf_theta"), np.tile(facets, (2, 1)).astype(np.float32)),
            "vndf": (("phi_i", "theta_i", "vndf_phi", "vndf_theta"), visible[None].astype(np.float32)),
            "luminance": (("phi_i", "theta_i", "row", "column"), whole(density, 1)[None]),
            "rgb": (("phi_i", "theta_i", "channel", "row", "column"), whole(np.moveaxis(values, -1, 1), 2)[None]),
            "jacobian": ("jacobian_0", np.ones(1, dtype=np.uint8)),
        },
        coords={"phi_i": np.zeros(1, dtype=np.float32), "theta_i": light_angles.astype(np.float32)},
        attrs={"missing_share": missing},
    )


def peak_angles(material: Material, error: float) -> np.ndarray:
    """Choose angles of the light, rad, between which the peak is approximately linear.

    Intervals are divided at their largest deviation until the error is satisfied (Douglas and Peucker 1973).

    Args:
        material: isotropic material.
        error: largest deviation of the peak from linear interpolation, relative to the peak, no unit.
    """
    # centres and edges of the cells of a MERL table up to 45.5 degrees, between which the table is linear
    angle = np.radians(np.arange(0, 45.75, 0.5))
    peak = np.asarray(material.brdf(np.zeros_like(angle), angle, np.full_like(angle, _HALF_PI)))
    peak = peak.reshape(angle.size, -1)
    known = np.isfinite(peak).all(axis=1) & (peak > 0).any(axis=1)
    if known.sum() < 2:
        return angle[[0, -1]]
    peak = np.stack([np.interp(angle, angle[known], row[known]) for row in peak.T], axis=1)
    scale = np.maximum(np.abs(peak), _FAINTEST * np.abs(peak).max())
    chosen, open_ = {0, angle.size - 1}, [(0, angle.size - 1)]
    while open_:
        first, last = open_.pop()
        inner = slice(first + 1, last)
        share = ((angle[inner] - angle[first]) / (angle[last] - angle[first]))[:, None]
        line = peak[first] + (peak[last] - peak[first]) * share
        deviation = np.max(np.abs(line - peak[inner]) / scale[inner], axis=1, initial=0.0)
        if deviation.size and deviation.max() > error:
            worst = first + 1 + int(np.argmax(deviation))
            chosen.add(worst)
            open_ += [(first, worst), (worst, last)]
    return angle[sorted(chosen)]


def _nodes(material: Material) -> int:
    """Choose the number of nodes in theta_h.

    The number of intervals is a multiple of 180, which is two for each theta_h cell of a MERL table. It is the smallest
    multiple with ten or more intervals within the width of the lobe, and at most the eighth.
    """
    finest = np.sqrt(float(material.finest) / _HALF_PI)
    return 180 * int(np.clip(np.ceil(10 / finest / 180), 1, 8)) + 1


def _facets(material: Material, u: np.ndarray) -> np.ndarray:
    """Compute D at the nodes `u` = sqrt(theta_h / (pi / 2)), 1/sr, (n,).

    D is the weighted mean of BRDF cos theta_i cos theta_o over difference angles. It is normalised such that the
    integral of D cos theta_h over the hemisphere is 1. The difference angles extend to the horizon, because a camera
    widens a lobe there, and the values of the file are divided by D.
    """
    theta_h = (u**2 * _HALF_PI)[:, None, None]
    theta_d = np.radians(np.arange(2.5, 90, 5))[:, None]
    phi_d = np.radians(np.arange(0, 180, 30.0))
    cos_mean = np.cos(theta_h) * np.cos(theta_d)
    cos_half = np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    weight = np.maximum(cos_mean**2 - cos_half**2, 0)
    brdf = np.asarray(material.brdf(theta_h, theta_d, phi_d))
    brdf = brdf.mean(axis=-1) if brdf.ndim == 4 else brdf
    known = np.isfinite(brdf) & (weight > 1e-4)
    total = np.sum(np.where(known, weight, 0), axis=(1, 2))
    light = np.sum(np.where(known, weight**2 * brdf, 0), axis=(1, 2))
    if not np.any(light > 0):
        raise ArgumentError(
            "the BRDF of the material has no positive value, so it has no lobe to sample: give a material that is not black"
        )
    mean = np.where(total > 0, light / np.where(total > 0, total, 1), np.nan)
    d = np.interp(u, u[total > 0], mean[total > 0])
    d = np.maximum(d, _FAINTEST * d.max())
    fine = _between(u)
    theta = fine**2 * _HALF_PI
    return d / np.trapezoid(np.interp(fine, u, d) * 2 * np.pi * np.cos(theta) * np.sin(theta) * np.pi * fine, fine)


def _between(u: np.ndarray) -> np.ndarray:
    return np.linspace(0, 1, 8 * (u.size - 1) + 1)


def _projected_area(u: np.ndarray, facets: np.ndarray, theta_o: np.ndarray) -> np.ndarray:
    """Compute the projected area of the facets in directions o, no unit.

    It is the integral of D max(0, m . o) over the hemisphere of facet normals m. `theta_o` are the angles of o to the
    normal, rad. The integral of max(0, a + b cos phi) over the azimuth phi has a closed form.
    """
    fine = _between(u)
    theta = fine**2 * _HALF_PI
    a, b = np.cos(theta) * np.cos(theta_o)[:, None], np.sin(theta) * np.sin(theta_o)[:, None]
    edge = np.arccos(np.clip(-a / np.maximum(b, 1e-300), -1, 1))
    across = 2 * (a * edge + b * np.sin(edge))
    return np.trapezoid(across * np.interp(fine, u, facets) * np.sin(theta) * np.pi * fine, fine)


def _jacobian(u: np.ndarray) -> np.ndarray:
    """Compute the solid angle of half vectors per area of the unit square, sr.

    `u` is the coordinate sqrt(theta_h / (pi / 2)) of the square.
    """
    return 2 * np.pi**2 * u * np.sin(u**2 * _HALF_PI)


def _visible(u: np.ndarray, facets: np.ndarray, light_angles: np.ndarray, azimuths: int) -> np.ndarray:
    """Compute the relative density of half vectors per area of the unit square, (light angles, azimuths, nodes).

    Half of the azimuths are distributed as visible normals, and half uniformly. At each azimuth, 40 % of the angles are
    distributed as visible normals, 30 % as sqrt(D) cos theta_h, and 30 % uniformly, to resolve the tail.
    """
    theta = u**2 * _HALF_PI
    phi = np.linspace(-np.pi, np.pi, azimuths)[:, None]
    light = light_angles[:, None, None]
    cos = np.cos(light) * np.cos(theta) + np.sin(light) * np.sin(theta) * np.cos(phi)
    seen = facets * np.maximum(cos, 0) * _jacobian(u)
    along = np.trapezoid(seen, u)[..., None]
    over_azimuth = along / np.trapezoid(along[..., 0], phi[:, 0])[:, None, None] + 1 / (2 * np.pi)
    logarithmic = np.sqrt(facets) * np.cos(theta) * _jacobian(u)
    spread = 0.4 * seen / along + 0.3 * logarithmic / np.trapezoid(logarithmic, u)
    return over_azimuth * (spread + 0.3 * 2 * u)


def _outgoing(
    material: Material, theta_m: np.ndarray, phi_m: np.ndarray, light_angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Compute BRDF cos theta_o for light at `light_angles` and half vectors at `theta_m` and `phi_m`.

    All angles are in rad. Half vectors have the shape (light angles, rows, columns).

    Returns:
        BRDF cos theta_o, 1/sr, with channels on the last axis, NaN below the horizon and for missing values; cos
        theta_o; and the share of missing values among those above the horizon.
    """
    light = np.broadcast_to(light_angles[:, None, None], theta_m.shape)
    i = np.sin(light), np.zeros(light.shape), np.cos(light)
    m = np.sin(theta_m) * np.cos(phi_m), np.sin(theta_m) * np.sin(phi_m), np.cos(theta_m)
    twice = 2 * (i[0] * m[0] + i[2] * m[2])
    o = tuple(twice * m_k - i_k for m_k, i_k in zip(m, i, strict=True))
    reflected = np.asarray(material.reflected(local_shading(vector(*i), vector(*o))))
    reflected = reflected if reflected.ndim == 4 else reflected[..., None]
    if reflected.shape[-1] not in (1, len(CHANNELS)):
        raise ArgumentError(
            f"an RGL file requires 1 or {len(CHANNELS)} channels, but this material has {reflected.shape[-1]}"
        )
    above = (o[2] > 0) & (twice > 0)
    outgoing = np.broadcast_to(reflected / np.cos(light)[..., None], (*light.shape, len(CHANNELS)))
    missing = float(np.isnan(outgoing[above]).mean()) if above.any() else 0.0
    return np.where(above[..., None], outgoing, np.nan), o[2], missing


def _fill_gaps(values: np.ndarray, cos_o: np.ndarray) -> np.ndarray:
    """Fill the missing values of every row.

    Gaps between values are interpolated linearly along the row. Missing values before the first value equal this value.
    Beyond the last value, the extrapolation is linear in `cos_o` down to -0.2, and constant below. It does not increase
    towards the horizon. A row without values is filled with 0.
    """
    columns = np.arange(values.shape[2])
    result = np.empty_like(values)
    for position in np.ndindex(values.shape[0], values.shape[1]):
        row, cos = values[position], cos_o[position]
        for channel in range(values.shape[-1]):
            known = np.flatnonzero(np.isfinite(row[:, channel]))
            if not known.size:
                result[(*position, slice(None), channel)] = np.nan
                continue
            whole = np.interp(columns, known, row[known, channel])
            if known.size > 1 and known[-1] < columns[-1]:
                a, b = known[-2:]
                slope = (row[b, channel] - row[a, channel]) / min(cos[b] - cos[a], -1e-6)
                # towards the horizon the BRDF times the cosine may fall, but not rise
                whole[b + 1 :] += max(slope, 0) * (np.maximum(cos[b + 1 :], -0.2) - cos[b])
            result[(*position, slice(None), channel)] = whole
    empty = ~np.isfinite(result)
    return np.where(empty, 0.0, result) if empty.any() else result
