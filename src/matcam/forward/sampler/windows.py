"""Windows: squares on the sensor about pixels, which contain the support of the kernel.

On a sphere, each side of a window, the limb and the terminator bound a half-space a . n <= b of normals n. This is true for
any distance of camera and lamp and any rotation of the pixel (docs/model.md 3 and 10).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from matcam.sample.sight import depth_of

GRAZING = 1e-3
"""Smallest cosine of a viewing angle by which foreshortening is estimated. It avoids a division by 0."""
_PER_SIDE = 12
"""Number of points on each side of a window at which angles are compared."""
_AROUND = np.linspace(-1, 1, 9)
_CLOSER = tuple(1 / _PER_SIDE / 4**n for n in range(3))
"""Half lengths, in sides, of the successively smaller parts of a border in which the nearest point is searched for."""
_FORESHORTENED = 2 / _PER_SIDE
"""Cosine of the viewing angle below which neighbouring points of a border are far apart on the sphere, compared to the
distance between border and centre of the window. A highlight just beside a window may then be much closer than any of these
points.
"""


class SphereView(NamedTuple):
    """Radius of a sphere, and inverse distances of camera and lamp, as floats.

    Attributes:
        radius: radius of the limb in the image, px.
        camera: inverse of the camera's distance, 1/radii; 0: distant.
        lamp: inverse of the lamp's distance, 1/radii; 0: distant.
    """

    radius: float
    camera: float
    lamp: float

    @property
    def distant(self) -> bool:
        return self.camera == 0 and self.lamp == 0

    @property
    def stretch(self) -> float:
        """Scale of the image at the depth of the centre, px per radius."""
        return self.radius * (1 - self.camera**2) ** 0.5

    def normals(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute the normals at positions in the image, px; positions beyond the limb are moved to the limb."""
        off, q = np.sqrt(x**2 + y**2), self.camera  # np.hypot takes four times as long
        scale = 1 / (np.maximum(off / (self.radius * (1 - 1e-12)), 1.0) * self.stretch)
        x, y = x * scale, y * scale
        n_z, _ = depth_of(off * scale, q)
        depth = 1 - q * n_z
        return x * depth, y * depth, n_z


class Windows(NamedTuple):
    """Squares about pixels, and the lamp of each pixel, arrays of shape (windows,). x and y are the axes of the sensor.

    Attributes:
        x: position of the centre of the pixel to the right of the optical axis, px.
        y: position of the centre of the pixel above the optical axis, px.
        lamp: angle between lamp and optical axis, rad.
        peak: angle between the normal of the highlight and the optical axis, rad; 0 for a cylinder.
        cosine: cosine of the azimuth of the lamp.
        sine: sine of the azimuth of the lamp.
        half: half of the sides along x and y, px, (2, windows).
    """

    x: np.ndarray
    y: np.ndarray
    lamp: np.ndarray
    peak: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    half: np.ndarray

    def at(self, index: np.ndarray | slice) -> Windows:
        return Windows(*(a[..., index] for a in self))

    def to_lamp(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Convert positions on the sensor, (windows, ...), to components along and across the direction to the lamp."""
        cosine, sine = (a.reshape(-1, *[1] * (np.ndim(x) - 1)) for a in (self.cosine, self.sine))
        return x * cosine + y * sine, y * cosine - x * sine

    def border(self, view: SphereView, at: np.ndarray | None = None) -> np.ndarray:
        """Compute the normals along the border of each window, (3, windows, points).

        Positions beyond the limb are moved to the limb. at: positions along the border in sides, from 0 at a corner to 4,
            (windows, points). Default: None, equally spaced.
        """
        at = np.arange(4 * _PER_SIDE)[None] / _PER_SIDE if at is None else np.mod(at, 4)
        side, along = at.astype(int), 2 * (at % 1) - 1
        on = [side == number for number in range(4)]
        offsets = np.select(on, [along, 1.0, -along, -1.0]), np.select(on, [-1.0, along, 1.0, -along])
        sides = zip((self.x, self.y), self.half, offsets, strict=True)
        x, y = (centre[:, None] + half[:, None] * offset for centre, half, offset in sides)
        return np.stack(view.normals(*self.to_lamp(x, y)))

    def extremes(
        self, view: SphereView, border: np.ndarray, angle_of: Callable[[Windows, np.ndarray], np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the smallest and the largest angle on the border of each window, rad, (windows,) each.

        border: result of `border`. angle_of: function that computes the angles, rad, (windows, points), of normals of some
            windows, (3, windows, points).
        """
        angles = angle_of(self, border)
        low, high = angles.min(axis=-1), angles.max(axis=-1)
        index = np.flatnonzero(border[2].min(axis=-1) < _FORESHORTENED)
        some, each = self.at(index), np.arange(index.size)
        at = angles[index].argmin(axis=-1) / _PER_SIDE
        for length in _CLOSER:
            around = at[:, None] + length * _AROUND
            angles = angle_of(some, some.border(view, around))
            at = around[each, angles.argmin(axis=-1)]
            low[index] = angles.min(axis=-1)
        return low, high

    def contains(self, view: SphereView, normal: np.ndarray) -> np.ndarray:
        """Check whether the image of a normal of each window, (3, windows), lies in the window."""
        scale = view.stretch / (1 - view.camera * normal[2])
        x = scale * (normal[0] * self.cosine - normal[1] * self.sine)
        y = scale * (normal[0] * self.sine + normal[1] * self.cosine)
        return (np.abs(x - self.x) < self.half[0]) & (np.abs(y - self.y) < self.half[1])

    def half_spaces(self, view: SphereView) -> tuple[np.ndarray, np.ndarray]:
        """Compute the half-spaces a . n <= b of limb, terminator and four sides: a, (3, windows, 6), and b, (windows, 6)."""
        zero, one = np.zeros(self.x.size), np.ones(self.x.size)
        normals = [(zero, zero, -one), (-np.sin(self.lamp), zero, -np.cos(self.lamp))]
        offsets = [-view.camera * one, -view.lamp * one]
        axes = (self.x, self.cosine, -self.sine), (self.y, self.sine, self.cosine)
        for (centre, along, across), half in zip(axes, self.half, strict=True):
            for side in (1, -1):
                # the image of a normal lies at stretch (n_x, n_y) / (1 - q n_z)
                end = side * centre + half
                normals.append((side * view.stretch * along, side * view.stretch * across, view.camera * end))
                offsets.append(end)
        return np.stack([np.stack(component, -1) for component in zip(*normals, strict=True)]), np.stack(offsets, -1)
