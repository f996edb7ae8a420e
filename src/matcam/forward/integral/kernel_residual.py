"""Residual of the kernel of a lens beyond a sum of Gaussians: its rings, and its dependence on direction.

The kernel of lens and pixel is computed exactly on a grid, as the Fourier transform of a band-limited transfer function.
The residual is this kernel minus the Gaussians. It vanishes a few rings from the centre. A singular value
decomposition of the residual on the grid yields a sum of few products

    residual(x, y) = sum over r of  u_r(x) v_r(y),

to which the operator for Gaussians applies, because Gaussians are such products, too. The functions u_r and v_r are
polynomials between knots. Values at single positions are interpolated from the grid.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import numpy as np

from matcam.camera.optics.gaussian import GaussianSum
from matcam.camera.optics.optics import Optics
from matcam.camera.pixel import PixelResponse
from matcam.core.jax import is_concrete, jax, jnp, without_derivatives
from matcam.core.workspace import default_workspace
from matcam.numerics.approximation import lagrange_basis

_REACH, _REACH_OF_ABERRATIONS = 9, 16
"""Support radius of the residual, in periods of the highest resolved frequency. Rings beyond it are below 1e-4 of the peak."""
_TAPERED = 0.6
"""Share of the support radius beyond which the residual is tapered to 0."""
_KNOTS = 21
"""Number of intervals between knots per period of the highest resolved frequency."""
_APART = 128
"""Distance between the kernel and its periodic copies in the discrete transform, in periods of the highest resolved
frequency. The copies contribute 2e-5 of the light within the support.
"""
_STENCIL = np.arange(-2, 4)
"""Knots through which the polynomial of an interval passes, relative to the knot at the start of the interval."""
MARGIN = 3
"""Width of the border of zeros around the grid, in knots."""
_LEFT_OUT = 1e-5
"""Largest value of the neglected products, as a share of the peak of the kernel."""
_FEWEST = 4
"""The number of products is a multiple of this value, because each number of products requires a program."""
RESIDUAL_RULE = _REACH, _REACH_OF_ABERRATIONS, _TAPERED, _KNOTS, _LEFT_OUT
"""Parameters of the residual of a lens. A stored quadrature rule is valid only for the same values."""
_SMOOTH = np.polynomial.legendre.leggauss(9)
"""Gauss-Legendre rule along each axis for radiance that is smooth on the scale of the residual."""
_HERMITE = (-np.sqrt(3), 1 / 6), (0.0, 2 / 3), (np.sqrt(3), 1 / 6)
"""Gauss-Hermite nodes, in standard deviations, and weights by which the residual is blurred by an additional Gaussian."""


class KernelResidual(eqx.Module):
    """Residual with compact support, as a sum of products u(x) v(y).

    Attributes:
        lines: coefficients of the polynomials along x and y, (products, 2, intervals, degree + 1), 1/px.
        grid: values at the knots along x and y, padded with zeros, 1/px^2.
        smooth: weights of the nodes for smooth radiance, (nodes along x, nodes along y), no unit.
        reach: half side of the square support, px.
        period: period of the highest frequency that the lens resolves, px.
        error: largest remaining error of the transfer function, no unit.
        even: True if the kernel is symmetric about the x axis.
    """

    lines: jax.Array
    grid: jax.Array
    smooth: jax.Array
    reach: jax.Array
    period: jax.Array
    error: jax.Array
    even: bool = eqx.field(static=True)

    def at(self, x: jax.Array, y: jax.Array, variances: tuple[jax.Array, jax.Array] | None) -> jax.Array:
        """Evaluate the residual, 1/px^2, at offsets along x and y, px.

        variances: variances of an additional Gaussian blur along x and y, px^2; None: no additional blur.
        """
        if variances is None:
            return self._read(x, y)
        along, across = (jnp.sqrt(variance) for variance in variances)
        both = [(a, b) for a in _HERMITE for b in _HERMITE]
        return sum((a[1] * b[1] * self._read(x + a[0] * along, y + b[0] * across) for a, b in both), jnp.zeros(()))

    def _read(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Interpolate the residual, 1/px^2, by cubics through the four nearest knots along each axis."""
        side = self.grid.shape[0]
        half = (side - 1) / 2
        flat = self.grid.ravel()
        firsts, bases = [], []
        for offset in (x, y):
            position = jnp.clip(offset / self.reach * (half - MARGIN) + half, 1, side - 3)
            first = jnp.floor(position)
            firsts.append(first.astype(jnp.int32) - 1)
            bases.append(lagrange_basis(np.arange(-1.0, 3.0), position - first))
        start = firsts[0] * side + firsts[1]
        rows = (
            bases[0][i] * sum((bases[1][j] * flat[start + (i * side + j)] for j in range(4)), jnp.zeros(()))
            for i in range(4)
        )
        return sum(rows, jnp.zeros(()))

    def line(self, polynomials: jax.Array, offset: jax.Array, variance: jax.Array | None) -> jax.Array:
        """Evaluate one of the two functions of a product, 1/px, at offsets, px.

        polynomials: coefficients of the function, (intervals, degree + 1), 1/px. variance: variance of an additional Gaussian
        blur, px^2; None: no blur.
        """
        if variance is None:
            return self._at(polynomials, offset)
        std = jnp.sqrt(variance)
        return sum(
            (share * self._at(polynomials, offset + position * std) for position, share in _HERMITE), jnp.zeros(())
        )

    def _at(self, polynomials: jax.Array, offset: jax.Array) -> jax.Array:
        count = polynomials.shape[0]
        position = (offset / self.reach + 1) * (count / 2)
        interval = jnp.clip(jnp.floor(position), 0, count - 1)
        between = position - interval
        own = polynomials[interval.astype(jnp.int32)]
        value = own[..., -1]
        for n in range(own.shape[-1] - 2, -1, -1):
            value = value * between + own[..., n]
        return jnp.where((position >= 0) & (position <= count), value, 0.0)

    def reach_through(self, variance: Any) -> Any:
        """Compute the half side of the support, px, after an additional blur of this variance, px^2."""
        return float(self.reach) + _HERMITE[-1][0] * np.sqrt(variance)

    def nodes(self) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Compute a quadrature rule for the residual times smooth radiance.

        The results are offsets along x and y, px, and weights, (nodes,).
        """
        x, y = (self.reach * a.ravel() for a in np.meshgrid(_SMOOTH[0], _SMOOTH[0], indexing="ij"))
        return x, y, self.smooth.ravel()


def kernel_residual(optics: Optics, pixel: PixelResponse, gaussians: GaussianSum, jitter: Any) -> KernelResidual | None:
    """Compute the residual of a lens through a pixel; None for a sum of Gaussians, or if parameters are traced.

    Args:
        optics: the lens, constant over the field.
        pixel: the pixel.
        gaussians: sum of Gaussians that approximates the lens.
        jitter: standard deviation of the registration jitter, px.
    """
    known = without_derivatives((optics, pixel, gaussians, jnp.asarray(jitter)))
    leaves, tree = jax.tree.flatten(known)
    if not all(map(is_concrete, leaves)) or float(known[2].total_error) == 0:
        return None
    key = tree, tuple(np.asarray(leaf).tobytes() for leaf in leaves)
    return default_workspace().remember("kernel residual", key, lambda: _made(*known))


def _made(optics: Optics, pixel: PixelResponse, gaussians: GaussianSum, jitter: jax.Array) -> KernelResidual:
    period = 1 / (optics.band() * optics.resolved_share())
    count = int(np.ceil(_APART / optics.resolved_share()))
    frequency = np.arange(-count, count + 1) / (_APART * period)
    fx, fy = np.meshgrid(frequency, frequency, indexing="ij")
    inside = np.hypot(fx, fy) < optics.band()
    transfer = np.zeros(fx.shape, dtype=complex)
    transfer[inside] = np.asarray(optics.otf(fx[inside], fy[inside]))
    passed = np.asarray(pixel.mtf(frequency)) * np.exp(-2 * (np.pi * float(jitter) * frequency) ** 2)
    transfer *= np.outer(passed, passed)

    periods = _REACH if optics.isotropic else _REACH_OF_ABERRATIONS
    reach, half = periods * period, periods * _KNOTS
    knots = reach * np.arange(-half, half + 1) / half
    waves = np.exp(2j * np.pi * np.outer(knots, frequency))
    exact = (waves @ transfer @ waves.T).real / (_APART * period) ** 2
    stds = np.hypot(np.asarray(gaussians.sigmas), float(jitter))
    profiles = np.stack([np.asarray(pixel.of_gaussian(knots, std)) for std in stds])
    weights = np.asarray(gaussians.weights)
    step = knots[1] - knots[0]
    residual = (exact - profiles.T @ (weights[:, None] * profiles)) * _taper(
        np.hypot(*np.meshgrid(knots, knots)) / reach
    )
    u, size, v = np.linalg.svd(residual)
    products = _enough(u, size, v, _LEFT_OUT * exact.max(), residual)
    root = np.sqrt(size[:products])
    lines = np.stack([(u[:, :products] * root).T, v[:products] * root[:, None]], axis=1)
    shown = lines[:, 0].T @ lines[:, 1]
    by_gaussians = np.exp(-2 * (np.pi * frequency[:, None] * stds) ** 2) * np.asarray(pixel.mtf(frequency))[:, None]
    left = transfer - (by_gaussians * weights) @ by_gaussians.T - step**2 * (waves.conj().T @ shown @ waves.conj())
    return KernelResidual(
        jnp.asarray(_polynomials(lines)),
        jnp.asarray(np.pad(shown, MARGIN)),
        jnp.asarray(_smooth_weights(shown, knots / reach, step)),
        jnp.asarray(reach),
        jnp.asarray(period),
        jnp.asarray(np.abs(left).max()),
        optics.isotropic,
    )


def _taper(share: np.ndarray) -> np.ndarray:
    """Evaluate the taper: 1 up to `_TAPERED`, and 0 at the support radius, with three continuous derivatives."""
    t = np.clip((share - _TAPERED) / (1 - _TAPERED), 0, 1)
    return 1 - t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3)


def _enough(u: np.ndarray, size: np.ndarray, v: np.ndarray, most: float, residual: np.ndarray) -> int:
    """Choose the number of products for which the remainder is below `most`, 1/px^2, everywhere."""
    for count in range(_FEWEST, size.size, _FEWEST):
        if np.abs((u[:, :count] * size[:count]) @ v[:count] - residual).max() < most:
            return count
    return size.size


def _polynomials(values: np.ndarray) -> np.ndarray:
    """Compute the coefficients of the polynomials between knots, lowest power first, (..., intervals, degree + 1)."""
    padded = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(2, 2)])  # the residual is 0 beyond its support
    count = values.shape[-1] - 1
    through = np.linalg.inv(np.vander(_STENCIL.astype(float), increasing=True))
    about = np.arange(count)[:, None] + 2 + _STENCIL
    return np.einsum("...ik,nk->...in", padded[..., about], through)


def _smooth_weights(residual: np.ndarray, knots: np.ndarray, step: float) -> np.ndarray:
    """Compute weights at Gauss-Legendre nodes that integrate polynomials times the residual.

    residual: values at the knots, 1/px^2. knots: positions of the knots, in support radii. step: their distance, px.
    """
    basis = np.stack(lagrange_basis(_SMOOTH[0], knots))
    return step**2 * basis @ residual @ basis.T
