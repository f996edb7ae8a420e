"""What is assumed of a lens that a capture states no profile of, and what a reconstruction determines of it."""

from matcam.files.capture_settings import Stated

GUESSED_LENS = Stated(0.5, 0.35)
"""px; standard deviation of the blur that is assumed, and its error: it spans lenses of 0.2 to 1.2 px within two of them."""
BY_SHAPE = 0.01
"""Unexplained share of the light from which the blurs of lens and lobe, which differ in shape only, are not told apart by that
shape."""


def unmeasured_lens() -> str:
    """Return in words what a reconstruction does about a lens without a profile."""
    return (
        f"the lens is taken as {GUESSED_LENS.value:g} +- {GUESSED_LENS.std:g} px and fitted; where no lobe explains the "
        f"pictures to {BY_SHAPE:.0%}, it keeps this error, and the roughness gets it"
    )
