"""Fresnel term of a measured material, with and without camera correction.

The source is equation (13) and Figure 6 of Holzschuch & Pacanowski (2017).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import ArgumentError, FitError
from matcam.core.grid import checked_table, merl_grid, sampling_of
from matcam.core.jax import jax, jnp, placed
from matcam.core.programs import kept_program
from matcam.core.registry import FAMILIES
from matcam.core.remark import to_attribute
from matcam.core.results.labelled import named
from matcam.core.threads import done_behind
from matcam.core.workspace import Workspace, default_workspace
from matcam.inverse.correction.explanation import explain, first_setup
from matcam.inverse.fit.fit_data import SEARCH_STEP
from matcam.inverse.fit.fit_setup import AUTO
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.normalised_fresnel import (
    NormalisedFresnel,
    averaged,
    budget_parts,
    budget_variables,
    nothing_to_normalise_by,
)
from matcam.inverse.operator.chosen_cells import peak_cells
from matcam.inverse.operator.lobe_operator import check_rig, operator_in, point_operator, rig_key
from matcam.inverse.operator.pixel_phase import located_rig
from matcam.inverse.operator.sample_view import sample_view
from matcam.inverse.peak_curve import NORMALISED_OVER, recorded_peak
from matcam.inverse.picture_gain import gain_remarks, picture_gain
from matcam.inverse.rig.rig_axes import known_lens
from matcam.inverse.saturated_values import without_saturated
from matcam.material.masking import MASKINGS, Masking, g2
from matcam.material.ndf.distribution import NDF
from matcam.numerics.budget import UncertaintyBudget
from matcam.numerics.fit_budget import parts_budget
from matcam.rigs import Rig

SUPPORTED_STD = 0.05
"""Relative standard deviation of F above which the data do not support F at an angle, as for `supported` in `correct`."""

_NEGLIGIBLE = 1e-3
"""Probability of the explanation without a camera below which its fit is not repeated in all slices. F would change by less
than 0.1 % of the difference between the two fits.
"""
_QUIET = np.radians(np.arange(6, 60, 3))  # theta_d at which the lobes of real tables are complete, rad
_NAMES = {
    "raw": "F from the recorded peak",
    "raw_std": "standard deviation of raw (noise)",
    "corrected_peak": "F from the recorded peak alone, divided by the relative response",
    "corrected": "F corrected for the camera",
    "corrected_std": "standard deviation of corrected",
    "corrected_std_noise": "part of corrected_std due to pixel noise",
    "corrected_std_camera": "part of corrected_std due to the uncertainty of the camera",
    "absolute": "F corrected for the camera, not normalised",
    "absolute_std": "standard deviation of absolute",
    "response": "recorded / true peak",
    "masking": "G in the mirror direction",
    "supported_angle": "largest difference angle up to which F is known to 5 % [rad]",
    "hwhm": "half width of the lobe at half its maximum [rad]",
    "hwhm_std": "standard deviation of hwhm [rad]",
}
"""Descriptive names and units of the variables of the results."""


def fresnel(
    brdf: xr.DataArray,
    rig: Rig,
    ndf: str = AUTO,
    *,
    masking: Masking = "smith",
    noise: PixelNoise | None = None,
    normalise: tuple[float, float] = NORMALISED_OVER,
    slice_step: int = 1,
    force_correction: bool = False,
    workspace: Workspace | None = None,
) -> xr.Dataset:
    """Estimate the Fresnel term of a table, with and without camera correction.

    The Fresnel term F is free in every slice; one lobe and a diffuse part are common to all slices. The uncertainty of the
    camera is a prior of the parameters of the camera. The shape of the lens is fitted, too. F is averaged over the same
    explanations as in `correct`. F is not corrected if `correct` withholds the correction of the table. If `corrected` and
    `corrected_peak` differ by more than their errors, the shape of the lobe differs from the fitted shape, or the blur
    of the table differs from that of the camera.

    Args:
        brdf: table, 1/sr, for example from `read_merl`.
        rig: rig that recorded the table, with a sphere or a cylinder; camera and lamp are distant or near.
        ndf: family of the lobe. Default: "auto", the mean over several explanations, weighted by their evidence. The
            explanations are the families "ggx" and "epd". If their residuals exceed the noise, Student's t, two lobes, a lobe
            over a rough base, and a spline-modified lobe are added.
        masking: model of the masking G: "smith", "smith-separable", "van-ginneken", or None for G = 1. Default: "smith".
        noise: noise of a pixel. Default: None, estimated from the residuals.
        normalise: range of theta_d, rad, over which the mean of the corrected F is 1. Default: 10 to 45 degrees.
        slice_step: spacing of the slices of theta_d that are used (no unit). Default: 1, all slices. A larger
            spacing is faster.
        force_correction: True to correct a table whose data contradict the rig. Default: False, F is not corrected.
        workspace: store of results that depend only on the rig. Default: None, the store of the process.

    Returns:
        Dataset over (theta_d, channel), without unit except for angles:

        - `raw`, `raw_std`: F from the recorded peak alone, as if the camera were perfect, and its standard deviation.
        - `corrected_peak`: estimate of Holzschuch & Pacanowski (2017): `raw` divided by the response at the peak relative to
            that at theta_d = 0.
        - `corrected`, `corrected_std`: F from the lobe fitted through the camera. The standard deviation has a part from
            pixel noise and image gain (`corrected_std_noise`), and a part from the camera, the rig and the other explanations
            (`corrected_std_camera`).
        - `absolute`, `absolute_std`: `corrected` without normalisation; NaN if the lobe is too narrow to
            determine its strength.
        - `response`: recorded / true peak, over theta_d, and over channel if each colour has its own lens; 1 if the
            correction is withheld.
        - `masking`: G in the mirror direction, over theta_d.
        - `supported_angle`: largest theta_d, rad, up to which corrected_std is below 5 % of corrected, over channel; 0 if there
            is none.
        - `width`, `width_std`: first parameter of the lobe, such as alpha; half width, rad, of a lobe without parameters of a
            family. `width_std` is infinite if the lobe is too narrow to be resolved.
        - `hwhm`, `hwhm_std`: half width at half maximum of the lobe, rad.
        - `budget_std`: part of corrected_std due to each source, over (source, theta_d, channel). The sum of the squares of
          the parts is the square of corrected_std. `budget_type`, `budget_value`, `budget_uncertainty` and `budget_degrees`
          are the type, value, standard uncertainty and degrees of freedom of each source (see `fresnel_budget`).

        `corrected` and `corrected_peak` have mean 1 over the range `normalise`. `raw` is `corrected_peak` times the
        relative response. The attribute `picture_gain` is the standard deviation of the image gain, estimated from the
        scatter of F between slices that exceeds the noise. The attribute `withheld` is 1 if rig and data contradict each
        other and `force_correction` is False; `corrected` is then F of a fit without a camera. The attribute `remarks` has
        a line for each remark, "code: text" (`matcam.core.remark.from_attribute`).

    Raises:
        ArgumentError: an argument is wrong, or a fit does not support the rig.
        FitError: the table has no highlight or not enough values, the cells contradict the rig, or a fit produced non-finite
            parameters.

    Source:
        Holzschuch & Pacanowski (2017), equation (13) and Figure 6; docs/model.md sections 5 and 8.

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
    checks.flag("force_correction", force_correction)
    given = brdf
    brdf, saturated = without_saturated(given, rig)
    located, workspace = located_rig(rig, brdf), workspace or default_workspace()
    _check_highlight(given, normalise)  # a saturated peak is a highlight, too
    setup = first_setup(
        brdf, located.rig, masking=masking, noise=noise, workspace=workspace, slice_step=max(slice_step, SEARCH_STEP)
    )
    setup.rule()  # computed alone, because the other fits use the programs that it compiles
    with done_behind(setup.with_(slice_step=slice_step).rule):
        explained = explain(setup, located, ndf)
    found = explained.setup.with_(slice_step=slice_step).solve(start=explained.fit)
    terms = [NormalisedFresnel(found, normalise)]
    held_back = explained.contradicts and not force_correction
    weight = 1.0 if held_back else explained.no_camera * (not force_correction)
    if explained.no_camera > _NEGLIGIBLE or held_back:
        blind = explained.blind_setup.with_(slice_step=slice_step).solve(start=explained.blind)
        terms.append(NormalisedFresnel(blind, normalise))
    members = [
        (
            NormalisedFresnel(other.setup.with_(slice_step=slice_step).solve(start=other.fit), normalise),
            other.probability,
        )
        for other in explained.others
    ]
    others = []
    for refit in explained.refits:
        if refit.contradicts and refit.counted:  # F is given only where `correct` supports it
            free = explained.setup.with_(slice_step=slice_step, also=(refit.axis.name,)).solve(start=refit.fit)
            others.append((refit.axis.name, NormalisedFresnel(free, normalise), refit.counted))
    lobe, theta_d = found.ndf, found.theta_d
    term = averaged(terms, members, others, weight, held_back=held_back)
    gain = picture_gain(theta_d, term.normalised, term.relative)
    term = term.with_gain(gain)
    remarks = (*explained.remarks, *saturated, *gain_remarks(gain))
    if explained.no_blur:
        remarks = (*remarks, explained.no_blur_remark)
    angles = np.append(theta_d, 0.0)
    colours = explained.located.rig.colours
    peaks = np.stack([_peak_responses(one, found, masking, angles, workspace) for one in colours])
    response, centre = np.split(np.ones_like(peaks) if held_back else peaks, [theta_d.size], axis=1)
    term = term.with_channel_misfit(explained.channel_misfit, response / centre)
    peak_terms = fresnel_of_peaks(brdf, theta_d, lobe, masking, response / centre, term.used)
    width = next(iter(found.params))

    def curve(values: np.ndarray) -> tuple[Any, ...]:
        return ("theta_d", "channel"), values.T

    result = xr.Dataset(
        {
            "raw": curve(peak_terms.raw),
            "raw_std": curve(peak_terms.raw * np.linalg.norm([*found.noise[:2], gain])),
            "corrected_peak": curve(peak_terms.corrected),
            "corrected": curve(term.normalised),
            "corrected_std": curve(np.hypot(term.std_noise, term.std_camera)),
            "corrected_std_noise": curve(term.std_noise),
            "corrected_std_camera": curve(term.std_camera),
            "absolute": curve(term.absolute),
            "absolute_std": curve(term.absolute_std),
            "response": curve(response) if len(colours) > 1 else ("theta_d", response[0]),
            "masking": ("theta_d", peak_terms.masking),
            "supported_angle": ("channel", _supported_angle(term, theta_d)),
            "width": ((), found.params[width]),
            "width_std": ((), found.std[width] if found.resolved else np.inf),
            "hwhm": ((), found.hwhm),
            "hwhm_std": ((), found.hwhm_std),
            **budget_variables(term),
        },
        coords={
            "theta_d": theta_d,
            "channel": brdf.coords["channel"] if "channel" in brdf.coords else np.arange(brdf.sizes["channel"]),
        },
        attrs={
            "ndf": found.family,
            "log_likelihood": ", ".join(f"{one.family} {one.log_likelihood:.1f}" for one in explained.candidates),
            "masking": masking or "none",
            "normalised_over": [float(a) for a in normalise],
            "noise_relative": found.noise.relative,
            "noise_floor": found.noise.floor,
            "noise": "given" if noise else "estimated from the residuals",
            "picture_gain": gain,
            "camera_uncertainty": known_lens(rig.camera).words,
            "withheld": int(held_back),
            "width_determined": int(found.resolved),
            "spline_modified": int(found.has_spline),
            "sampling": brdf.attrs["sampling"],
            "source": str(brdf.attrs.get("source", "")),
            "remarks": to_attribute(remarks),
        },
    )
    unit = " [rad]" if width.endswith("_rad") else ""
    width_names = {
        "width": f"{width}, width of the {found.lobe_name} lobe{unit}",
        "width_std": f"standard deviation of width{unit}",
    }
    return named(result, _NAMES | width_names)


class PeakFresnel(NamedTuple):
    """Fresnel term from the peaks of a table alone.

    Attributes:
        raw: F without correction for the camera, divided by the same factor as `corrected`, (channels, slices).
        corrected: F divided by the response at the peak relative to the response at theta_d = 0, (channels, slices). Its mean
            over the used slices is 1.
        masking: G in the mirror direction, (slices,).
    """

    raw: np.ndarray
    corrected: np.ndarray
    masking: np.ndarray


def fresnel_of_peaks(
    brdf: xr.DataArray, theta_d: np.ndarray, lobe: NDF, masking: Masking, response: np.ndarray, used: np.ndarray
) -> PeakFresnel:
    """Compute F from recorded peaks, without and with correction of the loss.

    Both are divided by the mean of the corrected F.

    Args:
        brdf: table, 1/sr.
        theta_d: difference angles of the slices, rad, (slices,).
        lobe: fitted lobe, from which masking and the largest value of D are computed.
        masking: model of the masking G.
        response: ratio of recorded to true peak, relative to that at theta_d = 0, (slices,) or (channels, slices).
        used: True for slices that contribute to the mean; it broadcasts to (channels, slices).
    """
    hidden, highest = (np.asarray(a) for a in _mirror_masking(lobe, placed(theta_d), masking))
    raw = recorded_peak(brdf, theta_d) * (4 * np.cos(theta_d) ** 2 / (highest * hidden))
    corrected = raw / response
    known = used & np.isfinite(corrected)
    count = known.sum(axis=-1, keepdims=True)
    scale = np.where(known, corrected, 0.0).sum(axis=-1, keepdims=True) / np.where(count > 0, count, np.nan)
    return PeakFresnel(raw / scale, corrected / scale, hidden)


def fresnel_budget(result: xr.Dataset, theta_d: float, channel: str | None = None) -> UncertaintyBudget:
    """Compute the uncertainty budget of the corrected F at an angle (GUM).

    The combined uncertainty of the budget is `corrected_std`. The sources are the values of the pixels, the image gains, the
    specified values of the camera and the rig, and the other explanations of the table.

    Args:
        result: Dataset from `fresnel`.
        theta_d: difference angle, rad. The nearest slice of the result is used.
        channel: name of the channel. Default: None, the middle channel.

    Raises:
        ArgumentError: `result` is not from `fresnel`, or has no such channel or no F at this angle, or the angle is out of
            its range.

    Example:
        >>> found = matcam.fresnel(table, matcam.rigs.merl())  # doctest: +SKIP
        >>> matcam.inverse.fresnel_budget(found, np.radians(75)).expanded  # doctest: +SKIP
        >>> matcam.inverse.fresnel_budget(np.ones(3), 0.5)
        Traceback (most recent call last):
        ...
        matcam.core.errors.ArgumentError: result must be a Dataset, got array([1., 1., 1.])
    """
    checks.instance("result", result, xr.Dataset)
    if "budget_std" not in result:
        raise ArgumentError(
            f"result must be a Dataset from matcam.fresnel with budget_std, got {list(result.data_vars)}"
        )
    names = [str(name) for name in result["channel"].values]
    channel = names[len(names) // 2] if channel is None else channel
    checks.choice("channel", channel, tuple(names))
    angle = float(checks.scalar("theta_d", checks.within("theta_d", theta_d, 0, np.pi / 2, "rad")))
    at = int(np.argmin(np.abs(result["theta_d"].values - angle))), names.index(channel)
    value, degrees = float(result["corrected"].values[at]), float(np.degrees(result["theta_d"].values[at[0]]))
    if not np.isfinite(value):
        raise ArgumentError(
            f"no F was determined at theta_d = {degrees:.1f} degrees in channel {channel}: choose an angle at which "
            "`corrected` is finite"
        )
    return parts_budget(f"F({degrees:.1f} deg), {channel}", value, budget_parts(result), at)


def _peak_responses(rig: Rig, found: MaterialFit, masking: Masking, angles: np.ndarray, store: Workspace) -> np.ndarray:
    """Compute the ratio of recorded to true peak for the fitted lens, (n,), at `angles`, values of theta_d, rad, (n,)."""
    cells, at = peak_cells(sample_view(rig), angles), found.coordinates
    recorded = operator_in(rig, cells, at.axes, repr(("peaks", rig_key(rig), at.axes, angles.tobytes())), store)
    recorded = recorded.leaning(found.log_slope(angles))
    through = recorded.record(found.ndf, masking, at.rig)[:, 0]
    return through / point_operator(cells).record(found.ndf, masking, ())[:, 0]


@kept_program
def _mirror_masking(ndf: NDF, theta_d: jax.Array, masking: Masking) -> tuple[jax.Array, jax.Array]:
    """Compute G in the mirror direction, and the largest value of D, 1/sr."""
    highest = ndf.d(0.0)
    if masking is None:
        return jnp.ones_like(theta_d), highest
    hidden = ndf.smith_lambda(jnp.cos(theta_d))
    return g2(masking, hidden, hidden, jnp.asarray(jnp.pi)), highest


def _check_highlight(brdf: xr.DataArray, normalise: tuple[float, float]) -> None:
    """Raise FitError for a table without a highlight, or without values in the range of normalisation."""
    quiet = brdf.values[merl_grid(sampling_of(brdf)).index(theta_d=_QUIET)]
    there = np.isfinite(quiet)
    rings = np.where(there, quiet, 0).sum(axis=2) / np.maximum(there.sum(axis=2), 1)
    bright = there[0].any(axis=1) & (rings[0] > 0)
    if bright.sum() < 3:
        raise FitError(
            "the table has no highlight: its peak (theta_h = 0) is missing or not positive at nearly all theta_d; "
            "give a table with a specular lobe"
        )
    seen = there.any(axis=2)[:, bright]
    fall = np.where(seen, rings[:, bright] / rings[0][bright], np.nan)
    typical = [np.nanmedian(row) for row in fall if np.isfinite(row).any()]
    if min(typical) >= 0.5:
        raise FitError(
            "the table has no highlight: the BRDF does not fall to half of its peak value; give a table with a specular lobe"
        )
    theta_d = merl_grid(sampling_of(brdf)).theta_d
    inside = (theta_d >= normalise[0]) & (theta_d <= normalise[1])
    if not np.isfinite(brdf.values[:, inside]).any(axis=(0, 1, 2)).all():
        raise nothing_to_normalise_by(normalise)


def _supported_angle(term: NormalisedFresnel, theta_d: np.ndarray) -> np.ndarray:
    """Find the largest theta_d, rad, up to which the relative standard deviation of F is below 5 %, (channels,).

    The search starts at the smallest theta_d with such a standard deviation. The result is 0 if there is none.
    """
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
    if np.shape(normalise) != (2,):
        raise ArgumentError(f"normalise must be two angles (low, high), rad, got shape {np.shape(normalise)}")
    low, high = normalise
    if not 0 <= low < high < np.pi / 2:
        hint = checks.degrees_hint(high, np.pi / 2)
        raise ArgumentError(
            f"normalise must be (low, high) with 0 <= low < high < pi/2 rad, got ({low:g}, {high:g}){hint}"
        )
