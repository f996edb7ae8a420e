"""Small pictures of single highlights, by the thousand: elliptical Gaussians through a Gaussian lens and a box pixel.

Lens and highlight add up to one Gaussian. Along the pixel grid its mean over a pixel is a product of two differences of
erf, and neighbouring pixels share their edges. At any other orientation it is the Gaussian of y times that of x given y,
whose mean is moved by y: the integral over x is again a difference of erf, the one over the pixel's height is smooth.
"""

from __future__ import annotations

from functools import partial, reduce
from math import lgamma, log

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.pixel import BoxPixel
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax, jnp

_ERROR = 1e-8
"""Of the rule over a pixel's height, relative to the highlight's density."""
_NARROWEST = 0.2
"""Total standard deviation, px, for which the rule is made where the numbers are not known, and the least it is made for."""
_LARGEST = 4096


def highlight_stamps(
    camera: Camera,
    size: int,
    flux: ArrayLike,
    x: ArrayLike,
    y: ArrayLike,
    std_along: ArrayLike,
    std_across: ArrayLike,
    angle: ArrayLike | None = None,
) -> jax.Array:
    """Pictures of Gaussian highlights, shape (..., size, size), in units of flux per px^2; row 0 on top.

    flux: integral over the highlight, finite. x, y: its centre, px from the stamp's middle (pixel centres lie at integers
    for an odd size, half way between them for an even one), y upwards. std_along, std_across: standard deviations, px,
    of the highlight alone, >= 0: along a direction at `angle`, rad, from the x axis, and across it. angle None: along
    the pixel grid, x and y, which is faster. All broadcast to the leading axes, one entry per stamp.

    The camera needs a Gaussian lens (a halo may surround it) and a box pixel. Exact along the grid; at any angle within
    5e-7 of the peak where lens and highlight together are nowhere narrower than 0.2 px (tests).
    Differentiable in all numbers, and usable inside jax.jit. ArgumentError for any other lens or pixel, and for numbers
    that are not finite.
    """
    terms = _gaussians(camera)
    if not isinstance(size, int) or not 1 <= size <= _LARGEST:
        raise ArgumentError(f"size must be a whole number of pixels in [1, {_LARGEST}], got {size!r:.60}")
    numbers = [checks.number(name, value) for name, value in (("flux", flux), ("x", x), ("y", y))]
    for name, value in (("std_along", std_along), ("std_across", std_across)):
        numbers.append(checks.within(name, value, 0, np.inf, "px", open_high=True))
    if angle is not None:
        numbers.append(checks.number("angle", angle))
    try:
        numbers = jnp.broadcast_arrays(*numbers)
    except ValueError:
        raise ArgumentError(
            f"shapes of the highlights' numbers do not broadcast: {[a.shape for a in numbers]}"
        ) from None
    pixel: BoxPixel = camera.pixel  # type: ignore[assignment]
    shared = is_concrete(pixel.half_width) and float(pixel.half_width) == 0.5
    draw = _aligned if angle is None else partial(_rotated, _order(terms, numbers[3], numbers[4]))
    flux, *others = numbers
    return reduce(
        jnp.add, (draw(size, shared, sigma, pixel.half_width, weight * flux, *others) for weight, sigma in terms)
    )


def _gaussians(camera: Camera) -> list[tuple[jax.Array, jax.Array]]:
    """(weight, standard deviation) of the lens's parts."""
    if not isinstance(camera, Camera):
        raise ArgumentError(f"camera must be a Camera (optics and pixel), got {type(camera).__name__}")
    if not isinstance(camera.pixel, BoxPixel):
        raise ArgumentError(f"stamps need a camera with a BoxPixel, got {type(camera.pixel).__name__}")
    parts = []
    for weight, part in camera.optics.components():
        if not isinstance(part, GaussianOptics):
            raise ArgumentError(f"stamps need GaussianOptics (a halo may surround them), got {type(part).__name__}")
        parts.append((weight, part.sigma))
    return parts


def _order(terms: list[tuple[jax.Array, jax.Array]], std_along: jax.Array, std_across: jax.Array) -> int:
    """How many Gauss-Legendre nodes a pixel's height needs for the narrowest Gaussian among all."""
    numbers = [std_along, std_across, *(sigma for _, sigma in terms)]
    if all(is_concrete(jax.lax.stop_gradient(a)) for a in numbers) and std_along.size:
        along, across, *sigmas = (np.min(np.asarray(jax.lax.stop_gradient(a))) for a in numbers)
        narrowest = max(float(np.hypot(min(along, across), min(sigmas))), _NARROWEST)
    else:
        narrowest = _NARROWEST
    order = 2
    while _log_error(order, 1 / narrowest) > log(_ERROR):
        order += 1
    return order


def _log_error(order: int, length: float) -> float:
    """Logarithm of the Gauss-Legendre rule's error for exp(-t^2 / 2) over an interval of `length`, by the bound
    length^(2n+1) n!^4 / ((2n+1) (2n)!^3) max |f^(2n)| with max |f^(2n)| = (2n-1)!!, relative to the length."""
    n = order
    derivative = lgamma(2 * n + 1) - n * log(2) - lgamma(n + 1)
    return 2 * n * log(length) + 4 * lgamma(n + 1) - log(2 * n + 1) - 3 * lgamma(2 * n + 1) + derivative


def _differences(at_edges: jax.Array, size: int, shared: bool) -> jax.Array:
    """Of a function at the pixels' edges (last axis): right less left."""
    return at_edges[..., 1:] - at_edges[..., :-1] if shared else at_edges[..., size:] - at_edges[..., :size]


def _edges(size: int, shared: bool, half_width: jax.Array) -> jax.Array:
    """Pixel edges, px from the middle: one row of them if neighbours share theirs, else all left ones before all right."""
    if shared:
        return jnp.arange(size + 1) - size / 2
    centres = jnp.arange(size) - (size - 1) / 2
    return jnp.concatenate([centres - half_width, centres + half_width])


@eqx.filter_jit
def _aligned(size, shared, sigma, half_width, flux, x, y, std_x, std_y):  # type: ignore[no-untyped-def]
    edges = _edges(size, shared, half_width)

    def mean(centre: jax.Array, std: jax.Array) -> jax.Array:
        unit = jnp.sqrt(2 * (std**2 + sigma**2))[..., None]
        steps = jax.scipy.special.erf((edges - centre[..., None]) / unit)
        return _differences(steps, size, shared) / (4 * half_width)

    rows = mean(-y, std_y)  # row 0 is on top
    return (flux[..., None] * rows)[..., :, None] * mean(x, std_x)[..., None, :]


@eqx.filter_jit
def _rotated(order, size, shared, sigma, half_width, flux, x, y, std_along, std_across, angle):  # type: ignore[no-untyped-def]
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    along, across = std_along**2, std_across**2
    yy = sigma**2 + along * sin**2 + across * cos**2
    xy = (along - across) * sin * cos
    determinant = (sigma**2 + along) * (sigma**2 + across)
    nodes, weights = (jnp.asarray(a) for a in np.polynomial.legendre.leggauss(order))
    centres = (size - 1) / 2 - jnp.arange(size)
    down = (centres[:, None] + half_width * nodes) - y[..., None, None]  # (..., rows, nodes)
    yy, slope = yy[..., None, None], (xy / yy)[..., None, None]
    share = flux[..., None, None] * weights * jnp.exp(-(down**2) / (2 * yy)) / jnp.sqrt(2 * jnp.pi * yy)
    unit = jnp.sqrt(2 * determinant / yy[..., 0, 0])[..., None, None]
    middle = (x[..., None, None] + slope * down) / unit
    edges = _edges(size, shared, half_width) / unit
    steps = jax.scipy.special.erf(edges[..., None, :] - middle[..., None])  # (..., rows, nodes, edges)
    at_edges = jnp.sum(share[..., None] * steps, axis=-2)
    return _differences(at_edges, size, shared) / (8 * half_width)
