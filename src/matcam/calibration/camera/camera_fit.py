"""Fit of the camera of one colour: lens and pixel, fitted to all measurements of the colour.

A lens model is fitted to all measurements jointly. The result is compared with the model-free mean MTF of the edges. This
mean MTF can also be used as the lens itself (model "measured"). The product of a Gaussian core and diffraction is not one of
the lens models. If the pixel is fitted and diffraction is included, the lens is therefore returned as a tabulated MTF.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from matcam.calibration.camera.consensus import disagreement_remarks
from matcam.calibration.camera.disagreement import blur_disagreement, widened_remarks, without_disagreeing
from matcam.calibration.camera.evidence import EdgeTable, Evidence, LensAt, MeanCurve
from matcam.calibration.camera.joint_fit import (
    EdgeMeasurements,
    fit_jointly,
)
from matcam.calibration.edge.free_curve import FREQUENCIES
from matcam.calibration.edge.profiles import KURTOSIS, LensModel, Separable, check_light, lens_model
from matcam.camera.camera import Camera
from matcam.camera.optics.measured import MeasuredOptics
from matcam.camera.optics.pupil import DiffractionOptics
from matcam.camera.parameters import Provenance, Uncertainty
from matcam.camera.pixel import BoxPixel
from matcam.core.arrays.module import replaced
from matcam.core.errors import ArgumentError, FitError
from matcam.core.jax import jax, jnp
from matcam.core.programs import kept_program
from matcam.core.remark import Remark
from matcam.core.results.summary import Quantity, Summarised, Summary, correlations, parameters

_LARGEST_STD = 0.1
"""Largest relative standard deviation of lens width and pixel half width if both are fitted (no unit)."""
_END = 1e-6
"""MTF at which the extrapolation of a measured curve ends. It is far below the noise."""


@dataclass(frozen=True, eq=False, repr=False)
class CameraFit(Summarised):
    """Fitted camera of one colour, with its uncertainty.

    Attributes:
        camera: lens and pixel, with their uncertainty.
        names: names of the fitted parameters, as in the profile. For a measured curve, "gaussian.sigma_px" is the lens width of
            the best-fitting Gaussian.
        values: (k,) fitted parameters, in the units of their names.
        covariance: (k, k) covariance of `values`; increased if the measurements scatter more than their noise.
        chi2: chi-square of all measurements for the given noise (no unit).
        degrees: degrees of freedom.
        spread: relative standard deviation of the blur among the edges, beyond their noise (no unit).
        edges: results of every edge; None without edges.
        curve: model-free mean MTF of the edges, and the MTF of this camera.
        measurements: number of measurements by image and kind.
        remarks: remarks on targets that were excluded, and on disagreement that increases the uncertainty. Default: ().

    Example:
        >>> f = np.linspace(0.05, 0.5, 10)
        >>> mtf = np.exp(-2 * (np.pi * 0.6 * f) ** 2) * np.sinc(f)
        >>> star = matcam.targets.MTFSamples("star", (9.0, 9.0), f, np.zeros(10), mtf, 1e-6 * np.eye(10))
        >>> fit = matcam.calibrate([], samples=[star]).channels["grey"]
        >>> fit.names, fit.measurements
        (('optics.sigma_px',), {'star': 1})
    """

    camera: Camera
    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    chi2: float
    degrees: int
    spread: float
    edges: EdgeTable | None
    curve: MeanCurve
    measurements: dict[str, int]
    remarks: tuple[Remark, ...] = ()

    @property
    def std(self) -> np.ndarray:
        """Standard deviations (k,) of `values`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def misfit(self) -> float:
        """Largest difference between the MTFs of camera and edges (no unit).

        The MTF of the edges is their mean MTF. Only frequencies up to 0.5 cycles/px are compared. The value is NaN without
        edges.
        """
        return self.curve.misfit[0]

    @property
    def misfit_std(self) -> float:
        """Standard deviation of `misfit` (no unit)."""
        return self.curve.misfit[1]

    @property
    def consistent(self) -> bool:
        """True if the camera explains the mean MTF of the edges.

        The value is False if `misfit` exceeds both 0.005 and 4 standard deviations. It is True without edges.
        """
        return self.curve.consistent

    @property
    def headline(self) -> str:
        """Summary of the result in one line."""
        pairs = zip(self.names, self.values, self.std, strict=True)
        numbers = ", ".join(f"{name} {value:.4g} ± {std:.2g}" for name, value, std in pairs)
        count = 0 if self.edges is None else self.edges.x.size
        fit = f"chi2 {self.chi2:.0f} of {self.degrees}" + (
            "" if self.consistent else ", model does not explain the edges"
        )
        return f"{numbers}; {count} edges, {sum(self.measurements.values()) - count} other measurements; {fit}"

    def quantities(self) -> list[Quantity]:
        """List the fitted parameters with their standard deviations."""
        return parameters(dict(zip(self.names, self.values, strict=True)), dict(zip(self.names, self.std, strict=True)))

    def _summary(self) -> Summary:
        return Summary(
            f"Camera fitted to {sum(self.measurements.values())} measurements",
            f"The camera {'explains' if self.consistent else 'does not explain'} the mean MTF of the edges.",
            {
                "Parameters": self.quantities(),
                "Correlations": correlations(self.names, self.covariance),
                "Fit statistics": [
                    Quantity("chi2", self.chi2),
                    Quantity("degrees of freedom", self.degrees),
                    Quantity("spread of the blur among edges, relative", self.spread),
                ],
            },
            self.remarks,
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert the fit to a part of the JSON of `matcam calibrate`.

        Returns:
            Parameters by name, their covariance, statistics of the fit, and the mean MTFs of edges and camera.
        """
        return {
            "parameters": dict(zip(self.names, self.values, strict=True)),
            "covariance": self.covariance,
            "chi2": self.chi2,
            "degrees": self.degrees,
            "consistent": self.consistent,
            "misfit": self.misfit,
            "misfit_std": self.misfit_std,
            "spread": self.spread,
            "measurements": self.measurements,
            "frequency_cycles_per_px": self.curve.frequency,
            "mtf": self.curve.mtf,
            "mtf_std": self.curve.mtf_std,
            "camera_mtf": self.curve.camera_mtf,
        }

    def with_provenance(self, provenance: Provenance) -> CameraFit:
        """Copy the fit, and set the provenance of its camera.

        Args:
            provenance: source, date and software, for the profile of the camera.

        Returns:
            The copy, whose camera has the provenance.
        """
        return replace(self, camera=replaced(self.camera, "provenance", provenance))

    def with_wider_errors(self, std: float) -> CameraFit:
        """Copy the fit with a larger standard deviation of its first parameter.

        Args:
            std: standard deviation that is added in quadrature, in the unit of the parameter.

        Returns:
            The copy. The uncertainty of the camera is also increased if the camera and the fit have uncertainties of the same
            parameters.
        """
        covariance = self.covariance.copy()
        covariance[0, 0] += std**2
        camera, uncertainty = self.camera, self.camera.uncertainty
        if uncertainty is not None and tuple(uncertainty.names) == tuple(self.names):
            camera = replaced(camera, "uncertainty", Uncertainty(tuple(self.names), covariance))
        return replace(self, camera=camera, covariance=covariance)


def fit_camera(
    evidence: Evidence,
    channel: str,
    model: str,
    half_width: float | None,
    wavelength: float | None,
    pixel_pitch: float | None,
) -> CameraFit:
    """Fit one camera to all measurements of a colour.

    The other parameters are arguments of `calibrate`. A FitError is raised if measurements contradict each other, or do not
    determine the requested parameters. An ArgumentError is raised if the model requires an argument that is missing.
    """
    f_numbers = evidence.f_numbers
    lens_at = _lens_at(model, half_width, wavelength, pixel_pitch, f_numbers)
    lens, measurements, table = lens_at(f_numbers[0]), evidence.measurements(lens_at), evidence.table()
    separable = isinstance(lens, Separable)
    # Without edges, the fit starts from a lens width of 0.5 px.
    start = np.asarray(lens.start(jnp.asarray(np.log(0.5 if table is None else np.median(table.sigma)))))
    precision = np.array([0.0, 0.0, KURTOSIS**-2]) if separable else np.zeros(start.size)
    half = float(half_width or 0.5)
    fitted, disagreeing = without_disagreeing(
        measurements, lambda some: fit_jointly(some, start, lens.longest, precision, half), channel
    )
    covariance = fitted.observed_covariance()
    parameters = _within_the_pitch(fitted.parameters, covariance) if separable else fitted.parameters
    found = _FittedLens(lens, parameters, covariance, half)
    if separable:
        _refuse_unseparated(found, table)
    curve, slope = _mean_curve(found, measurements.edges, table)
    explained = replace(curve, camera_mtf=curve.mtf) if model == "measured" else curve
    apart = blur_disagreement(measurements.groups, disagreeing, explained, slope)
    found = _FittedLens(lens, parameters, covariance + np.diag([apart**2, *[0.0] * (start.size - 1)]), half)
    names = lens.names
    if model == "measured":
        if table is None:
            raise FitError(
                "the lens model 'measured' needs edges, but there are none: add images of edges, or choose another model"
            )
        camera, names = _measured_camera(found, table, curve, apart * slope), ("gaussian.sigma_px",)
        expected = np.abs(camera.mtf(jnp.asarray(FREQUENCIES), jnp.asarray(table.angle)[:, None]))
        curve = replace(curve, camera_mtf=(table.weights * expected).sum(0))
    elif separable:
        camera, names = _separated_camera(found), lens.names[:2]
    else:
        camera = Camera(
            lens.optics(jnp.asarray(parameters)), BoxPixel(found.half), uncertainty=_uncertainty(names, found.errors)
        )
    count = len(names)
    return CameraFit(
        camera=camera,
        names=names,
        values=found.values[:count],
        covariance=found.errors[:count, :count],
        chi2=float(fitted.shares.chi2.sum()),
        degrees=int(fitted.shares.degrees.sum()) - start.size,
        spread=0.0 if table is None else table.spread,
        edges=table,
        curve=curve,
        measurements={name: n for name, n in Counter(measurements.groups).items() if name not in disagreeing},
        remarks=(*disagreement_remarks(disagreeing, channel), *widened_remarks(apart, channel)),
    )


def _lens_at(
    model: str,
    half_width: float | None,
    wavelength: float | None,
    pixel_pitch: float | None,
    f_numbers: list[float | None],
) -> LensAt:
    """Create the lens model to be fitted, as a function of the f-number."""
    both = wavelength is not None and pixel_pitch is not None
    if model in ("diffraction", "defocus") and not both:
        raise ArgumentError(f"wavelength and pixel_pitch must be given in m for the {model} model")
    check_light(wavelength, pixel_pitch)
    if half_width is not None:
        lens = lens_model("gaussian" if model == "measured" else model, wavelength, pixel_pitch)
        return lambda _: lens
    if not both:
        return lambda _: Separable(jnp.zeros(()), jnp.asarray(550e-9), jnp.asarray(5e-6))
    if None in f_numbers:
        raise ArgumentError(
            "diffraction requires f-numbers, but the f-number of at least one image is not known: give f_numbers"
        )
    return lambda n: Separable(jnp.asarray(n, float), jnp.asarray(wavelength), jnp.asarray(pixel_pitch))


class _FittedLens:
    """Fitted lens with parameters and covariance.

    Attributes:
        lens: the lens model.
        parameters: (k,) parameters in the form of the fit.
        covariance: (k, k) covariance of `parameters`.
        values: (k,) parameters in the units of their names.
        errors: (k, k) covariance of `values`.
        half: half width of the pixel, px.
    """

    def __init__(self, lens: LensModel, parameters: np.ndarray, covariance: np.ndarray, half: float) -> None:
        self.lens, self.parameters, self.covariance = lens, parameters, covariance
        at = jnp.asarray(parameters)
        by = np.asarray(jax.jacfwd(lens.numbers)(at))
        self.values, self.errors = np.asarray(lens.numbers(at)), by @ covariance @ by.T
        self.half = float(self.values[1]) if isinstance(lens, Separable) else half


def _within_the_pitch(parameters: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Compute the most probable parameters for a pixel that is not wider than the pitch."""
    over = parameters[1] - 0.5
    return parameters - covariance[:, 1] / covariance[1, 1] * over if over > 0 else parameters


def _refuse_unseparated(found: _FittedLens, table: EdgeTable | None) -> None:
    relative = np.sqrt(np.diag(found.errors)) / np.abs(found.values)
    names = ("the lens width", "the half width of the pixel")
    worst = int(np.argmax(relative[:2]))
    if relative[worst] > _LARGEST_STD:
        count = 0 if table is None else table.x.size
        raise FitError(
            f"lens and pixel cannot be separated: {count} edges determine {names[worst]} to {relative[worst]:.0%} "
            f"({found.values[worst]:.2f} px; at most {_LARGEST_STD:.0%} is accepted): give half_width, "
            "or more edges of a sharper lens at several known apertures"
        )


def _mean_curve(
    found: _FittedLens, edges: EdgeMeasurements | None, table: EdgeTable | None
) -> tuple[MeanCurve, np.ndarray]:
    """Compute the mean MTFs of edges and camera.

    The second result is the derivative of the MTF of the camera with respect to ln(blur). The standard deviation of the mean
    MTF is derived from the scatter of the edges, and is at least that due to the noise of the edges.
    """
    theta, half = jnp.asarray(found.parameters), jnp.asarray(found.half)
    if table is None:
        along = partial(found.lens.mtf, f=jnp.asarray(FREQUENCIES), angle=jnp.zeros(()), half_width=half)
        nothing = np.full(FREQUENCIES.size, np.nan)
        by = np.asarray(jax.jacfwd(along)(theta))[:, 0]
        return MeanCurve(FREQUENCIES, nothing, nothing, np.asarray(along(theta))), by
    values, by = map(np.asarray, _edge_curves(edges, theta, half))
    models, weight = np.abs(values), table.weights
    mean, expected = (weight * table.mtf).sum(0), (weight * models).sum(0)
    count = table.x.size
    # The scatter is computed about the model, because the MTF of the pixel depends on the angle of an edge.
    apart = table.mtf - models - (mean - expected)
    scatter = np.sqrt((weight**2 * apart**2).sum(0) * count / max(count - 1, 1))
    stated = np.sqrt((weight**2 * table.mtf_std**2).sum(0))
    curve = MeanCurve(FREQUENCIES, mean, np.maximum(scatter, stated) if count > 1 else stated, expected)
    return curve, (weight * np.sign(values) * by).sum(0)


@kept_program(returns=tuple[jax.Array, jax.Array])
def _edge_curves(edges: Any, theta: jax.Array, half: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Evaluate the signed MTF of the camera, and its derivative with respect to ln(blur).

    Both have the shape (edges, frequencies).
    """

    def one(edge: Any) -> tuple[jax.Array, jax.Array]:
        lens, angle = edge
        change = jnp.zeros_like(theta).at[0].set(1.0)
        return jax.jvp(lambda at: lens.mtf(at, FREQUENCIES, angle, half), (theta,), (change,))

    return jax.lax.map(one, (edges.lens, jnp.asarray(edges.angle)))


def _measured_camera(found: _FittedLens, table: EdgeTable, curve: MeanCurve, shift: np.ndarray) -> Camera:
    """Create a camera whose lens has the mean MTF of the edges, divided by that of the pixel.

    Beyond the frequency at which the standard deviation is too large, the curve is extrapolated by the fitted Gaussian.
    `shift` is the standard deviation of the MTF due to the disagreement of the measurements. This error is fully correlated
    over the frequencies.
    """
    mean, std = curve.mtf, curve.mtf_std
    c, s = np.abs(np.cos(table.angle))[:, None], np.abs(np.sin(table.angle))[:, None]
    pixel = np.sinc(2 * found.half * FREQUENCIES * c) * np.sinc(2 * found.half * FREQUENCIES * s)
    box = (table.weights * pixel).sum(0)
    # Division by an MTF of the pixel below 0.3 would amplify the noise. The standard deviation of the quotient is below 0.03.
    known = (box > 0.3) & (std < 0.03 * box) & (mean > 3 * std)
    last = int(np.argmin(known)) - 1 if not known.all() else FREQUENCIES.size - 1
    if last < 8:
        raise FitError(
            f"the measured curve ends at {FREQUENCIES[max(last, 0)]:.2f} cycles/px, because the noise is too large: add edges"
        )
    f, mtf, error = FREQUENCIES[: last + 1], (mean / box)[: last + 1], (std / box)[: last + 1]
    mtf = np.minimum(mtf / mtf[0], 1.0)
    rate = 2 * (np.pi * found.values[0]) ** 2
    end = np.sqrt(f[-1] ** 2 + max(np.log(mtf[-1] / _END), 0.1) / rate)
    beyond = np.linspace(f[-1], end, 25)[1:]
    tail = mtf[-1] * np.exp(-rate * (beyond**2 - f[-1] ** 2))
    tail[-1] = 0.0
    optics = MeasuredOptics(np.concatenate([f, beyond]), np.concatenate([mtf, tail]))
    # The errors at neighbouring frequencies are correlated: the covariance follows from the scatter of the edges, and
    # its rank does not exceed their number.
    apart = (table.mtf - table.mtf.mean(0))[:, 1 : last + 1] / box[1 : last + 1]
    scatter = apart.T @ apart / max(table.x.size - 1, 1)
    scale = error[1:] / np.sqrt(np.maximum(np.diag(scatter), 1e-30))
    covariance = scatter * np.outer(scale, scale) if table.x.size > 2 else np.diag(error[1:] ** 2)
    wide = (shift / box)[1 : last + 1]
    covariance += np.outer(wide, wide)
    names = tuple(f"optics.mtf[{i}]" for i in range(1, last + 1))
    return Camera(optics, BoxPixel(found.half), uncertainty=_uncertainty(names, covariance))


def _separated_camera(found: _FittedLens) -> Camera:
    """Create a camera from the fitted core and pixel.

    If the lens has an f-number, core and diffraction are combined in one tabulated MTF.
    """
    lens, theta = found.lens, jnp.asarray(found.parameters)
    assert isinstance(lens, Separable)
    core = lens.optics(theta)
    if not float(lens.f_number) > 0:
        return Camera(core, BoxPixel(found.half), uncertainty=_uncertainty(lens.names[:2], found.errors[:2, :2]))
    diffraction = DiffractionOptics(lens.f_number, lens.wavelength, lens.pixel_pitch)
    f = np.linspace(0, min(diffraction.band(), np.sqrt(-np.log(_END) / 2) / (np.pi * found.values[0])), 65)

    def curve(theta: jax.Array) -> jax.Array:
        values = lens.mtf(theta, jnp.asarray(f[:-1]), jnp.zeros(()), jnp.zeros(())) / BoxPixel(theta[1]).mtf(f[:-1])
        return jnp.concatenate([values, theta[1:2]])

    by = np.asarray(jax.jacfwd(curve)(theta))[1:]
    names = (*(f"optics.mtf[{i}]" for i in range(1, f.size - 1)), "pixel.half_width_px")
    optics = MeasuredOptics(f, np.append(np.asarray(curve(theta))[:-1], 0.0))
    return Camera(optics, BoxPixel(found.half), uncertainty=_uncertainty(names, by @ found.covariance @ by.T))


def _uncertainty(names: tuple[str, ...], covariance: np.ndarray) -> Uncertainty:
    return Uncertainty(names, (covariance + covariance.T) / 2)
