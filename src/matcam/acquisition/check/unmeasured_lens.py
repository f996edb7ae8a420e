"""Assumptions about a lens without a camera profile, and about unspecified distances."""

from __future__ import annotations

from matcam.camera.camera import Camera
from matcam.files.capture import Stated

GUESSED_LENS = Stated(0.5, 0.35)
"""Assumed standard deviation of the blur of a lens without a profile, and its standard error, px. Two standard errors
include lenses of up to 1.2 px.
"""
GUESSED_NEARNESS = Stated(0.02, 0.02)
"""Prior mean and standard deviation of the inverse of an unspecified distance, 1/radii."""
BY_SHAPE = 0.01
"""Unexplained share of the light above which the blurs of lens and lobe, which differ in shape only, are not
separated.
"""


def unmeasured_lens() -> str:
    return (
        f"the blur of the lens is assumed to be {GUESSED_LENS.value:g} ± {GUESSED_LENS.std:g} px and is fitted; if no lobe "
        f"explains the images to {BY_SHAPE:.0%}, the blur keeps this error, which adds to that of the roughness; to avoid it, "
        "measure a profile with `matcam calibrate`"
    )


def lens_sigma(camera: Camera | None) -> float:
    """Determine the standard deviation of the blur of a camera's lens, px.

    If there is no profile, or if the lens is not Gaussian, the result is the value of `GUESSED_LENS`.
    """
    known = {} if camera is None else camera.parameters()
    return float(known.get("optics.sigma_px", GUESSED_LENS.value))
