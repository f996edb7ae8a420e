"""Noise of uniform areas, as a test for denoising, compression, sharpening or a tone curve.

The noise of a sensor is independent between pixels, and increases with brightness. Denoising, demosaicing and JPEG
correlate the noise of neighbours. Sharpening makes this correlation negative. JPEG also causes block borders every 8
px. A tone curve makes the noise of dark pixels larger than the noise of bright pixels. Second differences of neighbours
remove light that changes smoothly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.core.arrays import FloatArray, xp
from matcam.numerics.normal import SIGNIFICANT

if TYPE_CHECKING:
    from matcam.core.jax import jax

BLOCK = 8
"""Block size of JPEG, px."""
_LARGEST = 9.0
"""Multiple of the mean square to which a squared difference is clipped."""
_LOSS = 4.0
"""Relative variance of a noise variance, times the number of differences. It exceeds 2, because differences share pixels."""
_FEWEST = 100
"""Smallest number of differences for an estimate of the noise."""
_GRID = 1.4
"""Ratio of the squared differences across and within blocks of 8 px above which an image was compressed as JPEG."""
LEAST_NOISE = 2e-4
"""Smallest noise of a photograph relative to the step of an edge. Only rendered images have less noise."""
TONE_CURVE_UNCERTAINTY = 0.03
"""Smallest relative standard deviation of a blur that was measured without inverting a tone curve."""


def clipped_mean(squares: jax.Array, count: jax.Array | int, most: float, rounds: int) -> jax.Array:
    """Compute the mean of squares that are clipped to `most` times their mean.

    `squares`: any shape; 0 for entries that are ignored. `count`: number of the other entries. `rounds`: number of iterations.
    """
    mean = squares.sum() / count
    for _ in range(rounds):
        mean = xp.minimum(squares, most * mean).sum() / count
    return mean


def smoothing_uncertainty(blur: float, *, denoised: bool) -> float:
    """Estimate the relative standard deviation of a measured blur that smoothing in software causes.

    Args:
        blur: standard deviation of the blur of lens and pixel, px. Smoothing has less effect on a wider blur.
        denoised: whether the smoothing has a longer range than demosaicing.
    """
    # The factors were measured with tests/oracle/processed_pictures.py. The error is at most 40 %.
    return float(min(0.2 / blur if denoised else 0.15 / blur**2, 0.4))


class FlatNoise(NamedTuple):
    """Noise of uniform areas.

    Attributes:
        neighbour_ratio: ratio of the noise variances from pixels 1 px and 2 px apart; 1 for independent noise.
        neighbour_ratio_std: standard deviation of `neighbour_ratio`; infinite if it is unknown.
        wide: ratio of the noise variances from pixels 2 px and 3 px apart; 1 for independent noise.
        tilt: ratio of the noise variance of the dark side to that of the bright side; NaN if it is unknown.
        tilt_std: standard deviation of `tilt`.
        grid: ratio of the squared differences across borders every 8 px and elsewhere; 1 for independent noise.
        variance: noise variances of the dark and of the bright side, in squared units of the image.
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
        # Weaker correlations are left to `linear_filters.py`, which compares filters by their probabilities.
        return self.neighbour_ratio < 0.75 and 1 - self.neighbour_ratio > SIGNIFICANT * self.neighbour_ratio_std

    @property
    def denoised(self) -> bool:
        """True if the noise is also correlated over 2 px, beyond the effect of JPEG blocks."""
        # Demosaicing and JPEG correlate pixels over a shorter range than denoising.
        wide = 0.65 if self.grid > _GRID else 0.8
        # Denoised images have weaker block borders than those of JPEG alone.
        return self.smoothed and self.wide < wide and self.grid < 4.0

    @property
    def compressed(self) -> bool:
        return self.smoothed and self.grid > _GRID

    @property
    def tone_curve_suspected(self) -> bool:
        """True if the noise of dark pixels is larger than that of bright ones, as after a tone curve."""
        # Only an excess of more than 8 %, at 4 standard deviations, indicates a tone curve.
        return not self.smoothed and self.tilt > 1.08 and self.tilt - 1 > 4.0 * self.tilt_std

    @property
    def correlation(self) -> str:
        return (
            f"the noise of neighbouring pixels is correlated (variance ratio {self.neighbour_ratio:.2f}, instead of 1)"
        )

    @property
    def tone(self) -> str:
        return (
            f"the noise variance of dark pixels is {self.tilt:.1f} times that of bright ones: a tone curve may have been "
            "applied"
        )

    @property
    def apart(self) -> float:
        """Significance of a negative correlation of neighbours, as caused by sharpening, in standard deviations."""
        return (self.neighbour_ratio - 1) / self.neighbour_ratio_std


def flat_noise(
    value: FloatArray, dark: np.ndarray, bright: np.ndarray, *, lines: bool = True, least: float = 0.0
) -> FlatNoise:
    """Measure the noise of an image (height, width).

    `dark`, `bright`: masks of the dark and bright flat areas. `lines`: whether all pixels are present, so that differences
    along columns are used as well. `least`: standard deviation below which the image is assumed to have no noise.
    """
    sides = [dark & np.isfinite(value), bright & np.isfinite(value)]
    value = np.where(sides[0] | sides[1], value, 0.0)
    views = [(value, sides)]
    if lines:
        views.append((np.ascontiguousarray(value.T), [np.ascontiguousarray(side.T) for side in sides]))

    def at(lag: int) -> tuple[FloatArray, FloatArray]:
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
    if min(n) > _FEWEST and min(variance) > 0:
        tilt = float(variance[0] / variance[1])
        result = result._replace(tilt=tilt, tilt_std=float(tilt * np.sqrt(_LOSS / n[0] + _LOSS / n[1])))
    if not result.smoothed:
        return result
    three, _ = at(3)
    good &= three > 0
    weight = fewer * good
    grid = min(_grid(v, of) for v, of in views) if lines else 1.0
    return result._replace(wide=ratio(two, three) if good.any() else 1.0, grid=grid)


def crushed_share(dark: np.ndarray, bright: np.ndarray) -> float:
    """Compute the fraction of clipped pixels on the dark side of an edge.

    Clipped pixels have the lowest value of the side. The fraction is 0 if the next value, or one value on the bright
    side, is similarly frequent. In a noise-free image both sides are uniform, which does not indicate clipping.
    `dark`, `bright`: numbers of pixels with each value of a side, in ascending order of the values.
    """
    if dark.sum() < 2 or bright.sum() < 2:
        return 0.0
    count = dark / dark.sum()
    largest = bright.max() / bright.sum()
    # Crushed blacks are at least 5 % of the dark side, and twice as frequent as any other value.
    piled = count[0] > max(0.05, 2.0 * max(largest, count[1] if count.size > 1 else 0.0))
    return float(count[0]) if piled else 0.0


def _variance(value: FloatArray, there: np.ndarray, lag: int) -> tuple[float, float]:
    """Compute the noise variance from pixels `lag` apart along the rows, and the number of differences."""
    both = there[:, 2 * lag :] & there[:, lag:-lag] & there[:, : -2 * lag]
    squared = (value[:, 2 * lag :] - 2 * value[:, lag:-lag] + value[:, : -2 * lag])[both] ** 2
    if squared.size < 2:
        return 0.0, 0.0
    return float(clipped_mean(squared, squared.size, _LARGEST, 5)) / 6, float(squared.size)


def _is_rounded_light(value: FloatArray, there: np.ndarray) -> bool:
    """Check whether the codes on one side of an edge are rounded smooth light without noise.

    Such codes change only where the light crosses a rounding level, so most neighbours are equal, and most successive changes
    along a row have the same sign.
    """
    both = there[:, 1:] & there[:, :-1]
    change = np.diff(value, axis=1) * both
    if not 2 <= np.count_nonzero(change) <= 0.5 * both.sum():
        return False
    change = np.sign(change)
    rows, columns = np.nonzero(change)
    sign, same_row = change[rows, columns], rows[1:] == rows[:-1]
    # With independent noise of 0.1 levels, 30 to 98 % of the changes are followed by one of opposite sign, and with 0.2
    # levels at least 59 %, for light that changes by at most 0.1 levels/px.
    return bool((sign[1:] != sign[:-1])[same_row].sum() < 0.35 * same_row.sum())


def _grid(value: FloatArray, sides: list[np.ndarray]) -> float:
    """Compute the ratio of the squared differences of neighbours across block borders and elsewhere.

    The most probable borders are used. The ratio is 1 if there are too few pixels.
    """
    total, count = np.zeros(BLOCK), np.zeros(BLOCK)
    for there in sides:
        both = there[:, 1:] & there[:, :-1]
        squared = np.where(both, np.diff(value, axis=1) ** 2, 0.0)
        mean = squared.sum() / max(both.sum(), 1)
        if mean > 0:
            relative = np.minimum(squared / mean, _LARGEST)
            phase = np.arange(both.shape[1]) % BLOCK
            total += np.bincount(phase, relative.sum(0), BLOCK)
            count += np.bincount(phase, both.sum(0), BLOCK)
    if count.min() < _FEWEST / BLOCK:
        return 1.0
    mean = total / count
    most = int(mean.argmax())
    return float(mean[most] / max(float(np.median(np.delete(mean, most))), 1e-300))
