"""Measured BRDFs as materials: tables on the MERL grid, and RGL's adaptive parameterisation.

A table is interpolated linearly, and missing values stay missing. The adaptive parameterisation is that of Dupuy &
Jakob (2018); files/rgl.py describes its fields.

A direction is a point (u, v) of the unit square: theta = u^2 pi / 2, phi = (2 v - 1) pi. The half vector is the point u_m, and
the light is the point u_i. For an isotropic material the azimuth of the half vector is relative to the azimuth of the light. A
map that flattens the field `vndf`, the density of visible normals, maps the point u_m to the point s at which the field `rgb`
is tabulated:

    BRDF cos theta_o = rgb(s) ndf(u_m) / (4 sigma(u_i))           with `jacobian`; otherwise rgb(s) alone.

theta_o is the angle of the view to the normal. The fields `ndf` and `sigma` are the density of facet normals and the projected
area of the facets. A measured file need not be reciprocal, and its tables contain some negative values.

Densities are tabulated for some directions of light, and are bilinear between the nodes of a grid. The map consists of
two cumulative distributions (section 4 of the paper): the marginal distribution of the rows maps y, and the conditional
distribution within a row maps x. Between the directions of light, densities and their integrals are interpolated linearly,
as in Mitsuba's `Marginal2D`. Positions on the flattened square therefore agree with Mitsuba.
"""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from matcam.core.arrays import compiled_by_jax, entries, xp
from matcam.core.arrays.elementary import plane_length
from matcam.core.arrays.module import Module, static_field
from matcam.core.errors import ArgumentError
from matcam.core.grid import GRID_SHAPE, checked_table, sampling_of, theta_h_edges
from matcam.core.shading import Shading
from matcam.material.material import Material, above_horizon, theta_h_of

if TYPE_CHECKING:
    from matcam.core.jax import jax

_HALF_PI = np.pi / 2


class Tabulated(Material):
    """BRDF table on the MERL grid, interpolated.

    The interpolation is linear in (sqrt theta_h, theta_d, phi_d).

    - Values are at the centre or the edge of their cells, according to `sampling` of the table.
    - phi_d + pi is equivalent to phi_d (reciprocity), so the last and the first phi_d are neighbours.
    - Below the first theta_h the first value is used, because through theta_h = 0 the table continues at phi_d + pi,
      which has the same value. Beyond the last theta_h and theta_d the last value is used.
    - A missing cell (NaN) stays missing: the result is NaN if the nearest sampling point is NaN. Otherwise missing
      neighbours are omitted, and the weights of the others are normalised.

    Args:
        table: BRDF, 1/sr, dims (theta_h, theta_d, phi_d, channel), shape (90, 90, 180, channels), such as
            `read_merl` returns.

    Attributes:
        values: the table, 1/sr, shape (90, 90, 180, channels).
        shift: position of a value in its cell, in cells: 0.5 for "centre", 0 for "edge".

    Raises:
        ArgumentError: the table has wrong dimensions, a wrong shape or wrong attributes.

    Source:
        Matusik et al. (2003), "A Data-Driven Reflectance Model" (the grid).

    Example:
        >>> from matcam.core.grid import brdf_table
        >>> grey = matcam.material.Tabulated(brdf_table(np.full((90, 90, 180, 3), 0.25), "centre"))
        >>> np.asarray(grey.brdf(0.1, 0.5, 1.0))
        array([0.25, 0.25, 0.25])
    """

    values: jax.Array
    shift: float = static_field()

    def __init__(self, table: xr.DataArray):
        checked = checked_table(table)
        self.values = xp.array(checked.values, dtype=np.float64)
        self.shift = {"centre": 0.5, "edge": 0.0}[sampling_of(checked)]

    @compiled_by_jax
    def reflected(self, shading: Shading) -> jax.Array:
        """Interpolate the BRDF times both cosines, 1/sr."""
        shading, above = above_horizon(shading)
        brdf = self._interpolate(theta_h_of(shading), xp.asarray(shading.theta_d), xp.asarray(shading.phi_d))
        return xp.where(above[..., None], brdf * (shading.cos_i * shading.cos_o)[..., None], 0.0)

    @property
    def finest(self) -> jax.Array:
        """Width of the first theta_h cell, rad."""
        return xp.asarray(theta_h_edges()[1])

    @property
    def rings(self) -> tuple[int, float]:
        """Number of half angles of the table, and their position.

        The half angles are evenly spaced in sqrt(theta_h). The position in a cell is `shift`.
        """
        return GRID_SHAPE[0], self.shift

    def _interpolate(self, theta_h: jax.Array, theta_d: jax.Array, phi_d: jax.Array) -> jax.Array:
        n_h, n_d, n_p = GRID_SHAPE
        peak = theta_h == 0
        root = xp.where(peak, 0.0, xp.sqrt(xp.where(peak, 1.0, theta_h / (np.pi / 2))))
        position_h = xp.clip(root * n_h - self.shift, 0, n_h - 1)
        position_d = xp.clip(theta_d * n_d / (np.pi / 2) - self.shift, 0, n_d - 1)
        position_p = xp.mod(phi_d / np.pi, 1.0) * n_p - self.shift
        positions = [_whole_where_close(position) for position in (position_h, position_d, position_p)]
        low = [xp.floor(position) for position in positions]
        fractions = [position - floor for position, floor in zip(positions, low, strict=True)]
        i_h, i_d, i_p = (floor.astype(int) for floor in low)

        total = weights = missing = xp.zeros(())
        for up in product((0, 1), repeat=3):
            # out-of-range neighbours have weight 0, with an arbitrary entry
            at = xp.minimum(i_h + up[0], n_h - 1), xp.minimum(i_d + up[1], n_d - 1), xp.mod(i_p + up[2], n_p)
            value = entries(self.values, *at)
            share = xp.ones(())
            nearest = xp.ones((), dtype=bool)
            for fraction, above in zip(fractions, up, strict=True):
                share = share * (fraction if above else 1 - fraction)
                nearest = nearest & ((fraction > 0.5) if above else (fraction <= 0.5))
            known = xp.isfinite(value)
            share = xp.where(known, share[..., None], 0.0)
            total = total + share * xp.where(known, value, 0.0)
            weights = weights + share
            missing = missing + xp.where(nearest[..., None] & ~known, 1.0, 0.0)
        return xp.where(missing > 0, xp.nan, total / xp.where(weights > 0, weights, 1.0))

    def __repr__(self) -> str:
        sampling = "edge" if self.shift == 0 else "centre"
        return f"Tabulated({' x '.join(map(str, self.values.shape))}, sampling={sampling!r})"


def _whole_where_close(position: jax.Array) -> jax.Array:
    """Round positions that are integers up to rounding errors.

    A compiler may compute a position twice with different rounding: for its cell and for its fraction of the cell.
    """
    whole = xp.round(position)
    return xp.where(xp.abs(position - whole) < 1e-9, whole, position)


class Blend(NamedTuple):
    """Interpolation between tabulated directions of light.

    Attributes:
        slices: indices of the tabulated directions for each point, shape (points, slices).
        weight: weights of the directions, same shape.
    """

    slices: jax.Array
    weight: jax.Array

    def of(self, grids: jax.Array, *at: jax.Array) -> jax.Array:
        """Compute the sum of weight * grids[slices, *at] over the slices, (points, ...)."""
        values = entries(grids, self.slices, *(a[:, None] for a in at))
        return xp.sum(self.weight.reshape(*self.weight.shape, *(1,) * (values.ndim - 2)) * values, axis=1)


def blend(axes: tuple[jax.Array, jax.Array], azimuth: jax.Array, theta: jax.Array) -> Blend:
    """Build the linear interpolation between tabulated directions of light.

    axes: azimuths (P,) and angles (T,) of the tabulated directions, rad. There are P T slices. azimuth, theta: direction of
    the light of each point, rad, (points,). Beyond the ends of the axes, the value at the end is used.
    """
    (i_p, w_p), (i_t, w_t) = (_between(axis, value) for axis, value in zip(axes, (azimuth, theta), strict=True))
    index = i_p[:, :, None] * axes[1].size + i_t[:, None, :]
    return Blend(index.reshape(theta.size, -1), (w_p[:, :, None] * w_t[:, None, :]).reshape(theta.size, -1))


def _between(axis: jax.Array, value: jax.Array) -> tuple[jax.Array, jax.Array]:
    if axis.size == 1:
        return xp.zeros((value.size, 1), dtype=int), xp.ones((value.size, 1))
    low = xp.clip(xp.searchsorted(axis, value, side="right") - 1, 0, axis.size - 2)
    first, second = entries(axis, low), entries(axis, low + 1)
    share = xp.clip((value - first) / (second - first), 0, 1)
    return xp.stack([low, low + 1], axis=-1), xp.stack([1 - share, share], axis=-1)


def bilinear(slices: jax.Array, chosen: Blend | None, x: jax.Array, y: jax.Array) -> jax.Array:
    """Interpolate a grid at positions of the unit square.

    slices: one grid, (rows, columns), or several grids that `chosen` blends, (slices, rows, columns, ...). x: positions
    from the first to the last column. y: positions from the first to the last row.
    """
    rows, columns = slices.shape[:2] if chosen is None else slices.shape[1:3]
    (i_x, t_x), (i_y, t_y) = _cell(x, columns), _cell(y, rows)
    look = partial(entries if chosen is None else chosen.of, slices)
    if slices.ndim == 4:
        t_x, t_y = t_x[:, None], t_y[:, None]
    upper = (1 - t_x) * look(i_y, i_x) + t_x * look(i_y, i_x + 1)
    lower = (1 - t_x) * look(i_y + 1, i_x) + t_x * look(i_y + 1, i_x + 1)
    return (1 - t_y) * upper + t_y * lower


def _cell(position: jax.Array, nodes: int) -> tuple[jax.Array, jax.Array]:
    scaled = xp.clip(position, 0, 1) * (nodes - 1)
    low = xp.minimum(xp.floor(scaled).astype(int), nodes - 2)
    return low, scaled - low


class Warp(Module):
    """Map of the unit square to itself that makes tabulated densities uniform.

    Attributes:
        density: density of each slice, (slices, rows, columns). Its trapezoidal integral is 1, where a step of the grid has
            length 1.
        conditional: integral of the density along each row up to each node, (slices, rows, columns).
        marginal: integral of the density over all rows up to each row, (slices, rows).
    """

    density: jax.Array
    conditional: jax.Array
    marginal: jax.Array

    def __init__(self, density: npt.ArrayLike):
        raw = np.asarray(density, dtype=np.float64)
        along = _running(raw)
        down = _running(along[..., -1])
        total = down[..., -1]
        self.density = raw / total[:, None, None]
        self.conditional = along / total[:, None, None]
        self.marginal = down / total[:, None]

    def flatten(self, chosen: Blend, x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Map positions x and y, (points,) each, to the flattened square.

        If the density of a row is 0, x is mapped to 0.
        """
        i_x, t_x = _cell(x, self.density.shape[2])
        i_y, t_y = _cell(y, self.density.shape[1])
        corner = {(a, b): chosen.of(self.density, i_y + b, i_x + a) for a in (0, 1) for b in (0, 1)}
        left, right = ((1 - t_y) * corner[a, 0] + t_y * corner[a, 1] for a in (0, 1))
        before = [chosen.of(self.conditional, i_y + b, i_x) for b in (0, 1)]
        whole = [chosen.of(self.conditional[..., -1], i_y + b) for b in (0, 1)]
        part = t_x * (left + t_x * (right - left) / 2) + (1 - t_y) * before[0] + t_y * before[1]
        row = (1 - t_y) * whole[0] + t_y * whole[1]
        above = t_y * (whole[0] + t_y * (whole[1] - whole[0]) / 2) + chosen.of(self.marginal, i_y)
        return xp.where(row > 0, part / xp.where(row > 0, row, 1.0), 0.0), above

    def inverse(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Map a grid on the flattened square back to the original square, for every slice.

        x: columns of the grid, (nx,). y: rows of the grid, (ny,). Every row of the density must have a positive value.

        Returns:
            x and y on the original square, and the density at these positions, shape (slices, ny, nx) each.
        """
        density, conditional, marginal = (np.asarray(a) for a in (self.density, self.conditional, self.marginal))
        slices, rows, columns = density.shape
        at_x, at_y, density_there = (np.empty((slices, y.size, x.size)) for _ in range(3))
        for s in range(slices):
            whole = conditional[s, :, -1]
            i = np.clip(np.searchsorted(marginal[s], y, side="right") - 1, 0, rows - 2)
            t = _within(whole[i], whole[i + 1], y - marginal[s, i])
            at_y[s] = ((i + t) / (rows - 1))[:, None]
            t = t[:, None]
            row = (1 - t) * conditional[s, i] + t * conditional[s, i + 1]
            values = (1 - t) * density[s, i] + t * density[s, i + 1]
            for k in range(y.size):
                area = x * row[k, -1]
                j = np.clip(np.searchsorted(row[k], area, side="right") - 1, 0, columns - 2)
                share = _within(values[k, j], values[k, j + 1], area - row[k, j])
                at_x[s, k] = (j + share) / (columns - 1)
                density_there[s, k] = (1 - share) * values[k, j] + share * values[k, j + 1]
        return at_x, at_y, density_there


def _running(values: np.ndarray) -> np.ndarray:
    """Compute cumulative trapezoidal sums along the last axis, from 0."""
    steps = (values[..., 1:] + values[..., :-1]) / 2
    return np.concatenate([np.zeros_like(values[..., :1]), np.cumsum(steps, axis=-1)], axis=-1)


def _within(first: np.ndarray, last: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Compute the position in [0, 1] up to which a density, linear from `first` to `last`, integrates to `area`."""
    root = np.sqrt(np.maximum(first**2 + 2 * area * (last - first), 0))
    total = first + root
    return np.clip(2 * area / np.where(total > 0, total, 1.0), 0, 1)


class Adaptive(Material):
    """BRDF in RGL's adaptive parameterisation, interpolated as in Mitsuba's `measured`.

    Channels are R, G, B, or the wavelengths of the file. Results are differentiable almost everywhere.

    Args:
        fields: Dataset from `read_rgl` or `adaptive_grid`.

    Attributes:
        azimuths: azimuths of the light, rad, (P,).
        angles: angles of the light to the normal, rad, (T,).
        ndf: density of facet normals on the unit square, 1/sr, (rows, columns).
        sigma: projected area of the facets towards each direction, no unit, (rows, columns).
        warp: map that flattens the density of visible normals.
        values: BRDF times cosine of the viewing angle on the flattened square, 1/sr, (P T, N, N, channels). If `jacobian` is
            True, they are divided by ndf / (4 sigma) and have no unit.
        jacobian: True if `values` lacks the factor ndf / (4 sigma).
        mirrored: ratio of a full turn to the range of the azimuths of the light, 1, 2 or 4. The material has the same values
            at the other azimuths by symmetry. 0 for an isotropic material.

    Raises:
        ArgumentError: `fields` is not such a Dataset, or its azimuths of the light do not span a full, a half or a quarter
            turn.

    Source:
        Dupuy & Jakob (2018), "An Adaptive Parameterization for Efficient Material Acquisition and Rendering".

    Example:
        >>> white = matcam.Microfacet(matcam.GGX(0.5), 0.0, diffuse=0.5)
        >>> material = matcam.material.Adaptive(matcam.exchange.adaptive_grid(white, square=8))
        >>> material.mirrored  # isotropic
        0
    """

    azimuths: jax.Array
    angles: jax.Array
    ndf: jax.Array
    sigma: jax.Array
    warp: Warp
    values: jax.Array
    jacobian: bool = static_field()
    mirrored: int = static_field()

    def __init__(self, fields: xr.Dataset):
        if not isinstance(fields, xr.Dataset) or "vndf" not in fields:
            got = "one without the field vndf" if isinstance(fields, xr.Dataset) else type(fields).__name__
            raise ArgumentError(f"fields must be a Dataset from read_rgl or adaptive_grid, got {got}")

        def array(name: str) -> np.ndarray:
            return fields[name].values.astype(np.float64)

        self.azimuths, self.angles = xp.asarray(array("phi_i")), xp.asarray(array("theta_i"))
        self.ndf, self.sigma = xp.asarray(array("ndf")), xp.asarray(array("sigma"))
        vndf, values = array("vndf"), array("spectra" if "spectra" in fields else "rgb")
        self.warp = Warp(vndf.reshape(-1, *vndf.shape[2:]))
        self.values = xp.moveaxis(values.reshape(-1, *values.shape[2:]), 1, -1)
        self.jacobian = bool(fields["jacobian"].values[0])
        span = float(self.azimuths[-1] - self.azimuths[0])
        self.mirrored = 0 if self.azimuths.size <= 2 else round(2 * np.pi / span)
        if self.mirrored not in (0, 1, 2, 4):
            raise ArgumentError(
                f"field phi_i must span a full, half or quarter turn of the azimuth of the light, got {span:.4g} rad"
            )

    @compiled_by_jax
    def reflected(self, shading: Shading) -> jax.Array:
        """Interpolate the BRDF times both cosines, 1/sr."""
        shading, above = above_horizon(shading)
        shape = above.shape
        flat = Shading(*(xp.broadcast_to(xp.asarray(a, dtype=xp.float64), shape).ravel() for a in shading))
        theta_i, phi_i, theta_m, phi_m = self._directions(flat)
        azimuth = phi_m if self.mirrored else phi_m - phi_i
        position = (azimuth + np.pi) / (2 * np.pi)
        u, v = xp.sqrt(theta_m / _HALF_PI), position - xp.floor(position)
        light = blend((self.azimuths, self.angles), phi_i, theta_i)
        outgoing = bilinear(self.values, light, *self.warp.flatten(light, u, v))
        if self.jacobian:
            facets = bilinear(self.ndf, None, u, v)
            area = bilinear(self.sigma, None, xp.sqrt(theta_i / _HALF_PI), (phi_i + np.pi) / (2 * np.pi))
            outgoing = outgoing * (facets / (4 * xp.where(area > 0, area, 1.0)))[:, None]
        outgoing = (outgoing * flat.cos_i[:, None]).reshape(*shape, -1)
        return xp.where(above[..., None], outgoing, 0.0)

    def _directions(self, shading: Shading) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        """Compute angles and azimuths of light and half vector, within the tabulated range."""
        slope = plane_length(shading.slope_along, shading.slope_across)
        none = slope == 0
        safe = xp.where(none, 1.0, slope)
        c, s = xp.where(none, 1.0, shading.slope_along / safe), xp.where(none, 0.0, shading.slope_across / safe)
        theta_m = xp.arctan(slope)
        # the light, first with the half vector in the x-z plane (core.grid.azimuth_difference), then rotated to its
        # azimuth
        x = xp.cos(theta_m) * xp.sin(shading.theta_d) * xp.cos(shading.phi_d) + xp.sin(theta_m) * xp.cos(
            shading.theta_d
        )
        y = xp.sin(shading.theta_d) * xp.sin(shading.phi_d)
        i_x, i_y, m_x, m_y = c * x - s * y, s * x + c * y, c, s
        if self.mirrored >= 2:
            flip_y = xp.where(i_y < 0, 1.0, -1.0)
            flip_x = xp.where(i_x < 0, 1.0, -1.0) if self.mirrored == 4 else flip_y
            i_x, i_y, m_x, m_y = i_x * flip_x, i_y * flip_y, m_x * flip_x, m_y * flip_y
        theta_i = xp.arctan2(plane_length(i_x, i_y), shading.cos_i)
        return theta_i, xp.arctan2(i_y, i_x), theta_m, xp.arctan2(m_y, m_x)

    @property
    def finest(self) -> jax.Array:
        """Half width of the lobe averaged over azimuths, rad.

        The half width is at least one step of the grid.
        """
        profile = xp.mean(self.ndf, axis=0)
        below = xp.argmax(xp.append(profile, 0.0) < profile.max() / 2)
        return xp.maximum(below / (profile.size - 1), 1 / (profile.size - 1)) ** 2 * _HALF_PI

    def __repr__(self) -> str:
        p, t = self.azimuths.size, self.angles.size
        return f"Adaptive({p} x {t} directions of light, {' x '.join(map(str, self.values.shape[1:]))})"
