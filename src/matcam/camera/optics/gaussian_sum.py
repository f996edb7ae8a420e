"""Any lens as a signed sum of Gaussians, mtf(f) = sum_j w_j exp(-2 pi^2 sigma_j^2 f^2): closed forms for what follows.

Exact for Gaussians and for halos round them. A lens whose MTF ends at a cutoff is smoother in frequency than no finite
sum of Gaussians can be: with sum |w_j| <= 50 no choice of widths comes closer to a perfect lens, seen through a full
pixel of 4.73 um at 550 nm, than 1.5e-4 / 6e-4 / 2.4e-3 at f/2.8 / 8 / 16 (tests/camera/test_gaussian_sum.py finds that
limit by linear programming). The least squares here, 24 terms, reach 8e-4 / 1.9e-3 / 5.2e-3. Where that does not do, integrate
over frequencies (`fourier`).
"""

from __future__ import annotations

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.optics import Optics
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import jax, jnp

# Found by trial on f/2.8 to f/16, in focus and with circles of 1 and 3 px: narrowest width * band, widest width in px
# (it carries the 1/r^3 tail of an Airy pattern), and the ridge that keeps sum |w| below 50
_NARROWEST, _WIDEST, _RIDGE = 0.3, 100.0, 8e-4

# Where the MTF is sampled, in units of the band; rows count as the square root of the frequency, because a plane has
# more high frequencies than low ones
_GRID = np.concatenate([np.geomspace(3e-4, 0.03, 30), np.linspace(0.04, 1.5, 147), np.linspace(1.55, 8, 80)])
_CHECKED = np.concatenate([np.geomspace(1e-5, 0.01, 200), np.linspace(0.01, 8, 1600)[1:]])


class GaussianSum(eqx.Module):
    """A lens as a sum of Gaussians. weights: shape (n,), signed, of sum 1. sigmas: shape (n,), px.

    error: largest difference of its MTF from the lens's, over all frequencies. total_error: the same after a pixel of
    100 % fill, in the direction in which that lets most through: what a picture can show of it. Sums of fitted
    components add their errors up.
    """

    weights: jax.Array
    sigmas: jax.Array
    error: jax.Array
    total_error: jax.Array

    def mtf(self, f: ArrayLike) -> jax.Array:
        """sum_j w_j exp(-2 pi^2 sigma_j^2 f^2) at f cycles/px."""
        return _spectra(checks.number("f", f), self.sigmas) @ self.weights


def gaussian_sum(optics: Optics, terms: int = 24) -> GaussianSum:
    """`optics` as Gaussians: its Gaussian components as they are, every other one by `terms` of them, in [8, 64].

    Differentiable in the numbers of the lens: the weights solve a linear least-squares problem in its sampled MTF, the
    widths are fixed multiples of 1 / band. ArgumentError for a measured MTF that has not reached 0.
    """
    if not 8 <= terms <= 64:
        raise ArgumentError(f"terms must lie in [8, 64], got {terms}")
    parts = [(weight, _of_one_piece(part, terms)) for weight, part in optics.components()]
    return GaussianSum(
        jnp.concatenate([weight * part.weights for weight, part in parts]),
        jnp.concatenate([part.sigmas for _, part in parts]),
        sum((jnp.abs(weight) * part.error for weight, part in parts), jnp.zeros(())),
        sum((jnp.abs(weight) * part.total_error for weight, part in parts), jnp.zeros(())),
    )


def _of_one_piece(optics: Optics, terms: int) -> GaussianSum:
    if isinstance(optics, GaussianOptics):
        return GaussianSum(jnp.ones(1), optics.sigma[None], jnp.zeros(()), jnp.zeros(()))
    band = jnp.sum(optics.rule_on(np.array([0.0, 1.0])).weight)  # traced where the lens is, as `band()` cannot be
    narrowest = _NARROWEST / band
    reach = jnp.log(jnp.maximum(_WIDEST / narrowest, _WIDEST))
    sigmas = narrowest * jnp.exp(reach * jnp.linspace(0, 1, terms))

    # weights = 1 / terms + basis @ v: their sum is 1 whatever v is
    mean = jnp.full(terms, 1 / terms)
    basis = jnp.asarray(np.linalg.qr(np.eye(terms) - 1 / terms)[0][:, : terms - 1])
    frequency = jnp.asarray(_GRID) * band
    importance = np.sqrt(_GRID) * _through_full_pixel(frequency)
    spectra = _spectra(frequency, sigmas)
    rows = jnp.concatenate([importance[:, None] * (spectra @ basis), _RIDGE * basis])
    right = jnp.concatenate([importance * (optics.mtf(frequency) - spectra @ mean), -_RIDGE * mean])
    q, r = jnp.linalg.qr(rows)
    weights = mean + basis @ jax.scipy.linalg.solve_triangular(r, q.T @ right)

    checked = jnp.asarray(_CHECKED) * band
    difference = jnp.abs(_spectra(checked, sigmas) @ weights - optics.mtf(checked))
    total = difference * _through_full_pixel(checked)
    return GaussianSum(weights, sigmas, jnp.max(difference), jnp.max(total))


def _spectra(f: jax.Array, sigmas: jax.Array) -> jax.Array:
    return jnp.exp(-2 * (jnp.pi * f[..., None] * sigmas) ** 2)


def _through_full_pixel(f: jax.Array) -> jax.Array:
    """Transfer function of a square of side 1 px in the direction that lets most through."""
    angle = np.linspace(0, np.pi / 4, 33)
    return jnp.max(jnp.abs(jnp.sinc(f[:, None] * np.cos(angle)) * jnp.sinc(f[:, None] * np.sin(angle))), axis=1)
