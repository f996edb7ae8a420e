"""Sphere in front of a camera as a mirror: normals of pixels, and mirror images of lamps (Alhazen's problem).

Axes: x right, y up, z parallel to the optical axis and towards the camera. The origin is the centre of the sphere, and
lengths are in radii of the sphere. Rows increase downwards. The formulas are exact for a near camera, a near lamp and a
sphere beside the optical axis.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from matcam.sample.sight import highlight_between

_TURNS = 60  # largest number of iterations
_SETTLED = 1e-15  # change of an angle at convergence, rad


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


class MirrorBall(NamedTuple):
    """Sphere in a frame.

    Attributes:
        row: row of the image of the sphere's centre, px.
        column: column of the image of the sphere's centre, px.
        radius: radius that the limb would have if the sphere's centre were on the optical axis, px.
        distance: distance of the camera from the sphere's centre, radii; infinite for an orthographic camera. Default:
            infinite.
        axis: (row, column) of the intersection of the optical axis with the frame, px. Default: the image of the sphere's
            centre.

    Example:
        A lamp 60 degrees to the right, far away like the camera, is seen where the normal is at 30 degrees:

        >>> ball = MirrorBall(row=100.0, column=100.0, radius=80.0)
        >>> row, column = ball.mirror_position(np.array([np.sin(np.pi / 3), 0.0, np.cos(np.pi / 3)]))
        >>> round(float(row), 6), round(float(column), 6)
        (100.0, 140.0)
    """

    row: float
    column: float
    radius: float
    distance: float = np.inf
    axis: tuple[float, float] | None = None

    @property
    def _focal(self) -> float:
        return self.radius * float(np.sqrt(self.distance**2 - 1))

    @property
    def towards_camera(self) -> np.ndarray:
        """Unit vector from the sphere's centre to the camera (3,)."""
        if self.axis is None or np.isinf(self.distance):
            return np.array([0.0, 0.0, 1.0])
        return unit(np.array([self.axis[1] - self.column, self.row - self.axis[0], self._focal]))

    def normals(self, rows: ArrayLike, columns: ArrayLike) -> np.ndarray:
        """Compute the normal at each position in the frame.

        Args:
            rows: rows of the positions, px; broadcasts with `columns`.
            columns: columns of the positions, px.

        Returns:
            Unit vectors (..., 3); NaN beside the sphere.
        """
        x, y = np.broadcast_arrays(np.asarray(columns, float) - self.column, self.row - np.asarray(rows, float))
        with np.errstate(invalid="ignore"):
            if np.isinf(self.distance):
                x, y = x / self.radius, y / self.radius
                return np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1)
            back = -self.towards_camera
            centre = back * (self._focal / -back[2])  # in px, from the pinhole
            ray = unit(centre + np.stack([x, y, np.zeros_like(x)], axis=-1))
            # foot of the perpendicular on the ray, without loss of digits for a distant camera
            off = ray - back
            size = (off**2).sum(-1, keepdims=True)
            foot = self.distance * ((1 - size / 2) * off - size / 2 * back)
            return foot - np.sqrt(1 - (foot**2).sum(-1, keepdims=True)) * ray

    def position(self, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute row and column, px, of the points of the sphere with given normals (..., 3); NaN for invisible points."""
        normals = np.asarray(normals, float)
        camera = self.towards_camera
        seen = normals @ camera > 1 / self.distance
        if np.isinf(self.distance):
            x, y = self.radius * normals[..., 0], self.radius * normals[..., 1]
        else:
            depth = self.distance * camera[2] - normals[..., 2]
            x, y = (
                self._focal * (normals[..., k] - self.distance * camera[k] + camera[k] / camera[2] * depth) / depth
                for k in (0, 1)
            )
        hidden = np.where(seen, 0.0, np.nan)
        return self.row - y + hidden, self.column + x + hidden

    def views(self, normals: np.ndarray) -> np.ndarray:
        """Compute unit vectors to the camera from the points of the sphere with given normals (..., 3)."""
        if np.isinf(self.distance):
            return np.broadcast_to(self.towards_camera, np.shape(normals))
        return unit(self.towards_camera * self.distance - normals)

    def lamp_seen_at(self, normals: np.ndarray, lamp_distance: float | np.ndarray = np.inf) -> np.ndarray:
        """Compute the direction of a lamp from the normal at the mirror image of the lamp.

        Args:
            normals: normals of the mirror points (..., 3).
            lamp_distance: distance of the lamp from the centre, radii. Default: infinite.

        Returns:
            Unit vectors from the sphere's centre to the lamp (..., 3).
        """
        normals = np.asarray(normals, float)
        views = self.views(normals)
        cosine = (views * normals).sum(-1, keepdims=True)
        light = 2 * cosine * normals - views
        nearness = 1 / np.asarray(lamp_distance, float)[..., None]
        # the length of normal + s light is the distance of the lamp
        length = np.sqrt(1 - nearness**2 * (1 - cosine**2)) - nearness * cosine
        return unit(nearness * normals + length * light)

    def mirror_normals(self, lamps: np.ndarray, lamp_distance: float | np.ndarray = np.inf) -> np.ndarray:
        """Compute the normals at which lamps are mirrored into the camera.

        Args:
            lamps: directions from the sphere's centre, unit vectors (..., 3).
            lamp_distance: distance of the lamps from the centre, radii. Default: infinite.

        Returns:
            Unit vectors (..., 3), each in the plane of camera, lamp and centre.
        """
        camera, lamps = self.towards_camera, np.asarray(lamps, float)
        across = lamps - (lamps @ camera)[..., None] * camera
        size = np.linalg.norm(across, axis=-1)
        full = np.arctan2(size, lamps @ camera)
        t = np.asarray(highlight_between(full, 1 / self.distance, 1 / np.asarray(lamp_distance, float)))[..., None]
        aside = across / np.where(size > 0, size, 1.0)[..., None]
        return np.cos(t) * camera + np.sin(t) * aside

    def mirror_position(
        self, lamps: np.ndarray, lamp_distance: float | np.ndarray = np.inf
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute row and column of the mirror images of lamps, px; NaN for invisible images.

        The arguments are the same as those of `mirror_normals`.
        """
        return self.position(self.mirror_normals(lamps, lamp_distance))


def cylinder_line(
    lamp: np.ndarray,
    distance: float = np.inf,
    lamp_distance: float = np.inf,
    height: Callable[[float], float] = lambda depth: 0.0,
    lean: float = 0.0,
) -> float:
    """Compute the image position of the brightest line of an upright cylinder.

    The position is the distance to the right of the axis, divided by the radius of the outline.

    Args:
        lamp: unit vector from the axis to the lamp (3,).
        distance: distance of the camera from the axis, radii. Default: infinite.
        lamp_distance: distance of the lamp from the axis, radii. Default: infinite.
        height: function that converts the depth of a point of the line to its height above the centre, both in radii.
            Default: height 0.
        lean: slope around the cylinder at which the density of the lobe is largest, divided by the given slope along the
            cylinder, no unit. Default: 0, for a symmetric lobe.
    """
    camera, source = 1 / distance, 1 / lamp_distance
    u, end = float(np.arctan2(lamp[0], 1 + lamp[2])), np.arccos(camera) - 1e-3
    for _ in range(_TURNS):
        sin, cos = np.sin(u), np.cos(u)
        point = np.array([sin, height(cos), cos])
        half = unit(lamp - source * point) + unit(np.array([0.0, 0.0, 1.0]) - camera * point)
        toward, aside = half[0] * sin + half[2] * cos, half[0] * cos - half[2] * sin
        turn = np.arctan2(aside, toward) - np.arctan(lean * half[1] / max(toward, 1e-6))
        last, u = u, float(np.clip(u + turn, -end, end))
        if abs(u - last) < _SETTLED:
            break
    return float(np.sqrt(1 - camera**2) * np.sin(u) / (1 - camera * np.cos(u)))
