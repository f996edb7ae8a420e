"""Pictures of a material on a curved sample, as the rig's camera takes them.

A picture within a stated error is exact only where it has to be: most of a sample is smooth, or dark beside its highlight. A
pixel records a value between the least and the largest radiance within its kernel's reach. Where these differ by less than
the error, the radiance at its centre will do. A highlight can hide between the centres, so all around it is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby, islice
from typing import NamedTuple

import equinox as eqx
import numpy as np
import xarray as xr
from jax.typing import ArrayLike
from scipy.ndimage import maximum_filter, minimum_filter

from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.optics import checked_isotropic
from matcam.camera.pixel import BoxPixel
from matcam.camera.sensor import Seed, Sensor
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax, jnp, without_derivatives
from matcam.forward.band_limited import POINT, FineLine, filtered, fine_line, transformed
from matcam.forward.integral.blur import Imaging, imaging_of, kernel_error
from matcam.forward.integral.blur_groups import groups_of
from matcam.forward.integral.cylinder_discs import cylinder_fineness, places_under, record_under_points
from matcam.forward.integral.cylinder_record import light_at, smooth_places
from matcam.forward.integral.discs import disc_fineness, nearer
from matcam.forward.integral.plan import RecordPlaces, integration_plan, pad_indices
from matcam.forward.integral.recording import record
from matcam.forward.integral.scene import Scene, Turn, highlight_x
from matcam.forward.picture_lens import PictureLens, picture_lens, varies_over_field
from matcam.lamp.lamps import LampPoint, checked_lamp_angle, lamp_points
from matcam.material.material import Material
from matcam.rigs import Rig, picture_shape
from matcam.sample.curved import Cylinder, Sphere
from matcam.sample.shape import Curved

_PLACES = 1 << 20
"""Pixels times points of a lamp that are recorded at once: they fit into 1 GiB."""
_AT_ONCE = 1 << 18
"""Places of a fine record that are recorded at once."""
_FARTHEST_REACH = 8.0  # px beyond the limb that a picture holds unless it is given a shape


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
    """Return the picture of a sphere or cylinder under the rig's lamp.

    The lamp's irradiance is 1 at the sample's centre, on a surface that faces it. Row 0 is on top. Pixel centres lie on
    integers, and the optical axis at ((width - 1) / 2, (height - 1) / 2). For derivatives see `picture_values`.

    A lamp's disc is a disc: the picture is the mean over those of its points. That takes 15 times as long for a disc whose
    image is as wide as the blur, and more for a larger one.

    Args:
        material: material of the sample, such as `Microfacet(GGX(0.1), 0.9)`.
        rig: camera, sample and lamp; the sample is a `Sphere` or `Cylinder`.
        lamp_angle: angle between lamp and optical axis, seen from the sample's centre, rad: 2 theta_d if all is distant. In
            [0, pi), or up to where a near lamp lights nothing that a near camera sees.
        azimuth: of the lamp about the optical axis, in [-2 pi, 2 pi], rad. Neither pixels nor a cylinder's axis (y) turn with
            it. Default: None, the rig's `lamp_azimuth`, or 0, the lamp towards +x (right); pi / 2 is towards +y (up).
        shape: (height, width), px. Default: the rig's crop, or what holds the sample and its blur.
        shift: of the sample and the optical axis from the picture's middle, px: columns to the right, rows down. Default:
            none.
        error: largest error allowed, as a share of the picture's peak, in [1e-6, 0.1], no unit; the larger, the faster.
            Default: None, as exact as is known (1e-4 of every value or 1e-7 of the peak). By frequencies it allows half as
            large an error of the transfer function, 1e-6 by default.
        exposure: electrons per unit of radiance, e- sr, for a raw picture of the camera's sensor. Default: None, radiance.
        seed: seed of the raw picture's noise, a whole number or a JAX key. Default: None, allowed for radiance only.
        time: exposure time of the raw picture, s, in which dark current gathers. Default: 0.

    Returns:
        Radiance, 1/sr, or digital values, DN, (row, column, channel); (row, column) behind a colour mosaic. Coordinates `x`
        and `y`, px, count from the optical axis, y upwards. Attribute `kernel_error`: see `measure`. Attribute `route`:
        "frequencies" where a finer picture was filtered as the lens does, "space" where the lens is a sum of Gaussians.

    Raises:
        ArgumentError: an argument is out of its range, the lamp lights nothing that is seen or stands in the camera, the
            sample is flat, or exposure lacks a sensor or a seed.

    Source:
        docs/model.md 2, 3 and 10.

    Example:
        The middle of a sphere, where no kernel meets the highlight or the limb; without a shape, the whole sphere.

        >>> rig = matcam.Rig(matcam.Camera(matcam.GaussianOptics(0.5)), matcam.Sphere(40.0))
        >>> image = matcam.picture(matcam.Microfacet(matcam.GGX(0.1), 0.9), rig, lamp_angle=1.0, shape=(3, 5))
        >>> image.dims, image.shape
        (('row', 'column', 'channel'), (3, 5, 1))
    """
    if error is not None:
        error = float(checks.within("error", error, 1e-6, 0.1, "of the picture's peak"))
    view = _view(material, rig, (lamp_angle, azimuth), shape, error)
    if any(shift):
        right, down = (float(checks.within(f"shift[{k}]", one, -1e4, 1e4, "px")) for k, one in enumerate(shift))
        view = view._replace(x=view.x - right, y=view.y + down)
    raw = _raw_conversion(rig.camera.sensor, exposure, seed, time)
    error = None if view.lens is not None else error
    values = _exact_record(material, view) if error is None else _record_within(error, material, view)
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
            "lamp_azimuth": view.azimuth,
            "rig": repr(rig),
            "kernel_error": kernel_error(rig) if view.lens is None else view.lens.error,
            "route": "space" if view.lens is None else "frequencies",
        },
    )


def picture_values(
    material: Material,
    rig: Rig,
    lamp_angle: ArrayLike,
    shape: tuple[int, int] | None = None,
    azimuth: ArrayLike | None = None,
) -> jax.Array:
    """Return the radiance of `picture` as an array.

    It is differentiable in the parameters of material and camera.

    Args:
        material: material of the sample, such as `Microfacet(GGX(0.1), 0.9)`.
        rig: camera, sample and lamp; the sample is a `Sphere` or `Cylinder`.
        lamp_angle: angle between lamp and optical axis, see `picture`, rad. Its derivatives are those of a sphere and a point.
        shape: (height, width), px. Default: see `picture`.
        azimuth: of the lamp about the optical axis, rad; it cannot be traced. Default: None, see `picture`.

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
    return _exact_record(material, _view(material, rig, (lamp_angle, azimuth), shape))


class _View(NamedTuple):
    """A sample as it is photographed, and the part of it that the picture shows.

    Attributes:
        imaging: sample, blur and the lamp's nearness.
        lamp_angle: angle between lamp and optical axis, rad.
        turning: 0, with the derivative of the lamp's angle, rad; None: nobody asks for it.
        azimuth: of the lamp, rad.
        points: the lamp's points, each of one angle and azimuth.
        x: places of the columns, px.
        y: places of the rows, px.
        lens: what a fine record is filtered by; None: the lens is a part of the imaging.
    """

    imaging: Imaging
    lamp_angle: float
    turning: jax.Array | None
    azimuth: float
    points: list[LampPoint]
    x: np.ndarray
    y: np.ndarray
    lens: PictureLens | None


def _view(
    material: Material,
    rig: Rig,
    lamp: tuple[ArrayLike, ArrayLike | None],
    shape: tuple[int, int] | None,
    error: float | None = None,
) -> _View:
    if not isinstance(material, Material):
        raise ArgumentError(
            f"material must be a Material such as Microfacet(GGX(0.1), 0.9), got {type(material).__name__}"
        )
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), got {type(rig).__name__}")
    if not isinstance(rig.sample, Curved):
        raise ArgumentError("a flat sample shows one normal: see textured_picture, or use a Sphere or a Cylinder")
    lens = _lens_of(material, rig, rig.sample, error)
    if lens is not None:
        rig = eqx.tree_at(lambda one: one.camera, rig, Camera(GaussianOptics(lens.limit.sigma), BoxPixel(POINT)))
    known = without_derivatives(lamp[0])
    angle = checked_lamp_angle(known, rig.lamp, rig.sample.distance)  # type: ignore[attr-defined]
    turning = None if is_concrete(lamp[0]) else jnp.asarray(lamp[0]) - known
    azimuth, imaging = float(checks.scalar("azimuth", rig.azimuths(lamp[1]))), imaging_of(rig)
    reach = max(group.scale.reach for group in groups_of(imaging.blur, imaging.sample)) if lens is None else np.inf
    height, width = _picture_shape(rig, shape, reach)
    if isinstance(rig.sample, Cylinder):
        fineness = cylinder_fineness(rig, imaging.blur, np.array(angle), azimuth, material)
    else:
        fineness = disc_fineness(rig, imaging, np.array(angle), material)
    points = lamp_points(rig.lamp, np.array(angle), azimuth, float(fineness))
    if turning is not None and (len(points) > 1 or not isinstance(rig.sample, Sphere)):
        raise ArgumentError(
            "derivatives by lamp_angle need a Sphere under a lamp without a disc: give lamp_angle as a number"
        )
    x, y = np.arange(width) - (width - 1) / 2, (height - 1) / 2 - np.arange(height)
    return _View(imaging, angle, turning, azimuth, points, x, y, lens)


def _lens_of(material: Material, rig: Rig, sample: Curved, error: float | None) -> PictureLens | None:
    """Return what the picture is filtered by; None where the lens is a sum of Gaussians."""
    optics = rig.camera.optics
    # a cylinder goes on beyond any picture, and its light with it: one row is all of them, where all is distant
    if isinstance(sample, Cylinder) and not (sample.distant and rig.lamp.nearness is None):
        checked_isotropic(optics, "a cylinder's picture before a near camera or lamp")
        return None
    aimed = None if error is None else error / 2  # of the transfer function: half of it shows at the peak
    if isinstance(sample, Cylinder) and varies_over_field(optics):
        raise ArgumentError("a cylinder's picture needs a lens that is the same all over the field: use a Sphere")
    lens = picture_lens(rig.camera, float(jax.lax.stop_gradient(sample.radius)), aimed)
    if lens is None:
        return None
    lens.channels(Scene(material, sample, jnp.zeros(())).channels())
    return lens


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
    if view.lens is not None:
        return _filtered_record(material, view, view.lens)
    x, y = (np.ascontiguousarray(a.ravel()) for a in np.meshgrid(view.x, view.y))
    return _record_pixels(material, view, x, y).reshape(view.y.size, view.x.size, -1)


def _filtered_record(material: Material, view: _View, lens: PictureLens) -> jax.Array:
    """Record all that sends light at several places a pixel, and filter it as the lens does."""
    per_px, endless = lens.limit.per_px, isinstance(view.imaging.sample, Cylinder)
    reach = max(group.scale.reach for group in groups_of(view.imaging.blur, view.imaging.sample))
    side = float(jax.lax.stop_gradient(view.imaging.sample.radius)) + reach
    across = fine_line(view.x, -side, side, per_px)
    along = FineLine(view.y[:1], 0, -1.0) if endless else fine_line(view.y, -side, side, per_px)
    x, y = np.meshgrid(across.at, along.at)
    lit = np.flatnonzero((np.abs(x) if endless else np.hypot(x, y)).ravel() < side)
    parts = [
        _record_pixels(material, view, x.ravel()[some], y.ravel()[some])
        for some in np.split(lit, range(_AT_ONCE, lit.size, _AT_ONCE))
    ]
    values = jnp.concatenate(parts)
    whole = jnp.zeros((x.size, values.shape[-1])).at[lit].set(values).reshape(*x.shape, -1)
    record = transformed(whole, across, along, per_px, endless)
    shares = [record]
    if lens.shares is not None:
        divided = lens.shares.divided(record.derivative, across.at, along.at, lens.limit.sigma)
        shares = [record.of(share) for share in divided]
    rows, columns = (
        first + per_px * np.arange(one.size) for first, one in ((along.first, view.y), (across.first, view.x))
    )
    rows = np.zeros_like(rows) if endless else rows
    seen = []
    for c, colour in enumerate(lens.colours):
        # one colour is that of all channels
        own = slice(None) if len(lens.colours) == 1 else [min(c, values.shape[-1] - 1)]
        passed = (
            filtered(share.only(own), one, lens.pixel, lens.limit, colour.shift)
            for share, one in zip(shares, colour.lenses, strict=True)
        )
        seen.append(record._replace(spectrum=sum(passed, jnp.zeros(()))).values()[rows[:, None], columns])
    return jnp.concatenate(seen, axis=-1)


def _record_pixels(material: Material, view: _View, x: np.ndarray, y: np.ndarray) -> jax.Array:
    """Record pixels centred on (x, y) px; shape (pixels, channels).

    The picture is the mean over the lamp's points; many of them are recorded at once.
    """
    sample, blur, nearness = view.imaging
    if isinstance(sample, Cylinder):
        return record_under_points(material, sample, blur, (x, y), view.points, nearness, one_picture=True)
    total: jax.Array | float = 0.0
    for points in _rings(view.points, max(1, _PLACES // max(x.size, 1))):
        angles, azimuths = (np.array([float(getattr(p, name)) for p in points]) for name in ("angle", "azimuth"))
        which = np.repeat(np.arange(len(points), dtype=np.int32), x.size)
        turned = azimuths if np.any(azimuths) else None
        places = RecordPlaces(
            np.tile(x, len(points)),
            np.tile(y, len(points)),
            angles[which],
            which,
            None if turned is None else turned[which],
        )
        imaging = nearer(view.imaging, points[0].distance)
        plan = integration_plan(imaging, angles, places, turned, material.elongation)
        values = record(material, imaging, plan if view.turning is None else plan.turned(view.turning))
        weights = np.array([point.weight for point in points])
        total += jnp.tensordot(weights, values.reshape(len(points), x.size, -1), axes=1)
    return jnp.asarray(total)


def _rings(points: list[LampPoint], most: int) -> Iterator[list[LampPoint]]:
    """Split a lamp's points into lists of at most `most` that are equally far away."""
    for _, ring in groupby(points, lambda point: point.distance):
        while some := list(islice(ring, most)):
            yield some


def _record_within(error: float, material: Material, view: _View) -> jax.Array:
    """Record a picture within `error` of its largest value.

    It must not be differentiated: which pixels are exact depends on the material.
    """
    turned = _turned(view)
    scales = [group.scale for group in groups_of(view.imaging.blur, view.imaging.sample, turned)]
    around = int(np.ceil(max(scale.reach for scale in scales)))
    beyond = np.arange(1, around + 1)
    wide = np.meshgrid(
        *(
            np.concatenate([a[0] - step * beyond[::-1], a, a[-1] + step * beyond])
            for a, step in ((view.x, 1), (view.y, -1))
        )
    )
    x, y = np.meshgrid(view.x, view.y)
    centres, near = np.zeros((*wide[0].shape, 1)), np.zeros(x.shape, dtype=bool)
    for point in view.points:
        light, highlight = (_on_cylinder if isinstance(view.imaging.sample, Cylinder) else _on_sphere)(
            material, view, point, wide, (x, y)
        )
        centres = centres + point.weight * light
        near |= highlight
    neighbourhood = (2 * around + 1, 2 * around + 1, 1)
    span = (maximum_filter(centres, neighbourhood) - minimum_filter(centres, neighbourhood)).max(axis=-1)
    height, width = view.y.size, view.x.size
    span, centres = (a[around : around + height, around : around + width] for a in (span, centres))
    values = centres.copy()

    def record_exactly(where: np.ndarray) -> None:
        index = pad_indices(np.flatnonzero(where))
        if index.size:
            pixels = _record_pixels(material, view, x.ravel()[index], y.ravel()[index])
            values.reshape(-1, values.shape[-1])[index] = np.asarray(pixels)

    record_exactly(near)
    peak = values[near].max(initial=0.0) or centres.max()
    record_exactly((span > error * peak) & ~near)
    return jnp.asarray(values)


def _turned(view: _View) -> bool:
    """Say whether pixels are turned against the scene's axes, which are those of a cylinder."""
    return isinstance(view.imaging.sample, Sphere) and bool(np.any([point.azimuth for point in view.points]))


_Places = Sequence[np.ndarray]
"""x and y, px."""


def _on_sphere(
    material: Material, view: _View, point: LampPoint, wide: _Places, pixels: _Places
) -> tuple[np.ndarray, np.ndarray]:
    """Return the light of a point of the lamp at centres of pixels, and which pixels may see its highlight."""
    imaging, sample = nearer(view.imaging, point.distance), view.imaging.sample
    turned = _turned(view)
    turn = Turn(jnp.cos(point.azimuth), jnp.sin(point.azimuth))
    scene = Scene(material, sample, jnp.asarray(point.angle), imaging.lamp_nearness, turn if turned else None)
    peak = scene.on_sensor(highlight_x(sample, scene.lamp_angle, scene.lamp_nearness), jnp.zeros(()))
    side = max(group.scale.near for group in groups_of(imaging.blur, sample, turned))
    near = [np.abs(at - float(middle)) < side for at, middle in zip(pixels, peak, strict=True)]
    return np.asarray(_at_centres(scene, *wide)), near[0] & near[1]


def _on_cylinder(
    material: Material, view: _View, point: LampPoint, wide: _Places, pixels: _Places
) -> tuple[np.ndarray, np.ndarray]:
    """Return the same before a cylinder; its limbs count as highlights, too."""
    sample, blur, nearness = view.imaging
    assert isinstance(sample, Cylinder)
    seen, own = (places_under(at[0].ravel(), at[1].ravel(), point, nearness) for at in (wide, pixels))
    light = np.asarray(light_at(material, sample, seen)).reshape(*wide[0].shape, -1)
    near = np.zeros(own.x.shape, dtype=bool)
    for terms, _ in groups_of(blur, sample):
        near |= ~np.logical_and(*smooth_places(sample, blur, terms, own, float(material.elongation)))
    return light, near.reshape(pixels[0].shape)


@jax.jit
def _at_centres(scene: Scene, x: jax.Array, y: jax.Array) -> jax.Array:
    element, lit = scene.shown(x, y)
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
