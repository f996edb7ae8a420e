"""Detection of photographs whose processing prevents the measurement of the lens.

All uniform areas of an image are used, because their noise is a better test than the few pixels next to one edge
(`flat_noise.py`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from matcam.calibration.photograph.flat_noise import (
    LEAST_NOISE,
    TONE_CURVE_UNCERTAINTY,
    FlatNoise,
    flat_noise,
    smoothing_uncertainty,
)
from matcam.calibration.photograph.linear_image import LinearImage
from matcam.core.errors import FitError
from matcam.core.remark import Remark

_PIXEL = 1 / 12
"""Variance of a fully sensitive pixel, px^2."""


class Processed(NamedTuple):
    """Processing that was found in an image.

    Attributes:
        remarks: remarks on the processing.
        noise: noise of the uniform areas; None if no processing was found.
    """

    remarks: tuple[Remark, ...]
    noise: FlatNoise | None

    def share(self, sigma: float) -> float:
        """Estimate the relative standard deviation of the blur due to the processing. `sigma` is the lens width, px."""
        if self.noise is None:
            return 0.0
        blur = np.hypot(sigma, np.sqrt(_PIXEL))
        far = self.noise.denoised or self.noise.compressed
        if far or self.noise.smoothed:
            return smoothing_uncertainty(float(blur), denoised=far)
        return TONE_CURVE_UNCERTAINTY if self.noise.tone_curve_suspected else 0.0


def processed(plane: LinearImage, *, accept: bool) -> Processed:
    """Detect the processing of an image.

    The MTF of an image that was denoised or compressed is not that of the lens. A FitError is therefore raised for such an
    image, unless `accept` is True. Mosaics are assumed to be unprocessed.
    """
    if plane.cfa is not None:
        return Processed((), None)
    noise = picture_noise(plane.values)
    if noise.denoised or noise.compressed:
        what = "compressed as JPEG, and may have been denoised" if noise.compressed else "denoised"
        text = (
            f"this is a processed image, whose MTF is not that of the lens: {noise.correlation}, because the image "
            f"was {what}"
        )
        if not accept:
            raise FitError(
                f"{text}: use camera raw, or accept the MTF of lens and processing together (accept_sharpened)"
            )
        remark = Remark("processed", text)
    elif noise.smoothed:
        remark = Remark("demosaiced", f"{noise.correlation}: the image was demosaiced, which blurs it; use camera raw")
    elif noise.tone_curve_suspected:
        remark = Remark("tone-curve", f"{noise.tone}: specify the tone curve (--tone)")
    else:
        return Processed((), None)
    return Processed((remark,), noise)


def picture_noise(values: np.ndarray) -> FlatNoise:
    largest = 1500  # side of the central area that is tested, px, which limits the computing time
    top, left = (max(size - largest, 0) // 2 for size in values.shape)
    middle = values[top : top + largest, left : left + largest]
    known = np.isfinite(middle)
    smooth = ndimage.gaussian_filter(np.where(known, middle, 0.0), 2.0)
    low, high = np.quantile(smooth, (0.05, 0.95))
    varies = ndimage.maximum_filter(smooth, 9) - ndimage.minimum_filter(smooth, 9)
    # Patterns that the lens does not resolve, such as the centre of a star, are grey. Uniform areas are therefore those near
    # the dark or the bright level, in which a window of 9 px varies by less than 6 % of the range of the image.
    far, limit = 0.25 * (high - low), 0.06 * (high - low)

    def even(side: np.ndarray) -> np.ndarray:
        # Most windows contain only noise, and the others the blurred rim of a shape. With a limit of 1.5 medians, the ratio of
        # noise variances of charts with a star and squares is 0.997 to 1.005 instead of 1, for lenses of 0.4 to 1.5 px and
        # 1000 and 20000 electrons.
        found = side & known & (varies < limit)
        return found & (varies <= 1.5 * np.median(varies[found])) if found.any() else found

    return flat_noise(middle, even(smooth < low + far), even(smooth > high - far), least=LEAST_NOISE * (high - low))


def processing_std(pictures: Iterable[Processed], sigma: float) -> float:
    """Estimate the standard deviation of the lens width due to the processing, px. `sigma` is the lens width, px."""
    share = max((one.share(sigma) for one in pictures), default=0.0)
    return share * (sigma + _PIXEL / sigma)
