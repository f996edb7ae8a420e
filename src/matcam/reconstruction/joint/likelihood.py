"""Likelihood of pixels whose residuals exceed the noise and are correlated.

A wrong lobe, dirt or a second reflection causes residuals of one sign over many pixels. If such pixels were treated as
independent, they would bias well determined quantities, and the estimated errors would be too small. The excess of the
residuals is estimated as a share of the light, and its correlation as a number of pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import pdist
from scipy.special import log_ndtr

from matcam.core.arrays import evenly
from matcam.reconstruction.joint.joint_problem import JointProblem
from matcam.reconstruction.observed_pixels import ObservedPixels

_CLIPPED_OUT = 30.0  # standard deviations above which a clipped pixel has no effect
_HUBER = 4.0
_CUT = 3.0
_NORMAL = 0.9733
"""Mean of the square of a normal variable, truncated at the square of `_CUT`."""
_FEWEST = 50


class Likelihood(NamedTuple):
    """Likelihood of pixels, with additional noise that is proportional to the model.

    Attributes:
        share: standard deviation of the additional noise that explains the residuals of bright pixels, as a share of the
            model.
        correlated: number of pixels whose unexplained residuals are treated as fully correlated. Default: 1, uncorrelated.
    """

    share: float
    correlated: float = 1.0

    @property
    def noise(self) -> float:
        """Independent noise of each pixel that has the same effect as the correlated residuals, as a share of the model."""
        return float(self.share * np.sqrt(self.correlated))

    def residual(
        self,
        pixels: ObservedPixels,
        value: np.ndarray,
        level: np.ndarray | None = None,
        exponent: np.ndarray | float = 1.0,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute standardised residuals, their derivatives with respect to the model, and robust weights, (pixels,).

        The residual of a clipped pixel is -sqrt(-2 ln p), where p is the probability of clipping.

        Args:
            pixels: observed pixels.
            value: model of the pixels, (pixels,).
            level: expected values from which the noise follows, (pixels,). Default: None, `value`.
            exponent: exponent of the likelihood of each pixel, no unit, (pixels,). Default: 1.
        """
        std = self.std(pixels, value if level is None else level) / np.sqrt(exponent)
        z = (value - pixels.values) / std
        by_value = 1 / std
        bound = np.clip(z, -_CLIPPED_OUT, _CLIPPED_OUT)
        chance = log_ndtr(bound)
        root = np.sqrt(np.maximum(-2 * chance, 1e-300))
        hazard = np.exp(-0.5 * bound**2 - chance) / np.sqrt(2 * np.pi)
        residual = np.where(pixels.clipped, -root, z)
        slope = np.where(pixels.clipped, hazard / np.maximum(root, 1e-12), 1.0) * by_value
        slope = np.where(pixels.clipped & (np.abs(z) > _CLIPPED_OUT), 0.0, slope)
        weight = np.where(np.abs(residual) > _HUBER, _HUBER / np.maximum(np.abs(residual), _HUBER), 1.0)
        used = pixels.used
        return np.where(used, residual, 0.0), np.where(used, slope, 0.0), np.where(used, weight, 0.0)

    def std(self, pixels: ObservedPixels, level: np.ndarray) -> np.ndarray:
        """Compute the standard deviation of pixels with the expected values `level`, (pixels,)."""
        return np.hypot(pixels.noise_at(level), self.noise * np.abs(level))

    def cost(
        self,
        pixels: ObservedPixels,
        value: np.ndarray,
        level: np.ndarray | None = None,
        exponent: np.ndarray | float = 1.0,
    ) -> float:
        """Compute Huber's cost of an image. The arguments are those of `residual`."""
        residual, _, _ = self.residual(pixels, value, level, exponent)
        size = np.abs(residual)
        return float(np.where(size > _HUBER, 2 * _HUBER * size - _HUBER**2, size**2).sum())

    def log_density(self, pixels: ObservedPixels, value: np.ndarray, exponent: np.ndarray) -> float:
        """Compute the sum of the logarithms of the likelihoods of pixels, up to a constant.

        Squared residuals are truncated at `_CUT` standard deviations, as for the unexplained share, so that dust on few pixels
        has little effect.

        Args:
            pixels: observed pixels.
            value: model of the pixels, (pixels,).
            exponent: exponent of the likelihood of each pixel, no unit, (pixels,).
        """
        residual, _, _ = self.residual(pixels, value)
        measured = pixels.used & ~pixels.clipped
        logs = np.where(measured, np.log(self.std(pixels, value)), 0.0) + 0.5 * np.minimum(residual**2, _CUT**2)
        return -float(exponent @ logs)


def unexplained_share(problem: JointProblem, p: np.ndarray, pictures: Sequence[int] | None = None) -> float:
    """Compute the unexplained share of the light at given parameters.

    The share is estimated from the squared residuals of bright pixels. Residuals above `_CUT` standard deviations are
    truncated, so that dust on few pixels has little effect. The share is 0 if there are fewer than `_FEWEST` bright pixels.

    Args:
        problem: problem of the fit.
        p: parameters, (size,).
        pictures: indices of the images. Default: None, all.
    """
    chosen = range(problem.layout.pictures) if pictures is None else pictures
    return _share([_Bright.of(problem, p, k) for k in chosen])


def likelihood_at(problem: JointProblem, p: np.ndarray) -> Likelihood:
    bright = [_Bright.of(problem, p, k) for k in range(problem.layout.pictures)]
    share = _share(bright)
    if share == 0:
        return Likelihood(share)
    # number of images in which the correlation is estimated
    return Likelihood(share, _correlated_pixels([bright[k] for k in evenly(len(bright), 12)], share))


class _Bright(NamedTuple):
    value: np.ndarray
    residual: np.ndarray
    std: np.ndarray
    positions: np.ndarray

    @classmethod
    def of(cls, problem: JointProblem, p: np.ndarray, k: int) -> _Bright:
        fit, pixels = problem.picture(p, k, slopes=False), problem.pixels[k]
        lit = np.flatnonzero(pixels.used & ~pixels.clipped & (fit.value > pixels.std))
        value, residual = fit.value[lit], (pixels.values - fit.value)[lit]
        std = pixels.noise_at(fit.value)[lit]
        bright = value > 10.0 * std
        return cls(value[bright], residual[bright], std[bright], pixels.positions[:, lit[bright]])


def _share(pictures: list[_Bright]) -> float:
    value, residual, std, *_ = (np.concatenate(column, axis=-1) for column in zip(*pictures, strict=True))
    if value.size < _FEWEST:
        return 0.0

    def excess(share: float) -> float:
        u2 = residual**2 / (std**2 + (share * value) ** 2)
        return float(np.mean(np.minimum(u2, _CUT**2)) / _NORMAL - 1)

    if excess(0.0) <= 0:
        return 0.0
    low, high = 1e-5, 1.0
    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return float(high)


def _correlated_pixels(pictures: list[_Bright], share: float) -> float:
    """Compute the number of pixels whose unexplained residuals are treated as fully correlated.

    The number follows from the sum of the correlations up to their first zero (Bartlett 1935).
    """
    together = np.zeros(1)
    total, count, unexplained = 0.0, 0, 0.0
    for one in pictures:
        if one.value.size < _FEWEST:
            continue
        variance = one.std**2 + (share * one.value) ** 2
        z = np.clip(one.residual / np.sqrt(variance), -_CUT, _CUT)
        apart = np.rint(pdist(one.positions.T)).astype(int)
        first, second = np.triu_indices(z.size, 1)
        at = np.bincount(apart, z[first] * z[second])
        if at.size > together.size:
            together = np.pad(together, (0, at.size - together.size))
        together[: at.size] += at
        total += float(z @ z)
        unexplained += float(np.sum((share * one.value) ** 2 / variance))
        count += z.size
    if total <= 0:
        return 1.0
    together[1] += together[0]  # pixels at one position in several colours
    ends = np.flatnonzero(together[1:] <= 0)
    shared = 2 * float(together[1 : 1 + (ends[0] if ends.size else together.size)].sum()) / total
    # smallest unexplained share of the variance of residuals by which correlations are divided, no unit
    return 1 + shared / max(unexplained / count, 0.05)
