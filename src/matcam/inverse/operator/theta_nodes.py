"""Nodes in the angle theta_h between normal and half vector, at which the rule of a pixel reads a lobe.

Nodes are even in asinh(theta_h / scale), so that they resolve a lobe a thousandth of a radian wide as well as a broad
one. The masking G varies slowly: it is evaluated at fewer nodes, at two azimuths of each, which represent the azimuths
in the window of the pixel.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from matcam.core.jax import jax, jit_plainly, jnp
from matcam.numerics.approximation import lagrange_basis

NODES = np.polynomial.legendre.leggauss(40)
_LOCAL = 10
"""Number of neighbouring nodes that share a weight between them; at more distant nodes the masking may differ."""
NODE_RULE = f"weights on {_LOCAL} nodes"
"""Name of the transfer of weights to other nodes, for the description of a stored rule."""
_RING_WINDOWS = 4
"""Number of parts of a window whose nodes resolve the diffraction rings of a lens."""
_FINEST = 25.0
"""Ratio of the largest angle to the scale of the nodes."""
_MOST_SKEW = 1e3
"""Largest skewness of the azimuths of a circle."""
_BLOCK = 128
"""Number of pixels that are transferred at a time: their arrays fit into a processor's cache."""
PIECE = 2 * _BLOCK
"""Number of pixels of one call: one program serves any number of them, and several cores share them."""
SAMPLED = np.round(np.linspace(0, NODES[0].size - 1, 20)).astype(int)
"""Nodes at which the masking of a distant rig is evaluated.

Cubics through them keep the kink of G at the limb in its position.
"""
_CUBIC = 4
_STEEPNESS = 7.0
"""Rate, 1/rad, of the exponential in theta_d by which F rises towards grazing angles."""
RISE = f"exp({_STEEPNESS:g} theta_d)"
"""Name of the function of theta_d in which F is taken as linear, for the description of a stored rule."""
_LEAST_STD = 1e-7
"""Standard deviation of the cosine of an azimuth below which all azimuths of a circle are equal."""


def _local_barycentric() -> np.ndarray:
    """Compute the barycentric weights of each run of neighbouring nodes, (runs, nodes of each)."""
    runs = NODES[0][np.arange(NODES[0].size - _LOCAL + 1)[:, None] + np.arange(_LOCAL)]
    return 1 / np.prod(runs[:, :, None] - runs[:, None] + np.eye(_LOCAL), axis=2)


_BARYCENTRIC = _local_barycentric()


def _sample_cubics() -> np.ndarray:
    """Compute Lagrange's cubic through the four samples about each node, at that node, (nodes, samples)."""
    through = np.zeros((NODES[0].size, SAMPLED.size))
    for node, position in enumerate(NODES[0]):
        first = int(np.clip(np.searchsorted(SAMPLED, node, "right") - _CUBIC // 2, 0, SAMPLED.size - _CUBIC))
        about = slice(first, first + _CUBIC)
        through[node, about] = lagrange_basis(NODES[0][SAMPLED[about]], position)
    return through


THROUGH_SAMPLES = _sample_cubics()


class ThetaRange(NamedTuple):
    """Range of angles over which nodes are laid; arrays of shape (pixels,).

    Attributes:
        low: smallest angle, rad.
        high: largest angle, rad.
        finest: largest angle at which nodes about a highlight become even, rad; infinite: that of the range itself.
    """

    low: np.ndarray
    high: np.ndarray
    finest: np.ndarray | float = np.inf

    def parts(self) -> list[ThetaRange]:
        """Divide the range into parts whose nodes resolve the rings of a lens."""
        at = [self.low + (self.high - self.low) * n / _RING_WINDOWS for n in range(_RING_WINDOWS + 1)]
        return [self._replace(low=low, high=high) for low, high in pairwise(at)]

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute the nodes and their weights as a rule in theta, (pixels, nodes) each, rad."""
        scale, first, last = (np.asarray(a)[:, None] for a in stretched(self.low, self.high, self.finest))
        t = first + (last - first) * (NODES[0] + 1) / 2
        return scale * np.sinh(t), scale * np.cosh(t) * (last - first) / 2 * NODES[1]

    def carry(self, theta: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Transfer weights at angles to the nodes, (pixels, nodes).

        The sum is exact for polynomials through neighbouring nodes. Only the lobe must be smooth on their scale, not
        the kernel.
        """
        return np.asarray(_carry(theta, weight, self.low, self.high, np.broadcast_to(self.finest, self.low.shape)))


@jit_plainly
def _carry(theta: Any, weight: Any, low: Any, high: Any, finest: Any) -> jax.Array:
    def block(arguments):  # type: ignore[no-untyped-def]
        theta, weight, low, high, finest = arguments
        scale, first, last = (a[:, None] for a in stretched(low, high, finest))
        t = 2 * (jnp.arcsinh(theta / scale) - first) / (last - first) - 1
        begin = jnp.clip(jnp.searchsorted(NODES[0], t) - _LOCAL // 2, 0, NODES[0].size - _LOCAL)
        about = begin[..., None] + np.arange(_LOCAL)
        gap = t[..., None] - jnp.asarray(NODES[0])[about]
        gap = jnp.where(jnp.abs(gap) < 1e-13, 1e-13, gap)
        share = jnp.asarray(_BARYCENTRIC)[begin] / gap
        share *= (weight / jnp.sum(share, -1))[..., None]
        pixel = jnp.arange(theta.shape[0])[:, None, None]
        return jnp.zeros_like(theta).at[pixel, about].add(share)

    arguments = (theta, weight, low, high, finest)
    blocks = tuple(a.reshape(-1, _BLOCK, *a.shape[1:]) for a in arguments)
    return jax.lax.map(block, blocks).reshape(weight.shape)


def stretched(low, high, finest=np.inf):  # type: ignore[no-untyped-def]
    """Compute (scale, first, last): nodes are even in asinh(theta / scale) between first and last. Arrays of NumPy or
    JAX.

    finest: see `ThetaRange`; the distance from the highlight, if it is larger.
    """
    xp = np if isinstance(low, np.ndarray) else jnp
    # the highlight itself is inside only if the range begins at 0
    scale = xp.where(low > 0, xp.maximum(high / _FINEST, 0.15 * (high - low)), high / _FINEST)
    scale = xp.minimum(scale, xp.maximum(low, finest))
    return scale, xp.arcsinh(low / scale), xp.arcsinh(high / scale)


def on_highlight(radius: float, reach: float) -> float:
    """Compute the angle at which nodes about a highlight become even, rad. reach: half side of the kernel's window, px."""
    return float(np.sqrt(2) * reach / radius / _FINEST)


def onto_nodes(positions: jax.Array, share: jax.Array) -> jax.Array:
    """Compute weights at Gauss nodes that integrate polynomials as shares at positions do, (pixels, nodes).

    The polynomial through Gauss nodes is a sum of Legendre polynomials, whose coefficients are sums over the nodes.

    Args:
        positions: positions in [-1, 1], (pixels, ...).
        share: their shares, of the same shape.
    """
    positions, share = (a.reshape(a.shape[0], -1) for a in (positions, share))
    return legendre_sums(positions, (share,))[0].T @ FROM_MOMENTS.T


def legendre_sums(position: jax.Array, shares: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
    """Sum shares times Legendre polynomials of the position over the last axis: arrays (degrees, ...)."""

    def next_degree(state, k):  # type: ignore[no-untyped-def]
        before, now = state
        sums = tuple((share * now) @ ones for share in shares)  # XLA takes four times as long for jnp.sum
        return (now, ((2 * k + 1) * position * now - k * before) / (k + 1)), sums

    ones = np.ones(position.shape[-1])
    start = jnp.zeros_like(position), jnp.ones_like(position)
    return jax.lax.scan(next_degree, start, jnp.arange(NODES[0].size, dtype=float))[1]


FROM_MOMENTS = NODES[1][:, None] * np.polynomial.legendre.legvander(NODES[0], NODES[0].size - 1)
"""Matrix that maps sums of Legendre polynomials to weights at the nodes, (nodes, degrees)."""
FROM_MOMENTS *= np.arange(NODES[0].size) + 0.5


def rise_of(theta_d: jax.Array, cell: jax.Array) -> jax.Array:
    """Compute the difference of theta_d from that of the cell in a variable in which F is nearly linear, rad.

    F rises as exp(7 theta_d) towards grazing angles, where it is steep. Small differences stay themselves.
    """
    return jnp.expm1(_STEEPNESS * (theta_d - cell)) / _STEEPNESS


class CircleSums(NamedTuple):
    """Sums over the parts of circles about the highlight in the window of a pixel, arrays of shape (pixels, circles).

    Attributes:
        total: sum of the weights.
        cosine: sum of the weights times powers 1 to 3 of the cosine of the azimuth about the half vector, (3, pixels,
            circles).
        position: sum of the weights times the position among the nodes, in [-1, 1].
        theta_d: sum of the weights times theta_d, rad.
        product: sum of the weights times theta_d times the cosine, rad.
    """

    total: np.ndarray
    cosine: np.ndarray
    position: np.ndarray
    theta_d: np.ndarray
    product: np.ndarray


def masking_samples(circles: CircleSums, theta: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, ...]:
    """Compute theta, cosine of the azimuth, theta_d and share of the two azimuths at which masking is evaluated.

    They come from the circles next to each node, or from the nearest circle inside the window.

    Args:
        circles: sums over circles.
        theta: nodes, (pixels, nodes), rad.
        at: indices of the nodes at which masking is evaluated.

    Returns:
        Arrays (pixels, samples), and three of (pixels, samples, 2).
    """
    seen = circles.total != 0
    safe = np.where(seen, circles.total, 1.0)
    middle, square, cube = circles.cosine / safe
    std = np.sqrt(np.maximum(square - middle**2, _LEAST_STD**2))
    nodes, shares = skewed_pair((cube - 3 * middle * square + 2 * middle**3) / std**3)
    cosine = np.clip(middle[..., None] + std[..., None] * nodes, -1, 1)
    beside = circles.theta_d / safe
    slope = (circles.product / safe - middle * beside) / std
    theta_d = beside[..., None] + slope[..., None] * nodes
    nearest = nearest_seen(seen)
    position = np.take_along_axis(circles.position / safe, nearest, axis=1)
    sampled = [np.take_along_axis(a, nearest[..., None], axis=1) for a in (cosine, theta_d, shares)]
    wanted = NODES[0][at]
    low = np.clip((position[:, None] <= wanted[:, None]).sum(-1) - 1, 0, seen.shape[1] - 2)
    left, right = (np.take_along_axis(position, low + n, axis=1) for n in (0, 1))
    gap = right - left
    part = np.clip((wanted - left) / np.where(gap > 0, gap, 1.0), 0, 1)[..., None]

    def between(values: np.ndarray) -> np.ndarray:
        one, other = (np.take_along_axis(values, (low + n)[..., None], axis=1) for n in (0, 1))
        return one + part * (other - one)

    return theta[:, at], *map(between, sampled)


def skewed_pair(skew: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute two nodes, in standard deviations from the mean, and their shares, on a trailing axis.

    They are a Gauss rule, exact to the third moment: close to the limb a circle is visible at two ends, of unequal
    light. skew: skewness of the distribution that they represent.
    """
    lean = np.clip(skew, -_MOST_SKEW, _MOST_SKEW) / 2
    root = np.sqrt(lean**2 + 1)
    nodes = np.stack([lean - root, lean + root], -1)
    return nodes, np.stack([lean + root, root - lean], -1) / (2 * root[..., None])


def nearest_seen(seen: np.ndarray) -> np.ndarray:
    """Return the index of the nearest element that is True along axis 1."""
    index = np.arange(seen.shape[1])
    before = np.maximum.accumulate(np.where(seen, index, -1), axis=1)
    after = np.minimum.accumulate(np.where(seen, index, index.size)[:, ::-1], axis=1)[:, ::-1]
    nearest = np.where((before < 0) | ((after < index.size) & (after - index < index - before)), after, before)
    return np.clip(nearest, 0, index.size - 1)


def padded(array: np.ndarray) -> np.ndarray:
    """Pad an array of pixels with its last element to a multiple of `PIECE`."""
    return np.concatenate([array, np.repeat(array[-1:], -array.size % PIECE)])
