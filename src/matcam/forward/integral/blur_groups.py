"""Groups of blur terms of similar width, which share quadrature nodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax
from matcam.forward.integral.blur import Blur
from matcam.lamp.lamps import STEEPEST
from matcam.sample.shape import Curved

_ONE_WIDTH = 1.4
"""Largest ratio of the standard deviations in a group."""
_ONE_WIDTH_OF_TAILS = 1.8
"""Largest ratio in the wider groups of a non-Gaussian lens, whose weights and therefore errors are small."""
_FOLLOWED = 5.2
"""Support radius of a Gaussian, in standard deviations."""
_REST_NEAR = 1.3
"""Half side of the square around a highlight, in support radii of the residual."""
_WIDTHS, _PERIODS = 6.2, 1.8
"""Support radius of a kernel with the fineness 1: in standard deviations of its narrowest Gaussian, and for a residual in
periods of its highest frequency.
"""


class BlurScale(NamedTuple):
    """Lengths on the sensor and fineness for the quadrature of terms of similar width.

    Attributes:
        near: half the side of the square around the highlight, px. For pixels in this square, the nodes are arranged about
            the half vector.
        margin: distance from limb and terminator beyond which the radiance around a pixel is smooth, px.
        reach: support radius of the kernel, px.
        fineness: required number of nodes across the support of the kernel divided by the number for a Gaussian of 0.5
            px with a pixel of 1 px, no unit; at least 1.
    """

    near: float
    margin: float
    reach: float
    fineness: float


class BlurGroup(NamedTuple):
    """Group of terms of a blur with similar widths.

    Attributes:
        terms: indices of the terms.
        scale: lengths on the sensor and fineness for the quadrature of the terms.
    """

    terms: tuple[int, ...]
    scale: BlurScale


def groups_of(blur: Blur, sample: Curved) -> tuple[BlurGroup, ...]:
    """Group the terms of a blur by width.

    An ArgumentError is raised if parameters are traced by jax.jit, or if the sample is smaller than the blur.
    """
    lengths = [jax.lax.stop_gradient(a) for a in (blur.stds, blur.pixel.half_width, sample.radius, blur.lamp_radius)]
    if not all(is_concrete(a) for a in lengths):
        raise ArgumentError(
            "the rig must have concrete parameters, because they determine the integration nodes: call this function "
            "outside jax.jit and jax.vmap"
        )
    stds, half = np.asarray(lengths[0]), float(lengths[1])
    disc, added = _widest_spread(blur, sample)
    widened = np.maximum(np.sqrt(stds**2 + added), np.sqrt(stds**2 + added - disc**2 / 4) + disc / _FOLLOWED)
    sample.check_resolved(max(half, float(np.min(stds))))
    groups: list[BlurGroup] = []
    left = list(np.argsort(stds))
    while left:
        ratio = _ONE_WIDTH_OF_TAILS if groups and blur.residual is not None else _ONE_WIDTH
        together = [j for j in left if stds[j] <= ratio * stds[left[0]]]
        groups.append(_group(blur, tuple(int(j) for j in together), half, float(np.max(widened[together]))))
        left = left[len(together) :]
    if blur.residual is not None:
        groups.append(_residual_group(blur, stds.size, float(blur.residual.reach_through(added))))
    return tuple(groups)


def fineness_of(blur: Blur, reach: np.ndarray | float) -> np.ndarray:
    """Compute the fineness of a blur that consists of Gaussians or of a residual, see `BlurScale`.

    reach: support radius, px, of any shape.
    """
    if blur.residual is not None:
        return np.maximum(reach / float(blur.residual.period) / _PERIODS, 1.0)
    return np.maximum(reach / float(np.min(jax.lax.stop_gradient(blur.stds))) / _WIDTHS, 1.0)


def _group(blur: Blur, terms: tuple[int, ...], half: float, widest: float) -> BlurGroup:
    """Build a group of Gaussians. widest: largest standard deviation with defocus and source disc, px."""
    std, reach = float(np.hypot(widest, half / np.sqrt(3))), half + _FOLLOWED * widest
    return BlurGroup(terms, BlurScale(10 * std, 4.8 * std, reach, float(fineness_of(blur.only(terms), reach))))


def _residual_group(blur: Blur, term: int, reach: float) -> BlurGroup:
    return BlurGroup(
        (term,), BlurScale(_REST_NEAR * reach, reach, reach, float(fineness_of(blur.only((term,)), reach)))
    )


def _widest_spread(blur: Blur, sample: Curved) -> tuple[float, float]:
    """Compute the largest radius of a disc out of focus, px, and the largest variance, px^2, of defocus plus source disc."""
    if not blur.varies:
        return 0.0, 0.0
    aperture, focus, lamp, radius = (
        float(jax.lax.stop_gradient(a)) for a in (blur.aperture, blur.focus, blur.lamp_radius, sample.radius)
    )
    depth = max(np.cos(focus), 1 - np.cos(focus))
    disc = radius * aperture * depth / 2
    return disc, disc**2 / 4 + (radius * lamp / 4 / STEEPEST) ** 2
