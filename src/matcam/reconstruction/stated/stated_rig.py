"""What a capture states of camera, distances and lamps, or a guess that is remarked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from matcam.acquisition.highlights import lamp_angles_apart
from matcam.acquisition.lamps.lamp_table import explain_lamp_table
from matcam.acquisition.outline import Outline
from matcam.acquisition.radiometry import capture_camera
from matcam.camera.camera import Camera
from matcam.camera.lens_field import Coefficient, LensField
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Stated
from matcam.reconstruction.sphere_scene import Known, lens_std

FEWEST = 3
"""Lamp positions that a reconstruction needs."""
_GUESSED_LENS = Known(0.5, 0.35)
"""px; where a capture states no profile."""
_GUESSED_DISTORTION = 0.002
"""Of the radius, at the sphere's limb: standard deviation where no profile states a distortion."""
_GUESSED_NEARNESS = Known(0.02, 0.02)
"""One over a distance that is not stated, in radii."""
_FAR_OFF = float(np.radians(10.0))
"""Angle between highlights and a lamp table from which no joint fit could begin with the table."""
_UNKNOWN = float(np.radians(20.0))
"""Standard deviation of a lamp's direction that nothing is stated of."""


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


def with_field(camera: Camera, outline: Outline) -> Camera:
    """Return the camera with a field: where its profile states none, a distortion about the sphere that nobody has measured."""
    if camera.field is not None:
        return camera
    guess = Coefficient(0.0, _GUESSED_DISTORTION)
    return camera.with_field(LensField((outline.column, outline.row), outline.radius, guess))


def stated_lamps(
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
    if known.sum() >= FEWEST:
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
