"""One folder of photographs for the examples: polished chromium under a lamp on an arc, as a noisy camera takes it.

The photographs come from the tests' oracle, which shares no code with matcam: run what needs them in the root of the sources.
To be quick, the sphere is small (64 px), the camera has no colour filters, and there are six lamp positions.
"""

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from tests.oracle.capture import METALS, Sensor, draw
from tests.oracle.sphere_picture import Surface, View, fresnel

import matcam
from matcam.reconstruction import Reconstruction

ALPHA = 0.03  # the true roughness
_N, _K = (values[1] for values in METALS["Cr"])
_SURFACE = Surface("ggx", ALPHA, n=(_N,), k=(_K,), diffuse=(0.0,))
_VIEW = View(radius=64.0, sigma=0.5, half_width=0.5, column=103.6, row=104.3, shape=(208, 208))
_SENSOR = Sensor(cfa=None, sensitivity=(1.0,))
_THETA_D = np.radians(np.linspace(8, 75, 6))


@cache
def photographed() -> Path:
    """Return a folder of 30 photographs, 10 dark frames and an outline frame, with what is stated of them."""
    folder = Path(tempfile.mkdtemp()) / "shots"
    draw(_SURFACE, _VIEW, _THETA_D, azimuth=0.4, sensor=_SENSOR, seed=5).write(folder)
    return folder


@cache
def reconstructed() -> Reconstruction:
    """Return what the photographs say; two examples show it."""
    return matcam.reconstruct(photographed(), ndf="ggx")


def true_reflectance(theta_d: np.ndarray) -> np.ndarray:
    """Return F of the sphere at difference angles, rad."""
    return fresnel(np.cos(theta_d), _N, _K)


def true_brdf(theta_h: np.ndarray, theta_d: float) -> np.ndarray:
    """Return the BRDF of the sphere where light and view make one angle with the normal, 1/sr (Walter et al. 2007, eq. 20)."""
    tan2 = np.tan(theta_h) ** 2
    d = 1 / (np.pi * ALPHA**2 * np.cos(theta_h) ** 4 * (1 + tan2 / ALPHA**2) ** 2)
    cos = np.cos(theta_h) * np.cos(theta_d)
    smith = (np.sqrt(1 + ALPHA**2 * (1 / cos**2 - 1)) - 1) / 2
    return true_reflectance(np.asarray(theta_d)) * d / (1 + 2 * smith) / (4 * cos**2)
