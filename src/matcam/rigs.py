"""Rigs: a camera, a sample in front of it and a lamp; and the rigs of published measurements."""

from __future__ import annotations

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from matcam import checks
from matcam._jax import jax, jnp
from matcam.camera.camera import Camera
from matcam.camera.gaussian import GaussianOptics
from matcam.camera.pixel import BoxPixel
from matcam.camera.uncertainty import Provenance
from matcam.errors import ArgumentError
from matcam.sample.shape import Sample
from matcam.sample.sphere import Sphere


class Rig(eqx.Module):
    """A set-up that measures a material by photographing it.

    camera: `Camera`. sample: `Sphere`, `Cylinder` or `Flat`. lamp_radius: angular radius of the lamp's disc seen from
    the sample, rad; 0 is a point.
    """

    camera: Camera
    sample: Sample
    lamp_radius: jax.Array

    def __init__(self, camera: Camera, sample: Sample, lamp_radius: ArrayLike = 0.0):
        if not isinstance(camera, Camera):
            raise ArgumentError(f"camera must be a Camera (optics and pixel), got {type(camera).__name__}")
        if not isinstance(sample, Sample):
            raise ArgumentError(f"sample must be a Sphere, Cylinder or Flat, got {type(sample).__name__}")
        self.camera = camera
        self.sample = sample
        self.lamp_radius = checks.scalar("lamp_radius", checks.within("lamp_radius", lamp_radius, 0, np.pi / 8, "rad"))

    def lamp_spread(self, theta_d: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Standard deviation of the half vector's spread over the lamp's disc, rad, as the normal's angle in the plane
        of camera and lamp and across it, at difference angle theta_d (MODEL 3)."""
        quarter = self.lamp_radius / 4
        return quarter + jnp.zeros_like(theta_d), quarter / jnp.cos(theta_d)

    def __repr__(self) -> str:
        return f"Rig({self.camera!r}, {self.sample!r}, lamp_radius={self.lamp_radius!s})"


def merl() -> Rig:
    """The rig of the MERL database as Holzschuch & Pacanowski (2017), section 4, reconstruct it.

    QImaging Retiga 1300, sphere over half the picture's height: limb of radius 256 px; pixels of 100 % fill; optics
    blur sigma_mtf = half a pixel. That last number is the paper's guess; its uncertainty is unknown, so none is stated.
    """
    source = "Holzschuch & Pacanowski 2017, section 4; sigma_mtf = sigma_p is their guess"
    camera = Camera(GaussianOptics(0.5), BoxPixel(0.5), provenance=Provenance(source=source))
    return Rig(camera, Sphere(256.0))
