"""Measurement of the slanted edges of a photograph in strips along the edges, and remarks on the image.

The rows of a strip follow the edge, so that an edge may have any angle. A row of a strip is part of a row of the image, or
of a column if columns cross the edge at a larger angle. The pixels are not resampled. All strips of an image have the same
shape, so that one compiled program measures them. Missing pixels of shorter or narrower strips are NaN.

The fit of an edge includes light that changes linearly. The nonlinear part of the vignetting in a strip is divided out. This
part is estimated from the bright sides of the edges in the image, because most of these sides are the same paper. An error
of the level or of the slope of the estimated light has no effect.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from matcam.calibration.chart.registration import FEWEST_POSITIONS
from matcam.calibration.edge.edge import AT_ONCE, EdgeSettings, edge_stack
from matcam.calibration.edge.edge_result import EdgeStack
from matcam.calibration.edge.rows import EdgeRegions, RegionFrame, turns_for
from matcam.calibration.photograph.flat_noise import crushed_share
from matcam.calibration.photograph.linear_image import SATURATED, SMALLEST, LinearImage, flaw
from matcam.calibration.search.edge_search import EdgePositions
from matcam.core.errors import FitError
from matcam.core.remark import Remark
from matcam.numerics.normal import SIGNIFICANT, robust_fit
from matcam.numerics.polynomials import plane_powers

_ROWS = (48, 64, 96, 128, 192)
"""Possible lengths of a strip across its rows, px. A small set of shapes limits the number of compiled programs."""
_COLUMNS = (32, 48)
"""Possible lengths of the rows of a strip, px."""


class Strips(NamedTuple):
    """Set of n strips along edges, in coordinates u along the rows of a strip and v across them.

    Attributes:
        transposed: (n,) whether u is y of the image, and v is x.
        mirrored: (n,) whether the bright side lies at smaller u.
        u: (n,) u of the middle of the edge, px.
        v: (n,) v of the middle of the edge, px.
        tilt: (n,) du/dv of the edge.
        rows: (n,) number of rows, px.
        width: (n,) width, an even number of px.
    """

    transposed: np.ndarray
    mirrored: np.ndarray
    u: np.ndarray
    v: np.ndarray
    tilt: np.ndarray
    rows: np.ndarray
    width: np.ndarray

    def subset(self, which: np.ndarray | slice) -> Strips:
        return Strips(*(column[which] for column in self))


def plane_edge_stack(
    plane: LinearImage, edges: EdgePositions, half_width: float = 0.5, *, accept_sharpened: bool = False
) -> EdgeStack:
    """Measure edges in one colour plane.

    Long edges are divided into several strips. `half_width`: half the side of the sensitive area of a pixel, px.

    Raises:
        FitError: no edge can be measured; the message gives the most frequent reason.
    """
    strips = strips_along(edges, plane.shape)
    if not strips.u.size:
        raise FitError(
            f"no slanted edge was found that can be measured (edges that are too short or lack free space around them: "
            f"{edges.x.size}): photograph a chart of slanted squares (matcam chart)"
        )
    regions, saturated = zip(*strip_regions(strips, plane, AT_ONCE), strict=True)
    known = [
        [
            Remark("saturated", f"{share:.0%} of the samples are saturated: expose less")
            if share > SATURATED
            else flaw(value) or _crushed(value)
            for share, value in zip(shares, rows.value, strict=True)
        ]
        for rows, shares in zip(regions, saturated, strict=True)
    ]
    settings = EdgeSettings(half_width=half_width, accept_sharpened=accept_sharpened)
    result = edge_stack(list(zip(regions_in_even_light(regions), known, strict=True)), settings)
    problems = [problem for problem in result.problems if problem]
    if len(problems) == len(result):
        code, count = Counter(problem.code for problem in problems).most_common(1)[0]
        example = next(problem for problem in problems if problem.code == code)
        raise FitError(
            f"none of the edges can be measured; the most frequent reason ({count} of {len(result)}): {example}"
        )
    return result


def _crushed(value: np.ndarray) -> Remark | None:
    used = value[np.isfinite(value)]
    bright = used > (used.min() + used.max()) / 2
    share = crushed_share(*(np.unique(used[side], return_counts=True)[1] for side in (~bright, bright)))
    return (
        Remark("crushed", f"blacks are crushed: {share:.0%} of the dark side has the lowest value; expose more")
        if share
        else None
    )


def edge_remarks(result: EdgeStack, channel: str) -> list[Remark]:
    good = result.good
    codes = Counter(problem.code for problem in result.problems if problem)
    remarks = []
    for code, kind, remedy in (
        ("saturated", "saturated edges", "expose less"),
        ("sharpened", "edges with an overshoot, as after sharpening,", "use camera raw"),
        ("crushed", "edges with crushed blacks", "expose more, or use camera raw"),
    ):
        if codes[code]:
            text = f"{kind} were excluded ({codes[code]} of {len(result)}): {remedy}"
            remarks.append(Remark(f"{code}-edges", f"{channel}: {text}"))
    dark, bright = result.dark[good], result.bright[good]
    contrast = float(np.median((bright - dark) / (np.abs(bright) + np.abs(dark))))
    # A printed chart has a higher contrast.
    if contrast < 0.2:
        text = f"the contrast is only {contrast:.0%} (20% or more is recommended), which increases the standard "
        text += "deviations: use a print with darker blacks, or reduce stray light"
        remarks.append(Remark("low-contrast", f"{channel}: {text}"))
    if text := _directional_blur(result):
        remarks.append(Remark("directional-blur", f"{channel}: {text}"))
    return remarks


def strips_along(edges: EdgePositions, shape: tuple[int, int]) -> Strips:
    """Place strips along the edges of an image of shape (height, width).

    Long edges are divided into several strips. Edges without enough space for a strip are excluded.
    """
    c, s = np.cos(edges.angle), np.sin(edges.angle)
    transposed = np.abs(s) > np.abs(c)
    across, along = np.where(transposed, s, c), np.where(transposed, c, s)
    u, v = np.where(transposed, edges.y, edges.x), np.where(transposed, edges.x, edges.y)
    tilt, steep = -along / across, np.abs(across)
    # The error of the position of an edge in the search is 1 px.
    half = np.minimum(np.floor(edges.clear / steep - 1.0), _COLUMNS[-1] // 2)
    # The points of the edge nearest to the ends of a row are further along the edge than the point nearest to its centre.
    rows = np.floor(edges.length * steep - 2 * half * np.abs(along) * steep)
    # The number of rows follows from a quantile of the lengths of the edges.
    usual = np.quantile(rows, 0.8) if rows.size else 0.0
    longest = next((n for n in _ROWS if n >= usual), _ROWS[-1])
    pieces = np.maximum(np.ceil(rows / longest), 1).astype(int)
    which = np.repeat(np.arange(rows.size), pieces)
    number = np.arange(which.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    size = np.floor(rows / pieces)[which]
    offset = (number - (pieces[which] - 1) / 2) * size
    strips = Strips(
        transposed[which], (across < 0)[which], u[which] + tilt[which] * offset, v[which] + offset, tilt[which],
        size.astype(int), 2 * half[which].astype(int),
    )  # fmt: skip
    # Fewer than 20 rows do not sample enough phases of the edge.
    return strips.subset(_inside(strips, shape) & (strips.rows >= 20) & (strips.width >= SMALLEST))


def strip_regions(strips: Strips, plane: LinearImage, at_once: int) -> Iterator[tuple[EdgeRegions, np.ndarray]]:
    """Yield the regions of strips, all of one shape.

    Each item contains at most `at_once` regions, and the share of saturated samples of each region.
    """
    sites = plane.sites
    step = 1 if sites.all() else 2
    rows = next((n for n in _ROWS if n >= strips.rows.max(initial=0)), _ROWS[-1])
    columns = next(n for n in _COLUMNS if n >= np.median(strips.width))
    by_row = step if (sites.sum(1) == 0).any() else 1  # red and blue have sites in every other row only
    for i in range(0, strips.u.size, at_once):
        yield _region(strips.subset(slice(i, i + at_once)), plane, step, by_row, (rows // by_row, columns // step))


def regions_in_even_light(regions: Sequence[EdgeRegions]) -> list[EdgeRegions]:
    """Divide regions by the estimated light.

    The logarithm of the light is a quadratic function of the position in the image. If the light cannot be estimated, the
    regions are unchanged.
    """
    x, y = (np.concatenate([getattr(r.frame, axis) for r in regions]) for axis in "xy")
    bright = np.concatenate([_bright(r.value) for r in regions])
    good = bright > 0
    if good.sum() < FEWEST_POSITIONS:
        return list(regions)
    middle, scale = (x.mean(), y.mean()), max(float(np.ptp(x)), float(np.ptp(y)), 1.0)

    def powers(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return plane_powers((x - middle[0]) / scale, (y - middle[1]) / scale, 2)

    design = powers(x, y)[good]
    # The bright sides scatter by at least 0.2 % about the light.
    light = robust_fit(design, np.log(bright[good]), least=0.002)
    # Light with a larger ratio of brightest and darkest than 20 is implausible.
    if light.kept.sum() < FEWEST_POSITIONS or np.ptp(design[light.kept] @ light.parameters) > np.log(20.0):
        return list(regions)

    def even(region: EdgeRegions) -> EdgeRegions:
        frame = region.frame
        relative = powers(*region.positions()) - powers(np.asarray(frame.x), np.asarray(frame.y))[:, None, None]
        return region._replace(value=region.value * np.exp(-relative @ light.parameters))

    return [even(region) for region in regions]


def _region(
    strips: Strips, plane: LinearImage, step: int, by_row: int, shape: tuple[int, int]
) -> tuple[EdgeRegions, np.ndarray]:
    """Read the pixels of strips as regions of one shape (rows, columns).

    `by_row`: distance of neighbouring rows, px. `step`: distance of neighbouring samples of a row, px.
    """
    (rows, columns), sites = shape, plane.sites
    first = np.ceil(strips.v - strips.rows / 2).astype(int)
    v = first[:, None] + by_row * np.arange(rows)
    # A row is read from its dark end: towards smaller u if the strip is mirrored.
    forward = np.where(strips.mirrored, -1, 1)[:, None]
    width = np.minimum(strips.width, columns * step)[:, None]
    begin = (
        np.rint(strips.u[:, None] + strips.tilt[:, None] * (v - strips.v[:, None])).astype(int) - forward * width // 2
    )
    if step == 2:
        first_row: np.ndarray = np.where(strips.transposed[:, None], sites.any(0), sites.any(1))
        if by_row == 2:  # the first row must have sites of the colour
            v = v + ~np.take_along_axis(first_row, v[:, :1] % 2, 1)
        turned = np.where(strips.transposed[:, None, None], sites.T, sites)
        begin = begin + forward * ~turned[np.arange(strips.u.size)[:, None], v % 2, begin % 2]
    u = begin[..., None] + forward[..., None] * step * np.arange(columns)
    there = (v < first[:, None] + strips.rows[:, None])[..., None] & (np.arange(columns) * step < width[..., None])
    u, full_v = np.where(there, u, begin[:, :1, None]), np.where(there, v[..., None], first[:, None, None])
    turned = strips.transposed[:, None, None]
    at = np.where(turned, u, full_v), np.where(turned, full_v, u)
    value = np.where(there, plane.values[at], np.nan)
    saturated = np.zeros(len(value)) if plane.saturated is None else plane.saturated[at].mean((1, 2))
    middle = first + (strips.rows - 1) / 2
    start = forward * (begin - strips.u[:, None])
    x, y = (np.where(strips.transposed, *pair) for pair in ((middle, strips.u), (strips.u, middle)))
    turns = turns_for(float((strips.rows * np.abs(strips.tilt)).min()) / step)
    frame = RegionFrame(x, y, strips.transposed, strips.mirrored, (strips.rows - 1).astype(float))
    return EdgeRegions(value, v - middle[:, None], start.astype(float), step, frame, turns), saturated


def _inside(strips: Strips, shape: tuple[int, int]) -> np.ndarray:
    """Compute the mask of the strips that are inside the image, with a margin of 2 px."""
    margin = strips.width / 2 + np.abs(strips.tilt) * strips.rows / 2 + 2
    across, along = (np.where(strips.transposed, *pair) for pair in (shape[:2], shape[1::-1]))
    long = strips.rows / 2 + 2
    return (strips.u >= margin) & (strips.u + margin < across) & (strips.v >= long) & (strips.v + long < along)


def _bright(value: np.ndarray) -> np.ndarray:
    there = np.isfinite(value)
    width = there.any(1).sum(1)
    # The last quarter of a row is its bright side.
    side = there & (np.arange(value.shape[2]) >= (width - width // 4)[:, None, None])
    count = side.sum((1, 2))
    return np.where(side, value, 0.0).sum((1, 2)) / np.where(count > 0, count, np.nan)


def _directional_blur(result: EdgeStack) -> str:
    """Describe the dependence of the blur on direction, for example by motion; empty if it is not significant."""
    good = result.good
    # The fit of three parameters requires at least 6 edges.
    if good.size < 6:
        return ""
    sigma, angle = result.parametric.values[good, 0], result.angle[good]
    std = 2 * sigma * np.sqrt(result.parametric.covariance[good, 0, 0])
    # The variance of the blur has a second harmonic in the direction. The edges of squares have only two directions, which
    # leave one combination of the harmonics undetermined. It is set to 0.
    design = np.stack([np.ones_like(angle), np.cos(2 * angle), np.sin(2 * angle)], 1)
    # A combination is undetermined if its singular value is below 0.03 of the largest singular value.
    fit = robust_fit(design, sigma**2, std, resolved=0.03)
    found = fit.parameters
    size = float(np.hypot(found[1], found[2]))
    std = float(np.sqrt(found[1:] @ fit.covariance[1:, 1:] @ found[1:] * max(1.0, fit.chi2)) / max(size, 1e-30))
    # A smaller relative amplitude of the variance of the blur than 0.15 is not reported.
    if size < 0.15 * found[0] or size < SIGNIFICANT * std:
        return ""
    most, least = np.sqrt(found[0] + size), np.sqrt(max(found[0] - size, 0.0))
    along = np.degrees(np.arctan2(found[2], found[1]) / 2) % 180
    blur = f"the blur is {most:.2f} px along {along:.0f} degrees and {least:.2f} px perpendicular to this direction"
    return f"{blur}: the camera moved, or the lens is astigmatic; repeat the photograph with a fixed camera"
