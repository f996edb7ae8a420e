"""From a picture to the rows that are measured: region, tone curve, colour plane, orientation. NumPy; nothing is resampled.

Whether a region can be measured, in one line that says why not.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from matcam.calibration.photograph.linear_image import SMALLEST

_FLAT_TOP = 0.05  # share at the very same, brightest value, that is worth a look
FEW_TURNS, MANY_TURNS = 2, 8
_ENOUGH_CYCLES = 4.0


class Region(NamedTuple):
    """Rows of samples, turned so that edges are nearer to vertical than to horizontal and their bright sides are right."""

    value: np.ndarray
    """(n, rows, columns) linear; NaN where there is none."""
    y: np.ndarray
    start: np.ndarray
    """(rows,), or (n, rows), px from the region's centre: the row's place, and that of its first sample."""
    step: int
    """px between samples."""
    frame: Frame
    turns: int
    """How often the fits of the edge's profile and of its place take turns: see `turns_for`."""


class Frame(NamedTuple):
    """How regions lie in the picture: numbers or (n,) of them."""

    x: np.ndarray | float
    y: np.ndarray | float
    """px: the region's centre."""
    transposed: np.ndarray | bool
    mirrored: np.ndarray
    """(n,) whether left and right were exchanged, after transposing."""
    length: np.ndarray | float
    """px from the first row to the last."""

    def turned(self, x: np.ndarray | float, y: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """A vector in the turned region, as it lies in the picture."""
        x = np.where(self.mirrored, -1.0, 1.0) * x
        return np.where(self.transposed, y, x), np.where(self.transposed, x, y)


def rows_of(values: np.ndarray, *, mosaic: bool = False) -> Region:
    """Rows of regions (n, height, width) that lie alike: all nearer to vertical than to horizontal, or all the other way.

    mosaic: most values are NaN because the colour has no site there; n is then 1.
    """
    across, along = (_difference(values, axis) for axis in (2, 1))
    height, width = values.shape[1:]
    # the mean gradient is what opposite borders differ by
    transposed = bool(np.abs(along).sum() * width > np.abs(across).sum() * height)
    mirrored = (along if transposed else across) < 0
    turned = values.swapaxes(1, 2) if transposed else values
    if mirrored.any():
        turned = np.where(mirrored[:, None, None], turned[:, :, ::-1], turned)
    height, width = turned.shape[1:]
    y, first, step = np.arange(height) - (height - 1) / 2, np.zeros(height), 1
    if mosaic:  # of a 2 x 2 cell at most two sites, and in a row every other column
        site = np.isfinite(turned[0])
        odd = site[:, 1::2].mean(1) > site[:, ::2].mean(1)
        rows, step = np.flatnonzero(site.mean(1) > 0.25), 2
        turned = np.stack([turned[0, row, int(odd[row]) :: 2][: width // 2] for row in rows])[None]
        y, first = y[rows], odd[rows].astype(float)
    value = np.full((len(turned), padded(turned.shape[1]), padded(turned.shape[2])), np.nan)
    value[:, : turned.shape[1], : turned.shape[2]] = turned
    more = (0, value.shape[1] - turned.shape[1])
    frame = Frame((values.shape[2] - 1) / 2, (values.shape[1] - 1) / 2, transposed, mirrored, float(np.ptp(y)))
    start = np.pad(first, more) - (width - 1) / 2
    return Region(value, np.pad(y, more), start, step, frame, MANY_TURNS if mosaic else FEW_TURNS)


def turns_for(cycles: float) -> int:
    """By how often an edge's rows see every phase: profile and place come apart slowly where that is less than a few times."""
    return FEW_TURNS if cycles >= _ENOUGH_CYCLES else MANY_TURNS


def _difference(values: np.ndarray, axis: int) -> np.ndarray:
    """(n,) of the borders at both ends of an axis."""
    last, first = (np.take(values, places, axis).reshape(len(values), -1) for places in ((-1, -2), (0, 1)))
    if np.isfinite(values).all():
        return last.mean(1) - first.mean(1)
    return np.nanmean(last, 1) - np.nanmean(first, 1)


def flaws(values: np.ndarray) -> list[str]:
    """`flaw` of every region of a stack (n, height, width), the quick way where there is none."""
    low, high = values.min((1, 2)), values.max((1, 2))
    share = (values == high[:, None, None]).mean((1, 2))
    doubtful = ~((low < high) & (share <= _FLAT_TOP))  # NaN is doubtful
    return [flaw(value) if look else "" for value, look in zip(values, doubtful, strict=True)]


def flaw(values: np.ndarray) -> str:
    """Why nothing can be measured in a region (height, width), in one line; empty if something might."""
    used = values[np.isfinite(values)]
    if used.size < SMALLEST**2 / 4:
        return f"region holds {used.size} usable samples: too few"
    low, high = used.min(), used.max()
    if not low < high:
        return f"region is all one value, {low:g}: there is no edge in it"
    if (used == high).mean() > _FLAT_TOP:
        # noise piles up at the end of a range, and nowhere else; without noise the dark side is as flat
        middle = (low + high) / 2
        flat = (used == high).sum() / (used > middle).sum()
        dark = np.unique(used[used <= middle], return_counts=True)[1]
        if dark.max() / dark.sum() < flat / 2:
            return f"region is saturated: {flat:.0%} of its bright samples have the very same value, {high:g}"
    return ""


def padded(size: int) -> int:
    """The next of 8, 10, 12 or 14 times a power of two: regions of nearly one size share one compiled program."""
    power = 1
    while True:
        for eighths in (8, 10, 12, 14):
            if eighths * power >= size:
                return eighths * power
        power *= 2


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
