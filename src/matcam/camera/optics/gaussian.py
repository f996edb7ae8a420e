"""Gaussian optics, and approximation of any lens by a signed sum of Gaussians.

The kernels of a lens have closed forms if its MTF is a sum of Gaussians, mtf(f) = sum_j w_j exp(-2 pi^2 sigma_j^2 f^2).
The weights w_j have no unit; the widths sigma_j are in px. The sum is exact for Gaussian lenses, with or without halos.

For a lens whose MTF ends at a cutoff, the accuracy of the sum is limited. The following errors are the largest errors of
the MTF, lens and pixel together, for a diffraction-limited lens at 550 nm, a full pixel of 4.73 um and sum_j |w_j| <= 50:

    f-number                                     2.8      8        16
    smallest possible error                      1.5e-4   6e-4     2.4e-3
    error of the least-squares fit, 24 terms     8e-4     1.9e-3   5.2e-3

tests/camera/test_gaussian_sum.py computes the smallest possible errors by linear programming. For higher accuracy,
integrate over frequencies (`optics.py`).
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from matcam.camera.optics.optics import Optics, Rule, checked_isotropic, piecewise_rule
from matcam.core import checks
from matcam.core.arrays import constant, is_concrete, linalg, xp
from matcam.core.arrays.module import Module
from matcam.core.errors import ArgumentError
from matcam.numerics.normal import normal_density

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_BAND_TIMES_SIGMA = 1.4  # the MTF at the end of the band is exp(-2 pi^2 1.4^2) = 2e-17
_TRACED_BAND = 16.0  # assumed band of a traced lens, cycles/px

# Found by trial on f/2.8 to f/16, in focus and with circles of confusion of 1 and 3 px: narrowest width * band, widest
# width in px (it represents the 1/r^3 tail of an Airy pattern), and the ridge that keeps sum |w| below 50
_NARROWEST, _WIDEST, _RIDGE = 0.3, 100.0, 8e-4

# Frequencies at which the MTF is sampled, in units of the band. The weight of a row is the square root of the frequency,
# because a plane has more high frequencies than low ones
_GRID = np.concatenate([np.geomspace(3e-4, 0.03, 30), np.linspace(0.04, 1.5, 147), np.linspace(1.55, 8, 80)])
_CHECKED = np.concatenate([np.geomspace(1e-5, 0.01, 200), np.linspace(0.01, 8, 1600)[1:]])


class GaussianOptics(Optics):
    """Gaussian point spread function (Holzschuch & Pacanowski 2017).

    Args:
        sigma: standard deviation of the point spread function, px, positive. Holzschuch & Pacanowski assume
            0.5 px for the MERL camera.

    Raises:
        ArgumentError: sigma is not positive, or not a single number.

    Source:
        Holzschuch & Pacanowski (2017), section 3 (their sigma_mtf).

    Example:
        >>> lens = matcam.GaussianOptics(0.5)
        >>> round(float(lens.mtf(0.25)), 4)
        0.7346
    """

    sigma: jax.Array

    profile_fields = MappingProxyType({"sigma_px": "sigma"})

    def __init__(self, sigma: ArrayLike):
        self.sigma = checks.scalar("sigma", checks.positive("sigma", sigma, "px"))

    def psf(self, x: ArrayLike, y: ArrayLike) -> jax.Array:
        """Compute the product lsf(x) lsf(y), 1/px^2, without the pixel."""
        return self.lsf(x) * self.lsf(y)

    def lsf(self, x: ArrayLike) -> jax.Array:
        """Compute the normal density with standard deviation sigma, 1/px, without the pixel."""
        return normal_density(checks.number("x", x), self.sigma)

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Compute exp(-2 pi^2 sigma^2 f^2) at f cycles/px, without the pixel."""
        return xp.exp(-2 * xp.square(xp.pi * self.sigma * checks.number("f", f)))

    def band(self) -> float:
        """Compute the frequency at which the MTF is 2e-17, cycles/px.

        For a traced lens, 16 cycles/px are assumed.
        """
        return _BAND_TIMES_SIGMA / float(self.sigma) if is_concrete(self.sigma) else _TRACED_BAND

    def rule_on(self, borders: np.ndarray) -> Rule:
        """Build a Gauss-Legendre quadrature up to 1.4 / sigma, cycles/px."""
        unit = piecewise_rule(borders)
        band = _BAND_TIMES_SIGMA / self.sigma
        return Rule(unit.frequency * band, unit.weight * band)


class GaussianSum(Module):
    """Approximation of a lens by a sum of Gaussians.

    The errors have no unit. For a lens with several components, each error is a bound: the sum over the components of the
    error of the component times the modulus of its weight.

    Attributes:
        weights: signed weights of the Gaussians, no unit, whose sum is 1, shape (n,).
        sigmas: standard deviations of the Gaussians, px, shape (n,).
        error: largest difference between the MTF of the sum and the MTF of the lens over all frequencies.
        total_error: largest difference after both MTFs are multiplied by the MTF of a full pixel. At each frequency, the MTF
            of the pixel is taken in the direction in which its modulus is largest.
    """

    weights: jax.Array
    sigmas: jax.Array
    error: jax.Array
    total_error: jax.Array

    def mtf(self, f: ArrayLike) -> jax.Array:
        """Compute sum_j w_j exp(-2 pi^2 sigma_j^2 f^2) at f cycles/px."""
        return _spectra(checks.number("f", f), self.sigmas) @ self.weights


def gaussian_sum(optics: Optics, terms: int = 24) -> GaussianSum:
    """Approximate an isotropic lens by a signed sum of Gaussians.

    Gaussian components are kept; every other component is replaced by `terms` Gaussians. The weights solve a linear
    least-squares problem for the sampled MTF of the component. The widths form a geometric sequence. The smallest width is
    0.3 / band, px, where band is the resolved band, cycles/px. The largest width is 100 px, or 100 times the smallest
    width if that is larger. The result is differentiable in the parameters of the lens.

    Args:
        optics: the lens.
        terms: number of Gaussians for each component that is not Gaussian, 8 to 64. Default: 24.

    Raises:
        ArgumentError: `terms` is out of range, a measured MTF does not end at 0, or the lens is not isotropic.
    """
    checked_isotropic(optics, "a sum of Gaussians, which predictions, reconstructions and cylinders use for a lens,")
    return round_gaussians(optics, terms)


def round_gaussians(optics: Optics, terms: int = 24) -> GaussianSum:
    """Approximate the azimuthally averaged PSF of a lens by Gaussians.

    For an isotropic lens the result is that of `gaussian_sum`.
    """
    if not 8 <= terms <= 64:
        raise ArgumentError(f"terms must lie in [8, 64], got {terms}")
    return _of_all_pieces(optics, _NARROWEST, terms, np.ones(_GRID.size))


def finest_width(optics: Optics) -> float:
    """Compute the standard deviation of the narrowest Gaussian in the approximation of a lens, px."""
    widths = [
        constant(part.sigma) if isinstance(part, GaussianOptics) else _NARROWEST / (part.resolved_share() * part.band())
        for _, part in optics.components()
    ]
    return min(float(width) if is_concrete(width) else _NARROWEST / _TRACED_BAND for width in widths)


def few_gaussians(optics: Optics) -> GaussianSum:
    """Approximate the azimuthally averaged PSF of a lens by a few Gaussians.

    The sum is accurate only far from the centre of the PSF. The difference between lens and sum near the centre must be
    added (`forward/integral/kernel_residual.py`).
    """
    # A grid about the centre corrects the sum of 13 Gaussians, each up to 1.75 times as wide as the previous one. Only the tail
    # of the sum must be accurate, so frequencies above a fifth of the band have small weights. The values were found by trial
    # on f/2.8 to f/16, out of focus by up to 0.3 waves: the share of the light within 7 to 50 periods of the band differs from
    # that of the lens by 4e-5 to 3e-4
    return _of_all_pieces(optics, 0.41, 13, 0.01 + 0.99 * np.exp(-((_GRID / 0.2) ** 2)))


def _of_all_pieces(optics: Optics, narrowest: float, terms: int, counts: np.ndarray) -> GaussianSum:
    """Approximate each component of a lens.

    narrowest: narrowest width times the resolved band, no unit. terms: number of Gaussians. counts: weights of the
    frequencies `_GRID`.
    """
    parts = [(weight, _of_one_piece(part, narrowest, terms, counts)) for weight, part in optics.components()]
    return GaussianSum(
        xp.concatenate([weight * part.weights for weight, part in parts]),
        xp.concatenate([part.sigmas for _, part in parts]),
        sum((xp.abs(weight) * part.error for weight, part in parts), xp.zeros(())),
        sum((xp.abs(weight) * part.total_error for weight, part in parts), xp.zeros(())),
    )


def _of_one_piece(optics: Optics, narrowest: float, terms: int, counts: np.ndarray) -> GaussianSum:
    if isinstance(optics, GaussianOptics):
        return GaussianSum(xp.ones(1), optics.sigma[None], xp.zeros(()), xp.zeros(()))
    band = xp.sum(optics.rule_on(np.array([0.0, 1.0])).weight)  # traced if the lens is traced, unlike `band()`
    resolved = band * optics.resolved_share()
    least = narrowest / resolved
    reach = xp.log(xp.maximum(_WIDEST / least, _WIDEST))
    sigmas = least * xp.exp(reach * xp.linspace(0, 1, terms))

    # weights = 1 / terms + basis @ v: their sum is 1 for any v
    mean = xp.full(terms, 1 / terms)
    basis = xp.asarray(np.linalg.qr(np.eye(terms) - 1 / terms)[0][:, : terms - 1])
    frequency = xp.asarray(_GRID) * resolved
    importance = counts * np.sqrt(_GRID) * _through_full_pixel(frequency)
    spectra = _spectra(frequency, sigmas)
    rows = xp.concatenate([importance[:, None] * (spectra @ basis), _RIDGE * basis])
    right = xp.concatenate([importance * (_mean_transfer(optics, frequency) - spectra @ mean), -_RIDGE * mean])
    q, r = linalg.qr(rows)
    weights = mean + basis @ linalg.solve(r, q.T @ right)

    checked = xp.asarray(_CHECKED) * band
    difference = xp.abs(_spectra(checked, sigmas) @ weights - _mean_transfer(optics, checked))
    total = difference * _through_full_pixel(checked)
    return GaussianSum(weights, sigmas, xp.max(difference), xp.max(total))


def _mean_transfer(optics: Optics, frequency: jax.Array) -> jax.Array:
    """Compute the azimuthal mean of the transfer function of a lens. The mean is real."""
    if optics.isotropic:
        return optics.mtf(frequency)
    # 32 directions in half a turn suffice, because the values in the other half are complex conjugates
    f, angle = frequency[:, None], np.pi * np.arange(32) / 32
    return xp.mean(xp.real(optics.otf(f * np.cos(angle), f * np.sin(angle))), axis=1)


def _spectra(f: jax.Array, sigmas: jax.Array) -> jax.Array:
    return xp.exp(-2 * (xp.pi * f[..., None] * sigmas) ** 2)


def _through_full_pixel(f: jax.Array) -> jax.Array:
    """Compute the modulus of the transfer function of a square of side 1 px, in the direction in which it is largest.

    f: frequency, cycles/px, (n,).
    """
    angle = np.linspace(0, np.pi / 4, 33)
    return xp.max(xp.abs(xp.sinc(f[:, None] * np.cos(angle)) * xp.sinc(f[:, None] * np.sin(angle))), axis=1)
