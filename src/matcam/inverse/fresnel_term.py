"""The Fresnel term of a measured material, with and without the camera: the paper's equation (13) and Figure 6."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError
from matcam.core.grid import CHANNEL_WAVELENGTHS, checked_table, merl_grid, sampling_of
from matcam.core.jax import jnp
from matcam.core.registry import FAMILIES
from matcam.core.remark import to_attribute
from matcam.core.workspace import Workspace
from matcam.forward.peaks.peak import peak_response
from matcam.inverse.correction.doubts import shape_correction
from matcam.inverse.fit.fit_setup import AUTO, SEARCH_EVERY, candidate_fits, free_setup, likeliest
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.lobe_operator import check_rig
from matcam.material.masking import MASKINGS, Masking, g2
from matcam.material.ndf.distribution import NDF
from matcam.material.optical_constants import metal as metal_index
from matcam.material.optical_constants import metals
from matcam.material.reflectance import fresnel_conductor
from matcam.rigs import Rig

SUPPORTED_STD = 0.05
"""Relative standard deviation beyond which an angle is no longer supported by the data."""

NORMALISE = (np.radians(10.0), np.radians(45.0))
"""theta_d over whose mean F is normalised. Below 10 degrees lamp and camera are in each other's way on real rigs; metals'
F is flat to 45."""

_BEND = 1.0
_QUIET = np.radians(np.arange(6, 60, 3))  # theta_d where lobes of real tables are complete


def fresnel(
    brdf: xr.DataArray,
    rig: Rig,
    ndf: str = AUTO,
    *,
    masking: Masking = "smith",
    noise: PixelNoise | None = None,
    normalise: tuple[float, float] = NORMALISE,
    every: int = 1,
    workspace: Workspace | None = None,
) -> xr.Dataset:
    """Extract the Fresnel term of a table, with and without its camera.

    F is free in every slice; one lobe and a Lambertian part are common to all. The camera's stated uncertainty is a prior that
    the data may improve on. So the fit is that of `fit(..., fresnel="free", diffuse=True)`. A lobe whose family does not
    explain the data is bent. `corrected` and `corrected_peak` may disagree by more than their errors. Then the lobe is not of
    this shape, or does not widen as this camera would make it.

    Args:
        brdf: table as from `read_merl`, 1/sr.
        rig: the rig that recorded it: a sphere, a distant camera and a distant lamp.
        ndf: family of the lobe. Default: "auto", the likelier of "ggx" and "epd", as the result is a curve and not parameters.
        masking: the G that (13) divides by: "smith", "smith-separable", "van-ginneken" or None. Default: "smith".
        noise: noise of a pixel. Default: None, estimated from the residuals.
        normalise: range of theta_d, rad, over which the mean of the corrected F is 1. Default: 10 to 45 degrees.
        every: spacing of the slices of theta_d that are used (no unit). Default: 1, all of them; more is quicker.
        workspace: keeps what depends on the rig alone for the next call. Default: None, the process's own.

    Returns:
        Dataset over (theta_d, channel), without unit but for angles:

        - `raw`, `raw_std`: F from the recorded peak alone, as if the camera were perfect.
        - `corrected_peak`: the paper's estimate, raw over the loss at the peak, relative to theta_d = 0.
        - `corrected`, `corrected_std`: F from the lobe fitted through the camera. The error has a part of pixel noise
          (`corrected_std_noise`) and one of the camera's stated uncertainty (`corrected_std_camera`).
        - `absolute`, `absolute_std`: the same, not normalised; NaN where the lobe is too narrow for its strength to be known.
        - `response`: recorded / true peak. `masking`: G in the mirror direction.
        - `supported_angle`: last theta_d, rad, up to which corrected_std stays under 5 % of corrected.
        - `width`, `width_std`: width of the lobe, as its NDF defines it; of a bent lobe, that of its family.
        - `hwhm`, `hwhm_std`: half width of the lobe at half its maximum, rad, whatever its shape.

        `corrected` and `corrected_peak` have mean 1 over the range. `raw` is corrected_peak times the relative loss.
        The attribute `remarks` has a line for each remark, "code: text" (`matcam.core.remark.from_attribute`).

    Raises:
        ArgumentError: an argument is wrong, or the rig is not one that a fit can follow.
        FitError: the table has no highlight, or nothing to normalise by.

    Source:
        The paper's equation (13) and Figure 6; docs/model.md sections 5 and 8.

    Example:
        >>> table = matcam.read_merl("chrome.binary")  # doctest: +SKIP
        >>> found = matcam.fresnel(table, matcam.rigs.merl())  # doctest: +SKIP
        >>> found["corrected"].sel(theta_d=np.radians(75), method="nearest")  # doctest: +SKIP
        >>> matcam.fresnel(np.ones(3), matcam.rigs.merl())
        Traceback (most recent call last):
        ...
        matcam.core.errors.ArgumentError: a BRDF table must be an xarray.DataArray (see read_merl), got ndarray
    """
    brdf = checked_table(brdf)
    _check(rig, ndf, normalise)
    checks.choice("masking", masking, MASKINGS)
    _check_highlight(brdf)
    setup = free_setup([brdf], rig, masking=masking, noise=noise, every=max(every, SEARCH_EVERY), workspace=workspace)
    fits = candidate_fits(setup, ndf)
    found = likeliest(fits)
    setup = setup.with_(ndf=found.family)
    shape = shape_correction(found, noise)
    if shape.family_fails:
        setup = setup.with_(bend=_BEND)
        found = setup.solve(start=found)
    if every < SEARCH_EVERY:
        found = setup.with_(every=every).solve(start=found)
    remarks = (*found.remarks, *([shape.remark(found.family)] if found.is_bent else []))
    lobe, theta_d = found.ndf, found.theta_d
    term = _FresnelTerm(found, normalise)
    hidden = _mirror_masking(lobe, theta_d, masking)
    *response, centre = np.asarray(peak_response(rig, lobe, np.append(theta_d, 0.0), exact=True, masking=masking))
    per_peak = 4 * np.cos(theta_d) ** 2 / (float(lobe.d(0.0)) * hidden)
    raw = recorded_peak(brdf, theta_d) * per_peak
    corrected_peak = raw / (np.array(response) / centre)
    scale = np.nanmean(np.where(term.used, corrected_peak, np.nan), axis=-1, keepdims=True)
    raw, corrected_peak = raw / scale, corrected_peak / scale
    width = next(iter(found.params))

    def curve(values: np.ndarray, text: str) -> tuple[Any, ...]:
        return ("theta_d", "channel"), values.T, {"long_name": text}

    return xr.Dataset(
        {
            "raw": curve(raw, "F from the recorded peak"),
            "raw_std": curve(raw * np.hypot(*found.noise[:2]), "standard deviation of raw (noise)"),
            "corrected_peak": curve(corrected_peak, "F from the recorded peak alone, over the relative loss"),
            "corrected": curve(term.normalised, "F corrected for the camera"),
            "corrected_std": curve(np.hypot(term.std_noise, term.std_camera), "standard deviation of corrected"),
            "corrected_std_noise": curve(term.std_noise, "its part from pixel noise"),
            "corrected_std_camera": curve(term.std_camera, "its part from the camera's uncertainty"),
            "absolute": curve(term.absolute, "F corrected, not normalised"),
            "absolute_std": curve(term.absolute_std, "standard deviation of absolute"),
            "response": ("theta_d", response, {"long_name": "recorded / true peak"}),
            "masking": ("theta_d", hidden, {"long_name": "G in the mirror direction"}),
            "supported_angle": ("channel", _supported_angle(term, theta_d), {"units": "rad"}),
            "width": ((), found.params[width], {"long_name": f"width of the {found.family} lobe ({width})"}),
            "width_std": ((), found.std[width] if found.resolved else np.inf, {"long_name": "its standard deviation"}),
            "hwhm": ((), found.hwhm, {"units": "rad", "long_name": "half width of the lobe at half its maximum"}),
            "hwhm_std": ((), found.hwhm_std, {"units": "rad", "long_name": "its standard deviation"}),
        },
        coords={
            "theta_d": ("theta_d", theta_d, {"units": "rad", "long_name": "difference angle"}),
            "channel": brdf.coords["channel"] if "channel" in brdf.coords else np.arange(brdf.sizes["channel"]),
        },
        attrs={
            "ndf": found.family,
            "log_likelihood": ", ".join(f"{one.family} {one.log_likelihood:.1f}" for one in fits),
            "masking": masking or "none",
            "normalised_over": [float(a) for a in normalise],
            "noise_relative": found.noise.relative,
            "noise_floor": found.noise.floor,
            "noise": "given" if noise else "estimated from the residuals",
            "camera_uncertainty": "stated" if rig.camera.uncertainty else "none stated: taken as exact",
            "width_determined": int(found.resolved),
            "bent": int(found.is_bent),
            "sampling": brdf.attrs["sampling"],
            "source": str(brdf.attrs.get("source", "")),
            "remarks": to_attribute(remarks),
        },
    )


def tabulated_fresnel(
    result: xr.Dataset, metal: str | None = None, wavelengths: Sequence[float] = CHANNEL_WAVELENGTHS
) -> xr.Dataset:
    """Return the Fresnel curves of all tables of a metal.

    Args:
        result: Dataset as from `fresnel`.
        metal: name of the metal, as in `metals`. Default: None, all metals.
        wavelengths: wavelength of each channel, m (channels,). Default: those of R, G and B. Give others for other channels.

    Returns:
        Dataset over (table, theta_d, channel), without unit:

        - `tabulated`: F of the table's n and k, normalised over the same range of theta_d as `result`.
        - `tabulated_f0`: F at normal incidence, (table, channel).
        - `rms_corrected`, `rms_raw`: rms over theta_d of (result / tabulated - 1), (table, channel), from the start of the
          normalisation to the supported angle; NaN where nothing is supported.

    Raises:
        ArgumentError: there is no such metal, or not one wavelength for each channel.

    Source:
        `metals` lists the tables.

    Example:
        >>> import xarray as xr
        >>> theta_d = np.radians(np.arange(5.0, 80.0, 10.0))
        >>> curve = (("theta_d", "channel"), np.ones((8, 1)))
        >>> found = xr.Dataset(
        ...     {"raw": curve, "corrected": curve, "supported_angle": ("channel", [1.3])},
        ...     coords={"theta_d": theta_d, "channel": ["G"]},
        ...     attrs={"normalised_over": [0.17, 0.79]},
        ... )
        >>> matcam.inverse.tabulated_fresnel(found, "Cr", [550e-9])["tabulated_f0"].values.round(2).ravel()
        array([0.55, 0.65, 0.68])
    """
    channels = result.sizes["channel"]
    if len(wavelengths) != channels:
        raise ArgumentError(f"wavelengths must be {channels}, one per channel of the result, got {len(wavelengths)}")
    theta_d = result["theta_d"].values
    low, high = result.attrs["normalised_over"]
    inside = (theta_d >= low) & (theta_d <= high)
    judged = (theta_d[:, None] >= low) & (theta_d[:, None] <= result["supported_angle"].values)
    tables = [(name, source) for name, sources in metals(metal).items() for source in sources]
    indices = [metal_index(name, wavelengths, source) for name, source in tables]
    n, k = (np.stack([getattr(index, part) for index in indices])[:, None, :] for part in ("n", "k"))
    *curves, f0 = np.asarray(fresnel_conductor(np.append(theta_d, 0.0)[:, None], n, k)).transpose(1, 0, 2)
    normalised = np.stack(curves, axis=1)
    normalised /= normalised[:, inside].mean(axis=1, keepdims=True)

    def rms(name: str) -> np.ndarray:
        squared = (result[name].values / normalised - 1) ** 2
        used = judged & np.isfinite(squared)
        count = used.sum(axis=1)
        return np.sqrt(np.where(count > 0, np.where(used, squared, 0).sum(axis=1) / np.maximum(count, 1), np.nan))

    return xr.Dataset(
        {
            "tabulated": (("table", "theta_d", "channel"), normalised),
            "tabulated_f0": (("table", "channel"), f0),
            "rms_corrected": (("table", "channel"), rms("corrected")),
            "rms_raw": (("table", "channel"), rms("raw")),
        },
        coords={
            "table": [f"{name} ({source})" for name, source in tables],
            "theta_d": result["theta_d"],
            "channel": result["channel"],
        },
        attrs={"wavelengths_m": list(wavelengths)},
    )


class _FresnelTerm:
    """Hold the strengths of a fit with their errors, over their mean. Arrays of shape (channels, slices)."""

    def __init__(self, found: MaterialFit, normalise: tuple[float, float]):
        theta_d, strengths = found.theta_d, found.strengths()
        strength = strengths.value
        used = (theta_d >= normalise[0]) & (theta_d <= normalise[1]) & np.isfinite(strength)
        if not used.any(-1).all():
            low, high = np.degrees(normalise)
            raise FitError(
                f"no theta_d between {low:g} and {high:g} degrees shows a highlight in every channel: cannot normalise"
            )
        self.used = used
        count = used.sum(-1, keepdims=True)
        mean = np.where(used, strength, 0).sum(-1, keepdims=True) / count
        self.normalised = strength / mean

        there = np.isfinite(strength)
        divisor = np.where(there, strength, np.inf)
        relative = [c / divisor[:, :, None] / divisor[:, None, :] for c in strengths[1:]]

        # normalising subtracts the mean's own change
        share = np.where(used, strength, 0) / (count * mean)
        off_mean = np.eye(theta_d.size) - share[:, None, :]
        self.std_noise, self.std_camera = (
            self.normalised * np.sqrt(np.clip(np.einsum("cst,ctu,csu->cs", off_mean, c, off_mean), 0, None))
            for c in relative
        )
        std = np.sqrt(np.einsum("uss->us", strengths.noise_covariance + strengths.rig_covariance))
        resolved = there & found.resolved
        self.absolute = np.where(resolved, strength, np.nan)
        self.absolute_std = np.where(resolved, std, np.nan)


def _mirror_masking(ndf: NDF, theta_d: np.ndarray, masking: Masking) -> np.ndarray:
    """Return G where light and view mirror each other."""
    if masking is None:
        return np.ones_like(theta_d)
    hidden = ndf.smith_lambda(jnp.cos(jnp.asarray(theta_d)))
    return np.asarray(g2(masking, hidden, hidden, jnp.asarray(jnp.pi)))


def recorded_peak(brdf: xr.DataArray, theta_d: np.ndarray) -> np.ndarray:
    """Return the mean of the cells nearest to the highlight in the slices at theta_d, (channels, slices).

    NaN where they are missing or not positive.
    """
    ring = brdf.values[merl_grid(sampling_of(brdf)).index(theta_h=0.0, theta_d=theta_d)]
    count = np.isfinite(ring).sum(axis=1)
    peak = np.where(count > 0, np.nansum(ring, axis=1) / np.maximum(count, 1), np.nan).T
    return np.where(np.nan_to_num(peak) > 0, peak, np.nan)


def _check_highlight(brdf: xr.DataArray) -> None:
    """Raise FitError for a table that does not fall to half of its peak anywhere."""
    quiet = brdf.values[merl_grid(sampling_of(brdf)).index(theta_d=_QUIET)]
    there = np.isfinite(quiet)
    rings = np.where(there, quiet, 0).sum(axis=2) / np.maximum(there.sum(axis=2), 1)
    bright = there[0].any(axis=1) & (rings[0] > 0)
    if bright.sum() < 3:
        raise FitError("no highlight: the table's peak (theta_h = 0) is missing or not positive at most theta_d")
    seen = there.any(axis=2)[:, bright]
    fall = np.where(seen, rings[:, bright] / rings[0][bright], np.nan)
    typical = [np.nanmedian(row) for row in fall if np.isfinite(row).any()]
    if min(typical) >= 0.5:
        raise FitError("no highlight: the table does not fall to half of its peak value anywhere")


def _supported_angle(term: _FresnelTerm, theta_d: np.ndarray) -> np.ndarray:
    """Return the last theta_d up to which the standard deviation stays under 5 %, counted outwards from the normalisation."""
    relative = np.hypot(term.std_noise, term.std_camera) / term.normalised
    fine = relative < SUPPORTED_STD  # False where NaN
    result = np.zeros(len(fine))
    for c, row in enumerate(fine):
        start = np.flatnonzero(row)
        if start.size:
            stop = np.flatnonzero(~row[start[0] :])
            result[c] = theta_d[start[0] + stop[0] - 1] if stop.size else theta_d[-1]
    return result


def _check(rig: Rig, ndf: str, normalise: tuple[float, float]) -> None:
    check_rig(rig)
    checks.choice("ndf", ndf, (AUTO, *FAMILIES))
    low, high = normalise
    if not 0 <= low < high < np.pi / 2:
        raise ArgumentError(f"normalise must be (low, high) with 0 <= low < high < pi/2 rad, got ({low:g}, {high:g})")
