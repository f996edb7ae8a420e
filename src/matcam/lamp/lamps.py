"""Lamps: distance and size of the source disc (docs/model.md 10).

The position of the lamp in an image is given by the angle between lamp and optical axis, and by the azimuth about that
axis. A lamp is isotropic. Its irradiance is 1 at the sample's centre, on a surface that faces the lamp. Lengths are in
radii of the sample.

The light of a disc is the mean of the light of its points. Each point is a lamp (`lamp_points`).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.core import checks
from matcam.core.arrays import is_concrete, xp
from matcam.core.arrays.module import Module, replaced
from matcam.core.errors import ArgumentError

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import jax

_LARGEST_DISC = np.pi / 8
"""Largest angular radius of a source disc, rad."""
STEEPEST = 0.1
"""Lower limit of cos theta_d in the stretch of the image of a source disc. At this limit the image is as long as the sample."""
_TURNS = 2 * np.pi
_AT_CAMERA = 1e-6
"""Distance of a lamp from the camera, relative to the camera's distance, below which the lamp is inside the camera."""


class Lamp(Module):
    """Point source, or source disc that faces the sample's centre."""

    @property
    @abstractmethod
    def nearness(self) -> jax.Array | None:
        """Inverse of the distance from the sample's centre, 1/radii; None for a distant lamp."""

    @property
    @abstractmethod
    def angular_radius(self) -> jax.Array:
        """Angular radius of the disc, seen from the sample's centre, rad."""

    @abstractmethod
    def with_angular_radius(self, angular_radius: float) -> Lamp:
        """Build the same lamp with a disc of another angular radius.

        Args:
            angular_radius: angular radius seen from the sample's centre, rad; not checked.
        """


class DistantLamp(Lamp):
    """Lamp at an infinite distance: a point, or a source disc.

    Args:
        radius: angular radius of the source disc seen from the sample, rad, [0, pi/8]. Default: 0, a point.

    Raises:
        ArgumentError: the radius is out of range, or not a single number.

    Source:
        docs/model.md 3.

    Example:
        >>> matcam.Rig(matcam.rigs.merl().camera, matcam.Sphere(400.0), matcam.DistantLamp(0.004)).lamp
        DistantLamp(radius=0.004)
    """

    radius: jax.Array

    def __init__(self, radius: ArrayLike = 0.0):
        self.radius = checks.scalar("lamp_radius", checks.within("lamp_radius", radius, 0, _LARGEST_DISC, "rad"))

    @property
    def nearness(self) -> None:
        """None, because the distance is infinite."""
        return

    @property
    def angular_radius(self) -> jax.Array:
        """Angular radius of the disc, rad."""
        return self.radius

    def with_angular_radius(self, angular_radius: float) -> DistantLamp:
        """Build a distant lamp with another angular radius, rad."""
        return replaced(self, "radius", xp.asarray(angular_radius))


class NearLamp(Lamp):
    """Lamp at a finite distance, whose irradiance varies over the sample.

    Irradiance is proportional to the inverse square of the distance from the lamp, and to the cosine of the angle of
    incidence.

    Args:
        distance: distance of the lamp from the sample's centre, in radii of the sample, above 1.
        radius: radius of the source disc, in radii of the sample, up to 0.41 of the distance. Default: 0, a point.

    Raises:
        ArgumentError: a parameter is out of range (for example, the lamp is inside the sample), or not a single number.

    Source:
        docs/model.md 10.

    Example:
        A lamp of 7 mm diameter, 700 mm from the centre of a sphere of 50 mm diameter:

        >>> matcam.NearLamp(distance=700 / 25, radius=3.5 / 25)
        NearLamp(distance=28.0, radius=0.14)
    """

    distance: jax.Array
    radius: jax.Array

    def __init__(self, distance: ArrayLike, radius: ArrayLike = 0.0):
        outside = "radii of the sample (the lamp is outside it)"
        far = checks.within("lamp_distance", distance, 1, np.inf, outside, open_low=True, open_high=True)
        self.distance = checks.scalar("lamp_distance", far)
        most = float(np.tan(_LARGEST_DISC) * self.distance) if is_concrete(self.distance) else np.inf
        disc = checks.within("lamp_radius", radius, 0, most, "radii of the sample (of a lamp at this distance)")
        self.radius = checks.scalar("lamp_radius", disc)

    @property
    def nearness(self) -> jax.Array:
        """Inverse distance from the centre of the sample, 1/radii."""
        return 1 / self.distance

    @property
    def angular_radius(self) -> jax.Array:
        """Angular radius of the disc, rad."""
        return xp.arctan(self.radius / self.distance)

    def with_angular_radius(self, angular_radius: float) -> NearLamp:
        """Build a lamp at the same distance with another angular radius, rad."""
        return replaced(self, "radius", xp.tan(angular_radius) * self.distance)


def closeness(lamp_nearness: ArrayLike | None, cos_i: jax.Array) -> jax.Array:
    """Compute the lamp's distance from the centre of the sample, divided by its distance from a point of the surface.

    The ratio is 1 for a distant lamp. The square of the ratio is the irradiance of a surface that faces the lamp,
    relative to the irradiance at the centre.

    Args:
        lamp_nearness: inverse of the lamp's distance from the centre, 1/radii; None: a distant lamp.
        cos_i: cosine of the angle of incidence, no unit.
    """
    if lamp_nearness is None:
        return xp.ones_like(cos_i)
    w = xp.asarray(lamp_nearness)
    return 1 / (xp.sqrt(1 - w**2 * (1 - cos_i**2)) - w * cos_i)


class LampPoint(NamedTuple):
    """Point of a lamp in several images, seen from the sample's centre.

    Attributes:
        angle: angle between the point and the optical axis in each image, rad.
        azimuth: azimuth of the point about the axis, from +x towards +y, rad; the same shape as `angle`.
        distance: distance of the point divided by the distance of the lamp's centre, no unit.
        weight: share of the lamp's irradiance at the sample's centre, no unit.
    """

    angle: np.ndarray
    azimuth: np.ndarray
    distance: float
    weight: float


def lamp_points(lamp: Lamp, lamp_angle: np.ndarray, azimuth: np.ndarray | float, fineness: float) -> list[LampPoint]:
    """Generate the points of a quadrature rule over the source disc.

    The rule is the product of Gauss-Legendre quadrature in the squared radius and equal steps around the disc. For the
    blur that `fineness` specifies, the error of the rule is below 5e-5 of any value above a thousandth of the peak.

    Args:
        lamp: the lamp.
        lamp_angle: angles between the lamp's centre and the optical axis, rad, any shape.
        azimuth: azimuth of the lamp about the optical axis, rad; one value, or the same shape as lamp_angle.
        fineness: ratio of the disc's radius to the standard deviation of the blur of its image, no unit.

    Returns:
        Points of the rule, ring by ring.
    """
    angle, disc = np.asarray(lamp_angle, dtype=np.float64), disc_of(lamp)
    if disc == 0:
        return [LampPoint(angle, np.full_like(angle, azimuth), 1.0, 1.0)]
    rings, spokes = rings_and_spokes(fineness)
    share, weight = np.polynomial.legendre.leggauss(rings)
    points = []
    for ring, (u, ring_weight) in enumerate(zip((1 + share) / 2, weight / 2, strict=True)):
        if lamp.nearness is None:  # uniform over the solid angle of the disc
            up = 1 - u * (1 - np.cos(disc))
            aside, length = np.sqrt((1 - up) * (1 + up)), 1.0
        else:  # a flat disc: its points are further away than its centre, and their irradiance is smaller
            aside, up = np.sqrt(u) * np.tan(disc), 1.0
            length = float(np.hypot(aside, up))
        for turn in (np.arange(spokes) + ring % 2 / 2) * _TURNS / spokes:
            x = up * np.sin(angle) + aside * np.cos(turn) * np.cos(angle)
            z = up * np.cos(angle) - aside * np.cos(turn) * np.sin(angle)
            y = aside * np.sin(turn)
            share_of_light = float(ring_weight / spokes / length**2)
            around = azimuth + np.arctan2(y, x)
            points.append(LampPoint(np.arctan2(np.hypot(x, y), z), around, length, share_of_light))
    return points


def rings_and_spokes(fineness: float) -> tuple[int, int]:
    """Compute the number of rings and the number of points per ring of `lamp_points`."""
    return int(np.ceil(1.3 + 1.1 * fineness)), int(np.ceil(6.5 + 4.2 * fineness))


def disc_of(lamp: Lamp) -> float:
    """Compute the angular radius of a source disc, rad.

    The lamp must be concrete, because the radius determines the number of points.
    """
    return checks.outside_jit(lamp.angular_radius, "the lamp's parameters")


def checked_azimuth(azimuth: ArrayLike, name: str = "azimuth") -> float:
    """Check one azimuth in [-2 pi, 2 pi], rad; see `checked_azimuths`."""
    return float(checks.scalar(name, checked_azimuths(azimuth, name)))


def checked_azimuths(azimuth: ArrayLike, name: str = "azimuth") -> jax.Array:
    """Check azimuths in [-2 pi, 2 pi], rad, any shape.

    Larger values are probably in degrees. name: name of the argument, for the message.
    """
    what = "rad (2 pi is a turn)"
    return checks.within(name, azimuth, -_TURNS, _TURNS, what)


def checked_lamp_angle(lamp_angle: ArrayLike, lamp: Lamp, camera_distance: ArrayLike) -> float:
    """Check one angle between lamp and optical axis, rad; see `checked_lamp_angles`."""
    return float(checks.scalar("lamp_angle", checked_lamp_angles(lamp_angle, lamp, camera_distance)))


def checked_lamp_angles(lamp_angle: ArrayLike, lamp: Lamp, camera_distance: ArrayLike) -> jax.Array:
    """Check that the lamp lights a part of the visible surface.

    Args:
        lamp_angle: angles between lamp and optical axis, rad, any shape.
        lamp: the lamp.
        camera_distance: distance of the camera from the sample's centre, radii.

    Raises:
        ArgumentError: an angle is negative, or the lamp is behind the visible surface or inside the camera.
    """
    camera_distance = checks.outside_jit(camera_distance, "the rig's parameters")
    nearness = 0.0 if lamp.nearness is None else checks.outside_jit(lamp.nearness, "the lamp's parameters")
    most = float(np.arccos(1 / camera_distance) + np.arccos(nearness))
    behind = f"rad (beyond {'pi' if most == np.pi else 'this limit'} the lamp is behind the sample)"
    angle = checks.within("lamp_angle", lamp_angle, 0, most, behind, open_high=True)
    if nearness and np.isfinite(camera_distance):
        apart = xp.hypot(1 / nearness * xp.sin(angle), 1 / nearness * xp.cos(angle) - camera_distance)
        if is_concrete(apart) and bool(xp.any(apart < _AT_CAMERA * camera_distance)):
            raise ArgumentError(
                f"the lamp is inside the camera, {camera_distance:g} radii from the sample's centre on the optical axis: "
                "give another lamp_angle or lamp_distance"
            )
    return angle
