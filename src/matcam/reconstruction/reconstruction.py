"""Result of `reconstruct`: the material from photographs, with its error budget."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from matcam.camera.profile import field_document
from matcam.core.errors import ArgumentError
from matcam.core.remark import Remark
from matcam.core.results.summary import Quantity, Summarised, Summary, with_std
from matcam.files.capture_settings import Stated
from matcam.numerics.budget import UncertaintyBudget
from matcam.reconstruction.alternatives import TriedExplanation, chosen_fit
from matcam.reconstruction.cylinder.anisotropic_table import anisotropic_table
from matcam.reconstruction.error_budget import (
    FitReading,
    Inseparable,
    Ratio,
    error_budget,
    inseparable,
    length_readings,
    parameter_readings,
    ratio_reading,
    reading_budget,
    reflectance_readings,
)
from matcam.reconstruction.joint.field_change import found_field
from matcam.reconstruction.material_table import material_table
from matcam.reconstruction.picture_model import SCENE
from matcam.reconstruction.pinhole_reading import pinhole_reading
from matcam.reconstruction.reflectance_curve import ReflectanceCurve, reflectance_curve
from matcam.reconstruction.rig.earlier_rig import rig_covariance
from matcam.reconstruction.rig.rig_document import FORMAT, SCENE_NAMES, VERSION
from matcam.reconstruction.sphere_fit import SphereFit
from matcam.reconstruction.stated.captured_scene import INCOMPLETE, CapturedScene

_JUDGED = np.radians(75.0)
"""Angle theta_d at which the error budget is given, rad. If the images do not cover it, their largest angle is used."""
_POOR = 0.03
"""Unexplained share of the light above which the verdict warns."""


@dataclass(frozen=True, repr=False)
class Reconstruction(Summarised):
    """Material from photographs, with its accuracy.

    Attributes:
        table: Dataset with `brdf` and `brdf_std`, 1/sr, and the mask `supported`, over the MERL grid; for an anisotropic
            material, over theta_h, phi_h, theta_d and phi_d.
        pinhole: BRDF from binning the pixels of the same images as if the camera were perfect, 1/sr; None: not computed.
        fit: joint fit of all images.
        curves: Fresnel term F of each channel as a function of the difference angle theta_d.
        units: unit of each channel, which is the image value per radiance under unit irradiance, with its relative
            standard deviation. Without a reference, the standard deviation is NaN, and F is relative.
        budget: standard deviations by source of uncertainty and result.
        not_determined: parameters that the images alone do not distinguish.
        tried: explanations that were fitted, with their probabilities.
        remarks: remarks on the result.
        captured: data of the capture before the fit.
        sample: kind of the sample, "sphere" or "cylinder".

    Source:
        docs/model.md 10.

    Example:
        >>> found = matcam.reconstruct("shots/")  # doctest: +SKIP
        >>> found.parameters["alpha"]  # doctest: +SKIP
        (0.0200, 0.0001)
        >>> found.ratio(np.radians(75)).value  # doctest: +SKIP
        1.12
    """

    table: xr.Dataset
    pinhole: xr.DataArray | None
    fit: SphereFit
    curves: tuple[ReflectanceCurve, ...]
    units: tuple[Stated, ...]
    budget: dict[str, dict[str, float]]
    not_determined: tuple[Inseparable, ...]
    tried: tuple[TriedExplanation, ...]
    remarks: tuple[Remark, ...]
    captured: CapturedScene
    sample: str

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of each parameter, by name.

        The parameters describe lobe, lens, Fresnel term (refractive index n + i k) and diffuse part. A spline-modified lobe
        is described by a half width, a tail exponent and a haze share.
        """
        covariance = self.fit.solution.covariance
        found = parameter_readings(self.fit, self.curves, self.units)
        return {name: (one.value, one.std(covariance)) for name, one in found.items()}

    def uncertainty_budget(self, name: str) -> UncertaintyBudget:
        """Compute the uncertainty budget of a result.

        The budget follows the Guide to the expression of uncertainty in measurement (GUM, JCGM 100:2008). The combined
        uncertainty is the standard deviation of the result. The sources are the pixels and the specified values of lens,
        lamps, distances, outline, gains and reference. The variances of the sources add up. In contrast, the attribute
        `budget` contains the decrease of the uncertainty that an exact source would cause.

        Args:
            name: name of the result, one of the names of `uncertainty_budgets()`.

        Raises:
            ArgumentError: there is no result of this name.

        Example:
            >>> found.uncertainty_budget("alpha").expanded  # doctest: +SKIP
        """
        known = self._readings
        if name not in known:
            raise ArgumentError(f"the reconstruction has no result {name!r}: give one of {', '.join(known)}")
        return reading_budget(self.fit, name, known[name])

    def uncertainty_budgets(self) -> list[UncertaintyBudget]:
        """Compute the uncertainty budgets of parameters, Fresnel term and lengths."""
        return [reading_budget(self.fit, name, one) for name, one in self._readings.items()]

    @property
    def _readings(self) -> dict[str, FitReading]:
        judged = min(_JUDGED, self.measured_range[1])
        return {
            **parameter_readings(self.fit, self.curves, self.units),
            **reflectance_readings(self.fit, self.curves, self.units, judged),
            **length_readings(self.fit),
        }

    @property
    def _sample_radius(self) -> float | None:
        """Fitted radius of the sample, mm; None if it was not specified."""
        stated, at = self.captured.sample_radius, self.fit.layout.sample_radius
        return None if stated is None else stated.value * float(np.exp(self.fit.solution.p[at]))

    @property
    def geometry(self) -> dict[str, Any]:
        """Outline, lamps and distances with their standard deviations."""
        fit, solution, layout = self.fit, self.fit.solution, self.fit.layout
        p, covariance = solution.p, solution.covariance
        std = np.sqrt(np.maximum(np.diag(covariance), 0))
        centres = np.array([p[layout.centre(k)] for k in range(layout.pictures)])
        spread = np.array([std[layout.centre(k)] for k in range(layout.pictures)])
        scene = dict(zip(SCENE, zip(p[layout.scene], std[layout.scene], strict=True), strict=True))

        def distance(name: str) -> list[float | None]:
            value, one = scene[name]
            return [1 / value, one / value**2] if value > 0 else [None, None]

        sigma, field = fit.scene.sigma, fit.scene.camera.field
        rig = rig_covariance(covariance, layout, solution.problem.frames, fit.lamps)
        turns = [f"{name} {turn}" for name in fit.names for turn in "ab"]
        captured = self.captured
        return {
            "frame_px": None if captured.frame is None else list(captured.frame),
            "sample_radius_mm": self._sample_radius,
            "centre_px": [centres.mean(axis=0).tolist(), spread.mean(axis=0).tolist()],
            "radius_px": [float(x) for x in scene["radius"]],
            "lamps": [
                {
                    "name": name,
                    "direction": direction.tolist(),
                    "std_deg": float(np.degrees(np.hypot(*std[layout.turn(k)]) / np.sqrt(2))),
                    "centre_px": centres[k].tolist(),
                    "gain": float(np.exp(p[layout.gain(k)])),
                }
                for k, (name, direction) in enumerate(zip(fit.names, fit.lamps, strict=True))
            ],
            "camera_radii": distance("camera"),
            "lamp_radii": distance("lamp"),
            "sigma_px": sigma * float(np.exp(scene["lens"][0])) if np.isfinite(sigma) else None,
            "field": None if field is None else field_document(found_field(field, p[layout.field], std[layout.field])),
            "covariance": {"names": [*SCENE_NAMES, *turns], "matrix": rig.tolist()},
        }

    @property
    def lengths(self) -> dict[str, tuple[float, float]]:
        """Values and standard deviations of outline and distances.

        The names contain the units: px, radii of the sample, and mm if the radius of the sample is specified. A distance
        that the images do not determine is infinite, and so is its standard deviation.
        """
        geometry = self.geometry
        (column, row), (column_std, row_std) = geometry["centre_px"]
        found = {
            "outline_column_px": (column, column_std),
            "outline_row_px": (row, row_std),
            "outline_radius_px": tuple(geometry["radius_px"]),
        }
        radius = geometry["sample_radius_mm"]
        for name in ("camera", "lamp"):
            value, std = geometry[f"{name}_radii"]
            pair = (np.inf, np.inf) if value is None else (value, std)
            found[f"{name}_distance_radii"] = pair
            if radius is not None:
                found[f"{name}_distance_mm"] = (pair[0] * radius, pair[1] * radius)
        return found

    @property
    def least_distances(self) -> dict[str, float]:
        """Lower limits of the distances, by the names of `lengths`.

        They correspond to two standard deviations of the inverse distance, and are infinite if it is exactly 0.
        """
        solution, radius, found = self.fit.solution, self._sample_radius, {}
        for name in ("camera", "lamp"):
            at = self.fit.layout.of(name)
            nearest = max(float(solution.p[at]), 0.0) + 2 * float(np.sqrt(solution.covariance[at, at]))
            found[f"{name}_distance_radii"] = least = 1 / nearest if nearest > 0 else np.inf
            if radius is not None:
                found[f"{name}_distance_mm"] = least * radius
        return found

    @property
    def length_quantities(self) -> list[Quantity]:
        """Outline and distances for a summary.

        If the standard deviation of a distance is at least half the distance, its lower limit is given.
        """
        least = self.least_distances
        return [
            Quantity(name, f"at least {least[name]:.3g}")
            if name in least and not std < value / 2
            else Quantity(name, value, std, relative=name not in ("outline_column_px", "outline_row_px"))
            for name, (value, std) in self.lengths.items()
        ]

    def ratio(self, theta_d: float, channel: int = 0) -> Ratio:
        """Compute F at an angle divided by the mean of F.

        The mean is over angles from 10° to 45°, within the range of the images. F is the Fresnel term.

        Args:
            theta_d: difference angle, rad.
            channel: index of the channel, no unit. Default: 0.
        """
        one = ratio_reading(self.fit, self.curves[channel], channel, theta_d)
        return Ratio(theta_d, one.value, one.std(self.fit.solution.covariance))

    @property
    def measured_range(self) -> tuple[float, float]:
        """Smallest and largest difference angle theta_d of the images, rad."""
        theta = self.fit.solution.theta_d
        return float(theta.min()), float(theta.max())

    @property
    def verdict(self) -> str:
        """Summary of the result in plain sentences."""
        widths = [np.degrees(pair) for name, pair in self.parameters.items() if name.startswith("hwhm")]
        half_width = " and ".join(
            f"{with_std(value, std) if 0 < std < np.inf else f'{value:.4g}'}°" for value, std in widths
        )
        low, high = np.degrees(self.measured_range)
        modified = "spline-modified " if self.fit.kind.spline_size else ""
        lobe = f"{modified}{self.fit.kind.family} lobe of half width {half_width}"
        words = [
            f"{len(self.fit.names)} images give a {lobe}, from theta_d {low:.0f}° to {high:.0f}°; "
            f"{self.supported_share:.0%} of the entries with a value are supported (known to 5 %)."
        ]
        if self.fit.stuck:
            words.append(
                "No lobe explains the images, and further rounds of the fit do not help: do not use these values."
            )
        if self.fit.solution.unexplained > _POOR:
            words.append(
                f"The model does not explain {self.fit.solution.unexplained:.0%} of the light, which increases every "
                "error: check the residual images."
            )
        if self.not_determined:
            pairs = ", nor ".join(one.text for one in self.not_determined)
            given = " and ".join(one.names[0] for one in self.not_determined)
            words.append(
                f"The images alone do not distinguish {pairs}: the result depends on the values given for {given}."
            )
        if not self.absolute:
            words.append(
                "F is relative, with a maximum of 1, because the capture has no reference of known reflectance."
            )
        return " ".join(words)

    @property
    def left_out(self) -> list[str]:
        """Names of the lamp positions that could not be used."""
        return [*self.captured.left_out, *(p.name for p in self.captured.pictures if p.name not in self.fit.names)]

    @property
    def absolute(self) -> bool:
        """True if F is absolute, because of a reference of known reflectance."""
        return all(np.isfinite(one.std) for one in self.units)

    @property
    def complete(self) -> bool:
        """True if every frame of the capture could be used."""
        return not any(remark.code in INCOMPLETE for remark in self.remarks)

    @property
    def supported_share(self) -> float:
        """Share of supported entries among those with a value, no unit."""
        return float(self.table["supported"].values[np.isfinite(self.table["brdf"].values)].mean())

    def _summary(self) -> Summary:
        return Summary(
            f"Material of a {self.sample}, reconstructed from {len(self.fit.names)} photographs",
            self.verdict,
            {
                "Parameters": [Quantity(name, *pair) for name, pair in self.parameters.items()],
                "Outline and distances": self.length_quantities,
            },
            self.remarks,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the JSON file, without the tables.

        Returns:
            The document described in docs/reconstruct.md.
        """
        fit, solution = self.fit, self.fit.solution
        units = np.array([one.value for one in self.units])
        strengths = fit.strengths / units
        std = fit.strengths_std / units
        return {
            "format": FORMAT,
            "version": VERSION,
            "verdict": self.verdict,
            "sample": self.sample,
            "lobe": {
                "family": fit.kind.family,
                "masking": fit.kind.masking,
                "spline_modified": fit.kind.spline_size > 0,
                "anisotropic": fit.kind.stretched,
            },
            "parameters": {name: list(pair) for name, pair in self.parameters.items()},
            "geometry": self.geometry,
            "fresnel": {
                "theta_d_deg": np.degrees(solution.theta_d).tolist(),
                "channels": list(fit.channels),
                "value": strengths.tolist(),
                "std": std.tolist(),
                "model": [curve.model for curve in self.curves],
                "absolute": self.absolute,
                "unit_std": [one.std for one in self.units] if self.absolute else None,
            },
            "budget": self.budget,
            "unexplained": solution.unexplained,
            "tried": {one.name: one.unexplained for one in self.tried},
            "probabilities": {one.name: one.probability for one in self.tried},
            "pictures": [
                {"name": name, "chi2": chi2, "left_out_px": out}
                for name, chi2, out in zip(fit.names, solution.chi2.tolist(), solution.left_out.tolist(), strict=True)
            ],
            "not_determined": [one.to_dict() for one in self.not_determined],
            "radiometry": self.captured.radiometry.to_dict(),
            "left_out": self.left_out,
            "remarks": [remark.to_dict() for remark in self.remarks],
        }


def reconstructed(
    captured: CapturedScene,
    family: str,
    fit_pictures: Callable[..., SphereFit],
    *,
    sample: str,
    diffuse: bool,
    progress: Callable[[str], None],
) -> Reconstruction:
    """Reconstruct a material from the data of a capture.

    Args:
        captured: merged images with approximate geometry, and prior knowledge of camera, outline, lamps and distances.
        family: family of the lobe, or "auto".
        fit_pictures: function that fits one explanation, with the interface of `fit_sphere`.
        sample: kind of the sample, "sphere" or "cylinder". For a sphere, the result includes the pinhole table of the fitted
            images.
        diffuse: True to include a Lambertian part.
        progress: function that is called with a line about each step.
    """
    fit, tried, remarks = chosen_fit(captured, family, fit_pictures, diffuse=diffuse, say=progress)
    units = fit.light.units
    theta, channels = fit.solution.theta_d, fit.layout.channels
    covariance = fit.strengths_covariance(fit.solution.fitted)
    curves = tuple(
        reflectance_curve(
            theta,
            fit.strengths[:, c],
            covariance[c::channels, c::channels],
            None if units is None else units[c],
        )
        for c in range(channels)
    )
    if units is None:
        # a scale that keeps F below 1 everywhere: F is relative, and a remark reports it
        low, high = theta.min(), theta.max()
        top = max(float(curve.at(np.linspace(low, high, 60)).max()) for curve in curves)
        units = (Stated(max(top, 1e-300), np.nan),) * channels
    middle = channels // 2
    judged = min(_JUDGED, float(theta.max()))
    every = [*captured.remarks, *remarks]
    pairs = inseparable(fit)
    every.extend(
        Remark(
            "not-determined",
            f"the images alone do not distinguish {one.text}: the result depends on the value given for the {one.names[0]}; "
            "check this value",
        )
        for one in pairs
    )
    if fit.solution.unexplained > _POOR:
        every.append(
            Remark(
                "unexplained",
                f"lobe, lens and geometry do not explain {fit.solution.unexplained:.1%} of the light, which increases "
                "every error: check the residual images",
            )
        )
    return Reconstruction(
        table=(anisotropic_table if fit.kind.stretched else material_table)(fit, curves, units),
        pinhole=pinhole_reading(captured.pictures, fit, units) if sample == "sphere" else None,
        fit=fit,
        curves=curves,
        units=units,
        budget=error_budget(fit, curves[middle], middle, judged, units[middle].std),
        not_determined=pairs,
        tried=tried,
        remarks=tuple(every),
        captured=captured,
        sample=sample,
    )
