"""Geometry of a sphere or cylinder, camera and lamp: size of the image and distances (docs/model.md 10)."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from matcam.core.arrays import xp
from matcam.core.errors import ArgumentError
from matcam.core.grid import azimuth_of, check_recorded, sample_of
from matcam.forward.sampler.windows import SphereView
from matcam.lamp.lamps import closeness
from matcam.rigs import Rig
from matcam.sample.curved import Cylinder, Sphere
from matcam.sample.shape import Position

BOTH_DIRECTIONS = np.array([0.0, np.pi])
"""Angles that are added to phi_d, rad, for the two positions of a cell on opposite sides of the highlight of its image."""


class SampleView(NamedTuple):
    """Geometry of a curved sample, a camera and a lamp, as Python numbers, so that views can be compared.

    Attributes:
        radius: radius of the limb in the image, px.
        camera: inverse of the camera's distance, 1/radii; 0: distant.
        lamp: inverse of the lamp's distance, 1/radii; 0: distant.
        azimuth: azimuth of the plane of camera and lamp relative to the rows of pixels, rad; in [0, pi/2) for an
            isotropic lens, which is invariant under a quarter turn, otherwise in [0, 2 pi).
        line: True if the sample is a cylinder, whose normals lie in one plane. Each cell then has its own lamp position
            (`forward/cylinder_cells.py`). The image position of a cell is computed on a sphere: the distance from the optical
            axis is the distance from the axis of the cylinder.
    """

    radius: float
    camera: float = 0.0
    lamp: float = 0.0
    azimuth: float = 0.0
    line: bool = False

    @property
    def distant(self) -> bool:
        return self.on_sphere.distant

    @property
    def one_picture(self) -> bool:
        """True if one image shows all cells of one theta_d."""
        return self.distant and not self.line

    @property
    def sphere(self) -> Sphere:
        return Sphere(self.radius, 1 / self.camera if self.camera else np.inf)

    @property
    def cylinder(self) -> Cylinder:
        return Cylinder(self.radius, 1 / self.camera if self.camera else np.inf)

    def position(self, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> Position:
        """Compute image position, px, and lamp angle, rad, from half and difference angles, rad."""
        from matcam.sample.positions import positions_of

        nearness = np.array(self.lamp) if self.lamp else None
        return Position(*positions_of(self.sphere, theta_h, theta_d, phi_d, nearness))  # type: ignore[arg-type]

    def lamp_angles(self, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> np.ndarray:
        """Compute the lamp angles for the two positions of each cell, rad.

        The two positions are on a trailing axis.
        """
        return self.position(theta_h[..., None], theta_d[..., None], phi_d[..., None] + BOTH_DIRECTIONS).lamp_angle  # type: ignore[return-value]

    def irradiance(self, cos_i: np.ndarray) -> np.ndarray:
        """Compute the irradiance of a surface that faces the lamp, relative to that at the centre of the sphere.

        cos_i: cosine of the angle of incidence on the sphere at the position of the surface.
        """
        return 1.0 if self.lamp == 0 else np.asarray(closeness(self.lamp, xp.asarray(cos_i))) ** 2  # type: ignore[return-value]

    def highlight(self, lamp_angle: np.ndarray) -> np.ndarray:
        """Compute the angle between optical axis and normal of the highlight, rad, from lamp angles, rad."""
        return np.asarray(self.sphere.highlight(xp.asarray(lamp_angle), self.lamp))

    def from_highlight(
        self, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the image position (x, y) relative to the highlight, px, from half and difference angles, rad."""
        if self.distant:
            x = self.radius * (
                np.sin(theta_d) * (np.cos(theta_h) - 1) - np.sin(theta_h) * np.cos(phi_d) * np.cos(theta_d)
            )
            return x, self.radius * np.sin(theta_h) * np.sin(phi_d)
        position = self.position(theta_h, theta_d, phi_d)
        return np.asarray(position.x) - self.at_highlight(np.asarray(position.lamp_angle)), np.asarray(position.y)

    def at_highlight(self, lamp_angle: np.ndarray) -> np.ndarray:
        """Compute the x coordinate of the highlight in the image, px."""
        from matcam.forward.integral.scene import highlight_x

        return np.asarray(highlight_x(self.sphere, xp.asarray(lamp_angle), xp.asarray(self.lamp)))

    def highlight_area(self, theta_d: np.ndarray) -> np.ndarray:
        """Compute four times the integral of a highlight over the image, px^2.

        The integrand is the record times cos_i at F = 1 (`sphere_rule.py`). In a distant rig the result is radius^2.
        """
        along, across = (np.asarray(a) for a in self.sphere.px_per_rad(xp.asarray(theta_d), self.lamp))
        return along * across * self.irradiance(np.cos(theta_d)) / np.cos(theta_d)

    @property
    def on_sphere(self) -> SphereView:
        return SphereView(self.radius, self.camera, self.lamp)


_ALIGNED = 1e-9
"""Sine of a multiple of the azimuth below which the axes of the pixels are treated as aligned with the plane of camera and
lamp. It exceeds rounding errors.
"""
FAR_AWAY = SampleView(256.0)
"""View of the sphere of the MERL rig, which is used if no rig is given."""


def sample_view(rig: Rig | None) -> SampleView:
    if rig is None:
        return FAR_AWAY
    sample, lamp, azimuth = rig.sample, rig.lamp.nearness, rig.lamp_azimuth or 0.0
    # square pixels and an isotropic lens are invariant under a quarter turn
    period = np.pi / 2 if all(one.camera.optics.isotropic for one in rig.colours) else 2 * np.pi
    turned = 0.0 if abs(np.sin(np.pi * azimuth / period)) < _ALIGNED else float(np.mod(azimuth, period))
    near = float(sample.nearness), 0.0 if lamp is None else float(lamp)  # type: ignore[attr-defined]
    return SampleView(float(sample.radius), *near, turned, isinstance(sample, Cylinder))  # type: ignore[attr-defined]


def rig_behind(table: xr.DataArray, rig: Rig) -> Rig:
    """Add the lamp azimuth of a table to a rig.

    An azimuth of the rig is not changed. An ArgumentError is raised if rig and table specify different azimuths or samples, or
    if the table is already corrected.
    """
    check_recorded(table)
    kind = sample_of(table)
    if kind not in (None, rig.sample.kind):
        if kind == "flat":
            raise ArgumentError(
                "the table is that of a flat sample (attrs['sample'] = 'flat'), which the camera does not blur: give a table "
                "of a sphere or a cylinder"
            )
        raise ArgumentError(f"sample must be that of the table (attrs['sample'] = '{kind}'), got a {rig.sample.kind}")
    stated, own = azimuth_of(table), rig.lamp_azimuth
    if own is None:
        return replace(rig, lamp_azimuth=stated) if stated else rig
    if stated is not None and abs(np.sin((stated - own) / 2)) > 1e-6:  # more than rounding errors
        raise ArgumentError(
            f"lamp_azimuth must be that of the table, attrs['lamp_azimuth'] = {stated:g} rad, or None, got {own:g} rad"
        )
    return rig
