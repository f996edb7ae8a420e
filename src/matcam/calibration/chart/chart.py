"""Test charts: printed elements with their positions and levels.

Positions and lengths are in mm on the page, with x to the right and y down from the upper left corner of the page. Levels are
linear reflectances relative to the bare paper, whose level is 1. At the brightest points of a
pattern, its phase is a multiple of 2 pi.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from matcam.core.errors import ArgumentError

Point = tuple[float, float]
"""Position or size (x, y) on the page, mm."""

PROFILES = ("sine", "bars", "lines")
"""Profiles of gratings."""


@dataclass(frozen=True)
class Chart:
    """Page with printed elements.

    Attributes:
        page: width and height of the page, mm.
        fiducials: marks for finding the chart in a photograph: none, or at least four. Exactly one of them has two rings.
        elements: targets, from upper left to lower right.
        ink: linear level of the fiducials, relative to the paper (no unit).

    Raises:
        ArgumentError: if the values of an element are invalid or contradict one another, or the fiducials are insufficient.

    Example:
        >>> chart = matcam.targets.design_chart(["star"], pixels_across=1500)
        >>> chart.page, len(chart.fiducials)
        ((297.0, 210.0), 8)
    """

    page: Point
    fiducials: tuple[Fiducial, ...]
    elements: tuple[Element, ...]
    ink: float

    def __post_init__(self) -> None:
        for i, element in enumerate(self.elements):
            for problem in _problems(element):
                raise ArgumentError(f"element {i} ({type(element).__name__.lower()}): {problem}")
        if not isinstance(self.fiducials, tuple) or not all(isinstance(one, Fiducial) for one in self.fiducials):
            raise ArgumentError(f"fiducials must be a tuple of Fiducial, got a {type(self.fiducials).__name__}")
        marks = sum(fiducial.rings == 2 for fiducial in self.fiducials)
        if self.fiducials and (len(self.fiducials) < 4 or marks != 1):
            raise ArgumentError(
                "fiducials must be empty, or contain at least 4 marks and exactly one mark with 2 rings, got "
                f"{len(self.fiducials)} and {marks}"
            )


@dataclass(frozen=True)
class Square:
    """Slanted square on paper; its four sides are edges.

    Attributes:
        corners: corners in cyclic order, mm.
        level: linear level of the square, relative to the paper (no unit).

    Example:
        >>> square = matcam.targets.design_chart(["squares"], pixels_across=1500).elements[-1]
        >>> len(square.corners), square.level
        (4, 0.25)
    """

    corners: tuple[Point, Point, Point, Point]
    level: float


@dataclass(frozen=True)
class Grating:
    """Rectangle filled with parallel bars or with a sine wave.

    Attributes:
        profile: "sine"; "bars", a square wave; or "lines", bright lines whose width is `duty` of a period.
        centre: centre of the rectangle, mm.
        size: size of the rectangle across and along the bars, mm.
        angle: angle from the x axis of the page to the direction across the bars, rad.
        period: period, mm.
        phase: phase at the centre, rad.
        dark: lowest linear level (no unit).
        bright: highest linear level (no unit).
        duty: bright share of a period (no unit); values other than 0.5 require the profile "lines". Default: 0.5.

    Example:
        >>> bars = matcam.targets.design_chart(["bars"], pixels_across=1500).elements[-1]
        >>> bars.profile, bars.contrast, round(bars.harmonic(1), 3), round(bars.harmonic(3), 3)
        ('bars', 0.6, 0.764, -0.255)
    """

    profile: str
    centre: Point
    size: Point
    angle: float
    period: float
    phase: float
    dark: float
    bright: float
    duty: float = 0.5

    @property
    def corners(self) -> np.ndarray:
        """Corners of the rectangle, (4, 2) mm."""
        across = np.array([np.cos(self.angle), np.sin(self.angle)]) * self.size[0] / 2
        along = np.array([-np.sin(self.angle), np.cos(self.angle)]) * self.size[1] / 2
        return np.array(self.centre) + np.array(
            [-across - along, across - along, across + along, along - across]
        )  # fmt: skip

    @property
    def contrast(self) -> float:
        """Contrast (bright - dark) / (bright + dark), no unit."""
        return (self.bright - self.dark) / (self.bright + self.dark)

    def harmonic(self, order: int) -> float:
        """Compute the signed, relative amplitude of a harmonic of the print.

        The amplitude is relative to the mean. For a square wave it is (4 / pi) contrast / order with alternating sign for odd
        orders, and 0 for even orders.

        Args:
            order: order of the harmonic; 1 for the fundamental.

        Returns:
            The amplitude (no unit).
        """
        if self.profile == "sine":
            return self.contrast if order == 1 else 0.0
        step = self.bright - self.dark
        mean = self.dark + step * self.duty
        return 2 * step * float(np.sin(np.pi * order * self.duty)) / (np.pi * order * mean)


@dataclass(frozen=True)
class Star:
    """Sinusoidal Siemens star.

    The level between the two radii is (bright + dark) / 2 + (bright - dark) / 2 cos(cycles * azimuth + phase). The azimuth
    increases from +x (right) towards +y (down).

    Attributes:
        centre: centre, mm.
        inner: inner radius, mm.
        outer: outer radius, mm.
        cycles: number of periods in a full turn (no unit).
        phase: phase at azimuth 0, rad.
        dark: lowest linear level (no unit).
        bright: highest linear level (no unit).

    Example:
        >>> star = matcam.targets.design_chart(["star"], pixels_across=1500).elements[-1]
        >>> star.cycles, round(star.contrast, 3)
        (144, 0.583)
    """

    centre: Point
    inner: float
    outer: float
    cycles: int
    phase: float
    dark: float
    bright: float

    @property
    def contrast(self) -> float:
        """Contrast (bright - dark) / (bright + dark), no unit."""
        return (self.bright - self.dark) / (self.bright + self.dark)


@dataclass(frozen=True)
class Dots:
    """Round dots on a square lattice.

    Attributes:
        centres: centres of the dots, mm.
        radius: radius of a dot, mm.
        pitch: distance between neighbours, mm.
        level: linear level of the dots, relative to the paper around them (no unit).

    Example:
        >>> dots = matcam.targets.design_chart(["dots"], pixels_across=1500).elements[-1]
        >>> round(dots.radius / dots.pitch, 4)
        0.0929
    """

    centres: tuple[Point, ...]
    radius: float
    pitch: float
    level: float


@dataclass(frozen=True)
class Patch:
    """Tone patch: a rectangle of one level.

    Attributes:
        corners: corners in cyclic order, mm.
        level: linear level, relative to the paper (no unit).

    Example:
        >>> chart = matcam.targets.design_chart(["star"], pixels_across=1500)
        >>> [element.level for element in chart.elements[:3]]
        [0.05, 0.1, 0.15]
    """

    corners: tuple[Point, Point, Point, Point]
    level: float


@dataclass(frozen=True)
class Fiducial:
    """Mark for finding the chart: a dark disc inside concentric dark rings.

    The width of each ring and each gap is the radius of the disc.

    Attributes:
        centre: centre, mm.
        radius: radius of the disc, mm; ring n = 1, 2 lies between 2n and 2n + 1 radii.
        rings: number of rings (no unit): 1, or 2 for the mark that determines the orientation.

    Example:
        >>> chart = matcam.targets.design_chart(["star"], pixels_across=1500)
        >>> sorted(mark.rings for mark in chart.fiducials)
        [1, 1, 1, 1, 1, 1, 1, 2]
    """

    centre: Point
    radius: float
    rings: int


Element = Square | Grating | Star | Dots | Patch
"""Element that can be printed on a chart."""


def _problems(element: Element) -> Iterator[str]:
    levels = [getattr(element, f.name) for f in fields(element) if f.name in ("level", "dark", "bright")]
    if not all(0 <= level <= 1 for level in levels):
        yield f"levels must lie in [0, 1], got {', '.join(f'{level:g}' for level in levels)}"
    if isinstance(element, Grating | Star) and not element.dark < element.bright:
        yield f"dark must lie below bright, got {element.dark:g} and {element.bright:g}"
    if isinstance(element, Grating):
        if element.profile not in PROFILES:
            yield f"profile must be one of {', '.join(PROFILES)}, got {element.profile!r}"
        if not (element.period > 0 and min(element.size) > 0 and 0 < element.duty < 1):
            yield (
                f"period and size must be positive, and duty must lie in (0, 1), got period {element.period:g}, "
                f"size {element.size[0]:g} x {element.size[1]:g} and duty {element.duty:g}"
            )
        if element.profile != "lines" and element.duty != 0.5:
            yield f"duty must be 0.5 for {element.profile}, got {element.duty:g}"
    if isinstance(element, Star) and not (0 <= element.inner < element.outer and element.cycles >= 8):
        yield (
            "a star needs 0 <= inner < outer radius and at least 8 cycles, "
            f"got radii {element.inner:g} and {element.outer:g}, and {element.cycles} cycles"
        )
    if isinstance(element, Dots) and not (0 < 2 * element.radius < element.pitch and element.centres):
        yield (
            "dots need centres, and 0 < 2 radius < pitch, "
            f"got radius {element.radius:g}, pitch {element.pitch:g} and {len(element.centres)} centres"
        )
