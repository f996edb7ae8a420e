"""Nodes in the angle theta_h between normal and half vector, at which the quadrature rule of a pixel evaluates a lobe.

They are Gauss-Legendre nodes in asinh(theta_h / scale), which resolve lobes with a width of 1e-3 rad as well as broad
lobes. The masking G is evaluated at two azimuths for each node, which represent all azimuths in the window of the pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from matcam.core.arrays import xp
from matcam.core.arrays.elementary import arcsinh, sine
from matcam.core.jax import jax, jit_plainly, jnp

NODES = np.polynomial.legendre.leggauss(40)
_LOCAL = 10
"""Number of neighbouring nodes to which a weight is distributed. At more distant nodes the masking may differ."""
_LARGEST_SCALE = 5e-4
"""Largest scale of the nodes about a highlight at normal view, rad. On a sphere of 20 px the bound of the width of a GGX lobe
of 3e-4 (`limits`) is then within 2 % of the bound from 160 nodes. With the scale of the whole window it would be only 1 % of
that bound.
"""
NARROWEST = 0.5
"""Smallest roughness of a lobe that the nodes resolve, divided by their scale at normal view, no unit. Compared with 160 nodes,
records of such lobes differ by at most 1e-7 of the peak, and by 1e-4 at a fifth of this roughness.
"""
NODE_RULE = (
    f"masking at every node, weights of 40 circles, or 160 or 240 at the limb, on {_LOCAL} nodes from the nearest point, "
    f"scale {_LARGEST_SCALE:g}"
)
"""Name of the transfer of weights to nodes, in the description of a stored rule."""
_RING_WINDOWS = 4
"""Number of parts into which a window is divided, so that the nodes of each part resolve the diffraction rings of a lens."""
_RANGE_PER_SCALE = 25.0
"""Ratio of the largest angle to the scale of the nodes. Below the scale the nodes are linear in the angle."""
_OUTSIDE = 1.1
"""Largest magnitude of a position among the nodes, which lie in [-1, 1]. More distant weights are moved to this position."""
_MOST_SKEW = 1e3
"""Largest skewness of the azimuths on a circle. Larger values are clipped."""
_BLOCK = 128
"""Number of pixels whose weights are transferred at a time. Their arrays fit into the cache of a processor."""
PIECE = 2 * _BLOCK
"""Number of pixels in each call. With a fixed number one compiled program serves all calls, and the calls run on several
cores.
"""
PIECES = 4
"""Number of pieces of `PIECE` pixels of a sphere that are computed together, because fewer calls take less time."""
_STEEPNESS = 7.0
"""Rate, 1/rad, of the exponential in theta_d by which F rises towards grazing angles."""
RISE = f"exp({_STEEPNESS:g} theta_d)"
"""Name of the function of theta_d in which F is assumed to be linear, in the description of a stored rule."""
_LEAST_STD = 1e-7
"""Standard deviation of the cosine of an azimuth below which all azimuths of a circle are treated as equal."""


def _local_barycentric() -> np.ndarray:
    """Compute the barycentric weights of all runs of `_LOCAL` neighbouring nodes, (runs, nodes of a run)."""
    runs = NODES[0][np.arange(NODES[0].size - _LOCAL + 1)[:, None] + np.arange(_LOCAL)]
    return 1 / np.prod(runs[:, :, None] - runs[:, None] + np.eye(_LOCAL), axis=2)


_BARYCENTRIC = _local_barycentric()


class Scale(NamedTuple):
    """Scale of the nodes about a highlight.

    Attributes:
        largest: largest scale, rad, which is reached at normal view; infinite: no limit.
        shrink: ratio of the scale to that determined by the range of angles, no unit. It is below 1 if the blur covers a
            large angle, as on a small sample, because a lobe covers the same angle on samples of all sizes.
    """

    largest: float
    shrink: float

    @classmethod
    def of(cls, radius: float, reach: float, *, single: bool = False) -> Scale:
        """Compute the scale.

        Args:
            radius: radius of the limb, px.
            reach: half side of the window of the narrowest kernel, px.
            single: True if there are no wider kernels with the same nodes, so that only `shrink` limits the scale.
        """
        own = float(np.sqrt(2) * reach / radius / _RANGE_PER_SCALE)
        return cls(np.inf if single else min(own, _LARGEST_SCALE), min(1.0, _LARGEST_SCALE / own))

    def limit(self, high: Any) -> Any:
        """Compute the upper limit of the scale, rad, of a range of angles whose largest angle is `high`, rad."""
        return self.shrink * high / _RANGE_PER_SCALE


class NodeSpacing(NamedTuple):
    """Relation between angles in a range and positions among the nodes: linear in asinh(theta / scale).

    The position is nearly linear in theta below the scale, and logarithmic above the scale. The fields are NumPy or JAX arrays
    of the same shape.

    Attributes:
        scale: the scale, rad.
        first: asinh(theta / scale) at the smallest angle.
        last: asinh(theta / scale) at the largest angle.
    """

    scale: Any
    first: Any
    last: Any

    @classmethod
    def of(cls, low: Any, high: Any, largest_scale: Any = np.inf) -> NodeSpacing:
        """Compute the spacing of a range of angles.

        Args:
            low: smallest angle, rad.
            high: largest angle, rad.
            largest_scale: upper limit of the scale, rad. If `low` is larger, `low` is the limit.
        """
        scale = xp.maximum(high / _RANGE_PER_SCALE, xp.minimum(0.15 * (high - low), low))
        scale = xp.minimum(scale, xp.maximum(low, largest_scale))
        return cls(scale, arcsinh(low / scale), arcsinh(high / scale))

    def by_pixel(self) -> NodeSpacing:
        """Append an axis for the nodes of each pixel."""
        return NodeSpacing(*(a[..., None] for a in self))

    def position(self, theta: Any) -> Any:
        """Compute the positions of angles among the nodes, in [-1.1, 1.1]."""
        return self.share(arcsinh(theta / self.scale))

    def share(self, stretched: Any) -> Any:
        """Compute positions among the nodes, in [-1.1, 1.1], from asinh(theta / scale)."""
        return xp.clip(2 * (stretched - self.first) / (self.last - self.first) - 1, -_OUTSIDE, _OUTSIDE)

    def stretched(self, position: Any) -> Any:
        """Compute asinh(theta / scale) at positions among the nodes."""
        return self.first + (self.last - self.first) * (position + 1) / 2

    def angle(self, position: Any) -> Any:
        """Compute the angles at positions among the nodes, rad."""
        return self.scale * xp.sinh(self.stretched(position))


class ThetaRange(NamedTuple):
    """Range of angles that the nodes cover. The arrays have shape (pixels,).

    Attributes:
        low: smallest angle, rad.
        high: largest angle, rad.
        largest_scale: upper limit of the scale of the nodes about a highlight, rad; infinite: the range determines the scale.
    """

    low: np.ndarray
    high: np.ndarray
    largest_scale: np.ndarray | float = np.inf

    def scaled(self, scale: Scale) -> ThetaRange:
        return self._replace(largest_scale=np.minimum(scale.largest, scale.limit(self.high)))

    def parts(self) -> list[ThetaRange]:
        """Divide the range into parts whose nodes resolve diffraction rings."""
        at = [self.low + (self.high - self.low) * n / _RING_WINDOWS for n in range(_RING_WINDOWS + 1)]
        return [self._replace(low=low, high=high) for low, high in pairwise(at)]

    def nodes(
        self, rule: tuple[np.ndarray, np.ndarray], roots: Sequence[np.ndarray] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute nodes and weights of a quadrature rule in theta, rad.

        Both arrays have shape (pixels, nodes). The range is divided at `roots`, and each part has its own nodes. Parts outside
        the range have weights of 0.

        Args:
            rule: nodes in [-1, 1], and their weights.
            roots: ascending angles, rad, (pixels,) each, behind which the integrand varies with the square root of the
                distance. Default: none.
        """
        scale, first, last = self.spacing().by_pixel()
        cuts = [arcsinh(root[:, None] / scale) for root in roots]
        edges = [first, *(np.clip(cut, first, last) for cut in cuts), last]
        stretched, rate = [], []
        for begin, end, cut in zip(edges, edges[1:], [None, *cuts], strict=False):
            if cut is None:
                stretched.append(begin + (end - begin) * (rule[0] + 1) / 2)
                rate.append((end - begin) / 2 * rule[1])
                continue
            start, stop = (np.sqrt(np.maximum(edge - cut, 0.0)) for edge in (begin, end))
            root = start + (stop - start) * (rule[0] + 1) / 2
            stretched.append(np.minimum(cut, end) + root**2)
            rate.append(root * (stop - start) * rule[1])
        at = np.concatenate(stretched, axis=1)
        return scale * np.sinh(at), scale * np.cosh(at) * np.concatenate(rate, axis=1)

    def spacing(self) -> NodeSpacing:
        return NodeSpacing.of(self.low, self.high, self.largest_scale)

    def carry(self, theta: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Transfer weights at angles to the nodes.

        The new weights have shape (pixels, nodes). Weighted sums of polynomials through neighbouring nodes are preserved.
        The lobe must be smooth on the scale of the nodes; the kernel need not be.

        theta: angles of the weights, rad.
        """
        parts = (slice(first, first + PIECE) for first in range(0, theta.shape[0], PIECE))
        spacing = self.spacing()
        return np.concatenate([_carry(theta[p], weight[p], NodeSpacing(*(a[p] for a in spacing))) for p in parts])


@jit_plainly
def _carry(theta: Any, weight: Any, spacing: NodeSpacing) -> jax.Array:
    def block(arguments):  # type: ignore[no-untyped-def]
        theta, weight, spacing = arguments
        t = spacing.by_pixel().position(theta)
        begin = jnp.clip(jnp.searchsorted(NODES[0], t) - _LOCAL // 2, 0, NODES[0].size - _LOCAL)
        about = begin[..., None] + np.arange(_LOCAL)
        gap = t[..., None] - jnp.asarray(NODES[0])[about]
        gap = jnp.where(jnp.abs(gap) < 1e-13, 1e-13, gap)
        share = jnp.asarray(_BARYCENTRIC)[begin] / gap
        share *= (weight / jnp.sum(share, -1))[..., None]
        pixel = jnp.arange(theta.shape[0])[:, None, None]
        return jnp.zeros((theta.shape[0], NODES[0].size)).at[pixel, about].add(share)

    blocks = jax.tree.map(lambda a: a.reshape(-1, _BLOCK, *a.shape[1:]), (theta, weight, spacing))
    return jax.lax.map(block, blocks).reshape(theta.shape[0], -1)


def onto_nodes(positions: jax.Array, share: jax.Array) -> jax.Array:
    """Transfer weights at any positions to the Gauss nodes.

    The new weights have shape (pixels, nodes). Weighted sums of polynomials are preserved. The polynomial through the
    values at the Gauss nodes is a sum of Legendre polynomials, whose coefficients are sums over the nodes.

    Args:
        positions: positions among the nodes, in [-1.1, 1.1], (pixels, ...).
        share: weights at the positions, in the shape of `positions`.
    """
    positions, share = (a.reshape(a.shape[0], -1) for a in (positions, share))
    return legendre_sums(positions.T, (share.T,))[0].T @ FROM_MOMENTS.T


def legendre_sums(position: jax.Array, shares: Sequence[jax.Array]) -> tuple[jax.Array, ...]:
    """Compute the sums of weights times Legendre polynomials of the position.

    The sums are over the first axis. There is one result of shape (degrees, ...) for each array of weights.

    Args:
        position: positions among the nodes, in [-1.1, 1.1].
        shares: arrays of weights in the shape of `position`.
    """

    def next_degree(state, k):  # type: ignore[no-untyped-def]
        before, now = state
        sums = tuple(jnp.sum(share * now, axis=0) for share in shares)
        return (now, (2 * k + 1) / (k + 1) * position * now - k / (k + 1) * before), sums

    start = jnp.zeros_like(position), jnp.ones_like(position)
    return jax.lax.scan(next_degree, start, jnp.arange(NODES[0].size, dtype=float), unroll=4)[1]


FROM_MOMENTS = NODES[1][:, None] * np.polynomial.legendre.legvander(NODES[0], NODES[0].size - 1)
"""Matrix that maps sums of Legendre polynomials to weights at the nodes, (nodes, degrees)."""
FROM_MOMENTS *= np.arange(NODES[0].size) + 0.5


def rise_of(theta_d: jax.Array, cell: jax.Array) -> jax.Array:
    """Transform the deviation of theta_d from its value for the cell, rad.

    F rises as exp(7 theta_d) towards grazing angles, and is nearly linear in the transformed deviation. Small deviations
    are unchanged.
    """
    return jnp.expm1(_STEEPNESS * (theta_d - cell)) / _STEEPNESS


def cos_azimuth(cos_i: Any, cos_o: Any, theta_h: Any, theta_d: Any) -> jax.Array:
    """Compute the cosine of the azimuth of the normal about the half vector, measured from the side of the lamp."""
    return jnp.clip((cos_i - cos_o) / jnp.maximum(2 * sine(theta_h) * sine(theta_d), 1e-300), -1, 1)


class CircleSums(NamedTuple):
    """Sums over circles about the highlight, inside the window of a pixel.

    The arrays have shape (pixels, circles).

    Attributes:
        total: sum of the weights.
        cosine: sums of the weights times powers 1 to 3 of the cosine of the azimuth about the half vector, (3, pixels,
            circles).
        position: sum of the weights times the position among the nodes, in [-1.1, 1.1].
        theta_d: sum of the weights times theta_d, rad.
        product: sum of the weights times theta_d times the cosine of the azimuth, rad.
    """

    total: np.ndarray
    cosine: np.ndarray
    position: np.ndarray
    theta_d: np.ndarray
    product: np.ndarray


class PixelRule(NamedTuple):
    """Quadrature rule in theta_h for each pixel.

    Attributes:
        weight: weights at the nodes of theta_h, (pixels, 40), no unit.
        circles: sums over the circles, from which the azimuths for masking are computed.
        moment: `weight` times the deviation of theta_d from its value for the cell (`rise_of`), rad, (pixels, 40). None: not
            required.
    """

    weight: np.ndarray
    circles: CircleSums
    moment: np.ndarray | None = None


def masking_angles(circles: CircleSums) -> dict[str, np.ndarray]:
    """Compute the angles at which masking is evaluated at the nodes, and their shares, by name.

    There are two azimuths at each node, which are interpolated between the circles next to the node. A circle outside the
    window is replaced by the nearest circle inside it.

    Args:
        circles: sums over circles.

    Returns:
        Three arrays of shape (pixels, nodes, 2): `cos_psi`, the cosine of both azimuths; `theta_d`, rad; and `share`.
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
    wanted = NODES[0]
    low = np.clip((position[:, None] <= wanted[:, None]).sum(-1) - 1, 0, seen.shape[1] - 2)
    left, right = (np.take_along_axis(position, low + n, axis=1) for n in (0, 1))
    gap = right - left
    part = np.clip((wanted - left) / np.where(gap > 0, gap, 1.0), 0, 1)[..., None]

    def between(values: np.ndarray) -> np.ndarray:
        one, other = (np.take_along_axis(values, (low + n)[..., None], axis=1) for n in (0, 1))
        return one + part * (other - one)

    return dict(zip(("cos_psi", "theta_d", "share"), map(between, sampled), strict=True))


def skewed_pair(skew: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the two-point Gauss rule of a skewed distribution.

    The nodes, in standard deviations from the mean, and their shares have a trailing axis. The rule is exact up to the
    third moment. It represents circles close to the limb, which are visible at two ends with unequal weights.

    skew: skewness of the distribution.
    """
    lean = np.clip(skew, -_MOST_SKEW, _MOST_SKEW) / 2
    root = np.sqrt(lean**2 + 1)
    nodes = np.stack([lean - root, lean + root], -1)
    return nodes, np.stack([lean + root, root - lean], -1) / (2 * root[..., None])


def nearest_seen(seen: np.ndarray) -> np.ndarray:
    """Find the index of the True element that is nearest to each element along axis 1."""
    index = np.arange(seen.shape[1])
    before = np.maximum.accumulate(np.where(seen, index, -1), axis=1)
    after = np.minimum.accumulate(np.where(seen, index, index.size)[:, ::-1], axis=1)[:, ::-1]
    nearest = np.where((before < 0) | ((after < index.size) & (after - index < index - before)), after, before)
    return np.clip(nearest, 0, index.size - 1)


def padded(array: np.ndarray) -> np.ndarray:
    """Pad an array with its last element to a multiple of `PIECE`."""
    return np.concatenate([array, np.repeat(array[-1:], -array.size % PIECE)])
