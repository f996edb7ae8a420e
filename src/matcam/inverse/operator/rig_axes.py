"""Parameters of a rig that a fit may change, each along its own axis, and their priors.

A width - of the lens, the lamp, the registration - acts through its square, which adds to the variance of all other
blurs. Its coordinate is half the logarithm of that total variance: the record of a pixel is smooth in it down to a
width of 0. For parameters that are known to a few per cent or are not widths, the coordinate is ln(value / value of the
rig).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.camera.camera import Camera
from matcam.camera.parameters import Uncertainty
from matcam.core.errors import ArgumentError
from matcam.core.jax import jnp
from matcam.forward.integral.blur import Blur, blur_of
from matcam.rigs import Rig
from matcam.sample.curved import Cylinder

LENS = "optics.sigma_px"
"""Name of the width of a Gaussian lens."""
LAMP, APERTURE = "lamp_radius", "aperture"
SHAPE = "lens shape"
"""Name of the shape of the lens's kernel, its variance unchanged: 0 as in the rig, -1 as flat as a disc, above 0 with
longer tails.
"""
STRETCH = "lens stretch"
"""Name of the stretch: variance of the kernel of the lens along the plane of camera and lamp less that across it, over the
variance.
"""
SHAPES = (SHAPE, STRETCH)
"""Changes of the kernel of the lens at constant variance, linear in their coordinates."""
WIDTHS = (LAMP, "jitter", APERTURE)
"""Fields of `Rig` that widen a highlight."""

_FREE_RANGE = 0.5
"""Half range of ln(value / value of the rig), for a free parameter that is not a width."""
_WIDEST_LENS, _WIDEST = 0.5, 0.2
"""Largest coordinate of a free width: of the lens, and of the others, whose blur varies over the image."""
_NEARBY = 0.03
"""Largest coordinate of a lamp that is fitted only near the value of the rig."""
_SHARPEST = 0.1
"""Width of a lens below which rules are extrapolated, px: the border of a pixel becomes a step that their nodes do not
resolve.
"""
_NARROWEST = 1e-3
"""Smallest width of a lens, px, so that its logarithm exists."""
_PRIOR_RANGE = 5.0
"""Half range in standard deviations, for a parameter with a prior."""
_GUESS = 0.25
"""Relative standard deviation of the width of a lens above which it is a guess, whose width may be 0."""
_LENS_WIDTHS = ("sigma_px", "f_number", "blur_diameter_px")
"""Parameters of lenses that scale their kernel."""
ASSUMED = 0.1
"""Relative standard deviation of the width of a lens if its profile gives none."""
SHAPE_SPREAD = 0.55
"""Relative change of variance of the two kernels that change the shape of a lens; see `SHAPE_SHARE`."""
SHAPE_SHARE = 1 / (6 * SHAPE_SPREAD**2)
"""Share of both kernels, less twice the lens itself, that gives a Gaussian the fourth moment of a disc of its variance
and half its central value.
"""
_SHAPE_RANGE, _STRETCH_RANGE = (-1.5, 4.0), (-1.5, 1.5)
STRETCH_SPREAD = 0.3
"""Relative change of variance of the two kernels whose difference changes the stretch: one is widened along, one across."""
_STRETCH_STD = 0.5
"""Prior standard deviation of the stretch. Third-order coma has a stretch of 1."""
_COUNTS = ((0.03, 3), (0.15, 5), (np.inf, 9))
"""Half range of an axis -> number of its points."""


class Axis(NamedTuple):
    """Axis of one parameter. Its coordinate is s = ln((value^2 + softening^2) / (base^2 + softening^2)) / 2.

    Attributes:
        name: name of the parameter, as in `Camera.parameters`, or a field of `Rig`.
        base: the rig's value, at coordinate 0.
        softening: root of the variance of the other blurs, in the parameter's unit; 0: the coordinate is ln(value / base).
        low: smallest coordinate.
        high: largest coordinate.
        points: coordinates at which a rule is computed; 0 is among them.
        by_variance: whether a lamp's disc counts by its variance alone, as a Gaussian, because its size is not known.
            Default: False.
    """

    name: str
    base: float
    softening: float
    low: float
    high: float
    points: tuple[float, ...]
    by_variance: bool = False

    def value(self, coordinate: float) -> float:
        """Return the parameter at a coordinate."""
        if self.name in SHAPES:
            return coordinate
        return float(np.sqrt(self.square(coordinate, 0.0)[0]))

    def square(self, coordinate: float, std: float) -> tuple[float, float]:
        """Return the square of the parameter and its standard deviation: blurs add in quadrature, so it is linear near 0."""
        total = float((self.base**2 + self.softening**2) * np.exp(2 * coordinate))
        return max(total - self.softening**2, 0.0), 2 * total * std

    def slope(self, coordinate: float, std: float) -> float:
        """Compute d value / d coordinate, as a secant to one standard deviation up.

        At a width of 0 the derivative is infinite.
        """
        if self.name in SHAPES:
            return 1.0
        step = max(std, 1e-6)
        return (self.value(coordinate + step) - self.value(coordinate)) / step


def shape_axes(rig: Rig) -> tuple[tuple[Axis, ...], tuple[float, ...]]:
    """Return the axes of unknown shape of the kernel of a lens at its variance, and their standard deviations.

    Images of a cylinder show one direction of the kernel.
    """
    axes = Axis(SHAPE, 0.0, 0.0, *_SHAPE_RANGE, (0.0, 1.0)), Axis(STRETCH, 0.0, 0.0, *_STRETCH_RANGE, (0.0, 1.0))
    count = 1 if isinstance(rig.sample, Cylinder) else 2
    return axes[:count], (1.0, _STRETCH_STD)[:count]


class KnownLens(NamedTuple):
    """Prior knowledge of a camera's lens.

    Attributes:
        uncertainty: of the camera's parameters; None: it has none.
        words: the same, in words.
        assumed: whether no uncertainty was specified, so that a tenth of the width is assumed.
        exact: whether the lens is specified as exact, or has no width.
    """

    uncertainty: Uncertainty | None
    words: str
    assumed: bool
    exact: bool


def known_lens(camera: Camera) -> KnownLens:
    """Return the prior of the lens of a camera: that of its profile, or a tenth of its width."""
    if camera.uncertainty is not None and camera.uncertainty.names:
        if any(std > 0 for std in camera.uncertainty.std().values()):
            return KnownLens(camera.uncertainty, "stated", assumed=False, exact=False)
        return KnownLens(camera.uncertainty, "stated as exact", assumed=False, exact=True)
    widths = {
        name: ASSUMED * float(value)
        for name, value in camera.parameters().items()
        if name.startswith("optics.") and name.rsplit(".", 1)[-1] in _LENS_WIDTHS and float(value) > 0
    }
    if not widths:
        return KnownLens(None, "none stated: taken as exact", assumed=False, exact=True)
    return KnownLens(
        Uncertainty.of(widths), f"none stated: {ASSUMED:.0%} of the lens's width", assumed=True, exact=False
    )


def is_guess(name: str, relative: float) -> bool:
    """Check whether a relative standard deviation makes a width a guess, whose axis is `free_axis`."""
    return name == LENS and relative >= _GUESS


def guess_std(axis: Axis, relative: float) -> float:
    """Return the standard deviation along a free axis of a width with a relative one: the step upwards."""
    wider = (axis.base * (1 + relative)) ** 2 + axis.softening**2
    return float(0.5 * np.log(wider / (axis.base**2 + axis.softening**2)))


def prior_axis(name: str, base: float, std: float) -> Axis:
    """Return the axis of a parameter with a relative standard deviation."""
    half = round(float(np.clip(_PRIOR_RANGE * std, 0.02, _FREE_RANGE)), 6)
    return Axis(name, base, 0.0, -half, half, _points(-half, half))


def widths_of(rig: Rig) -> tuple[str, ...]:
    """Name the widths that may be free. The source disc of a cylinder is fixed."""
    return tuple(name for name in WIDTHS if name != LAMP or not isinstance(rig.sample, Cylinder))


def free_axis(name: str, rig: Rig, *, nearby: bool = False) -> Axis:
    """Return the axis of a parameter without a prior. ArgumentError for one that the rig lacks.

    nearby: whether the radius of the lamp is fitted only near the value of the rig, a point source by its variance.
    This suffices where rig and data agree, and discs are slow.
    """
    parameters = rig.camera.parameters()
    if name not in parameters and name not in widths_of(rig):
        raise ArgumentError(
            f"free names {name!r}, which this camera lacks; it has {', '.join(sorted(parameters))}; the rig has "
            f"{', '.join(widths_of(rig))}"
        )
    base = float(getattr(rig, name) if name in WIDTHS else parameters[name])
    softening = _softening(name, rig)
    if not softening:
        if base <= 0:
            raise ArgumentError(f"{name} is 0 in this rig: it cannot be left free")
        return Axis(name, base, 0.0, -_FREE_RANGE, _FREE_RANGE, _points(-_FREE_RANGE, _FREE_RANGE))
    total = base**2 + softening**2
    narrowest = _NARROWEST if name == LENS else 0.0
    low, high = 0.5 * np.log((narrowest**2 + softening**2) / total), _WIDEST_LENS if name == LENS else _WIDEST
    if nearby and name == LAMP:
        low, high = max(low, -_NEARBY), _NEARBY
    sharpest = 0.5 * np.log((_SHARPEST**2 + softening**2) / total) if name == LENS else low
    points = _points(min(sharpest, -1e-3) if low < 0 else 0.0, high)
    return Axis(name, base, softening, float(low), high, points, by_variance=nearby and name == LAMP and base == 0)


def rig_with(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Return the rig with other values of these parameters."""
    camera = rig.camera.with_parameters({name: value for name, value in values.items() if name not in WIDTHS})
    rig = eqx.tree_at(lambda r: r.camera, rig, camera)
    if LAMP in values:
        rig = eqx.tree_at(lambda r: r.lamp, rig, rig.lamp.with_angular_radius(float(values[LAMP])))
    widths = [name for name in WIDTHS if name in values and name != LAMP]
    new = tuple(jnp.asarray(float(values[name])) for name in widths)
    return eqx.tree_at(lambda r: tuple(getattr(r, name) for name in widths), rig, new) if widths else rig


class MovedBlur(NamedTuple):
    """Blur at one point of an axis.

    Attributes:
        blur: the blur.
        rough: whether a source disc counts as a Gaussian at all positions. Default: False.
        stretch: variances that are added to it along the plane of camera and lamp and across it, px^2. Default: none.
    """

    blur: Blur
    rough: bool = False
    stretch: tuple[float, float] = (0.0, 0.0)


def blurs_along(rig: Rig, own: Blur, axis: Axis) -> list[MovedBlur]:
    """Compute the blurs whose rules an axis needs. own: that of the rig."""
    if axis.name == STRETCH:
        more = STRETCH_SPREAD * own.std_of_half**2
        return [MovedBlur(own, stretch=stretch) for stretch in ((more, 0.0), (0.0, more))]
    if axis.name == SHAPE:
        scales = (1 + SHAPE_SPREAD, 1 - SHAPE_SPREAD)
        return [MovedBlur(dataclasses.replace(own, stds=own.stds * np.sqrt(scale))) for scale in scales]
    moved = (rig_with(rig, {axis.name: axis.value(point)}) for point in axis.points if point)
    # the dependence of the residual on lens parameters is second order and is neglected
    rest = own.rest if own.rest is not None and own.rest.even else None
    blurs = (blur_of(one, in_discs=True, whole=own.rest is not None, rest=rest) for one in moved)
    return [MovedBlur(blur, axis.by_variance) for blur in blurs]


def along_axes(axes: tuple[Axis, ...], name: str, along: str, values: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Return the values of the rig by name, and their differences at every point of every axis."""
    own, *others = values
    named = {name: own}
    for n, changes in enumerate(_changes_along(axes, own, others)):
        named |= {f"{along}{n}.{point}": change for point, change in enumerate(changes)}
    return named


def _changes_along(axes: tuple[Axis, ...], weight: np.ndarray, others: list[np.ndarray]) -> list[list[np.ndarray]]:
    """Compute the differences of the weights at every point of every axis. others: weights of `blurs_along`, in order."""
    changes = (other - weight for other in others)
    along = []
    for axis in axes:
        if axis.name == SHAPE:
            along.append([0 * weight, SHAPE_SHARE * (next(changes) + next(changes))])
        elif axis.name == STRETCH:
            along.append([0 * weight, (next(changes) - next(changes)) / (2 * STRETCH_SPREAD)])
        else:
            along.append([next(changes) if point else 0 * weight for point in axis.points])
    return along


def axis_selection(axes: Sequence[Axis], among: Sequence[Axis]) -> np.ndarray:
    """Return the (axes, among) matrix that maps coordinates along some axes to those along more."""
    return np.array([[axis == other for other in among] for axis in axes], dtype=float).reshape(len(axes), len(among))


def _softening(name: str, rig: Rig) -> float:
    """Compute the root of the variance of all other blurs at the middle of the sphere, in the unit of the parameter; 0
    for no width.
    """
    pixel = float(rig.camera.pixel.half_width) / np.sqrt(3)
    if name == LENS:
        return float(np.hypot(pixel, rig.jitter))
    if name not in WIDTHS:
        return 0.0
    lens = blur_of(rig).std_of_half ** 2
    total = float(np.sqrt(max(lens - (float(rig.jitter) ** 2 if name == "jitter" else 0.0), 0.0) + pixel**2))
    # docs/model.md 3: a lamp spreads light by a quarter of its radius on the sphere, focus by a quarter of the circle of
    # confusion
    per_px = {"jitter": 1.0, LAMP: 4 / float(rig.sample.radius), "aperture": 8 / float(rig.sample.radius)}  # type: ignore[attr-defined]
    return total * per_px[name]


def _points(low: float, high: float) -> tuple[float, ...]:
    """Return Chebyshev's points, with the one next to 0 moved to 0."""
    half = (high - low) / 2
    count = next(count for largest, count in _COUNTS if half <= largest)
    points = (low + high) / 2 + half * np.cos(np.pi * np.arange(count) / (count - 1))
    points[np.argmin(np.abs(points))] = 0.0
    return tuple(float(p) for p in np.round(points, 12))
