"""Choice of the number of nodes on each arc, for midpoint and Gauss-Legendre rules."""

from __future__ import annotations

import numpy as np

from matcam.forward.sampler.arc_rules import MOST_NODES
from matcam.forward.sampler.arcs import Arcs, Frame
from matcam.forward.sampler.circles import CircleLayout
from matcam.forward.sampler.windows import GRAZING, SphereView, Windows

_ON_ARC, _ON_FULL_ARC = 6.0, 12.0
"""Number of nodes of a Gauss-Legendre rule on a short arc, and of additional nodes on an arc across a window whose kernel
has the fineness 1.
"""
_EVENLY, _EVENLY_PER_SIDE = 4.0, 10.0
"""The same numbers of a midpoint rule. A spacing of h standard deviations of the kernel has a relative error of
exp(-2 pi^2 / h^2), which is 3e-6 for the largest spacing in the image, 1.25.
"""
_EVENLY_PER_DISTANCE, _FEWEST = 5.0, 12.0
"""Number of nodes of a midpoint rule per ratio of length to distance from the highlight, and smallest number of nodes. With
smaller numbers (4 and 8), records of near rigs are off by up to twice the allowed error.
"""
_BESIDE, _PER_DISTANCE, _MOST_DISTANCES = 7.0, 2.5, 8.0
"""Numbers of nodes on an arc beside the highlight: minimum, additional nodes per ratio of the length of the arc to its
distance from the highlight, and largest such ratio.
"""
_LONGEST = 1.3
"""Length of an arc, in sides of its window, above which the number of nodes is constant."""
_PART = 2 * np.pi / 3 + 1e-9
"""Largest part of a circle, rad, that needs the Gauss-Legendre nodes of one arc. A longer arc has the nodes of all its
parts; a whole circle has three parts.
"""


def nodes_on_arcs(
    view: SphereView, windows: Windows, layout: CircleLayout, fineness: float | np.ndarray, elongation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the number of nodes of each arc, and whether they are equally spaced.

    Args:
        view: the sphere and the distances of camera and lamp.
        windows: the windows.
        layout: circles and arcs of the windows.
        fineness: fineness of the kernel (`BlurScale`), a number or (windows,).
        elongation: elongation of the lobe, no unit; see `record_plan`.

    Returns:
        Numbers of nodes, (arcs,); and True for a midpoint rule, False for a Gauss-Legendre rule, (arcs,).
    """
    circle, _, half, vanishes = layout.arcs
    window = layout.circles.window[circle]
    highlight, fine = layout.highlight[window], np.broadcast_to(fineness, windows.x.shape)[window]
    length = 2 * half * np.sin(layout.circles.angle[circle])
    sides = length * view.radius / (2 * windows.half.min(axis=0)[window])
    longer = elongation * _elongation_about(view, windows)[window]
    distances = np.where(np.isfinite(highlight), length / highlight, 2 * half * (longer - 1))
    parts = np.ceil(2 * half / _PART)
    gauss = parts * np.maximum(
        _ON_ARC + _ON_FULL_ARC * fine * np.minimum(sides / parts, _LONGEST),
        _BESIDE + _PER_DISTANCE * np.minimum(distances / parts, _MOST_DISTANCES),
    )
    across = _EVENLY + _EVENLY_PER_SIDE * fine * sides * _largest_step(layout.frame, window, layout.arcs)
    evenly = np.maximum(np.maximum(across, _EVENLY_PER_DISTANCE * distances), _FEWEST)
    evenly, gauss = (2 * np.ceil(needed / 2) for needed in (evenly, gauss))
    chosen = vanishes & (evenly < gauss)
    return np.minimum(np.where(chosen, evenly, gauss), MOST_NODES).astype(int), chosen


def _largest_step(frame: Frame, window: np.ndarray, arcs: Arcs) -> np.ndarray:
    """Compute the largest length in the image of a step of unit length along each arc, no unit.

    This length occurs where the tangent of the arc has the smallest component along the optical axis. frame: frames of
    windows. window: index of the window of each arc.
    """
    (_, _, along), (_, _, across) = frame.first, frame.second
    from_flat = arcs.middle - np.arctan2(across, along)[window]  # azimuth from the position whose tangent has no depth
    nearest = np.abs(from_flat - np.pi * np.rint(from_flat / np.pi)) - arcs.half
    depth = np.hypot(along, across)[window] * np.sin(np.maximum(nearest, 0.0))
    return np.sqrt(1 - depth**2)


def _elongation_about(view: SphereView, windows: Windows) -> np.ndarray:
    """Compute the ratio of the axes of the curves of equal theta_h about the highlights, no unit; 1 in a distant rig.

    A displacement in the plane of incidence rotates the direction to a near lamp or camera less than a displacement
    across this plane, because the projection of the displacement is shorter.
    """
    cosine = np.maximum(np.cos(windows.peak) - view.camera, GRAZING)
    turn = (view.camera / (1 - view.camera) + view.lamp / (1 - view.lamp)) / 2
    return (1 + turn / cosine) / (1 + turn * cosine)
