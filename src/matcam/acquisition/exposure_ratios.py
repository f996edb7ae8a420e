"""Exposure ratios, clip level, photon transfer and linearity from brackets: images of one scene in several exposures.

The expected light of a pixel in exposure k is e_k f, where f is the flux of the pixel and e_k the relative exposure. A
group contains pixels of one lamp position, one brightness and one set of exposures that do not clip them. The sum of the
light of a group is also proportional to e_k. With the measured sums d_k and weights w, the quasi-likelihood equations
sum w (d_k - e_k f) = 0 are linear in the data. Unlike in a regression, noise in f therefore causes no bias.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from matcam.acquisition.bracket_sample import BracketSample
from matcam.acquisition.light.mislabelled_frames import light_ratios
from matcam.files.capture_settings import Stated
from matcam.numerics.normal import robust_std

_SAFE = 0.85
"""Share of the clip level below which the prediction from shorter exposures makes a pixel usable."""
UNKNOWN_GAIN = Stated(float("nan"), float("inf"))
"""Gain that the frames do not determine, DN per electron."""


class ClipLevel(NamedTuple):
    """Code at which pixels clip.

    Attributes:
        level: code of clipped pixels as read, DN.
        std: standard deviation of the level, DN; NaN if no clipping was found.
        spread: standard deviation of the codes of clipped pixels, DN.
        pixels: number of clipped pixels; 0: no clipping was found, and `level` is the largest code.
    """

    level: float
    std: float
    spread: float
    pixels: int

    @property
    def threshold(self) -> float:
        """Smallest code of a pixel that is treated as clipped, DN."""
        if not self.pixels:
            return self.level + 1.0
        return self.level - max(6 * self.spread, 0.002 * abs(self.level), 0.5)


class ExposureRatios(NamedTuple):
    """Ratios of k exposures from brackets.

    Attributes:
        value: each exposure relative to the shortest, (k,).
        covariance: covariance of the logarithms of `value`, (k, k); 0 for the shortest exposure. If `linked` is False, the
            diagonal is infinite for all other exposures.
        misfit: scatter relative to noise, chi2 per degree of freedom; NaN without degrees of freedom.
        curve: n rows, one for each range of codes, (n, 3): code above dark relative to the largest code, relative departure
            from linearity, and standard deviation of the departure.
        linked: True if pixels that are usable in several exposures link all exposures.
    """

    value: np.ndarray
    covariance: np.ndarray
    misfit: float
    curve: np.ndarray
    linked: bool

    def std(self, reference: int = 0) -> np.ndarray:
        """Compute the relative standard deviation of the ratio of each exposure to the exposure `reference`, (k,).

        `reference` is an index. The standard deviation is infinite if the ratio is not determined.
        """
        own = np.diag(self.covariance)
        with np.errstate(invalid="ignore"):
            variance = own + own[reference] - 2 * self.covariance[reference]
        variance = np.where(np.isnan(variance), np.inf, np.maximum(variance, 0))
        variance[reference] = 0.0
        return np.sqrt(variance)


def first_guess(samples: Sequence[BracketSample], nominal: np.ndarray, top: float, noise: float) -> np.ndarray:
    """Estimate the relative exposures from the median ratios of the light in neighbouring exposures.

    The nominal ratio is used if two neighbouring exposures have no common well-exposed pixels. A ratio that is unknown or
    not above 1 is replaced by 2.

    Args:
        samples: samples of all lamp positions.
        nominal: nominal times of the exposures, s (count,); NaN: unknown.
        top: largest code above dark, DN.
        noise: read noise, DN.
    """
    *measured, stated = np.diagonal(light_ratios(samples, nominal, top, noise), 1, axis1=1, axis2=2)
    steps = []
    for ratios, other in zip(np.transpose(measured), stated, strict=True):
        known = ratios[np.isfinite(ratios)]
        step = float(np.median(known)) if known.size else other
        steps.append(step if step > 0 else np.log(2.0))
    return np.exp(np.cumsum([0.0, *steps]))


def measure_clip_level(samples: Sequence[BracketSample], guess: np.ndarray, largest: float) -> ClipLevel:
    """Measure the code of pixels that must be clipped according to a shorter exposure.

    Args:
        samples: samples of all lamp positions.
        guess: relative exposures.
        largest: largest code of all frames, DN.
    """
    codes = []
    for sample in samples:
        for i in range(1, len(sample.exposures)):
            step = guess[sample.exposures[i]] / guess[sample.exposures[i - 1]]
            must = step * sample.light[i - 1] > 1.6 * largest
            codes.append(sample.codes[i][must])
    found = np.concatenate(codes) if codes else np.zeros(0)
    if found.size < 3:
        return ClipLevel(largest, float("nan"), 0.0, 0)
    level = float(np.median(found))
    spread = robust_std(found - level)
    # rounding leaves the median within half a code
    return ClipLevel(level, float(np.hypot(1.25 * spread / np.sqrt(found.size), 0.29)), spread, int(found.size))


def usable(sample: BracketSample, exposures: np.ndarray, clip: ClipLevel, noise: float) -> np.ndarray:
    """Compute the mask of the usable pixels of a sample, (k, n).

    A pixel is not usable if its code reaches the clip threshold. If clipping was found, it is also not usable where its
    neighbours or shorter exposures predict a code near the clip level.
    """
    relative = exposures[sample.exposures]
    below = sample.codes < clip.threshold
    if not below.size:  # no pixel is lit
        return below
    height = max(clip.level - float(np.median(sample.codes[0] - sample.light[0])), 1.0)
    fits = np.ones_like(below)
    total, weight = np.zeros(sample.light.shape[1]), 0.0
    for k in range(1, len(relative)):
        total, weight = total + sample.light[k - 1] * fits[k - 1], weight + relative[k - 1] * fits[k - 1]
        predicted = np.maximum(total / np.maximum(weight, 1e-300), 0) + 2 * noise / relative[k - 1]
        # the neighbours are used if the light is below the noise of a shorter exposure
        fits[k] = fits[k - 1] & (relative[k] * predicted < _SAFE * height) & (sample.around[k] < _SAFE * height)
    return below & (fits if clip.pixels else True)


def fit_ratios(
    samples: Sequence[BracketSample], guess: np.ndarray, clip: ClipLevel, noise: float, gain: float
) -> ExposureRatios:
    """Fit exposure ratios to all brackets together.

    Args:
        samples: samples of all lamp positions.
        guess: initial relative exposures.
        clip: the clip level.
        noise: read noise, DN.
        gain: DN per electron.
    """
    if len(guess) < 2:
        return ExposureRatios(np.ones(len(guess)), np.zeros((len(guess),) * 2), float("nan"), np.zeros((0, 3)), True)
    exposures = guess.copy()
    for _ in range(3):
        sums, counts = _groups(samples, exposures, clip, noise)
        exposures, flux = _solve(sums, counts, exposures, noise, gain)
    used = counts > 0
    mean = exposures * flux[:, None]
    weight = np.where(used, mean / np.maximum(mean + noise**2 / gain, 1e-12), 0)
    information = counts * mean * weight / gain
    total = information.sum(1)
    good = total > 0
    matrix = np.diag(information.sum(0)) - (information[good] / total[good, None]).T @ information[good]
    linked = bool(
        np.linalg.matrix_rank(matrix[1:, 1:] + 0.0, tol=1e-6 * max(matrix.max(), 1e-300)) == len(exposures) - 1
    )
    variance = counts * (gain * np.maximum(mean, 0) + noise**2)
    chi = np.where(used & (variance > 0), (sums - counts * mean) ** 2 / np.where(variance > 0, variance, 1), 0)
    degrees = int(used.sum() - len(flux) - len(exposures) + 1)
    misfit = float(chi.sum() / degrees) if degrees > 0 else float("nan")
    covariance = np.diag(np.r_[0.0, np.full(len(exposures) - 1, np.inf)])
    if linked and len(exposures) > 1:
        covariance[1:, 1:] = np.linalg.inv(matrix[1:, 1:]) * max(1.0, misfit if degrees > 0 else 1.0)
    return ExposureRatios(exposures / exposures[0], covariance, misfit, _curve(sums, counts, mean, variance), linked)


def fit_gain(samples: Sequence[BracketSample], ratios: np.ndarray, clip: ClipLevel, noise: float) -> Stated:
    """Fit the gain, DN per electron, and its standard deviation, from differences between exposures of one scene.

    Let d_a and d_b be the light of a pixel in exposures a and b, and r the ratio of a to b. K is the gain, and m is the mean
    of d_a. The difference d_a - r d_b has the variance K m (1 + r) + read noise^2 (1 + r^2). K is fitted to this variance, so
    pairs of equal frames are not required. The variance is estimated robustly in bins of brightness. The result is
    `UNKNOWN_GAIN` if too few pixels are usable.
    """
    rows = []
    for sample in samples:
        use = usable(sample, ratios, clip, noise)
        for b in range(1, len(sample.exposures)):
            a = b - 1
            share = ratios[sample.exposures[a]] / ratios[sample.exposures[b]]
            both = use[a] & use[b]
            if both.sum() < 20:
                continue
            difference = sample.light[a][both] - share * sample.light[b][both]
            brightness = share * sample.around[b][both]
            own = share * sample.light[b][both]  # b is the longer exposure, so its relative noise is small
            good = (brightness > 0) & (np.abs(own - brightness) < 0.2 * np.maximum(brightness, 20 * noise))
            rows.append(np.stack([difference[good], own[good], brightness[good], np.full(good.sum(), share)]))
    if not rows:
        return UNKNOWN_GAIN
    difference, mean, brightness, share = np.concatenate(rows, axis=1)
    inside = (brightness > 3 * noise) & (mean > 0)
    difference, mean, brightness, share = difference[inside], mean[inside], brightness[inside], share[inside]
    if difference.size < 200:
        return UNKNOWN_GAIN
    slope, extra, size = [], [], []
    # the neighbours determine the bin, because bins of the pixel's own light would truncate its noise
    for part in _brightness_bins(brightness):
        scaled = difference[part] / np.sqrt((1 + share[part]) * mean[part])
        extra.append(float(np.mean(noise**2 * (1 + share[part] ** 2) / ((1 + share[part]) * mean[part]))))
        middle = np.median(scaled)
        width = 6 * robust_std(scaled - middle)
        kept = scaled[np.abs(scaled - middle) <= max(width, 1e-12)]
        slope.append(float(kept.var(ddof=1)) - extra[-1])
        size.append(kept.size)
    if not slope:
        return UNKNOWN_GAIN
    # the expected scatter determines the weights, because the measured scatter would favour bins that are low by chance
    value = float(np.median(slope))
    for _ in range(4):
        error = (max(value, 1e-9) + np.asarray(extra)) * np.sqrt(2 / np.asarray(size))
        value = float(np.sum(slope / error**2) / np.sum(1 / error**2))
    scatter = float(np.sum(((np.asarray(slope) - value) / error) ** 2) / max(len(slope) - 1, 1))
    return Stated(value, float(np.sqrt(max(scatter, 1.0) / np.sum(1 / error**2))))


def fit_gain_of_single(samples: Sequence[BracketSample], clip: ClipLevel, noise: float) -> Stated:
    """Estimate an upper bound of the gain, DN per electron, from differences between neighbouring pixels.

    The longest exposure of each lamp position is used. Texture and gradients increase the variance of the differences. The
    bound is therefore the lower quartile of the ratio of variance to mean among bins of brightness. The standard deviation
    of the bound is assumed to be 50 %. The result is `UNKNOWN_GAIN` if too few pixels are usable.
    """
    light = np.concatenate([sample.light[-1] for sample in samples])
    around = np.concatenate([sample.around[-1] for sample in samples])
    codes = np.concatenate([sample.codes[-1] for sample in samples])
    good = (around > 10 * noise) & (codes < clip.threshold)
    if good.sum() < 300:
        return UNKNOWN_GAIN
    light, around = light[good], around[good]
    found = []
    for part in _brightness_bins(around):
        spread = robust_std((light - around)[part])
        # the mean of eight neighbours adds an eighth of the variance
        found.append((spread**2 / 1.125 - noise**2) / float(around[part].mean()))
    value = float(np.quantile(found, 0.25)) if found else float("nan")
    return Stated(value, 0.5 * value) if value > 0 else UNKNOWN_GAIN


def _brightness_bins(brightness: np.ndarray) -> Iterator[np.ndarray]:
    cuts = np.unique(np.quantile(brightness, np.linspace(0, 1, 25)))
    position = np.clip(np.searchsorted(cuts, brightness, side="right") - 1, 0, len(cuts) - 2)
    for one in range(len(cuts) - 1):
        part = position == one
        if part.sum() >= 30:
            yield part


def _groups(
    samples: Sequence[BracketSample], exposures: np.ndarray, clip: ClipLevel, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the sum of light, DN, and the number of pixels of each group in each exposure, (groups, exposures) each.

    Both are 0 for exposures that the group does not use. Groups that use only one exposure are omitted.
    """
    sums, counts = [], []
    for sample in samples:
        use = usable(sample, exposures, clip, noise)
        relative = exposures[sample.exposures]
        usual = np.where(use, sample.around, 0).sum(0) / np.maximum((use * relative[:, None]).sum(0), 1e-300)
        bright = np.clip(np.floor(3 * np.log2(np.maximum(usual * relative[-1], 1e-3))), -20, 100).astype(int) + 20
        key = bright * (1 << len(relative)) + (use * (1 << np.arange(len(relative)))[:, None]).sum(0)
        names, position = np.unique(key, return_inverse=True)
        one_sum, one_count = np.zeros((len(names), len(exposures))), np.zeros((len(names), len(exposures)))
        for i, k in enumerate(sample.exposures):
            one_sum[:, k] = np.bincount(position, np.where(use[i], sample.light[i], 0), len(names))
            one_count[:, k] = np.bincount(position, use[i], len(names))
        sums.append(one_sum)
        counts.append(one_count)
        reference = sample.reference_total
        good = np.isfinite(reference)
        if good.sum() > 1:
            one_sum, one_count = np.zeros((1, len(exposures))), np.zeros((1, len(exposures)))
            one_sum[0, sample.exposures[good]] = reference[good]
            one_count[0, sample.exposures[good]] = sample.reference_pixels.sum()
            sums.append(one_sum)
            counts.append(one_count)
    all_sums, all_counts = np.concatenate(sums), np.concatenate(counts)
    shared = (all_counts > 0).sum(1) > 1
    return all_sums[shared], all_counts[shared]


def _solve(
    sums: np.ndarray, counts: np.ndarray, exposures: np.ndarray, noise: float, gain: float
) -> tuple[np.ndarray, np.ndarray]:
    """Solve the quasi-likelihood equations for the relative exposures and the flux of each group.

    The flux is the light per pixel at a relative exposure of 1, DN.
    """
    used = counts > 0
    exposures = exposures.copy()
    flux = sums.sum(1) / np.maximum((counts * exposures).sum(1), 1e-300)
    for _ in range(400):
        mean = np.maximum(exposures * flux[:, None], 0)
        weight = np.where(used, mean / np.maximum(mean + noise**2 / gain, 1e-12) + 1e-9, 0)
        flux = (weight * sums).sum(1) / np.maximum((weight * counts * exposures).sum(1), 1e-300)
        known = np.maximum((weight * counts * flux[:, None]).sum(0), 1e-300)
        new = np.where(used.any(0), (weight * sums).sum(0) / known, exposures)
        new = np.where(new > 0, new / new[0], exposures)
        done = np.abs(np.log(new / exposures)).max() < 1e-9
        exposures = new
        if done:
            break
    return exposures, flux


def _curve(sums: np.ndarray, counts: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Compute the rows of `ExposureRatios.curve`, one for each half octave of the code."""
    used = counts > 0
    code, residual, var, size = mean[used], (sums - counts * mean)[used], variance[used], (counts * mean)[used]
    if not code.size:
        return np.zeros((0, 3))
    position = np.floor(2 * np.log2(np.maximum(code, 1e-3) / code.max())).astype(int)
    rows = []
    for one in np.unique(position):
        part = position == one
        total = size[part].sum()
        if total > 0:
            rows.append(
                (code[part].mean() / code.max(), residual[part].sum() / total, np.sqrt(var[part].sum()) / total)
            )
    return np.array(rows).reshape(-1, 3)
