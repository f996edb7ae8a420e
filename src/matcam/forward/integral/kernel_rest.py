"""What a sum of Gaussians leaves of a lens's kernel: its rings, and whatever differs with the direction.

The kernel of lens and pixel is exact on a grid, as the transform of a transfer function that ends. Less its Gaussians it has
died away some rings from its centre. A singular value decomposition makes of the grid a few products

    rest(x, y) = sum over r of  u_r(x) v_r(y),

and the operator for Gaussians, which are such products, takes them as they are. Their lines are polynomials between knots. At
single places the grid itself is read.
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
"""Half side of the rest, in periods of the cutoff: further out rings are below 1e-4 of the peak, and alike on average."""
_TAPERED = 0.6
"""Share of the reach from which the rest is led to 0."""
_KNOTS = 21
"""Intervals to a period of the cutoff."""
_APART = 128
"""Half side of what the transform repeats, in periods of the cutoff: their light within the reach is 2e-5 of all."""
_STENCIL = np.arange(-2, 4)
"""Knots through which the polynomial of an interval goes."""
MARGIN = 3
"""Zeros around the grid."""
_LEFT_OUT = 1e-5
"""Of the kernel's peak: largest value of the products that are left out."""
_FEWEST = 4
"""Products come in multiples of these: each count is a program."""
REST_RULE = _REACH, _REACH_OF_ABERRATIONS, _TAPERED, _KNOTS, _LEFT_OUT
"""All that says what is left to a lens's rest: a kept rule is of no use where this is different."""
_SMOOTH = np.polynomial.legendre.leggauss(9)
"""Nodes along each axis in light that is smooth on the rest's own scale."""
_HERMITE = (-np.sqrt(3), 1 / 6), (0.0, 2 / 3), (np.sqrt(3), 1 / 6)
"""Places, in standard deviations, and shares by which what is added to the lens spreads the rest."""


class KernelRest(eqx.Module):
    """A kernel of a compact support, as a sum of products in x and y.

    Attributes:
        lines: coefficients of the polynomials along x and y, (products, 2, intervals, degree + 1), 1/px.
        grid: values at the knots along x and y, with some zeros around, 1/px^2.
        smooth: weights of the nodes in smooth light, (nodes along x, nodes along y), no unit.
        reach: half side of its support, px.
        period: of the lens's cutoff, px.
        error: largest error of the transfer function that is left, no unit.
        even: whether it is the same mirrored up and down.
    """

    lines: jax.Array
    grid: jax.Array
    smooth: jax.Array
    reach: jax.Array
    period: jax.Array
    error: jax.Array
    even: bool = eqx.field(static=True)

    def at(self, x: jax.Array, y: jax.Array, variances: tuple[jax.Array, jax.Array] | None) -> jax.Array:
        """Return values at offsets along x and y, px. variances: px^2, along x and y, of a Gaussian that spreads it."""
        if variances is None:
            return self._read(x, y)
        along, across = (jnp.sqrt(variance) for variance in variances)
        both = [(a, b) for a in _HERMITE for b in _HERMITE]
        return sum((a[1] * b[1] * self._read(x + a[0] * along, y + b[0] * across) for a, b in both), jnp.zeros(()))

    def _read(self, x: jax.Array, y: jax.Array) -> jax.Array:
        """Return the cubic through the knots about each place: they are close."""
        side = self.grid.shape[0]
        half = (side - 1) / 2
        flat = self.grid.ravel()
        firsts, bases = [], []
        for offset in (x, y):
            place = jnp.clip(offset / self.reach * (half - MARGIN) + half, 1, side - 3)
            first = jnp.floor(place)
            firsts.append(first.astype(jnp.int32) - 1)
            bases.append(lagrange_basis(np.arange(-1.0, 3.0), place - first))
        start = firsts[0] * side + firsts[1]
        rows = (
            bases[0][i] * sum((bases[1][j] * flat[start + (i * side + j)] for j in range(4)), jnp.zeros(()))
            for i in range(4)
        )
        return sum(rows, jnp.zeros(()))

    def line(self, polynomials: jax.Array, offset: jax.Array, variance: jax.Array | None) -> jax.Array:
        """Return one line at offsets, px. polynomials: (intervals, degree + 1). variance: that spreads it, px^2."""
        if variance is None:
            return self._at(polynomials, offset)
        std = jnp.sqrt(variance)
        return sum((share * self._at(polynomials, offset + place * std) for place, share in _HERMITE), jnp.zeros(()))

    def _at(self, polynomials: jax.Array, offset: jax.Array) -> jax.Array:
        count = polynomials.shape[0]
        place = (offset / self.reach + 1) * (count / 2)
        interval = jnp.clip(jnp.floor(place), 0, count - 1)
        between = place - interval
        own = polynomials[interval.astype(jnp.int32)]
        value = own[..., -1]
        for n in range(own.shape[-1] - 2, -1, -1):
            value = value * between + own[..., n]
        return jnp.where((place >= 0) & (place <= count), value, 0.0)

    def reach_through(self, variance: Any) -> Any:
        """Return the half side of the support where a Gaussian of this variance, px^2, spreads it, px."""
        return float(self.reach) + _HERMITE[-1][0] * np.sqrt(variance)

    def nodes(self) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return offsets along x and y, px, and weights of a rule for light that is smooth within the reach, (nodes,)."""
        x, y = (self.reach * a.ravel() for a in np.meshgrid(_SMOOTH[0], _SMOOTH[0], indexing="ij"))
        return x, y, self.smooth.ravel()


def kernel_rest(optics: Optics, pixel: PixelResponse, gaussians: GaussianSum, jitter: Any) -> KernelRest | None:
    """Return what Gaussians leave of a lens seen through a pixel; None where that is nothing, or numbers are not known yet.

    Args:
        optics: the lens, the same all over the field.
        pixel: the pixel.
        gaussians: the sum.
        jitter: standard deviation that registration adds to the lens, px.
    """
    known = without_derivatives((optics, pixel, gaussians, jnp.asarray(jitter)))
    leaves, tree = jax.tree.flatten(known)
    if not all(map(is_concrete, leaves)) or float(known[2].total_error) == 0:
        return None
    key = tree, tuple(np.asarray(leaf).tobytes() for leaf in leaves)
    return default_workspace().remember("kernel rest", key, lambda: _made(*known))


def _made(optics: Optics, pixel: PixelResponse, gaussians: GaussianSum, jitter: jax.Array) -> KernelRest:
    period = 1 / optics.band()
    frequency = np.arange(-_APART, _APART + 1) / (_APART * period)
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
    rest = (exact - profiles.T @ (weights[:, None] * profiles)) * _taper(np.hypot(*np.meshgrid(knots, knots)) / reach)
    u, size, v = np.linalg.svd(rest)
    products = _enough(u, size, v, _LEFT_OUT * exact.max(), rest)
    root = np.sqrt(size[:products])
    lines = np.stack([(u[:, :products] * root).T, v[:products] * root[:, None]], axis=1)
    shown = lines[:, 0].T @ lines[:, 1]
    by_gaussians = np.exp(-2 * (np.pi * frequency[:, None] * stds) ** 2) * np.asarray(pixel.mtf(frequency))[:, None]
    left = transfer - (by_gaussians * weights) @ by_gaussians.T - step**2 * (waves.conj().T @ shown @ waves.conj())
    return KernelRest(
        jnp.asarray(_polynomials(lines)),
        jnp.asarray(np.pad(shown, MARGIN)),
        jnp.asarray(_smooth_weights(shown, knots / reach, step)),
        jnp.asarray(reach),
        jnp.asarray(period),
        jnp.asarray(np.abs(left).max()),
        optics.isotropic,
    )


def _taper(share: np.ndarray) -> np.ndarray:
    """Return 1 up to the tapered part, and down to 0 at the reach; smooth to the third derivative."""
    t = np.clip((share - _TAPERED) / (1 - _TAPERED), 0, 1)
    return 1 - t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3)


def _enough(u: np.ndarray, size: np.ndarray, v: np.ndarray, most: float, rest: np.ndarray) -> int:
    """Return how many products leave out no more than `most` anywhere."""
    for count in range(_FEWEST, size.size, _FEWEST):
        if np.abs((u[:, :count] * size[:count]) @ v[:count] - rest).max() < most:
            return count
    return size.size


def _polynomials(values: np.ndarray) -> np.ndarray:
    """Return the coefficients of the polynomials between knots, by powers of the place there; (..., intervals, degree + 1)."""
    padded = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(2, 2)])  # beyond its reach the rest is 0
    count = values.shape[-1] - 1
    through = np.linalg.inv(np.vander(_STENCIL.astype(float), increasing=True))
    about = np.arange(count)[:, None] + 2 + _STENCIL
    return np.einsum("...ik,nk->...in", padded[..., about], through)


def _smooth_weights(rest: np.ndarray, knots: np.ndarray, step: float) -> np.ndarray:
    """Return weights at Legendre's nodes by which polynomials are integrated as by the rest; knots: in reaches."""
    basis = np.stack(lagrange_basis(_SMOOTH[0], knots))
    return step**2 * basis @ rest @ basis.T
