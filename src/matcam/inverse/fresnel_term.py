"""The Fresnel term of a measured material, with and without the camera: the paper's equation (13) and Figure 6."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from matcam import checks
from matcam._jax import jax, jnp
from matcam.camera.noise import PixelNoise
from matcam.errors import ArgumentError, FitError
from matcam.forward.peak import peak_response
from matcam.inverse.lobe_through_camera import LobeFit, fit_lobe
from matcam.inverse.peak_cells import peak_data
from matcam.material.families import ONE_WIDTH
from matcam.material.masking import MASKINGS, Masking, g2
from matcam.material.ndf import MixtureNDF
from matcam.rigs import Rig
from matcam.sample.sphere import Sphere
from matcam.table import checked_table

SUPPORTED_STD = 0.05
"""Relative standard deviation beyond which an angle is no longer supported by the data."""

NORMALISE = (np.radians(10.0), np.radians(45.0))
"""theta_d over whose mean F is normalised. Below 10 degrees lamp and camera are in each other's way on real rigs; metals'
F is flat to 45."""


_CANDIDATES = ("gaussian", "ggx")  # of "auto"; Beckmann's lobe is the Gaussian one wherever a camera matters


def fresnel(
    brdf: xr.DataArray,
    rig: Rig,
    *,
    ndf: str = "auto",
    masking: Masking = "smith",
    noise: PixelNoise | None = None,
    normalise: tuple[float, float] = NORMALISE,
) -> xr.Dataset:
    """Fresnel term F(theta_d) of a table, raw and corrected for the camera (paper (13); MODEL 5, 8).

    brdf: table as from `read_merl`, recorded by `rig` (a sphere). ndf: family of the lobe, "gaussian", "ggx", "beckmann", or
    "auto": the likelier of the first two. masking: the G that (13) divides by. noise: of a pixel; None: estimated from the
    residuals. normalise: range of theta_d, rad, over which the mean of the corrected F is 1.

    Returns a Dataset over (theta_d, channel), all dimensionless but for the angles:
      raw, raw_std                F from the recorded peak alone, as if the camera were perfect
      corrected_peak              the paper's estimate: raw over the loss at the peak, relative to theta_d = 0
      corrected, corrected_std    F from the lobe fitted through the camera; its std is that of pixel noise
                                  (corrected_std_noise) and of the camera's stated uncertainty (corrected_std_camera)
      absolute, absolute_std      the same, not normalised: needs D(0), that is the lobe's width; NaN where unknown
      response                    recorded / true peak; masking: G in the mirror direction
      supported_angle             last theta_d, rad, up to which corrected_std stays under 5 % of corrected
      width, width_std            of the lobe, as its NDF defines it, freed from the camera
    corrected and corrected_peak have mean 1 over the range; raw has not: it is corrected_peak times the loss relative to
    theta_d = 0. Where corrected and corrected_peak disagree by more than their errors, the lobe is not the shape, or does
    not widen with theta_d as, this camera would make it. Errors: ArgumentError for a wrong argument, FitError without a
    highlight.
    """
    brdf = checked_table(brdf)
    _check(rig, ndf, normalise)
    checks.choice("masking", masking, MASKINGS)
    data = peak_data(brdf, rig.sample)  # type: ignore[arg-type]
    fit = fit_lobe(data, rig, list(_CANDIDATES) if ndf == "auto" else [ndf], noise and noise.checked())
    theta_d = data.theta_d
    *response, centre = np.asarray(peak_response(rig, fit.ndf, np.append(theta_d, 0.0)))
    term = _FresnelTerm(fit, rig, theta_d, masking, normalise)
    peak = data.values[..., data.theta_h == data.theta_h[0]].mean(-1)
    peak = np.where((data.content[..., 0] > 0) & (peak > 0), peak, np.nan)
    noise_of_pixel = np.hypot(fit.noise.relative, fit.noise.floor)
    lossless = peak * term.per_amplitude / (response / centre)
    scale = np.nanmean(np.where(term.used, lossless, np.nan), axis=-1, keepdims=True)
    raw, corrected_peak = peak * term.per_amplitude / scale, lossless / scale
    labels = ("theta_d", "channel")

    def variable(values: np.ndarray, text: str) -> tuple[Any, ...]:
        return labels, values.T, {"long_name": text}

    return xr.Dataset(
        {
            "raw": variable(raw, "F from the recorded peak"),
            "raw_std": variable(raw * noise_of_pixel, "standard deviation of raw (noise)"),
            "corrected_peak": variable(corrected_peak, "F from the recorded peak alone, over the relative loss"),
            "corrected": variable(term.normalised, "F corrected for the camera"),
            "corrected_std": variable(np.hypot(term.std_noise, term.std_camera), "standard deviation of corrected"),
            "corrected_std_noise": variable(term.std_noise, "its part from pixel noise"),
            "corrected_std_camera": variable(term.std_camera, "its part from the camera's uncertainty"),
            "absolute": variable(term.absolute, "F corrected, not normalised"),
            "absolute_std": variable(term.absolute_std, "standard deviation of absolute"),
            "response": ("theta_d", response, {"long_name": "recorded / true peak"}),
            "masking": ("theta_d", term.masking, {"long_name": "G in the mirror direction"}),
            "supported_angle": ("channel", _supported(term, theta_d), {"units": "rad"}),
            "width": ((), fit.width, {"long_name": f"width of the {fit.ndf.family} lobe"}),
            "width_std": ((), term.width_std, {"long_name": "its standard deviation"}),
        },
        coords={
            "theta_d": ("theta_d", theta_d, {"units": "rad", "long_name": "difference angle"}),
            "channel": brdf.coords["channel"] if "channel" in brdf.coords else np.arange(brdf.sizes["channel"]),
        },
        attrs={
            "ndf": fit.ndf.family,
            "log_likelihood": ", ".join(f"{name} {value:.1f}" for name, value in fit.log_likelihoods.items()),
            "masking": masking or "none",
            "normalised_over": [float(a) for a in normalise],
            "noise_relative": fit.noise.relative,
            "noise_floor": fit.noise.floor,
            "noise": "given" if noise else "estimated from the residuals",
            "camera_uncertainty": "stated" if rig.camera.uncertainty else "none stated: taken as exact",
            "width_determined": int(fit.width_determined),
            "sampling": brdf.attrs["sampling"],
            "source": str(brdf.attrs.get("source", "")),
        },
    )


class _FresnelTerm:
    """F = A * 4 cos^2 theta_d / (D(0) G), and how its errors follow from the fit's."""

    def __init__(self, fit: LobeFit, rig: Rig, theta_d: np.ndarray, masking: Masking, normalise: tuple[float, float]):
        maps = _log_factor_and_slope(type(fit.ndf), np.log(fit.width), theta_d, masking)
        log_factor, by_width, self.masking = (np.asarray(a) for a in maps)
        self.per_amplitude = np.exp(log_factor)
        self.absolute = fit.amplitude * self.per_amplitude
        used = (theta_d >= normalise[0]) & (theta_d <= normalise[1]) & np.isfinite(self.absolute)
        if not used.any(-1).all():
            low, high = np.degrees(normalise)
            raise FitError(
                f"no theta_d between {low:g} and {high:g} degrees shows a highlight in every channel: cannot normalise"
            )
        self.used = used
        count = used.sum(-1, keepdims=True)
        self.mean = np.where(used, self.absolute, 0).sum(-1) / count[:, 0]
        self.normalised = self.absolute / self.mean[:, None]

        # covariance of ln F (channels, slices, slices); ln F = ln A + ln factor(width)
        amplitude = np.where(np.isfinite(fit.amplitude), fit.amplitude, np.inf)
        relative = fit.amplitude_covariance / amplitude[:, :, None] / amplitude[:, None, :]
        width_variance = fit.log_width_variance if fit.width_determined else 0.0
        with_width = fit.amplitude_width_covariance / amplitude
        coupled = with_width[:, :, None] * by_width
        noise = relative + coupled + coupled.transpose(0, 2, 1) + width_variance * np.outer(by_width, by_width)
        # sensitivity of ln F to the camera's parameters (p, channels, slices)
        camera = fit.amplitude_by_camera / amplitude + fit.log_width_by_camera[:, None, None] * by_width
        known = rig.camera.uncertainty
        spread = np.asarray(known.covariance) if known is not None else np.zeros((0, 0))
        camera_covariance = np.einsum("pcs,pq,qct->cst", camera, spread, camera)

        # normalising subtracts the mean's own change
        share = np.where(used, self.absolute, 0) / (count * self.mean[:, None])
        off_mean = np.eye(theta_d.size) - share[:, None, :]
        through = lambda c: np.einsum("cst,ctu,csu->cs", off_mean, c, off_mean)  # noqa: E731
        self.std_noise = self.normalised * np.sqrt(through(noise))
        self.std_camera = self.normalised * np.sqrt(np.clip(through(camera_covariance), 0, None))
        total = np.einsum("css->cs", noise + camera_covariance)
        unknown = not fit.width_determined
        self.absolute_std = np.where(unknown, np.nan, self.absolute * np.sqrt(np.clip(total, 0, None)))
        if unknown:
            self.absolute = np.full_like(self.absolute, np.nan)
        width_by_camera = fit.log_width_by_camera
        self.width_std = fit.width * np.sqrt(fit.log_width_variance + width_by_camera @ spread @ width_by_camera)


@partial(jax.jit, static_argnums=(0, 3))
def _log_factor_and_slope(
    ndf_type: type[MixtureNDF], log_width: jax.Array, theta_d: jax.Array, masking: Masking
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """ln of 4 cos^2 / (D(0) G) over theta_d, its derivative by ln width, and G."""

    def log_factor(log_width: jax.Array) -> tuple[jax.Array, jax.Array]:
        ndf = ndf_type(jnp.exp(log_width))
        joint = jnp.ones_like(theta_d)
        if masking is not None:  # light and view mirror each other
            hidden = ndf.smith_lambda(jnp.cos(theta_d))
            joint = g2(masking, hidden, hidden, jnp.asarray(jnp.pi))
        return jnp.log(4 * jnp.cos(theta_d) ** 2 / (ndf.d(0.0) * joint)), joint

    value, slope, joint = jax.jvp(log_factor, (log_width,), (jnp.ones(()),), has_aux=True)
    return value, slope, joint


def _supported(term: _FresnelTerm, theta_d: np.ndarray) -> np.ndarray:
    """Last theta_d up to which the standard deviation stays under 5 %, counted outwards from the normalisation."""
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
    if not isinstance(rig, Rig):
        raise ArgumentError(f"rig must be a Rig such as rigs.merl(), got {type(rig).__name__}")
    if not isinstance(rig.sample, Sphere):
        raise ArgumentError(f"fresnel needs a table recorded from a Sphere, this rig has a {type(rig.sample).__name__}")
    checks.choice("ndf", ndf, ("auto", *ONE_WIDTH))
    low, high = normalise
    if not 0 <= low < high < np.pi / 2:
        raise ArgumentError(f"normalise must be (low, high) with 0 <= low < high < pi/2 rad, got ({low:g}, {high:g})")
