"""View of a sample by a rig, and the exact record of its pixels.

For a lens that is a sum of Gaussians, every pixel is computed separately by quadrature (`integral/`, `sampler/`). For a
band-limited lens, the radiance of all pixels is computed at several positions per pixel, and filtered (`frequencies/`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.optics import checked_isotropic
from matcam.camera.pixel import BoxPixel
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax, jnp, without_derivatives
from matcam.forward.frequencies.band_limited import POINT, FineLine, FineRecord, filtered, fine_line, transformed
from matcam.forward.frequencies.light_grid import LightGrid, margin_of, per_px_for, serves
from matcam.forward.frequencies.picture_lens import PictureLens, picture_lens, varies_over_field
from matcam.forward.integral.blur import Imaging, imaging_of
from matcam.forward.integral.blur_groups import groups_of
from matcam.forward.integral.discs import disc_fineness, nearer
from matcam.forward.integral.scene import Scene, Turn
from matcam.forward.sampler.plan import RecordPositions
from matcam.forward.sampler.under_lamp import record_under_points
from matcam.lamp.lamps import LampPoint, checked_lamp_angle, lamp_points
from matcam.material.material import Material, check_material
from matcam.rigs import Rig, picture_shape
from matcam.sample.curved import Cylinder, Sphere
from matcam.sample.shape import Curved

_AT_ONCE = 1 << 18
"""Largest number of positions of a fine record that are computed at once, which limits the memory."""


class View(NamedTuple):
    """Sample, camera and lamp of an image, and the positions of its pixels.

    Attributes:
        imaging: sample, blur and the inverse distance of the lamp.
        lamp_angle: angle between lamp and optical axis, rad.
        turning: offset of the lamp angle, rad. Its value is 0; JAX differentiates the lamp angle through it. None: the lamp
            angle is not differentiated.
        azimuth: azimuth of the lamp, rad.
        points: points of the lamp, each with one angle and azimuth.
        x: positions of the columns, px.
        y: positions of the rows, px.
        lens: filter for a record with several positions per pixel; None: `imaging` includes the blur of the lens.
    """

    imaging: Imaging
    lamp_angle: float
    turning: jax.Array | None
    azimuth: float
    points: list[LampPoint]
    x: np.ndarray
    y: np.ndarray
    lens: PictureLens | None


def view_of(
    material: Material,
    rig: Rig,
    lamp: tuple[ArrayLike, ArrayLike | None],
    shape: tuple[int, int] | None,
    error: float | None = None,
) -> View:
    """Build the view of a sample by a rig.

    Args:
        material: material of the sample.
        rig: camera, sample and lamp.
        lamp: angle between lamp and optical axis, rad, and azimuth of the lamp, rad. If the azimuth is None, the azimuth of
            the rig is used.
        shape: (height, width) of the image, px. None: an area that contains the sample.
        error: twice the target for the largest error of a transfer function, no unit. Default: None, full accuracy.

    Raises:
        ArgumentError: see `matcam.picture`.
    """
    check_material(material)
    checks.instance("rig", rig, Rig, "rigs.merl()")
    if not isinstance(rig.sample, Curved):
        raise ArgumentError("a flat sample has only one normal: use textured_picture, or give a Sphere or a Cylinder")
    lens = _lens_of(material, rig, rig.sample, error)
    if lens is not None:
        rig = eqx.tree_at(lambda one: one.camera, rig, Camera(GaussianOptics(lens.limit.sigma), BoxPixel(POINT)))
    known = without_derivatives(lamp[0])
    angle = checked_lamp_angle(known, rig.lamp, rig.sample.distance)  # type: ignore[attr-defined]
    turning = None if is_concrete(lamp[0]) else jnp.asarray(lamp[0]) - known
    azimuth, imaging = float(checks.scalar("azimuth", rig.azimuths(lamp[1]))), imaging_of(rig)
    reach = max(group.scale.reach for group in groups_of(imaging.blur, imaging.sample)) if lens is None else np.inf
    height, width = _picture_shape(rig, shape, reach)
    fineness = disc_fineness(rig, imaging, np.array(angle), material, azimuth)
    points = lamp_points(rig.lamp, np.array(angle), azimuth, float(fineness))
    if turning is not None and (len(points) > 1 or not isinstance(rig.sample, Sphere)):
        raise ArgumentError(
            "derivatives with respect to lamp_angle need a Sphere and a point lamp: give lamp_angle as a number"
        )
    x, y = np.arange(width) - (width - 1) / 2, (height - 1) / 2 - np.arange(height)
    return View(imaging, angle, turning, azimuth, points, x, y, lens)


def _lens_of(material: Material, rig: Rig, sample: Curved, error: float | None) -> PictureLens | None:
    """Build the filter of the image; None if a sum of Gaussians describes the lens."""
    optics = rig.camera.optics
    # a cylinder extends beyond any image: in a distant rig one row represents all rows
    if isinstance(sample, Cylinder) and not (sample.distant and rig.lamp.nearness is None):
        checked_isotropic(optics, "a cylinder's image with a near camera or lamp")
        return None
    aimed = None if error is None else error / 2  # error of the transfer function
    if isinstance(sample, Cylinder) and varies_over_field(optics):
        raise ArgumentError(
            "a cylinder's image needs a lens that is the same all over the field: use another lens, or a Sphere"
        )
    lens = picture_lens(rig.camera, float(jax.lax.stop_gradient(sample.radius)), aimed)
    if lens is None:
        return None
    lens.channels(Scene(material, sample, jnp.zeros(())).channels())
    return lens


def _picture_shape(rig: Rig, shape: tuple[int, int] | None, reach: float) -> tuple[int, int]:
    """Choose the height and width of an image, px.

    The result is the given shape, the crop of the rig, or a square that contains the sample. The square has a margin for
    the blur, of at most 8 px.
    """
    if shape is not None:
        return picture_shape("shape", shape)
    if rig.crop is not None:
        return rig.crop
    side = 2 * int(np.ceil(float(rig.sample.radius) + min(reach, 8.0))) + 1  # type: ignore[attr-defined]
    return picture_shape("shape", (side, side))


def exact_record(material: Material, view: View) -> jax.Array:
    """Compute the radiance of all pixels, 1/sr, (rows, columns, channels)."""
    if view.lens is not None:
        return _filtered_record(material, view, view.lens)
    x, y = (np.ascontiguousarray(a.ravel()) for a in np.meshgrid(view.x, view.y))
    return record_pixels(material, view, x, y).reshape(view.y.size, view.x.size, -1)


def _filtered_record(material: Material, view: View, lens: PictureLens) -> jax.Array:
    """Compute the radiance of all pixels, 1/sr, (rows, columns, channels), by filtering a fine record with the lens."""
    endless = isinstance(view.imaging.sample, Cylinder)
    if serves(view.imaging.sample, material.elongation, lens.highest) and not view.imaging.blur.varies:
        per_px, across, along, record = _light_record(material, view, lens)
    else:
        per_px, across, along, record = _fine_record(material, view, lens)
    rows, columns = (
        first + per_px * np.arange(one.size) for first, one in ((along.first, view.y), (across.first, view.x))
    )
    rows = np.zeros_like(rows) if endless else rows
    channels = record.spectrum.shape[-1]
    own = [
        list(range(channels)) if len(lens.colours) == 1 else [min(c, channels - 1)] for c in range(len(lens.colours))
    ]
    shares: Iterable[FineRecord] = [record]
    if lens.shares is not None:
        weights, values = lens.shares.on_grid(across.at, along.at), record.values()
        shares = (record.of(weights.of(k) * values) for k in range(len(lens.shares.positions)))
    passed = [jnp.zeros(())] * len(lens.colours)
    for k, share in enumerate(shares):
        for c, colour in enumerate(lens.colours):
            passed[c] = passed[c] + filtered(share.only(own[c]), colour.lenses[k], lens.pixel, colour.shift)
    seen = [record._replace(spectrum=one).values()[rows[:, None], columns] for one in passed]
    return jnp.concatenate(seen, axis=-1)


def _light_record(material: Material, view: View, lens: PictureLens) -> tuple[int, FineLine, FineLine, FineRecord]:
    """Compute the radiance of a sphere on a grid.

    Returns:
        Number of positions along the side of a pixel; positions of columns and of rows; and the transform of the radiance,
        exact up to the cutoff frequency of the lens.
    """
    sample = view.imaging.sample
    radius = float(jax.lax.stop_gradient(sample.radius))
    per_px = max(lens.limit.per_px, per_px_for(lens.highest, radius))
    side = radius + margin_of(per_px, lens.highest)
    across, along = (fine_line(line, -side, side, per_px) for line in (view.x, view.y))
    grid = LightGrid.of(across.at, along.at, lens.highest)
    light: jax.Array | float = 0.0
    for point in view.points:
        angle = jnp.asarray(point.angle) + (0.0 if view.turning is None else view.turning)
        turn = Turn(jnp.cos(point.azimuth), jnp.sin(point.azimuth)) if point.azimuth else None
        nearness = nearer(view.imaging, point.distance).lamp_nearness
        light += point.weight * grid.laid(Scene(material, sample, angle, nearness, turn))
    record = transformed(jnp.asarray(light), across, along, per_px, False)
    jitter = view.imaging.blur.stds[0] ** 2 - lens.limit.sigma**2
    return per_px, across, along, record.blurred(jitter)


def _fine_record(material: Material, view: View, lens: PictureLens) -> tuple[int, FineLine, FineLine, FineRecord]:
    """Compute the results of `_light_record` from records by quadrature, separately for each position."""
    per_px, endless = lens.limit.per_px, isinstance(view.imaging.sample, Cylinder)
    reach = max(group.scale.reach for group in groups_of(view.imaging.blur, view.imaging.sample))
    side = float(jax.lax.stop_gradient(view.imaging.sample.radius)) + reach
    across = fine_line(view.x, -side, side, per_px)
    along = FineLine(view.y[:1], 0, -1.0) if endless else fine_line(view.y, -side, side, per_px)
    x, y = np.meshgrid(across.at, along.at)
    lit = np.flatnonzero((np.abs(x) if endless else np.hypot(x, y)).ravel() < side)
    parts = [
        record_pixels(material, view, x.ravel()[some], y.ravel()[some])
        for some in np.split(lit, range(_AT_ONCE, lit.size, _AT_ONCE))
    ]
    values = jnp.concatenate(parts)
    whole = jnp.zeros((x.size, values.shape[-1])).at[lit].set(values).reshape(*x.shape, -1)
    record = transformed(whole, across, along, per_px, endless)
    return per_px, across, along, record.undone(lens.limit.sigma, lens.highest, compact=lens.shares is not None)


def record_pixels(material: Material, view: View, x: np.ndarray, y: np.ndarray) -> jax.Array:
    """Compute the radiance of pixels centred on (x, y), px, as the mean over the points of the lamp.

    Returns:
        Radiance, 1/sr, (pixels, channels).
    """
    which: np.ndarray | slice = slice(None)
    if Scene(material, view.imaging.sample, jnp.zeros(()), view.imaging.lamp_nearness).uniform_rows:
        x, which = np.unique(x, return_inverse=True)
        y = np.zeros_like(x)
    positions = RecordPositions(x, y, np.full(x.size, view.lamp_angle))
    turning = 0.0 if view.turning is None else view.turning
    return record_under_points(material, view.imaging, positions, view.points, turning)[which]
