"""Linear filters of an image: estimation from the correlation of the noise, and effect on the MTF.

The noise of a sensor is independent between pixels. After a linear filter of transfer function K, the power spectrum of
the noise is |K|^2, and the MTF of the image is multiplied by K. Smoothing, sharpening, deconvolution and resampling are
compared with the absence of a filter by their posterior probabilities. The uncertainty therefore increases continuously
with the correlation, without a threshold.

Weak sharpening is also visible in the edge. The line spread function of a lens is not negative, but that of an unsharp
mask is negative beside the core. Therefore the edge is fitted twice with an arbitrary non-negative line spread function (a
series of narrow basis functions): without and with an unsharp mask. Defocus, ghosts and glare are non-negative, and are
not mistaken for a mask.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.optimize import nnls
from scipy.special import ndtr

from matcam.calibration.photograph.flat_noise import LEAST_NOISE
from matcam.core.arrays import FloatArray
from matcam.numerics.crossing import first_fall
from matcam.numerics.polynomials import plane_orders

LAGS = (
    *((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (1, 2), (2, 1), (1, -2), (2, -1), (2, 2), (2, -2)),
    *((0, 5), (5, 0), (4, 4), (4, -4), (0, 6), (6, 0)),
)
"""Offsets (rows, columns) of the pixels whose correlation is compared with that of filters, px. Uneven light, but hardly any
filter, correlates distant pixels."""
_ORDER = 3
"""Order of the polynomial that models the light on a side of the edge."""
_LOST = 0.4
"""Largest relative error of MTF50, which is also used if no MTF50 can be computed without the filter."""
_GRID = 32
"""Number of samples of a transfer function along each axis. Their spacing is 1/32 cycles/px."""


_WIDTHS = 0.25 * 1.04 ** np.arange(37)
"""Standard deviations of the Gaussian filters, px."""
_MASKS = [(a, r) for a in (0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0) for r in (0.6, 0.8, 1.0, 1.3, 1.7)]
"""Unsharp masks: amount, and standard deviation of their Gaussian, px."""
AMOUNT, RADIUS = 0.1, 1.0
"""Amount and radius (px) of the unsharp mask that represents weak sharpening in the test of an edge."""


class Correlations(NamedTuple):
    """Correlations of the noise of an image.

    Attributes:
        value: (lags,) correlations of pixels at the offsets of `LAGS`.
        pairs: (lags,) numbers of pixel pairs.
    """

    value: FloatArray
    pairs: FloatArray


class BareEdge(NamedTuple):
    """Set of n pixel means across an edge, corrected for uneven light.

    Values are in units of the step of the edge.

    Attributes:
        distance: (n,) distance from the edge, px, ascending.
        spread: (n,) variance of the distances in each mean, px^2.
        value: (n,) value, 0 on the dark and 1 on the bright side.
        std: (n,) standard deviation of the noise.
        parametric: (n,) prediction of the parametric fit.
        light: (k, n) changes of the value by the levels and by uneven light, with free coefficients.
        blur: standard deviation of the line spread function, px.
    """

    distance: FloatArray
    spread: FloatArray
    value: FloatArray
    std: FloatArray
    parametric: FloatArray
    light: FloatArray
    blur: float


class FilterUncertainty(NamedTuple):
    """Uncertainty of an MTF due to filters that may have been applied.

    Attributes:
        share: relative error of MTF50: mean of the absolute errors due to all filters, weighted by the probabilities of
            the filters.
        probability: probability that any filter was applied.
        smooths: whether the most probable filter decreases MTF50.
    """

    share: float
    probability: float
    smooths: bool


class _Filters(NamedTuple):
    """Set of k linear filters.

    Attributes:
        correlation: (k, lags) correlations of filtered white noise.
        transfer: (k, frequencies) transfer functions.
        prior: (k,) prior probabilities.
    """

    correlation: FloatArray
    transfer: FloatArray
    prior: FloatArray


def correlations(value: FloatArray, sides: tuple[np.ndarray, np.ndarray]) -> Correlations | None:
    """Measure the correlations of the noise of an image; None if there are too few pixels or no noise.

    Args:
        value: image (height, width), any unit.
        sides: masks (height, width) of the dark and of the bright flat side of the image.

    Returns:
        Correlations of pixels at all offsets of `LAGS`.
    """
    noise, there = np.zeros(value.shape), np.zeros(value.shape)
    for side in sides:
        # Fewer pixels do not determine the correlations.
        if side.sum() < 500:
            return None
        left = value[side] - _smooth_light(value, side)[side]
        scale = left.std()
        if not scale > 0:
            return None
        # Larger deviations are not noise.
        noise[side], there[side] = np.clip(left / scale, -4.0, 4.0), 1.0
    # Structure at a few positions, caused by dirt or the border of a shadow, is not noise. There, the mean over a patch of
    # 5 x 5 px exceeds the median of all patches by a factor of 5.
    there_mean, noise_mean = (ndimage.uniform_filter(a, 5) for a in (there, noise))
    local = np.abs(noise_mean / np.maximum(there_mean, 1e-3))
    there *= local < 5.0 * np.median(local[there > 0])
    total, pairs = (_sums_of_products(a) for a in (noise * there, there))
    # The fit of the light reduces the sum of correlations by one pair for each of its terms.
    return Correlations((total + len(sides) * len(plane_orders(_ORDER))) / np.maximum(pairs, 1.0), pairs)


def _smooth_light(value: FloatArray, side: np.ndarray) -> FloatArray:
    """Fit a polynomial of order `_ORDER` to the pixels of a mask, and evaluate it over the image (height, width).

    Row and column powers are separable, so that all sums over pixels are matrix products.
    """
    powers = [np.vander(np.linspace(-1, 1, size), 2 * _ORDER + 1, increasing=True).T for size in value.shape]
    moments = powers[0] @ side @ powers[1].T
    i, j = np.transpose(plane_orders(_ORDER))
    y, x = (power[: _ORDER + 1] for power in powers)
    found = np.zeros((_ORDER + 1, _ORDER + 1))
    score = (y @ (side * value) @ x.T)[i, j]
    found[i, j] = np.linalg.lstsq(moments[i[:, None] + i, j[:, None] + j], score, rcond=None)[0]
    return y.T @ found @ x


def _sums_of_products(values: FloatArray) -> FloatArray:
    height, width = values.shape
    first = (values[: height - dy, max(-dx, 0) : width - max(dx, 0)] for dy, dx in LAGS)
    second = (values[dy:, max(dx, 0) : width + min(dx, 0)] for dy, dx in LAGS)
    return np.array([np.einsum("ij,ij", a, b) for a, b in zip(first, second, strict=True)])


def _log_likelihoods(seen: Correlations) -> FloatArray:
    """Compute the log-likelihood of each filter in `_filters()`, up to a constant."""
    expected = _filters().correlation
    # Variance of a correlation after a filter (Bartlett 1946), and by uneven light. One basis serves all filters.
    spread = 1 + 2 * (expected**2).sum(1, keepdims=True)
    apart = np.hypot(*np.array(LAGS).T)
    unit = np.sqrt(np.maximum(seen.pairs, 1.0))
    # Uneven light causes correlations with a standard deviation of 0.03, which decrease over 8, 20 or 1000 px.
    light = 0.03 * np.exp(-apart / np.array((8.0, 20.0, 1e3))[:, None]) * unit
    power, axes = np.linalg.eigh(light.T @ light)
    variance = spread + np.maximum(power, 0.0)
    left = ((seen.value - expected) * unit) @ axes
    return -(left**2 / variance + np.log(variance)).sum(1) / 2


def mask_gain(seen: Correlations) -> float:
    """Compute the increase of 2 ln(likelihood) of the noise if an unsharp mask with `AMOUNT` and `RADIUS` is assumed.

    The light is assumed to be even.
    """
    expected = _filters().correlation[1 + len(_WIDTHS) + _MASKS.index((AMOUNT, RADIUS))]
    return float(seen.pairs @ (seen.value**2 - (seen.value - expected) ** 2))


def edge_gain(edge: BareEdge) -> float:
    """Compute the decrease of the chi-square of an edge if an unsharp mask with `AMOUNT` and `RADIUS` is assumed.

    The line spread function of the lens may be any non-negative function.
    """
    weight = 1 / np.hypot(edge.std, LEAST_NOISE)
    given = edge.light * weight
    # The unbounded coefficients are eliminated by projection.
    basis = np.linalg.qr((given / np.maximum(np.linalg.norm(given, axis=1), 1e-300)[:, None]).T)[0]

    def beyond(columns: FloatArray) -> FloatArray:
        return columns - (columns @ basis) @ basis.T

    distance = edge.distance
    # Basis functions lie within 0.8 of the distance of the border.
    positions, widths = _line_bumps(edge.blur, 0.8 * min(float(distance.max()), -float(distance.min())))

    def edges(more: float) -> FloatArray:
        return ndtr((distance - positions[:, None]) / np.sqrt(widths[:, None] ** 2 + edge.spread + more**2))

    lens, wider = edges(0.0), edges(RADIUS)
    wanted = beyond((edge.value * weight)[None])[0]
    left = [nnls(beyond(columns * weight).T, wanted)[1] ** 2 for columns in (lens, lens + AMOUNT * (lens - wider))]
    return float(left[0] - left[1])


def needed_gain(blur: float) -> float:
    """Compute the sum of `mask_gain` and `edge_gain` above which an unsharp mask is reported.

    Two of 1,000 clean edges exceed this threshold. Next to the core of a sharp edge, negative noise can only be fitted
    with the mask. For clean edges with a lens width of 0.3, 0.5 and 0.7 px and a signal-to-noise ratio of 100, the
    decrease of the chi-square of the edge is 7 ± 3, 5 ± 2 and 3 ± 1, respectively.

    Args:
        blur: standard deviation of the line spread function, px.
    """
    # The threshold for wide blurs is 13. It increases below a blur of 0.75 px.
    return 13.0 + 6.5 * max(0.0, 1 / blur - 1 / 0.75)


def effect_on_half(frequency: FloatArray, mtf: FloatArray) -> float:
    """Compute the relative increase of MTF50 by an unsharp mask with `AMOUNT` and `RADIUS`; 0 if MTF50 is undefined.

    Args:
        frequency: frequencies, cycles/px.
        mtf: MTF of the sharpened image, with the shape of `frequency`.
    """
    before = mtf / (1 + AMOUNT * (1 - np.exp(-2 * (np.pi * RADIUS * frequency) ** 2)))
    share = float(first_fall(frequency, mtf) / first_fall(frequency, before)) - 1
    return share if np.isfinite(share) else 0.0


def filter_uncertainty(
    seen: Correlations | None, frequency: FloatArray, mtf: FloatArray, *, sharpened: bool = False
) -> FilterUncertainty:
    """Estimate the uncertainty of an MTF due to linear filters, whose probabilities follow from the noise.

    Args:
        seen: correlations of the noise; None if they are unknown.
        frequency: frequencies (n,), cycles/px.
        mtf: MTF of the image (n,).
        sharpened: whether the edge itself indicates that a filter has increased the MTF. Default: False.

    Returns:
        The uncertainty; its share is 0 if the noise is unknown.
    """
    if seen is None:
        return FilterUncertainty(0.0, 0.0, False)
    log_likelihood, effect = _log_likelihoods(seen), _effects(frequency, mtf)
    probability = _filters().prior * np.exp(log_likelihood - log_likelihood.max())
    if sharpened:
        probability *= effect > 0
    probability /= max(float(probability.sum()), 1e-300)
    likeliest = int(np.argmax(probability[1:])) + 1
    filtered = float(probability[1:].sum())
    # Two standard deviations need not include an improbable value: the share is proportional to the probability of each
    # filter, and not to its square root. Filters without an effect, such as narrow Gaussians, do not change it.
    return FilterUncertainty(float(probability @ np.abs(effect)), filtered, bool(effect[likeliest] < 0))


def _effects(frequency: FloatArray, mtf: FloatArray) -> FloatArray:
    """Compute the relative change of MTF50 due to each filter in `_filters()`; negative for a decrease."""
    transfer = _filters().transfer
    # The transfer function of a filter on the pixel grid has a period of 1 cycle/px.
    at = np.abs((frequency + 0.5) % 1.0 - 0.5) * _GRID
    k = np.minimum(at.astype(int), transfer.shape[1] - 2)
    through = transfer[:, k] + (at - k) * (transfer[:, k + 1] - transfer[:, k])
    after = first_fall(frequency, mtf)
    if not np.isfinite(after):
        return np.zeros(len(transfer))
    before = first_fall(frequency, mtf / np.maximum(through, 0.05))  # no division by a small transfer
    return np.nan_to_num(np.clip(after / before - 1, -_LOST, _LOST), nan=-_LOST)


@cache
def _filters() -> _Filters:
    """Tabulate all filters; the first is the identity."""
    gaussians = [_gaussian(width) for width in _WIDTHS]
    masks = [1 + amount * (1 - _gaussian(radius)) for amount, radius in _MASKS]
    deconvolutions = [
        np.sum([(1 - _gaussian(width)) ** k for k in range(count + 1)], axis=0)
        for width in (0.4, 0.5, 0.6, 0.7, 0.8)
        for count in (1, 2, 3, 4, 5)
    ]
    of_one = [[(k**2, k[0]) for k in family] for family in (gaussians, masks, deconvolutions)]
    families = [*of_one, [*_resampled(), _filled_mosaic()]]
    power, transfer = zip(*itertools.chain(*families), strict=True)
    covariance = np.fft.irfft2(power, (_GRID, _GRID))
    near = covariance[:, *np.transpose(LAGS)] / covariance[:, :1, 0]
    # The prior probability of a filter is 5 %.
    priors = [0.05 / len(families) / len(family) for family in families for _ in family]
    return _Filters(
        np.pad(near, ((1, 0), (0, 0))),
        np.array([np.ones(_GRID // 2 + 1), *transfer]),
        np.array([0.95, *priors]),
    )


def _gaussian(width: float) -> FloatArray:
    """Compute the transfer function of a sampled Gaussian filter on half the frequency grid.

    `width`: standard deviation of the filter, px.
    """
    line = np.exp(-(((np.arange(_GRID) + _GRID // 2) % _GRID - _GRID // 2) ** 2) / (2 * width**2))
    transfer = np.fft.fft(line / line.sum()).real
    return np.outer(transfer, transfer[: _GRID // 2 + 1])


def _resampled() -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the noise power and the transfer function of each resampling kernel.

    Both are averaged over the positions of the new pixels.
    """
    distance = (np.arange(_GRID) - _GRID // 2) + (np.arange(8)[:, None] + 0.5) / 8
    waves, x = np.exp(-2j * np.pi * np.fft.fftfreq(_GRID)[:, None, None] * distance), np.abs(distance)
    # Cubic convolution (Keys 1981).
    cubic = np.select([x < 1, x < 2], [np.polyval([1.5, -2.5, 0, 1], x), np.polyval([-0.5, 2.5, -4, 2], x)])
    # Interpolation of an impulse by a cubic spline (Unser 1999).
    spline = ndimage.map_coordinates(np.eye(1, _GRID)[0], x[None], order=3, mode="mirror")
    for kernel in (np.maximum(1 - x, 0.0), cubic, spline):
        transfers = (waves * kernel).sum(-1)
        power = (np.abs(transfers) ** 2).mean(1)
        yield np.outer(power, power[: _GRID // 2 + 1]), np.abs(transfers.mean(1))[: _GRID // 2 + 1]


def _filled_mosaic() -> tuple[FloatArray, FloatArray]:
    """Compute the noise power and the transfer function of a demosaiced colour.

    Every second pixel is the mean of its four neighbours.
    """
    covariance = np.zeros((_GRID, _GRID))
    covariance[0, 0] = (1 + 1 / 4) / 2
    for step in (1, -1):
        covariance[step, 0] = covariance[0, step] = 1 / 4
        covariance[2 * step, 0] = covariance[0, 2 * step] = 1 / 16 / 2
        covariance[step, 1] = covariance[step, -1] = 2 / 16 / 2
    line = np.cos(2 * np.pi * np.fft.rfftfreq(_GRID))
    return np.fft.rfft2(covariance).real, (1 + (line + 1) / 2) / 2


def _line_bumps(blur: float, outermost: float) -> tuple[FloatArray, FloatArray]:
    """Compute the centres and widths of the basis functions of a line spread function, px.

    The basis functions outside the core are wider.
    """
    # Within 6 blurs, the width is 0.3 blurs, and at least 0.2 px. Outside, it is a fifth of the distance.
    width = max(0.2, 0.3 * blur)
    half = min(max(6.0 * blur, 5.0), outermost)
    core = width * np.arange(int(2 * half / width) + 1)
    core -= core.mean()
    outside = core[-1] * 1.25 ** np.arange(1, 40)
    outside = outside[outside < outermost]
    positions = np.concatenate([-outside[::-1], core, outside])
    apart = np.abs(positions)
    return positions, np.where(apart > 1.1 * core[-1], apart / 5, width)
