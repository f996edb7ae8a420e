"""Integration nodes in an image of a sphere, dense about a sharp highlight.

Positions on the disc of the outline are p = (cos v sin u, sin v), with u and v in rad. In u and v, a lobe has similar
widths along the plane of incidence and across it, independent of foreshortening. All functions of u and v are smooth at
the outline (u = pi / 2). A product of nodes in u and v therefore suits a highlight at any position. The spacing of the
nodes follows the lobe near its peak, and is at most half a pixel elsewhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from matcam.acquisition.mirror_ball import MirrorBall
from matcam.camera.lens_field import LensField
from matcam.numerics.approximation import nodes_in_panels

NODES = 112
"""Number of nodes along each axis of a window."""
WINDOW = 33
"""Number of pixels along each axis of a window."""
_ORDER = 8
_PEAK_STEP = 0.25  # spacing of nodes near the peak, in asinh(angle / scale of the lobe)
_PIXEL_STEP = 0.5  # spacing of nodes elsewhere, px: at the inverse of this distance the MTF of a pixel is 0
_LIMB_STEP = 0.04  # spacing of nodes near the outline, rad
_LIMB = 0.35  # distance from the outline within which this spacing is used, rad
MARGIN = 4.5
"""Margin of the nodes about the pixels of a window, px."""


class Window(NamedTuple):
    """Integration nodes and pixels of the window about one highlight.

    The u axis is parallel to the axis of the column index, or to that of the row index if `turned` is 1. A lens with
    distortion maps a position along (u, v) to stretch @ position + shift. The disc of nodes is rotated by `tilt`, so that
    the images of nodes of equal v lie on one line of pixels.

    Attributes:
        u: nodes, rad, (NODES,).
        v: nodes, rad, (NODES,).
        weight: weights of the nodes on the disc of the outline, of radius 1, (NODES, NODES), v before u.
        pixel_u: columns of the pixels, or their rows if `turned` is 1, px, (WINDOW,).
        pixel_v: rows of the pixels, or their columns if `turned` is 1, px, (WINDOW,).
        turned: 1.0 if u is parallel to the axis of the row index, else 0.0.
        stretch: derivatives of the distorted position with respect to the undistorted position, (2, 2). Default: the unit
            matrix.
        shift: constant part of the distorted position, px, (2,). Default: 0.
        tilt: rotation of the disc of nodes, rad. Default: 0.
        widened: width of the lens at the highlight, relative to that of its profile, no unit. Default: 1.
    """

    u: np.ndarray
    v: np.ndarray
    weight: np.ndarray
    pixel_u: np.ndarray
    pixel_v: np.ndarray
    turned: float
    stretch: np.ndarray = np.eye(2)
    shift: np.ndarray = np.zeros(2)
    tilt: float = 0.0
    widened: float = 1.0


def window_about(
    ball: MirrorBall,
    highlight: tuple[float, float],
    *,
    scale: float,
    plateau: float = 0.0,
    keep: Window | None = None,
    field: LensField | None = None,
) -> Window:
    """Build the window about a highlight.

    Args:
        ball: the sphere, without the distortion of the lens.
        highlight: column and row of the highlight, px, without the distortion of the lens.
        scale: angle over which the lobe changes near its peak, rad.
        plateau: angle over which a source disc spreads the peak, half the angular radius of the lamp, rad. Default: 0.
        keep: earlier window, whose pixels are kept if the highlight has moved by at most one pixel. Default: None.
        field: distortion and blur of the lens over the field. Default: None, uniform.

    Returns:
        Window with nodes and pixels, and with the affine map of the lens if there is a field.
    """
    column, row = highlight
    radius = ball.radius
    p_x, p_y = (column - ball.column) / radius, (ball.row - row) / radius
    turned = abs(p_y) > abs(p_x)
    along, across = (p_y, p_x) if turned else (p_x, p_y)
    if field is not None:
        tilt = _tilt(field, highlight, turned)
        column, row = map(float, field.seen_at(*highlight))
        cos, sin = np.cos(tilt), np.sin(tilt)
        along, across = along * cos + across * sin, across * cos - along * sin
    column, row = np.round(column), np.round(row)
    if keep is not None and keep.turned == turned:
        old = (keep.pixel_u[WINDOW // 2], keep.pixel_v[WINDOW // 2])
        old_column, old_row = old[::-1] if turned else old
        if max(abs(old_column - column), abs(old_row - row)) <= 1:
            column, row = old_column, old_row
    span = np.arange(WINDOW) - WINDOW // 2
    pixel_u, pixel_v = (row + span, column + span) if turned else (column + span, row + span)
    reach = (WINDOW // 2 + 1 + MARGIN) / radius
    peak_v = np.arcsin(np.clip(across, -1, 1))
    peak_u = np.arcsin(np.clip(along / max(np.cos(peak_v), 1e-6), -1, 1))
    low_v, high_v = (np.arcsin(np.clip(across + side * reach, -1, 1)) for side in (-1, 1))
    # rows of the window are chords of different length, and the longest row determines the range of u
    chord = np.cos([low_v, peak_v, high_v])
    chord = np.maximum(chord, 1e-3)
    low_u = np.arcsin(np.clip((along - reach) / chord, -1, 1)).min()
    high_u = np.arcsin(np.clip((along + reach) / chord, -1, 1)).max()
    v, weight_v = graded_nodes(low_v, high_v, peak_v, scale, plateau, radius)
    u, weight_u = graded_nodes(
        low_u, high_u, peak_u, scale / np.cos(peak_v), plateau / np.cos(peak_v), radius * np.cos(peak_v)
    )
    weight = (np.cos(v) ** 2 * weight_v)[:, None] * (np.cos(u) * weight_u)[None, :]
    window = Window(u, v, weight, pixel_u, pixel_v, float(turned))
    return window if field is None else through_lens(window, field, highlight)


def through_lens(window: Window, field: LensField, highlight: tuple[float, float]) -> Window:
    """Compute the affine map of a lens near a highlight, and replace that of a window.

    Args:
        window: window whose nodes and pixels are kept.
        field: distortion and blur of the lens over the field.
        highlight: column and row of the highlight, px, without distortion.
    """
    seen, stretch, true = np.array(field.seen_at(*highlight)), field.stretch(*highlight), np.array(highlight)
    turned = window.turned > 0
    if turned:
        seen, stretch, true = seen[::-1], stretch[::-1, ::-1], true[::-1]
    return window._replace(
        stretch=np.ascontiguousarray(stretch),
        shift=seen - stretch @ true,
        tilt=_tilt(field, highlight, turned),
        widened=field.blur_scale(*highlight),
    )


def _tilt(field: LensField, highlight: tuple[float, float], turned: bool) -> float:
    """Compute the rotation of the nodes, rad, that aligns nodes of equal v with lines of pixels."""
    stretch = field.stretch(*highlight)
    if turned:
        stretch = stretch[::-1, ::-1]
    return float(np.arctan2(stretch[1, 0], stretch[1, 1]))


def graded_nodes(
    low: float, high: float, peak: float, scale: float, plateau: float, radius: float, nodes: int = NODES
) -> tuple[np.ndarray, np.ndarray]:
    """Compute nodes, rad, and weights in [low, high], from Gauss-Legendre panels with equal integrals of a node density.

    The density increases about the peak of the lobe and near the limb.

    Args:
        low: lower end of the interval, rad.
        high: upper end of the interval, rad.
        peak: position of the peak of the lobe, rad.
        scale: angle over which the lobe changes near its peak, rad.
        plateau: angle over which a source disc spreads the peak, rad.
        radius: radius of the outline, px, which determines the largest spacing.
        nodes: number of nodes. Default: `NODES`.
    """

    def share(t: np.ndarray) -> np.ndarray:
        aside = t - peak
        beyond = np.sign(aside) * np.arcsinh(np.maximum(np.abs(aside) - plateau, 0) / scale) / _PEAK_STEP
        within = np.clip(aside, -plateau, plateau) / (scale * _PEAK_STEP)
        limb = np.clip(np.abs(t) - (np.pi / 2 - _LIMB), 0, None) * np.sign(t) / _LIMB_STEP
        return beyond + within + limb + radius * np.sin(t) / _PIXEL_STEP

    # inverse of the cumulative share, from a table that is dense where the share is steep
    near = scale * np.sinh(np.linspace(0, np.arcsinh(np.pi / scale), 400))
    offsets = np.concatenate([-near[:0:-1], near])
    table = np.concatenate(
        [[low, high], peak + offsets + plateau, peak + offsets - plateau, np.linspace(low, high, 400)]
    )
    table = np.unique(np.clip(table, low, high))
    shares = share(table)
    borders = np.interp(np.linspace(shares[0], shares[-1], nodes // _ORDER + 1), shares, table)
    borders[0], borders[-1] = low, high
    return nodes_in_panels(borders, _ORDER)


def lamp_disc(points: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute positions on the unit disc, (points, 2), and their weights, (points,), whose sum is 1.

    The positions are the centre, or rings of 6, 12, 18, ... positions of a quadrature rule of degree 5 or more.

    Args:
        points: required number of positions; 1 for the centre. The rings may contain more positions.
    """
    if points <= 1:
        return np.zeros((1, 2)), np.ones(1)
    rings = int(np.ceil((np.sqrt(1 + 4 * (points - 1) / 3) - 1) / 2))
    x, w = np.polynomial.legendre.leggauss(rings)
    positions, weights = [], []
    for ring in range(rings):
        count = 6 * (ring + 1)
        angle = 2 * np.pi * (np.arange(count) + 0.5 * (ring % 2)) / count
        radius = np.sqrt((1 + x[ring]) / 2)  # Gauss rule in the square of the radius, for equal areas
        positions.append(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
        weights.append(np.full(count, w[ring] / 2 / count))
    return np.concatenate(positions), np.concatenate(weights)


def lamp_positions(lamp_radius: float, width: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Choose the positions on a source disc: its centre alone if the disc is much smaller than the lobe.

    Args:
        lamp_radius: angular radius of the lamp, rad.
        width: width of the lobe, rad or a slope.

    Returns:
        Positions as rotations of the direction to the lamp, rad, (points, 2); weights of the positions, whose sum is 1,
        (points,); and the angle over which the disc spreads the peak of a lobe, rad.
    """
    # a disc of less than a tenth of the width of the lobe is a point
    radius = lamp_radius if lamp_radius / 2 > 0.1 * width else 0.0
    positions, weights = lamp_disc(36 if radius else 1)
    return positions * radius, weights, radius / 2
