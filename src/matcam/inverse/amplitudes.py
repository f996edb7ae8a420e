"""What a fit of a lobe's shape leaves to linear algebra and statistics: strengths, backgrounds, weights and noise.

Model of a cell's value in channel c and slice s:  A_cs m_s(cell) + B_c, with m from `LobeModel`, A the lobe's true peak
value and B the Lambertian part. Noise lives in pixels: a pixel's variance is the model's,

    V = relative^2 (A m)^2 + floor^2 (A max m)^2,

never the data's, and a cell's weight is its pixel content over it (MODEL 8).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from matcam.camera.noise import PixelNoise
from matcam.inverse.peak_cells import PeakData

START_NOISE = PixelNoise(0.02, 0.005)
"""Assumed while nothing better is known."""

# A pixel's noise relative to its own value is never large in usable data. What exceeds it is misfit, and is better
# described as a share of the peak: then the faint surroundings of an unexpected lobe do not govern its fit.
_NOISE_BOUNDS = ((np.log(1e-4), np.log(0.05)), (np.log(1e-6), np.log(0.5)))


class Amplitudes(NamedTuple):
    """Best strengths for a given shape. Shapes: channels c, slices s, cells n."""

    amplitude: np.ndarray
    """(c, s, 1): A; NaN where the slice shows no lobe."""
    background: np.ndarray
    """(c,): B."""
    residual: np.ndarray
    """(c, s, n): data less model; 0 where there are no data."""


def solve(data: PeakData, record: np.ndarray, weights: np.ndarray) -> Amplitudes:
    """Weighted least squares for A and B."""
    wm = weights * record
    smm, sm1, s11 = (wm * record).sum(-1), wm.sum(-1), weights.sum(-1)
    sdm, sd1 = (wm * data.values).sum(-1), (weights * data.values).sum(-1)
    over = np.where(smm > 0, smm, 1.0)
    free = (s11 - sm1**2 / over).sum(-1)
    background = (sd1 - sdm * sm1 / over).sum(-1) / np.where(free > 0, free, 1.0)
    amplitude = np.where(smm > 0, (sdm - background[:, None] * sm1) / over, 0.0)[..., None]
    residual = np.where(weights > 0, data.values - amplitude * record - background[:, None, None], 0.0)
    return Amplitudes(np.where(amplitude > 0, amplitude, np.nan), background, residual)


def first_weights(data: PeakData) -> np.ndarray:
    """Weights before anything is known: each slice in units of its own peak, faint cells held back by a floor."""
    peak = data.values[..., :4].mean(-1, keepdims=True)
    usable = (peak > 0) & (data.content[..., :4].min(-1, keepdims=True) > 0)
    variance = (START_NOISE.relative * data.values) ** 2 + (4 * START_NOISE.floor * peak) ** 2
    return np.where(usable, data.content / np.where(usable, variance, 1.0), 0.0)


def weights_of(data: PeakData, record: np.ndarray, fitted: Amplitudes, noise: PixelNoise) -> np.ndarray:
    """Pixel content over the model's variance; 0 in slices where no lobe was found."""
    return np.nan_to_num(data.content / (fitted.amplitude**2 * relative_variance(record, noise)))


def relative_variance(record: np.ndarray, noise: PixelNoise) -> np.ndarray:
    """Variance of a pixel in units of the true peak squared, (s, n)."""
    return (noise.relative * record) ** 2 + (noise.floor * record.max(-1, keepdims=True)) ** 2


def share_of_pixel_variance(data: PeakData) -> np.ndarray:
    """A cell is the mean of two pixels, unless both ways fall into one: (s, n)."""
    return np.where(data.pixels.first == data.pixels.second, 1.0, 0.5)


def estimate_noise(data: PeakData, record: np.ndarray, fitted: Amplitudes) -> PixelNoise:
    """Relative noise and floor from the residuals, by maximum likelihood; each cell counts with its pixel content."""
    squared = (fitted.residual / fitted.amplitude) ** 2
    content = np.where(np.isfinite(squared), data.content, 0.0)
    squared = np.nan_to_num(squared)
    pixel_share = share_of_pixel_variance(data)

    def objective(logs: np.ndarray) -> float:
        variance = relative_variance(record, PixelNoise(*np.exp(logs)))
        # each slice's own amplitude has taken up part of its noise: the leverage of one pixel
        information = record**2 / variance
        taken = np.clip(information / np.maximum((content * information).sum(-1, keepdims=True), 1e-300), 0, 0.9)
        expected = variance * pixel_share
        return float((content * (np.log(expected) + squared / (expected * (1 - taken)))).sum() / content.sum())

    start = np.log([START_NOISE.relative, START_NOISE.floor])
    best = minimize(objective, start, method="L-BFGS-B", bounds=_NOISE_BOUNDS)
    return PixelNoise(*np.exp(best.x).tolist())


def log_likelihood(data: PeakData, record: np.ndarray, fitted: Amplitudes, noise: PixelNoise) -> float:
    """Gaussian log-likelihood of the values, up to a constant; each cell counts with its pixel content."""
    variance = fitted.amplitude**2 * relative_variance(record, noise) * share_of_pixel_variance(data)
    used = (data.content > 0) & np.isfinite(variance)
    variance = np.where(used, variance, 1.0)
    return -0.5 * float((np.where(used, data.content, 0.0) * (np.log(variance) + fitted.residual**2 / variance)).sum())
