"""Residuals of images that exceed the noise: their size relative to the light, and their correlation between pixels.

A wrong lobe, dirt or a second reflection causes residuals of one sign over many pixels. If such pixels were treated as
independent, they would bias well determined quantities, and the estimated errors would be too small.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import pdist

from matcam.reconstruction.joint.joint_problem import JointProblem

_CUT = 3.0
_NORMAL = 0.9733
"""Mean of the square of a normal variable, truncated at the square of `_CUT`."""
_BRIGHT = 10.0
_FEWEST = 50
_LOOKED_AT = 12
"""Number of images in which the correlation is estimated."""
_LEAST = 0.05
"""Smallest unexplained share of the variance of residuals by which correlations are divided, no unit."""


class UnexplainedLight(NamedTuple):
    """Unexplained share of the light, and its correlation between pixels.

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


def unexplained_share(problem: JointProblem, p: np.ndarray) -> float:
    """Compute the unexplained share of the light at given parameters.

    It is estimated from squared residuals truncated at `_CUT` standard deviations, so that dust on few pixels has no
    effect.

    Args:
        problem: problem of the fit.
        p: parameters, (size,).
    """
    return _share(_bright_pixels(problem, p))


def unexplained_by(problem: JointProblem, p: np.ndarray) -> UnexplainedLight:
    """Compute the unexplained share and the correlation between neighbouring pixels; see `unexplained_share`."""
    bright = _bright_pixels(problem, p)
    share = _share(bright)
    if share == 0:
        return UnexplainedLight(share)
    some = np.unique(np.linspace(0, len(bright) - 1, min(_LOOKED_AT, len(bright))).round().astype(int))
    return UnexplainedLight(share, _correlated_pixels([bright[k] for k in some], share))


def unexplained_in(problem: JointProblem, p: np.ndarray, k: int) -> float:
    """Compute the unexplained share of the light of one image.

    Args:
        problem: problem of the fit.
        p: parameters, (size,).
        k: index of the image.
    """
    return _share([_Bright.of(problem, p, k)])


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
        bright = value > _BRIGHT * std
        return cls(value[bright], residual[bright], std[bright], pixels.positions[:, lit[bright]])


def _bright_pixels(problem: JointProblem, p: np.ndarray) -> list[_Bright]:
    return [_Bright.of(problem, p, k) for k in range(problem.layout.pictures)]


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
    """Compute the number of correlated pixels: the sum of correlations up to their first zero (Bartlett 1935)."""
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
    return 1 + shared / max(unexplained / count, _LEAST)
