"""Images of a material on a curved sample by the camera of a rig.

An image with a given error is computed exactly only where required, because most of a sample is smooth or much darker
than the highlight. The value of a pixel lies between the smallest and the largest radiance within the support of its
kernel. Where these differ by less than the error, the radiance at the centre of the pixel suffices. A highlight may lie
between the centres, so all pixels around a highlight are computed exactly. A lit crescent or its tips may also lie
between the centres, so the radiance is also evaluated along the limb.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from scipy.ndimage import maximum_filter, minimum_filter

from matcam.camera.sensor import Seed, Sensor
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp, transferred
from matcam.core.results.labelled import named
from matcam.forward.integral.blur import kernel_error
from matcam.forward.integral.blur_groups import groups_of
from matcam.forward.integral.discs import nearer
from matcam.forward.integral.scene import Scene, Turn, highlight_x
from matcam.forward.sampler.plan import RecordPositions, rough_pixels
from matcam.forward.view import View, exact_record, record_pixels, view_of
from matcam.lamp.lamps import LampPoint
from matcam.material.material import Material
from matcam.numerics.blocks import few_lengths, pad_indices
from matcam.rigs import Rig
from matcam.sample.curved import Cylinder, Sphere


def picture(
    material: Material,
    rig: Rig,
    lamp_angle: ArrayLike,
    azimuth: ArrayLike | None = None,
    *,
    shape: tuple[int, int] | None = None,
    shift: tuple[float, float] = (0.0, 0.0),
    error: float | None = None,
    exposure: float | None = None,
    seed: Seed | None = None,
    time: float = 0.0,
) -> xr.DataArray:
    """Simulate the image of a sphere or cylinder in a rig.

    The irradiance is 1 at the sample's centre, on a surface that faces the lamp (each point of a disc, for a source disc).
    Row 0 is on top. Pixel centres lie on integers, and the optical axis at ((width - 1) / 2, (height - 1) / 2). For
    derivatives see `picture_values`.

    The image under a source disc is the mean of the images under the points of a quadrature rule. The computing time is
    proportional to the number of points. A disc has at least 14 points, and more if its image is wider than the blur.

    Args:
        material: material of the sample, such as `Microfacet(GGX(0.1), 0.9)`.
        rig: camera, sample and lamp; the sample is a `Sphere` or `Cylinder`.
        lamp_angle: angle between lamp and optical axis, seen from the sample's centre, rad: 2 theta_d in a distant rig.
            In [0, pi) in a distant rig; in a near rig, below the angle from which the lamp lights no visible surface.
        azimuth: azimuth of the lamp about the optical axis, in [-2 pi, 2 pi], rad. Pixels and the axis of a cylinder
            (y) do not rotate with the lamp. Default: None, the rig's `lamp_azimuth`, or 0, the lamp towards +x (right); pi / 2
            is towards +y (up).
        shape: (height, width), px. Default: the crop of the rig, or an area that contains the sample and its blur.
        shift: shift of the sample and the optical axis from the centre of the image, px: columns to the right, rows
            down. Default: (0, 0).
        error: largest allowed error, as a share of the peak of the image, in [1e-6, 0.1], no unit; larger is faster.
            Default: None, full accuracy (1e-4 of every value or 1e-7 of the peak). If a finer image is filtered by the
            transfer function of the lens, the allowed error of the transfer function is `error` / 2, or 1e-6 for None.
        exposure: electrons per unit of radiance, e- sr, for a raw image of the camera's sensor. Default: None,
            radiance.
        seed: seed of the noise of the raw image, an integer or a JAX key. Default: None, for radiance only.
        time: exposure time of the raw image, s, for the dark current. Default: 0.

    Returns:
        Radiance, 1/sr, or digital values, DN, (row, column, channel); (row, column) for a colour mosaic. Coordinates
        `x` and `y`, px, are relative to the optical axis, y upwards. Attribute `kernel_error`: see `measure`. Attribute
        `route`: "frequencies" if a finer image was filtered by the transfer function of the lens; "space" if the lens was
        represented by a sum of Gaussians.

    Raises:
        ArgumentError: an argument is out of its range, the lamp lights no visible surface or is inside the camera, the
            sample is flat, or exposure lacks a sensor or a seed.

    Source:
        docs/model.md 2, 3 and 10.

    Example:
        The image shows the middle of a sphere, where no kernel contains the highlight or the limb. Without `shape` it
        would show the whole sphere.

        >>> rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(0.5)), matcam.Sphere(40.0))
        >>> image = matcam.picture(matcam.Microfacet(matcam.GGX(0.1), 0.9), rig, lamp_angle=1.0, shape=(3, 5))
        >>> image.dims, image.shape
        (('row', 'column', 'channel'), (3, 5, 1))
    """
    if error is not None:
        error = float(checks.within("error", error, 1e-6, 0.1, "of the image's peak"))
    view = view_of(material, rig, (lamp_angle, azimuth), shape, error)
    material = transferred(material)  # here, so that compiled programs do not transfer it at each call
    offset = np.asarray(checks.within("shift", shift, -1e4, 1e4, "px"))  # type: ignore[arg-type]
    if offset.shape != (2,):
        raise ArgumentError(f"shift must be two numbers (right, down), px, got an array of shape {offset.shape}")
    right, down = offset.tolist()
    if right or down:
        view = view._replace(x=view.x - right, y=view.y + down)
    raw = _raw_conversion(rig.camera.sensor, exposure, seed, time)
    error = None if view.lens is not None else error
    values = exact_record(material, view) if error is None else _record_within(error, material, view)
    quantity, unit = "radiance", "1/sr"
    if raw is not None:
        values, quantity, unit = raw(values), "digital", "DN"
    recorded = xr.DataArray(
        np.asarray(values),
        dims=("row", "column", "channel")[: values.ndim],
        coords={
            "x": ("column", view.x),
            "y": ("row", view.y),
        },
        name="picture",
        attrs={
            "units": unit,
            "long_name": "radiance over irradiance" if raw is None else "raw code",
            "quantity": quantity,
            "lamp_angle": view.lamp_angle,
            "lamp_azimuth": view.azimuth,
            "rig": repr(rig),
            "kernel_error": kernel_error(rig) if view.lens is None else view.lens.error,
            "route": "space" if view.lens is None else "frequencies",
        },
    )
    return named(
        recorded, {"x": "position on the sample, to the right [px]", "y": "position on the sample, upwards [px]"}
    )


def picture_values(
    material: Material,
    rig: Rig,
    lamp_angle: ArrayLike,
    shape: tuple[int, int] | None = None,
    azimuth: ArrayLike | None = None,
) -> jax.Array:
    """Compute the radiance of `picture` as an array.

    The array is differentiable in the parameters of material and camera.

    Args:
        material: material of the sample, such as `Microfacet(GGX(0.1), 0.9)`.
        rig: camera, sample and lamp; the sample is a `Sphere` or `Cylinder`.
        lamp_angle: angle between lamp and optical axis, see `picture`, rad. For a sphere under a point lamp, the array is
            differentiable with respect to this angle, too.
        shape: (height, width), px. Default: see `picture`.
        azimuth: azimuth of the lamp about the optical axis, rad; it must be concrete. Default: None, see `picture`.

    Returns:
        Radiance under unit irradiance, (height, width, channels), 1/sr.

    Raises:
        ArgumentError: see `picture`; or the call is inside jax.jit.

    Source:
        docs/model.md 2 and 3.

    Example:
        >>> rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(0.5)), matcam.Sphere(40.0))
        >>> matcam.forward.picture_values(matcam.Microfacet(matcam.GGX(0.1), 0.9), rig, lamp_angle=1.0, shape=(3, 5)).shape
        (3, 5, 1)
    """
    return exact_record(transferred(material), view_of(material, rig, (lamp_angle, azimuth), shape))


def _record_within(error: float, material: Material, view: View) -> jax.Array:
    """Compute the radiance of an image, 1/sr, with an error of at most `error` times its largest value.

    The image must not be differentiated, because the selection of the exact pixels depends on the material.
    """
    scales = [group.scale for group in groups_of(view.imaging.blur, view.imaging.sample)]
    around = int(np.ceil(max(scale.reach for scale in scales)))
    beyond = np.arange(1, around + 1)
    wide = np.meshgrid(
        *(
            np.concatenate([a[0] - step * beyond[::-1], a, a[-1] + step * beyond])
            for a, step in ((view.x, 1), (view.y, -1))
        )
    )
    x, y = np.meshgrid(view.x, view.y)
    centres = most = np.zeros((*wide[0].shape, 1))
    near = np.zeros(x.shape, dtype=bool)
    for point in view.points:
        light, brightest, highlight = (_on_cylinder if isinstance(view.imaging.sample, Cylinder) else _on_sphere)(
            material, view, point, wide, (x, y)
        )
        centres, most = centres + point.weight * light, most + point.weight * brightest
        near |= highlight
    neighbourhood = (2 * around + 1, 2 * around + 1, 1)
    span = (maximum_filter(most, neighbourhood) - minimum_filter(centres, neighbourhood)).max(axis=-1)
    height, width = view.y.size, view.x.size
    span, centres = (a[around : around + height, around : around + width] for a in (span, centres))
    values = centres.copy()

    def record_exactly(where: np.ndarray) -> None:
        index = pad_indices(np.flatnonzero(where))
        if index.size:
            pixels = record_pixels(material, view, x.ravel()[index], y.ravel()[index])
            values.reshape(-1, values.shape[-1])[index] = np.asarray(pixels)

    record_exactly(near)
    peak = values[near].max(initial=0.0) or centres.max()
    record_exactly((span > error * peak) & ~near)
    return jnp.asarray(values)


def _turned(view: View) -> bool:
    """Check whether the rows of pixels are rotated relative to the axes of the scene, which occurs only for a sphere."""
    return isinstance(view.imaging.sample, Sphere) and bool(np.any([point.azimuth for point in view.points]))


_Positions = Sequence[np.ndarray]
"""Arrays of x and y, px."""
_ALONG = 0.5
"""Step along the limb between positions at which the radiance is evaluated, px. Every pixel on the limb contains one of them.
"""
_BELOW_LIMB = 1.5 * 3.0 ** -np.arange(16)
"""Distances of these positions from the limb, px. Any lit crescent contains at least one of them."""


def _on_sphere(
    material: Material, view: View, point: LampPoint, wide: _Positions, pixels: _Positions
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the radiance under one point of the lamp, and find the pixels near its highlight.

    Returns:
        Radiance at the positions `wide`, 1/sr; the largest radiance found in the pixels at these positions, 1/sr; and
        True for each of `pixels` near the highlight.
    """
    imaging, sample = nearer(view.imaging, point.distance), view.imaging.sample
    turned = _turned(view)
    turn = Turn(jnp.cos(point.azimuth), jnp.sin(point.azimuth))
    scene = Scene(material, sample, jnp.asarray(point.angle), imaging.lamp_nearness, turn if turned else None)
    peak = scene.on_sensor(highlight_x(sample, scene.lamp_angle, scene.lamp_nearness), jnp.zeros(()))
    side = max(group.scale.near for group in groups_of(imaging.blur, sample))
    near = [np.abs(at - float(middle)) < side for at, middle in zip(pixels, peak, strict=True)]
    light = np.asarray(_at_centres(scene, *wide))
    return light, _most_at_limb(scene, float(sample.radius), light, wide), near[0] & near[1]


def _most_at_limb(scene: Scene, radius: float, light: np.ndarray, wide: _Positions) -> np.ndarray:
    """Compute the largest radiance found in each pixel, 1/sr.

    It is the larger of the radiance at the centre of the pixel, `light`, and the largest radiance along the limb inside the
    pixel.
    """
    count = few_lengths(int(np.ceil(2 * np.pi * radius / _ALONG)))
    azimuth = 2 * np.pi * np.arange(count) / count
    depth = radius - np.minimum(_BELOW_LIMB, radius / 2)[:, None]
    x, y = depth * np.cos(azimuth), depth * np.sin(azimuth)
    found = np.asarray(_at_centres(scene, x, y))
    column, row = np.rint(x - wide[0][0, 0]).astype(int), np.rint(wide[1][0, 0] - y).astype(int)
    shown = (column >= 0) & (column < light.shape[1]) & (row >= 0) & (row < light.shape[0]) & np.any(found > 0, axis=-1)
    most = light.copy()
    np.maximum.at(most, (row[shown], column[shown]), found[shown])
    return most


def _on_cylinder(
    material: Material, view: View, point: LampPoint, wide: _Positions, pixels: _Positions
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the results of `_on_sphere` for a cylinder. Pixels near a limb count as pixels near the highlight."""
    imaging = nearer(view.imaging, point.distance)
    turn = Turn(jnp.cos(point.azimuth), jnp.sin(point.azimuth))
    scene = Scene(material, imaging.sample, jnp.asarray(point.angle), imaging.lamp_nearness, turn)
    light = np.asarray(_at_centres(scene, *wide))
    x, y = (at.ravel() for at in pixels)
    positions = RecordPositions(x, y, *(np.full(x.size, a) for a in (point.angle, point.azimuth)))
    return light, light, rough_pixels(imaging, positions, float(material.elongation)).reshape(pixels[0].shape)


@jax.jit
def _at_centres(scene: Scene, x: jax.Array, y: jax.Array) -> jax.Array:
    element, lit = scene.shown(x, y)
    return jnp.where(lit[..., None], scene.sent(element), 0.0)


def _raw_conversion(
    sensor: Sensor | None, exposure: float | None, seed: Seed | None, time: float
) -> Callable[[jax.Array], jax.Array] | None:
    """Build the function that converts radiance, 1/sr, to a raw image, DN; None if no exposure is given."""
    if exposure is None:
        return None
    if sensor is None:
        raise ArgumentError("exposure needs a camera with a sensor: Camera(optics, pixel, sensor=Sensor(...))")
    if seed is None:
        raise ArgumentError("exposure needs a seed of the noise: set seed to an integer or a JAX key")

    def raw(values: jax.Array) -> jax.Array:
        if sensor.cfa is not None and values.shape[-1] == 1:
            values = jnp.broadcast_to(values, (*values.shape[:2], 3))
        return sensor.expose(values, exposure, seed, time)

    return raw
