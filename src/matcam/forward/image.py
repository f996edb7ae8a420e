"""Pictures of a material on a curved sample, as the rig's camera takes them.

A picture within a stated error is exact only where it has to be: most of a sample is smooth, or dark beside its highlight. A
pixel records a value between the least and the largest radiance within its kernel's reach. Where these differ by less than
the error, the radiance at its centre will do. A highlight can hide between the centres, so all around it is exact.
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
from matcam.forward.integral.blur import Imaging, groups_of, imaging_of, kernel_error
from matcam.forward.integral.integrals import Scene, highlight_x
from matcam.forward.integral.plan import RecordPlaces, integration_plan, pad_indices
from matcam.forward.integral.recording import record
from matcam.material.material import Material
from matcam.rigs import Rig, picture_shape
from matcam.sample.shape import Curved

_FARTHEST_REACH = 8.0  # px beyond the limb that a picture holds unless it is given a shape


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
    """Return the picture of a sphere or cylinder under a distant lamp.

    The lamp's irradiance is 1, and it stands towards +x (right). Row 0 is on top. Pixel centres lie on integers, and the
    optical axis at ((width - 1) / 2, (height - 1) / 2). For derivatives see `picture_values`.

    Args:
        material: material of the sample, such as `Microfacet(GGX(0.1), 0.9)`.
        rig: camera, sample and lamp; the sample is a `Sphere` or `Cylinder`.
        lamp_angle: angle between lamp and optical axis, in [0, pi), rad: 2 theta_d with a distant camera.
        shape: (height, width), px. Default: the rig's crop, or what holds the sample and its blur.
        error: largest error allowed, as a share of the picture's peak, in [1e-6, 0.1], no unit; the larger, the faster.
            Default: None, as exact as is known (1e-4 of every value or 1e-7 of the peak).
        exposure: electrons per unit of radiance, e- sr, for a raw picture of the camera's sensor. Default: None, radiance.
        seed: seed of the raw picture's noise, a whole number or a JAX key. Default: None, allowed for radiance only.
        time: exposure time of the raw picture, s, in which dark current gathers. Default: 0.

    Returns:
        Radiance, 1/sr, or digital values, DN, (row, column, channel); (row, column) behind a colour mosaic. Coordinates `x`
        and `y`, px, count from the optical axis, y upwards. Attribute `kernel_error`: see `measure`.

    Raises:
        ArgumentError: an argument is out of its range, the sample is flat, or exposure lacks a sensor or a seed.

    Source:
        docs/model.md 2 and 3.

    Example:
        The middle of a sphere, where no kernel meets the highlight or the limb; without a shape, the whole sphere.

        >>> rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(0.5)), matcam.Sphere(40.0))
        >>> image = matcam.picture(matcam.Microfacet(matcam.GGX(0.1), 0.9), rig, lamp_angle=1.0, shape=(3, 5))
        >>> image.dims, image.shape
        (('row', 'column', 'channel'), (3, 5, 1))
    """
    view = _view(material, rig, lamp_angle, shape)
    raw = _raw_conversion(rig.camera.sensor, exposure, seed, time)
    if error is None:
        values = _exact_record(material, view)
    else:
        values = _record_within(
            float(checks.within("error", error, 1e-6, 0.1, "of the picture's peak")), material, view
        )
    quantity, unit = "radiance", "1/sr"
    if raw is not None:
        values, quantity, unit = raw(values), "digital", "DN"
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
    """Return the radiance of `picture` as an array.

    It is differentiable in the parameters of material and camera.

    Args:
        material: material of the sample, such as `Microfacet(GGX(0.1), 0.9)`.
        rig: camera, sample and lamp; the sample is a `Sphere` or `Cylinder`.
        lamp_angle: angle between lamp and optical axis, in [0, pi), rad; it cannot be traced.
        shape: (height, width), px. Default: see `picture`.

    Returns:
        Radiance under unit irradiance, (height, width, channels), 1/sr.

    Raises:
        ArgumentError: see `picture`; or the call stands inside jax.jit.

    Source:
        docs/model.md 2 and 3.

    Example:
        >>> rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(0.5)), matcam.Sphere(40.0))
        >>> matcam.forward.picture_values(matcam.Microfacet(matcam.GGX(0.1), 0.9), rig, lamp_angle=1.0, shape=(3, 5)).shape
        (3, 5, 1)
    """
    return _exact_record(material, _view(material, rig, lamp_angle, shape))


class _View(NamedTuple):
    """A sample as it is photographed, and the part of it that the picture shows.

    Attributes:
        imaging: sample and blur.
        lamp_angle: angle between lamp and optical axis, rad.
        x: places of the columns, px.
        y: places of the rows, px.
    """

    imaging: Imaging
    lamp_angle: float
    x: np.ndarray
    y: np.ndarray


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
    imaging = imaging_of(rig)
    reach = max(group.scale.reach for group in groups_of(imaging.blur, imaging.sample))
    height, width = _picture_shape(rig, shape, reach)
    return _View(imaging, float(lamp), np.arange(width) - (width - 1) / 2, (height - 1) / 2 - np.arange(height))


def _picture_shape(rig: Rig, shape: tuple[int, int] | None, reach: float) -> tuple[int, int]:
    """Return the picture's (height, width), px.

    It is the given shape, the rig's crop, or a square that holds the sample and its light's reach of at most 8 px.
    """
    if shape is not None:
        return picture_shape("shape", shape)
    if rig.crop is not None:
        return rig.crop
    side = 2 * int(np.ceil(float(rig.sample.radius) + min(reach, _FARTHEST_REACH))) + 1  # type: ignore[attr-defined]
    return picture_shape("shape", (side, side))


def _exact_record(material: Material, view: _View) -> jax.Array:
    x, y = (np.ascontiguousarray(a.ravel()) for a in np.meshgrid(view.x, view.y))
    return _record_pixels(material, view, x, y).reshape(view.y.size, view.x.size, -1)


def _record_pixels(material: Material, view: _View, x: np.ndarray, y: np.ndarray) -> jax.Array:
    """Record pixels centred on (x, y) px; shape (pixels, channels)."""
    places = RecordPlaces(x, y, np.full(x.size, view.lamp_angle), np.zeros(x.size, dtype=np.int32))
    return record(material, view.imaging, integration_plan(view.imaging, np.array([view.lamp_angle]), places))


def _record_within(error: float, material: Material, view: _View) -> jax.Array:
    """Record a picture within `error` of its largest value.

    It must not be differentiated: which pixels are exact depends on the material.
    """
    sample, lamp_angle = view.imaging.sample, jnp.asarray(view.lamp_angle)
    scales = [group.scale for group in groups_of(view.imaging.blur, sample)]
    around = int(np.ceil(max(scale.reach for scale in scales)))
    beyond = np.arange(1, around + 1)
    wide = [
        np.concatenate([a[0] - step * beyond[::-1], a, a[-1] + step * beyond])
        for a, step in ((view.x, 1), (view.y, -1))
    ]
    centres = np.asarray(_at_centres(Scene(material, sample, lamp_angle), *np.meshgrid(*wide)))
    neighbourhood = (2 * around + 1, 2 * around + 1, 1)
    span = (maximum_filter(centres, neighbourhood) - minimum_filter(centres, neighbourhood)).max(axis=-1)
    height, width = view.y.size, view.x.size
    span, centres = (a[around : around + height, around : around + width] for a in (span, centres))
    values, peak_x = centres.copy(), float(highlight_x(sample, lamp_angle))
    x, y = np.meshgrid(view.x, view.y)

    def record_exactly(where: np.ndarray) -> None:
        index = pad_indices(np.flatnonzero(where))
        if index.size:
            pixels = _record_pixels(material, view, x.ravel()[index], y.ravel()[index])
            values.reshape(-1, values.shape[-1])[index] = np.asarray(pixels)

    side = max(scale.near for scale in scales)
    near = (np.abs(x - peak_x) < side) & (np.abs(y) < side)
    record_exactly(near)
    peak = values[near].max(initial=0.0) or centres.max()
    record_exactly((span > error * peak) & ~near)
    return jnp.asarray(values)


@jax.jit
def _at_centres(scene: Scene, x: jax.Array, y: jax.Array) -> jax.Array:
    element, visible = scene.sample.at(x, y)
    lit = visible & (scene.seen(element).cos_i > 0)
    return jnp.where(lit[..., None], scene.sent(element), 0.0)


def _raw_conversion(
    sensor: Sensor | None, exposure: float | None, seed: Seed | None, time: float
) -> Callable[[jax.Array], jax.Array] | None:
    """Return the function from radiance to a raw picture; None where radiance is wanted."""
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
