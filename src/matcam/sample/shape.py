"""Shapes of samples: image positions of surface normals (docs/model.md 3).

The x axis of the image lies in the plane of camera and lamp, and the y axis is perpendicular to this plane. Image positions
are in px from the optical axis, which passes through the centre of the sample. The lamp is towards +x. Another azimuth of
the lamp rotates these axes relative to the sensor. Distances are in radii of the sample. The nearness of a lamp is the
inverse of its distance; None means a distant lamp.

The image of a flat sample contains one normal, and that of a curved sample (`Sphere`, `Cylinder`) contains many.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from matcam.core import checks
from matcam.core.arrays import is_concrete, xp
from matcam.core.arrays.elementary import arcsine
from matcam.core.arrays.module import Module, static_field
from matcam.core.errors import ArgumentError
from matcam.core.shading import Vector, towards_source
from matcam.sample.sight import angle_on_circle, highlight_between, parallax

if TYPE_CHECKING:
    from jax.typing import ArrayLike

    from matcam.core.jax import AnyArray, jax

_LARGEST = 1e100
"""Largest radius, px. Sums of its square and of the squares of blurs are finite in float64."""


class Element(NamedTuple):
    """Surface elements in the image; arrays that broadcast.

    Attributes:
        normal: unit vector of the surface normal.
        tangent: unit vector of the first tangent, in the plane of the x axis and the optical axis.
        view: unit vector to the camera.
        x: image position along the x axis, px.
        y: image position along the y axis, px.
        area: area in the image divided by the cosine of the viewing angle, px^2 per du dv for an element at (u, v), per
            px^2 for an element at (x, y). The light towards the camera is proportional to this cosine, so the product
            of light and area is regular at the limb.
    """

    normal: Vector
    tangent: Vector
    view: Vector
    x: jax.Array
    y: jax.Array
    area: jax.Array


class Position(NamedTuple):
    """Image position and lamp angle for half and difference angles.

    Attributes:
        x: image position along the x axis, px.
        y: image position along the y axis, px.
        lamp_angle: angle between lamp and optical axis, rad.
    """

    x: jax.Array
    y: jax.Array
    lamp_angle: jax.Array


class Sample(Module):
    """Shape of a sample."""

    @property
    def kind(self) -> str:
        """Name of the shape in files: "sphere", "cylinder" or "flat"."""
        return type(self).__name__.lower()

    def in_words(self) -> str:
        """Describe the shape in words, for titles and pages."""
        return f"{self.kind} sample"

    @abstractmethod
    def px_per_rad(self, theta_o: jax.Array, lamp_nearness: ArrayLike | None = None) -> tuple[jax.Array, jax.Array]:
        """Compute the shift of the image per rotation of the normal, px/rad.

        Args:
            theta_o: angle between normal and view at the highlight, rad.
            lamp_nearness: inverse of the lamp's distance, 1/radii. Default: None, a distant lamp.

        Returns:
            Shifts in the plane of camera and lamp and perpendicular to it; infinite in a direction with a constant normal.
        """


class Flat(Sample):
    """Flat sample, tilted away from the camera.

    The normal of a flat sample is constant, so the camera blurs the texture but not the angular dependence of the
    reflectance.

    Source:
        Holzschuch & Pacanowski (2017), section 3; docs/model.md 3.

    Example:
        >>> round(float(matcam.Flat().frequency_on_sensor(0.1, np.pi / 3)), 6)
        0.2
    """

    def px_per_rad(self, theta_o: jax.Array, lamp_nearness: ArrayLike | None = None) -> tuple[jax.Array, jax.Array]:
        """Return infinity in both directions, because the normal is constant."""
        return xp.full_like(theta_o, xp.inf), xp.full_like(theta_o, xp.inf)

    def frequency_on_sensor(self, frequency: ArrayLike, theta_o: ArrayLike) -> jax.Array:
        """Compute the frequency of a texture on the sensor, cycles/px.

        The texture varies along the direction in which the tilt shortens the image of the sample, by the factor
        cos(theta_o).

        Args:
            frequency: frequency of the texture without tilt, cycles/px.
            theta_o: tilt, rad, [0, pi/2); broadcasts with frequency.

        Raises:
            ArgumentError: an argument is not finite or out of range, or the shapes do not broadcast.

        Source:
            Holzschuch & Pacanowski (2017), (4).
        """
        frequency, theta_o = checks.number("frequency", frequency), checks.viewing_angle("theta_o", theta_o)
        checks.broadcast_shape(frequency=frequency, theta_o=theta_o)
        return frequency / xp.cos(theta_o)

    def __repr__(self) -> str:
        return "Flat()"


class Curved(Sample):
    """Curved sample, whose image contains many normals.

    The surface has two coordinates: u, the angle of the normal from the optical axis in the plane of camera and lamp, rad,
    and v, perpendicular to this plane. At every v, the visible and lit part of the surface is one interval of u, with sharp
    ends.

    Attributes:
        radius: radius of the limb in the image, px.
        distance: distance of the camera from the centre of the sample, in radii of the sample; infinite for an
            orthographic camera.
        distant: True if the distance is infinite. The view direction is then constant.
    """

    radius: jax.Array
    distance: jax.Array
    distant: bool = static_field()

    def __repr__(self) -> str:
        far = "" if self.distant else f", distance={self.distance!s}"
        return f"{type(self).__name__}(radius={self.radius!s}{far})"

    def in_words(self) -> str:
        """Describe shape, radius and camera in words, for titles and pages."""
        camera = "" if self.distant else f", camera at {float(self.distance):g} radii"
        return f"{self.kind} of {float(self.radius):g} px radius{camera}"

    def check_resolved(self, blur: AnyArray | float) -> None:
        """Check that the sample is larger than the blur.

        Args:
            blur: half a pixel, or the standard deviation of the lens if that is larger, px.

        Raises:
            ArgumentError: the radius of the sample does not exceed the blur.
        """
        if is_concrete(self.radius) and is_concrete(blur) and not float(blur) < float(self.radius):
            raise ArgumentError(
                f"the sample's radius must exceed the camera's blur of at least {float(blur):g} px, got "
                f"{float(self.radius):g} px"
            )

    @abstractmethod
    def surface(self, u: jax.Array, v: jax.Array) -> Element:
        """Compute the surface element at (u, v).

        Args:
            u: angle of the normal in the plane of camera and lamp, rad; broadcasts with v.
            v: second coordinate of the surface, perpendicular to this plane; rad for a sphere, radii for a cylinder.
        """

    @abstractmethod
    def at(self, x: jax.Array, y: jax.Array) -> tuple[Element, jax.Array]:
        """Compute the surface elements at image positions, and a mask, True for lines of sight that meet the sample.

        Args:
            x: position in the image, px; broadcasts with y.
            y: position in the image, px.
        """

    @abstractmethod
    def coordinates(self, element: Element) -> tuple[jax.Array, jax.Array]:
        """Compute (u, v) of a surface element.

        Args:
            element: the surface element.
        """

    @abstractmethod
    def position(
        self, theta_h: AnyArray, theta_d: AnyArray, phi_d: AnyArray, lamp_nearness: ArrayLike | None = None
    ) -> Position:
        """Compute the image position and the lamp angle for half and difference angles.

        The results are meaningless if light or view is below the horizon.

        Args:
            theta_h: angle between half vector and normal, rad; the angles broadcast.
            theta_d: angle between light and half vector, rad.
            phi_d: azimuth of the light about the half vector, rad.
            lamp_nearness: inverse of the lamp's distance, 1/radii. Default: None, a distant lamp.
        """

    @abstractmethod
    def section(self, v: jax.Array) -> jax.Array:
        """Compute the radius of the section of the surface at v, in radii of the sample.

        Args:
            v: second coordinate of the surface.
        """

    @abstractmethod
    def height(self, element: Element) -> jax.Array:
        """Compute the signed distance of surface elements from the plane of the x axis and the optical axis, radii.

        Args:
            element: the surface elements.
        """

    def point(self, element: Element) -> Vector:
        """Compute the positions of surface elements relative to the centre, radii.

        Args:
            element: the surface elements.
        """
        return element.normal[0], self.height(element), element.normal[2]

    @property
    def nearness(self) -> jax.Array:
        """Inverse of the camera distance, 1/radii; 0: a distant camera."""
        return 1 / self.distance

    @property
    def stretch(self) -> jax.Array:
        """Scale at the depth of the centre, px per radius.

        The scale is radius sqrt(1 - 1 / distance^2) (docs/model.md 3).
        """
        return self.radius * xp.sqrt(1 - self.nearness**2)

    def visible(self, v: jax.Array) -> jax.Array:
        """Compute the largest |u| that is visible at v, rad.

        The result is 0 if no u is visible.

        Args:
            v: second coordinate of the surface.
        """
        return xp.full_like(v, xp.pi / 2) if self.distant else self._seen_from(v, self.nearness)

    def _seen_from(self, v: jax.Array, nearness: jax.Array) -> jax.Array:
        """Compute the largest visible |u - u_0| at v for an observer at the angle u_0, rad.

        The observer is a camera or a lamp in the plane of the x axis and the optical axis. nearness: inverse of the distance
        of the observer, 1/radii.
        """
        section = self.section(v)
        cosine = nearness / xp.where(section > 0, section, 1.0)
        return xp.where(cosine < 1, xp.arccos(xp.where(cosine < 1, cosine, 0.0)), 0.0)

    def lit(
        self, v: jax.Array, lamp_angle: jax.Array, lamp_nearness: ArrayLike | None = None
    ) -> tuple[jax.Array, jax.Array]:
        """Compute the visible and lit interval of u, rad.

        The results are the lower and the upper end. They are equal if no u is both visible and lit.

        Args:
            v: second coordinate of the surface.
            lamp_angle: angle between lamp and optical axis, rad.
            lamp_nearness: inverse of the lamp's distance, 1/radii. Default: None, a distant lamp.
        """
        high = self.visible(v)
        half = xp.pi / 2 if lamp_nearness is None else self._seen_from(v, xp.asarray(lamp_nearness))
        low = xp.maximum(-high, lamp_angle - half)
        high = xp.minimum(high, lamp_angle + half)
        return xp.minimum(low, high), high

    def across(self, x: jax.Array, v: jax.Array) -> jax.Array:
        """Compute the visible u at a column of the image, rad.

        If no u is visible at the column, the nearest visible u is returned.

        Args:
            x: position in the image, px.
            v: second coordinate of the surface.
        """
        section, q = self.section(v), self.nearness
        slope = x / (self.stretch * xp.where(section > 0, section, 1.0))
        if self.distant:
            inside = xp.abs(slope) < 1
            return xp.where(inside, arcsine(xp.where(inside, slope, 0.0)), xp.sign(slope) * xp.pi / 2)
        u = angle_on_circle(slope, slope * section * q)
        end = self.visible(v)
        return xp.clip(u, -end, end)

    def highlight(self, lamp_angle: jax.Array, lamp_nearness: ArrayLike | None = None) -> jax.Array:
        """Compute the angle u of the highlight at v = 0, rad.

        At the highlight, the normal is the half vector. If camera and lamp are distant, u is `lamp_angle` / 2.

        Args:
            lamp_angle: angle between lamp and optical axis, rad.
            lamp_nearness: inverse of the lamp's distance, 1/radii. Default: None, a distant lamp.
        """
        lamp_angle = xp.asarray(lamp_angle, dtype=xp.float64)
        if self.distant and lamp_nearness is None:
            return lamp_angle / 2
        return highlight_between(lamp_angle, self.nearness, 0.0 if lamp_nearness is None else lamp_nearness)

    def lamp_angle(self, theta_d: jax.Array, lamp_nearness: ArrayLike | None = None) -> jax.Array:
        """Compute the angle between lamp and optical axis, rad.

        Args:
            theta_d: half the angle between lamp and camera, seen from the highlight, rad.
            lamp_nearness: inverse of the lamp's distance, 1/radii. Default: None, a distant lamp.
        """
        angle = 2 * theta_d - xp.arcsin(self.nearness * xp.sin(theta_d))
        return angle if lamp_nearness is None else angle - xp.arcsin(lamp_nearness * xp.sin(theta_d))

    def theta_d(self, lamp_angle: jax.Array, lamp_nearness: ArrayLike | None = None) -> jax.Array:
        """Compute half the angle between lamp and camera, rad.

        The angle is seen from the highlight. This function is the inverse of `Curved.lamp_angle`.

        Args:
            lamp_angle: angle between lamp and optical axis, rad.
            lamp_nearness: inverse of the lamp's distance, 1/radii. Default: None, a distant lamp.
        """
        aside = lamp_angle - self.highlight(lamp_angle, lamp_nearness)
        return aside if lamp_nearness is None else aside + parallax(aside, lamp_nearness)[0]

    def px_per_rad(self, theta_o: jax.Array, lamp_nearness: ArrayLike | None = None) -> tuple[jax.Array, jax.Array]:
        """Compute the shift of the image per rotation of the normal, px/rad.

        For a distant camera and lamp, the shift on a sphere is (radius cos theta_o, radius), because x = radius sin theta_o
        (Holzschuch & Pacanowski 2017, (5)). If camera or lamp is near, the half vector also rotates, by half the rotation
        of the line to camera or lamp.
        """
        q = self.nearness
        turn_along, turn_across = self._half_vector_turn(theta_o, lamp_nearness)
        if self.distant:
            across = xp.divide(self.radius, self._turn_across(turn_across))
            return self.radius * xp.cos(theta_o) / (1 + turn_along), across + xp.zeros_like(theta_o)
        t = theta_o - xp.arcsin(q * xp.sin(theta_o))
        depth, length = 1 - q * xp.cos(t), xp.sqrt(1 + q**2 - 2 * q * xp.cos(t))
        turn_along = turn_along + q * (xp.cos(t) - q) / length**2 / 2
        turn_across = turn_across + q / length / (2 * xp.cos(theta_o))
        along = self.stretch * (xp.cos(t) - q) / depth**2 / (1 + turn_along)
        return along, xp.divide(self.stretch / depth, self._turn_across(turn_across))

    @staticmethod
    def _half_vector_turn(theta_d: jax.Array, lamp_nearness: ArrayLike | None) -> tuple[jax.Array, jax.Array]:
        """Compute the rotation of the half vector divided by the rotation of the normal.

        The results are for rotations in the plane of camera and lamp, and for rotations perpendicular to this plane.

        Only the rotation due to a near lamp is included; the ratio is 0 for a distant lamp.
        """
        if lamp_nearness is None:
            return xp.zeros(()), xp.zeros(())
        w = xp.asarray(lamp_nearness)
        t = theta_d - xp.arcsin(w * xp.sin(theta_d))
        length = xp.sqrt(1 + w**2 - 2 * w * xp.cos(t))
        return w * (xp.cos(t) - w) / length**2 / 2, w / length / (2 * xp.cos(theta_d))

    @abstractmethod
    def _turn_across(self, half_vector: jax.Array) -> jax.Array:
        """Compute the rotation of the normal relative to the half vector, rad per radius along y.

        half_vector: rotation of the half vector, rad per radius.
        """

    def line_of_sight(self, normal: Vector, y: jax.Array) -> tuple[Vector, jax.Array, jax.Array]:
        """Compute direction, distance and depth from points to the camera.

        Distance and depth (along the optical axis) are divided by the camera's distance from the centre. They are
        scalars for a distant camera.

        Args:
            normal: surface normal at the points.
            y: distance from the plane of the x axis and the optical axis, radii.
        """
        zero, one = xp.zeros(()), xp.ones(())
        if self.distant:
            return (zero, zero, one), one, one
        q = self.nearness
        view, square = towards_source((zero, zero, one), (normal[0], y, normal[2]), q)
        return view, xp.sqrt(square), 1 - q * normal[2]


def checked_radius(radius: ArrayLike) -> jax.Array:
    return checks.scalar("radius", checks.within("radius", radius, 0, _LARGEST, "px", open_low=True))


def checked_distance(distance: ArrayLike) -> jax.Array:
    """Check the distance of a camera from the centre of the sample, radii, above 1; infinity is allowed."""
    what = "radii of the sample (the camera is outside it)"
    return checks.scalar("distance", checks.within("distance", distance, 1, np.inf, what, open_low=True))


def is_infinite(distance: ArrayLike) -> bool:
    return is_concrete(distance) and bool(np.isinf(np.asarray(distance, dtype=np.float64)))
