"""The record of an isotropic lobe in one pixel, on a distant sphere, as a sum over angles from the half vector.

In polar coordinates (theta, psi) about the half vector the lobe depends on theta alone, so the record is linear in it,

    R cos_i = F r^2 / 4 integral D(theta) [ integral k(x - x(theta, psi)) G dpsi ] sin(theta) dtheta      (docs/model.md 3),

and the bracket without G depends on the rig alone: it is computed once, for any material. G varies slowly. It is taken at two
azimuths of each theta, chosen by the mean and the variance of the azimuths that the pixel sees there.

Nodes in theta are even in asinh(theta / scale). So they meet a lobe a thousandth of a radian wide as well as a broad one.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from matcam.core.jax import jax, jit_plainly, jnp
from matcam.forward.integral.blur import Blur, Spread
from matcam.inverse.operator.lamp_lines import LampDisc, both_sides, disc_kernel
from matcam.inverse.operator.sample_view import square_border
from matcam.numerics.approximation import lagrange_basis
from matcam.numerics.sine import sine_and_cosine

NODES = np.polynomial.legendre.leggauss(40)
_LOCAL = 10
"""Nodes on which a weight between them is laid: further away the masking may be another one."""
NODE_RULE = f"weights on {_LOCAL} nodes"
"""How weights come to the nodes of several widths; rules that are kept say so."""
AZIMUTHS = np.polynomial.legendre.leggauss(22)
_AZIMUTHS_OF_RINGS = np.polynomial.legendre.leggauss(48)
"""Where a lens's rings are seen."""
_RING_WINDOWS = 4
_FINEST = 25.0
"""Outer end of the nodes over the angle at which they become even."""
_REACH = 6.2
"""How far a Gaussian is followed, in standard deviations: highlights are 1e6 times brighter than their surroundings."""
_LEAST_SPREAD = 1e-5
"""Least standard deviation of the cosines of a circle's azimuths: their moments are differences of sums."""
_MOST_LEAN = 1e3
"""Largest skewness of what a circle shows."""
_BLOCK = 128
"""Pixels at a time: what fits into a processor's cache."""
PIECE = 2 * _BLOCK
"""Pixels of one call: one program serves any number of them, and several cores share them."""
SAMPLED = np.round(np.linspace(0, NODES[0].size - 1, 20)).astype(int)
"""Nodes at which G is taken. Where the limb cuts a circle off G has a kink: cubics keep it in its place."""
_CUBIC = 4


def _local_barycentric() -> np.ndarray:
    """Return the barycentric weights of each run of neighbouring nodes, (runs, nodes of each)."""
    runs = NODES[0][np.arange(NODES[0].size - _LOCAL + 1)[:, None] + np.arange(_LOCAL)]
    return 1 / np.prod(runs[:, :, None] - runs[:, None] + np.eye(_LOCAL), axis=2)


_BARYCENTRIC = _local_barycentric()


def _sample_cubics() -> np.ndarray:
    """Return Lagrange's cubic through the four samples about each node, at that node, (nodes, samples)."""
    through = np.zeros((NODES[0].size, SAMPLED.size))
    for node, place in enumerate(NODES[0]):
        first = int(np.clip(np.searchsorted(SAMPLED, node, "right") - _CUBIC // 2, 0, SAMPLED.size - _CUBIC))
        about = slice(first, first + _CUBIC)
        through[node, about] = lagrange_basis(NODES[0][SAMPLED[about]], place)
    return through


THROUGH_SAMPLES = _sample_cubics()


class Pixels(NamedTuple):
    """Hold places in the pictures of a sphere, arrays of one shape.

    Attributes:
        x: px from the optical axis, the lamp towards +x.
        y: the same across.
        theta_d: rad.
        factor: factor of the record.
    """

    x: np.ndarray
    y: np.ndarray
    theta_d: np.ndarray
    factor: np.ndarray


class PolarRule(NamedTuple):
    """Hold the rule of each pixel.

    Attributes:
        theta: (pixels, nodes), rad from the half vector.
        weight: (pixels, nodes).
        cos_psi: (pixels, nodes, 2), cosine of the two azimuths at which G is taken; NaN where nothing is seen.
        share: (pixels, nodes, 2), shares of the weight at these azimuths.
    """

    theta: jax.Array
    weight: jax.Array
    cos_psi: jax.Array
    share: jax.Array


class PolarWindow(NamedTuple):
    """Hold what a kernel can see, as intervals of theta; arrays of shape (pixels,).

    Attributes:
        low: smallest angle from the half vector, rad.
        high: largest angle, rad.
        reach: half side of what the kernel reaches along x, px.
        rows: the same along y.
        finest: largest angle at which nodes about a highlight become even, rad; infinite: the window's own.
    """

    low: np.ndarray
    high: np.ndarray
    reach: np.ndarray
    rows: np.ndarray
    finest: np.ndarray | float = np.inf


def polar_window(radius: float, pixels: Pixels, reach: np.ndarray, rows: np.ndarray) -> PolarWindow:
    """Return the angles from the half vector under a kernel of half sides `reach` and `rows` px, along x and y.

    The extremes lie on the border of the kernel's rectangle, or on the limb where it leaves the sphere.
    """
    x, y = (a / radius for a in square_border(radius, pixels.x, pixels.y, reach, rows))
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    sin, cos = np.sin(pixels.theta_d)[..., None], np.cos(pixels.theta_d)[..., None]
    theta = np.arctan2(np.hypot(y, x * cos - z * sin), x * sin + z * cos)
    inside = (np.abs(pixels.x - radius * sin[..., 0]) < reach) & (np.abs(pixels.y) < rows)
    low, high = theta.min(-1), theta.max(-1)
    slack = 0.02 * (high - low)
    return PolarWindow(
        np.where(inside, 0.0, np.maximum(low - slack, 0.0)), np.minimum(high + slack, np.pi / 2), reach, rows
    )


def ring_windows(window: PolarWindow) -> list[PolarWindow]:
    """Divide a window, so that the nodes of each part resolve a lens's rings."""
    at = [window.low + (window.high - window.low) * n / _RING_WINDOWS for n in range(_RING_WINDOWS + 1)]
    return [window._replace(low=low, high=high) for low, high in pairwise(at)]


def on_highlight(radius: float, reach: float) -> float:
    """Return the angle at which nodes about a highlight become even, rad. reach: half side of what a pixel there sees, px."""
    return float(np.sqrt(2) * reach / radius / _FINEST)


def kernel_reach(half_width: float, stds: np.ndarray) -> np.ndarray:
    """Return the half side of the square that a pixel sees through Gaussians of these standard deviations, px."""
    return half_width + _REACH * stds


@partial(jit_plainly, static=("terms",))
def polar_rule(
    radius: jax.Array,
    blur: Blur,
    variances: tuple,
    terms: tuple[int, ...],
    pixels: Pixels,
    window: PolarWindow,
    disc: LampDisc | None = None,
) -> PolarRule:
    """Return the rule for some terms of a blur; differentiable in its parameters.

    variances: px^2, (pixels,), that the blur's spread adds along x and y. pixels: a multiple of the block, see `padded`.
    disc: of a lamp whose disc is not in the variances.
    """
    around = AZIMUTHS if blur.rest is None else _AZIMUTHS_OF_RINGS

    def block(arguments):  # type: ignore[no-untyped-def]
        arguments, disc = arguments
        x, y, theta_d, factor, low, high, reach, rows, finest, var_x, var_y = (a[:, None, None] for a in arguments)
        scale, first, last = stretched(low, high, finest)
        t = first + (last - first) * (NODES[0][:, None] + 1) / 2
        theta = scale * jnp.sinh(t)
        step = scale * jnp.cosh(t) * (last - first) / 2 * NODES[1][:, None]
        sin, cos, sin_d, cos_d = jnp.sin(theta), jnp.cos(theta), jnp.sin(theta_d), jnp.cos(theta_d)
        # visible: cos psi < cot theta cot theta_d; lit: > the negative; seen by the kernel: x, then y
        horizon = cos * cos_d / jnp.maximum(sin * sin_d, 1e-300)
        mirror = jnp.where(y < 0, -1.0, 1.0)
        y = jnp.abs(y)  # the mirror's other half sees the same, mirrored
        along = [((x + side * reach) / radius - cos * sin_d) / (sin * cos_d) for side in (-1, 1)]
        from_ = jnp.arccos(jnp.clip(jnp.minimum(along[1], horizon), -1, 1))
        to = jnp.arccos(jnp.clip(jnp.maximum(along[0], -horizon), -1, 1))
        rise = [jnp.arcsin(jnp.clip((y + side * rows) / radius / sin, 0, 1)) for side in (-1, 1)]
        total, moments = 0.0, jnp.zeros(3)[:, None, None]
        for begin, end in ((rise[0], rise[1]), (jnp.pi - rise[1], jnp.pi - rise[0])):
            begin, end = jnp.maximum(begin, from_), jnp.minimum(end, to)
            half = jnp.maximum(end - begin, 0.0) / 2
            psi = begin + half * (around[0] + 1)
            sin_psi, cos_psi = sine_and_cosine(psi)
            normal = cos * sin_d + sin * cos_psi * cos_d, sin * sin_psi, cos * cos_d - sin * cos_psi * sin_d
            if disc is None:
                spread = Spread(var_x, var_y, jnp.abs(blur.defocus(radius, normal[2])))
                kernel = both_sides(blur, terms, spread, (radius * normal[0] - x, radius * normal[1]), y, mirror)
            else:
                kernel = disc_kernel(radius, blur, terms, disc, normal, (x, y), (var_x, var_y))
            share = kernel * half * around[1]
            total += jnp.sum(share, -1)
            moments += jnp.stack([jnp.sum(share * cos_psi**n, -1) for n in (1, 2, 3)])
        safe = jnp.where(total == 0, 1.0, total)
        middle, square, cube = moments / safe
        spread = jnp.sqrt(jnp.maximum(square - middle**2, _LEAST_SPREAD**2))
        nodes, shares = skewed_pair((cube - 3 * middle * square + 2 * middle**3) / spread**3)
        pair = jnp.clip(middle[..., None] + spread[..., None] * nodes, -1, 1)
        pair = jnp.where((total == 0)[..., None], jnp.nan, pair)
        weight = factor[..., 0] * radius**2 / 4 * (sin * step)[..., 0] * total
        return PolarRule(theta[..., 0], weight, pair, shares)

    arguments = tuple(jnp.broadcast_to(a, pixels.x.shape) for a in (*pixels, *window, *variances))
    blocks = jax.tree.map(lambda a: a.reshape(-1, _BLOCK, *a.shape[1:]), (arguments, disc))
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), jax.lax.map(block, blocks))


disc_rule = jax.jit(polar_rule.__wrapped__, static_argnames=("terms",))  # type: ignore[attr-defined]
"""The same for discs, compiled with all passes: Gaussians of a disc take a third of the time."""


def skewed_pair(lean: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the two nodes, in standard deviations from the mean, and their shares, on a trailing axis.

    They are Gauss's rule, exact to the third moment: close to the limb a circle is seen at two ends, of unequal light.
    lean: third moment of what they stand for, in standard deviations.
    """
    lean = jnp.clip(lean, -_MOST_LEAN, _MOST_LEAN) / 2
    root = jnp.sqrt(lean**2 + 1)
    nodes = jnp.stack([lean - root, lean + root], -1)
    return nodes, jnp.stack([lean + root, root - lean], -1) / (2 * root[..., None])


def stretched(
    low: jax.Array, high: jax.Array, finest: jax.Array | float = jnp.inf
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (scale, first, last): nodes are even in asinh(theta / scale) between first and last.

    finest: as of a `PolarWindow`; further from the highlight than that, the distance from it.
    """
    # the highlight itself is inside only where the window begins at 0
    scale = jnp.where(low > 0, jnp.maximum(high / _FINEST, 0.15 * (high - low)), high / _FINEST)
    scale = jnp.minimum(scale, jnp.maximum(low, finest))
    return scale, jnp.arcsinh(low / scale), jnp.arcsinh(high / scale)


def onto_nodes(place: jax.Array, share: jax.Array) -> jax.Array:
    """Return the weights at Gauss's nodes that integrate polynomials as shares at places do, (pixels, nodes).

    The polynomial through Gauss's nodes is a sum of Legendre's, whose coefficients are the nodes' own sums. place, share:
    (pixels, ...), the places in [-1, 1].
    """

    def next_moment(state, k):  # type: ignore[no-untyped-def]
        before, now = state
        return (now, ((2 * k + 1) * place * now - k * before) / (k + 1)), jnp.sum(share * now, over)

    over = tuple(range(1, place.ndim))
    start = jnp.zeros_like(place), jnp.ones_like(place)
    _, moments = jax.lax.scan(next_moment, start, jnp.arange(NODES[0].size, dtype=float))
    return moments.T @ _FROM_MOMENTS.T


_FROM_MOMENTS = NODES[1][:, None] * np.polynomial.legendre.legvander(NODES[0], NODES[0].size - 1)
_FROM_MOMENTS *= np.arange(NODES[0].size) + 0.5


@jit_plainly
def transfer(rule: PolarRule, window: PolarWindow) -> jax.Array:
    """Return a rule's weights at the nodes of a wider window.

    The result is the same for all that polynomials through neighbouring nodes follow. So a kernel need not be smooth on their
    scale; only the lobe has to be.
    """

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

    finest = jnp.broadcast_to(window.finest, window.low.shape)
    arguments = (rule.theta, rule.weight, window.low, window.high, finest)
    blocks = tuple(a.reshape(-1, _BLOCK, *a.shape[1:]) for a in arguments)
    return jax.lax.map(block, blocks).reshape(rule.weight.shape)


def masking_samples(rule: PolarRule) -> tuple[np.ndarray, ...]:
    """Return (theta, cos psi, shares) at the sampled nodes; where nothing is seen, those of the nearest node that sees any."""
    theta, cos_psi, share = (np.asarray(a) for a in (rule.theta, rule.cos_psi, rule.share))
    nearest = nearest_seen(np.isfinite(cos_psi[..., 0]))[:, SAMPLED, None]
    return theta[:, SAMPLED], *(np.nan_to_num(np.take_along_axis(a, nearest, axis=1)) for a in (cos_psi, share))


def nearest_seen(seen: np.ndarray) -> np.ndarray:
    """Return the index of the nearest that is seen along axis 1."""
    index = np.arange(seen.shape[1])
    before = np.maximum.accumulate(np.where(seen, index, -1), axis=1)
    after = np.minimum.accumulate(np.where(seen, index, index.size)[:, ::-1], axis=1)[:, ::-1]
    nearest = np.where((before < 0) | ((after < index.size) & (after - index < index - before)), after, before)
    return np.clip(nearest, 0, index.size - 1)


def padded(array: np.ndarray) -> np.ndarray:
    """Repeat the last of an array of pixels up to a whole number of pieces."""
    return np.concatenate([array, np.repeat(array[-1:], -array.size % PIECE)])
