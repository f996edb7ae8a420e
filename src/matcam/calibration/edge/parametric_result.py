"""Results of the parametric estimate of one edge or of a stack, and the values that all edge results share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from matcam.calibration.edge.free_curve import SampledCurve
from matcam.calibration.edge.measurement import LensFit
from matcam.calibration.edge.profiles import LensModel
from matcam.camera.camera import Camera
from matcam.camera.parameters import Provenance, Uncertainty
from matcam.camera.pixel import BoxPixel
from matcam.core.arrays import xp
from matcam.core.io import plain
from matcam.core.results.summary import Quantity, Summarised, Summary, correlations, parameters
from matcam.numerics.normal import IMPROBABLE

if TYPE_CHECKING:
    from matcam.core.jax import AnyArray

Number = TypeVar("Number", float, np.ndarray)
"""Type of a value: a float for one edge, an array (n,) for a stack."""


@dataclass(frozen=True, eq=False)
class EdgeValues(Generic[Number]):
    """Values of one edge or of a stack of edges, as described in `EdgeMTF` and `EdgeStack`."""

    frequency: np.ndarray
    mtf: np.ndarray
    mtf_std: np.ndarray
    mtf50: Number
    mtf50_std: Number
    core_mtf: np.ndarray
    core_mtf_std: np.ndarray
    core_mtf50: Number
    core_mtf50_std: Number
    glare_fraction: Number
    glare_fraction_std: Number
    glare_radius: Number
    angle: Number
    angle_std: Number
    bow: Number
    position: tuple[Number, Number]
    dark: Number
    bright: Number
    light: tuple[Number, Number]
    gain: Number
    read_noise: Number
    excess: Number
    outliers: Number
    roughness: Number
    misfit: Number
    overshoot: Number
    overshoot_std: Number

    @property
    def glare_found(self) -> Any:
        """True if glare was found; a mask (n,) for a stack."""
        return self.glare_fraction != 0


@dataclass(frozen=True, eq=False)
class _LensNumbers(Generic[Number]):
    """Parametric estimate of one edge or of a stack of edges."""

    model: str
    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    mtf: np.ndarray
    mtf_std: np.ndarray
    mtf50: Number
    mtf50_std: Number
    chi2: Number
    degrees: Number
    misfit_probability: Number
    lens: LensModel
    fitted: np.ndarray
    half_width: float

    @property
    def consistent(self) -> Any:
        """True if the model explains the edge (significance level 0.1 %).

        For a stack, the value is a mask (n,).
        """
        return self.misfit_probability > IMPROBABLE


@dataclass(frozen=True, eq=False, repr=False)
class ParametricEdge(Summarised, _LensNumbers[float]):
    """Maximum likelihood fit of a lens model.

    Attributes:
        model: name of the lens model (no unit).
        names: names of the fitted parameters in camera profiles, such as "optics.sigma_px" (no unit).
        values: fitted parameters (k,), in the units of their names.
        covariance: covariance of `values` (k, k).
        mtf: signed MTF of lens and pixel (81,), at `EdgeMTF.frequency` (no unit).
        mtf_std: standard deviation of `mtf` (81,).
        mtf50: lowest frequency at which `mtf` is one half, cycles/px.
        mtf50_std: standard deviation of `mtf50`, cycles/px.
        chi2: chi-square of the fit to means of pixels, for the given or estimated noise (no unit).
        degrees: degrees of freedom (no unit).
        misfit_probability: probability of residuals at least as large as those of the fit if the model is correct (no unit).
        lens: the lens model.
        fitted: fitted parameters (k,), in the parameterisation of `lens`, such as ln sigma.
        half_width: half the side of the sensitive area of a pixel, px.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> image = 100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y)))
        >>> fit = matcam.edge_mtf(image).parametric
        >>> fit.names, np.round(fit.values, 2)
        (('optics.sigma_px',), array([0.79]))
    """

    @property
    def camera(self) -> Camera:
        """Fitted camera, with the covariance of its parameters."""
        return Camera(
            self.lens.optics(xp.asarray(self.fitted)),
            BoxPixel(self.half_width),
            uncertainty=Uncertainty(self.names, self.covariance),
            provenance=Provenance(source=f"slanted edge, {self.model} model"),
        )

    def quantities(self) -> list[Quantity]:
        """List the fitted parameters and MTF50, with their standard deviations."""
        std = np.sqrt(np.diag(self.covariance))
        fitted = parameters(dict(zip(self.names, self.values, strict=True)), dict(zip(self.names, std, strict=True)))
        return [*fitted, Quantity("MTF50", self.mtf50, self.mtf50_std, "cycles/px")]

    def _summary(self) -> Summary:
        return Summary(
            f"{self.model} lens fitted to a slanted edge",
            f"The model {'explains' if self.consistent else 'does not explain'} the edge.",
            {
                "Parameters": self.quantities(),
                "Correlations": correlations(self.names, self.covariance),
                "Fit statistics": [
                    Quantity("chi2", self.chi2),
                    Quantity("degrees of freedom", self.degrees),
                    Quantity("probability of the residuals' structure", self.misfit_probability),
                ],
            },
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert the fit to a JSON object.

        Returns:
            Values by name, with units in the names.
        """
        return plain(
            {
                "model": self.model,
                "mtf50_cycles_per_px": self.mtf50,
                "mtf50_std": self.mtf50_std,
                "parameters": dict(zip(self.names, self.values, strict=True)),
                "covariance": self.covariance,
                "chi2": self.chi2,
                "degrees": self.degrees,
                "misfit_probability": self.misfit_probability,
                "consistent": self.consistent,
            }
        )


@dataclass(frozen=True, eq=False)
class ParametricStack(_LensNumbers[np.ndarray]):
    """Parametric estimates of a stack of edges.

    Attributes:
        model: name of the lens model (no unit).
        names: names of the fitted parameters (no unit).
        values: fitted parameters (n, k), in the units of their names.
        covariance: covariances of `values` (n, k, k).
        mtf: signed MTF of lens and pixel (n, 81), at `EdgeStack.frequency` (no unit).
        mtf_std: standard deviation of `mtf` (n, 81).
        mtf50: lowest frequency at which `mtf` is one half (n,), cycles/px.
        mtf50_std: standard deviation of `mtf50` (n,), cycles/px.
        chi2: chi-square of the fit to means of pixels, for the given or estimated noise (n,) (no unit).
        degrees: degrees of freedom (n,) (no unit).
        misfit_probability: probability of residuals at least as large as those of the fit if the model is correct (n,)
            (no unit).
        lens: the lens model.
        fitted: fitted parameters (n, k), in the parameterisation of `lens`, such as ln sigma.
        half_width: half the side of the sensitive area of a pixel, px.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> image = 100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y)))
        >>> matcam.edge_mtf_stack([image, image]).parametric.values.shape
        (2, 1)
    """


def parametric_stack(
    fit: LensFit, free: tuple[SampledCurve, SampledCurve], bad: np.ndarray, lens: LensModel, half_width: float
) -> ParametricStack:
    """Convert the fits of a stack of edges to results.

    All arrays are NumPy arrays. If the lens model is rejected, the differences of MTF and MTF50 from the model-free
    values are added in quadrature to the standard deviations, and the difference of MTF50 to that of the first
    parameter. `free`: model-free MTF and MTF50. `bad`: mask (n,) of edges whose values become NaN.
    """
    probability = fit.misfit_probability
    wrong = ~(probability > IMPROBABLE)

    def std(own: SampledCurve, other: SampledCurve) -> np.ndarray:
        off = own.value - other.value
        return np.hypot(own.std, np.where(wrong.reshape(-1, *[1] * (off.ndim - 1)), off, 0.0))

    off = np.where(wrong & np.isfinite(free[1].value), np.abs(free[1].value / fit.mtf50.value - 1), 0.0)
    numbers: dict[str, Any] = {
        "values": fit.numbers,
        "covariance": with_scale_error(
            np.asarray(fit.numbers_covariance), np.asarray(fit.numbers), lens.names, half_width, off
        ),
        "mtf": fit.mtf.value,
        "mtf_std": std(fit.mtf, free[0]),
        "mtf50": fit.mtf50.value,
        "mtf50_std": std(fit.mtf50, free[1]),
        "chi2": fit.chi2,
        "misfit_probability": probability,
    }
    return ParametricStack(
        model=lens.name,
        names=lens.names,
        **{name: with_nan(value, bad) for name, value in numbers.items()},
        degrees=np.asarray(fit.degrees),
        lens=lens,
        fitted=np.asarray(fit.profile),
        half_width=half_width,
    )


def with_scale_error(
    covariance: np.ndarray, values: np.ndarray, names: tuple[str, ...], half_width: float, share: np.ndarray
) -> np.ndarray:
    """Add an error of the frequency scale to the variance of the first parameter of a lens.

    The scale applies to the combined blur of lens and pixel.

    Args:
        covariance: covariances of the parameters (n, k, k).
        values: parameters (n, k).
        names: names of the parameters.
        half_width: half the side of the sensitive area of a pixel, px.
        share: relative standard deviations of the scale (n,).
    """
    first, box = values[:, 0], half_width**2 / 3
    wider = covariance.copy()
    wider[:, 0, 0] += (share * (first + box / first if names[0].endswith("sigma_px") else first)) ** 2
    return wider


def with_nan(values: AnyArray | np.float64, bad: np.ndarray) -> np.ndarray:
    if not bad.any():
        return np.asarray(values)
    return np.where(bad.reshape(-1, *[1] * (np.ndim(values) - 1)), np.nan, values)
