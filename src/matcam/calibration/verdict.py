"""Whether a region can be measured, in one line that says why not."""

from __future__ import annotations

from typing import Any

import numpy as np

from matcam.calibration.region import Region

_LEAST_ROWS = 10
_LEAST_CONTRAST = 3.0  # standard deviations of a pixel
_WIDEST_GAP = 0.55  # px: sampling the edge more coarsely leaves the MTF50 of a sharp lens undetermined
_OVERSHOOT, _SIGNIFICANT = 0.02, 5.0  # of the step, standard deviations
_BLUR = 0.2  # of the region's width: widest standard deviation of the line spread function


def refusals(found: Any, region: Region, *, accept_sharpened: bool) -> list[str]:
    """For each edge of a stack why it cannot be measured; empty if it can. found: the stack's `Measurement`."""
    dark, bright = found.state.linear[:, 0], found.state.linear[:, 1]
    contrast = (bright - dark) / np.maximum(found.residual, 1e-300)
    blur = np.hypot(found.free.shape.sigma, found.free.shape.half_width / np.sqrt(3))
    over, least = found.overshoot.value, np.maximum(_OVERSHOOT, _SIGNIFICANT * found.overshoot.std)
    width = region.step * (region.value.shape[2] - 1)
    lost = ~np.isfinite(contrast + blur + over + least) | (found.crossing < _LEAST_ROWS)
    gap = largest_gap(region, np.where(lost[:, None], 0.0, found.curve))

    def why(i: int) -> str:
        if lost[i]:
            return "no edge that crosses the region from one side to the other was found in it"
        if contrast[i] < _LEAST_CONTRAST:
            return f"no edge was found in the region: its step is {contrast[i]:.1f} times the scatter about it"
        if gap[i] > _WIDEST_GAP:
            return (
                f"phases are missing: an edge at {np.degrees(np.arctan(abs(found.curve[i, 1]))):.1f} degrees to the grid "
                f"passes all pixels at the same places ({gap[i]:.2f} px apart): turn the target by a few degrees"
            )
        if blur[i] > _BLUR * width:
            return f"region of {width:.0f} px is too narrow for an edge whose blur has a standard deviation of {blur[i]:.1f} px"
        if not accept_sharpened and over[i] > least[i]:
            return (
                f"picture is sharpened: the edge overshoots its levels by {over[i]:.1%}, which no lens does; use the raw "
                "picture, or accept the MTF of lens and sharpening together (accept_sharpened=True, --accept-sharpened)"
            )
        return ""

    return [why(i) for i in range(len(lost))]


def largest_gap(region: Region, curves: np.ndarray) -> np.ndarray:
    """(n,) px: the widest interval of distances to each edge in which there is no sample. curves: (n, 3)."""
    place = curves[:, :1] + region.y * (curves[:, 1:2] + region.y * curves[:, 2:])
    offset = (place - region.start) / region.step
    nearest = np.clip(np.rint(offset), 0, region.value.shape[2] - 1).astype(int)
    there = np.isfinite(np.take_along_axis(region.value, nearest[..., None], axis=2)[..., 0])
    crossed = there & (np.abs(offset - nearest) <= 0.5)
    # rows that the edge does not cross stand beyond the last phase
    phase = np.sort(np.where(crossed, offset % 1.0, 2.0), axis=1)
    last = np.take_along_axis(phase, np.maximum(crossed.sum(1, keepdims=True) - 1, 0), axis=1)[:, 0]
    steps = np.where(phase[:, 1:] < 2, np.diff(phase, axis=1), 0.0).max(axis=1)
    widest = np.maximum(steps, phase[:, 0] + 1 - last)
    return np.where(crossed.any(1), widest * region.step / np.hypot(1, curves[:, 1]), np.inf)
