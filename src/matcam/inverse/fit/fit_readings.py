"""Results of a solved fit: strengths, named parameters, materials, camera and remarks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from matcam.camera.camera import Camera, camera_with
from matcam.camera.parameters import Uncertainty
from matcam.core.jax import jax, jnp, placed
from matcam.core.remark import Remark
from matcam.inverse.fit.body import base_and_slope, diffuse_and_slope, loss_in_coat
from matcam.inverse.fit.fit_data import noise_text
from matcam.inverse.fit.fit_parameters import BASE_WIDTH, COATED, LobeKind, readable_value, reflectance_at
from matcam.inverse.fit.fit_problem import FitProblem
from matcam.inverse.fit.lobe_readings import half_maximum_angle, lobe_readings
from matcam.inverse.fit.search import Solution
from matcam.inverse.rig.lens_changes import ASSUMED, CHANGES
from matcam.inverse.rig.rig_axes import WIDTHS, Axis, known_lens
from matcam.material.microfacet import Microfacet
from matcam.material.reflectance import Conductor, Dielectric, Reflectance, Sampled, Schlick

DETERMINED = 0.05
"""Relative standard deviation below which a roughness is considered determined."""
_LARGEST_NOISE, _FLOOR_SHARE = 0.05, 20.0
"""Largest noise of a camera, as a share of the value of a pixel: that of a pixel with 400 electrons. A noise of the dark
pixels of 0.25 % of the peak counts as much.
"""
LINEAR = 0.15
"""Largest relative standard deviation of a power at which the linearised errors are valid. For larger ones the relation of
width and power is not linear, and the computed standard deviation of the width is too small.
"""

_BOUND = 0.05
"""Value of ln(width / smallest allowed width) up to which the width of a fit is considered to be at its lower bound."""
_UNSEEN = 2.0
"""Largest square of a width that is compatible with 0, in standard deviations of the square. It is the limit of a two-sided
95 % confidence interval.
"""


class FitCoordinates(NamedTuple):
    """Coordinates of the first lobe and of the rig in a solved fit.

    Attributes:
        kind: parametrisation of the lobe.
        lobe: coordinates of the lobe, in the order of `LobeKind.names`, (lobe coordinates,).
        axes: fitted parameters of the rig.
        rig: coordinates of the parameters of the rig, (axes,); 0 is the specified value.
        covariance: covariance of the coordinates of lobe and rig, (lobe coordinates + axes, lobe coordinates + axes).
    """

    kind: LobeKind
    lobe: np.ndarray
    axes: tuple[Axis, ...]
    rig: np.ndarray
    covariance: np.ndarray


class Strengths(NamedTuple):
    """Strengths F of the slices, for a fit in which F is free in every slice.

    In the shapes, u is the number of units, s of slices, and p of coordinates. For slices without values, F is NaN and the
    other arrays are 0.

    Attributes:
        value: strengths F (no unit), (u, s).
        noise_covariance: covariance of F due to pixel noise for an exact rig, (u, s, s).
        rig_covariance: covariance of F due to the uncertain parameters of the rig, (u, s, s).
        slopes: derivatives of F with respect to the coordinates of the fit, (u, s, p).
    """

    value: np.ndarray
    noise_covariance: np.ndarray
    rig_covariance: np.ndarray
    slopes: np.ndarray


class LinearisedFit(NamedTuple):
    """Linear least-squares problem of a fit at its solution.

    In the shapes, u is the number of units, s of slices, and n of cells in a slice.

    Attributes:
        solution: solution of the fit, with data, operator, model and derivatives.
        coordinates: coordinates of the first lobe and the rig.
        residual: data - model, 1/sr, (u, s, n); 0 for unused cells.
        by_coordinates: derivatives of the model with respect to the coordinates of the first lobe and the rig, 1/sr,
            (coordinates, u, s, n).
        by_units: derivatives of the model with respect to the coordinates of coat, base and units, 1/sr,
            (coordinates, u, s, n).
        rig_information: prior information matrix of the coordinates of the rig, (axes, axes).
    """

    solution: Solution
    coordinates: FitCoordinates
    residual: np.ndarray
    by_coordinates: np.ndarray
    by_units: np.ndarray
    rig_information: np.ndarray


def fit_coordinates(solution: Solution) -> FitCoordinates:
    layout, p = solution.problem.layout, solution.p
    both = np.r_[layout.lobe(0), layout.rig]
    covariance = solution.covariance[np.ix_(both, both)]
    return FitCoordinates(layout.kind, p[layout.lobe(0)], solution.problem.prior.axes, p[layout.rig], covariance)


def linearised_fit(solution: Solution) -> LinearisedFit:
    problem, layout = solution.problem, solution.problem.layout
    derivative = solution.model.derivative
    return LinearisedFit(
        solution,
        fit_coordinates(solution),
        problem.residual(solution.model),
        derivative[np.r_[layout.lobe(0), layout.rig]],
        derivative[layout.rig.stop :],
        problem.prior.rig_information(),
    )


def strengths_with_covariance(solution: Solution) -> Strengths:
    own, slope = _strength_errors(solution)
    rig = solution.problem.layout.rig
    # `added` is the part due to the uncertainty of the rig; the remainder is the covariance for an exact rig
    cross = solution.covariance[:, rig]
    added = cross @ np.linalg.pinv(solution.covariance[rig, rig], hermitian=True) @ cross.T
    seen = solution.problem.data.used.any(-1)
    diagonal = np.eye(own.shape[1]) * own[:, None, :] ** 2
    by_noise, by_rig = (
        np.einsum("pus,pq,qut->ust", slope, part, slope) for part in (solution.covariance - added, added)
    )
    value = np.where(seen, solution.model.strength, np.nan)
    return Strengths(value, diagonal + by_noise, by_rig, -np.moveaxis(slope, 0, -1))


def strength_curves(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Compute F of every unit and slice and its standard deviation, (units, slices) each.

    If F is free in every slice, the standard deviation includes the image gain. Both are then NaN in slices without values.
    """
    problem, layout = solution.problem, solution.problem.layout
    strength = solution.model.strength.copy()
    if layout.fresnel != "free":
        variance = np.zeros_like(strength)
        for u in range(len(strength)):
            slope, inner = fresnel_slope(solution, u, problem.theta_d)
            variance[u] = np.einsum("sa,ab,sb->s", slope, solution.covariance[inner, inner], slope)
        return strength, np.sqrt(variance)
    own, slope = _strength_errors(solution)
    variance = own**2 + np.einsum("pus,pq,qus->us", slope, solution.covariance, slope)
    variance += (solution.noise.picture_gain * strength) ** 2
    seen = problem.data.used.any(-1)
    return np.where(seen, strength, np.nan), np.where(seen, np.sqrt(variance), np.nan)


def fresnel_slope(solution: Solution, unit: int, theta: np.ndarray | float) -> tuple[np.ndarray, slice]:
    """Compute the derivatives of F of a unit with respect to the coordinates of F.

    Args:
        solution: solution of a fit whose model of F has parameters.
        unit: index of the unit.
        theta: angles at which F is evaluated, rad, (...).

    Returns:
        Derivatives, (..., coordinates), and the slice of the coordinate vector that contains the coordinates of F.
    """
    layout = solution.problem.layout
    first = layout.unit(unit).start
    inner = slice(first, first + layout.fresnel_size)

    def curve(c: jax.Array) -> jax.Array:
        return reflectance_at(layout.fresnel, c).at(jnp.asarray(theta))

    return np.asarray(jax.jacfwd(curve)(jnp.asarray(solution.p[inner]))), inner


def _strength_errors(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Compute the two terms of the covariance of free strengths. Both are 0 for slices without values.

    The first term, s, is the standard deviation of the strengths if all other parameters are exact, (units, slices). The
    second term, J, is the negative derivative of the strengths with respect to the coordinates of the fit,
    (coordinates, units, slices). The covariance of the strengths of a unit is diag(s^2) + J' C J, where C is the covariance of
    the coordinates.
    """
    data, model = solution.problem.data, solution.model
    weighted = np.where(data.used, solution.weight, 0.0) * model.lobe
    power = np.maximum((weighted * model.lobe).sum(-1), 1e-300)
    slope = (weighted * model.derivative).sum(-1) / power
    seen = data.used.any(-1)
    return np.where(seen, model.strength_std, 0.0), np.where(seen, slope, 0.0)


def body_at(
    solution: Solution, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the BRDF of the body and its standard deviation, 1/sr, (..., units) each.

    The angles, rad, broadcast to (...).
    """
    layout, p = solution.problem.layout, solution.p
    angles = np.broadcast_arrays(theta_h, theta_d, phi_d)
    value, variance = np.zeros((2, *angles[0].shape, layout.units))
    # each part at an amount of 1, and its derivative with respect to a coordinate that all units share
    parts: dict[str, np.ndarray] = {}
    shared: dict[str, tuple[int, np.ndarray]] = {}
    if layout.diffuse:
        lost = loss_in_coat(*angles) if layout.coated else np.zeros(angles[0].shape)
        parts["diffuse"], by_share = diffuse_and_slope(layout.coated_share(p), lost)
        if layout.coated:
            shared["diffuse"] = layout.coat.start, by_share
    if layout.base:
        parts["base"], by_width = base_and_slope(p[layout.base_width][0], *angles)
        shared["base"] = layout.base_width.start, by_width
    for u in range(layout.units):
        indices = [layout.of_units(name)[u] for name in parts]
        amounts = dict(zip(parts, np.maximum(p[indices], 0.0), strict=True))
        columns = list(parts.values())
        value[..., u] = sum((amounts[name] * column for name, column in parts.items()), 0.0)
        for name, (index, slope) in shared.items():
            indices, columns = [*indices, index], [*columns, amounts[name] * slope]
        covariance = solution.covariance[np.ix_(indices, indices)]
        variance[..., u] = np.einsum("k...,k...->...", columns, np.tensordot(covariance, columns, 1))
    return value, np.sqrt(np.maximum(variance, 0.0))


class LobeVerdict(NamedTuple):
    """Result of the check whether a fit determines and resolves its lobes.

    Attributes:
        determined: True if the first lobe is resolved and all lobes are determined. The first parameter of every lobe must
            have a relative standard deviation below 5 %. If the family has several parameters, the last parameter must have
            a relative standard deviation below 15 %. For a lobe without parameters of a family, only the half width is
            tested, with a limit of 5 %.
        resolved: True if the first lobe is wider than the smallest width that a fit allows. Every camera records a lobe of
            that width as a point.
        explained: True if the noise that was estimated from the residuals can be that of a camera, or if it was given.
    """

    determined: bool
    resolved: bool
    explained: bool


def lobe_verdict(solution: Solution, *, noise_given: bool) -> LobeVerdict:
    layout, std = solution.problem.layout, np.sqrt(np.diag(solution.covariance))
    narrowest = layout.kind.bounds(solution.problem.radius)[0][0]
    resolved = bool(float(solution.p[0]) - narrowest > _BOUND)
    explained = noise_given or max(solution.noise.relative, _FLOOR_SHARE * solution.noise.floor) <= _LARGEST_NOISE
    if not layout.kind.of_family:  # the half width is tested, because the lobe has no parameters of a family
        lobes = [layout.lobe(n) for n in range(layout.lobes)]
        angles = [half_maximum_angle(layout.kind, solution.p[at], solution.covariance[at, at]) for at in lobes]
        return LobeVerdict(resolved and all(error < DETERMINED * angle for angle, error in angles), resolved, explained)
    first = [layout.lobe(n).start for n in range(layout.lobes)]
    own = len(layout.kind.family_names)
    linear = own == 1 or bool(np.all(std[[start + own - 1 for start in first]] < LINEAR))
    return LobeVerdict(linear and bool(np.all(std[first] < DETERMINED)) and resolved, resolved, explained)


def fit_remarks(
    solution: Solution, camera: Camera | None, verdict: LobeVerdict, noise_given: bool
) -> tuple[Remark, ...]:
    """List the remarks on a fit.

    Args:
        solution: solution of the fit.
        camera: camera of the rig; None without a rig.
        verdict: result of `lobe_verdict`.
        noise_given: True if the noise is specified.
    """
    remarks = []
    prior, position, noise = solution.problem.prior, solution.problem.layout.rig, solution.noise
    if camera is None:
        remarks.append(Remark("no-rig", "without a rig, the fit assumes a perfect camera"))
    elif not prior.axes:
        remarks.append(
            Remark("camera-exact", "the camera is assumed to be exact: the errors do not include its uncertainty")
        )
    elif solution.problem.prior.root.any() and known_lens(camera).assumed:
        text = (
            f"the camera has no uncertainty: the lens width is assumed to be known to {ASSUMED:.0%}; specify the "
            "standard deviation of the width, or 0 for an exact lens"
        )
        remarks.append(Remark("lens-assumed", text))
    stds = np.sqrt(np.diag(solution.covariance)[position])
    for axis, coordinate, own in zip(prior.axes, solution.p[position], stds, strict=True):
        square, std = axis.square(coordinate, own)
        if axis.softening and square < _UNSEEN * std:
            text = f"{axis.name} is compatible with 0: its square is {square:.2g} ± {std:.2g}"
            remarks.append(Remark("compatible-with-zero", text))
    if not verdict.resolved:
        remarks.append(
            Remark(
                "lobe-too-narrow",
                "the fitted lobe has the smallest width that a fit allows, so this width is an upper bound; check that the "
                "rig is the one that recorded the data",
            )
        )
    elif not verdict.determined:
        text = "the data do not determine the lobe: the width is not known to 5 %, or the last parameter not to 15 %"
        remarks.append(Remark("roughness-not-determined", text))
    base_width = solution.problem.layout.base_width
    if (solution.p[base_width] < solution.problem.bounds()[0][base_width] + _BOUND).any():
        text = (
            f"the base has the smallest roughness that a fit allows, {float(np.exp(solution.p[base_width][0])):.2g}, so this "
            "roughness is an upper bound, and its standard deviation is too small"
        )
        remarks.append(Remark("base-too-narrow", text))
    if noise_given and solution.misfit > 1 + 5 * np.sqrt(2 / max(solution.freedom, 1)):
        text = f"the residuals are {np.sqrt(solution.misfit):.1f} times the given noise: the model does not explain the data"
        remarks.append(Remark("misfit", text))
    if not verdict.explained:
        text = (
            "the model does not explain the data, so do not use the parameters and their errors: "
            f"the residuals are {noise_text(noise, 0)} of the value of a pixel and {noise.floor:.1%} of the peak of the image, "
            "which exceeds the noise of any camera; check the camera, the radius of the sample and the family of the lobe"
        )
        remarks.append(Remark("misfit", text))
    return tuple(remarks)


class NamedParameters(NamedTuple):
    """Reported parameters of a fit.

    Attributes:
        names: names of the parameters, for example "alpha", "n[G]" and "optics.sigma_px". The parameters of a lobe are those
            of `lobe_readings`.
        values: value of each parameter, in its own unit, (names,).
        covariance: covariance of the values, (names, names).
        slopes: derivatives of the values with respect to the coordinates of the fit, (names, coordinates).
    """

    names: list[str]
    values: np.ndarray
    covariance: np.ndarray
    slopes: np.ndarray


def named_parameters(solution: Solution) -> NamedParameters:
    problem, layout, data = solution.problem, solution.problem.layout, solution.problem.data
    several = data.tables > 1
    unit_names = [f"{label}@{t}" if several else label for label, t in zip(data.labels, data.table_of, strict=True)]
    names: list[str] = []
    values: list[float] = []
    slopes: list[np.ndarray] = []
    for lobe in range(layout.lobes):
        suffix = ""
        if layout.lobes > 1:
            unit = layout.lobe_of.index(lobe)
            suffix = f"[{data.table_of[unit]}]" if layout.lobes == data.tables else f"[{unit_names[unit]}]"
        read = lobe_readings(layout.kind, solution.p[layout.lobe(lobe)])
        names += [f"{name}{suffix}" for name in read.names]
        values += read.values.tolist()
        for slope in read.slopes:
            slopes.append(np.zeros(layout.size))
            slopes[-1][layout.lobe(lobe)] = slope
    one_each = np.eye(layout.size)
    for position, axis in enumerate(problem.prior.axes, layout.rig.start):
        std = float(np.sqrt(solution.covariance[position, position]))
        names.append(axis.name)
        values.append(axis.value(solution.p[position]))
        slopes.append(one_each[position] * axis.slope(solution.p[position], std))
    for name, where in ((COATED, layout.coat), (BASE_WIDTH, layout.base_width)):
        for position in range(where.start, where.stop):
            value, slope = readable_value(name, float(solution.p[position]))
            names.append(name)
            values.append(value)
            slopes.append(one_each[position] * slope)
    for unit, unit_name in enumerate(unit_names):
        for position, name in enumerate(layout.unit_names, layout.unit(unit).start):
            value, slope = readable_value(name, float(solution.p[position]))
            names.append(f"{name}[{unit_name}]")
            values.append(value)
            slopes.append(one_each[position] * slope)
    by_p = np.array(slopes).reshape(-1, layout.size)
    return NamedParameters(names, np.array(values), by_p @ solution.covariance @ by_p.T, by_p)


def fitted_materials(solution: Solution, strength: np.ndarray) -> tuple[Microfacet, ...]:
    """Build the material of each table.

    strength: F from `strength_curves`, (units, slices).
    """
    problem = solution.problem
    return tuple(_material(solution, problem.data.units_of(table), strength) for table in range(problem.data.tables))


def _material(solution: Solution, units: list[int], strength: np.ndarray) -> Microfacet:
    problem, layout = solution.problem, solution.problem.layout
    diffuse: Any = 0.0
    if layout.diffuse:
        diffuse = np.clip(problem.of_units("diffuse", solution.p)[units], 0, 1)
    rows = [solution.p[layout.unit(u)] for u in units]
    term: Reflectance
    if layout.fresnel == "free":
        seen = np.isfinite(strength[units]).all(axis=0)
        term = Sampled(problem.theta_d[seen], np.maximum(strength[units][:, seen], 0.0).T)
    elif layout.fresnel == "conductor":
        term = Conductor(np.exp([r[0] for r in rows]), np.exp([r[1] for r in rows]))
    elif layout.fresnel == "schlick":
        term = Schlick(np.array([r[0] for r in rows]))
    else:
        term = Dielectric(1 + np.exp([r[0] for r in rows]))
    ndf = layout.kind.ndf(placed(solution.p[layout.lobe(layout.lobe_of[units[0]])]))
    return Microfacet(ndf, term, diffuse, layout.kind.masking)


def fitted_camera(solution: Solution, camera: Camera) -> Camera:
    problem: FitProblem = solution.problem
    axes, position = problem.prior.axes, problem.layout.rig
    lens = [n for n, axis in enumerate(axes) if axis.name not in (*WIDTHS, *CHANGES)]
    if not lens:
        return camera
    coordinates = solution.p[position]
    values = {axes[n].name: axes[n].value(float(coordinates[n])) for n in lens}
    covariance = solution.covariance[position, position][np.ix_(lens, lens)]
    slopes = [axes[n].slope(float(coordinates[n]), float(np.sqrt(covariance[m, m]))) for m, n in enumerate(lens)]
    covariance = covariance * np.outer(slopes, slopes)
    fitted = camera_with(camera, values)
    uncertainty = Uncertainty(values, (covariance + covariance.T) / 2)
    return Camera(fitted.optics, fitted.pixel, fitted.sensor, uncertainty=uncertainty, provenance=fitted.provenance)
