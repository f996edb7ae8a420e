"""Effective kernel of one lens and one pixel: value of a pixel for a point, a line or an edge.

The kernel has a closed form for Gaussian optics and a square pixel, and is integrated over frequencies otherwise. All
functions are for lenses of one component; `Camera` sums over components.

Closed form: let p be the half width of the pixel, and a the angle between a direction and the grid. The projection of
the square along this direction is the convolution of two boxes with the half widths p |cos a| and p |sin a|. A Gaussian
convolved with both boxes is a second difference of H, the integral of the normal distribution function. The value at an
edge is a second difference of the integral of H. H and its integral are split into a polynomial for x > 0 and a vanishing
remainder, so that no large terms cancel. If the short box is much narrower than the Gaussian, the second difference
loses digits. In this case, the mean over the short box is computed by quadrature. Polynomial and remainder have kinks
at x = 0 that cancel, and both use the left-hand derivative there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from matcam.camera.optics import optics as fourier
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.optics import Optics
from matcam.camera.optics.varying import VaryingOptics
from matcam.camera.pixel import BoxPixel, PixelResponse, gaussian_over_interval, mean_over_interval
from matcam.core.arrays import special, xp
from matcam.numerics.normal import normal_density

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray, jax


def point(optics: Optics, pixel: PixelResponse, x: jax.Array, y: jax.Array) -> jax.Array:
    """Compute the value of a pixel, 1/px^2, for a point source.

    x, y: position of the point relative to the centre of the pixel, px.
    """
    if isinstance(optics, GaussianOptics):
        return pixel.of_gaussian(x, optics.sigma) * pixel.of_gaussian(y, optics.sigma)
    reach, band = fourier.reach_of(xp.hypot(x, y)), optics.band()
    rule = optics.frequency_rule(fourier.panels_for(reach + 1, band))
    turns = fourier.turns_for(reach + 1, band)
    if not optics.isotropic:  # the kernel depends on the offset of the pixel from the point, (-x, -y)
        along = partial(transfer_along, optics, pixel)
        return fourier.directed_plane_kernel(rule, along, -x, -y, turns)
    return fourier.plane_kernel(rule, partial(transfer_along, optics, pixel), x, y, turns)


def line(optics: Optics, pixel: PixelResponse, x: jax.Array, angle: jax.Array) -> jax.Array:
    """Compute the value of a pixel, 1/px, for a line source.

    x: distance of the line from the centre of the pixel, px. angle: direction of the normal of the line, rad.
    """
    if isinstance(optics, GaussianOptics) and isinstance(pixel, BoxPixel):
        return square_line(x, angle, pixel.half_width, optics.sigma)
    # the kernel depends on the offset of the pixel from the line, -x
    return fourier.line_kernel(rule_for(optics, x), partial(transfer_along, optics, pixel), -x, angle)


def edge(optics: Optics, pixel: PixelResponse, x: jax.Array, angle: jax.Array) -> jax.Array:
    """Compute the value of a pixel at a unit step edge.

    x: distance of the centre of the pixel from the edge, px, positive on the bright side of the edge. angle: direction of the
    normal of the edge, rad.
    """
    if isinstance(optics, GaussianOptics) and isinstance(pixel, BoxPixel):
        return square_edge(x, angle, pixel.half_width, optics.sigma)
    return fourier.step_response(rule_for(optics, x), partial(transfer_along, optics, pixel), x, angle)


def transfer(optics: Optics, pixel: PixelResponse, fx: jax.Array, fy: jax.Array) -> jax.Array:
    """Evaluate the transfer function of lens and pixel at (fx, fy), cycles/px."""
    return optics.otf(fx, fy) * pixel.mtf(fx) * pixel.mtf(fy)


def transfer_along(optics: Optics, pixel: PixelResponse, f: jax.Array, angle: jax.Array) -> jax.Array:
    """Evaluate the transfer function of lens and pixel at f, cycles/px, in the direction `angle`, rad."""
    lens = optics.mtf(f) if optics.isotropic else optics.otf(f * xp.cos(angle), f * xp.sin(angle))
    return lens * pixel.mtf(f * xp.cos(angle)) * pixel.mtf(f * xp.sin(angle))


def rule_for(optics: Optics, x: jax.Array) -> fourier.Rule:
    """Choose frequencies that resolve the kernel at distances x, px."""
    # the transform of the pixel oscillates like 1 px of additional distance
    return optics.frequency_rule(fourier.panels_for(fourier.reach_of(x) + 1, optics.band()))


def square_line(x: jax.Array, angle: jax.Array, half_width: jax.Array, std: jax.Array) -> jax.Array:
    """Compute the value of a square pixel for a Gaussian line, 1/px.

    x, angle: see `line`. half_width, std: px.
    """
    long, sliver, short = _boxes(angle, half_width, std)
    safe = xp.where(sliver, std, short)  # neither the unused branch nor its gradient may divide by 0
    polynomial = _polynomial_difference(lambda u: xp.where(u > 0, u, 0), x, long, safe, far=0.0)
    remainder = _second_difference(lambda u: _first_remainder(u, std), x, long, safe)
    closed = (polynomial + remainder) / (4 * long * safe)
    by_sliver = mean_over_interval(lambda u: gaussian_over_interval(u, long[..., None], std), x, short)
    return xp.where(sliver, by_sliver, closed)


def square_edge(x: jax.Array, angle: jax.Array, half_width: jax.Array, std: jax.Array) -> jax.Array:
    """Compute the value of a square pixel at a blurred edge.

    The edge is a unit step with Gaussian blur. x, angle: see `edge`. half_width, std: px.
    """
    long, sliver, short = _boxes(angle, half_width, std)
    safe = xp.where(sliver, std, short)
    polynomial = _polynomial_difference(
        lambda u: xp.where(u > 0, (xp.square(u) + std**2) / 2, 0), x, long, safe, far=1.0
    )
    remainder = _second_difference(lambda u: _second_remainder(u, std), x, long, safe)
    closed = (polynomial + remainder) / (4 * long * safe)

    def box_edge(u: jax.Array) -> jax.Array:
        wide = long[..., None]
        upper, lower = u + wide, u - wide
        ramp = xp.where(upper > 0, upper, 0) - xp.where(lower > 0, lower, 0)
        # to the right of the box the difference is exactly the width of the box
        ramp = xp.where(lower > 0, 2 * wide, ramp)
        return (ramp + _first_remainder(upper, std) - _first_remainder(lower, std)) / (2 * wide)

    return xp.where(sliver, mean_over_interval(box_edge, x, short), closed)


def edge_and_slopes(
    x: AnyArray, angle: jax.Array, half_width: jax.Array, std: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Evaluate `square_edge` and its derivatives with respect to x and std.

    Fits evaluate these three functions repeatedly. The integral H of the normal distribution function solves the heat
    equation. Therefore one normal distribution function and one density per corner of the square determine all three
    functions. The second difference is evaluated without the split into two parts; it is accurate to 1e-9 of the step
    up to 100 px. x: shape (n,), px. std: one or n values, px. angle, half_width: one value each, rad and px.
    """
    long, _, short = _boxes(angle, half_width, std)
    short = xp.where(short > 1e-3, short, 1e-3)  # px: this adds a blur of 2e-7 px^2 and loses no digits
    signs = np.array([1.0, -1.0, -1.0, 1.0])
    corners = np.array([1.0, 1.0, -1.0, -1.0]) * long + np.array([1.0, -1.0, 1.0, -1.0]) * short
    t = (x + corners[:, None]) / std
    phi, below = normal_density(t), special.ndtr(t)
    first = t * below + phi
    share = std / (4 * long * short)
    return std * share / 2 * (signs @ (t * first + below)), share * (signs @ first), share * (signs @ below)


def _boxes(angle: jax.Array, half_width: jax.Array, std: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Compute the half width of the long box, px, a mask of very short boxes, and the half width of the short box, px."""
    a, b = half_width * xp.abs(xp.cos(angle)), half_width * xp.abs(xp.sin(angle))
    long, short = xp.maximum(a, b), xp.minimum(a, b)
    # for a short half width below 0.05 standard deviations, quadrature replaces the second difference
    return long, short < 0.05 * std, short


def _second_difference(
    function: Callable[[jax.Array], jax.Array], x: jax.Array, long: jax.Array, short: jax.Array
) -> jax.Array:
    return (
        function(x + long + short)
        - function(x + long - short)
        - function(x - long + short)
        + function(x - long - short)
    )


def _polynomial_difference(
    function: Callable[[jax.Array], jax.Array], x: jax.Array, long: jax.Array, short: jax.Array, far: float
) -> jax.Array:
    """Compute the second difference of a function that is 0 for x < 0.

    Outside the boxes the result is exactly 0 on the left, and exactly 4 * far * long * short on the right.
    """
    reach = long + short
    inside = xp.abs(x) < reach
    near = _second_difference(function, xp.where(inside, x, 0.0), long, short)
    return xp.where(inside, near, xp.where(x > 0, far * 4 * long * short, 0.0))


def _first_remainder(x: jax.Array, std: jax.Array) -> jax.Array:
    """Evaluate H(x) - max(x, 0), where H is the integral of the normal distribution function from -infinity to x."""
    t = xp.where(x > 0, x, -x) / std
    return std * (normal_density(t) - t * special.ndtr(-t))


def _second_remainder(x: jax.Array, std: jax.Array) -> jax.Array:
    """Evaluate the integral of H (see `_first_remainder`), less (x^2 + std^2) / 2 for x > 0."""
    # beyond 40 standard deviations the normal density underflows to 0
    t = xp.minimum(xp.where(x > 0, x, -x) / std, 40.0)
    tail = std**2 / 2 * ((t**2 + 1) * special.ndtr(-t) - t * normal_density(t))
    return xp.where(x > 0, -tail, tail)


def mtf50(optics: Optics, pixel: PixelResponse) -> dict[str, float]:
    """Compute the frequency along a row at which the MTF is 0.5.

    Args:
        optics: the lens.
        pixel: response of a pixel.

    Returns:
        Frequency, cycles/px, by the name of each representative lens if the lens varies over colour or field, and by ""
        otherwise; NaN beyond 2 cycles/px.
    """
    lenses = optics.named_lenses if isinstance(optics, VaryingOptics) else {"": optics}
    return {name: _half(lens, pixel) for name, lens in lenses.items()}


def _half(lens: Optics, pixel: PixelResponse) -> float:
    frequency = np.linspace(0, 2, 4001)  # cycles/px; the step is below the standard deviation of any calibration
    passed = np.abs(np.asarray(transfer_along(lens, pixel, xp.asarray(frequency), xp.zeros(frequency.size))))
    below = np.flatnonzero(passed < 0.5)
    if not below.size:
        return float("nan")
    around = [below[0], below[0] - 1]  # the MTF is 1 at frequency 0, and decreases below 0.5 between these indices
    return float(np.interp(0.5, passed[around], frequency[around]))
