"""MERL grid of half and difference angles (Rusinkiewicz 1998), and tables of a BRDF on this grid.

A pair of directions, of the light and of the view, is given by (theta_h, theta_d, phi_d). theta_h is the angle between half
vector and normal. theta_d and phi_d are the polar angle and the azimuth of the light in a frame whose pole is the half
vector. The x axis of this frame points away from the normal. An exchange of light and view changes phi_d by pi.

A table is an xarray.DataArray on this grid. Missing values are NaN. The attribute `sampling` specifies at which position of a
cell the value applies, "centre" or "edge".
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from matcam.core import checks
from matcam.core.arrays import linalg, xp
from matcam.core.errors import ArgumentError

if TYPE_CHECKING:
    import xarray as xr
    from jax.typing import ArrayLike

    from matcam.core.jax import AnyArray, jax

GRID_SHAPE = (90, 90, 180)
"""Number of cells of a MERL table along (theta_h, theta_d, phi_d)."""

Sampling = Literal["centre", "edge"]
SAMPLINGS: tuple[Sampling, ...] = ("centre", "edge")
"""Sampling positions of values in their cells; loaders of MERL files differ."""


DIMS = ("theta_h", "theta_d", "phi_d", "channel")
CHANNELS = ("R", "G", "B")
CHANNEL_WAVELENGTHS = (610e-9, 550e-9, 465e-9)
"""Representative wavelengths of R, G, B, m, at which tabulated metals are compared. MERL does not publish its camera's
spectral response; these are the middles of the bands of a common RGB sensor."""


class Grid(NamedTuple):
    """Angles at which the cells of a MERL table are sampled.

    Attributes:
        theta_h: half angles, shape (90,), rad.
        theta_d: difference angles, shape (90,), rad.
        phi_d: azimuths of the difference, shape (180,), rad.

    Example:
        >>> from matcam.core.grid import merl_grid
        >>> merl_grid("centre").index(theta_h=0.0, phi_d=np.radians(90))
        (0, slice(None, None, None), 90)
    """

    theta_h: np.ndarray
    theta_d: np.ndarray
    phi_d: np.ndarray

    def index(  # type: ignore[override]  # replaces tuple.index: the arguments are angles
        self, *, theta_h: ArrayLike | None = None, theta_d: ArrayLike | None = None, phi_d: ArrayLike | None = None
    ) -> tuple[Any, Any, Any]:
        """Compute the index of the cell that contains given angles.

        An angle belongs to the cell that contains it, whatever the sampling position is. This is the rule of MERL, which
        rounds down. An angle on the border of two cells belongs to the upper cell. The end of the range belongs to the
        last cell.

        Args:
            theta_h: half angle, rad, [0, pi / 2], any shape. Default: None, all half angles.
            theta_d: difference angle, rad, [0, pi / 2], any shape. Default: None, all difference angles.
            phi_d: azimuth of the difference, rad, [0, pi], any shape. Default: None, all azimuths.

        Returns:
            The index along theta_h, theta_d and phi_d. Each is a whole number, an array of whole numbers, or slice(None)
            for an omitted angle.

        Raises:
            ArgumentError: an angle is out of its range.
        """
        given = {"theta_h": theta_h, "theta_d": theta_d, "phi_d": phi_d}
        i, j, k = (
            slice(None) if angle is None else _cell_of(name, angle, count)
            for (name, angle), count in zip(given.items(), GRID_SHAPE, strict=True)
        )
        return i, j, k


def _cell_of(name: str, angle: ArrayLike, count: int) -> Any:
    end = np.pi if name == "phi_d" else np.pi / 2
    share = np.asarray(checks.within(name, angle, 0, end, "rad")) / end
    position = count * (np.sqrt(share) if name == "theta_h" else share)
    # an angle that is less than 1e-9 cells below a border is on the border, up to rounding
    cell = np.minimum(np.floor(position + 1e-9).astype(int), count - 1)
    return cell if cell.ndim else int(cell)


def merl_grid(sampling: Sampling) -> Grid:
    """Compute the angles at which the cells of a MERL table are sampled.

    The spacing of theta_h is quadratic: theta_h = ((i + s) / 90)^2 pi / 2 for cell i, where s = 0.5 for "centre" and s = 0
    for "edge". This spacing follows from the reader of MERL, in which i = floor(90 sqrt(theta_h / (pi / 2))).
    """
    shift = 0.5 if sampling == "centre" else 0.0
    n_h, n_d, n_p = GRID_SHAPE
    return Grid(
        ((np.arange(n_h) + shift) / n_h) ** 2 * np.pi / 2,
        (np.arange(n_d) + shift) / n_d * np.pi / 2,
        (np.arange(n_p) + shift) / n_p * np.pi,
    )


def theta_h_edges() -> np.ndarray:
    """Compute the borders of the theta_h cells, rad, shape (91,)."""
    return (np.arange(GRID_SHAPE[0] + 1) / GRID_SHAPE[0]) ** 2 * np.pi / 2


def cosines(theta_h: ArrayLike, theta_d: ArrayLike, phi_d: ArrayLike) -> tuple[jax.Array, jax.Array]:
    """Compute the cosines of the angles of light and view to the normal, in this order.

    The arguments are in rad. The cosine of a direction below the horizon is negative.
    """
    theta_h, theta_d, phi_d = (xp.asarray(a, dtype=xp.float64) for a in (theta_h, theta_d, phi_d))
    mean = xp.cos(theta_h) * xp.cos(theta_d)
    half_difference = xp.sin(theta_h) * xp.sin(theta_d) * xp.cos(phi_d)
    return mean - half_difference, mean + half_difference


def azimuth_difference(theta_h: AnyArray, theta_d: AnyArray, phi_d: AnyArray) -> jax.Array:
    """Compute the difference of the azimuths of light and view about the surface normal, rad.

    The arguments are in rad. The result lies in [0, pi]. It is pi if light and view lie on opposite sides of the normal, as
    for a mirror.
    """
    # with the half vector in the x-z plane, the light is Ry(theta_h) (sin td cos pd, sin td sin pd, cos td) and the
    # view the same with pd + pi; their projections on the surface:
    along = xp.cos(theta_h) * xp.sin(theta_d) * xp.cos(phi_d)
    offset = xp.sin(theta_h) * xp.cos(theta_d)
    across = xp.sin(theta_d) * xp.sin(phi_d)
    x_i, x_o = offset + along, offset - along
    sine, cosine = x_i * -across - across * x_o, x_i * x_o - across * across
    # along the normal the azimuth is undefined: any value suffices, but its derivative must be finite
    return xp.abs(xp.arctan2(sine, xp.where((sine == 0) & (cosine == 0), -1.0, cosine)))


def azimuth_at_cosines(cos_i: AnyArray, cos_o: AnyArray, theta_d: AnyArray) -> AnyArray:
    """Compute `azimuth_difference` from the cosines of the angles of light and view.

    The spherical law of cosines needs fewer trigonometric functions. The error is below 5e-8 rad divided by the smaller
    sine of the two angles, which suffices for masking: near the normal there is none.
    """
    product = xp.sqrt(xp.maximum((1 - cos_i**2) * (1 - cos_o**2), 1e-30))  # of the sines; finite along the normal
    return xp.arccos(xp.clip((xp.cos(2 * theta_d) - cos_i * cos_o) / product, -1.0, 1.0))


def half_and_difference(
    theta_i: ArrayLike, phi_i: ArrayLike, theta_o: ArrayLike, phi_o: ArrayLike
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Compute (theta_h, theta_d, phi_d) of light and view, rad.

    phi_d lies in [0, 2 pi). If the half vector is the normal, phi_d is the azimuth of the light.

    Args:
        theta_i: angle of the light to the normal, rad.
        phi_i: azimuth of the light, rad.
        theta_o: angle of the view to the normal, rad.
        phi_o: azimuth of the view, rad.
    """
    theta_i, phi_i, theta_o, phi_o = (xp.asarray(a, dtype=xp.float64) for a in (theta_i, phi_i, theta_o, phi_o))

    def vector(theta: Any, phi: Any) -> jax.Array:
        return xp.stack([xp.sin(theta) * xp.cos(phi), xp.sin(theta) * xp.sin(phi), xp.cos(theta)])

    i, o = vector(theta_i, phi_i), vector(theta_o, phi_o)
    half = i + o
    theta_d = xp.arctan2(linalg.norm(i - o, axis=0), linalg.norm(half, axis=0))
    across = xp.hypot(half[0], half[1])
    theta_h = xp.arctan2(across, half[2])
    c, s = (
        xp.where(across > 0, a / xp.where(across > 0, across, 1.0), at) for a, at in ((half[0], 1.0), (half[1], 0.0))
    )
    # the light, rotated to azimuth 0 of the half vector, then tilted so that the half vector is the pole
    x, y = c * i[0] + s * i[1], c * i[1] - s * i[0]
    phi_d = xp.arctan2(y, x * xp.cos(theta_h) - i[2] * xp.sin(theta_h))
    return theta_h, theta_d, xp.mod(phi_d, 2 * xp.pi)


def below_horizon(sampling: Sampling) -> np.ndarray:
    """Mark the cells in which light or view is not above the horizon.

    The mask has the shape (90, 90, 180). The angles of a cell are those at its sampling position.
    """
    theta_h, theta_d, phi_d = merl_grid(sampling)
    mean = np.cos(theta_h)[:, None] * np.cos(theta_d)
    half_difference = np.sin(theta_h)[:, None] * np.sin(theta_d)
    return mean[:, :, None] <= half_difference[:, :, None] * np.abs(np.cos(phi_d))


def brdf_table(values: np.ndarray, sampling: Sampling, **attrs: object) -> xr.DataArray:
    """Build a BRDF table from values on the MERL grid.

    The values have the shape (90, 90, 180, 3), with the channels R, G, B, and the unit 1/sr. Missing values are NaN.
    `sampling` is the sampling position of the values in the cells. `attrs` are further attributes of the table.
    """
    import xarray as xr

    from matcam.core.results.labelled import named

    grid = merl_grid(sampling)
    table = xr.DataArray(
        values,
        dims=DIMS,
        coords={
            "theta_h": ("theta_h", grid.theta_h),
            "theta_d": ("theta_d", grid.theta_d),
            "phi_d": ("phi_d", grid.phi_d),
            "channel": list(CHANNELS),
        },
        name="brdf",
        attrs={"units": "1/sr", "long_name": "BRDF", "sampling": sampling, **attrs},
    )
    return checked_table(named(table))


def checked_table(table: xr.DataArray) -> xr.DataArray:
    """Check a BRDF on the MERL grid, and order its channels.

    Channels are ordered R, G, B if these are their labels. An ArgumentError is raised for wrong dimensions, shape,
    coordinates, labels, units or values.
    """
    import xarray as xr

    if not isinstance(table, xr.DataArray):
        raise ArgumentError(f"a BRDF table must be an xarray.DataArray (see read_merl), got {type(table).__name__}")
    if table.dims != DIMS:
        raise ArgumentError(f"a BRDF table must have dims {DIMS}, got {table.dims}")
    if table.shape[:3] != GRID_SHAPE or table.shape[3] < 1:
        raise ArgumentError(f"a BRDF table must have shape {GRID_SHAPE} x channels, got {table.shape}")
    if table.dtype.kind not in "fiu":
        raise ArgumentError(f"a BRDF table must contain real numbers, got {table.dtype}")
    sampling = sampling_of(table)
    for name, expected in merl_grid(sampling)._asdict().items():
        if name not in table.coords or not np.allclose(table.coords[name], expected, rtol=0, atol=1e-9):
            given = table.coords.get(name)
            in_degrees = given is not None and np.allclose(given, np.degrees(expected), rtol=0, atol=1e-7)
            hint = f"; its values are in degrees: give np.radians(table[{name!r}])" if in_degrees else ""
            raise ArgumentError(
                f"coordinate {name} must contain the angles of the MERL grid at the {sampling} of each cell, rad{hint}"
            )
        check_unit(f"coordinate {name}", table.coords[name], "rad")
    check_unit("a BRDF table", table, "1/sr")
    if np.isinf(table.values).any():
        raise ArgumentError("a BRDF table must not contain infinities: use NaN for missing values")
    return in_order(table, "a BRDF table")


def in_order(table: xr.DataArray, what: str) -> xr.DataArray:
    """Order the channels R, G, B if these are their labels.

    Three channels without labels are assumed to be in this order. An ArgumentError is raised if three channels have
    other labels, because their wavelengths are unknown, or if two channels have the same label. `what` is the name of the
    values in the message.
    """
    if "channel" not in table.coords:
        return table
    labels = [str(label) for label in np.atleast_1d(table["channel"].values)]
    if len(set(labels)) < len(labels):
        raise ArgumentError(f"{what} has the channels {', '.join(labels)}: each label must occur once")
    if len(labels) != len(CHANNELS) or tuple(labels) == CHANNELS:
        return table
    if set(labels) != set(CHANNELS):
        raise ArgumentError(
            f"{what} of three channels must label them R, G, B, in any order, got {', '.join(labels)[:60]}: "
            "assign these labels, or omit the coordinate if the channels are in this order"
        )
    return table.isel(channel=[labels.index(label) for label in CHANNELS])


def check_unit(what: str, values: xr.DataArray, unit: str) -> None:
    """Check that the attribute `units` of values is missing or a spelling of `unit`.

    Otherwise an ArgumentError is raised. `what` is the name of the values in the message.
    """
    stated = values.attrs.get("units", unit)
    if not isinstance(stated, str) or stated not in _SAME_UNIT[unit]:
        raise ArgumentError(
            f"{what} must be in {unit}, but attrs['units'] is {stated!r:.40}: convert the values, or correct this attribute"
        )


_SAME_UNIT = {
    "1/sr": ("1/sr", "sr-1", "sr^-1", "sr**-1"),
    "rad": ("rad", "radian", "radians"),
    "nm": ("nm", "nanometer"),
}
"""Spellings of each unit that UDUNITS accepts."""


def azimuth_of(table: xr.DataArray) -> float | None:
    """Read the azimuth of the lamp in the images of a table, rad.

    The azimuth is the attribute `lamp_azimuth` of the table. The result is None if the attribute is missing. An ArgumentError
    is raised if the attribute is not a number in [-2 pi, 2 pi].
    """
    azimuth = table.attrs.get("lamp_azimuth")
    if azimuth is None:
        return None
    if not isinstance(azimuth, int | float | np.number) or not abs(float(azimuth)) <= 2 * np.pi:
        raise ArgumentError(f"attrs['lamp_azimuth'] of a BRDF table must lie in [-2 pi, 2 pi] rad, got {azimuth!r:.60}")
    return float(azimuth)


def sample_of(table: xr.DataArray) -> str | None:
    """Read the shape of the sample from the attribute `sample` of a table.

    The result is None if the attribute is missing. An ArgumentError is raised for an unknown shape.
    """
    kind = table.attrs.get("sample")
    if kind is None or kind in ("sphere", "cylinder", "flat"):
        return kind
    raise ArgumentError(f"attrs['sample'] of a BRDF table must be 'sphere', 'cylinder' or 'flat', got {kind!r:.60}")


def sampling_of(table: xr.DataArray) -> Sampling:
    sampling = table.attrs.get("sampling")
    if sampling not in SAMPLINGS:
        raise ArgumentError(f"attrs['sampling'] of a BRDF table must be 'centre' or 'edge', got {sampling!r}")
    return sampling


CORRECTED = "corrected_for_camera"
"""Name of the attribute that marks a table as corrected, or as reconstructed from photographs."""


def check_recorded(table: xr.DataArray, what: str = "brdf") -> None:
    """Raise ArgumentError if a table is corrected for a camera, or reconstructed from photographs.

    `what` is the name of the table in the message.
    """
    if table.attrs.get(CORRECTED):
        kind = table.attrs.get("long_name", "corrected BRDF")
        raise ArgumentError(f"{what} is already a {kind}: give the table as it was recorded")
