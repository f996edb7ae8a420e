"""From a capture to what the joint fit needs: merged pictures, outline, first lamp directions, and what is known of all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from matcam.acquisition.capture_check import dark_disc
from matcam.acquisition.darkness import dark_of
from matcam.acquisition.frame_shifts import find_shifts
from matcam.acquisition.highlights import Highlight, find_highlights, lamp_angles_apart, lamp_from_highlight
from matcam.acquisition.lamps.lamp_table import explain_lamp_table
from matcam.acquisition.light.kept_work import KeptWork
from matcam.acquisition.light.reference_patch import PatchLight, ReferencePatch, patch_light
from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.merging import merge
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.acquisition.outline import Outline, Sighting, find_outline, stacked
from matcam.acquisition.radiometry import Radiometry, capture_camera
from matcam.camera.camera import Camera
from matcam.camera.lens_field import Coefficient, LensField
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.core.errors import ArgumentError, FitError, MatcamError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Region, Stated
from matcam.files.capture_frames import CaptureFrame
from matcam.reconstruction.rig.earlier_rig import known_rig
from matcam.reconstruction.rig.rig_document import EarlierRig
from matcam.reconstruction.sphere_scene import Known, SphereScene, lens_std

Progress = Callable[[str, int, int], None]

_GUESSED_LENS = Known(0.5, 0.35)
"""px; where a capture states no profile."""
_GUESSED_DISTORTION = 0.002
"""Of the radius, at the sphere's limb: standard deviation where no profile states a distortion."""
_GUESSED_NEARNESS = Known(0.02, 0.02)
"""One over a distance that is not stated, in radii."""
_MARGIN = 0.12
"""Of the radius, about the outline: the part of a frame that is read."""
_SHIFT = 0.3
"""px; how far the sphere may move between pictures where its limb does not say."""
_FEWEST = 3
_SEEN = float(np.radians(0.5))
"""How well the highlights tell a lamp's direction where its light on a patch is not yet grazing, rad."""
_FAR_OFF = float(np.radians(10.0))
"""Angle between highlights and a lamp table from which no joint fit could begin with the table."""
_UNKNOWN = float(np.radians(20.0))
"""Standard deviation of a lamp's direction that nothing is stated of."""
INCOMPLETE = ("bad-frame", "bad-line", "missing-frame", "other-size", "no-highlight", "picture-left-out")
"""Codes of the remarks on what could not be used."""


class CapturedScene(NamedTuple):
    """Hold what a capture's frames say before the joint fit.

    Attributes:
        pictures: merged pictures that can be fitted.
        scene: what is known beforehand.
        lamps: directions to the lamps as the highlights say, (pictures, 3).
        radiometry: what the codes mean.
        outline: the sphere's outline.
        left_out: names of the lamp positions that cannot be used.
        remarks: what a reader should know.
        units: of each channel, value of the pictures per radiance under unit irradiance, with relative standard deviation;
            None: there is no reference of known reflectance.
        frame: width and height of the frames, px; None: none could be read. Default: None.
        sample_radius: of the sphere, mm. Default: None, not stated.
    """

    pictures: list[MergedPicture]
    scene: SphereScene
    lamps: np.ndarray
    radiometry: Radiometry
    outline: Outline
    left_out: tuple[str, ...]
    remarks: tuple[Remark, ...]
    units: tuple[Known, ...] | None = None
    frame: tuple[int, int] | None = None
    sample_radius: Stated | None = None


def captured_scene(
    capture: Capture,
    progress: Progress | None = None,
    earlier: EarlierRig | None = None,
    *,
    workers: int = 1,
    kept: KeptWork | None = None,
) -> CapturedScene:
    """Merge a capture's frames, and find outline, highlights and lamps.

    Args:
        capture: as from `read_capture`.
        progress: is called with a step's name, and how many of how many parts of it are done. Default: None.
        earlier: the rig as another reconstruction found it. Default: None.
        workers: lamp positions that are read at a time. Default: 1.
        kept: where what was read is kept for a run that goes on. Default: None, nowhere.

    Raises:
        ArgumentError: the capture is not of a sphere, or `earlier` is of another rig.
        FitError: there is no sphere, or fewer than three pictures show a highlight.
    """
    kind = capture.settings["sample"]["kind"]
    if kind != "sphere":
        raise ArgumentError(
            f"{capture.folder}: sample.kind is {kind!r}: photographs of a sphere can be reconstructed so far"
        )
    remarks: list[Remark] = list(capture.problems)
    camera = capture_camera(capture)
    if camera is None:
        camera = Camera(GaussianOptics(_GUESSED_LENS.value))
        remarks.append(
            Remark(
                "lens-guessed",
                f"no camera profile: the lens is taken as {_GUESSED_LENS.value:g} +- {_GUESSED_LENS.std:g} px",
            )
        )
        spread = _GUESSED_LENS.std / _GUESSED_LENS.value
    else:
        spread = lens_std(camera)
    frame, rig = _frame_size(capture), None
    if earlier is not None:
        sigma, radius = camera.parameters().get("optics.sigma_px"), capture.radius_mm
        rig, said = known_rig(
            earlier,
            list(capture.lamps),
            frame,
            None if radius is None else radius.value,
            None if sigma is None else float(sigma),
        )
        remarks.extend(said)
        camera = camera.with_field(earlier.field)
    camera_nearness = _nearness(capture.camera_radii, "camera", remarks)
    lamp_nearness = _nearness(capture.lamp_radii, "lamp", remarks)
    if rig is not None:
        std = np.sqrt(np.diag(rig.covariance))
        camera_nearness, lamp_nearness = (
            Known(float(rig.values[at]), float(std[at])) if rig.knows[at] else stated
            for at, stated in ((1, camera_nearness), (2, lamp_nearness))
        )
    distance = 1 / camera_nearness.value if camera_nearness.value > 0 else np.inf
    sighting = Sighting(distance=distance)
    outline, region = None, capture.region
    if capture.of("outline"):
        found, shape = (capture.region, ()) if capture.region else _about_disc(capture)
        outline = _backlit_outline(capture, sighting, found, remarks)
        region = capture.region or _about(outline, shape)
    pictures, radiometry = merge(capture, region, progress, workers=workers, kept=kept)
    if capture.settings["lamp"]["intensity"] == "table":
        pictures = _under_one_light(pictures, capture)
    remarks.extend(radiometry.remarks)
    centres: np.ndarray | None = None
    if outline is None:
        try:
            outline = find_outline(stacked(pictures), sighting=sighting)
        except FitError as error:
            raise FitError(f"{error}; give a frame of the sphere before a bright field, in outline/") from error
        outline, shifts = find_shifts(pictures, outline, shift_std=_SHIFT, same_radius=False)
        centres = np.array([[outline.column + s.column, outline.row + s.row] for s in shifts])
    remarks.extend(outline.remarks)
    ball = MirrorBall(outline.row, outline.column, outline.radius, distance)
    highlights, said = find_highlights(pictures, ball, blur=float(np.hypot(outline.sigma, 0.29)))
    remarks.extend(said)
    camera = _with_field(camera, outline)
    ball, centres, highlights = _undistorted(camera.field, ball, centres, highlights)
    far = 1 / lamp_nearness.value if lamp_nearness.value > 0 else np.inf
    seen = [k for k, one in enumerate(highlights) if one is not None]
    left_out = tuple(one.name for k, one in enumerate(pictures) if k not in seen)
    if len(seen) < _FEWEST:
        raise FitError(
            f"{capture.folder}: {len(seen)} of {len(pictures)} pictures show a highlight on the sphere; "
            f"at least {_FEWEST} are needed"
        )
    lamps = np.array([lamp_from_highlight(one, ball, far)[0] for one in highlights if one is not None])
    pictures = [pictures[k] for k in seen]
    centres = np.tile([ball.column, ball.row], (len(seen), 1)) if centres is None else centres[seen]
    names = [one.name for one in pictures]
    if rig is None:
        stated, stds = _stated_lamps(capture, names, lamps, remarks)
    else:
        every = list(capture.lamps)
        rig = rig._replace(lamps=rig.lamps[[every.index(name) for name in names]])
        stated, stds = _stated_lamps(capture, names, lamps, [])
        known = rig.lamps >= 0
        stated[known], stds[known] = rig.directions[rig.lamps[known]], rig.lamp_std[rig.lamps[known]]
    order = [1, 0, 2]  # row, column, radius -> column, row, radius
    light = _gains(capture, radiometry, names, lamps, ball, lamp_nearness, remarks)
    lamp_radius = _lamp_radius(capture)
    scene = SphereScene(
        camera=camera,
        lens_std=spread,
        centres=centres,
        radius=ball.radius,
        outline_covariance=outline.covariance[np.ix_(order, order)],
        shift_std=_SHIFT,
        camera_nearness=camera_nearness,
        lamp_nearness=lamp_nearness,
        lamps=stated,
        lamp_std=stds,
        lamp_radius=lamp_radius,
        gain_std=np.sqrt(np.diag(light.covariance)),
        gain=light.gain,
        gain_correlation=_correlation(light.covariance),
        rig=rig,
    )
    units = None if light.units is None else tuple(Known(*one) for one in light.units)
    said_once = tuple(dict.fromkeys(remarks))
    radius = capture.radius_mm
    return CapturedScene(pictures, scene, lamps, radiometry, outline, left_out, said_once, units, frame, radius)


def _correlation(covariance: np.ndarray) -> np.ndarray:
    std = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(std, std))


def _frame_size(capture: Capture) -> tuple[int, int] | None:
    """Return width and height of the first frame that can be read."""
    for frame in capture.frames[:3]:
        try:
            height, width = capture.read(frame).values.shape[:2]
        except MatcamError:
            continue
        return int(width), int(height)
    return None


def _with_field(camera: Camera, outline: Outline) -> Camera:
    """Return the camera with a field: where its profile states none, a distortion about the sphere that nobody has measured."""
    if camera.field is not None:
        return camera
    guess = Coefficient(0.0, _GUESSED_DISTORTION)
    return camera.with_field(LensField((outline.column, outline.row), outline.radius, guess))


def _undistorted(
    field: LensField | None, ball: MirrorBall, centres: np.ndarray | None, highlights: Sequence[Highlight | None]
) -> tuple[MirrorBall, np.ndarray | None, list[Highlight | None]]:
    """Return sphere, centres and highlights as a lens without distortion would show them."""
    if field is None or (field.k1.value == 0 and field.k2.value == 0):
        return ball, centres, list(highlights)
    column, row, radius = field.true_circle(ball.column, ball.row, ball.radius)
    true = MirrorBall(row, column, radius, ball.distance)
    if centres is not None:
        centres = np.array([field.true_circle(x, y, ball.radius)[:2] for x, y in centres])
    moved: list[Highlight | None] = []
    for one in highlights:
        if one is not None:
            column, row = map(float, field.true_place(one.column, one.row))
            normal = true.normals(row, column)
            # on the limb itself rounding may put it beside the sphere
            one = replace(one, row=row, column=column, normal=normal if np.isfinite(normal).all() else one.normal)
        moved.append(one)
    return true, centres, moved


def _under_one_light(pictures: Sequence[MergedPicture], capture: Capture) -> list[MergedPicture]:
    """Divide the pictures by their lamps' stated light; their mean over lamps and colours is kept."""
    stated = {one.name: np.array(capture.lamps[one.name].intensity) for one in pictures}
    mean = float(np.mean([light.mean() for light in stated.values()]))
    found = []
    for one in pictures:
        light = stated[one.name] / mean
        if len(light) not in (1, len(one.channels)):
            raise FitError(
                f"{capture.folder}: lamp {one.name} has {len(light)} intensities and its pictures {len(one.channels)} "
                "colours: give one, or one of each"
            )
        share = np.broadcast_to(light, len(one.channels))[one.channel]
        found.append(replace(one, values=one.values / share, std=one.std / share))
    return found


def _nearness(distance: Stated | None, of: str, remarks: list[Remark]) -> Known:
    if distance is None:
        remarks.append(
            Remark(f"{of}-distance-not-stated", f"the {of}'s distance is not stated: 25 radii or more are assumed")
        )
        return _GUESSED_NEARNESS
    return Known(1 / distance.value, max(distance.std, 1e-6 * distance.value) / distance.value**2)


def _lamp_radius(capture: Capture) -> float:
    """Return the lamp's angular radius, rad; 0 where its size or distance is not stated."""
    radius, distance = capture.settings["lamp"]["radius_mm"][0], capture.settings["distances"]["lamp_mm"]
    return 0.0 if distance is None else float(radius / distance[0])


def _backlit_outline(capture: Capture, sighting: Sighting, region: Region | None, remarks: list[Remark]) -> Outline:
    """Return the outline before a bright field, from the mean of the frames that show one."""
    reader = MosaicReader(capture)
    total: np.ndarray | None = None
    count, scatter = 0, 0.0
    for frame in capture.of("outline"):
        try:
            codes = reader.read(frame, region).astype(np.float64) - _dark(reader, capture, frame, region)
        except MatcamError as error:
            remarks.append(Remark("bad-frame", str(error)))
            continue
        if total is not None and total.shape != codes.shape:
            remarks.append(
                Remark("bad-frame", f"{capture.folder / frame.file}: is not of the other outline frames' size")
            )
            continue
        total = codes if total is None else total + codes
        count += 1
    if total is None:
        raise FitError(f"{capture.folder / 'outline'}: none of its frames can be read")
    mean = total / count
    # photon noise in codes, from the smoothest neighbourhoods: differences of pixels of one colour
    step = 1 if reader.cfa is None else 2
    difference = mean[step:] - mean[:-step]
    bright = mean > np.percentile(mean, 60)
    noise = 1.4826 * float(np.median(np.abs(difference[bright[step:] & bright[:-step]]))) / np.sqrt(2)
    level = float(np.median(mean[bright]))
    scatter = max(noise, 1e-6 * abs(level), 1e-9)
    std = scatter * np.sqrt(np.clip(mean / max(level, 1e-12), 0.05, None))
    origin = (0, 0) if region is None else (region[1], region[0])
    picture = MergedPicture(
        "outline",
        mean,
        std,
        np.zeros(mean.shape, bool),
        reader.channel_map(mean.shape, origin),
        reader.channels,
        origin,
    )
    beyond = np.radians(capture.settings["outline"]["field_beyond_deg"])
    reach = float(beyond), float(beyond) / 3
    return find_outline(picture, light="backlit", sighting=sighting, backlight_reach=reach)


def _about_disc(capture: Capture) -> tuple[Region | None, tuple[int, ...]]:
    """Return the part of the frames about the dark disc of the first outline frame, and the frames' shape.

    None: all of them, as there is no plain disc.
    """
    reader = MosaicReader(capture)
    for frame in capture.of("outline"):
        try:
            codes = reader.read(frame)
        except MatcamError:
            continue
        column, row, radius = dark_disc(codes)
        reach = radius * (1 + 2 * _MARGIN) + 8
        return (_box(column, row, reach, codes.shape) if np.isfinite(radius) else None), codes.shape
    return None, ()


def _dark(reader: MosaicReader, capture: Capture, frame: CaptureFrame, region: Region | None) -> np.ndarray | float:
    """Return the mean dark code of a frame's exposure, or of any; 0 where there is none."""
    frames = capture.of("dark", exposure=frame.exposure) or capture.of("dark")
    stack = []
    for one in frames[:8]:
        try:
            stack.append(reader.read(one, region))
        except MatcamError:
            continue
    if not stack:
        return float(capture.settings["camera"]["black_level_dn"] or 0.0)
    return np.asarray(dark_of(stack).level, dtype=np.float64)


def _about(outline: Outline, shape: tuple[int, ...]) -> Region:
    """Return the part of a frame about an outline: first column and row even, so that a mosaic stays one."""
    return _box(outline.column, outline.row, outline.radius * (1 + _MARGIN) + 4, shape)


def _box(column: float, row: float, reach: float, shape: tuple[int, ...]) -> Region:
    left, top = (2 * int(max(0, np.floor((centre - reach) / 2))) for centre in (column, row))
    right, bottom = (int(np.ceil(min(at + reach, size))) for at, size in zip((column, row), shape[::-1], strict=True))
    return left, top, right - left, bottom - top


def _stated_lamps(
    capture: Capture, names: Sequence[str], lamps: np.ndarray, remarks: list[Remark]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the stated directions, or those of the highlights where none is stated, and how well each is known, rad."""
    stated, stds = lamps.copy(), np.full(len(names), _UNKNOWN)
    for k, name in enumerate(names):
        direction = capture.lamps[name].direction
        if np.all(np.isfinite(direction)):
            stated[k], stds[k] = direction, max(capture.direction_std, 1e-5)
    known = stds < _UNKNOWN
    if known.any():
        apart = np.degrees(lamp_angles_apart(lamps[known], stated[known]))
        remarks.append(
            Remark(
                "lamp-table",
                f"highlights and stated lamp directions differ by {np.sqrt(np.mean(apart**2)):.2g}° rms before the fit",
            )
        )
    if known.sum() >= _FEWEST:
        remark = _table_mistake(lamps, stated, stds, known)
        remarks.extend([] if remark is None else [remark])
    return stated, stds


def _table_mistake(lamps: np.ndarray, stated: np.ndarray, stds: np.ndarray, known: np.ndarray) -> Remark | None:
    """Name what is wrong with a lamp table, and change `stated` and `stds` so that the fit does not rest on it."""
    verdict = explain_lamp_table(lamps[known], stated[known])
    if verdict.mistake == "none":
        return None
    (said,) = verdict.remarks
    if verdict.mistake != "unexplained":
        stated[known], stds[known] = lamps[known], _UNKNOWN
        return Remark(said.code, f"{said.text}; the highlights are used instead")
    usual = float(np.median(lamp_angles_apart(lamps[known], stated[known])))
    if usual < _FAR_OFF:
        return None  # the joint fit tells whether the table, the outline or a distance is wrong
    stds[known] = np.maximum(stds[known], 1.5 * usual)
    return Remark(
        said.code, f"{said.text}; its standard deviation is taken as {np.degrees(1.5 * usual):.2g}°, not as stated"
    )


def _gains(
    capture: Capture,
    radiometry: Radiometry,
    names: Sequence[str],
    lamps: np.ndarray,
    ball: MirrorBall,
    nearness: Known,
    remarks: list[Remark],
) -> PatchLight:
    """Return each picture's light and the unit of values by the reference; where there is none, what is stated of the lamp."""
    count, drift = len(names), max(float(capture.settings["lamp"]["gain_std"]), 1e-5)
    stated = PatchLight(np.ones(count), drift**2 * np.eye(count), None, np.zeros(count, bool))
    reference, region = capture.settings["reference"], capture.reference_region
    if reference is not None and reference["kind"] == "diffuse" and region is not None:
        found = patch_light(
            _patch(capture, region),
            [radiometry.reference_light[name] for name in names],
            lamps,
            ball,
            Stated(*nearness),
            lamp_std=np.full(count, min(capture.direction_std, _SEEN)),
            gain_std=drift,
            exposure_std=max(one.std / one.value for one in radiometry.exposures.values()),
        )
        if found is None:
            text = "the diffuse reference is dark, clipped or lit at grazing in every picture: F is relative"
            remarks.append(Remark("no-reference", text))
        elif found.units is None:
            text = "reference.reflectance is not stated: F is relative"
            remarks.append(Remark("no-reflectance", text))
        return found or stated
    output = [radiometry.lamp_output.get(name) for name in names]
    known = np.array([one is not None and np.isfinite(one.value) and one.value > 0 for one in output])
    if not known.any():
        return stated
    gain = np.array([one.value if good and one is not None else 1.0 for one, good in zip(output, known, strict=True)])
    std = np.array(
        [one.std / one.value if good and one is not None else drift for one, good in zip(output, known, strict=True)]
    )
    return PatchLight(gain / gain.mean(), np.diag(np.maximum(std, 1e-5) ** 2), None, known)


def _patch(capture: Capture, region: Region) -> ReferencePatch:
    """Return the diffuse reference as the capture states it."""
    reference, radius = capture.settings["reference"], capture.radius_mm
    patch = ReferencePatch(region, tilt_std=float(np.radians(reference["tilt_std_deg"])))
    if reference["reflectance"] is not None:
        patch = patch._replace(reflectance=Stated(*reference["reflectance"]))
    if reference["depth_mm"] is not None and radius is not None:
        depth, std = reference["depth_mm"]
        patch = patch._replace(depth=Stated(depth / radius.value, std / radius.value))
    return patch
