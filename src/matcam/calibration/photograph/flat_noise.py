"""The noise of even areas as a test for denoising, compression, sharpening or a tone curve.

The noise of a sensor is independent between pixels, and increases with brightness. Denoising, demosaicing and JPEG make
the noise of neighbours correlated, sharpening makes it anticorrelated, JPEG leaves borders every 8 px, and a tone curve
makes the noise of dark pixels larger than that of bright ones. Second differences of neighbours remove light that
changes smoothly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.arrays import FloatArray

BLOCK = 8  # px: block size of JPEG
# multiple of the mean square to which a difference is clipped: an edge of dirt is not noise
_ROUNDS, _LARGEST = 5, 9.0
# the relative standard deviation of a variance of n differences is the root of this over n, because they share pixels
_LOSS = 4.0
_FEWEST = 100  # smallest number of differences
_CORRELATED, _SURE = 0.75, 5.0  # variance between neighbours over that of pixels 2 px apart; standard deviations
_WIDE, _WIDE_IN_BLOCKS = 0.8, 0.65  # the same, 2 over 3 px apart: demosaicing and JPEG have a shorter range
_TONE_RATIO, _SURE_TONE = 1.08, 4.0  # variance of dark over bright pixels; standard deviations
_EQUAL, _REVERSALS = 0.5, 0.35
"""Share of equal neighbours above which, and of changes that reverse the one before below which, a side has no noise.

Rounded codes of smooth light change along contours, and a change is followed by one of the same sign. Independent noise of 0.1
levels reverses 30 to 98 % of its changes, and of 0.2 levels 59 % or more, for light that changes by 0.1 levels/px or less.
"""
_GRID = 1.4  # squared difference across the border of a block over that within
# the same, above which the noise was removed by the blocks alone: denoised images have weaker borders
_BLOCKS_ALONE = 4.0
# px, px^2: errors of MTF50 times the blur, and its square, in tests/oracle/processed_pictures.py
_DENOISED, _DEMOSAICED = 0.2, 0.15
_MOST = 0.4  # of MTF50
_PILED, _LEAST_PILE = 2.0, 0.05  # multiple of the share at the next level; share of the dark side at the lowest level
LEAST_NOISE = 2e-4
"""Smallest noise of a photograph, relative to the step of its light: a smooth render has less."""
TONE_CURVE_UNCERTAINTY = 0.03
"""Smallest relative standard deviation of a blur behind a tone curve that was not undone."""


def smoothing_uncertainty(blur: float, *, denoised: bool) -> float:
    """Return the relative standard deviation of a blur from smoothing by software.

    Args:
        blur: of lens and pixel, px. The wider it is, the less smoothing over so many px changes it.
        denoised: whether it reached further than demosaicing.
    """
    return float(min(_DENOISED / blur if denoised else _DEMOSAICED / blur**2, _MOST))


class FlatNoise(NamedTuple):
    """Noise of even areas.

    Attributes:
        neighbour_ratio: variance between neighbours over that of pixels 2 px apart; 1 for independent noise.
        neighbour_ratio_std: its standard deviation; infinite where nothing is known.
        wide: variance of pixels 2 px apart over that of pixels 3 px apart; 1 for independent noise.
        tilt: variance of the dark side over that of the bright one; NaN where nothing is known.
        tilt_std: its standard deviation.
        grid: squared difference across borders every 8 px over that elsewhere; 1 for independent noise.
        variance: of dark and bright side.
    """

    neighbour_ratio: float
    neighbour_ratio_std: float
    wide: float
    tilt: float
    tilt_std: float
    grid: float
    variance: tuple[float, float]

    @property
    def smoothed(self) -> bool:
        """Check whether the noise of neighbours is correlated."""
        return self.neighbour_ratio < _CORRELATED and 1 - self.neighbour_ratio > _SURE * self.neighbour_ratio_std

    @property
    def denoised(self) -> bool:
        """Check whether the noise of more distant pixels is correlated, too."""
        wide = _WIDE_IN_BLOCKS if self.grid > _GRID else _WIDE
        return self.smoothed and self.wide < wide and self.grid < _BLOCKS_ALONE

    @property
    def compressed(self) -> bool:
        """Check whether JPEG blocks were found."""
        return self.smoothed and self.grid > _GRID

    @property
    def tone_curve_suspected(self) -> bool:
        """Check whether the noise of dark pixels is larger than that of bright ones, as under a tone curve."""
        return not self.smoothed and self.tilt > _TONE_RATIO and self.tilt - 1 > _SURE_TONE * self.tilt_std

    @property
    def correlation(self) -> str:
        """Describe the correlation of neighbours."""
        return f"the noise of neighbouring pixels is correlated ({self.neighbour_ratio:.2f} of independent noise)"

    @property
    def apart(self) -> float:
        """Return the significance of a negative correlation of neighbours, as from sharpening, in standard deviations."""
        return (self.neighbour_ratio - 1) / self.neighbour_ratio_std


def flat_noise(
    value: FloatArray, dark: np.ndarray, bright: np.ndarray, *, lines: bool = True, least: float = 0.0
) -> FlatNoise:
    """Return the noise of an image (height, width).

    dark, bright: masks of its flat areas, bool. `lines`: whether columns are neighbours, too, and all pixels are
    present. `least`: standard deviation below which no noise is assumed, as in a smooth render.
    """
    sides = [dark & np.isfinite(value), bright & np.isfinite(value)]
    value = np.where(sides[0] | sides[1], value, 0.0)
    views = [(value, sides), *([(value.T, [side.T for side in sides])] if lines else [])]

    def at(lag: int) -> tuple[FloatArray, FloatArray]:
        """Return the variances and counts of all directions and sides."""
        found = np.array([_variance(v, side, lag) for v, of in views for side in of])
        return found[:, 0], found[:, 1]

    def ratio(near: FloatArray, far: FloatArray) -> float:
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.where(good, np.log(near / far), 0.0)
        return float(np.exp((weight * steps).sum() / weight.sum()))

    (near, count), (two, fewer) = at(1), at(2)
    n, total = ((a[::2].sum(), a[1::2].sum()) for a in (count, count * near))
    variance = (total[0] / max(n[0], 1.0), total[1] / max(n[1], 1.0))
    good = (near > 0) & (two > least**2) & (fewer > _FEWEST)
    good &= ~np.array([_is_rounded_light(v, side) for v, of in views for side in of])
    result = FlatNoise(1.0, np.inf, 1.0, np.nan, np.inf, 1.0, variance)
    if not good.any():
        return result
    weight = fewer * good
    neighbour_ratio = ratio(near, two)
    result = result._replace(
        neighbour_ratio=neighbour_ratio, neighbour_ratio_std=float(neighbour_ratio * np.sqrt(_LOSS / weight.sum()))
    )
    if min(n) > _FEWEST and variance[1] > 0:
        tilt = float(variance[0] / variance[1])
        result = result._replace(tilt=tilt, tilt_std=float(max(tilt, 1.0) * np.sqrt(_LOSS / n[0] + _LOSS / n[1])))
    if not result.smoothed:
        return result
    three, _ = at(3)
    good &= three > 0
    weight = fewer * good
    grid = min(_grid(v, of) for v, of in views) if lines else 1.0
    return result._replace(wide=ratio(two, three) if good.any() else 1.0, grid=grid)


def crushed_share(dark: FloatArray, bright: FloatArray) -> float:
    """Compute the share of a dark side at its lowest value; 0 if noise explains it.

    Noise has equal values only at the end of a range; without noise the bright side is as flat.
    """
    if dark.size < 2 or bright.size < 2:
        return 0.0
    count = np.unique(dark, return_counts=True)[1] / dark.size
    largest = np.unique(bright, return_counts=True)[1].max() / bright.size
    piled = count[0] > max(_LEAST_PILE, _PILED * max(largest, count[1] if count.size > 1 else 0.0))
    return float(count[0]) if piled else 0.0


def _variance(value: FloatArray, there: np.ndarray, lag: int) -> tuple[float, float]:
    """Return the variance of pixels `lag` apart along the rows, and the number of differences."""
    both = there[:, 2 * lag :] & there[:, lag:-lag] & there[:, : -2 * lag]
    squared = (value[:, 2 * lag :] - 2 * value[:, lag:-lag] + value[:, : -2 * lag])[both] ** 2
    if squared.size < 2:
        return 0.0, 0.0
    power = squared.mean()
    for _ in range(_ROUNDS):
        power = np.minimum(squared, _LARGEST * power).mean()
    return float(power) / 6, float(squared.size)


def _is_rounded_light(value: FloatArray, there: np.ndarray) -> bool:
    """Decide whether the codes of a side change only along the contours of smooth light, without noise."""
    change = np.sign(np.diff(value, axis=1)) * (there[:, 1:] & there[:, :-1])
    rows, columns = np.nonzero(change)
    if rows.size < 2 or rows.size > (1 - _EQUAL) * (there[:, 1:] & there[:, :-1]).sum():
        return False
    sign, same_row = change[rows, columns], rows[1:] == rows[:-1]
    return bool((sign[1:] != sign[:-1])[same_row].sum() < _REVERSALS * same_row.sum())


def _grid(value: FloatArray, sides: list[np.ndarray]) -> float:
    """Return the squared difference of neighbours across the most probable block borders relative to the other differences."""
    total, count = np.zeros(BLOCK), np.zeros(BLOCK)
    for there in sides:
        both = there[:, 1:] & there[:, :-1]
        squared = np.where(both, np.diff(value, axis=1) ** 2, 0.0)
        mean = squared.sum() / max(both.sum(), 1)
        if mean > 0:
            relative = np.minimum(squared / mean, _LARGEST)
            for phase in range(BLOCK):
                total[phase] += relative[:, phase::BLOCK].sum()
                count[phase] += both[:, phase::BLOCK].sum()
    if count.min() < _FEWEST / BLOCK:
        return 1.0
    mean = total / count
    most = int(mean.argmax())
    return float(mean[most] / max(float(np.median(np.delete(mean, most))), 1e-300))
