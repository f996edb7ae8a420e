"""A picture to within a stated error, exact only where it has to be: most of a sample is smooth, or dark beside its highlight.

What a pixel records lies between the least and the largest radiance within its kernel's reach. Where these differ by less
than the error, the radiance at its centre will do. A highlight can hide between the centres, so all around it is exact.

A picture of a material on a curved sample, as the rig's camera takes it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from scipy.ndimage import maximum_filter, minimum_filter

from matcam.camera.sensor import Seed, Sensor
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp
from matcam.forward.integral.blur import Blur, blur_of, groups_of, kernel_error
from matcam.forward.integral.plan import Targets, filled, planned
from matcam.forward.integral.recording import record
from matcam.forward.integral.scene import Scene, highlight_x
from matcam.material.material import Material
from matcam.rigs import Rig, picture_shape
from matcam.sample.shape import Curved


def record_within(
    error: float, material: Material, sample: Curved, blur: Blur, lamp_angle: float, x: np.ndarray, y: np.ndarray
) -> jax.Array:
    """Radiance, 1/sr, that pixels centred on x (columns,), y (rows,) px, one apart, record, within `error` of the largest;
    shape (rows, columns, channels). Not to be differentiated: which pixels are exact depends on the material."""
    scales = [group.scale for group in groups_of(blur, sample)]
    around = int(np.ceil(max(scale.reach for scale in scales)))
    beyond = np.arange(1, around + 1)
    wide = [np.concatenate([a[0] - step * beyond[::-1], a, a[-1] + step * beyond]) for a, step in ((x, 1), (y, -1))]
    centres = np.asarray(_at_centres(Scene(material, sample, jnp.asarray(lamp_angle)), *np.meshgrid(*wide)))
    grown = (2 * around + 1, 2 * around + 1, 1)
    span = (maximum_filter(centres, grown) - minimum_filter(centres, grown)).max(axis=-1)
    span, centres = (a[around : around + y.size, around : around + x.size] for a in (span, centres))
    values, peak_x = centres.copy(), float(highlight_x(sample, jnp.asarray(lamp_angle)))
    x, y = np.meshgrid(x, y)

    def exactly(chosen: np.ndarray) -> None:
        which = filled(np.flatnonzero(chosen))
        if which.size:
            targets = Targets(
                x.ravel()[which],
                y.ravel()[which],
                np.full(which.size, lamp_angle),
                np.zeros(which.size, dtype=np.int32),
            )
            plan = planned(sample, blur, np.array([lamp_angle]), targets)
            values.reshape(-1, values.shape[-1])[which] = np.asarray(record(material, sample, blur, plan))

    side = max(scale.near for scale in scales)
    near = (np.abs(x - peak_x) < side) & (np.abs(y) < side)
    exactly(near)
    peak = values[near].max(initial=0.0) or centres.max()
    exactly((span > error * peak) & ~near)
    return jnp.asarray(values)


@jax.jit
def _at_centres(scene: Scene, x: jax.Array, y: jax.Array) -> jax.Array:
    element, visible = scene.sample.at(x, y)
    lit = visible & (scene.seen(element).cos_i > 0)
    return jnp.where(lit[..., None], scene.sent(element), 0.0)


def picture(
    material: Material,
    rig: Rig,
    lamp_angle: ArrayLike,
    *,
    shape: tuple[int, int] | None = None,
    error: float | None = None,
    exposure: float | None = None,
    seed: Seed | None = None,
    time: float = 0.0,
) -> xr.DataArray:
    """The picture of a sphere or cylinder of `material` under a distant lamp of unit irradiance.

    lamp_angle: between lamp and camera, rad, [0, pi): 2 theta_d; the lamp stands towards +x (right). shape: (height,
    width); None: the rig's crop, or what holds the sample and its blur. Row 0 is on top, pixel centres lie on integers,
    the optical axis at ((width - 1) / 2, (height - 1) / 2).

    error: None for a record as exact as is known (1e-4 of every value or 1e-7 of the peak); else the largest error that may
    be made, as a share of the picture's peak, [1e-6, 0.1]: the more, the faster.

    exposure: None for radiance, 1/sr; a number, e- per unit of radiance, for a raw picture of the camera's sensor, DN, of
    `time` s, with the noise that `seed` stands for.

    DataArray (row, column, channel), or (row, column) behind a colour mosaic. For the differentiable values alone see
    `picture_values`.
    """
    view = _view(material, rig, lamp_angle, shape)
    exposed = _exposed(rig.camera.sensor, exposure, seed, time)
    if error is None:
        values = _recorded(material, view)
    else:
        error = float(checks.within("error", error, 1e-6, 0.1, "of the picture's peak"))
        values = record_within(error, material, *view)
    quantity, unit = "radiance", "1/sr"
    if exposed is not None:
        values, quantity, unit = exposed(values), "digital", "DN"
    return xr.DataArray(
        np.asarray(values),
        dims=("row", "column", "channel")[: values.ndim],
        coords={
            "x": ("column", view.x, {"units": "px"}),
            "y": ("row", view.y, {"units": "px"}),
        },
        name="picture",
        attrs={
            "units": unit,
            "quantity": quantity,
            "lamp_angle": view.lamp_angle,
            "rig": repr(rig),
            "kernel_error": kernel_error(rig),
        },
    )


def picture_values(
    material: Material, rig: Rig, lamp_angle: ArrayLike, shape: tuple[int, int] | None = None
) -> jax.Array:
    """Radiance of `picture`, 1/sr, shape (height, width, channels): differentiable in the numbers of the material and
    the camera. ArgumentError inside jax.jit."""
    return _recorded(material, _view(material, rig, lamp_angle, shape))


class _View(NamedTuple):
    """What is photographed, and what the picture shows of it."""

    sample: Curved
    blur: Blur
    lamp_angle: float
    x: np.ndarray
    y: np.ndarray
    """Places of the columns and of the rows, px."""


def _view(material: Material, rig: Rig, lamp_angle: ArrayLike, shape: tuple[int, int] | None) -> _View:
    if not isinstance(material, Material):
        raise ArgumentError(
            f"material must be a Material such as Microfacet(GGX(0.1), 0.9), got {type(material).__name__}"
        )
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), got {type(rig).__name__}")
    if not isinstance(rig.sample, Curved):
        raise ArgumentError("a flat sample shows one normal: see textured_picture, or use a Sphere or a Cylinder")
    behind = "rad (beyond pi the lamp is behind the sample)"
    lamp = checks.scalar("lamp_angle", checks.within("lamp_angle", lamp_angle, 0, np.pi, behind, open_high=True))
    blur = blur_of(rig)
    reach = max(group.scale.reach for group in groups_of(blur, rig.sample))
    height, width = _shape(rig, shape, reach)
    x, y = np.arange(width) - (width - 1) / 2, (height - 1) / 2 - np.arange(height)
    return _View(rig.sample, blur, float(lamp), x, y)


def _shape(rig: Rig, shape: tuple[int, int] | None, reach: float) -> tuple[int, int]:
    """What was asked for, the rig's crop, or a square that holds the sample and what its light reaches within 8 px."""
    if shape is not None:
        return picture_shape("shape", shape)
    if rig.crop is not None:
        return rig.crop
    side = 2 * int(np.ceil(float(rig.sample.radius) + min(reach, 8.0))) + 1  # type: ignore[attr-defined]
    return picture_shape("shape", (side, side))


def _recorded(material: Material, view: _View) -> jax.Array:
    x, y = (np.ascontiguousarray(a.ravel()) for a in np.meshgrid(view.x, view.y))
    targets = Targets(x, y, np.full(x.size, view.lamp_angle), np.zeros(x.size, dtype=np.int32))
    plan = planned(view.sample, view.blur, np.array([view.lamp_angle]), targets)
    return record(material, view.sample, view.blur, plan).reshape(view.y.size, view.x.size, -1)


def _exposed(
    sensor: Sensor | None, exposure: float | None, seed: Seed | None, time: float
) -> Callable[[jax.Array], jax.Array] | None:
    """What makes a raw picture of radiances; None where these are wanted."""
    if exposure is None:
        return None
    if sensor is None:
        raise ArgumentError("exposure needs a camera with a sensor: Camera(optics, pixel, sensor=Sensor(...))")
    if seed is None:
        raise ArgumentError("exposure needs a seed: a whole number, the same for the same noise")

    def raw(values: jax.Array) -> jax.Array:
        if sensor.cfa is not None and values.shape[-1] == 1:
            values = jnp.broadcast_to(values, (*values.shape[:2], 3))
        return sensor.expose(values, exposure, seed, time)

    return raw
