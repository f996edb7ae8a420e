"""Standard deviation of the image gain, from the scatter of the Fresnel term between slices that exceeds the noise.

A smooth Fresnel term F is removed: ln F is projected onto polynomials in cos theta_d. The remainders are assumed to be
normally distributed. The covariance of the remainders is the sum of the covariances of the noise and of independent gains. The
variance of the gains is averaged over its posterior, because ten slices determine this variance only to a factor of two. The
most probable variance alone would result in standard deviations that are too small.
"""

from __future__ import annotations

import numpy as np

from matcam.core.remark import Remark

_TERMS = 6
"""Number of powers of cos theta_d that describe ln F up to `_STEEP`. The remainder is below 0.08 % for metals and for
dielectrics with refractive indices from 1.3 to 2.5. With 4 powers it is up to 1.3 %.
"""
_FEWEST = 5
"""Smallest number of remainders for an estimate. The relative standard deviation of a variance from 5 values is
sqrt(2 / 5), about 0.6.
"""
_STEEP = np.radians(70.0)
"""Largest theta_d that is used, rad. F of dielectrics is steeper beyond."""
_CLEAR = 4.0  # smallest 2 ln(likelihood ratio) in favour of a gain: two standard deviations
# standard deviations of the gain, in units of that of the noise, over which the posterior is averaged
_GRID = np.geomspace(0.03, 300.0, 120)


def picture_gain(theta_d: np.ndarray, curves: np.ndarray, covariances: np.ndarray) -> float:
    """Estimate the relative standard deviation of the image gain.

    The result is 0 if the noise explains the scatter of F between slices, or if there are too few slices.

    Args:
        theta_d: theta_d of the slices, rad, (n,).
        curves: F of each channel, with any factor, (channels, n); NaN where F is unknown.
        covariances: covariances of the noise of ln F, (channels, n, n).
    """
    quiet = int((theta_d < _STEEP).sum())
    # the channels of an image have the same gain, so their log likelihoods are averaged instead of added
    found = [
        _likelihood(theta_d[:quiet], curve[:quiet], covariance[:quiet, :quiet])
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
    # weak prior: flat in the variance of the gain below that of the noise, and flat in its logarithm above
    weight = np.exp(log_likelihood[1:] - log_likelihood[1:].max()) * variance / (variance + noise)
    return float(np.sqrt(weight @ variance / weight.sum()))


def strengths_gain(
    theta_d: np.ndarray, strengths: np.ndarray, noise_covariance: np.ndarray, rig_covariance: np.ndarray
) -> float:
    """Estimate the relative standard deviation of the image gain from the strengths of a fit.

    Args:
        theta_d: difference angles of the slices, rad, (slices,).
        strengths: strengths of the fit, no unit, (channels, slices); NaN for slices without values.
        noise_covariance: covariance of the strengths due to pixel noise, (channels, slices, slices).
        rig_covariance: covariance of the strengths due to the rig, (channels, slices, slices).
    """
    divisor = np.where(np.isfinite(strengths), strengths, np.inf)
    covariance = (noise_covariance + rig_covariance) / divisor[:, :, None] / divisor[:, None, :]
    return picture_gain(theta_d, strengths, covariance)


def gain_remarks(gain: float) -> tuple[Remark, ...]:
    if round(gain, 3) == 0:
        return ()
    text = f"F varies between images by {gain:.1%} in addition to its noise; the standard deviation of F includes this gain"
    return (Remark("picture-gain", text),)


def _likelihood(theta_d: np.ndarray, curve: np.ndarray, covariance: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Compute the mean variance of the noise, and the log likelihoods of standard deviations of the gain.

    The first standard deviation is 0. The others are the entries of `_GRID` times the standard deviation of the noise. The
    result is None if there are too few slices.
    """
    good = np.isfinite(curve) & (curve > 0) & np.isfinite(np.diagonal(covariance))
    if good.sum() < _TERMS + _FEWEST:
        return None
    basis = np.linalg.qr(np.vander(np.cos(theta_d[good]), _TERMS), mode="complete")[0]
    rough = basis[:, _TERMS:].T  # orthonormal, and orthogonal to a smooth ln F
    seen, noise = rough @ np.log(curve[good]), rough @ covariance[np.ix_(good, good)] @ rough.T
    own = float(np.diagonal(covariance)[good].mean())
    values = []
    for share in np.append(0.0, _GRID):
        total = noise + own * share**2 * np.eye(len(rough))
        values.append(-(np.linalg.slogdet(total)[1] + seen @ np.linalg.solve(total, seen)) / 2)
    return own, np.array(values)
