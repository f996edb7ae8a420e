"""Layout of a chart: panels on a page, with elements sized in pixels of the camera."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from matcam.calibration.chart.chart import Chart, Dots, Element, Fiducial, Grating, Patch, Point, Square, Star
from matcam.core import checks
from matcam.core.errors import ArgumentError

PAGES = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}
"""Width and height of the named pages in landscape orientation, mm."""

_INK = 0.05
"""Linear level of fiducials and dots (no unit)."""
_DARK, _SINE_BRIGHT = 0.25, 0.95
"""Linear levels of squares, gratings and stars: dark; bright of a sine, which must not exceed the paper."""
_SLANT = math.radians(5)
"""Angle of squares and dots to the page, rad. The edges then sample all phases of the pixel grid (ISO 12233)."""
_SLANTED = np.array([[np.cos(_SLANT), -np.sin(_SLANT)], [np.sin(_SLANT), np.cos(_SLANT)]])
"""Rotation matrix of squares and dots."""
_FREQUENCIES = (0.05, 0.08, 0.11, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45)
"""Frequencies of the gratings, cycles per pixel of the intended camera."""


def design_chart(
    kinds: Sequence[str] = ("squares", "bars", "star", "dots"),
    *,
    page: Point | str = "a4",
    pixels_across: float = 3000.0,
) -> Chart:
    """Design a chart with one panel for each kind of target.

    Eleven tone patches and eight fiducials are added. The sizes of the elements are multiples of the size of a camera pixel on
    the page.

    Args:
        kinds: panels without repetition: "squares" (slanted by 5 degrees), "bars", "sines" and "lines" (gratings of 0.05 to
            0.45 cycles/px in two directions), "star" (a sinusoidal Siemens star), "dots".
            Default: squares, bars, star and dots.
        page: width and height, mm, or "a4", "a3", "letter" (landscape). The size of the elements is proportional
            to the width of the page. Default: "a4".
        pixels_across: width of the page in the intended images, px. If this width is wrong, the targets are too fine or
            too coarse. Default: 3000.

    Returns:
        The chart, to be printed with `matcam chart` and written with `write_chart`.

    Raises:
        ArgumentError: if an argument is out of range, a kind or a page is unknown, or a panel is too small for its elements.

    Source:
        docs/targets.md; ISO 12233 for slanted edges and the Siemens star.

    Example:
        >>> chart = matcam.targets.design_chart(["squares", "star"], pixels_across=2000)
        >>> sorted({type(element).__name__ for element in chart.elements})
        ['Patch', 'Square', 'Star']
    """
    for kind in kinds:
        checks.choice("kinds", kind, KINDS)
    if not len(kinds) or len(set(kinds)) != len(kinds):
        raise ArgumentError(f"kinds must name at least one panel, without repetition, got {', '.join(kinds) or 'none'}")
    size = PAGES[checks.choice("page", page, tuple(PAGES))] if isinstance(page, str) else page
    if checks.plain_array("page", size).shape != (2,):
        raise ArgumentError(f"page must be one of {', '.join(PAGES)}, or (width, height) in mm, got {size!r:.60}")
    width, height = (float(checks.within("page", side, 50, 5000, "mm")) for side in size)
    pixel = width / float(checks.within("pixels_across", pixels_across, 300, 100_000))
    # Fiducials with a radius below 2.6 px are not found with a lens width of 1 px.
    margin = max(0.045 * min(width, height), 17 * pixel)
    radius = margin / 6.5
    fiducials = tuple(_fiducials(width, height, margin, radius))
    strip = 0.06 * height
    top, left = 1.8 * margin, 1.8 * margin
    room = (width - 2 * left, height - 2 * top - 1.4 * strip)
    elements: list[Element] = list(_patches(left, height - top - strip, room[0], strip))
    columns = max(range(1, len(kinds) + 1), key=lambda n: _shorter_side(n, len(kinds), room))
    rows = math.ceil(len(kinds) / columns)
    cell = (room[0] / columns, room[1] / rows)
    gap = 0.04 * min(cell)
    for i, kind in enumerate(kinds):
        row, column = divmod(i, columns)
        corner = (left + column * cell[0] + gap, top + row * cell[1] + gap)
        found = list(_PANELS[kind](corner, (cell[0] - 2 * gap, cell[1] - 2 * gap), pixel))
        if not found:
            raise ArgumentError(
                f"a panel of {cell[0] / pixel:.0f} x {cell[1] / pixel:.0f} px is too small for {kind}: "
                f"give fewer kinds, or pixels_across above {pixels_across:g}"
            )
        elements += found
    return Chart((width, height), fiducials, tuple(elements), _INK)


def _shorter_side(columns: int, count: int, room: Point) -> float:
    rows = math.ceil(count / columns)
    return min(room[0] / columns, room[1] / rows)


def _fiducials(width: float, height: float, margin: float, radius: float) -> Iterator[Fiducial]:
    """Yield the fiducials along the border of the page.

    The fiducial with two rings is in the upper left corner. The positions between the corners are not symmetric. A mirrored or
    rotated view therefore cannot be explained by perspective.
    """
    near, far = (margin, margin), (width - margin, height - margin)
    positions = [near, (0.4 * width, near[1]), (far[0], near[1]), (far[0], 0.4 * height), far, (0.6 * width, far[1])]
    for position in [*positions, (near[0], far[1]), (near[0], 0.5 * height)]:
        yield Fiducial(position, radius, 2 if position == near else 1)


def _patches(left: float, top: float, width: float, height: float) -> Iterator[Patch]:
    levels = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.75, 0.9)
    step = width / len(levels)
    for i, level in enumerate(levels):
        x, gap = left + i * step, 0.05 * step
        yield Patch(
            ((x + gap, top), (x + step - gap, top), (x + step - gap, top + height), (x + gap, top + height)), level
        )


def _positions(corner: Point, size: Point, pitch: float) -> Iterator[Point]:
    """Yield the centres, mm, of the cells of a regular grid in the middle of a panel."""
    columns, rows = (int(side / pitch + 1e-9) for side in size)
    # More than 200,000 elements in a panel are assumed to be a mistake.
    if columns * rows > 200_000:
        raise ArgumentError(
            f"a panel has {columns * rows} elements, but at most 200,000 are possible: reduce pixels_across"
        )
    first = [c + (s - n * pitch) / 2 + pitch / 2 for c, s, n in zip(corner, size, (columns, rows), strict=True)]
    for row in range(rows):
        for column in range(columns):
            yield first[0] + column * pitch, first[1] + row * pitch


def _fitting_side(size: Point, usual: float, pitch: float, least: int) -> float:
    """Compute the side of the squares in a panel, mm.

    The side is `usual`, mm, if at least `least` squares of this side fit. Otherwise the side is reduced until two squares fit,
    but not below half of `usual`. `pitch` is the distance between neighbours, relative to the side.
    """
    if math.prod(int(side / (pitch * usual)) for side in size) >= least:
        return usual
    small, large = sorted(size)
    # In small panels, squares and gratings have at least half the usual size. Their measurements are then less
    # accurate.
    return float(np.clip((1 - 1e-9) * min(small, large / 2) / pitch, 0.5 * usual, usual))


def _squares(corner: Point, size: Point, pixel: float) -> Iterator[Square]:
    spacing = 1.6  # distance between the centres of neighbouring squares, relative to their side
    side = _fitting_side(size, 80.0 * pixel, spacing, 1)  # 80 px if there is space
    for centre in _positions(corner, size, spacing * side):
        points = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * side / 2 @ _SLANTED.T + centre
        a, b, c, d = ((float(px), float(py)) for px, py in points)
        yield Square((a, b, c, d), _DARK)


def _gratings(profile: str) -> Callable[[Point, Point, float], Iterator[Grating]]:
    # A quarter of a period of lines is bright. Bars are as bright as the paper.
    duty, bright = (0.25 if profile == "lines" else 0.5), (_SINE_BRIGHT if profile == "sine" else 1.0)

    def panel(corner: Point, size: Point, pixel: float) -> Iterator[Grating]:
        gap = 1.4  # size of a grating with the paper around it, relative to the grating
        side = _fitting_side(size, 76.0 * pixel, gap, 2)  # 76 px if there is space
        positions = list(_positions(corner, size, gap * side))
        count = min(len(positions) // 2, len(_FREQUENCIES))
        # A single pair of gratings has a medium frequency, which is sensitive to blur.
        first = 0 if count > 1 else len(_FREQUENCIES) // 2 - 1
        chosen = [_FREQUENCIES[i] for i in np.linspace(first, len(_FREQUENCIES) - 1, count).round().astype(int)]
        # The pixels sample all phases of a tilted grating, and no harmonic coincides with a frequency of the pixel grid.
        wanted = [(f, math.radians(7) + turn) for f in chosen for turn in (0, math.pi / 2)]
        for centre, (frequency, angle) in zip(positions, wanted, strict=False):
            period = pixel / frequency
            across = max(1, round(side / period)) * period  # with whole periods, the mean is that of one period
            yield Grating(profile, centre, (across, side), angle, period, 0.0, _DARK, bright, duty)

    return panel


def _star(corner: Point, size: Point, pixel: float) -> Iterator[Star]:
    outer = min(size) / 2
    # Use the largest number of cycles that are wide enough at the rim: with more cycles, a ring is closer to a plane wave.
    for cycles in (144, 108, 72, 48, 36, 24):
        if cycles / (2 * math.pi * outer / pixel) < 0.07 or (cycles == 24 and outer > 40 * pixel):
            centre = (corner[0] + size[0] / 2, corner[1] + size[1] / 2)
            yield Star(centre, cycles * pixel / (2 * math.pi) / 0.9, outer, cycles, 0.0, _DARK, _SINE_BRIGHT)
            return


def _dots(corner: Point, size: Point, pixel: float) -> Iterator[Dots]:
    # The lattice is rotated, so that the pixels sample the dots at different phases.
    middle = np.array(corner) + np.array(size) / 2
    inner = tuple(s / (np.cos(_SLANT) + np.sin(_SLANT) * max(size) / min(size)) for s in size)
    pitch = 14.0 * pixel  # halfway between two dots, their blur is negligible
    points = [
        tuple(float(v) for v in _SLANTED @ centre + middle)
        for centre in _positions((-inner[0] / 2, -inner[1] / 2), (inner[0], inner[1]), pitch)
    ]
    if len(points) >= 9:
        yield Dots(tuple((x, y) for x, y in points), 1.3 * pixel, pitch, _INK)


_PANELS: dict[str, Callable[[Point, Point, float], Iterator[Element]]] = {
    "squares": _squares, "bars": _gratings("bars"), "sines": _gratings("sine"), "lines": _gratings("lines"),
    "star": _star, "dots": _dots,
}  # fmt: skip
"""Functions by kind that fill a panel: (upper left corner, size, size of a camera pixel, all mm) -> elements."""
KINDS = tuple(_PANELS)
"""Kinds of panels."""
