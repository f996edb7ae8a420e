"""Texture on a flat sample: the contrast that survives tilt and camera (paper (4))."""

from __future__ import annotations

from jax.typing import ArrayLike

from matcam._jax import jax
from matcam.errors import ArgumentError
from matcam.rigs import Rig
from matcam.sample.flat import Flat


def texture_contrast(rig: Rig, frequency: ArrayLike, theta_o: ArrayLike) -> jax.Array:
    """Recorded / true contrast of a sinusoidal texture that varies along the tilt, signed; arguments broadcast.

    frequency: cycles/px as seen head-on. theta_o: viewing angle, rad, [0, pi/2). A frequency nu arrives at
    nu / cos(theta_o), and keeps the camera's MTF there; negative means that bright and dark have changed places.
    """
    if not isinstance(rig.sample, Flat):
        raise ArgumentError(f"texture_contrast needs a rig with a Flat sample, got {type(rig.sample).__name__}")
    return rig.camera.mtf(rig.sample.frequency_on_sensor(frequency, theta_o))
