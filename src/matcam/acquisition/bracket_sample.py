"""Selected pixels of every lamp position in all its exposures, for estimates of exposure ratios, gain and clip level.

A pixel is selected, and assigned to a range of brightness, by the mean of its neighbours of the same colour. Selection by
the noisy code of the pixel itself would bias the estimates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from matcam.files.capture_frames import CaptureFrame

MOST = 30_000
"""Largest number of pixels per lamp position, which bounds the memory for all positions."""


class BracketSample(NamedTuple):
    """Selected pixels of one lamp position: n pixels in k exposures.

    Attributes:
        lamp: name of the lamp position.
        frames: the frames, in the order of `exposures`.
        exposures: indices of the exposures of this lamp position among all exposures, the shortest first, (k,).
        codes: codes of the selected pixels as read, float32 (k, n), DN.
        light: `codes` less the dark level, float32 (k, n), DN.
        around: mean of the neighbours in each exposure, less the dark level, float32 (k, n), DN.
        reference: mean of the reference region in each exposure and channel, less the dark level, (k, channels), DN;
            NaN if there is no reference or if its pixels may be clipped.
        reference_pixels: number of pixels of each channel in the reference region, (channels,).
        median: median code of each frame, (k,), DN.
        tops: `light.pile_up.TopCodes` of each frame, (k, 8).
        extent: smallest and largest code of each frame, (k, 2), DN.
    """

    lamp: str
    frames: tuple[CaptureFrame, ...]
    exposures: np.ndarray
    codes: np.ndarray
    light: np.ndarray
    around: np.ndarray
    reference: np.ndarray
    reference_pixels: np.ndarray
    median: np.ndarray
    tops: np.ndarray
    extent: np.ndarray

    @property
    def reference_total(self) -> np.ndarray:
        """Sum of the light of the reference region in each exposure, (k,), DN; NaN where `reference` is NaN."""
        return np.asarray(self.reference @ self.reference_pixels.astype(float))

    def part(self, chosen: np.ndarray) -> BracketSample:
        """Select frames of the lamp position.

        Args:
            chosen: indices of the frames in the new order, or a mask, (k,).
        """
        chosen = np.arange(len(self.frames))[chosen]
        arrays = ("exposures", "codes", "light", "around", "reference", "median", "tops", "extent")
        return self._replace(
            frames=tuple(self.frames[k] for k in chosen), **{name: getattr(self, name)[chosen] for name in arrays}
        )


def same_colour_neighbours(light: np.ndarray, step: int) -> np.ndarray:
    """Compute, for each pixel, the mean of its eight neighbours of the same colour.

    Args:
        light: image, (height, width), in any unit.
        step: distance between pixels of the same colour along a row, px: 2 in a mosaic, 1 in a grey image.
    """
    padded = np.pad(light, step, mode="reflect" if min(light.shape) > step else "edge")
    height, width = light.shape
    rows = padded[:height] + padded[step : step + height]
    rows += padded[2 * step :]
    total = rows[:, :width] + rows[:, step : step + width]
    total += rows[:, 2 * step :]
    total -= light
    total /= 8
    return np.asarray(total)


def noise_correlation(light: np.ndarray, noise: float) -> tuple[float, float]:
    """Estimate the noise correlation of neighbouring dark pixels, and the standard deviation of the correlation.

    The noise of raw pixels is uncorrelated. Sharpening causes a negative correlation, demosaicing and smoothing a
    positive correlation. If the frame has too few dark pixels, the result is 0 with an infinite standard deviation.

    Args:
        light: dark-subtracted frame, (height, width), DN.
        noise: read noise, DN.
    """
    # a square of 9 px: a small one, which contains the other pixel of a pair, would favour noise of opposite signs
    around = uniform_filter(light, 9)
    dark = (np.abs(around) < 1.5 * max(noise, 0.3)) & (np.abs(light) < 6 * max(noise, 0.3))
    products, squares, count = 0.0, 0.0, 0
    for axis in (0, 1):
        product, square, pairs = lagged(light, dark, axis, 1)
        if pairs < 100:
            continue
        # faint light is smooth and correlated over several pixels, unlike noise after sharpening or demosaicing
        # at 4 px the noise of sharpened or demosaiced frames is nearly uncorrelated: a Gaussian blur of 1 px
        # leaves 2 %
        smooth, _, others = lagged(light, dark, axis, 4)
        smooth = min(max(smooth, 0.0), 0.9 * square) if others >= 100 else 0.0
        products, squares, count = (
            products + pairs * (product - smooth),
            squares + pairs * (square - smooth),
            count + pairs,
        )
    return (products / squares, 1 / count**0.5) if squares > 0 else (0.0, float("inf"))


def lagged(light: np.ndarray, dark: np.ndarray, axis: int, lag: int) -> tuple[float, float, int]:
    """Compute covariance and variance, DN^2, of pairs of dark pixels, and the number of pairs.

    The pixels of a pair are `lag` px apart along the axis. With fewer than 100 pairs, covariance and variance are 0.
    """
    first, second = ((slice(None),) * axis + (part,) for part in (slice(lag, None), slice(-lag)))
    both = dark[first] & dark[second]
    a, b = light[first][both].astype(np.float64), light[second][both].astype(np.float64)
    if a.size < 100:
        return 0.0, 0.0, int(a.size)
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b) / a.size, float(a @ a + b @ b) / (2 * a.size), int(a.size)


def choose_pixels(around: np.ndarray, noise: float, seed: int) -> np.ndarray:
    """Select at most `MOST` lit pixels for a sample, and return their indices.

    If there are more lit pixels, one half of the selection has the brightest neighbours. The other half is selected at
    random from the other lit pixels.

    Args:
        around: mean of the neighbours of each of n pixels in k exposures, the shortest exposure first, (k, n), DN.
        noise: standard deviation of one pixel's read noise, DN.
        seed: seed of the random selection.
    """
    top = max(float(around.max()), 1.0)
    score = (np.minimum(around, 0.9 * top)).sum(0)
    lit = np.flatnonzero(around[-1] > 6 * max(noise, 0.5))
    if lit.size <= MOST:
        return lit
    order = lit[np.argpartition(score[lit], lit.size - MOST // 2)]
    others, brightest = order[: lit.size - MOST // 2], order[lit.size - MOST // 2 :]
    return np.sort(np.concatenate([brightest, np.random.default_rng(seed).choice(others, MOST // 2, replace=False)]))
