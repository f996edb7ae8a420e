"""Charts to photograph: what is printed where, in mm on the page, x right and y down from its upper left corner.

Levels are linear reflectances relative to the bare paper, which is 1. A phase's cosine is 1 where a pattern is brightest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from matcam.core.errors import ArgumentError

Point = tuple[float, float]

PROFILES = ("sine", "bars", "lines")


@dataclass(frozen=True)
class Square:
    """A slanted square: four edges."""

    corners: tuple[Point, Point, Point, Point]
    """mm, one after the other round the square."""
    level: float
    """Of the square; around it there is paper."""


@dataclass(frozen=True)
class Grating:
    """A rectangle filled with parallel bars or with a sine."""

    profile: str
    """"sine"; "bars": a square wave; "lines": bright lines, `duty` of a period wide."""
    centre: Point
    size: Point
    """mm: across the bars, and along them."""
    angle: float
    """rad, direction across the bars: that of the frequency, to the page's x axis."""
    period: float
    """mm."""
    phase: float
    """rad at the centre."""
    dark: float
    bright: float
    duty: float = 0.5
    """Bright share of a period; 0.5 but for lines."""

    @property
    def corners(self) -> np.ndarray:
        """(4, 2) mm."""
        across = np.array([np.cos(self.angle), np.sin(self.angle)]) * self.size[0] / 2
        along = np.array([-np.sin(self.angle), np.cos(self.angle)]) * self.size[1] / 2
        return np.array(self.centre) + np.array(
            [-across - along, across - along, across + along, along - across]
        )  # fmt: skip


@dataclass(frozen=True)
class Star:
    """A sinusoidal Siemens star: level = mean + amplitude cos(cycles * azimuth + phase) between two radii."""

    centre: Point
    inner: float
    outer: float
    """mm, radii."""
    cycles: int
    phase: float
    dark: float
    bright: float


@dataclass(frozen=True)
class Dots:
    """Round dots on a square lattice."""

    centres: tuple[Point, ...]
    radius: float
    """mm."""
    pitch: float
    """mm between neighbours."""
    level: float
    """Of the dots; around them there is paper."""


@dataclass(frozen=True)
class Patch:
    """A rectangle of one level: a step of the tone curve."""

    corners: tuple[Point, Point, Point, Point]
    level: float


@dataclass(frozen=True)
class Fiducial:
    """A mark to find the chart by: a dark disc, and dark rings around it as wide as their gaps and as its radius."""

    centre: Point
    radius: float
    """mm, of the inner disc: ring n lies between 2n and 2n + 1 radii."""
    rings: int
    """1; 2 for the one that tells which way is up."""


Element = Square | Grating | Star | Dots | Patch


@dataclass(frozen=True)
class Chart:
    """A page and what is printed on it."""

    page: Point
    """mm, width and height."""
    fiducials: tuple[Fiducial, ...]
    elements: tuple[Element, ...]
    ink: float
    """Level of the fiducials."""

    def of_kind(self, kind: type) -> list[Element]:
        """The elements of one kind, in the order of the description."""
        return [element for element in self.elements if isinstance(element, kind)]


def contrast(element: Grating | Star) -> float:
    """(bright - dark) / (bright + dark) of a pattern."""
    return (element.bright - element.dark) / (element.bright + element.dark)


def fundamental(element: Grating | Star) -> float:
    """Amplitude of a pattern's first harmonic, relative to the pattern's mean."""
    return harmonic(element, 1)


def harmonic(element: Grating | Star, order: int) -> float:
    """Amplitude, signed, of cos(order * phase) in a pattern, relative to the pattern's mean: what a perfect camera sees.

    A square wave's are (4 / pi) contrast / order, alternating, none even.
    """
    if isinstance(element, Star) or element.profile == "sine":
        return contrast(element) if order == 1 else 0.0
    mean = element.dark + (element.bright - element.dark) * element.duty
    return 2 * (element.bright - element.dark) * float(np.sin(np.pi * order * element.duty)) / (np.pi * order * mean)


def check(chart: Chart) -> Chart:
    """`chart`, if it can be: ArgumentError naming the first element whose numbers contradict one another."""
    for i, element in enumerate(chart.elements):
        where = f"element {i} ({type(element).__name__.lower()})"
        for problem in _problems(element):
            raise ArgumentError(f"{where}: {problem}")
    marks = sum(fiducial.rings == 2 for fiducial in chart.fiducials)
    if chart.fiducials and (len(chart.fiducials) < 4 or marks != 1):
        raise ArgumentError(
            f"fiducials: at least 4 are needed, one of them with 2 rings; there are {len(chart.fiducials)}, {marks} of them so"
        )
    return chart


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
            yield "period and size must be positive, duty inside (0, 1)"
        if element.profile != "lines" and element.duty != 0.5:
            yield f"duty is 0.5 for {element.profile}, got {element.duty:g}"
    if isinstance(element, Star) and not (0 <= element.inner < element.outer and element.cycles >= 8):
        yield "a star needs 0 <= inner < outer radius and at least 8 cycles"
    if isinstance(element, Dots) and not (0 < 2 * element.radius < element.pitch and element.centres):
        yield "dots need centres, and 0 < 2 radius < pitch"
