"""Parameters of a rig that a fit may change, each along its own axis, and their priors.

The square of a width (of the lens, the lamp or the registration) adds to the variance of all other blurs. The coordinate
of a width is half the logarithm of this total variance, relative to the total variance of the rig. The record of a pixel is a
smooth function of this coordinate down to a width of 0. A change of the lens (`lens_changes.py`) is its own coordinate. For
other parameters the coordinate is ln(value / value of the rig).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from matcam.camera.camera import Camera, camera_with
from matcam.camera.parameters import Uncertainty
from matcam.core.errors import ArgumentError
from matcam.core.jax import jnp
from matcam.core.results.summary import with_std
from matcam.forward.integral.blur import Blur, blur_of
from matcam.inverse.rig.lens_changes import ASSUMED, CHANGES, EIGHTH, SHAPE, SIXTH, STRETCH, VARIANCES
from matcam.rigs import Rig
from matcam.sample.curved import Cylinder

LENS = "optics.sigma_px"
"""Name of the parameter for the width of a Gaussian lens."""
LAMP, APERTURE = "lamp_radius", "aperture"
"""Names of the angular radius of the source disc and of the relative aperture of the rig."""
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
_LENS_WIDTHS = {
    "sigma_px": ("lens blur", " px"),
    "f_number": ("f-number", ""),
    "blur_diameter_px": ("diameter of the defocus blur", " px"),
}
"""Lens parameters that scale the kernel, by name: their terms and units in messages."""
_COLOURS = ("red", "green", "blue")
_COUNTS = ((0.03, 3), (0.15, 5), (np.inf, 9))
"""Pairs (largest half range of an axis, number of its points). A wider range requires a polynomial of higher degree."""
_AMONG = 1001
"""Number of positions among which a point of an axis is chosen."""
_BESIDE_CHANGES = 2
"""Smallest number of points of the width of a lens in addition to those for changes of the lens."""
_APART = 0.05
"""Smallest distance between prescribed points of an axis, relative to its range. A polynomial through closer points is
inaccurate elsewhere.
"""


class Axis(NamedTuple):
    """Axis of one parameter.

    The coordinate is ln((value^2 + softening^2) / (base^2 + softening^2)) / 2, or the value itself for a change of the lens.

    Attributes:
        name: name of the parameter as in `Camera.parameters`, or of a field of `Rig`.
        base: value of the rig, at coordinate 0.
        softening: square root of the variance of the other blurs, in the unit of the parameter; 0 for a parameter that is not
            a width.
        low: smallest coordinate.
        high: largest coordinate.
        points: coordinates at which a rule is computed, including 0.
        by_variance: True if a source disc of unknown size is replaced by a Gaussian with the variance of the disc. Default:
            False.
    """

    name: str
    base: float
    softening: float
    low: float
    high: float
    points: tuple[float, ...]
    by_variance: bool = False

    def coordinate(self, value: float) -> float:
        """Compute the coordinate of a value. The parameter must not be a change of the lens."""
        return 0.5 * float(np.log((value**2 + self.softening**2) / (self.base**2 + self.softening**2)))

    def std(self, relative: float) -> float:
        """Compute the standard deviation of the coordinate of a parameter of the camera.

        For a width it is the step to one standard deviation above the base.

        relative: relative standard deviation of the parameter.
        """
        return self.coordinate(self.base * (1 + relative)) if self.softening else relative

    def value(self, coordinate: float) -> float:
        if self.name in CHANGES:
            return coordinate
        return float(np.sqrt(self.square(coordinate, 0.0)[0]))

    def square(self, coordinate: float, std: float) -> tuple[float, float]:
        """Compute the squared parameter and the standard deviation of the square.

        Blurs add in quadrature, so the square of a width is linear in the coordinate near a width of 0.

        std: standard deviation of the coordinate.
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

    def lens_share(self, coordinate: float) -> tuple[float, float]:
        """Compute the share of a lens in the variance of the whole blur, relative to the share at coordinate 0.

        The second result is the derivative of the first with respect to the coordinate.
        """
        others = self.softening**2 / (self.base**2 + self.softening**2)
        left = others * float(np.exp(-2 * coordinate))
        return max(1 - left, 0.0) / (1 - others), 2 * left / (1 - others)


def scaled_changes(axes: Sequence[Axis], coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scale the changes of the lens by its share of the variance.

    The share is that of the lens in the variance of the whole blur, relative to the share at coordinate 0. The changes are
    relative to the moments of the lens, so their effect vanishes with the width of the lens. Moments of order 2 k are divided
    by the k-th power of the variance. A change d of such a moment of the lens changes the moment of the whole blur by d times
    the k-th power of the share.

    Returns:
        Coordinates at which a lens with the width of the rig's lens has the same effect, (axes,), and their derivatives with
        respect to the given coordinates, (axes, axes). Coordinates of other parameters are not changed.
    """
    scaled, slopes = np.array(coordinates, dtype=float), np.eye(len(axes))
    for lens in (n for n, axis in enumerate(axes) if axis.name == LENS and axis.base > 0):
        share, by_width = axes[lens].lens_share(scaled[lens])
        for n, axis in enumerate(axes):
            power = CHANGES[axis.name].power if axis.name in CHANGES else 0
            if power:
                slopes[n, n] = share**power
                slopes[n, lens] = scaled[n] * power * share ** (power - 1) * by_width
                scaled[n] *= share**power
    return scaled, slopes


def shape_axes(rig: Rig) -> tuple[tuple[Axis, ...], tuple[float, ...]]:
    """Build the axes of the lens shape, and their prior standard deviations.

    A cylinder has no axis of the stretch, because its images depend on the kernel in one direction only.
    """
    names = (SHAPE, SIXTH, EIGHTH) if isinstance(rig.sample, Cylinder) else (SHAPE, SIXTH, EIGHTH, STRETCH)
    return tuple(map(change_axis, names)), tuple(CHANGES[name].std for name in names)


def change_axis(name: str) -> Axis:
    change = CHANGES[name]
    return Axis(name, 0.0, 0.0, change.low, change.high, tuple(sorted((0.0, *change.points))))


class KnownLens(NamedTuple):
    """Prior of the lens of a camera.

    Attributes:
        uncertainty: uncertainty of the camera's parameters; None: no uncertainty is specified and the lens has no width
            parameter, or a width of 0.
        words: description of the width of the lens and of its uncertainty, for messages, such as "lens blur 0.510 ± 0.010 px".
        assumed: True if no uncertainty is specified, and `ASSUMED` is used.
        exact: True if the lens is specified as exact, or has a width of 0 and no specified uncertainty.
    """

    uncertainty: Uncertainty | None
    words: str
    assumed: bool
    exact: bool


def known_lens(camera: Camera) -> KnownLens:
    """Determine the prior of the lens of a camera.

    The prior is the uncertainty of the camera if it is specified, and a default otherwise.
    """
    given = camera.uncertainty
    widths = {name: float(value) for name, value in camera.parameters().items() if is_lens_width(name)}
    if given is not None and given.names:
        std = given.std()
        if not any(std.values()):
            return KnownLens(given, f"{_lens_text(widths, {})}, specified as exact", assumed=False, exact=True)
        words = _lens_text(widths, std)
        if any(width > 0 and is_guess(name, std.get(name, 0.0) / width) for name, width in widths.items()):
            words = f"assumed {words}; measure it with matcam calibrate"
        return KnownLens(given, words, assumed=False, exact=False)
    assumed = {name: ASSUMED * width for name, width in widths.items() if width > 0}
    words = f"{_lens_text(widths, assumed)}; no uncertainty is specified"
    if widths and not assumed:
        return KnownLens(None, f"{words}, so the lens is assumed to be exact", assumed=False, exact=True)
    if not assumed:
        return KnownLens(None, words, assumed=True, exact=False)
    words += f", so a standard deviation of {ASSUMED:.0%} is assumed"
    return KnownLens(Uncertainty.of(assumed), words, assumed=True, exact=False)


def _lens_text(widths: Mapping[str, float], std: Mapping[str, float]) -> str:
    """Format the widths of a lens with their standard deviations, by the names of the parameters."""
    parts = []
    for name, width in widths.items():
        *path, last = name.split(".")
        what, unit = _LENS_WIDTHS[last]
        colour = "".join(f" of {part}" for part in path if part in _COLOURS)
        number = with_std(width, std[name]) if std.get(name, 0.0) > 0 else f"{width:.4g}"
        parts.append(f"{what}{colour} {number}{unit}")
    return ", ".join(parts) or "lens without a width parameter"


def is_lens_width(name: str) -> bool:
    """Check whether a parameter of a camera is a width of a lens, which scales its kernel."""
    return name.startswith("optics.") and name.rsplit(".", 1)[-1] in _LENS_WIDTHS


def is_guess(name: str, relative: float) -> bool:
    """Check whether a parameter is a guessed width of a lens.

    relative: relative standard deviation of the parameter.
    """
    return name == LENS and relative >= _GUESS


def prior_axis(name: str, rig: Rig, std: float) -> Axis:
    """Build the axis of a camera parameter that has a prior.

    For a guessed width of a lens, the axis covers the whole range.

    std: relative standard deviation of the parameter.
    """
    if is_guess(name, std):
        return free_axis(name, rig)
    half = round(float(np.clip(_PRIOR_RANGE * std, 0.02, _FREE_RANGE)), 6)
    if name == LENS:
        return _lens_axis(rig, half)
    return Axis(name, float(rig.camera.parameters()[name]), 0.0, -half, half, _points(-half, half, _count(half)))


def widths_of(rig: Rig) -> tuple[str, ...]:
    """List the names of the widths that may be free.

    With a cylinder the radius of the source disc is fixed.
    """
    return tuple(name for name in WIDTHS if name != LAMP or not isinstance(rig.sample, Cylinder))


def free_axis(name: str, rig: Rig, *, nearby: bool = False) -> Axis:
    """Build the axis of a parameter without a prior.

    An ArgumentError is raised if the rig does not have the parameter, or if the parameter is 0 and cannot be free.

    nearby: True if the radius of the lamp is fitted only near the value of the rig, and a point source is widened as a
    Gaussian. This range suffices if rig and data agree, and takes less time than the integration over discs.
    """
    parameters = rig.camera.parameters()
    if name not in parameters and name not in widths_of(rig):
        raise ArgumentError(
            f"a free parameter must be one of the camera or the rig, got {name!r}; the camera has "
            f"{', '.join(sorted(parameters))}; the rig has {', '.join(widths_of(rig))}"
        )
    if name == LENS:
        return _lens_axis(rig)
    base = float(getattr(rig, name) if name in WIDTHS else parameters[name])
    softening = _softening(name, rig)
    if not softening:
        if base <= 0:
            raise ArgumentError(
                f"{name} is 0 in this rig and cannot be free: specify a positive value, or another parameter"
            )
        return Axis(name, base, 0.0, -_FREE_RANGE, _FREE_RANGE, _points(-_FREE_RANGE, _FREE_RANGE, _count(_FREE_RANGE)))
    low, high = 0.5 * float(np.log(softening**2 / (base**2 + softening**2))), _WIDEST
    if nearby and name == LAMP:
        low, high = max(low, -_NEARBY), _NEARBY
    start = min(low, -1e-3) if low < 0 else 0.0
    points = _points(start, high, _count((high - start) / 2))
    return Axis(name, base, softening, low, high, points, by_variance=nearby and name == LAMP and base == 0)


def _lens_axis(rig: Rig, half: float | None = None) -> Axis:
    """Build the axis of the width of a Gaussian lens.

    The points include the widths of the isotropic Gaussians of the changes of the lens. These Gaussians therefore require no
    separate rules.

    half: half the range of the logarithm of the width. Default: None, the whole range.
    """
    base, softening, own = float(rig.camera.parameters()[LENS]), _softening(LENS, rig), blur_of(rig)
    whole = Axis(LENS, base, softening, 0.0, _WIDEST_LENS, ())
    sharpest = whole.coordinate(_SHARPEST)
    if half is None:
        low, first, high = whole.coordinate(_NARROWEST), sharpest, whole.high
    else:
        low, high = (whole.coordinate(base * float(np.exp(end))) for end in (-half, half))
        first = low
    given = [lens_coordinate(own, variance) for variance in VARIANCES]
    count = max(_count((high - low) / 2), len(given) + _BESIDE_CHANGES)
    given = [point for point in given if point >= min(first, sharpest)]
    return whole._replace(low=low, high=high, points=_points(min(first, -1e-3), high, count, given))


def rig_with(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Replace values of parameters of a rig.

    values: value of each parameter by name, as in `Axis`.
    """
    camera = camera_with(rig.camera, {name: value for name, value in values.items() if name not in WIDTHS})
    rig = eqx.tree_at(lambda r: r.camera, rig, camera)
    if LAMP in values:
        rig = eqx.tree_at(lambda r: r.lamp, rig, rig.lamp.with_angular_radius(float(values[LAMP])))
    widths = [name for name in WIDTHS if name in values and name != LAMP]
    new = tuple(jnp.asarray(float(values[name])) for name in widths)
    return eqx.tree_at(lambda r: tuple(getattr(r, name) for name in widths), rig, new) if widths else rig


def lens_coordinate(own: Blur, variance: float) -> float:
    """Compute the coordinate of the width of a Gaussian lens.

    Args:
        own: blur of the rig.
        variance: variance of lens and registration, divided by its value for the rig, no unit.
    """
    pixel, lens = float(own.pixel.half_width) ** 2 / 3, own.std_of_half**2
    return round(0.5 * float(np.log((variance * lens + pixel) / (lens + pixel))), 12)


def axis_selection(axes: Sequence[Axis], among: Sequence[Axis]) -> np.ndarray:
    """Build the matrix that maps coordinates along `axes` to coordinates along `among`.

    The matrix has shape (axes, among). An element is 1 where the two axes are equal, otherwise 0.
    """
    return np.array([[axis == other for other in among] for axis in axes], dtype=float).reshape(len(axes), len(among))


def _softening(name: str, rig: Rig) -> float:
    """Compute the square root of the variance of all other blurs, in the unit of the parameter.

    The result is valid in the middle of the sphere. It is 0 for a parameter that is not a width.
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


def _count(half: float) -> int:
    return next(count for largest, count in _COUNTS if half <= largest)


def _points(low: float, high: float, count: int, given: Sequence[float] = ()) -> tuple[float, ...]:
    """Compute Leja points: 0, the given points, and points between `low` and `high` that are far from all others.

    Each point maximises the product of its distances to the preceding points. Given points that are too close to others are
    omitted.
    """
    points = [0.0]
    for point in given:
        if np.min(np.abs(np.subtract(points, point))) >= _APART * (high - low):
            points.append(point)
    among = np.linspace(low, high, _AMONG)
    while len(points) < count:
        points.append(among[np.argmax(np.prod(np.abs(among[:, None] - points), axis=1))])
    return tuple(float(p) for p in np.round(points, 12))
