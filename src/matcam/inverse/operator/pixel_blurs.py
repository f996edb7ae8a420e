"""Blurs of a rig in the pixels of cells: widening by lamp and defocus, support, and images of a source disc."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from matcam.forward.integral.blur import Blur, variances_at
from matcam.inverse.operator.lamp_lines import LampDisc, lamp_discs
from matcam.inverse.operator.sample_view import SampleView
from matcam.inverse.operator.sphere_rule import kernel_reach
from matcam.inverse.rig.rig_blurs import MovedBlur
from matcam.rigs import Rig

_INSIDE = 1 - 1e-9
"""Largest distance from the centre of the sample, in radii, at which defocus is computed, just inside the limb."""


class PixelBlurs(NamedTuple):
    """Blurs of a rig in each pixel, widened by lamp and defocus.

    They include the blurs at points of the parameter axes and the blurs for changes of the lens.

    Attributes:
        blurs: the blurs. If the blur of the rig is among them, it is the first.
        spreads: variances that are added to each blur along x and y, (pixels,) each, px^2.
        reaches: half sides of the window of each kernel along the axes of the pixel, (2, pixels), px.
        discs: source disc of each blur; None: a point source, or a disc that is part of the spreads.
        lamps: angular radius of the source disc of each blur, rad.
        columns: index of each blur among all blurs whose rules are computed.
    """

    blurs: list[Blur]
    spreads: list[tuple[np.ndarray, ...]]
    reaches: list[np.ndarray]
    discs: list[LampDisc | None]
    lamps: list[float]
    columns: tuple[int, ...]

    def of(self, piece: slice) -> PixelBlurs:
        """Select a subset of pixels."""
        return self._replace(
            spreads=[tuple(v[piece] for v in spread) for spread in self.spreads],
            reaches=[reach[:, piece] for reach in self.reaches],
            discs=[disc and LampDisc._make(a[piece] for a in disc) for disc in self.discs],
        )


def gaussian_blurs(
    view: SampleView,
    rig: Rig,
    moved: list[MovedBlur],
    pixels: tuple[np.ndarray, np.ndarray, np.ndarray],
    lenses: list[float],
) -> PixelBlurs:
    """Build the Gaussians of a group of terms.

    A source disc much smaller than the blur is approximated by a Gaussian.

    Args:
        view: geometry of sample, camera and lamp.
        rig: the rig.
        moved: blurs at the points of the axes.
        pixels: x and y, px, and lamp angle, rad, of each pixel.
        lenses: standard deviation of a Gaussian that is as sharp as the lens of each blur, px. Some Gaussians of a lens may be
            narrower or have negative weights, but their sum is not sharper.
    """
    x, y, lamp_angle = pixels
    blurs, rough, stretch = ([getattr(one, name) for one in moved] for name in MovedBlur._fields)
    lamps = [float(blur.lamp_radius) for blur in blurs]
    if view.line:
        blurs = [blur.of_point() for blur in blurs]
    stds = [max(lens, float(np.min(np.asarray(blur.stds)))) for lens, blur in zip(lenses, blurs, strict=True)]
    exact = [blur.of_point() if one else blur for blur, one in zip(blurs, rough, strict=True)]
    discs, aside = lamp_discs(view, exact, stds, lamp_angle, x, y)
    chords = max(blur.chords for blur in blurs)
    if any(disc is not None for disc in discs) or (view.line and any(lamps)):
        blurs, chords = [blur if one else blur.of_point() for blur, one in zip(blurs, rough, strict=True)], 0
    elif view.azimuth and any(float(blur.lamp_radius) > 0 for blur in blurs):
        chords = 0  # a small source disc and defocus add Gaussians along rotated axes
    # one compiled program for all blurs; a variance that is common to all nodes halves the computing time
    if np.any(stretch) or any(blur.varies for blur in exact):
        blurs = [dataclasses.replace(blur, varies=True, chords=chords) for blur in blurs]
    spreads = [_variances(view, rig, blur, pixels, more) for blur, more in zip(blurs, stretch, strict=True)]
    half_width = float(rig.camera.pixel.half_width)
    widest = [np.asarray(blur.stds).max() for blur in blurs]
    reaches = [
        kernel_reach(half_width, np.sqrt(s**2 + np.maximum(*v))) + m + _widest_disc(view, blur, x, y, s)
        for s, v, m, blur in zip(widest, spreads, aside, blurs, strict=True)
    ]
    if any(rough):  # approximated discs do not widen the range of the nodes, so that the other blurs stay accurate
        seen = np.max([reach for reach, one in zip(reaches, rough, strict=True) if not one], axis=0)
        reaches = [np.minimum(reach, seen) for reach in reaches]
    return PixelBlurs(blurs, spreads, reaches, discs, lamps, tuple(range(len(blurs))))


def residual_blurs(
    view: SampleView, rig: Rig, moved: list[MovedBlur], pixels: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> PixelBlurs:
    """Build the residuals of the lenses beyond their Gaussians.

    The residuals are small. Source disc and defocus are approximated by Gaussians, and the changes along an axis are
    neglected.

    pixels: x and y, px, and lamp angle, rad, of each pixel.
    """
    variances, reaches, blurs = [], [], [one.blur for one in moved]
    for blur in blurs:
        added = _variances(view, rig, blurs[0] if blur.residual is blurs[0].residual else blur, pixels)
        variances.append(added)
        reaches.append(blur.residual.reach_through(np.stack(added)))  # type: ignore[union-attr]
    varies = any(np.any(added) for added in variances)
    blurs = [dataclasses.replace(blur, varies=varies, chords=0) for blur in blurs]
    return PixelBlurs(blurs, variances, reaches, [None] * len(blurs), [0.0] * len(blurs), tuple(range(len(blurs))))


def _variances(
    view: SampleView,
    rig: Rig,
    blur: Blur,
    pixels: tuple[np.ndarray, np.ndarray, np.ndarray],
    more: tuple[float, float] = (0.0, 0.0),
) -> tuple[np.ndarray, ...]:
    """Compute the variances that lamp, defocus and stretch add along x and y, px^2.

    more: variances due to the stretch along x and y, px^2.
    """
    x, y, lamp_angle = pixels
    added = variances_at(blur, rig.sample, view.on_sphere.normals(x, y)[2], lamp_angle, rig.lamp.nearness)  # type: ignore[arg-type]
    return tuple(variance + one for variance, one in zip(added, more, strict=True))


def _widest_disc(view: SampleView, blur: Blur, x: np.ndarray, y: np.ndarray, std: float) -> np.ndarray:
    """Compute the radius of the largest circle of confusion for each pixel, px; 0 if defocus is Gaussian."""
    if not blur.chords:
        return np.zeros(x.shape)

    def disc(off: np.ndarray) -> np.ndarray:
        depth = view.on_sphere.normals(np.clip(off, 0, _INSIDE * view.radius), np.zeros(off.shape))[2]
        return np.abs(np.asarray(blur.defocus(view.radius, depth)))

    off, everywhere = np.hypot(x, y), disc(np.array([0.0, view.radius])).max()
    reach = kernel_reach(float(blur.pixel.half_width), np.asarray(std)) + everywhere
    return np.maximum(disc(off - reach), disc(off + reach))
