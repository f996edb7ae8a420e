"""Prior knowledge of a capture, and the problem of the joint fit with the corresponding prior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from matcam.acquisition.light.picture_light import LightAt, PictureLight, constant_light
from matcam.acquisition.mirror_ball import MirrorBall, unit
from matcam.camera.camera import Camera
from matcam.camera.lens_field import Coefficient, LensField
from matcam.files.capture_settings import Stated
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.rig.rig_axes import known_lens
from matcam.material.ndf.free_lobe import KNOTS, spline_smoothness
from matcam.numerics.linalg import whitening
from matcam.reconstruction.joint.field_change import FIELD, FieldChange, outline_slopes
from matcam.reconstruction.joint.joint_problem import JointLayout, JointProblem, PixelModel
from matcam.reconstruction.observed_pixels import ObservedPixels
from matcam.reconstruction.picture_model import LampFrame, lamp_coordinates
from matcam.reconstruction.rig.earlier_rig import KnownRig

_LARGEST_CHANGE = 1.0
"""Largest change of ln of the radius of the sample. Larger errors indicate a wrong unit of the radius."""


@dataclass(frozen=True)
class SphereScene:
    """Prior knowledge of a capture before the joint fit.

    Attributes:
        camera: the camera; the fit scales the width of its lens.
        lens_std: relative standard deviation of the lens width, no unit; 0: exact.
        centres: column and row of the centre of the outline in each image, px, (pictures, 2).
        radius: radius of the outline, px.
        outline_covariance: covariance of the errors of column, row and radius that all images share, px^2, (3, 3).
        shift_std: standard deviation of the additional error of the centre in each image, px.
        camera_nearness: inverse of the distance of the camera, with standard deviation, 1/radii.
        lamp_nearness: inverse of the distance of the lamp, with standard deviation, 1/radii.
        lamps: unit vectors from the centre of the sphere to the lamp, x right, y up, z to the camera, (pictures, 3).
        lamp_std: standard deviation of each direction along each tangent, rad, () or (pictures,). The smallest one is also that
            of a rotation that is common to all directions.
        lamp_radius: angular radius of the source disc, seen from the centre of the sphere, rad. Default: 0, a point.
        light: light of each image relative to the mean, as a function of the directions and the inverse distance of the lamp,
            1/radii. Default: None, equal with a standard deviation of 0.5 %.
        rig: rig of an earlier reconstruction, which replaces the specified lens, distances, lamps and distortion.
            Default: None.
        unstated_field: prior of an unspecified distortion, which is not fitted, but increases the errors. Default: None,
            the only distortion is that of the profile.
        sample_radius: specified radius of the sample with its standard deviation, mm. Both inverse distances are this radius
            divided by a distance in mm, so the error of the radius is common to them. Default: None, unknown.
    """

    camera: Camera
    lens_std: float
    centres: np.ndarray
    radius: float
    outline_covariance: np.ndarray
    shift_std: float
    camera_nearness: Stated
    lamp_nearness: Stated
    lamps: np.ndarray
    lamp_std: float | np.ndarray
    lamp_radius: float = 0.0
    light: LightAt | None = None
    rig: KnownRig | None = None
    unstated_field: LensField | None = None
    sample_radius: Stated | None = None

    @property
    def sigma(self) -> float:
        """Standard deviation of the lens according to its profile, px; NaN if the lens is not Gaussian."""
        return float(self.camera.parameters().get("optics.sigma_px", np.nan))

    def light_at(self, lamps: np.ndarray, nearness: float) -> PictureLight:
        """Determine the light of the images for directions, (pictures, 3), and an inverse distance of the lamp, 1/radii."""
        # assumed relative standard deviation of the light of an image, no unit
        return constant_light(len(self.lamps), 0.005) if self.light is None else self.light(lamps, nearness)

    @property
    def field(self) -> LensField | None:
        """Lens field of the profile or, without such a field, that of the unspecified distortion."""
        return self.camera.field or self.unstated_field


def mirror_ball(layout: JointLayout, p: np.ndarray, k: int) -> tuple[MirrorBall, float]:
    """Derive the sphere in image k and the distance of the lamp (radii) from the parameters p."""
    column, row = map(float, p[layout.centre(k)])
    _, radius, *nearness = map(float, p[layout.scene])
    distance, far = (1 / one if one > 0 else np.inf for one in nearness)
    return MirrorBall(row, column, radius, distance), far


def part_of(scene: SphereScene, pictures: Sequence[int]) -> SphereScene:
    count, keep = len(scene.lamps), list(pictures)

    def light(lamps: np.ndarray, nearness: float) -> PictureLight:
        every = scene.lamps.copy()
        every[keep] = lamps
        return scene.light_at(every, nearness).part(keep)

    return replace(
        scene,
        centres=scene.centres[keep],
        lamps=scene.lamps[keep],
        lamp_std=np.broadcast_to(scene.lamp_std, count)[keep],
        light=light,
        rig=None if scene.rig is None else scene.rig._replace(lamps=scene.rig.lamps[keep]),
    )


def with_light(scene: SphereScene, change: Callable[[PictureLight], PictureLight]) -> SphereScene:
    """Change the light of the images, for every position of the lamps."""
    return replace(scene, light=lambda lamps, nearness: change(scene.light_at(lamps, nearness)))


def unstated_distortion(ball: MirrorBall) -> LensField:
    # as a share of the radius at the limb of the sphere
    return LensField((ball.column, ball.row), ball.radius, Coefficient(0.0, 5e-4))


def prior_of(
    layout: JointLayout,
    scene: SphereScene,
    frames: Sequence[LampFrame],
    spline: float,
    own: int,
    nearness: float | None = None,
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Build the prior as linear combinations of the parameters with independent errors and unit variance.

    Args:
        layout: order of the parameters.
        scene: prior knowledge of the scene.
        frames: base direction of the lamp of each image.
        spline: prior standard deviation of the departure of ln D from its family; 0: no departure.
        own: index of the first coefficient of the spline.
        nearness: inverse distance of the lamp about which the light of the images is linear, 1/radii. Default: None, the
            prior mean.

    Returns:
        Combinations, (rows, size), means of the combinations, (rows,), and name of the source of each.
    """
    rows: list[np.ndarray] = []
    values: list[float] = []
    sources: list[str] = []

    def add(source: str, row: np.ndarray, value: float) -> None:
        rows.append(row)
        values.append(value)
        sources.append(source)

    def single(source: str, index: int, std: float, value: float) -> None:
        row = np.zeros(layout.size)
        row[index] = 1 / std
        add(source, row, value / std)

    field, in_rig = scene.field, np.zeros(5, bool)
    if scene.rig is not None:
        in_rig = scene.rig.knows
        for row, value in zip(*scene.rig.prior(layout, frames), strict=True):
            add("rig", row, float(value))
    if scene.lens_std > 0 and not in_rig[0]:
        single("lens", layout.of("lens"), scene.lens_std, 0.0)
    for at, (name, known) in enumerate((("camera", scene.camera_nearness), ("lamp", scene.lamp_nearness))):
        if known.std > 0 and not in_rig[1 + at]:
            row = np.zeros(layout.size)
            row[layout.of(name)] = 1 / known.std
            # a larger sample has smaller distances in radii of the sample
            row[layout.sample_radius] = -known.value / known.std if scene.sample_radius else 0.0
            add(f"{name} distance", row, known.value / known.std)
    if scene.sample_radius is not None and any(row[layout.sample_radius] for row in rows):
        single("sample radius", layout.sample_radius, scene.sample_radius.std / scene.sample_radius.value, 0.0)
    # outline: column, row and radius are common, and each image has its own shift of the centre
    k = layout.pictures
    which = np.repeat(range(3), [k, k, 1])
    covariance = np.asarray(scene.outline_covariance, dtype=float)[np.ix_(which, which)]
    covariance[np.arange(2 * k), np.arange(2 * k)] += max(scene.shift_std, 1e-4) ** 2
    root = whitening(covariance)
    positions = [layout.centre(i).start + axis for axis in (0, 1) for i in range(k)] + [layout.of("radius")]
    expected = np.append(scene.centres.T.ravel(), scene.radius)
    moved = np.zeros(2 * k + 1)
    if field is not None:
        moved = outline_slopes(field, tuple(scene.centres.mean(axis=0)), scene.radius)[which]
        for index, one in enumerate((field.k1, field.growth)):
            if one.std > 0 and not in_rig[3 + index]:
                single(FIELD[index], layout.field.start + index, one.std, 0.0)
    for line in root:
        row = np.zeros(layout.size)
        row[positions] = line
        row[layout.field.start] = line @ moved
        add("outline", row, float(line @ expected))
    stds = np.broadcast_to(np.asarray(scene.lamp_std, dtype=float), k)
    own_lamps = [i for i in range(k) if scene.rig is None or scene.rig.lamps[i] < 0]
    for row, value in zip(*_lamp_prior(layout, scene, frames, own_lamps, stds), strict=True):
        add("lamp", row, float(value))
    about = scene.lamp_nearness.value if nearness is None else nearness
    light = scene.light_at(np.array([frame.base for frame in frames]), about)
    gain_std = np.sqrt(np.diag(light.covariance))
    correlation = light.covariance / np.outer(gain_std, gain_std)
    # common errors alone have a singular covariance
    for line in whitening(correlation + 1e-9 * np.eye(k)) / gain_std:
        row = np.zeros(layout.size)
        row[[layout.gain(i) for i in range(k)]] = line
        row[layout.of("lamp")] = -line @ light.gain_by_nearness
        add("gain", row, float(line @ np.log(light.gain) + row[layout.of("lamp")] * about))
    for index in range(layout.diffuse_shape.start, layout.diffuse_shape.stop):
        # standard deviation of the coefficients of a non-Lambertian diffuse part, no unit
        single("diffuse shape", index, 0.5, 0.0)
    if spline:
        for line in spline_smoothness():
            row = np.zeros(layout.size)
            row[own : own + KNOTS] = line / spline
            add("smooth lobe", row, 0.0)
    return np.array(rows), np.array(values), tuple(sources)


def _lamp_prior(
    layout: JointLayout, scene: SphereScene, frames: Sequence[LampFrame], lamps: Sequence[int], stds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Build the prior of the directions to the lamps.

    Besides its own error, each direction has an error that is common to all: the axes of a table of directions are rotated
    relative to the camera. The standard deviation of the rotation is that of the best known direction.

    Args:
        layout: order of the parameters.
        scene: prior knowledge of the scene.
        frames: base direction of the lamp of each image.
        lamps: indices of the images whose lamps have a prior.
        stds: standard deviation of each direction along each tangent, rad, (pictures,).

    Returns:
        Combinations, (2 lamps, size), and their means, (2 lamps,).
    """
    rows, values = np.zeros((2 * len(lamps), layout.size)), np.zeros(2 * len(lamps))
    if not lamps:
        return rows, values
    turned = []
    for n, i in enumerate(lamps):
        # coordinates of the specified direction in this frame, whose base is the last fitted direction
        stated, frame = unit(scene.lamps[i]), frames[i]
        values[2 * n : 2 * n + 2] = lamp_coordinates(frame, stated)
        for axis, tangent in enumerate((frame.first, frame.second)):
            rows[2 * n + axis, layout.turn(i).start + axis] = 1.0
            turned.append(np.cross(stated, tangent))  # displacement along the tangent per rad about each axis
    own = np.repeat(stds[list(lamps)], 2)
    covariance = np.diag(own**2) + own.min() ** 2 * np.array(turned) @ np.array(turned).T
    root = whitening(covariance)
    return root @ rows, root @ values


def joint_problem(
    layout: JointLayout,
    kind: LobeKind,
    scene: SphereScene,
    frames: Sequence[LampFrame],
    model: PixelModel,
    pixels: Sequence[ObservedPixels],
    changes: Sequence[FieldChange] = (),
    *,
    slope: np.ndarray | None = None,
    diffuse: bool = True,
    spline: float = 0.0,
    nearness: float | None = None,
) -> JointProblem:
    """Build the problem of the joint fit: pixels, model, bounds, prior and constant parameters.

    Args:
        layout: order of the parameters.
        kind: family, masking and splines of the lobe.
        scene: prior knowledge of the scene.
        frames: base direction of the lamp of each image.
        model: model of the pixels.
        pixels: pixels of each image.
        changes: effect of a change of `scene.field` on each image. A field without a profile is not fitted. Default: (),
            the effect is neglected.
        slope: d ln F / d theta_d of each image and channel, 1/rad. Default: None, 0.
        diffuse: True to include a Lambertian part. Default: True.
        spline: prior standard deviation of the departure of ln D from its family, no unit. Default: 0, no departure.
        nearness: as for `prior_of`. Default: None, the prior mean.
    """
    low, high = _bounds(layout, kind, scene)
    fixed = low == high
    if not diffuse:
        fixed[layout.diffuse] = fixed[layout.diffuse_shape] = True
    for name, known_value in (("camera", scene.camera_nearness), ("lamp", scene.lamp_nearness)):
        if known_value.std == 0:
            fixed[layout.of(name)] = True
    known_field = scene.camera.field
    for index in range(len(FIELD)):
        fixed[layout.field.start + index] = known_field is None or (known_field.k1, known_field.growth)[index].std == 0
    rows, values, sources = prior_of(layout, scene, frames, spline, len(kind.family_names), nearness)
    # an exact lens, or a radius without distances relative to it
    for position in (layout.of("lens"), layout.sample_radius):
        fixed[position] |= not rows[:, position].any()
    for k, one in enumerate(pixels):  # a colour without pixels in an image
        for c in range(layout.channels):
            if not (one.used & (one.channel == c)).any():
                fixed[layout.strengths(k).start + c] = True
    slope = np.zeros((layout.pictures, layout.channels)) if slope is None else slope
    changes, unstated = ((), changes) if known_field is None else (changes, ())
    return JointProblem(
        model, layout, pixels, frames, rows, values, sources, low, high, slope, fixed, changes, unstated
    )


def _bounds(layout: JointLayout, kind: LobeKind, scene: SphereScene) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
    for index, (least, most) in enumerate(kind.bounds(scene.radius)):
        low[index], high[index] = least, most
    low[layout.sample_radius], high[layout.sample_radius] = -_LARGEST_CHANGE, _LARGEST_CHANGE
    low[layout.scene] = [-1.5, 0.8 * scene.radius, 0.0, 0.0]
    high[layout.scene] = [1.0, 1.2 * scene.radius, 0.9, 0.9]
    return low, high


def lens_std(camera: Camera) -> float:
    """Compute the largest relative standard deviation of the parameters of the lens.

    The standard deviations are those of the profile, or assumed. The result, no unit, is 0 if no standard deviation is known.
    """
    known = known_lens(camera)
    if known.uncertainty is None:
        return 0.0
    parameters = camera.parameters()
    relative = [
        std / float(parameters[name])
        for name, std in known.uncertainty.std().items()
        if name.startswith("optics.") and float(parameters[name]) > 0
    ]
    return max(relative, default=0.0)
