"""Sources of the uncertainty of a joint fit, and parameters that its images do not distinguish.

There are two budgets. `error_budget` computes the decrease of the variance that an exact source would cause.
`reading_budget` builds the budget of the GUM (Guide to the expression of uncertainty in measurement, JCGM 100:2008).
This budget consists of the variances of independent sources, whose sum is the variance of the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from matcam.files.capture_settings import Stated
from matcam.inverse.fit.fit_parameters import LobeKind
from matcam.inverse.fit.lobe_readings import HALF_WIDTH, half_maximum, lobe_readings
from matcam.numerics.budget import UncertaintyBudget, UncertaintySource
from matcam.numerics.fit_budget import Readings, StatedParameter, Statement, posterior_budget
from matcam.reconstruction.joint.field_change import FIELD
from matcam.reconstruction.reflectance_curve import ReflectanceCurve
from matcam.reconstruction.sphere_fit import SphereFit

NOISE = "noise"
"""Source of the uncertainty that remains if all specified values are exact: photon noise, read noise, and residuals of the
model.
"""
REFERENCE = "reference"
"""Source of the uncertainty of the unit of image values: reflectance, position and noise of a white patch."""
_KEPT = 0.01
"""Share of the prior information on a parameter that is kept in the test of determination. Without this share, the
other parameters would be fully correlated with the freed parameter.
"""
_NORMAL = np.radians([10, 15, 20, 25, 30, 35, 40, 45])
"""Angles theta_d at which F is averaged for normalisation, rad; angles outside the range of the images are omitted."""


class Inseparable(NamedTuple):
    """Parameters that the images alone do not distinguish.

    Attributes:
        names: names of two parameters.
        correlation: correlation of the two parameters, no unit, if the first has nearly no prior.
    """

    names: tuple[str, str]
    correlation: float

    @property
    def text(self) -> str:
        return f"{self.names[0]} from {self.names[1]} (correlation {self.correlation:.3f})"

    def to_dict(self) -> dict[str, object]:
        return {"names": list(self.names), "correlation": self.correlation}


class Ratio(NamedTuple):
    """Ratio of F(theta_d) to the mean of F from 10 to 45 degrees.

    Attributes:
        theta_d: difference angle, rad.
        value: the ratio, no unit.
        std: standard deviation of the ratio, no unit.
    """

    theta_d: float
    value: float
    std: float


class FitReading(NamedTuple):
    """Value that is derived from a joint fit.

    Attributes:
        value: the value, in its unit.
        slope: derivatives with respect to the parameters of the fit, (size,).
        more: sources of uncertainty other than the parameters.
    """

    value: float
    slope: np.ndarray
    more: tuple[UncertaintySource, ...] = ()

    def std(self, covariance: np.ndarray) -> float:
        own = sum(source.contribution**2 for source in self.more)
        return float(np.sqrt(max(float(self.slope @ covariance @ self.slope) + own, 0.0)))


def ratio_reading(fit: SphereFit, curve: ReflectanceCurve, channel: int, theta_d: float) -> FitReading:
    """Compute the ratio of F(theta_d) to the mean of F from 10 to 45 degrees.

    Angles outside the range of the images are omitted from the mean.

    Args:
        fit: the fit.
        curve: F of the channel.
        channel: index of the channel.
        theta_d: difference angle, rad.
    """
    at = np.append(_normal_angles(fit), theta_d)
    value, slopes = curve.at(at), curve.slopes(at)
    mean = value[:-1].mean()
    ratio = value[-1] / mean
    row = ratio * (slopes[-1] / value[-1] - slopes[:-1].mean(axis=0) / mean)
    return _of_curve(fit, curve, channel, float(ratio), row)


def _level_reading(fit: SphereFit, curve: ReflectanceCurve, channel: int, unit: float) -> FitReading:
    """Compute the mean of F from 10 to 45 degrees.

    `unit` is the strength that corresponds to F = 1. Angles outside the range of the images are omitted from the mean.
    """
    at = _normal_angles(fit)
    level = float(curve.at(at).mean()) / unit
    return _of_curve(fit, curve, channel, level, curve.slopes(at).mean(axis=0) / unit)


def _normal_angles(fit: SphereFit) -> np.ndarray:
    seen = fit.solution.theta_d
    normal = np.array([angle for angle in _NORMAL if seen.min() <= angle <= seen.max()])
    return normal if normal.size else np.array([seen.min()])


def error_budget(
    fit: SphereFit, curve: ReflectanceCurve, channel: int, theta_d: float, unit_std: float = float("nan")
) -> dict[str, dict[str, float]]:
    """Compute the contribution of each source to the standard deviation of the results.

    The contribution of a source is the square root of the decrease of the variance if the source is exact.

    Args:
        fit: the fit.
        curve: F of one channel.
        channel: index of the channel.
        theta_d: difference angle of the ratio, rad.
        unit_std: relative standard deviation of the unit of the images, from a reference. Default: NaN, F is relative.

    Returns:
        Standard deviations by source and result. The results are "ratio" (F at theta_d divided by the mean of F from 10 to
        45 degrees, relative), "level" (this mean, relative; only if F is absolute), "roughness" (logarithm of the first
        parameter of the lobe, or of the half width of a spline-modified lobe), "radius_px" (px) and "lens" (relative). The
        source "total" includes all sources, "reference" is the unit of the images, and "noise" is the standard deviation
        if all specified values are exact.
    """
    solution, layout, unity = fit.solution, fit.layout, np.eye(fit.layout.size)
    ratio, width = ratio_reading(fit, curve, channel, theta_d), next(iter(_lobe_readings(fit).values()))
    absolute = bool(np.isfinite(unit_std))
    readings = {"ratio": (ratio, ratio.value)}
    if absolute:
        level = _level_reading(fit, curve, channel, 1.0)
        readings["level"] = level, level.value
    readings["roughness"] = width, width.value
    readings["radius_px"] = FitReading(0.0, unity[layout.of("radius")]), 1.0
    readings["lens"] = FitReading(0.0, unity[layout.of("lens")]), 1.0

    def stds(covariance: np.ndarray) -> dict[str, float]:
        return {name: one.std(covariance) / abs(unit) for name, (one, unit) in readings.items()}

    total = stds(solution.covariance)
    budget = {"total": dict(total)}
    if absolute:
        budget["total"]["level"] = float(np.hypot(total["level"], unit_std))
    everything = np.zeros_like(solution.covariance)
    for source in dict.fromkeys(solution.problem.prior_sources):
        # a factor of 1e6 of the information makes a source exact
        change = 1e6 * solution.problem.information_of(source)
        everything += change
        without = stds(solution.covariance_with(change))
        budget[source] = {name: float(np.sqrt(max(total[name] ** 2 - without[name] ** 2, 0.0))) for name in total}
    if absolute:
        budget[REFERENCE] = dict.fromkeys(total, 0.0) | {"level": unit_std}
    budget[NOISE] = stds(solution.covariance_with(everything))
    return budget


def _shared(fit: SphereFit) -> tuple[tuple[str, ...], np.ndarray]:
    """Collect the reported parameters that all images share.

    A spline-modified lobe has a half width instead of coefficients.

    Returns:
        Names, and derivatives with respect to the coordinates of the fit, (names, coordinates).
    """
    diffuse = [f"diffuse {channel}" for channel in fit.channels]
    others = ("lens", "radius", "camera distance", "lamp distance", *diffuse, *FIELD)
    own = fit.kind.size
    names, rows = fit.kind.names, np.eye(own)
    if fit.kind.spline_size:
        names, _, rows = lobe_readings(fit.kind, fit.solution.p[:own])
    return (*names, *others), block_diag(rows, np.eye(len(others)))


def inseparable(fit: SphereFit) -> tuple[Inseparable, ...]:
    """Find shared parameters that the images alone do not distinguish from the lens, the distances or the outline.

    The priors of lens, camera distance, lamp distance and outline are removed in turn, except for 1 % of their information.
    A freed parameter is reported if its standard deviation more than triples, and if its correlation with another shared
    parameter exceeds 0.95. It is reported together with the parameter of the largest correlation.
    """
    solution, (names, slopes) = fit.solution, _shared(fit)

    def shared(covariance: np.ndarray) -> np.ndarray:
        return slopes @ covariance[: slopes.shape[1], : slopes.shape[1]] @ slopes.T

    before = np.diag(shared(solution.fitted))
    found: list[Inseparable] = []
    for source, name in (("lens", "lens"), ("camera distance",) * 2, ("lamp distance",) * 2, ("outline", "radius")):
        information = solution.problem.information_of(source)
        if not information.any():
            continue
        position = names.index(name)
        after = shared(solution.covariance_without((1 - _KEPT) * information))
        grown = after[position, position] / max(before[position], 1e-300)
        # ratio of standard deviations without and with specified values above which a parameter is not
        # determined
        if not np.isfinite(grown) or grown < 3.0**2:
            continue
        std = np.sqrt(np.maximum(np.diag(after), 1e-300))
        correlation = after[position] / (std[position] * std)
        # a correlation with an undetermined parameter is not counted
        said = {one for pair in found for one in pair.names}
        # correlation above which the images do not distinguish two parameters
        apart = [
            Inseparable((name, names[other]), float(np.clip(value, -1, 1)))
            for other, value in enumerate(correlation.tolist())
            if other != position and abs(value) > 0.95 and before[other] > 0 and names[other] not in said
        ]
        # a nearly free parameter is correlated with all others
        found += sorted(apart, key=lambda one: -abs(one.correlation))[:1]
    return tuple(found)


def parameter_readings(
    fit: SphereFit, curves: Sequence[ReflectanceCurve], units: Sequence[Stated]
) -> dict[str, FitReading]:
    """Derive the parameters of lobe, lens, F (n and k) and diffuse parts from a fit.

    `curves` contains F of each channel. `units` contains the unit of each channel, which is the image value per radiance
    under unit irradiance. The keys of the result are the names in a report.
    """
    p, layout, unity = fit.solution.p, fit.layout, np.eye(fit.layout.size)
    found = _lobe_readings(fit)
    sigma = fit.scene.sigma
    lens, name = (sigma, "sigma_px") if np.isfinite(sigma) else (1.0, "lens_scale")
    lens *= float(np.exp(p[layout.of("lens")]))
    found[name] = FitReading(lens, lens * unity[layout.of("lens")])
    for index, (channel, curve) in enumerate(zip(fit.channels, curves, strict=True)):
        for name, (value, row) in curve.parameters().items():
            found[f"{name}_{channel}"] = _of_curve(fit, curve, index, value, row)
        position = layout.diffuse.start + index
        if not fit.solution.problem.fixed[position]:
            value, unit = float(p[position]) / units[index].value, units[index].value
            row = unity[position] / unit - value * fit.light.unit_by_nearness * unity[layout.of("lamp")]
            found[f"diffuse_{channel}"] = FitReading(value, row)
    return found


def reflectance_readings(
    fit: SphereFit, curves: Sequence[ReflectanceCurve], units: Sequence[Stated], theta_d: float
) -> dict[str, FitReading]:
    """Derive the ratio of F at an angle to the mean of F from 10 to 45 degrees, for each channel.

    If F is absolute, the mean is derived, too. `curves` and `units` are those of `parameter_readings`. `theta_d` is the
    difference angle, rad. The keys of the result are the names in a report.
    """
    found = {}
    for index, (channel, curve, unit) in enumerate(zip(fit.channels, curves, units, strict=True)):
        ratio = ratio_reading(fit, curve, index, theta_d)
        found[f"F({np.degrees(theta_d):.0f} deg) / F(10 to 45 deg), {channel}"] = ratio
        if np.isfinite(unit.std):
            one = _level_reading(fit, curve, index, unit.value)
            source = UncertaintySource(
                f"{REFERENCE}: value of the images for F = 1",
                unit.value,
                unit.std * unit.value,
                -one.value / unit.value,
                "B",
            )
            found[f"F(10 to 45 deg), {channel}"] = one._replace(more=(*one.more, source))
    return found


def length_readings(fit: SphereFit) -> dict[str, FitReading]:
    """Derive the outline radius (px) and the distances of camera and lamp (radii of the sample) from a fit.

    A distance is omitted if its standard deviation is at least half the distance, because only a lower limit is known.
    """
    layout, p, unity = fit.layout, fit.solution.p, np.eye(fit.layout.size)
    found = {"outline_radius_px": FitReading(float(p[layout.of("radius")]), unity[layout.of("radius")])}
    for name in ("camera", "lamp"):
        at = layout.of(name)
        nearness = float(p[at])
        if nearness > 2 * np.sqrt(fit.solution.covariance[at, at]):
            found[f"{name}_distance_radii"] = FitReading(1 / nearness, -unity[layout.of(name)] / nearness**2)
    return found


def reading_budget(fit: SphereFit, name: str, reading: FitReading) -> UncertaintyBudget:
    """Build the uncertainty budget (GUM) of a value derived from a fit.

    `name` is the name of the value with its unit.
    """
    solution = fit.solution
    unstated = float(reading.slope @ (solution.covariance - solution.fitted) @ reading.slope)
    more = list(reading.more)
    if solution.problem.unstated:
        k1 = solution.problem.unstated[0].field.k1
        more.append(
            UncertaintySource(
                "unspecified distortion k1 of the lens", k1.value, k1.std, np.sqrt(max(unstated, 0.0)) / k1.std, "B"
            )
        )
    pixels = sum(int(one.used.sum()) for one in solution.problem.pixels)
    degrees = max(float(pixels - (~solution.problem.fixed).sum()), 1.0)
    readings = Readings("pixels: noise and unexplained light", "A", degrees)
    return posterior_budget(name, reading.value, reading.slope, solution.fitted, _statements(fit), readings, more)


def _statements(fit: SphereFit) -> list[Statement]:
    """Collect the prior knowledge of the parameters.

    A source that specifies one parameter has the name and unit of that parameter.
    """
    problem, layout, scene = fit.solution.problem, fit.layout, fit.scene
    sigma = scene.sigma
    radius = np.nan if scene.sample_radius is None else scene.sample_radius.value
    lens = ("lens: optics.sigma_px", sigma, sigma) if np.isfinite(sigma) else ("lens: scale of its kernel", 1.0, 1.0)
    named = {
        "lens": StatedParameter(layout.of("lens"), *lens),
        "sample radius": StatedParameter(layout.sample_radius, "sample radius, mm", radius, radius),
    }
    found = []
    for source in dict.fromkeys(problem.prior_sources):
        single = problem.prior_sources.count(source) == 1 and source in named
        found.append(Statement(source, problem.information_of(source), (named[source],) if single else ()))
    return found


def _lobe_readings(fit: SphereFit) -> dict[str, FitReading]:
    """Derive the parameters of the lobe.

    The half width, rad, is one of the parameters of a spline-modified lobe. For other lobes, the half width is added to
    the parameters. For a lobe with two roughnesses, the half widths along the x and y axes of the material are added.
    """
    kind, size = fit.kind, fit.layout.size
    q = fit.solution.p[: kind.size]

    def reading(value: float, slope: np.ndarray, first: int = 0) -> FitReading:
        row = np.zeros(size)
        row[first : first + len(slope)] = slope
        return FitReading(value, row)

    read = lobe_readings(kind, q)
    rows = zip(read.names, read.values.tolist(), read.slopes, strict=True)
    found = {name: reading(value, slope) for name, value, slope in rows}
    if kind.spline_size:
        return found
    if not kind.stretched:
        return found | {HALF_WIDTH: reading(*half_maximum(kind, q))}
    # along an axis of the slopes the lobe is an isotropic lobe with the roughness of that axis
    plain = LobeKind(kind.family, kind.masking)
    for axis, index in (("x", 0), ("y", 1)):
        found[f"hwhm_{axis}_rad"] = reading(*half_maximum(plain, q[index : index + 1]), index)
    return found


def _of_curve(fit: SphereFit, curve: ReflectanceCurve, channel: int, value: float, row: np.ndarray) -> FitReading:
    """Build the reading of a value that is derived from the curve of F of one channel.

    `row` contains the derivatives of the value with respect to the coefficients of the curve.
    """
    slope = row @ curve.gain @ fit.strengths_rows()[channel :: fit.layout.channels]
    by_scale, by_misfit = (float(np.sqrt(max(row @ part @ row, 0.0))) for part in (curve.by_scale, curve.by_misfit))
    degrees = max(float(fit.layout.pictures - len(row)), 1.0)
    more = (
        UncertaintySource("scale of F", 0.0, by_scale, 1.0, "B"),
        UncertaintySource("departures of F from its curve", 0.0, by_misfit, 1.0, "A", degrees),
    )
    return FitReading(value, slope, tuple(source for source in more if source.uncertainty > 0))
