"""Fresnel term divided by its mean, with uncertainties and their sources, averaged over the explanations of a table."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from matcam.core.errors import FitError
from matcam.inverse.fit.fit_statements import fit_readings_source, fit_statements
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.numerics.fit_budget import VariancePart, statement_parts

GAIN = "gains of the images"
OTHER_LOBES = "other lobes that explain the table"
NO_CAMERA = "no camera, instead of the specified camera"
CHANNELS = "differences between the channels"


class NormalisedFresnel:
    """Fresnel term F of the slices of a fit, divided by its mean, with standard deviations.

    The arrays have shape (channels, slices), except `relative`, the covariance of ln F, (channels, slices, slices). `parts`
    contains the sources of the variance of the normalised term. The variances of the sources add up to the sum of the squares
    of `std_noise` and `std_camera`.
    """

    def __init__(self, found: MaterialFit, normalise: tuple[float, float]):
        theta_d, strengths = found.theta_d, found.strengths()
        strength = strengths.value
        used = (theta_d >= normalise[0]) & (theta_d <= normalise[1]) & np.isfinite(strength)
        if not used.any(-1).all():
            raise nothing_to_normalise_by(normalise)
        self.used = used
        count = used.sum(-1, keepdims=True)
        mean = np.where(used, strength, 0).sum(-1, keepdims=True) / count
        self.normalised = strength / mean

        there = np.isfinite(strength)
        divisor = np.where(there, strength, np.inf)
        noise, camera = (c / divisor[:, :, None] / divisor[:, None, :] for c in strengths[1:3])
        self.relative = noise + camera

        # normalisation subtracts the relative change of the mean from that of each strength
        share = np.where(used, strength, 0) / (count * mean)
        self._off_mean = np.eye(theta_d.size) - share[:, None, :]
        self.std_noise, self.std_camera = (self._normalised_std(c) for c in (noise, camera))
        divided = strengths.slopes / divisor[..., None]
        slopes = self.normalised[..., None] * np.einsum("cst,ctp->csp", self._off_mean, divided)
        self.parts = statement_parts(
            fit_statements(found._solution),
            np.nan_to_num(slopes),
            found._solution.covariance,
            self.std_noise**2 + self.std_camera**2,
            fit_readings_source(found.freedom, noise_given=found.noise_given),
        )
        std = np.sqrt(np.einsum("uss->us", strengths.noise_covariance + strengths.rig_covariance))
        resolved = there & found.resolved
        self.absolute = np.where(resolved, strength, np.nan)
        self.absolute_std = np.where(resolved, std, np.nan)

    def _normalised_std(self, covariance: np.ndarray) -> np.ndarray:
        """Compute the standard deviation of the normalised term, (channels, slices).

        covariance: covariance of ln F, (channels, slices, slices).
        """
        variance = np.einsum("cst,ctu,csu->cs", self._off_mean, covariance, self._off_mean)
        return self.normalised * np.sqrt(np.clip(variance, 0, None))

    def with_gain(self, gain: float) -> NormalisedFresnel:
        """Add the variance due to the image gain to the variance due to noise.

        gain: relative standard deviation of the image gain.
        """
        one = gain**2 * np.eye(self.normalised.shape[1])
        own = self._normalised_std(np.broadcast_to(one, self.relative.shape))
        self.std_noise = np.hypot(self.std_noise, own)
        self.parts = (*self.parts, VariancePart(GAIN, "A", own**2, degrees=max(self.used.shape[-1] - 1, 1)))
        self.absolute_std = np.hypot(self.absolute_std, gain * self.absolute)
        return self

    def with_channel_misfit(self, misfit: float, relative_response: np.ndarray) -> NormalisedFresnel:
        """Add the variance due to different lobes of the channels, as `with_channel_misfit` of a correction does.

        Args:
            misfit: difference between the lobes of the channels that noise does not explain, relative to the lobe (no unit).
            relative_response: ratio of recorded to true peak, relative to that at theta_d = 0, (channels or 1, slices).
        """
        relative = np.minimum(misfit, np.abs(np.log(np.maximum(relative_response, 1e-300))))
        self.std_camera = np.hypot(self.std_camera, relative * self.normalised)
        self.parts = (*self.parts, VariancePart(CHANNELS, "B", (relative * self.normalised) ** 2))
        self.absolute_std = np.hypot(self.absolute_std, misfit * self.absolute)
        return self


def averaged(
    terms: list[NormalisedFresnel],
    members: list[tuple[NormalisedFresnel, float]],
    others: list[tuple[str, NormalisedFresnel, float]],
    weight: float,
    *,
    held_back: bool,
) -> NormalisedFresnel:
    """Average F over the explanations of a table.

    Args:
        terms: F of the most probable lobe through the camera and, unless its probability is negligible, F of the fit without a
            camera.
        members: F of each other lobe, with the probability of this lobe.
        others: name of each refitted rig parameter, F of the refit, and a factor. The difference of this F from F of the most
            probable lobe, multiplied by the factor, is a standard deviation.
        weight: probability of the explanation without a camera.
        held_back: True if the correction is withheld. The result is then F of the fit without a camera.
    """
    camera, *blind = terms
    shift, spread, moved, scatter = (np.zeros_like(camera.normalised) for _ in range(4))
    for other, share in members:
        apart, aside = other.normalised - camera.normalised, np.nan_to_num(other.absolute - camera.absolute)
        shift, spread = shift + share * apart, spread + share * apart**2
        moved, scatter = moved + share * aside, scatter + share * aside**2
    camera.normalised, camera.absolute = camera.normalised + shift, camera.absolute + moved
    camera.std_camera = np.sqrt(camera.std_camera**2 + spread - shift**2)
    if members:
        camera.parts = (*camera.parts, VariancePart(OTHER_LOBES, "B", spread - shift**2))
    camera.absolute_std = np.sqrt(camera.absolute_std**2 + scatter - moved**2)
    result = blind[0] if held_back else camera
    variance = result.std_camera**2
    absolute = result.absolute_std**2
    for name, other, share in others:
        own = (share * (other.normalised - camera.normalised)) ** 2
        variance = variance + own
        result.parts = (*result.parts, VariancePart(f"{name} left free", "B", own))
        absolute = absolute + (share * np.nan_to_num(other.absolute - camera.absolute)) ** 2
    if blind:
        share = 1.0 if held_back else weight * (1 - weight)
        apart = blind[0].normalised - camera.normalised
        variance = variance + share * apart**2
        result.parts = (*result.parts, VariancePart(NO_CAMERA, "B", share * apart**2))
        absolute = absolute + share * np.nan_to_num(blind[0].absolute - camera.absolute) ** 2
        if not held_back:
            result.normalised = camera.normalised + weight * apart
    result.std_camera, result.absolute_std = np.sqrt(variance), np.sqrt(absolute)
    return result


def budget_variables(term: NormalisedFresnel) -> dict[str, tuple[Any, ...]]:
    parts = term.parts
    std = np.sqrt(np.stack([np.maximum(part.variance, 0.0) for part in parts]))
    own = [np.nan if part.uncertainty is None else part.uncertainty for part in parts]
    return {
        "source": ("source", [part.name for part in parts], {"long_name": "source of uncertainty"}),
        "budget_std": (
            ("source", "theta_d", "channel"),
            std.swapaxes(1, 2),
            {"long_name": "part of corrected_std due to the source", "units": "1"},
        ),
        "budget_type": ("source", [part.kind for part in parts], {"long_name": "type of evaluation (GUM)"}),
        "budget_value": (
            "source",
            [part.value for part in parts],
            {"long_name": "value, in the unit that the name of the source contains"},
        ),
        "budget_uncertainty": (
            "source",
            own,
            {
                "long_name": "standard uncertainty of the source, in the unit of its value; NaN: in the unit of the result"
            },
        ),
        "budget_degrees": (
            "source",
            [float(part.degrees) for part in parts],
            {"long_name": "degrees of freedom", "units": "1"},
        ),
    }


def budget_parts(result: xr.Dataset) -> list[VariancePart]:
    """Rebuild the sources of uncertainty from a Dataset with `budget_variables`."""
    return [
        VariancePart(
            str(one["source"].item()),
            "A" if one["budget_type"].item() == "A" else "B",
            one["budget_std"].values ** 2,
            float(one["budget_value"]),
            float(one["budget_uncertainty"]) if np.isfinite(one["budget_uncertainty"]) else None,
            float(one["budget_degrees"]),
        )
        for one in (result.isel(source=index) for index in range(result.sizes["source"]))
    ]


def nothing_to_normalise_by(normalise: tuple[float, float]) -> FitError:
    low, high = np.degrees(normalise)
    return FitError(
        f"at least one channel has no value of F at theta_d from {low:g} to {high:g} degrees; choose another range of theta_d "
        "for the normalisation (normalise)"
    )
