"""From a capture to what the joint fit needs: merged pictures, outline, first lamp directions, and what is known of all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from matcam.acquisition.darkness import dark_of
from matcam.acquisition.frame_shifts import find_shifts
from matcam.acquisition.highlights import find_highlights, lamp_angles_apart, lamp_from_highlight
from matcam.acquisition.merged_picture import MergedPicture
from matcam.acquisition.merging import merge
from matcam.acquisition.mirror_ball import MirrorBall
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.acquisition.outline import Outline, Sighting, find_outline, stacked
from matcam.acquisition.radiometry import Radiometry, capture_camera
from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.core.errors import ArgumentError, FitError, MatcamError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, CaptureFrame, Region, Stated
from matcam.reconstruction.sphere_scene import Known, SphereScene, lens_std

Progress = Callable[[str, int, int], None]

_GUESSED_LENS = Known(0.5, 0.35)
"""px; where a capture states no profile."""
_GUESSED_NEARNESS = Known(0.02, 0.02)
"""One over a distance that is not stated, in radii."""
_MARGIN = 0.12
"""Of the radius, about the outline: the part of a frame that is read."""
_SHIFT = 0.3
"""px; how far the sphere may move between pictures where its limb does not say."""
_FEWEST = 3
_PATCH_DEPTH = 0.5
"""Radii by which a diffuse reference may stand before or behind the sphere's centre."""
INCOMPLETE = ("bad-frame", "bad-line", "missing-frame", "other-size", "no-highlight", "picture-left-out")
"""Codes of the remarks on what could not be used."""


class CapturedScene(NamedTuple):
    """Hold what a capture's frames say before the joint fit.

    Attributes:
        pictures: merged pictures that can be fitted.
        scene: what is known beforehand.
        lamps: directions to the lamps as the highlights say, (pictures, 3).
        radiometry: what the codes mean.
        outline: the sphere's outline; None: of another sample.
        left_out: names of the lamp positions that cannot be used.
        remarks: what a reader should know.
    """

    pictures: list[MergedPicture]
    scene: SphereScene
    lamps: np.ndarray
    radiometry: Radiometry
    outline: Outline | None
    left_out: tuple[str, ...]
    remarks: tuple[Remark, ...]


def captured_scene(capture: Capture, progress: Progress | None = None) -> CapturedScene:
    """Merge a capture's frames, and find outline, highlights and lamps.

    Args:
        capture: as from `read_capture`.
        progress: is called with a step's name, and how many of how many parts of it are done. Default: None.

    Raises:
        ArgumentError: the capture is not of a sphere.
        FitError: there is no sphere, or fewer than three pictures show a highlight.
    """
    kind = capture.settings["sample"]["kind"]
    if kind != "sphere":
        raise ArgumentError(f"{capture.folder}: sample.kind is {kind!r}: the outline of a 'sphere' is looked for here")
    remarks: list[Remark] = list(capture.problems)
    camera, spread = captured_lens(capture, remarks)
    camera_nearness = known_nearness(capture.camera_radii, "camera", remarks)
    lamp_nearness = known_nearness(capture.lamp_radii, "lamp", remarks)
    distance = 1 / camera_nearness.value if camera_nearness.value > 0 else np.inf
    sighting = Sighting(distance=distance)
    outline, region = None, capture.region
    if capture.of("outline"):
        outline = _backlit_outline(capture, sighting, capture.region, remarks)
        region = capture.region or _about(outline)
    pictures, radiometry = merge(capture, region, progress)
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
    centres = np.tile([outline.column, outline.row], (len(seen), 1)) if centres is None else centres[seen]
    stated, stds = _stated_lamps(capture, [one.name for one in pictures], lamps, remarks)
    order = [1, 0, 2]  # row, column, radius -> column, row, radius
    gain, gain_std = gains_of(capture, radiometry, [one.name for one in pictures], lamps, ball, far)
    lamp_radius = lamp_radius_of(capture)
    scene = SphereScene(
        camera=camera,
        lens_std=spread,
        centres=centres,
        radius=outline.radius,
        outline_covariance=outline.covariance[np.ix_(order, order)],
        shift_std=_SHIFT,
        camera_nearness=camera_nearness,
        lamp_nearness=lamp_nearness,
        lamps=stated,
        lamp_std=stds,
        lamp_radius=lamp_radius,
        gain_std=gain_std,
        gain=gain,
    )
    return CapturedScene(pictures, scene, lamps, radiometry, outline, left_out, tuple(dict.fromkeys(remarks)))


def captured_lens(capture: Capture, remarks: list[Remark]) -> tuple[Camera, float]:
    """Return a capture's camera and the relative standard deviation of its lens; without a profile a guess, remarked."""
    camera = capture_camera(capture)
    if camera is not None:
        return camera, lens_std(camera)
    value, std = _GUESSED_LENS
    remarks.append(Remark("lens-guessed", f"no camera profile: the lens is taken as {value:g} +- {std:g} px"))
    return Camera(GaussianOptics(value)), std / value


def known_nearness(distance: Stated | None, of: str, remarks: list[Remark]) -> Known:
    """Return one over a stated distance, in radii; of one that is not stated a guess, remarked."""
    if distance is None:
        remarks.append(
            Remark(f"{of}-distance-not-stated", f"the {of}'s distance is not stated: 25 radii or more are assumed")
        )
        return _GUESSED_NEARNESS
    return Known(1 / distance.value, max(distance.std, 1e-6 * distance.value) / distance.value**2)


def lamp_radius_of(capture: Capture) -> float:
    """Return the lamp's angular radius, rad; 0 where its size or distance is not stated."""
    radius, distance = capture.settings["lamp"]["radius_mm"][0], capture.settings["distances"]["lamp_mm"]
    return 0.0 if distance is None else float(radius / distance[0])


def _backlit_outline(capture: Capture, sighting: Sighting, region: Region | None, remarks: list[Remark]) -> Outline:
    """Return the outline before a bright field, from the mean of the frames that show one."""
    reader = MosaicReader(capture)
    mean = mean_outline_frame(reader, capture, region, remarks)
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
    return find_outline(picture, light="backlit", sighting=sighting, backlight_reach=(float(beyond), float(beyond) / 3))


def mean_outline_frame(
    reader: MosaicReader, capture: Capture, region: Region | None, remarks: list[Remark]
) -> np.ndarray:
    """Return the mean of the frames before a bright field, less dark; those that cannot be used are remarked."""
    total: np.ndarray | None = None
    count = 0
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
    return np.asarray(total / count)


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


def _about(outline: Outline) -> Region:
    """Return the part of a frame about an outline: first column and row even, so that a mosaic stays one."""
    reach = outline.radius * (1 + _MARGIN) + 4
    left, top = (2 * int(max(0, np.floor((centre - reach) / 2))) for centre in (outline.column, outline.row))
    right, bottom = (int(np.ceil(centre + reach)) for centre in (outline.column, outline.row))
    return left, top, right - left, bottom - top


def _stated_lamps(
    capture: Capture, names: Sequence[str], lamps: np.ndarray, remarks: list[Remark]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the stated directions, or those of the highlights where none is stated, and how well each is known, rad."""
    stated, stds = lamps.copy(), np.full(len(names), np.radians(20.0))
    for k, name in enumerate(names):
        direction = capture.lamps[name].direction
        if np.all(np.isfinite(direction)):
            stated[k], stds[k] = direction, max(capture.direction_std, 1e-5)
    known = stds < np.radians(19.0)
    if known.any():
        apart = np.degrees(lamp_angles_apart(lamps[known], stated[known]))
        remarks.append(
            Remark(
                "lamp-table",
                f"highlights and stated lamp directions differ by {np.sqrt(np.mean(apart**2)):.2g}° rms before the fit",
            )
        )
    return stated, stds


def gains_of(
    capture: Capture, radiometry: Radiometry, names: Sequence[str], lamps: np.ndarray, ball: MirrorBall, far: float
) -> tuple[np.ndarray | None, np.ndarray]:
    """Return each picture's light by the reference and its relative standard deviation; where there is none, what is stated."""
    drift = float(capture.settings["lamp"]["gain_std"])
    output = [radiometry.lamp_output.get(name) for name in names]
    known = [one is not None and np.isfinite(one.value) and one.value > 0 for one in output]
    if not any(known):
        return None, np.full(len(names), drift)
    gain = np.array([one.value if good and one is not None else 1.0 for one, good in zip(output, known, strict=True)])
    std = np.array(
        [one.std / one.value if good and one is not None else drift for one, good in zip(output, known, strict=True)]
    )
    region = capture.reference_region
    if capture.settings["reference"]["kind"] == "diffuse" and region is not None and np.isfinite(far):
        # the radiometry takes the lamp as distant; a near one lights a patch beside the sphere otherwise
        column, row, width, height = region
        patch = np.array([column + width / 2 - ball.column, ball.row - row - height / 2, 0.0]) / ball.radius
        way = lamps - patch / far
        length = np.linalg.norm(way, axis=1)
        stated = np.array([capture.lamps[name].direction[2] for name in names])
        gain /= way[:, 2] / length**3 / np.where(np.isfinite(stated), stated, lamps[:, 2])
        std = np.hypot(std, 2 * np.abs(lamps[:, 2]) / far * _PATCH_DEPTH)
    return gain / gain.mean(), np.maximum(std, 1e-5)
