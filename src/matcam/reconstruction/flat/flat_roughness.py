"""Common roughness of all texels of a flat sample, and gain of each image, from coarse frequencies of the texture.

The gain of an image is its relative irradiance. An image is a linear combination of the diffuse and the specular map, with
weights that depend on roughness and gain. Roughness and gains minimise the residual of these combinations. At every
frequency, the residual is that of the best pair of maps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from matcam.core.jax import jnp
from matcam.core.registry import family_ndf
from matcam.core.shading import shading, vector
from matcam.material.masking import Masking
from matcam.material.microfacet import Microfacet
from matcam.reconstruction.flat.flat_stack import FlatStack

_WIDTHS = np.geomspace(0.01, 0.9, 46)


class FlatRoughness(NamedTuple):
    """Parameters that are common to all texels.

    Attributes:
        log_alpha: ln of the roughness of the lobe.
        gains: ln of the gain of each image, (pictures,).
        covariance: covariance of log_alpha and gains, (1 + pictures, 1 + pictures).
        weights: gain times the radiance of the diffuse and of the specular part in each image if both maps are 1,
            (pictures, 2).
        mean: mean of the diffuse and of the specular map, in the unit of the images, (2,).
        mean_noise: covariance of the means if roughness and gains are exact, (2, 2).
        mean_slope: derivatives of the means with respect to log_alpha and gains, (2, 1 + pictures).
        misfit: mean squared residual, relative to the variance of the noise.
        stated: prior information matrix of log_alpha and gains, same shape as `covariance`.
        freedom: number of degrees of freedom of the residual.
    """

    log_alpha: float
    gains: np.ndarray
    covariance: np.ndarray
    weights: np.ndarray
    mean: np.ndarray
    mean_noise: np.ndarray
    mean_slope: np.ndarray
    misfit: float
    stated: np.ndarray
    freedom: int


class LobeShares:
    """Radiance of a lobe with a Fresnel term of 1, and of a white Lambertian surface, in each image.

    The irradiance perpendicular to the direction of the light is 1.

    Args:
        family: family of the lobe, with roughness as its only parameter.
        masking: model of the masking of the lobe.
        tilts: tilts of the sample, rad, (pictures,); positive if the normal tilts towards +x.
        towards: directions to the lamps, (pictures, 3).
    """

    def __init__(self, family: str, masking: Masking, tilts: np.ndarray, towards: np.ndarray):
        zero = np.zeros_like(tilts)
        normal = vector(np.sin(tilts), zero, np.cos(tilts))
        tangent = vector(np.cos(tilts), zero, -np.sin(tilts))
        at = shading(normal, tangent, vector(*towards.T), vector(zero, zero, zero + 1.0))
        self.theta_d = np.asarray(at.theta_d)
        self.lit = np.asarray((at.cos_i > 0) & (at.cos_o > 0))
        self.white = np.maximum(np.asarray(at.cos_i), 0.0) / np.pi
        lobes = [
            Microfacet(family_ndf(family, jnp.asarray(width)), 1.0, masking=masking).reflected(at) / at.cos_o
            for width in _WIDTHS
        ]
        self._log_lobe = CubicSpline(np.log(_WIDTHS), np.log(np.maximum(np.array(lobes), 1e-300)))

    def lobe(self, log_alpha: float) -> tuple[np.ndarray, np.ndarray]:
        """Compute the radiance of the lobe in each image and its derivative with respect to log_alpha, (pictures,)."""
        value = np.exp(self._log_lobe(log_alpha))
        return value, value * self._log_lobe(log_alpha, 1)


def fit_roughness(stack: FlatStack, shares: LobeShares, gain_std: np.ndarray) -> FlatRoughness:
    """Fit the roughness and the gains of the images.

    Args:
        stack: images on the texels.
        shares: radiance of the lobe and of a white surface in each image.
        gain_std: prior standard deviation of ln of the gain of each image, (pictures,).
    """
    # frequency below which the texture is coarse, cycles/px
    coarse = (stack.radius < 0.15) & (stack.radius > 0)
    root = np.sqrt(stack.noise[:, coarse])
    data, transfer = stack.spectrum[:, coarse] / root, stack.transfer[:, coarse] / root
    # smallest relative error that is assumed for the mean of an image, no unit
    mean_std = np.hypot(stack.mean_std, 1e-4 * np.abs(stack.mean))
    prior = np.maximum(gain_std, 1e-5)

    def weights(p: np.ndarray) -> np.ndarray:
        return np.exp(p[1:])[:, None] * np.column_stack([shares.white, shares.lobe(p[0])[0]])

    def residual(p: np.ndarray) -> np.ndarray:
        loadings = weights(p)
        left = _left_behind(data, transfer, loadings)
        level = _left_behind((stack.mean / mean_std)[:, None], (1 / mean_std)[:, None], loadings)
        return np.concatenate([left.real.ravel(), left.imag.ravel(), level.real.ravel(), p[1:] / prior])

    count = len(stack.mean)
    starts = [np.concatenate([[value], np.zeros(count)]) for value in np.log(_WIDTHS)]
    start = min(starts, key=lambda p: float((residual(p) ** 2).sum()))
    low, high = np.log(_WIDTHS[[0, -1]])
    bounds = np.concatenate([[low], np.full(count, -1.0)]), np.concatenate([[high], np.full(count, 1.0)])
    found = least_squares(residual, np.clip(start, bounds[0] + 1e-6, bounds[1] - 1e-6), bounds=bounds, x_scale="jac")
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    p = found.x
    _, slope = shares.lobe(p[0])
    slopes = np.zeros((count, 2, 1 + count))
    slopes[:, 1, 0] = np.exp(p[1:]) * slope
    slopes[np.arange(count), :, 1 + np.arange(count)] = weights(p)
    loadings = weights(p) / mean_std[:, None]
    inverse = np.linalg.pinv(loadings.T @ loadings)
    reading = inverse @ loadings.T / mean_std
    mean = reading @ stack.mean
    freedom = coarse.sum() * max(count - 2, 1)  # a frequency and its mirror image are complex conjugates
    return FlatRoughness(
        log_alpha=float(p[0]),
        gains=p[1:],
        covariance=covariance,
        weights=weights(p),
        mean=mean,
        mean_noise=inverse,
        mean_slope=-np.einsum("ik,kjp,j->ip", reading, slopes, mean),
        misfit=float(2 * found.cost / freedom),
        stated=np.diag(np.concatenate([[0.0], 1 / prior**2])),
        freedom=int(freedom),
    )


def _left_behind(data: np.ndarray, transfer: np.ndarray, loadings: np.ndarray) -> np.ndarray:
    """Compute the residual of whitened data for the best pair of maps at each frequency, (pictures, frequencies)."""
    scale = np.abs(loadings).max(axis=0)
    unit = loadings / scale
    share = transfer**2
    a, b, c = (share.T @ (unit[:, i] * unit[:, j]) for i, j in ((0, 0), (1, 1), (0, 1)))
    first, second = ((transfer * data).T @ unit[:, i] for i in (0, 1))
    determinant = np.maximum(a * b - c**2, 1e-9 * a * b + 1e-300)
    maps = np.stack([(b * first - c * second) / determinant, (a * second - c * first) / determinant])
    return np.asarray(data - transfer * (unit @ maps))
