"""Whether a whole photograph has been through software that leaves no lens to be measured.

The noise of all its even parts together tells it more surely than the few pixels beside one edge (`flat_noise.py`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from matcam.calibration.photograph.flat_noise import BENT_DOUBT, FlatNoise, flat_noise, smoothing_doubt
from matcam.calibration.photograph.linear_image import LinearImage
from matcam.core.errors import FitError
from matcam.core.remark import Remark

_LARGEST = 1500  # px: so much of a picture is enough
_SMOOTH, _WINDOW, _EVEN = 2.0, 9, 0.06  # px, px, of the range: smoothed light that varies by less over a window is even
_LEAST_NOISE = 2e-4  # of the range
_PIXEL = 1 / 12  # px^2


class Processed(NamedTuple):
    """Hold what software did to a picture.

    Attributes:
        remarks: what was seen.
        noise: of the even parts.
    """

    remarks: tuple[Remark, ...]
    noise: FlatNoise | None

    def share(self, sigma: float) -> float:
        """Return the relative standard deviation that this gives to the blur of lens and pixel.

        sigma: px, of the lens.
        """
        if self.noise is None:
            return 0.0
        blur = np.hypot(sigma, np.sqrt(_PIXEL))
        far = self.noise.denoised or self.noise.compressed
        if far or self.noise.smoothed:
            return smoothing_doubt(float(blur), denoised=far)
        return BENT_DOUBT if self.noise.bent else 0.0


def processed(plane: LinearImage, *, accept: bool) -> Processed:
    """Return what software did to a picture; FitError where its MTF is not the lens's.

    accept: the MTF of lens and software together is wanted. Camera raw is as the sensor saw it, and passes.
    """
    if plane.cfa is not None:
        return Processed((), None)
    noise = picture_noise(plane.values)
    if noise.denoised or noise.compressed:
        what = "compressed as JPEG, and may have been denoised" if noise.compressed else "denoised"
        text = f"neighbours err alike (by {noise.alike:.2f} of independent noise): it was {what}"
        if not accept:
            raise FitError(
                f"this is a processed picture; its MTF is not the lens's: {text}: use camera raw, or accept "
                "the MTF of lens and software together (accept_sharpened)"
            )
        return Processed(
            (Remark("processed", f"this is a processed picture; its MTF is not the lens's: {text}"),), noise
        )
    if noise.smoothed:
        text = (
            f"neighbours err alike (by {noise.alike:.2f} of independent noise): demosaiced, which blurs; use camera raw"
        )
        return Processed((Remark("demosaiced", text),), noise)
    if noise.bent:
        text = (
            f"dark pixels err {noise.tilt:.1f} times as much as bright ones: a tone curve that was not undone (--tone)?"
        )
        return Processed((Remark("tone-curve", text),), noise)
    return Processed((), None)


def picture_noise(values: np.ndarray) -> FlatNoise:
    """Return the noise of a picture's even parts; values: (height, width)."""
    top, left = (max(size - _LARGEST, 0) // 2 for size in values.shape)
    middle = values[top : top + _LARGEST, left : left + _LARGEST]
    known = np.isfinite(middle)
    smooth = ndimage.gaussian_filter(np.where(known, middle, 0.0), _SMOOTH)
    low, high = np.quantile(smooth, (0.05, 0.95))
    varies = ndimage.maximum_filter(smooth, _WINDOW) - ndimage.minimum_filter(smooth, _WINDOW)
    even = known & (varies < _EVEN * (high - low))
    dark = smooth < (low + high) / 2
    return flat_noise(middle, even & dark, even & ~dark, least=_LEAST_NOISE * (high - low))


def doubt_of(pictures: Iterable[Processed], sigma: float) -> float:
    """Return the standard deviation, px, that what software did to pictures gives to a lens; sigma: px, of the lens."""
    share = max((one.share(sigma) for one in pictures), default=0.0)
    return share * (sigma + _PIXEL / sigma)
