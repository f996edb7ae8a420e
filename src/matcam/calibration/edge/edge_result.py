"""Results of slanted edges: model-free and parametric estimates of one edge or of a stack, with standard deviations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from matcam.calibration.edge import free_curve
from matcam.calibration.edge.free_curve import FREQUENCIES, GLARE, EdgeSamples, SampledCurve
from matcam.calibration.edge.geometry import CURVE, EdgeCells, legendre
from matcam.calibration.edge.maximum_likelihood import ADDED, SHIFT, light_of
from matcam.calibration.edge.measurement import EdgeFits
from matcam.calibration.edge.parametric_result import (
    EdgeValues,
    ParametricEdge,
    ParametricStack,
    parametric_stack,
    with_nan,
)
from matcam.calibration.edge.profiles import LensModel
from matcam.calibration.edge.rows import MISFIT, RegionFrame
from matcam.calibration.photograph.linear_filters import BareEdge
from matcam.core import checks
from matcam.core.arrays import tuple_map
from matcam.core.io import plain
from matcam.core.remark import Remark, texts
from matcam.core.results.summary import Quantity, Summarised, Summary

if TYPE_CHECKING:
    import xarray as xr

_NAMES = {
    "mtf": "MTF of lens and pixel", "mtf_std": "standard deviation of mtf", "core_mtf": "MTF without glare",
    "core_mtf_std": "standard deviation of core_mtf", "parametric_mtf": "MTF of the fitted model",
    "parametric_mtf_std": "standard deviation of parametric_mtf",
}  # fmt: skip
"""Descriptions of the variables of `EdgeMTF.dataset`."""


@dataclass(frozen=True, eq=False, repr=False)
class EdgeMTF(Summarised, EdgeValues[float]):
    """MTF of lens and pixel across one edge.

    The MTF is estimated without a model and with a lens model (`parametric`). The standard deviations describe the scatter
    of repeated images with the same noise, and the remaining systematic effects that `remarks` lists.

    Attributes:
        frequency: frequencies (81,) along the normal, 0 to 1.25 cycles/px.
        mtf: MTF of lens and pixel (81,), without a model (no unit).
        mtf_std: standard deviation of `mtf` (81,).
        mtf50: lowest frequency at which the MTF is one half, cycles/px; NaN if the MTF does not fall to one half.
        mtf50_std: standard deviation of `mtf50`, cycles/px.
        core_mtf: MTF without glare (81,); equal to `mtf` if no glare was found (no unit).
        core_mtf_std: standard deviation of `core_mtf` (81,).
        core_mtf50: lowest frequency at which `core_mtf` is one half, cycles/px; NaN if `core_mtf` does not fall to one half.
        core_mtf50_std: standard deviation of `core_mtf50`, cycles/px.
        glare_fraction: share of the light in glare; 0 if no glare was found at 5 sigma (no unit).
        glare_fraction_std: standard deviation of `glare_fraction` (no unit).
        glare_radius: standard deviation of the glare, modelled as a Gaussian, px; NaN if no glare was found.
        angle: angle from the rows of the image to the normal of the edge, which points to the bright side, rad, in
            (-pi, pi]; x points right, and y points down.
        angle_std: standard deviation of `angle`, rad.
        bow: distance of the middle of the edge from the chord between its ends, positive towards the bright side, px.
        position: (x, y) of the middle of the edge in the whole image, px; pixel centres have whole-number coordinates.
        dark: level of the dark side, in the units of the linear image.
        bright: level of the bright side, in the units of the linear image.
        light: relative changes of the light along the rows and along the columns of the image, 1/px.
        gain: system gain, given or estimated, in the units of the image: the variance of a pixel is gain * value +
            read_noise^2.
        read_noise: standard deviation of the read noise, given or estimated, in the units of the image.
        excess: factor by which all variances were increased because the scatter of the pixels exceeds the noise; 1 if
            it does not (no unit).
        outliers: number of pixels that were excluded as outliers (no unit).
        roughness: standard deviation of the position of the edge in single rows beyond noise, px; `mtf_std` includes the
            blur by the roughness.
        misfit: residual near the edge that neither lens nor light explains, in units of the step; `mtf_std` includes it.
        overshoot: largest excess of the edge spread function beyond the dark or the bright level, relative to the step.
            Sharpening causes an overshoot, but a lens does not (no unit).
        overshoot_std: standard deviation of `overshoot` (no unit).
        parametric: fit of a lens model, a `ParametricEdge`.
        fits: all fitted quantities; positions are relative to the centre of the region, px.
        given: remarks on the image, for example on its tone curve (no unit). Default: (), no remarks.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> image = 100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y)))
        >>> result = matcam.edge_mtf(image, gain=1.0, read_noise=0.0)
        >>> result.glare_found, result.remarks
        (False, ())
        >>> esf = result.esf([-4.0, 0.0, 4.0])
        >>> [round(float(value), 2) for value in esf.value]
        [0.0, 0.5, 1.0]
    """

    parametric: ParametricEdge
    fits: EdgeFits
    given: tuple[Remark, ...] = ()

    def esf(self, distance: ArrayLike) -> SampledCurve:
        """Evaluate the edge spread function, 0 to 1.

        Args:
            distance: distance from the edge, positive on the bright side, px, any shape.

        Returns:
            Value and standard deviation, with the shape of `distance`.
        """
        return self._curve(free_curve.edge_response, distance)

    def lsf(self, distance: ArrayLike) -> SampledCurve:
        """Evaluate the line spread function, 1/px.

        Args:
            distance: distance from the edge, positive on the bright side, px, any shape.

        Returns:
            Value and standard deviation, with the shape of `distance`.
        """
        return self._curve(free_curve.line_response, distance)

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """Remarks on the image and on unusual properties of this edge."""
        remarks = list(self.given)
        if self.excess > 1:
            raised = np.sqrt(self.excess)
            text = f"the scatter of the pixels exceeds their noise: standard deviations were multiplied by {raised:.1f}"
            remarks.append(Remark("scatter", text))
        if self.misfit > MISFIT:
            text = (
                f"neither a lens nor smooth light explains {self.misfit:.2%} of the step: the region may contain a ghost, a "
                "shadow or dirt; standard deviations were increased"
            )
            remarks.append(Remark("unexplained", text))
        # The blur by a roughness below 0.03 px is negligible.
        if self.roughness > 0.03:
            text = f"the edge has a roughness of {self.roughness:.2f} px, which blurs it: standard deviations were increased"
            remarks.append(Remark("rough-edge", text))
        if self.outliers:
            text = f"outlying pixels, such as hot or dead pixels and dust, were excluded ({self.outliers})"
            remarks.append(Remark("outliers", text))
        return tuple(remarks)

    def dataset(self) -> xr.Dataset:
        """Convert the MTFs to a data set over `frequency`.

        Returns:
            Data set with units. Its attributes are MTF50, angle, bow, and share and radius of the glare.
        """
        import xarray as xr

        from matcam.core.results.labelled import named

        (_, frequency), *curves = self.columns().items()
        names = (
            "mtf50",
            "mtf50_std",
            "angle",
            "angle_std",
            "bow",
            "glare_fraction",
            "glare_fraction_std",
            "glare_radius",
        )
        data = xr.Dataset(
            {name: ("frequency", curve) for name, curve in curves},
            {"frequency": frequency},
            {name: getattr(self, name) for name in names},
        )
        return named(data, _NAMES)

    def columns(self) -> dict[str, np.ndarray]:
        """Collect frequencies and MTFs (81,) for the table of `matcam edge`.

        Returns:
            Arrays by name.
        """
        fit = self.parametric
        return {
            "frequency_cycles_per_px": self.frequency, "mtf": self.mtf, "mtf_std": self.mtf_std, "core_mtf": self.core_mtf,
            "core_mtf_std": self.core_mtf_std, "parametric_mtf": fit.mtf, "parametric_mtf_std": fit.mtf_std,
        }  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Convert the result to the JSON object of `matcam edge --json`.

        Returns:
            Values by name, with units in the names; angles are in degrees. A standard deviation has the unit of its
            value.
        """
        return plain(
            {
                "mtf50_cycles_per_px": self.mtf50,
                "mtf50_std": self.mtf50_std,
                "core_mtf50_cycles_per_px": self.core_mtf50,
                "core_mtf50_std": self.core_mtf50_std,
                "glare_fraction": self.glare_fraction,
                "glare_fraction_std": self.glare_fraction_std,
                "glare_radius_px": self.glare_radius,
                "angle_deg": np.degrees(self.angle),
                "angle_std_deg": np.degrees(self.angle_std),
                "bow_px": self.bow,
                "light_per_px": self.light,
                "levels": [self.dark, self.bright],
                "gain": self.gain,
                "read_noise": self.read_noise,
                "excess": self.excess,
                "outliers": self.outliers,
                "roughness_px": self.roughness,
                "misfit": self.misfit,
                "overshoot": self.overshoot,
                "remarks": texts(self.remarks),
                "parametric": self.parametric,
                "frequency_cycles_per_px": self.frequency,
                "mtf": self.mtf,
                "mtf_std": self.mtf_std,
            }
        )

    def _summary(self) -> Summary:
        fit, frequency = self.parametric, "cycles/px"
        found = [Quantity("MTF50", self.mtf50, self.mtf50_std, frequency)]
        if self.glare_found:
            found += [
                Quantity("MTF50 without glare", self.core_mtf50, self.core_mtf50_std, frequency),
                Quantity("glare, share of the light", self.glare_fraction, self.glare_fraction_std),
            ]
        geometry = [
            Quantity("direction of the normal", self.angle, self.angle_std, "rad", relative=False),
            Quantity("bow", self.bow, unit="px"),
        ]
        return Summary(
            f"Slanted edge with its normal at {np.degrees(self.angle):.2f}°",
            sections={
                "MTF of lens and pixel, without a model": found,
                f"Model of the lens: {fit.model}{'' if fit.consistent else ' (does not explain the edge)'}": fit.quantities(),
                "Edge": [*geometry, Quantity("overshoot, share of the step", self.overshoot, self.overshoot_std)],
            },
            remarks=self.remarks,
        )

    @property
    def samples(self) -> EdgeSamples:
        """Measured edge response, sorted by distance."""
        bare = self.bare
        return EdgeSamples(bare.distance, bare.value, bare.std, bare.parametric)

    @cached_property
    def bare(self) -> BareEdge:
        """Means of pixels, sorted by distance, corrected for levels and light."""
        fits = self.fits
        order = np.argsort(fits.cells.distance)
        order = order[fits.cells.pixels[order] > 0]
        cells = EdgeCells(*(column[..., order] for column in fits.cells))
        (dark, bright), free, expected = fits.free.levels[:2], fits.state.used > 0, fits.parametric.expected[order]
        factor, addend = light_of(fits.free.levels, cells.terms)
        unit = (bright - dark) * factor
        value, parametric = ((a - addend - dark * factor) / unit for a in (cells.value, expected))
        variance = fits.noise.variance(expected, cells.dim)
        scene = (value + dark / (bright - dark)) / factor
        multiplied, added = cells.terms[free[2 : SHIFT - ADDED]], cells.terms[:ADDED][free[SHIFT - ADDED : SHIFT]]
        light = np.concatenate([np.ones((1, order.size)), scene * multiplied, added / unit])
        std = np.sqrt(fits.excess * variance / cells.pixels) / unit
        distance, spread = np.asarray(cells.distance + fits.shift), np.asarray(cells.spread)
        blur = float(free_curve.line_width(fits.free.shape))
        return BareEdge(distance, spread, value, std, parametric, light, blur)

    def _curve(self, function: Any, distance: ArrayLike) -> SampledCurve:
        at = np.asarray(checks.number("distance", np.asarray(distance)))
        found = function(self.fits.free, at.ravel())
        return SampledCurve(*(np.reshape(a, at.shape) for a in found))


@dataclass(frozen=True, eq=False, repr=False)
class EdgeStack(Summarised, EdgeValues[np.ndarray]):
    """Results of n edges.

    Floating-point values of an edge that cannot be measured are NaN. `stack[i]` is the `EdgeMTF` of one edge.

    Attributes:
        frequency: frequencies (81,) along the normal, cycles/px; the same for all edges.
        mtf: MTF of lens and pixel (n, 81), without a model (no unit).
        mtf_std: standard deviation of `mtf` (n, 81).
        mtf50: lowest frequency at which the MTF is one half (n,), cycles/px.
        mtf50_std: standard deviation of `mtf50` (n,), cycles/px.
        core_mtf: MTF without glare (n, 81) (no unit).
        core_mtf_std: standard deviation of `core_mtf` (n, 81).
        core_mtf50: lowest frequency at which `core_mtf` is one half (n,), cycles/px.
        core_mtf50_std: standard deviation of `core_mtf50` (n,), cycles/px.
        glare_fraction: share of the light in glare (n,) (no unit).
        glare_fraction_std: standard deviation of `glare_fraction` (n,).
        glare_radius: standard deviation of the glare, modelled as a Gaussian (n,), px.
        angle: angle from the rows of the image to the normal of the edge (n,), rad.
        angle_std: standard deviation of `angle` (n,), rad.
        bow: distance of the middle of the edge from the chord between its ends (n,), px.
        position: (x, y) of the middle of the edge, (n,) each, px.
        dark: level of the dark side (n,), in the units of the image.
        bright: level of the bright side (n,), in the units of the image.
        light: relative change of the light along rows and columns, (n,) each, 1/px.
        gain: system gain (n,), in the units of the image.
        read_noise: standard deviation of the read noise (n,), in the units of the image.
        excess: factor by which all variances were increased, as in `EdgeMTF` (n,) (no unit).
        outliers: number of pixels that were excluded (n,) (no unit).
        roughness: standard deviation of the position of the edge in single rows beyond noise (n,), px.
        misfit: residual near the edge that neither lens nor light explains, in units of the step (n,).
        overshoot: overshoot of the edge spread function, relative to the step (n,) (no unit).
        overshoot_std: standard deviation of `overshoot` (n,).
        problems: for each edge, the reason why it cannot be measured, or None.
        parametric: fits of a lens model, a `ParametricStack`.
        fits: all fitted quantities, in the form that the joint fit of many edges requires.
        given: for each edge, remarks on processing such as denoising, a tone curve or crushed blacks. Default: (), no
            remarks.

    Example:
        >>> y, x = np.mgrid[-80:80, -40:40]
        >>> image = 100 + 800 / (1 + np.exp(-2 * (x - 0.1 * y)))
        >>> stack = matcam.edge_mtf_stack([image, np.zeros((160, 80))])
        >>> [problem and problem.code for problem in stack.problems]
        [None, 'flat']
        >>> len(stack), stack.good, round(stack[0].mtf50, 2)
        (2, array([0]), 0.22)
    """

    problems: tuple[Remark | None, ...]
    parametric: ParametricStack
    fits: EdgeFits
    given: tuple[tuple[Remark, ...], ...] = ()

    @property
    def good(self) -> np.ndarray:
        """Indices of the edges that could be measured."""
        return np.flatnonzero([problem is None for problem in self.problems])

    def _summary(self) -> Summary:
        found = f", median MTF50 {np.median(self.mtf50[self.good]):.4f} cycles/px" if self.good.size else ""
        problems = {i: problem for i, problem in enumerate(self.problems) if problem is not None}
        return Summary(
            f"{len(self)} edges, {self.good.size} measured{found}",
            sections={"Not measured": [Quantity(f"edge {i}", problem.text) for i, problem in problems.items()]},
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert the results to a JSON object.

        Returns:
            "edges": result of `EdgeMTF.to_dict` of each edge; "problems": reason why each edge cannot be measured, or null.
        """
        return plain({"edges": list(self), "problems": self.problems})

    def __getitem__(self, index: int) -> EdgeMTF:
        lens = {name: _of_one(getattr(self.parametric, name), index) for name in ParametricEdge.__dataclass_fields__}
        own = EdgeValues.__dataclass_fields__.keys() - {"frequency"}
        numbers = {name: _of_one(getattr(self, name), index) for name in own} | {"frequency": self.frequency}
        fits, given = tuple_map(lambda a: a[index], self.fits), self.given[index] if self.given else ()
        return EdgeMTF(**numbers, parametric=ParametricEdge(**lens), fits=fits, given=given)

    def __iter__(self) -> Iterator[EdgeMTF]:
        return (self[i] for i in range(len(self)))

    def __len__(self) -> int:
        return len(self.problems)


def stack_result(
    fits: EdgeFits, frame: RegionFrame, lens: LensModel, half_width: float, problems: tuple[Remark | None, ...]
) -> EdgeStack:
    """Convert the fits of a stack to results in the coordinates of the image. The arrays of `fits` are NumPy arrays."""
    free = fits.free
    glare = free.coefficients[..., GLARE]
    slope, end = np.asarray(fits.slope), frame.length / 2 / fits.length
    # The orders that are even in y determine the curve at its middle, and the mean of its ends.
    even = legendre(np.stack([0 * end, end]), CURVE)[::2]
    middle, ends = np.einsum("nk,kin->in", fits.curve[:, ::2], even)
    levels = np.moveaxis(np.asarray(free.levels), -1, 0)
    bad = np.array([problem is not None for problem in problems])

    nx, ny = frame.in_picture(1.0, -slope)
    x, y = frame.in_picture(middle, 0.0)
    numbers: dict[str, Any] = {
        "glare_fraction": glare,
        "glare_fraction_std": np.sqrt(np.maximum(free.covariance[..., GLARE, GLARE], 0.0)),
        "glare_radius": np.where(glare != 0, free.shape.radius, np.nan),
        "angle": np.arctan2(ny, nx),
        "angle_std": fits.slope_std / (1 + slope**2),
        "bow": (middle - ends) / np.hypot(1, slope),
        "dark": levels[0],
        "bright": levels[1],
        "gain": fits.noise.gain,
        "read_noise": fits.noise.read,
    }
    numbers |= {name: getattr(fits, name) for name in ("excess", "roughness", "misfit")}
    for name in ("mtf", "mtf50", "core_mtf", "core_mtf50", "overshoot"):
        found = getattr(fits, name)
        numbers |= {name: found.value, f"{name}_std": found.std}
    known: dict[str, Any] = {name: with_nan(value, bad) for name, value in numbers.items()}
    for name, pair in (("position", (frame.x + x, frame.y + y)), ("light", frame.in_picture(levels[2], levels[3]))):
        known[name] = tuple(with_nan(part, bad) for part in pair)
    return EdgeStack(
        **known,
        frequency=FREQUENCIES,
        outliers=np.asarray(fits.outliers).astype(int),
        problems=problems,
        parametric=parametric_stack(fits.parametric, (fits.mtf, fits.mtf50), bad, lens, half_width),
        fits=fits,
    )


def _of_one(value: Any, index: int) -> Any:
    if isinstance(value, tuple) and value and isinstance(value[0], np.ndarray):
        return tuple(_of_one(part, index) for part in value)
    if isinstance(value, np.ndarray):
        return value[index].item() if value.ndim == 1 else value[index]
    return value
