"""Lenses as measured curves: the edges' own mean, freed of the pixel; and a separated core with its diffraction."""

from __future__ import annotations

import numpy as np

from matcam._jax import jax, jnp
from matcam.calibration.curves import FREQUENCIES
from matcam.calibration.evidence import EdgeTable
from matcam.calibration.separable import Separable
from matcam.camera.camera import Camera
from matcam.camera.diffraction import DiffractionOptics
from matcam.camera.gaussian import GaussianOptics
from matcam.camera.measured import MeasuredOptics
from matcam.camera.pixel import BoxPixel
from matcam.camera.uncertainty import Uncertainty
from matcam.errors import FitError

_PIXEL = 0.3  # least transfer of the pixel by which a curve is divided
_STD = 0.03  # of the lens's MTF, beyond which a curve is not followed
_TAIL, _END = 24, 1e-6  # samples of the Gaussian by which it goes on, and where that is called 0
_SAMPLES = 65


def weights(table: EdgeTable) -> np.ndarray:
    """(n, 81) of the edges in a mean MTF: by their variances, sum 1."""
    weight = 1 / np.maximum(table.mtf_std, 1e-4) ** 2
    return weight / weight.sum(0)


def mean_of(camera: Camera, table: EdgeTable | None) -> np.ndarray:
    """(81,) a camera's MTF, averaged over the edges' directions as their own is; without edges, along the rows."""
    f = jnp.asarray(FREQUENCIES)
    if table is None:
        return np.asarray(camera.mtf(f))
    return (weights(table) * np.abs(camera.mtf(f, jnp.asarray(table.angle)[:, None]))).sum(0)


def measured_camera(sigma: float, half: float, table: EdgeTable, mean: np.ndarray, std: np.ndarray) -> Camera:
    """The edges' mean MTF divided by the pixel's, as far as it is known; beyond, it goes on as the best Gaussian's does.

    sigma: px, of that Gaussian. mean, std: (81,) of the edges.
    """
    c, s = np.abs(np.cos(table.angle))[:, None], np.abs(np.sin(table.angle))[:, None]
    pixel = np.sinc(2 * half * FREQUENCIES * c) * np.sinc(2 * half * FREQUENCIES * s)
    box = (weights(table) * pixel).sum(0)
    known = (box > _PIXEL) & (std < _STD * box) & (mean > 3 * std)
    last = int(np.argmin(known)) - 1 if not known.all() else FREQUENCIES.size - 1
    if last < 8:
        raise FitError(
            f"the measured curve ends at {FREQUENCIES[max(last, 0)]:.2f} cycles/px: too many edges are lost in noise"
        )
    f, mtf, error = FREQUENCIES[: last + 1], (mean / box)[: last + 1], (std / box)[: last + 1]
    mtf = np.minimum(mtf / mtf[0], 1.0)
    rate = 2 * (np.pi * sigma) ** 2
    end = np.sqrt(f[-1] ** 2 + max(np.log(mtf[-1] / _END), 0.1) / rate)
    beyond = np.linspace(f[-1], end, _TAIL + 1)[1:]
    tail = mtf[-1] * np.exp(-rate * (beyond**2 - f[-1] ** 2))
    tail[-1] = 0.0
    optics = MeasuredOptics(np.concatenate([f, beyond]), np.concatenate([mtf, tail]))
    # neighbouring frequencies err together: what the edges' scatter says, not more directions than there are edges
    apart = (table.mtf - table.mtf.mean(0))[:, 1 : last + 1] / box[1 : last + 1]
    scatter = apart.T @ apart / max(table.x.size - 1, 1)
    scale = error[1:] / np.sqrt(np.maximum(np.diag(scatter), 1e-30))
    covariance = scatter * np.outer(scale, scale) if table.x.size > 2 else np.diag(error[1:] ** 2)
    names = [f"optics.mtf[{i}]" for i in range(1, last + 1)]
    return Camera(optics, BoxPixel(half), uncertainty=Uncertainty(names, (covariance + covariance.T) / 2))


def separated_camera(lens: Separable, parameters: np.ndarray, covariance: np.ndarray) -> Camera:
    """Core and pixel, with the diffraction of this lens's f-number where it has one: the curve is then their product."""
    half = float(parameters[1])
    core = lens.optics(jnp.asarray(parameters))
    sigma = float(core.sigma) if isinstance(core, GaussianOptics) else float("nan")
    if not float(lens.f_number) > 0:
        by = np.asarray(jax.jacfwd(lens.numbers)(jnp.asarray(parameters)))[:2]
        errors = by @ covariance @ by.T
        return Camera(core, BoxPixel(half), uncertainty=Uncertainty(lens.names[:2], (errors + errors.T) / 2))
    diffraction = DiffractionOptics(lens.f_number, lens.wavelength, lens.pixel_pitch)
    f = np.linspace(0, min(diffraction.band(), np.sqrt(-np.log(_END) / 2) / (np.pi * sigma)), _SAMPLES)

    def curve(theta: jax.Array) -> jax.Array:
        values = lens.mtf(theta, jnp.asarray(f[:-1]), jnp.zeros(()), jnp.zeros(())) / BoxPixel(theta[1]).mtf(f[:-1])
        return jnp.concatenate([values, theta[1:2]])

    theta = jnp.asarray(parameters)
    by = np.asarray(jax.jacfwd(curve)(theta))[1:]
    errors = by @ covariance @ by.T
    names = [f"optics.mtf[{i}]" for i in range(1, f.size - 1)] + ["pixel.half_width_px"]
    values = np.append(np.asarray(curve(theta))[:-1], 0.0)
    return Camera(MeasuredOptics(f, values), BoxPixel(half), uncertainty=Uncertainty(names, (errors + errors.T) / 2))
