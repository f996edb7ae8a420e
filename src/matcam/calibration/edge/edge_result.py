"""What `edge_mtf` returns: both estimates of one edge, or of a stack of them, with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.edge import free_fit as curves
from matcam.calibration.edge.free_basis import GLARE
from matcam.calibration.edge.free_fit import FREQUENCIES
from matcam.calibration.edge.profiles import LensModel
from matcam.calibration.photograph.region import Frame
from matcam.camera.camera import Camera
from matcam.camera.pixel import BoxPixel
from matcam.camera.uncertainty import Provenance, Uncertainty
from matcam.core import checks
from matcam.core.jax import jax

if TYPE_CHECKING:
    import xarray as xr

_LENGTH = 512
_WRONG = 1e-3  # probability below which a model is called wrong


class Curve(NamedTuple):
    """A curve and its standard deviation, of one shape."""

    value: np.ndarray
    std: np.ndarray


class EdgeSamples(NamedTuple):
    """The picture as an edge response: means over cells of pixels at nearly one distance from the edge."""

    distance: np.ndarray
    """px, negative on the dark side."""
    value: np.ndarray
    """0 on the dark side, 1 on the bright one, light made even."""
    std: np.ndarray
    parametric: np.ndarray
    """What the parametric fit expects of the same cells."""


@dataclass(frozen=True, eq=False)
class ParametricEdge:
    """The maximum likelihood fit of a family of lenses behind the exact box of a pixel."""

    model: str
    """Name of the family."""
    names: tuple[str, ...]
    """Of the fitted numbers, as camera profiles name them: "optics.sigma_px"."""
    values: np.ndarray
    """(k,)"""
    covariance: np.ndarray
    """(k, k)"""
    mtf: np.ndarray
    """Total MTF at the `frequency` of the result it belongs to, signed."""
    mtf_std: np.ndarray
    mtf50: Any
    """cycles/px."""
    mtf50_std: Any
    chi2: Any
    """Of the cells, under the noise."""
    degrees: Any
    misfit_probability: Any
    """How often the right model would leave as much structure in its residuals as this one has left."""
    _lens: LensModel
    _fitted: Any
    _half_width: float

    @property
    def consistent(self) -> Any:
        """False: the model is wrong (at 0.1 %)."""
        return self.misfit_probability > _WRONG

    @property
    def camera(self) -> Camera:
        """The camera that was found, with its covariance."""
        return Camera(
            self._lens.optics(self._fitted),
            BoxPixel(self._half_width),
            uncertainty=Uncertainty(self.names, self.covariance),
            provenance=Provenance(source=f"slanted edge, {self.model} model"),
        )


@dataclass(frozen=True, eq=False)
class EdgeMTF:
    """The MTF of lens and pixel along an edge's normal, twice: free of a model, and as a lens model (`parametric`).

    Standard deviations are those that repeated pictures with this noise would show. Of a stack of edges every number has
    a leading axis; `result[i]` is one of them.
    """

    frequency: np.ndarray
    """(81,) cycles/px along the normal, 0 to 1.25."""
    mtf: np.ndarray
    mtf_std: np.ndarray
    mtf50: Any
    """Lowest frequency, cycles/px, where the MTF is one half; NaN if there is none."""
    mtf50_std: Any
    core_mtf: np.ndarray
    """The MTF without its glare; the same where no glare was found."""
    core_mtf_std: np.ndarray
    core_mtf50: Any
    core_mtf50_std: Any
    glare_fraction: Any
    """Share of the light that is spread widely; 0 where none was found (at 5 sigma)."""
    glare_fraction_std: Any
    glare_radius: Any
    """px, standard deviation of the glare as a Gaussian; NaN where none was found."""
    angle: Any
    """Direction of the edge's normal, towards its bright side, to the picture's rows: rad, x right, y down, (-pi, pi]."""
    angle_std: Any
    bow: Any
    """px: how far the edge's middle lies from the chord of its ends, towards the bright side."""
    place: tuple[Any, Any]
    """(x, y) px of the edge's middle, pixel centres of the picture on whole numbers."""
    dark: Any
    bright: Any
    """Levels on both sides, in the picture's (linear) units."""
    light: tuple[Any, Any]
    """Relative change of the light per px, along the picture's rows and columns."""
    gain: Any
    read_noise: Any
    """Noise: a pixel's variance is gain * value + read_noise^2; given, or estimated from neighbours."""
    excess: Any
    """Factor by which variances were raised because the picture scatters more than the estimated noise; 1 if not."""
    overshoot: Any
    """Of the ESF beyond its levels, relative to the step; a lens has none, sharpening has."""
    overshoot_std: Any
    problems: tuple[str, ...]
    """For each edge of a stack why it cannot be measured; empty where it can. Its numbers are NaN if it cannot."""
    parametric: ParametricEdge
    _found: Any

    def esf(self, distance: ArrayLike) -> Curve:
        """Edge response, 0 to 1, at px from the edge (positive: bright side). Of one edge."""
        return self._curve(_EDGE, distance)

    def lsf(self, distance: ArrayLike) -> Curve:
        """Line response, 1/px, at px from the edge. Of one edge."""
        return self._curve(_LINE, distance)

    @property
    def glare_found(self) -> Any:
        """Whether there is glare."""
        return self.glare_fraction != 0

    def dataset(self) -> xr.Dataset:
        """The MTFs over `frequency`, of one edge, as a Dataset with units and the other numbers as attributes."""
        import xarray as xr

        columns = {
            "mtf": self.mtf, "mtf_std": self.mtf_std, "core_mtf": self.core_mtf, "core_mtf_std": self.core_mtf_std,
            "parametric_mtf": self.parametric.mtf, "parametric_mtf_std": self.parametric.mtf_std,
        }  # fmt: skip
        numbers = (
            "mtf50",
            "mtf50_std",
            "angle",
            "angle_std",
            "bow",
            "glare_fraction",
            "glare_fraction_std",
            "glare_radius",
        )
        return xr.Dataset(
            {name: ("frequency", value) for name, value in columns.items()},
            {"frequency": ("frequency", self.frequency, {"units": "cycles/px"})},
            {name: getattr(self, name) for name in numbers},
        )

    @cached_property
    def samples(self) -> EdgeSamples:
        """The picture's own edge response, sorted by distance. Of one edge."""
        cells, fit, shift = self._found.cells, self._found.parametric, self._found.state.linear[4]
        used = np.asarray(cells.pixels) > 0
        dark, bright, gx, gy = self._found.free.levels
        light = 1 + gx * cells.x + gy * cells.y
        unit = (bright - dark) * light
        variance = self.gain * np.maximum(fit.expected, 0) + self.read_noise**2
        order = np.argsort(np.asarray(cells.distance)[used])
        columns = (
            cells.distance + shift,
            (cells.value - dark * light) / unit,
            np.sqrt(self.excess * variance / np.maximum(cells.pixels, 1)) / unit,
            (fit.expected - dark * light) / unit,
        )
        return EdgeSamples(*(np.asarray(column)[used][order] for column in columns))

    def _curve(self, function: Any, distance: ArrayLike) -> Curve:
        at = checks.number("distance", np.asarray(distance))
        # always a multiple of some length, so that one compiled program serves most calls
        padded = np.pad(np.asarray(at).ravel(), (0, -at.size % _LENGTH))
        found = function(self._found.free, padded)
        value, std = (np.asarray(a)[: at.size].reshape(at.shape) for a in (found.value, found.std))
        return Curve(value, std)

    def __getitem__(self, index: int) -> EdgeMTF:
        if not self.problems:
            raise TypeError("this is the result of one edge, not of a stack")
        one = {
            name: _picked(value, index) for name, value in vars(self).items() if name not in ("frequency", "problems")
        }
        return EdgeMTF(frequency=self.frequency, problems=(), **one)

    def __len__(self) -> int:
        if not self.problems:
            raise TypeError("this is the result of one edge, not of a stack")
        return len(self.problems)


_EDGE, _LINE = jax.jit(curves.edge_response), jax.jit(curves.line_response)


def result_of(
    found: Any, frame: Frame, model: str, lens: LensModel, half_width: float, problems: tuple[str, ...]
) -> EdgeMTF:  # fmt: skip
    """Result of a `Measurement` (as NumPy arrays) of one edge; of a stack, with leading axes, if there are `problems`."""
    free, fit = found.free, found.parametric
    glare, slope, bend = free.even[..., GLARE], found.curve[..., 1], found.curve[..., 2]
    frame = frame if problems else frame._replace(mirrored=frame.mirrored[0])
    bad = np.array([bool(p) for p in problems])

    def scalar(value: Any) -> Any:
        return np.where(bad, np.nan, value) if problems else float(value)

    def curve(value: np.ndarray) -> np.ndarray:
        return np.where(bad.reshape(-1, *[1] * (value.ndim - 1)), np.nan, value) if problems else value

    nx, ny = frame.turned(1.0, -slope)
    x, y = frame.turned(found.curve[..., 0], 0.0)
    gx, gy = frame.turned(free.levels[..., 2], free.levels[..., 3])
    return EdgeMTF(
        frequency=FREQUENCIES,
        mtf=curve(found.mtf.value),
        mtf_std=curve(found.mtf.std),
        mtf50=scalar(found.mtf50.value),
        mtf50_std=scalar(found.mtf50.std),
        core_mtf=curve(found.core_mtf.value),
        core_mtf_std=curve(found.core_mtf.std),
        core_mtf50=scalar(found.core_mtf50.value),
        core_mtf50_std=scalar(found.core_mtf50.std),
        glare_fraction=scalar(glare),
        glare_fraction_std=scalar(np.sqrt(free.covariance[..., GLARE, GLARE])),
        glare_radius=scalar(np.where(glare != 0, free.shape.radius, np.nan)),
        angle=scalar(np.arctan2(ny, nx)),
        angle_std=scalar(np.sqrt(found.curve_covariance[..., 1, 1]) / (1 + slope**2)),
        # the curve x0(y) = ... + bend y^2 lies below its chord by bend (length / 2)^2, measured along x
        bow=scalar(-bend * frame.length**2 / 4 / np.hypot(1, slope)),
        place=(scalar(frame.x + x), scalar(frame.y + y)),
        dark=scalar(free.levels[..., 0]),
        bright=scalar(free.levels[..., 1]),
        light=(scalar(gx), scalar(gy)),
        gain=scalar(found.noise.gain),
        read_noise=scalar(found.noise.read),
        excess=scalar(found.excess),
        overshoot=scalar(found.overshoot.value),
        overshoot_std=scalar(found.overshoot.std),
        problems=problems,
        parametric=ParametricEdge(
            model=model,
            names=lens.names,
            values=curve(fit.numbers),
            covariance=curve(fit.numbers_covariance),
            mtf=curve(fit.mtf.value),
            mtf_std=curve(fit.mtf.std),
            mtf50=scalar(fit.mtf50.value),
            mtf50_std=scalar(fit.mtf50.std),
            chi2=scalar(fit.chi2),
            degrees=fit.degrees,
            misfit_probability=scalar(_misfit_probability(*fit.structure)),
            _lens=lens,
            _fitted=fit.state.profile,
            _half_width=half_width,
        ),
        _found=found,
    )


def _misfit_probability(found: np.ndarray, mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Of a quadratic form of normal numbers with this mean and variance, as a scaled chi-square (Satterthwaite 1946)."""
    from scipy.special import chdtrc  # needed here only

    known = (variance > 0) & (mean > 0)  # not where there was nothing to be fitted
    mean, variance = np.where(known, mean, 1.0), np.where(known, variance, 1.0)
    return np.where(known, chdtrc(2 * mean**2 / variance, np.maximum(found, 0.0) * 2 * mean / variance), np.nan)


def _picked(value: Any, index: int) -> Any:
    """One edge of anything that holds a stack."""
    if isinstance(value, ParametricEdge):
        kept = ("model", "names", "_lens", "_half_width")
        return ParametricEdge(**{n: v if n in kept else _picked(v, index) for n, v in vars(value).items()})
    if isinstance(value, np.ndarray):
        return float(value[index]) if value.ndim == 1 else value[index]
    return jax.tree.map(partial(_picked, index=index), value)
