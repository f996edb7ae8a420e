"""Regions as rows of samples across an edge, and checks of the measured edges.

A region is transposed and mirrored so that its edge is closer to vertical than to horizontal, and its bright side is on
the right. The pixels are not resampled. For a mosaic, the rows contain the sites of one colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from matcam.calibration.edge.free_curve import GLARE, ghost_of, line_width
from matcam.calibration.edge.free_fit import VEIL
from matcam.calibration.edge.geometry import CURVE, edge_distance, legendre
from matcam.calibration.edge.measurement import EdgeFits
from matcam.calibration.photograph.flat_noise import flat_noise
from matcam.calibration.photograph.linear_image import LinearImage, measurable_region
from matcam.calibration.photograph.tone import Tone
from matcam.calibration.photograph.unnamed_mosaic import refuse_unnamed_mosaic
from matcam.core.errors import RegionError
from matcam.core.remark import Remark
from matcam.files.photographs import Photograph
from matcam.numerics.normal import SIGNIFICANT, robust_std

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray

SHARPENED = 0.02
"""Overshoot, relative to the step, above which an edge is assumed to be sharpened. A lens does not cause an overshoot."""
MISFIT = 0.002
"""Misfit near the edge, relative to the step, above which a remark is given. A lens does not cause such a misfit."""
CLEAR = 4.6
"""Distance of an edge from the borders of the region below which the levels are uncertain, in standard deviations of its
blur."""


class RegionFrame(NamedTuple):
    """Position and orientation of one region in the image, or of n regions (n,).

    Attributes:
        x: x of the centre of the region, px.
        y: y of the centre of the region, px.
        transposed: whether rows and columns were exchanged.
        mirrored: whether left and right were exchanged, after transposing.
        length: distance from the first row to the last, px.
    """

    x: np.ndarray | float
    y: np.ndarray | float
    transposed: np.ndarray | bool
    mirrored: np.ndarray
    length: np.ndarray | float

    def in_picture(self, x: np.ndarray | float, y: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Transform a vector (x, y) from the axes of the region to those of the image, without translation."""
        x = np.where(self.mirrored, -1.0, 1.0) * x
        return np.where(self.transposed, y, x), np.where(self.transposed, x, y)


class EdgeRegions(NamedTuple):
    """Rows of samples of n regions.

    The regions are transposed and mirrored so that their edges are closer to vertical than to horizontal, with the
    bright side on the right.

    Attributes:
        value: (n, rows, columns) linear values; NaN for missing samples.
        y: (n, rows) position of each row from the centre of the region, px.
        start: (n, rows) position of the first sample of each row from the centre of the region, px.
        step: distance of neighbouring samples, px.
        frame: position and orientation of the regions in the image.
        turns: number of alternating fits of the profile and of the position of the edge.
    """

    value: np.ndarray
    y: np.ndarray
    start: np.ndarray
    step: int
    frame: RegionFrame
    turns: int

    def coordinates(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute x and y of all samples relative to the centres of the regions, (n, rows, columns) px."""
        x = self.start[..., None] + self.step * np.arange(self.value.shape[2])
        return x, np.broadcast_to(self.y[..., None], x.shape)

    def positions(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute x and y of all samples in the image, (n, rows, columns) px."""
        frame = RegionFrame(*(np.reshape(column, (-1, 1, 1)) for column in self.frame))
        x, y = frame.in_picture(*self.coordinates())
        return frame.x + x, frame.y + y

    def distances(self, i: int, curve: AnyArray, length: AnyArray) -> np.ndarray:
        """Compute the distances of the samples of region i from an edge, (rows, columns) px.

        `curve`, `length`: as in `EdgeFits`.
        """
        x, _ = self.coordinates()
        return np.asarray(edge_distance(curve, x[i], legendre(self.y[i] / length, CURVE), length))

    def crossings(self, fits: EdgeFits) -> np.ndarray:
        """Compute the x (n, rows) at which the edges of all regions cross the rows, px from the centres of the regions."""
        powers = legendre(self.y / fits.length[:, None], CURVE)
        return np.einsum("nk,knr->nr", np.nan_to_num(fits.curve), powers)


def edge_region(
    image: ArrayLike | Photograph | LinearImage,
    roi: Sequence[int] | None,
    channel: str | None,
    cfa: str | None,
    tone: Tone,
) -> tuple[LinearImage, EdgeRegions]:
    """Convert an image region that contains one edge to a linear plane and to rows.

    The arguments are those of `LinearImage.of`. A FitError is raised if the region cannot be measured, for example
    because it is too large or saturated. An ArgumentError is raised if the region is outside the image or too small.
    """
    region = measurable_region(LinearImage.of(image, channel, cfa, tone, roi))
    height, width = region.values.shape
    # The search for structure in larger regions requires much time and memory.
    if height * width > (largest := 1 << 22):
        raise RegionError(
            f"a region of {width} x {height} px is too large for one edge: choose a region of at most {largest} pixels"
        )
    refuse_unnamed_mosaic(region)
    return region, edge_regions(region.values[None], mosaic=region.cfa is not None)


def edge_regions(values: np.ndarray, *, mosaic: bool = False) -> EdgeRegions:
    """Convert regions (n, height, width) to rows.

    Either all edges must be closer to vertical than to horizontal, or all edges must be closer to horizontal. `mosaic`:
    whether most values are NaN, because the colour has no sites at these pixels; n is then 1.
    """
    across, along = (_difference(values, axis) for axis in (2, 1))
    height, width = values.shape[1:]
    # The mean gradient follows from the difference between opposite borders.
    transposed = bool(np.abs(along).sum() * width > np.abs(across).sum() * height)
    mirrored = (along if transposed else across) < 0
    turned = values.swapaxes(1, 2) if transposed else values
    if mirrored.any():
        turned = np.where(mirrored[:, None, None], turned[:, :, ::-1], turned)
    height, width = turned.shape[1:]
    y, first, step = np.arange(height) - (height - 1) / 2, np.zeros(height), 1
    if mosaic:  # a 2 x 2 cell has at most two sites of a colour, in every other row or column
        site = np.isfinite(turned[0])
        odd = site[:, 1::2].mean(1) > site[:, ::2].mean(1)
        rows, step = np.flatnonzero(site.mean(1) > 0.25), 2
        turned = np.stack([turned[0, row, int(odd[row]) :: 2][: width // 2] for row in rows])[None]
        y, first = y[rows], odd[rows].astype(float)
    value = np.full((len(turned), program_size(turned.shape[1]), program_size(turned.shape[2])), np.nan)
    value[:, : turned.shape[1], : turned.shape[2]] = turned
    more = (0, value.shape[1] - turned.shape[1])
    frame = RegionFrame((values.shape[2] - 1) / 2, (values.shape[1] - 1) / 2, transposed, mirrored, float(np.ptp(y)))
    start = np.pad(first, more) - (width - 1) / 2
    y, start = (np.broadcast_to(a, value.shape[:2]) for a in (np.pad(y, more), start))
    return EdgeRegions(value, y, start, step, frame, turns_for(0.0 if mosaic else np.inf))


def turns_for(cycles: float) -> int:
    """Select the number of alternating fits of profile and position.

    `cycles`: number of times that the rows sample every phase. With few cycles, profile and position converge slowly.
    """
    return 2 if cycles >= 4.0 else 8


def program_size(size: int) -> int:
    """Round a size up to the next size for which a program is compiled.

    Such a size is 8, 10, 12 or 14 times a power of two, so that similar sizes share one program.
    """
    power = 1
    while True:
        for eighths in (8, 10, 12, 14):
            if eighths * power >= size:
                return eighths * power
        power *= 2


def refusals(found: EdgeFits, region: EdgeRegions, clear: np.ndarray, *, accept_sharpened: bool) -> list[Remark | None]:
    """List the reason for the rejection of each edge of a stack, or None for an edge that was measured.

    `clear`: `clearance` of the edges.
    """
    dark, bright = found.state.linear[:, 0], found.state.linear[:, 1]
    contrast = (bright - dark) / np.maximum(found.residual, 1e-300)
    blur = line_width(found.free.shape)
    over, least = found.overshoot.value, np.maximum(SHARPENED, SIGNIFICANT * found.overshoot.std)
    width = region.step * (region.value.shape[2] - 1)
    # Fewer than 10 rows do not determine the curve of the edge.
    lost = ~np.isfinite(contrast + blur + over + least) | (found.crossing < 10)
    gap = _largest_gap(found, region)

    glare = found.free.coefficients[:, GLARE]
    # Such strong glare, together with a misfit, is not attributed to the lens.
    veiled = (glare > 0.15) & (found.free.shape.radius > VEIL * width) & (found.misfit > MISFIT)

    ghost = ghost_of(found.free)

    def refusal(i: int) -> Remark | None:
        if lost[i]:
            text = "no edge was found that crosses the region from one side to the other: choose another region"
            return Remark("no-edge", text)
        # Smaller steps may be noise.
        if contrast[i] < 3.0:
            text = f"no edge was found: the step is {contrast[i]:.1f} times the scatter of the pixels, but must be "
            text += "at least 3 times the scatter"
            seen = describe_content(region.value[i])
            return Remark(
                "no-edge", f"{text}; {seen}: choose another region" if seen else f"{text}: choose another region"
            )
        # Larger gaps do not determine the MTF50 of a sharp lens.
        if gap[i] > 0.55:
            return Remark(
                "phases-missing",
                f"the edge is at {np.degrees(abs(found.angle[i])):.1f} degrees to the pixel grid, so that the pixels sample "
                f"too few distances from the edge (the largest gap is {gap[i]:.2f} px, but must be at most 0.55 "
                "px): rotate the target by a few degrees",
            )
        # A blur wider than a fifth of the region leaves no flat sides.
        if blur[i] > width / 5:
            return Remark(
                "too-narrow",
                f"the region of {width:.0f} px is too narrow for an edge whose blur has a standard deviation of "
                f"{blur[i]:.1f} px: choose a region of at least {5 * blur[i]:.0f} px across the edge",
            )
        if accept_sharpened:
            return None
        if over[i] > least[i] and clear[i] > CLEAR:
            return Remark(
                "sharpened",
                f"the image is sharpened: the edge overshoots its levels by {over[i]:.1%}, which a lens does not cause; use "
                "the raw image, or accept the MTF of lens and sharpening together (accept_sharpened=True)",
            )
        if veiled[i]:
            text = f"a lens alone does not explain glare of {glare[i]:.0%} of the step, with a radius above {VEIL:.0%} of the "
            text += f"region width, and a misfit of {found.misfit[i]:.1%} of the step"
            why = describe_content(region.value[i]) or "the region may contain a ghost, a second edge or dirt"
            return Remark("unexplained", f"{text}; {why}: choose another region")
        # A step with more than 0.3 of the height of the edge is not a ghost of the lens.
        second = bool(ghost.share[i] > 0.3)
        seen = describe_content(region.value[i]) if second or found.misfit[i] > MISFIT else ""
        if second:
            text = seen or f"the region contains 2 edges, {ghost.position[i]:.1f} px apart"
            return Remark("unexplained", f"a single edge is required, but {text}: choose another region")
        # A lens causes a smaller misfit near the edge.
        if seen or found.misfit[i] > 0.015:
            return Remark(
                "unexplained",
                f"neither a lens nor smooth light explains {found.misfit[i]:.1%} of the step; "
                f"{seen or 'the region may contain a ghost, a second edge, the border of a shadow or dirt'}: "
                "choose another region",
            )
        return None

    return [refusal(i) for i in range(len(lost))]


def describe_content(value: np.ndarray) -> str:
    """Describe the content of a region (rows, columns) that may not contain exactly one edge.

    The description is empty if the content is unknown.
    """
    value = value[np.isfinite(value).any(1)][:, np.isfinite(value).any(0)]
    known = np.isfinite(value)
    middle = float(np.median(value[known]))
    noise = flat_noise(value, known & (value < middle), known & (value >= middle))
    # Sharpening causes a smaller ratio than a halftone.
    if noise.neighbour_ratio > 1.5 and noise.apart > SIGNIFICANT:
        return "the region contains a pattern with a period of a few px, such as a screen or a halftone"
    slope = np.gradient(ndimage.gaussian_filter(np.where(known, value, middle), 1.0), axis=1)[:, 2:-2]
    slope = np.where(known[:, 2:-2], slope, 0.0)
    size = np.abs(slope)
    # A step has a slope of at least 0.3 of the 99.5 % quantile, and of 4 standard deviations of all slopes.
    least = max(0.3 * np.quantile(size, 0.995), 4.0 * robust_std(size))
    up, down = (
        (np.diff(there.astype(int), axis=1, prepend=0) == 1).sum(1) for there in (slope > least, slope < -least)
    )
    steps = up + down
    # In text or a pattern, the number of steps per row varies.
    if steps.std() > 1.5:
        return "the rows of the region differ from one another, as in text or a pattern"
    if np.median(steps) > 1:
        return f"the region contains {np.median(steps):.0f} edges"
    if np.median(steps) == 1 and (steps == 0).mean() > 0.05:
        return f"the edge ends at a corner, because {(steps == 0).mean():.0%} of the rows have no edge"
    return ""


def clearance(found: EdgeFits, region: EdgeRegions) -> np.ndarray:
    """Compute the distances (n,) of edges from the borders of their regions, in standard deviations of the edge blur."""
    there, position = np.isfinite(region.value), region.crossings(found)
    first, last = there.argmax(2), region.value.shape[2] - 1 - there[:, :, ::-1].argmax(2)
    off = np.stack([position - region.start - region.step * first, region.start + region.step * last - position])
    known = there.any(2)
    # In a tenth of the rows, the edge may be nearer to a border.
    nearest = np.array(
        [np.quantile(off[:, k, some], 0.1, axis=1).min() if some.any() else np.nan for k, some in enumerate(known)]
    )
    return nearest / np.hypot(1.0, np.nan_to_num(found.slope)) / line_width(found.free.shape)


def _largest_gap(found: EdgeFits, region: EdgeRegions) -> np.ndarray:
    """Compute the largest gap (n,) in the sampled distances from an edge, px."""
    offset = (region.crossings(found) - region.start) / region.step
    nearest = np.clip(np.rint(offset), 0, region.value.shape[2] - 1).astype(int)
    there = np.isfinite(np.take_along_axis(region.value, nearest[..., None], axis=2)[..., 0])
    crossed = there & (np.abs(offset - nearest) <= 0.5)
    gaps = []
    for phases, seen in zip(offset % 1.0, crossed, strict=True):
        phase = np.sort(phases[seen])
        gaps.append(np.diff(phase, append=phase[:1] + 1).max(initial=0.0) if phase.size else np.inf)
    return np.array(gaps) * region.step / np.hypot(1, np.nan_to_num(found.slope))


def _difference(values: np.ndarray, axis: int) -> np.ndarray:
    last, first = (np.take(values, places, axis).reshape(len(values), -1) for places in ((-1, -2), (0, 1)))
    if np.isfinite(values).all():
        return last.mean(1) - first.mean(1)
    return np.nanmean(last, 1) - np.nanmean(first, 1)
