"""The gain of each picture: by how much the Fresnel term is rougher, from slice to slice, than its noise.

Fourth differences over neighbouring slices take a smooth F away. What is left is normal; its covariance is that of the noise
and of gains that are independent. The gains' variance is averaged over its posterior: ten slices know it to a factor of two,
and errors by the likeliest variance alone would be too small (of 30 tables they held 56 % where 68 % are meant).
"""

from __future__ import annotations

import numpy as np

from matcam.core.remark import Remark

_FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
_STEEP = np.radians(70.0)  # theta_d up to which F is smooth enough for its roughness to be the pictures'
_CLEAR = 4.0  # 2 ln likelihood that a gain must bring to be believed
_GRID = np.geomspace(0.03, 300.0, 120)  # standard deviations that are weighed, in units of the noise's


def picture_gain(theta_d: np.ndarray, curves: np.ndarray, covariances: np.ndarray) -> float:
    """Return the standard deviation of a picture's gain, relative; 0 where no more than noise is seen.

    Args:
        theta_d: of the slices (n,), rad, evenly apart.
        curves: F of the channels (channels, n), on any scale; NaN where it is not known.
        covariances: of the noise of ln F (channels, n, n).
    """
    quiet = int((theta_d < _STEEP).sum())
    # a picture's gain is that of all its channels, which do not count as several
    found = [
        _likelihood(curve[:quiet], covariance[:quiet, :quiet])
        for curve, covariance in zip(curves, covariances, strict=True)
    ]
    known = [one for one in found if one is not None]
    if not known:
        return 0.0
    noise = float(np.mean([own for own, _ in known]))
    log_likelihood = np.mean([values for _, values in known], axis=0)
    if 2 * (log_likelihood[1:].max() - log_likelihood[0]) < _CLEAR:
        return 0.0
    variance = noise * _GRID**2
    # as good as no prior: flat in the variance below the noise's, in its logarithm above
    weight = np.exp(log_likelihood[1:] - log_likelihood[1:].max()) * variance / (variance + noise)
    return float(np.sqrt(weight @ variance / weight.sum()))


def strengths_gain(
    theta_d: np.ndarray, strengths: np.ndarray, noise_covariance: np.ndarray, rig_covariance: np.ndarray
) -> float:
    """Return the same of a fit's strengths, (channels, slices), whose covariances are (channels, slices, slices)."""
    divisor = np.where(np.isfinite(strengths), strengths, np.inf)
    covariance = (noise_covariance + rig_covariance) / divisor[:, :, None] / divisor[:, None, :]
    return picture_gain(theta_d, strengths, covariance)


def gain_remarks(gain: float) -> tuple[Remark, ...]:
    """Say that there is a gain, where there is."""
    if not gain:
        return ()
    text = (
        f"F scatters from picture to picture by {gain:.1%}: a gain of each picture, which its standard deviation holds"
    )
    return (Remark("picture-gain", text),)


def _likelihood(curve: np.ndarray, covariance: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Return the noise's mean variance, and ln likelihood without a gain and with each of `_GRID`; None for too few slices."""
    good = np.isfinite(curve) & (curve > 0) & np.isfinite(np.diagonal(covariance))
    size = len(_FOURTH)
    starts = [first for first in range(curve.size - size + 1) if good[first : first + size].all()]
    if len(starts) < size:
        return None
    differences = np.zeros((len(starts), curve.size))
    for row, first in zip(differences, starts, strict=True):
        row[first : first + size] = _FOURTH
    seen = differences @ np.log(np.where(good, curve, 1.0))
    noise = differences @ np.where(good[:, None] & good, covariance, 0.0) @ differences.T
    gain = differences @ differences.T
    own = float(np.diagonal(covariance)[good].mean())
    values = []
    for share in np.append(0.0, _GRID):
        total = noise + own * share**2 * gain
        values.append(-(np.linalg.slogdet(total)[1] + seen @ np.linalg.solve(total, seen)) / 2)
    return own, np.array(values)
