"""Parameters of a rig that a fit may change, each along its own axis, and their priors.

The square of a width (of the lens, the lamp or the registration) adds to the variance of all other blurs. The coordinate
of a width is half the logarithm of this total variance, relative to that of the rig. The record of a pixel is a smooth
function of this coordinate down to a width of 0. For parameters that are known to a few per cent or are not widths, the
coordinate is ln(value / value of the rig).
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
"""Name of the parameter for the width of a Gaussian lens."""
LAMP, APERTURE = "lamp_radius", "aperture"
"""Names of the angular radius of the source disc and of the relative aperture of the rig."""
WIDTH = "lens_width"
"""Name of the logarithm of the width of a lens without a width parameter, relative to the lens of the rig, no unit."""
SHAPE = "lens_shape"
"""Name of the change of the fourth moment of the kernel of the lens at constant variance, no unit. It is 0 for the lens of
the rig, -1 for a kernel that is as flat as a disc, and positive for longer tails.
"""
SIXTH, EIGHTH = "lens_sixth_moment", "lens_eighth_moment"
"""Names of the changes of the next even moments of the kernel of the lens at constant lower moments, no unit. With `SHAPE`
they describe a disc to 2 % of its difference from the Gaussian of the same variance. This also holds at the limb, where a
highlight is narrower than the lens.
"""
STRETCH = "lens_stretch"
"""Name of the stretch: variance of the kernel of the lens along the plane of camera and lamp minus that across it, divided
by the variance.
"""
WIDTHS = (LAMP, "jitter", APERTURE)
"""Names of the fields of `Rig` that widen a highlight."""

_FREE_RANGE = 0.5
"""Half the range of ln(value / value of the rig) of a free parameter that is not a width."""
_WIDEST_LENS, _WIDEST = 0.5, 0.2
"""Largest coordinate of the free width of a lens, and of any other free width. The second is smaller, because the blur of
lamp and defocus varies over the image.
"""
_NEARBY = 0.03
"""Largest coordinate of the radius of a lamp that is fitted only near the value of the rig."""
_SHARPEST = 0.1
"""Width of a lens below which rules are extrapolated, px. For a sharper lens the border of a pixel is a step that the
nodes of the rules do not resolve.
"""
_NARROWEST = 1e-3
"""Smallest width of a lens, px. It is above 0, so that the logarithm of the width exists."""
_PRIOR_RANGE = 5.0
"""Half the range of a parameter with a prior, in standard deviations. A fitted value outside contradicts the prior."""
_GUESS = 0.25
"""Smallest relative standard deviation of the width of a lens that is treated as a guess. A guessed width may be 0."""
_LENS_WIDTHS = ("sigma_px", "f_number", "blur_diameter_px")
"""Names of the lens parameters that scale the kernel."""
ASSUMED = 0.1
"""Relative standard deviation that is assumed for the width of a lens if its profile has no uncertainty."""
_STEP = 0.4
"""Relative step in variance between the Gaussians of a finite difference. A smaller step would amplify the errors of their
quadrature rules.
"""
_COUNTS = ((0.03, 3), (0.15, 5), (np.inf, 9))
"""Pairs (largest half range of an axis, number of its points). A wider range requires a polynomial of higher degree."""


class KernelChange(NamedTuple):
    """Change of the kernel of a lens along a coordinate.

    It is the polynomial through the changes at given points and 0 at coordinate 0. The change at a point is a sum of
    Gaussians. Their variances are relative to that of the Gaussian that is as wide as the lens.

    Attributes:
        points: Gaussians for each coordinate, as (variance along the plane of camera and lamp, variance across it, share), no
            unit. The shares add up to 0.
        std: prior standard deviation of the coordinate.
        low: smallest coordinate.
        high: largest coordinate.
    """

    points: Mapping[float, tuple[tuple[float, float, float], ...]]
    std: float
    low: float
    high: float


def _difference(factor: float, *shares: int) -> dict[float, tuple[tuple[float, float, float], ...]]:
    """Build a finite difference with respect to the variance, from isotropic Gaussians at -2 to 2 steps.

    shares: shares of the five Gaussians, which are multiplied by `factor`.
    """
    scales = (1 + step * _STEP for step in range(-2, 3))
    return {1.0: tuple((scale, scale, factor * share) for scale, share in zip(scales, shares, strict=True) if share)}


def _widened(*points: float) -> dict[float, tuple[tuple[float, float, float], ...]]:
    """Build differences between wider or narrower Gaussians and the lens's kernel.

    points: logarithms of the ratios of the widths.
    """
    return {point: ((np.exp(2 * point), np.exp(2 * point), 1.0), (1.0, 1.0, -1.0)) for point in points}


def _stretched(*points: float) -> dict[float, tuple[tuple[float, float, float], ...]]:
    """Build differences between elliptical Gaussians and the lens's kernel. points: stretches of the Gaussians."""
    return {point: ((1 + point / 2, 1 - point / 2, 1.0), (1.0, 1.0, -1.0)) for point in points}


CHANGES = {
    WIDTH: KernelChange(_widened(-0.25, 0.25), ASSUMED, -0.5, 0.5),
    # a disc has the moments of a mixture of Gaussians whose relative variance has the second central moment -1/3
    SHAPE: KernelChange(_difference(1 / (18 * _STEP**2), 1, -1, 0, -1, 1), 1.0, -1.5, 4.0),
    SIXTH: KernelChange(_difference(1 / (36 * _STEP**3), -1, 2, 0, -2, 1), 1.0, -3.0, 3.0),  # third central moment: 1/3
    EIGHTH: KernelChange(_difference(1 / (72 * _STEP**4), 1, -4, 6, -4, 1), 1.0, -3.0, 3.0),
    STRETCH: KernelChange(_stretched(-1.0, 1.0), 0.5, -1.5, 1.5),  # third-order coma has 1
}
"""Changes of the kernel of the lens by name. A disc has shape -1 and sixth moment 1, and its eighth moment is below 1."""


class Axis(NamedTuple):
    """Axis of one parameter. Its coordinate is s = ln((value^2 + softening^2) / (base^2 + softening^2)) / 2.

    Attributes:
        name: name of the parameter as in `Camera.parameters`, or of a field of `Rig`.
        base: value of the rig, at coordinate 0.
        softening: root of the variance of the other blurs, in the unit of the parameter; 0: the coordinate is
            ln(value / base).
        low: smallest coordinate.
        high: largest coordinate.
        points: coordinates at which a rule is computed; 0 is among them.
        by_variance: True if a source disc of unknown size is replaced by a Gaussian of the same variance. Default: False.
    """

    name: str
    base: float
    softening: float
    low: float
    high: float
    points: tuple[float, ...]
    by_variance: bool = False

    def value(self, coordinate: float) -> float:
        """Compute the value of the parameter at a coordinate."""
        if self.name in CHANGES:
            return coordinate
        return float(np.sqrt(self.square(coordinate, 0.0)[0]))

    def square(self, coordinate: float, std: float) -> tuple[float, float]:
        """Compute the squared parameter and the standard deviation of the square.

        Blurs add in quadrature, so the square is linear in the coordinate near a width of 0. std: standard deviation of
        the coordinate.
        """
        total = float((self.base**2 + self.softening**2) * np.exp(2 * coordinate))
        return max(total - self.softening**2, 0.0), 2 * total * std

    def slope(self, coordinate: float, std: float) -> float:
        """Compute the derivative of the value with respect to the coordinate.

        It is approximated by a secant that ends one standard deviation `std` above the coordinate, because the derivative
        is infinite at a width of 0.
        """
        if self.name in CHANGES:
            return 1.0
        step = max(std, 1e-6)
        return (self.value(coordinate + step) - self.value(coordinate)) / step


def shape_axes(rig: Rig) -> tuple[tuple[Axis, ...], tuple[float, ...]]:
    """Build the axes of the lens shape, and their prior standard deviations.

    A cylinder has no axis of the stretch, because its images depend on the kernel in one direction only.
    """
    names = (SHAPE, SIXTH, EIGHTH) if isinstance(rig.sample, Cylinder) else (SHAPE, SIXTH, EIGHTH, STRETCH)
    return tuple(map(change_axis, names)), tuple(CHANGES[name].std for name in names)


def change_axis(name: str) -> Axis:
    """Build the axis of a change of the kernel of the lens."""
    change = CHANGES[name]
    return Axis(name, 0.0, 0.0, change.low, change.high, tuple(sorted((0.0, *change.points))))


class KnownLens(NamedTuple):
    """Prior of the lens of a camera.

    Attributes:
        uncertainty: uncertainty of the camera's parameters; None: no uncertainty is specified and the lens has no width
            parameter, or a width of 0.
        words: description of the uncertainty, for messages.
        assumed: True if no uncertainty is specified, and `ASSUMED` is used.
        exact: True if the lens is specified as exact, or has a width of 0.
    """

    uncertainty: Uncertainty | None
    words: str
    assumed: bool
    exact: bool


def known_lens(camera: Camera) -> KnownLens:
    """Determine the prior of the lens of a camera.

    The prior is the uncertainty of the camera if it is specified, and a default otherwise.
    """
    if camera.uncertainty is not None and camera.uncertainty.names:
        if any(std > 0 for std in camera.uncertainty.std().values()):
            return KnownLens(camera.uncertainty, "specified", assumed=False, exact=False)
        return KnownLens(camera.uncertainty, "specified as exact", assumed=False, exact=True)
    widths = {
        name: ASSUMED * float(value)
        for name, value in camera.parameters().items()
        if _is_lens_width(name) and float(value) > 0
    }
    if not widths and any(_is_lens_width(name) for name in camera.parameters()):
        return KnownLens(None, "not specified: assumed to be exact", assumed=False, exact=True)
    known = Uncertainty.of(widths) if widths else None
    return KnownLens(
        known, f"not specified: assumed to be {ASSUMED:.0%} of the lens's width", assumed=True, exact=False
    )


def _is_lens_width(name: str) -> bool:
    return name.startswith("optics.") and name.rsplit(".", 1)[-1] in _LENS_WIDTHS


def is_guess(name: str, relative: float) -> bool:
    """Check whether a parameter is a guessed width of a lens.

    A guess requires `free_axis`. relative: relative standard deviation of the parameter.
    """
    return name == LENS and relative >= _GUESS


def guess_std(axis: Axis, relative: float) -> float:
    """Compute the standard deviation of a width along its free axis.

    It is the step to one standard deviation above the base. relative: relative standard deviation of the width.
    """
    wider = (axis.base * (1 + relative)) ** 2 + axis.softening**2
    return float(0.5 * np.log(wider / (axis.base**2 + axis.softening**2)))


def prior_axis(name: str, base: float, std: float) -> Axis:
    """Build the axis of a parameter with a prior.

    base: value of the rig. std: relative standard deviation of the parameter.
    """
    half = round(float(np.clip(_PRIOR_RANGE * std, 0.02, _FREE_RANGE)), 6)
    return Axis(name, base, 0.0, -half, half, _points(-half, half))


def widths_of(rig: Rig) -> tuple[str, ...]:
    """List the names of the widths that may be free.

    With a cylinder the radius of the source disc is fixed.
    """
    return tuple(name for name in WIDTHS if name != LAMP or not isinstance(rig.sample, Cylinder))


def free_axis(name: str, rig: Rig, *, nearby: bool = False) -> Axis:
    """Build the axis of a parameter without a prior.

    An ArgumentError is raised if the rig does not have the parameter, or if it is 0 and cannot be free.

    nearby: True if the radius of the lamp is fitted only near the value of the rig, and a point source is widened as a
    Gaussian. This suffices if rig and data agree, and is faster than the integration over discs.
    """
    parameters = rig.camera.parameters()
    if name not in parameters and name not in widths_of(rig):
        raise ArgumentError(
            f"free must name parameters of this rig, got {name!r}; the camera has {', '.join(sorted(parameters))}; the rig has "
            f"{', '.join(widths_of(rig))}"
        )
    base = float(getattr(rig, name) if name in WIDTHS else parameters[name])
    softening = _softening(name, rig)
    if not softening:
        if base <= 0:
            raise ArgumentError(
                f"{name} is 0 in this rig and cannot be free: specify a positive value, or another parameter"
            )
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
    """Return the rig with other values of parameters.

    values: value of each parameter by name, as in `Axis`.
    """
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
        rough: True if a source disc is replaced by a Gaussian at all positions. Default: False.
        stretch: variances that are added to the blur along the plane of camera and lamp and across it, px^2. Default: 0.
    """

    blur: Blur
    rough: bool = False
    stretch: tuple[float, float] = (0.0, 0.0)


def blurs_along(rig: Rig, own: Blur, axes: Sequence[Axis]) -> list[MovedBlur]:
    """Compute the blurs at the points of the parameter axes.

    Changes of the lens are not included, see `change_kernels`. own: blur of the rig.
    """
    # the dependence of the residual on lens parameters is second order and is neglected
    residual = own.residual if own.residual is not None and own.residual.even else None
    whole = own.residual is not None
    points = [(axis, point) for axis in axes if axis.name not in CHANGES for point in axis.points if point]
    moved = ((axis, rig_with(rig, {axis.name: axis.value(point)})) for axis, point in points)
    return [
        MovedBlur(blur_of(one, in_discs=True, whole=whole, residual=residual), axis.by_variance) for axis, one in moved
    ]


def change_kernels(own: Blur, axes: Sequence[Axis]) -> list[MovedBlur]:
    """Compute the Gaussians that represent changes of the lens along axes.

    own: blur of the rig.
    """
    variance = own.std_of_half**2
    kernels = []
    for along, across in _change_variances(axes):
        least = min(along, across)
        std = jnp.full(1, np.sqrt(least * variance))
        one = dataclasses.replace(own, weights=jnp.ones(1), stds=std, residual=None)
        kernels.append(MovedBlur(one, stretch=((along - least) * variance, (across - least) * variance)))
    return kernels


def _change_variances(axes: Sequence[Axis]) -> list[tuple[float, float]]:
    """List the distinct variances of the Gaussians that represent changes of the lens, isotropic Gaussians first.

    The two variances of each Gaussian, along and across the plane of camera and lamp, are relative to that of the lens.
    """
    changes = (CHANGES[axis.name] for axis in axes if axis.name in CHANGES)
    terms = (term for change in changes for terms in change.points.values() for term in terms)
    variances = dict.fromkeys((along, across) for along, across, _ in terms)
    return sorted(variances, key=lambda pair: pair[0] != pair[1])


def along_axes(axes: tuple[Axis, ...], name: str, along: str, values: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Compute the differences of values at the points of all axes.

    The result contains the values of the rig and the differences by name. name: name of the values. along: prefix of the
    names of the differences. values: values for the rig, for each of `blurs_along`, and for each of `change_kernels`.
    """
    own, *others = values
    variances = _change_variances(axes)
    kernels = dict(zip(variances, others[len(others) - len(variances) :], strict=True))
    moved = iter(others)
    named = {name: own}
    for n, axis in enumerate(axes):
        change = CHANGES.get(axis.name)
        for number, point in enumerate(axis.points):
            if not point:
                difference = 0 * own
            elif change:
                difference = np.add.reduce([share * kernels[x, y] for x, y, share in change.points[point]])
            else:
                difference = next(moved) - own
            named[f"{along}{n}.{number}"] = difference
    return named


def axis_selection(axes: Sequence[Axis], among: Sequence[Axis]) -> np.ndarray:
    """Build the matrix that maps coordinates along some axes to more axes.

    It has shape (axes, among), and is 1 where the two axes are the same, otherwise 0.
    """
    return np.array([[axis == other for other in among] for axis in axes], dtype=float).reshape(len(axes), len(among))


def _softening(name: str, rig: Rig) -> float:
    """Compute the root of the variance of all other blurs, in the unit of the parameter.

    It applies to the middle of the sphere, and is 0 for a parameter that is not a width.
    """
    pixel = float(rig.camera.pixel.half_width) / np.sqrt(3)
    if name == LENS:
        return float(np.hypot(pixel, rig.jitter))
    if name not in WIDTHS:
        return 0.0
    lens = blur_of(rig).std_of_half ** 2
    total = float(np.sqrt(max(lens - (float(rig.jitter) ** 2 if name == "jitter" else 0.0), 0.0) + pixel**2))
    # docs/model.md 3: the standard deviation of the blur is a quarter of the lamp's radius on the sphere, and a quarter of
    # the circle of confusion
    per_px = {"jitter": 1.0, LAMP: 4 / float(rig.sample.radius), "aperture": 8 / float(rig.sample.radius)}  # type: ignore[attr-defined]
    return total * per_px[name]


def _points(low: float, high: float) -> tuple[float, ...]:
    """Compute Chebyshev points between `low` and `high`. The point closest to 0 is replaced by 0."""
    half = (high - low) / 2
    count = next(count for largest, count in _COUNTS if half <= largest)
    points = (low + high) / 2 + half * np.cos(np.pi * np.arange(count) / (count - 1))
    points[np.argmin(np.abs(points))] = 0.0
    return tuple(float(p) for p in np.round(points, 12))
