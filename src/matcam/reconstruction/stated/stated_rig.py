"""Specified camera and distances of a capture, or a guess with a remark."""

from __future__ import annotations

from matcam.acquisition.check.unmeasured_lens import GUESSED_LENS, GUESSED_NEARNESS, unmeasured_lens
from matcam.acquisition.radiometry import capture_camera
from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.core.errors import FileFormatError
from matcam.core.remark import Remark
from matcam.files.capture import Capture
from matcam.files.capture_settings import Stated
from matcam.reconstruction.sphere_scene import lens_std

FEWEST = 3
"""Smallest number of lamp positions for a reconstruction."""
_EXACT = 1e-5
"""Default relative standard deviation of a specified length. It is smaller than that of any measurement, but not 0, so
that a wrong length can be detected.
"""


def captured_lens(capture: Capture, remarks: list[Remark]) -> tuple[Camera, float]:
    """Determine the camera of a capture, and the relative standard deviation of the width of its lens.

    If the profile is missing, unreadable or of another camera, both results are guesses, and a remark is added. A FitError is
    raised if mosaics are read as grey images, see `capture_camera`.
    """
    value, std = GUESSED_LENS
    try:
        camera = capture_camera(capture)
    except FileFormatError as error:
        remarks.append(Remark("profile-left-out", f"{error}; {unmeasured_lens()}"))
        return Camera(GaussianOptics(value)), std / value
    if camera is not None:
        return camera, lens_std(camera)
    remarks.append(Remark("lens-guessed", f"the capture has no camera profile: {unmeasured_lens()}"))
    return Camera(GaussianOptics(value)), std / value


def without_field(camera: Camera, sample: str, remarks: list[Remark]) -> Camera:
    """Remove the lens field from a camera, and add a remark. The models of flat samples and cylinders support no field."""
    if camera.field is None:
        return camera
    text = (
        f"distortion and blur over the field of the profile are ignored for a {sample}: keep the sample near the centre of "
        "the frame"
    )
    remarks.append(Remark("field-not-used", text))
    return camera.with_field(None)


def known_radius(capture: Capture) -> Stated | None:
    """Return the specified radius of the sample with its standard deviation, mm; None: unknown."""
    radius = capture.radius_mm
    return None if radius is None else Stated(radius.value, max(radius.std, _EXACT * radius.value))


def known_nearness(capture: Capture, of: str, remarks: list[Remark]) -> Stated:
    """Compute the inverse of a specified distance, and its standard deviation, 1/radii.

    If the distance or the radius of the sample is unknown, a guess is returned and a remark is added. The standard deviation
    is due to the distance alone, because the error of the radius is common to the distances of camera and lamp.
    """
    stated, radius = capture.settings["distances"][f"{of}_mm"], capture.radius_mm
    if stated is None or radius is None:
        missing = [f"distances.{of}_mm"] * (stated is None) + ["sample.radius_mm"] * (radius is None)
        remarks.append(
            Remark(
                f"{of}-distance-not-stated",
                f"the distance of the {of} in radii of the sample is unknown, so a distance above about 25 radii is assumed: "
                f"specify {' and '.join(missing)}",
            )
        )
        return GUESSED_NEARNESS
    distance, std = stated
    return Stated(radius.value / distance, max(std / distance, _EXACT) * radius.value / distance)


def lamp_radius_of(capture: Capture) -> float:
    """Compute the angular radius of the lamp, rad; 0 if the radius or the distance of the lamp is unknown."""
    radius, distance = capture.settings["lamp"]["radius_mm"][0], capture.settings["distances"]["lamp_mm"]
    return 0.0 if distance is None else float(radius / distance[0])
