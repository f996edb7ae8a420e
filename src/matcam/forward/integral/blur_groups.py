"""Lengths on the sensor that a blur defines. Terms of similar width share their integral."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.core.errors import ArgumentError
from matcam.core.jax import is_concrete, jax
from matcam.forward.integral.blur import Blur
from matcam.forward.integral.kernel_rest import KernelRest
from matcam.lamp.lamps import STEEPEST
from matcam.sample.shape import Curved

_ONE_WIDTH = 1.4
"""Largest ratio of the standard deviations in a group."""
_ONE_WIDTH_OF_TAILS = 1.8
"""Largest ratio beyond the core of a non-Gaussian lens, where shares and thus errors are small."""
_SHARP = 0.7
"""Standard deviation, in half widths of the pixel, below which the borders of the pixel are steps."""
_FOLLOWED = 5.2
"""Support radius of a Gaussian, in standard deviations."""
_REST_NEAR = 1.3
"""Half side of the square around a highlight, in support radii of the residual."""
_REST_SQUEEZED = 0.65
"""Half the distance, in support radii of the residual, beyond which a lobe is a polynomial about a pixel."""
_REST_FINEST, _REST_SPACING = 0.7, 0.18
"""Standard deviation of an equally narrow Gaussian, and step of a record, for the residual, in periods of the cutoff."""
_REST_PANEL = 3
"""Periods between the borders of panels in the support of the residual."""


class BlurScale(NamedTuple):
    """Lengths on the sensor, px, of terms of similar width.

    Attributes:
        near: half the side of the square around the highlight in which the nodes are centred on the half vector.
        squeezed: support radius of the kernel for a squeezed lobe.
        margin: distance from the ends of the light beyond which the surroundings of a pixel are smooth.
        reach: support radius of the kernel.
        reach_in_focus: support radius of the kernel without discs.
        disc: radius of the largest disc out of focus; 0 if it is a Gaussian.
        finest: standard deviation of the narrowest term, without the pixel.
        spacing: step of the grid that resolves a record.
        cuts: offsets inside the support between which the kernel is smooth; () if it is smooth everywhere.
    """

    near: float
    squeezed: float
    margin: float
    reach: float
    reach_in_focus: float
    disc: float
    finest: float
    spacing: float
    cuts: tuple[float, ...]


class BlurGroup(NamedTuple):
    """Terms of a blur of similar width, by index, and their lengths."""

    terms: tuple[int, ...]
    scale: BlurScale


def groups_of(blur: Blur, sample: Curved, turned: bool = False) -> tuple[BlurGroup, ...]:
    """Group the terms of a blur by width. Values must be concrete: ArgumentError inside jit.

    If the pixel is turned relative to the plane of camera and lamp, lengths include its corners.
    """
    lengths = [jax.lax.stop_gradient(a) for a in (blur.stds, blur.pixel.half_width, sample.radius, blur.lamp_radius)]
    if not all(is_concrete(a) for a in lengths):
        raise ArgumentError("the rig's parameters select the integration nodes: call this outside of jax.jit and vmap")
    stds, half = np.asarray(lengths[0]), float(lengths[1])
    disc, added = _widest_spread(blur, sample)
    widened = np.maximum(np.sqrt(stds**2 + added), np.sqrt(stds**2 + added - disc**2 / 4) + disc / _FOLLOWED)
    radius = float(lengths[2])
    if np.min(stds) >= radius:
        raise ArgumentError(
            f"the sample's radius must exceed the camera's blur, of standard deviation {np.min(stds):g} px, got {radius:g} px"
        )
    groups: list[BlurGroup] = []
    left = list(np.argsort(stds))
    while left:
        ratio = _ONE_WIDTH_OF_TAILS if groups and blur.rest is not None else _ONE_WIDTH
        together = [j for j in left if stds[j] <= ratio * stds[left[0]]]
        scale = _scale(half, stds[together], widened[together], turned)
        if blur.chords:
            in_focus = float(np.sqrt(np.max(stds[together]) ** 2 + added - disc**2 / 4))
            scale = scale._replace(
                disc=disc, reach_in_focus=scale.reach + _FOLLOWED * (in_focus - widened[together].max())
            )
        groups.append(BlurGroup(tuple(int(j) for j in together), scale))
        left = left[len(together) :]
    if blur.rest is not None:
        groups.append(BlurGroup((stds.size,), _rest_scale(blur.rest, half, added, turned)))
    return tuple(groups)


def _rest_scale(rest: KernelRest, half: float, added: float, turned: bool) -> BlurScale:
    """Compute the lengths of the residual of the Gaussians. added: variance that focus and lamp add to it, px^2."""
    period = float(rest.period)
    reach = rest.reach_through(added)
    along = reach * (np.sqrt(2) if turned else 1.0)
    panels = int(np.ceil(2 * reach / period / _REST_PANEL))
    cuts = reach * np.linspace(-1, 1, panels + 1)[1:-1]
    return BlurScale(
        near=_REST_NEAR * reach,
        squeezed=_REST_SQUEEZED * reach,
        margin=along,
        reach=along,
        reach_in_focus=along,
        disc=0.0,
        finest=_REST_FINEST * period,
        spacing=_REST_SPACING * np.hypot(period, half),
        cuts=tuple(cuts),
    )


def _scale(half: float, stds: np.ndarray, widened: np.ndarray, turned: bool) -> BlurScale:
    widest, narrowest = float(np.max(widened)), float(np.min(stds))
    std, finest = (float(np.hypot(s, half / np.sqrt(3))) for s in (widest, narrowest))
    corner = half * (np.sqrt(2) - 1) if turned else 0.0
    reach = half + _FOLLOWED * widest + corner
    inner = max(half - _FOLLOWED * widest, half / 4)
    return BlurScale(
        near=10 * std,
        squeezed=reach,
        margin=4.8 * std + corner,
        reach=reach,
        reach_in_focus=reach,
        disc=0.0,
        finest=narrowest,
        spacing=min(0.4 * narrowest, 0.36 * finest),
        cuts=(-half, -inner, inner, half) if narrowest < _SHARP * half else (),
    )


def _widest_spread(blur: Blur, sample: Curved) -> tuple[float, float]:
    """Compute the radius of the largest disc out of focus, px, and the largest variance that it and the lamp add, px^2."""
    if not blur.varies:
        return 0.0, 0.0
    aperture, focus, lamp, radius = (
        float(jax.lax.stop_gradient(a)) for a in (blur.aperture, blur.focus, blur.lamp_radius, sample.radius)
    )
    depth = max(np.cos(focus), 1 - np.cos(focus))
    disc = radius * aperture * depth / 2
    return disc, disc**2 / 4 + (radius * lamp / 4 / STEEPEST) ** 2
