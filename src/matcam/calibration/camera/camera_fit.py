"""Lenses as measured curves: the edges' own mean, freed of the pixel; and a separated core with its diffraction.

One colour's measurements as one camera: lens and pixel fitted together, judged, refused where they cannot be known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from matcam.calibration.camera import evidence as agreement
from matcam.calibration.camera import joint_fit
from matcam.calibration.camera.evidence import EdgeTable, Evidence, LensAt
from matcam.calibration.edge.free_fit import FREQUENCIES
from matcam.calibration.edge.profiles import KURTOSIS, LensModel, Separable, lens_model
from matcam.camera.camera import Camera
from matcam.camera.optics.gaussian import GaussianOptics
from matcam.camera.optics.measured import MeasuredOptics
from matcam.camera.optics.pupil import DiffractionOptics
from matcam.camera.pixel import BoxPixel
from matcam.camera.uncertainty import Provenance, Uncertainty
from matcam.core.errors import ArgumentError, FitError
from matcam.core.jax import jax, jnp

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


_LARGEST_STD = 0.1  # relative, of lens and pixel where both are fitted
_MISSED, _SIGNIFICANT = 0.005, 4.0  # of the MTF, standard deviations: the model does not explain the edges
_SIGMA = 0.5  # px, where a fit starts that no edge has told of
_WAVELENGTHS = (1e-9, 1e-3)


@dataclass(frozen=True)
class Request:
    """What kind of camera is wanted; fields as in `calibrate`."""

    model: str
    half_width: float | None
    wavelength: float | Mapping[str, float] | None
    pixel_pitch: float | None

    def lens_at(self, channel: str, f_numbers: list[float | None]) -> LensAt:
        """The family to be fitted, by a picture's f-number. ArgumentError where something is missing for it."""
        wavelength = self.wavelength.get(channel) if isinstance(self.wavelength, Mapping) else self.wavelength
        both = wavelength is not None and self.pixel_pitch is not None
        if self.model in ("diffraction", "defocus") and not both:
            raise ArgumentError(f"wavelength and pixel_pitch must be given for the {self.model} model, m")
        if wavelength is not None and not _WAVELENGTHS[0] <= wavelength <= _WAVELENGTHS[1]:
            raise ArgumentError(f"wavelength must lie in [1e-09, 0.001] m (550 nm is 550e-9), got {wavelength:g}")
        if self.pixel_pitch is not None and not 1e-8 <= self.pixel_pitch <= 1e-2:
            raise ArgumentError(f"pixel_pitch must lie in [1e-08, 0.01] m (5 um is 5e-6), got {self.pixel_pitch:g}")
        if self.half_width is not None:
            name = "gaussian" if self.model == "measured" else self.model
            lens = lens_model(name, wavelength, self.pixel_pitch)
            return lambda _: lens
        if both and any(number is None for number in f_numbers):
            raise ArgumentError("diffraction is to be taken into account, but not every picture's f-number is known")
        if not both:
            return lambda _: Separable(jnp.zeros(()), jnp.asarray(550e-9), jnp.asarray(5e-6))
        return lambda n: Separable(jnp.asarray(n, float), jnp.asarray(wavelength), jnp.asarray(self.pixel_pitch))


@dataclass(frozen=True, eq=False)
class CameraFit:
    """The camera of one colour, and how well it is known."""

    camera: Camera
    names: tuple[str, ...]
    """Of the fitted numbers: as in the profile, or "gaussian.sigma_px", the best Gaussian's beside a measured curve."""
    values: np.ndarray
    """(k,)"""
    covariance: np.ndarray
    """(k, k); wider than the noise's where measurements scatter more than that."""
    chi2: float
    """Of all samples, under the noise."""
    degrees: int
    spread: float
    """Relative standard deviation of the blur among the edges, beyond their noise."""
    misfit: float
    misfit_std: float
    """Largest difference below Nyquist between the edges' mean MTF, free of a model, and this camera's; NaN without edges."""
    edges: EdgeTable | None
    frequency: np.ndarray
    mtf: np.ndarray
    mtf_std: np.ndarray
    """(81,) the edges' mean, and its standard deviation; NaN without edges."""
    model_mtf: np.ndarray
    """(81,) this camera's, averaged in the same way; without edges, along the rows."""
    measurements: dict[str, int]
    """How many of each: picture and kind."""

    @property
    def std(self) -> np.ndarray:
        """(k,) standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def consistent(self) -> bool:
        """False: the edges' mean MTF is not this camera's, by more than 0.005 and 4 standard deviations."""
        return not (self.misfit > _MISSED and self.misfit > _SIGNIFICANT * self.misfit_std)

    @property
    def summary(self) -> str:
        """One line."""
        pairs = zip(self.names, self.values, self.std, strict=True)
        numbers = ", ".join(f"{name} {value:.4g} ± {std:.2g}" for name, value, std in pairs)
        count = 0 if self.edges is None else self.edges.x.size
        fit = f"chi2 {self.chi2:.0f} of {self.degrees}" + (
            "" if self.consistent else ", model does not explain the edges"
        )
        return f"{numbers}; {count} edges, {sum(self.measurements.values()) - count} other measurements; {fit}"

    def with_provenance(self, **texts: str) -> CameraFit:
        """The same with a camera that says where it comes from."""
        c = self.camera
        camera = Camera(c.optics, c.pixel, c.sensor, uncertainty=c.uncertainty, provenance=Provenance(**texts))
        return replace(self, camera=camera)


def camera_of(evidence: Evidence, channel: str, request: Request) -> CameraFit:
    """Fit one camera to everything. FitError where measurements contradict each other, or do not determine what is asked."""
    lens_at = request.lens_at(channel, evidence.f_numbers())
    edges, values, table = evidence.edges(lens_at), evidence.values(lens_at), evidence.table()
    f_number = evidence.f_numbers()[0]
    lens = lens_at(f_number)
    log_sigma = np.log(_SIGMA if table is None else np.median(table.sigma))
    start = np.asarray(lens.start(jnp.asarray(log_sigma)))
    separable = isinstance(lens, Separable)
    prior = np.array([0.0, 0.0, KURTOSIS**-2]) if separable else np.zeros(start.size)
    fitted = joint_fit.fit(edges, values, start, lens.longest, request.half_width or 0.5, prior)
    groups = evidence.groups()
    if problem := agreement.contradiction(fitted, groups):
        raise FitError(f"contradictory measurements, channel {channel}: {problem}")
    covariance = agreement.covariance(fitted, prior)
    parameters = _within_the_pitch(fitted.parameters, covariance) if separable else fitted.parameters
    numbers, errors = joint_fit.in_units(lens, parameters, covariance)
    if separable:
        _refuse_unseparated(numbers, errors, table)
    half = float(numbers[1]) if separable else float(request.half_width or 0.5)
    mean, std, expected = _mean_curve(table, edges, lens, parameters, half)
    camera, names = _camera(request, lens, parameters, covariance, half, table, (mean, std))
    if request.model == "measured":
        expected = mean_of(camera, table)
    below = (FREQUENCIES > 0) & (FREQUENCIES <= 0.5)
    worst = int(np.argmax(np.where(below, np.abs(mean - expected), -1)))
    count = len(names)
    return CameraFit(
        camera=camera,
        names=names,
        values=numbers[:count],
        covariance=errors[:count, :count],
        chi2=float(fitted.shares.chi2.sum()),
        degrees=int(fitted.shares.degrees.sum()) - start.size,
        spread=agreement.spread(table),
        misfit=float(abs(mean - expected)[worst]),
        misfit_std=float(std[worst]),
        edges=table,
        frequency=FREQUENCIES,
        mtf=mean,
        mtf_std=std,
        model_mtf=expected,
        measurements={name: groups.count(name) for name in dict.fromkeys(groups)},
    )


def _within_the_pitch(parameters: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """The best camera whose pixel is no wider than the pitch: where the best one's is, everything else follows it back."""
    over = parameters[1] - 0.5
    return parameters - covariance[:, 1] / covariance[1, 1] * over if over > 0 else parameters


def _refuse_unseparated(numbers: np.ndarray, covariance: np.ndarray, table: EdgeTable | None) -> None:
    relative = np.sqrt(np.diag(covariance)) / np.abs(numbers)
    names = ("the lens's sigma", "the pixel's half width")
    worst = int(np.argmax(relative[:2]))
    if relative[worst] > _LARGEST_STD:
        count = 0 if table is None else table.x.size
        raise FitError(
            f"lens and pixel cannot be told apart: {count} edges know {names[worst]} to {relative[worst]:.0%} "
            f"({numbers[worst]:.2f} px; at most {_LARGEST_STD:.0%} is accepted): give the fill (half_width, --half-width), "
            "or more edges of a sharper lens at several known apertures"
        )


def _mean_curve(
    table: EdgeTable | None, edges: Any, lens: LensModel, parameters: np.ndarray, half: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The edges' mean MTF, its standard deviation by their scatter, and the same mean of the camera's."""
    theta = jnp.asarray(parameters)
    if table is None:
        nothing = np.full(FREQUENCIES.size, np.nan)
        return nothing, nothing, np.asarray(lens.mtf(theta, jnp.asarray(FREQUENCIES), jnp.zeros(()), jnp.asarray(half)))
    models = np.asarray(_curves(lens, edges, theta, jnp.asarray(half)))
    weight = weights(table)
    mean, expected = (weight * table.mtf).sum(0), (weight * np.abs(models)).sum(0)
    count = table.x.size
    # about the model, because edges see different pixels under different angles
    apart = table.mtf - np.abs(models) - (mean - expected)
    scatter = np.sqrt((weight**2 * apart**2).sum(0) * count / max(count - 1, 1))
    stated = np.sqrt((weight**2 * table.mtf_std**2).sum(0))
    return mean, np.maximum(scatter, stated) if count > 1 else stated, expected


@jax.jit
def _curves(lens: LensModel, edges: Any, theta: jax.Array, half: jax.Array) -> jax.Array:
    """(edges, frequencies) the camera's MTF, signed, at each edge."""
    return jax.lax.map(lambda e: e[0].mtf(theta, FREQUENCIES, e[1], half), (edges.lens, jnp.asarray(edges.angle)))


def _camera(
    request: Request, lens: LensModel, parameters: np.ndarray, covariance: np.ndarray, half: float,
    table: EdgeTable | None, curve: tuple[np.ndarray, np.ndarray],
) -> tuple[Camera, tuple[str, ...]]:  # fmt: skip
    """The camera with its uncertainty, and the names of the numbers that were fitted."""
    if request.model == "measured":
        if table is None:
            raise FitError("a measured curve needs edges; there are none")
        sigma = float(lens.numbers(jnp.asarray(parameters))[0])
        return measured_camera(sigma, half, table, *curve), ("gaussian.sigma_px",)
    if isinstance(lens, Separable):
        return separated_camera(lens, parameters, covariance), lens.names[:2]
    _, errors = joint_fit.in_units(lens, parameters, covariance)
    uncertainty = Uncertainty(lens.names, (errors + errors.T) / 2)
    return Camera(lens.optics(jnp.asarray(parameters)), BoxPixel(half), uncertainty=uncertainty), lens.names
