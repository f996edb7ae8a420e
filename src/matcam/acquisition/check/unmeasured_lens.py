"""Assumption about a lens that no camera profile describes."""

from __future__ import annotations

from matcam.camera.camera import Camera
from matcam.files.capture import Stated

GUESSED_LENS = Stated(0.5, 0.35)
"""px; standard deviation of the blur that is assumed of a lens without a profile, and its error: two of them span lenses of up
to 1.2 px."""
BY_SHAPE = 0.01
"""Unexplained share of the light from which the blurs of lens and lobe, which differ in shape only, are not separated by it."""


def unmeasured_lens() -> str:
    """Return in words what a reconstruction does about a lens without a profile."""
    return (
        f"the lens is taken as {GUESSED_LENS.value:g} +- {GUESSED_LENS.std:g} px and fitted; where no lobe explains the "
        f"pictures to {BY_SHAPE:.0%}, it keeps this error, and the roughness gets it"
    )


def lens_sigma(camera: Camera | None) -> float:
    """Return the standard deviation of a camera's lens, px; without a profile, or of one that is no Gaussian, the guess."""
    known = {} if camera is None else camera.parameters()
    return float(known.get("optics.sigma_px", GUESSED_LENS.value))
