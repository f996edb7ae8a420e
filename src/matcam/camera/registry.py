"""Models of lenses and pixels, by the names that profiles and users give them; free of JAX, for the command line."""

from __future__ import annotations

from typing import Any

from matcam.core.registry import Registry

_OPTICS = "matcam.camera.optics"

LENSES: Registry[Any] = Registry(
    {
        "gaussian": f"{_OPTICS}.gaussian:GaussianOptics",
        "diffraction": f"{_OPTICS}.pupil:DiffractionOptics",
        "defocus": f"{_OPTICS}.pupil:DefocusOptics",
        "measured": f"{_OPTICS}.measured:MeasuredOptics",
        "halo": f"{_OPTICS}.halo:HaloOptics",
    }
)
"""Every lens; `calibrate` and camera profiles take any of them."""

PARAMETRIC_LENSES = LENSES.subset(lambda name: name != "measured")
"""Lenses of a few parameters, which can be fitted to a single edge."""

PIXELS: Registry[Any] = Registry(
    {
        "box": "matcam.camera.pixel:BoxPixel",
        "windowed gaussian": "matcam.camera.pixel:WindowedGaussianPixel",
    }
)
"""Every pixel response."""

CFAS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Bayer mosaics: the colours of the upper left 2 x 2 pixels, row by row."""
