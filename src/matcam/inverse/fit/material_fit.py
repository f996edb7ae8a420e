"""Result of a fit: parameters with errors, the material, and the misfit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from matcam.camera.camera import Camera
from matcam.camera.sensor import PixelNoise
from matcam.core.errors import ArgumentError
from matcam.core.jax import jnp, placed
from matcam.core.remark import Remark
from matcam.core.results.labelled import named
from matcam.core.results.summary import Quantity, Summarised, Summary, correlations, half_width, parameters
from matcam.inverse.fit.body import Base, DiffusePart
from matcam.inverse.fit.fit_data import at_largest_noise, log_likelihood, standardised_residual
from matcam.inverse.fit.fit_parameters import reflectance_at
from matcam.inverse.fit.fit_readings import (
    FitCoordinates,
    LinearisedFit,
    Strengths,
    body_at,
    fit_coordinates,
    fit_remarks,
    fitted_camera,
    fitted_materials,
    fresnel_slope,
    linearised_fit,
    lobe_verdict,
    named_parameters,
    strength_curves,
    strengths_with_covariance,
)
from matcam.inverse.fit.fit_statements import fit_readings_source, fit_statements
from matcam.inverse.fit.lobe_readings import HALF_WIDTH, half_maximum, half_maximum_angle
from matcam.inverse.fit.search import Solution
from matcam.material.microfacet import Microfacet
from matcam.material.ndf.distribution import NDF
from matcam.numerics.budget import UncertaintyBudget
from matcam.numerics.fit_budget import posterior_budget


@dataclass(frozen=True, repr=False)
class MaterialFit(Summarised):
    """Fitted material with its errors.

    Attributes:
        family: family of the lobe ("ggx", "epd", "sgd", "beckmann", "gaussian"; in `correct` also "student-t" and
            "two-lobes").
        params: value of each parameter by name ("alpha", "n[G]", "optics.sigma_px", ...), in the unit of the parameter.
            A spline-modified lobe, Student's t and two lobes have "hwhm_rad", "tail_exponent" and "haze_share" instead
            of the parameters of a family.
        std: standard deviation of each parameter, by the same names and in the same units.
        covariance: covariance of all parameters, in the order of `params`, (parameters, parameters).
        hwhm: half width at half maximum of the first lobe, rad. It is well determined even if a width and a power are
            correlated.
        hwhm_std: standard deviation of `hwhm`, rad.
        determined: True if the first lobe is resolved, the first parameter of every lobe is known to 5 %, and the last of
            several parameters to 15 %. Without parameters of a family, the half width must be known to 5 %. Always False if
            `explained` is False.
        explained: True if the noise that was estimated from the residuals can be that of a camera, or if it was given. If it
            is False, the model does not explain the data.
        resolved: True if the first lobe is wider than the smallest width of a fit, which every camera records as a point.
        materials: fitted material of each table.
        camera: fitted camera, with its uncertainty after the fit; None without a rig.
        curves: Dataset over (theta_d, channel), no unit: the Fresnel term F, `fresnel`, and its standard deviation,
            `fresnel_std`.
        residual: Dataset over (channel, theta_d, cell) of the residuals, in standard deviations of the noise; NaN for unused
            cells. The Dataset also contains theta_h and phi_d of each cell, rad.
        noise: noise of a pixel, specified or estimated.
        misfit: weighted sum of squared standardised residuals per degree of freedom (no unit). It is about 1 if the model
            explains the data.
        log_likelihood: natural logarithm of the likelihood, for the comparison of families on the same data.
        freedom: degrees of freedom.
        remarks: remarks on the fit.
        noise_given: True if `noise` was specified; False if it was estimated from the residuals.
        _solution: solved problem, for use inside the package only.

    Example:
        >>> found = matcam.fit(table, matcam.rigs.merl(), "ggx")  # doctest: +SKIP
        >>> found.params["alpha"], found.std["alpha"]  # doctest: +SKIP
        >>> print(found.summary())  # doctest: +SKIP
        >>> axes = found.plot()  # doctest: +SKIP
        >>> list(matcam.inverse.MaterialFit.__dataclass_fields__)[:3]
        ['family', 'params', 'std']
    """

    family: str
    params: dict[str, float]
    std: dict[str, float]
    covariance: np.ndarray
    hwhm: float
    hwhm_std: float
    determined: bool
    explained: bool
    resolved: bool
    materials: tuple[Microfacet, ...]
    camera: Camera | None
    curves: xr.Dataset
    residual: xr.Dataset
    noise: PixelNoise
    misfit: float
    log_likelihood: float
    freedom: int
    remarks: tuple[Remark, ...]
    noise_given: bool
    _solution: Solution = field(repr=False)

    @property
    def material(self) -> Microfacet:
        """Material of the first table."""
        return self.materials[0]

    @property
    def ndf(self) -> NDF:
        """Fitted lobe of the first channel of the first table."""
        coordinates = self.coordinates
        return coordinates.kind.ndf(placed(coordinates.lobe))

    @property
    def theta_d(self) -> np.ndarray:
        """Difference angles of the fitted slices, rad, (slices,)."""
        return self._solution.problem.theta_d

    @property
    def diffuse(self) -> np.ndarray:
        """Albedo of the diffuse part of each channel, no unit, (channels,).

        The channels are those of all tables. The values are 0 if the fit has no diffuse part.
        """
        return self._solution.problem.of_units("diffuse", self._solution.p)

    @property
    def diffuse_part(self) -> DiffusePart:
        """Diffuse part of the body, with albedo 0 if there is none."""
        coated = self._solution.problem.layout.coated_share(self._solution.p)
        return DiffusePart(tuple(np.maximum(self.diffuse, 0.0).tolist()), coated)

    @property
    def base(self) -> Base | None:
        """Rough base under the lobe; None if the fit has none."""
        solution = self._solution
        layout = solution.problem.layout
        if not layout.base:
            return None
        reflectance = solution.problem.of_units("base", solution.p)
        return Base(float(np.exp(solution.p[layout.base_width][0])), tuple(np.maximum(reflectance, 0.0).tolist()))

    def body(self, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the BRDF of the body and its standard deviation.

        The body is the diffuse part, and the rough base under the lobe if the fit has one.

        Args:
            theta_h: angles between normal and half vector, rad; all angles broadcast to (...).
            theta_d: difference angles, rad.
            phi_d: azimuths of the difference vector, rad.

        Returns:
            (value, standard deviation), 1/sr, (..., channels) each.
        """
        return body_at(self._solution, theta_h, theta_d, phi_d)

    @property
    def has_spline(self) -> bool:
        """True if the lobe is spline-modified."""
        return bool(self.coordinates.kind.spline_size)

    @property
    def lobe_name(self) -> str:
        """Name of the family, with the prefix "spline-modified" if applicable."""
        return f"spline-modified {self.family}" if self.has_spline else self.family

    @property
    def coordinates(self) -> FitCoordinates:
        """Coordinates of the first lobe and the rig, with their covariance.

        The model is approximately linear in these coordinates.
        """
        return fit_coordinates(self._solution)

    def correlation(self, first: str, second: str) -> float:
        """Compute the correlation of two parameters.

        Args:
            first: name of a parameter, as in `params`.
            second: name of another parameter.

        Returns:
            The correlation, from -1 to 1.

        Raises:
            ArgumentError: the fit has no parameter of this name.
        """
        names = list(self.params)
        for name in (first, second):
            if name not in names:
                raise ArgumentError(f"the fit has no parameter {name!r}; give one of: {', '.join(names)}")
        i, j = names.index(first), names.index(second)
        return float(self.covariance[i, j] / np.sqrt(self.covariance[i, i] * self.covariance[j, j]))

    def uncertainty_budget(self, name: str) -> UncertaintyBudget:
        """Compute the uncertainty budget of a parameter (GUM).

        The combined uncertainty is the standard deviation of the parameter. The sources are the readings of the pixels, the
        specified values of the camera and the rig, and the priors of the lobe shape and of the coated share.

        Args:
            name: name of the parameter, as in `params`, or "hwhm_rad".

        Raises:
            ArgumentError: the fit has no parameter of this name.
        """
        return self.uncertainty_budgets(name)[0]

    def uncertainty_budgets(self, *names: str) -> list[UncertaintyBudget]:
        """Compute the uncertainty budgets of several parameters.

        Parameters with non-finite derivatives are omitted.

        Args:
            *names: names of parameters, as in `uncertainty_budget`. Default: all names in `params`, and "hwhm_rad".

        Raises:
            ArgumentError: a name is not the name of a parameter of the fit.
        """
        solution = self._solution
        named = named_parameters(solution)
        known = {n: (float(v), s) for n, v, s in zip(named.names, named.values, named.slopes, strict=True)}
        if HALF_WIDTH not in known:
            angle, by_lobe = half_maximum(self.coordinates.kind, self.coordinates.lobe)
            slope = np.zeros(solution.p.size)
            slope[solution.problem.layout.lobe(0)] = by_lobe
            known[HALF_WIDTH] = (angle, slope)
        wrong = [name for name in names if name not in known]
        if wrong:
            raise ArgumentError(f"the fit has no parameter {wrong[0]!r}; give one of: {', '.join(known)}")
        statements = fit_statements(solution)
        readings = fit_readings_source(self.freedom, noise_given=self.noise_given)
        return [
            posterior_budget(name, *known[name], solution.covariance, statements, readings)
            for name in (names or known)
            if np.isfinite(known[name][1]).all()
        ]

    def fresnel(self, theta: float, unit: int = 0) -> tuple[float, float]:
        """Compute F and its standard deviation at an angle.

        Args:
            theta: angle between light and half vector, rad.
            unit: index of the channel, counted over the channels of all tables. Default: 0, the first channel.

        Returns:
            (F, standard deviation), no unit. If F is free in every slice, both are interpolated between the slices.

        Example:
            >>> found.fresnel(np.radians(75.0))  # doctest: +SKIP
        """
        layout = self._solution.problem.layout
        if layout.fresnel == "free":
            x = self.theta_d
            f, std = self.curves["fresnel"].values[:, unit], self.curves["fresnel_std"].values[:, unit]
            there = np.isfinite(f)
            return float(np.interp(theta, x[there], f[there])), float(np.interp(theta, x[there], std[there]))
        slope, inner = fresnel_slope(self._solution, unit, theta)
        value = reflectance_at(layout.fresnel, jnp.asarray(self._solution.p[inner])).at(jnp.asarray(theta))
        return float(value), float(np.sqrt(slope @ self._solution.covariance[inner, inner] @ slope))

    def strengths(self) -> Strengths:
        """Compute the free strengths F of the slices and their covariance.

        F must be free in every slice of the fit. The strengths are not normalised.

        Returns:
            F of each channel and slice, and the two parts of its covariance, due to pixel noise and due to uncertain
            parameters of the rig.
        """
        return strengths_with_covariance(self._solution)

    def log_slope(self, theta_d: np.ndarray) -> np.ndarray:
        """Interpolate the derivative of ln F with respect to theta_d.

        Records in near rigs depend on this derivative.

        Args:
            theta_d: difference angles, rad, (n,).

        Returns:
            Mean of the derivatives of all channels, 1/rad, (n,), interpolated between the slices of the fit; 0 for a distant
            rig.
        """
        return np.interp(theta_d, self.theta_d, self._solution.model.log_slope.mean(axis=0))

    def squared_width(self, name: str) -> tuple[float, float]:
        """Compute the square of a fitted width of the rig.

        Blurs add in quadrature, so the error of the square remains finite at a width of 0.

        Args:
            name: name of the width, as in `params` ("optics.sigma_px", "lamp_radius", ...).

        Returns:
            (square, standard deviation of the square), in the squared unit of the width.

        Raises:
            ArgumentError: `name` is not a fitted parameter of the rig.

        Example:
            >>> found.squared_width("optics.sigma_px")  # doctest: +SKIP
        """
        at = self.coordinates
        names = [axis.name for axis in at.axes]
        if name not in names:
            raise ArgumentError(
                f"{name!r} is not a fitted parameter of the rig; the fitted parameters of the rig are: "
                f"{', '.join(names) or 'none'}"
            )
        position = names.index(name)
        own = len(at.lobe) + position
        return at.axes[position].square(float(at.rig[position]), float(np.sqrt(at.covariance[own, own])))

    def linearised(self) -> LinearisedFit:
        """Linearise the least-squares problem at the solution.

        The uncertainty of a correction is computed from this problem.

        Returns:
            Data, model, derivatives and prior at the solution.
        """
        return linearised_fit(self._solution)

    @property
    def _verdict(self) -> str:
        if not self.explained:
            return "The model does not explain the data: do not use the parameters and their errors."
        return f"The data {'determine' if self.determined else 'do not determine'} the roughness to 5 %."

    def _summary(self) -> Summary:
        width = [] if HALF_WIDTH in self.params else [half_width(self.hwhm, self.hwhm_std)]
        source = "given" if self.noise_given else "estimated from the residuals"
        bound = "at least " if not self.noise_given and at_largest_noise(self.noise) else ""
        noise = f"{bound}{self.noise.relative:.2g} of the value, {self.noise.floor:.2g} of the peak ({source})"
        return Summary(
            f"{self.lobe_name} lobe, fitted {'without a' if self.camera is None else 'through the'} camera",
            self._verdict,
            {
                "Parameters": [*parameters(self.params, self.std), *width],
                "Correlations": correlations(self.params, self.covariance),
                "Fit statistics": [
                    Quantity("noise of a pixel", noise),
                    Quantity("squared residual over expected variance, per degree of freedom", self.misfit),
                    Quantity("degrees of freedom", self.freedom),
                    Quantity("ln likelihood", self.log_likelihood),
                ],
            },
            self.remarks,
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert the parameters and statistics of the fit to JSON types.

        Returns:
            The dictionary that `matcam fit --json` prints. Angles are in rad.

        Example:
            >>> found.to_dict()["misfit"]  # doctest: +SKIP
        """
        scale = np.sqrt(np.diag(self.covariance))
        return {
            "ndf": self.family,
            "spline_modified": self.has_spline,
            "params": self.params,
            "std": self.std,
            "correlation": (self.covariance / np.outer(scale, scale)).tolist(),
            "hwhm_rad": self.hwhm,
            "hwhm_std_rad": self.hwhm_std,
            "determined": self.determined,
            "noise": self.noise._asdict(),
            "misfit": self.misfit,
            "log_likelihood": self.log_likelihood,
            "degrees_of_freedom": self.freedom,
            "remarks": [remark.to_dict() for remark in self.remarks],
        }


def material_fit(solution: Solution, camera: Camera | None, *, noise_given: bool) -> MaterialFit:
    """Build the result of a solved fit.

    Args:
        solution: solution of the fit.
        camera: camera of the rig; None without a rig.
        noise_given: True if the noise is specified.
    """
    problem, data = solution.problem, solution.problem.data
    readings = named_parameters(solution)
    std = np.sqrt(np.diag(readings.covariance))
    lobe = fit_coordinates(solution)
    own = slice(0, len(lobe.lobe))
    hwhm, hwhm_std = half_maximum_angle(lobe.kind, lobe.lobe, lobe.covariance[own, own])
    strength, strength_std = strength_curves(solution)
    labels = ("theta_d", "channel")
    coords: dict[str, Any] = {
        "theta_d": problem.theta_d,
        "channel": [label if data.tables == 1 else f"{label}{u}" for u, label in enumerate(data.labels)],
    }
    curves = named(
        xr.Dataset({"fresnel": (labels, strength.T), "fresnel_std": (labels, strength_std.T)}, coords=coords),
        {"fresnel": "F of the fitted lobe", "fresnel_std": "standard deviation of fresnel"},
    )
    value, noise = solution.model.value, solution.noise
    scaled = standardised_residual(data, value, noise, problem.gain(noise))
    residual = xr.Dataset(
        {"residual": (("channel", "theta_d", "cell"), np.where(data.used, scaled, np.nan))},
        coords={
            **coords,
            "theta_h": (("theta_d", "cell"), problem.cells.theta_h),
            "phi_d": (("theta_d", "cell"), problem.cells.phi_d),
        },
        attrs={"units": "standard deviations of the noise"},
    )
    named(residual, {"residual": "residual over the standard deviation of the noise"})
    verdict = lobe_verdict(solution, noise_given=noise_given)
    return MaterialFit(
        family=lobe.kind.family,
        params=dict(zip(readings.names, readings.values.tolist(), strict=True)),
        std=dict(zip(readings.names, std.tolist(), strict=True)),
        covariance=readings.covariance,
        hwhm=hwhm,
        hwhm_std=hwhm_std,
        determined=verdict.determined and verdict.explained,
        explained=verdict.explained,
        resolved=verdict.resolved,
        materials=fitted_materials(solution, strength),
        camera=fitted_camera(solution, camera) if camera else None,
        curves=curves,
        residual=residual,
        noise=noise,
        misfit=solution.misfit,
        log_likelihood=log_likelihood(data, value, noise, scaled**2),
        freedom=solution.freedom,
        remarks=fit_remarks(solution, camera, verdict, noise_given),
        noise_given=noise_given,
        _solution=solution,
    )
