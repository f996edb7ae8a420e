"""Windows: squares on the sensor about pixels, which contain the support of the kernel.

On a sphere, each side of a window, the limb and the terminator bound a half-space of normals, a . n <= b, for any distance
of camera and lamp and any rotation of the pixel (docs/model.md 3 and 10).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_SIDE = np.linspace(-1, 1, 13)
_SQUARE = np.concatenate([np.stack([_SIDE, 0 * _SIDE + end], -1) for end in (-1, 1)])
_BORDER = np.concatenate([_SQUARE, _SQUARE[:, ::-1]])
"""Points on the border of a window, in half sides, (points, 2)."""


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
        """Check whether both camera and lamp are distant."""
        return self.camera == 0 and self.lamp == 0

    @property
    def stretch(self) -> float:
        """Return the scale of the image at the depth of the centre, px per radius."""
        return self.radius * (1 - self.camera**2) ** 0.5

    def normals(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute the normals at positions in the image, px; positions beyond the limb are moved to the limb."""
        beyond = np.maximum(np.hypot(x, y) / (self.radius * (1 - 1e-12)), 1.0)
        x, y, q = x / beyond / self.stretch, y / beyond / self.stretch, self.camera
        square = x**2 + y**2
        n_z = (square * q + np.sqrt(np.maximum(1 + square * (q**2 - 1), 0))) / (1 + square * q**2)
        depth = 1 - q * n_z
        return x * depth, y * depth, n_z


class Windows(NamedTuple):
    """Squares about pixels and the lamps of the pixels, arrays of shape (windows,). The axes x and y are those of the sensor.

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
        """Return the windows at indices."""
        return Windows(*(a[..., index] for a in self))

    def to_lamp(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotate positions on the sensor, (windows, ...), to axes of which the first points towards the lamp."""
        cosine, sine = (a.reshape(-1, *[1] * (np.ndim(x) - 1)) for a in (self.cosine, self.sine))
        return x * cosine + y * sine, y * cosine - x * sine

    def border(self, view: SphereView) -> np.ndarray:
        """Compute normals along the border of each window, moved to the limb from outside, (3, windows, points)."""
        sides = zip((self.x, self.y), self.half, _BORDER.T, strict=True)
        x, y = (centre[:, None] + half[:, None] * offset for centre, half, offset in sides)
        return np.stack(view.normals(*self.to_lamp(x, y)))

    def contains(self, view: SphereView, normal: np.ndarray) -> np.ndarray:
        """Check whether the image of a normal of each window, (3, windows), lies in the window."""
        scale = view.stretch / (1 - view.camera * normal[2])
        x = scale * (normal[0] * self.cosine - normal[1] * self.sine)
        y = scale * (normal[0] * self.sine + normal[1] * self.cosine)
        return (np.abs(x - self.x) < self.half[0]) & (np.abs(y - self.y) < self.half[1])

    def half_spaces(self, view: SphereView) -> tuple[np.ndarray, np.ndarray]:
        """Compute a, (3, windows, 6), and b, (windows, 6), of the half-spaces of limb, terminator and the four sides."""
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
