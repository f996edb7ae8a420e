"""Readings of a solved fit: strengths, parameters by name, materials, the camera, and remarks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from matcam.camera.camera import Camera
from matcam.camera.parameters import Uncertainty
from matcam.core.jax import jax, jnp, placed
from matcam.core.remark import Remark
from matcam.inverse.fit.base_lobe import base_and_slope
from matcam.inverse.fit.fit_parameters import BASE_WIDTH, LobeKind, readable_value, reflectance_at
from matcam.inverse.fit.fit_problem import FitProblem
from matcam.inverse.fit.lobe_readings import half_maximum_angle, lobe_readings
from matcam.inverse.fit.search import Solution
from matcam.inverse.operator.rig_axes import ASSUMED, CHANGES, WIDTHS, Axis, known_lens
from matcam.material.microfacet import Microfacet
from matcam.material.reflectance import Conductor, Dielectric, Reflectance, Sampled, Schlick

DETERMINED = 0.05
"""Relative standard deviation of a roughness below which it is determined."""
LINEAR = 0.15
"""Relative standard deviation of a power up to which the linearised errors are valid. Beyond it the correlation of
width and power is not linear, and the standard deviation of the width is too small.
"""

_BOUND = 0.05
"""ln of a width over the narrowest allowed width, below which the fit is at its bound."""
_UNSEEN = 2.0
"""Number of standard deviations of its square below which a width is compatible with 0."""


class FitCoordinates(NamedTuple):
    """First lobe and rig of a fit, in the coordinates in which the fit is linear.

    Attributes:
        kind: meaning of the coordinates of the lobe.
        lobe: (lobe coordinates,), logarithms of the parameters of the family, then spline coefficients.
        axes: fitted parameters of the rig.
        rig: (axes,), coordinates along the axes; 0 is the value of the rig.
        covariance: covariance of (lobe, rig).
    """

    kind: LobeKind
    lobe: np.ndarray
    axes: tuple[Axis, ...]
    rig: np.ndarray
    covariance: np.ndarray


class Strengths(NamedTuple):
    """Fitted F of every slice, free in each. Shapes: u units, s slices; NaN or 0 where nothing was recorded.

    Attributes:
        value: (u, s), F.
        noise_covariance: (u, s, s), covariance due to pixel noise, for an exact rig.
        rig_covariance: (u, s, s), covariance due to the uncertain parameters of the rig.
        slopes: (u, s, p), derivatives of F with respect to the coordinates of the fit.
    """

    value: np.ndarray
    noise_covariance: np.ndarray
    rig_covariance: np.ndarray
    slopes: np.ndarray


class LinearisedFit(NamedTuple):
    """Linear least-squares problem of a fit at its solution.

    Attributes:
        solution: data, operator, model and derivatives at the solution.
        coordinates: coordinates of the first lobe and the rig.
        residual: (u, s, n), data - model; 0 where unused.
        by_coordinates: (lobe and rig, u, s, n), derivatives of the model with respect to the coordinates.
        by_units: (unit parameters, u, s, n), derivatives with respect to the parameters of base and units.
        rig_information: (axes, axes), prior information on the rig.
    """

    solution: Solution
    coordinates: FitCoordinates
    residual: np.ndarray
    by_coordinates: np.ndarray
    by_units: np.ndarray
    rig_information: np.ndarray


def fit_coordinates(solution: Solution) -> FitCoordinates:
    """Return the first lobe and the rig."""
    layout, p = solution.problem.layout, solution.p
    both = np.r_[layout.lobe(0), layout.rig]
    covariance = solution.covariance[np.ix_(both, both)]
    return FitCoordinates(layout.kind, p[layout.lobe(0)], solution.problem.prior.axes, p[layout.rig], covariance)


def linearised_fit(solution: Solution) -> LinearisedFit:
    """Return the linear problem at a solution."""
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
    """Compute F of every slice and the two parts of its covariance."""
    own, slope = _strength_errors(solution)
    rig = solution.problem.layout.rig
    # part from the uncertainty of the rig, and covariance for an exact rig
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
    """Compute F of every unit and slice, and its standard deviation.

    The standard deviation includes the image gain if F is free.
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
    """Compute the derivatives of F of a unit at angles with respect to its coordinates, and their indices."""
    layout = solution.problem.layout
    first = layout.unit(unit).start
    inner = slice(first, first + layout.fresnel_size)

    def curve(c: jax.Array) -> jax.Array:
        return reflectance_at(layout.fresnel, c).at(jnp.asarray(theta))

    return np.asarray(jax.jacfwd(curve)(jnp.asarray(solution.p[inner]))), inner


def _strength_errors(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Compute the parts of the errors of free strengths; 0 where nothing was recorded.

    The first part is their standard deviation for exact other parameters, (units, slices). The second is minus their
    derivatives with respect to the parameters of the fit, (parameters, units, slices). The covariance of the strengths
    of a unit is diag(own^2) + slope' covariance slope.
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
    """Compute the light from below the lobe, 1/sr, and its standard deviation, (angles, units)."""
    layout, p = solution.problem.layout, solution.p
    angles = np.broadcast_arrays(theta_h, theta_d, phi_d)
    value, variance = np.zeros((2, *angles[0].shape, layout.units))
    parts = {"diffuse": np.full(angles[0].shape, 1 / np.pi)} if layout.diffuse else {}
    by_width = np.zeros(angles[0].shape)
    if layout.base:
        parts["base"], by_width = base_and_slope(p[layout.base_width][0], *angles)
    for u in range(layout.units):
        indices = [layout.of_units(name)[u] for name in parts]
        amounts = np.maximum(p[indices], 0.0)
        columns = list(parts.values())
        value[..., u] = sum((amount * column for amount, column in zip(amounts, columns, strict=True)), 0.0)
        if layout.base:
            indices, columns = [*indices, layout.base_width.start], [*columns, amounts[-1] * by_width]
        covariance = solution.covariance[np.ix_(indices, indices)]
        variance[..., u] = np.einsum("k...,kl,l...->...", columns, covariance, columns)
    return value, np.sqrt(np.maximum(variance, 0.0))


class LobeVerdict(NamedTuple):
    """Verdict on the lobes of a fit.

    Attributes:
        determined: True if every roughness, or the half width of a lobe without a family, is known to 5 %.
        resolved: True if the lobe is wider than the narrowest lobe that the camera distinguishes from a point.
    """

    determined: bool
    resolved: bool


def lobe_verdict(solution: Solution) -> LobeVerdict:
    """Check whether the lobes are determined and resolved."""
    layout, std = solution.problem.layout, np.sqrt(np.diag(solution.covariance))
    narrowest = layout.kind.bounds(solution.problem.radius)[0][0]
    resolved = bool(float(solution.p[0]) - narrowest > _BOUND)
    if not layout.kind.of_family:  # such a lobe is judged by its half width
        lobes = [layout.lobe(n) for n in range(layout.lobes)]
        angles = [half_maximum_angle(layout.kind, solution.p[at], solution.covariance[at, at]) for at in lobes]
        return LobeVerdict(resolved and all(error < DETERMINED * angle for angle, error in angles), resolved)
    first = [layout.lobe(n).start for n in range(layout.lobes)]
    own = len(layout.kind.family_names)
    linear = own == 1 or bool(np.all(std[[start + own - 1 for start in first]] < LINEAR))
    return LobeVerdict(linear and bool(np.all(std[first] < DETERMINED)) and resolved, resolved)


def fit_remarks(
    solution: Solution, camera: Camera | None, verdict: LobeVerdict, noise_given: bool
) -> tuple[Remark, ...]:
    """List the remarks on a fit."""
    remarks = []
    prior, position, noise = solution.problem.prior, solution.problem.layout.rig, solution.noise
    if camera is None:
        remarks.append(Remark("no-rig", "no rig: fitted as if the camera were perfect"))
    elif not prior.axes:
        remarks.append(Remark("camera-exact", "the camera is assumed to be exact"))
    elif solution.problem.prior.root.any() and known_lens(camera).assumed:
        text = (
            f"the profile has no uncertainty: the lens width is assumed to be known to {ASSUMED:.0%}; give its "
            "standard deviation, or 0 for an exact lens"
        )
        remarks.append(Remark("lens-assumed", text))
    stds = np.sqrt(np.diag(solution.covariance)[position])
    for axis, coordinate, own in zip(prior.axes, solution.p[position], stds, strict=True):
        square, std = axis.square(coordinate, own)
        if axis.softening and square < _UNSEEN * std:
            text = f"{axis.name} is compatible with 0: its square is {square:.2g} +- {std:.2g}"
            remarks.append(Remark("compatible-with-zero", text))
    if not verdict.resolved:
        remarks.append(
            Remark(
                "lobe-too-narrow",
                "the lobe is narrower than this camera can resolve or record: the width is a bound; "
                "check that rig and data belong together",
            )
        )
    elif not verdict.determined:
        text = "the roughness is not determined: its standard deviation exceeds 5 %"
        remarks.append(Remark("roughness-not-determined", text))
    if noise_given and solution.misfit > 1 + 5 * np.sqrt(2 / max(solution.freedom, 1)):
        text = f"the residuals are {np.sqrt(solution.misfit):.1f} times the given noise: the model does not explain the data"
        remarks.append(Remark("misfit", text))
    if not noise_given and max(noise.relative, 20 * noise.floor) > 0.05:
        text = (
            f"the residuals are {noise.relative:.0%} of a pixel's value and {noise.floor:.1%} of its image's peak, more than "
            "the noise of any camera: the camera or the family of the lobe is wrong"
        )
        remarks.append(Remark("misfit", text))
    return tuple(remarks)


class NamedParameters(NamedTuple):
    """Reported parameters of a fit.

    Attributes:
        names: "alpha", "n[G]", "optics.sigma_px", ...; of a spline-modified lobe, those of `lobe_readings` instead of
            coefficients.
        values: values in the units of the parameters.
        covariance: covariance of the values.
        slopes: derivatives of the values with respect to the coordinates, (names, coordinates).
    """

    names: list[str]
    values: np.ndarray
    covariance: np.ndarray
    slopes: np.ndarray


def named_parameters(solution: Solution) -> NamedParameters:
    """Return all parameters by name."""
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
    if layout.base:
        value, slope = readable_value(BASE_WIDTH, float(solution.p[layout.base_width][0]))
        names.append(BASE_WIDTH)
        values.append(value)
        slopes.append(one_each[layout.base_width.start] * slope)
    for unit, unit_name in enumerate(unit_names):
        for position, name in enumerate(layout.unit_names, layout.unit(unit).start):
            value, slope = readable_value(name, float(solution.p[position]))
            names.append(f"{name}[{unit_name}]")
            values.append(value)
            slopes.append(one_each[position] * slope)
    by_p = np.array(slopes).reshape(-1, layout.size)
    return NamedParameters(names, np.array(values), by_p @ solution.covariance @ by_p.T, by_p)


def fitted_materials(solution: Solution, strength: np.ndarray) -> tuple[Microfacet, ...]:
    """Build the material of each table. strength: (units, slices), as from `strength_curves`."""
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
    """Build the fitted camera, with its uncertainty after the fit."""
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
    fitted = camera.with_parameters(values)
    uncertainty = Uncertainty(values, (covariance + covariance.T) / 2)
    return Camera(fitted.optics, fitted.pixel, fitted.sensor, uncertainty=uncertainty, provenance=fitted.provenance)
