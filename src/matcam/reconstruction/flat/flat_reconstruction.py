"""Maps of a flat textured sample from photographs, with errors that include the texture that the camera does not resolve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from matcam.acquisition.check.flat_check import FEWEST, sample_tilts
from matcam.acquisition.light.kept_work import KeptWork
from matcam.acquisition.merging import merge
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.acquisition.radiometry import Progress
from matcam.camera.camera import Camera
from matcam.core.errors import ArgumentError, FitError
from matcam.core.registry import ONE_WIDTH
from matcam.core.remark import Remark
from matcam.core.results.labelled import named
from matcam.core.results.summary import Quantity, Summarised, Summary
from matcam.files.capture import Capture
from matcam.inverse.fit.fit_setup import AUTO
from matcam.material.masking import Masking
from matcam.numerics.budget import UncertaintyBudget, UncertaintySource
from matcam.numerics.fit_budget import Readings, Statement, posterior_budget
from matcam.reconstruction.flat.flat_roughness import FlatRoughness, LobeShares, fit_roughness
from matcam.reconstruction.flat.flat_stack import MARGIN, FlatPicture, FlatStack, flat_stack
from matcam.reconstruction.flat.texture_posterior import TexturePosterior, texture_posterior
from matcam.reconstruction.stated.captured_scene import INCOMPLETE
from matcam.reconstruction.stated.stated_rig import captured_lens, without_field

MAPS = ("diffuse", "specular")
_CLIPPED = 0.001  # share of clipped pixels up to which an image is used


@dataclass(frozen=True, repr=False)
class FlatReconstruction(Summarised):
    """Maps of a flat sample, with their accuracy.

    Attributes:
        maps: Dataset. `diffuse`, `specular` and their standard deviations `diffuse_std` and `specular_std` are relative.
            They are arrays over y and x (px of the sample seen head-on). `diffuse_error` is the variance at each
            frequency, and `diffuse_resolved` is the share of the prior variance that the images remove. Both are arrays
            over frequency_y and frequency_x (cycles/px). `specular_error` and `specular_resolved` are the corresponding arrays
            of `specular`.
        parameters: value and standard deviation of the roughness `alpha`, and of the means `mean_diffuse` and
            `mean_specular` of all texels. The maps omit the texels at the border, so their means differ slightly.
        cutoffs: frequencies along the rows and across them up to which a map is resolved, cycles/px, by the name of the map.
        mm_per_px: size of a texel, mm; None: unknown.
        family: family of the lobe.
        names: names of the images that were used.
        gains: relative irradiance in each image, and standard deviation of its logarithm, (pictures, 2).
        misfit: mean squared residual of the coarse frequencies, relative to the variance of the noise.
        left_out: lamp positions that could not be used.
        remarks: remarks on the result.
        budgets: uncertainty budgets of `parameters`.

    Example:
        >>> found = matcam.reconstruct("slab/")  # doctest: +SKIP
        >>> found.maps["diffuse"].mean(), found.cutoffs["diffuse"]  # doctest: +SKIP
    """

    maps: xr.Dataset
    parameters: dict[str, tuple[float, float]]
    cutoffs: dict[str, tuple[float, float]]
    mm_per_px: float | None
    family: str
    names: tuple[str, ...]
    gains: np.ndarray
    misfit: float
    left_out: tuple[str, ...]
    remarks: tuple[Remark, ...]
    budgets: tuple[UncertaintyBudget, ...]

    sample = "flat"

    def uncertainty_budget(self, name: str) -> UncertaintyBudget:
        """Return the uncertainty budget of a parameter.

        The budget follows the Guide to the expression of uncertainty in measurement (GUM, JCGM 100:2008).

        Args:
            name: name of the parameter, one of `parameters`.

        Raises:
            ArgumentError: there is no parameter of this name.

        Example:
            >>> found.uncertainty_budget("alpha").expanded  # doctest: +SKIP
        """
        known = {one.name: one for one in self.budgets}
        if name not in known:
            raise ArgumentError(f"the reconstruction has no result {name!r}: give one of {', '.join(known)}")
        return known[name]

    def uncertainty_budgets(self) -> list[UncertaintyBudget]:
        """Return the uncertainty budgets of all parameters (GUM)."""
        return list(self.budgets)

    @property
    def complete(self) -> bool:
        """True if every frame of the capture could be used."""
        return not self.left_out and not any(remark.code in INCOMPLETE for remark in self.remarks)

    @property
    def verdict(self) -> str:
        """Summary of the result in plain sentences."""
        alpha, std = self.parameters["alpha"]
        resolved = "; ".join(f"{name} up to {self._resolution(name)}" for name in MAPS)
        return (
            f"{len(self.names)} images give a {self.family} lobe of roughness {alpha:.4g} ± {std:.1g} and two maps. "
            f"The maps are resolved in these bands: {resolved}. Their errors include the finer texture, which is lost."
        )

    def _summary(self) -> Summary:
        cutoffs = [
            Quantity(f"{name}, {along}", value, unit="cycles/px")
            for name, pair in self.cutoffs.items()
            for along, value in zip(("along the rows", "across the rows"), pair, strict=True)
        ]
        return Summary(
            f"Maps of a flat sample, reconstructed from {len(self.names)} photographs",
            self.verdict,
            {
                "Parameters": [Quantity(name, *pair) for name, pair in self.parameters.items()],
                "Highest resolved frequency": cutoffs,
                "Fit statistics": [Quantity("mean squared residual over the variance of the noise", self.misfit)],
            },
            self.remarks,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the JSON file, without the maps.

        Returns:
            The document described in docs/reconstruct.md.
        """
        scale = None if self.mm_per_px is None else 1 / self.mm_per_px
        return {
            "format": "matcam reconstruction",
            "version": 1,
            "sample": self.sample,
            "verdict": self.verdict,
            "lobe": {"family": self.family},
            "parameters": {name: list(pair) for name, pair in self.parameters.items()},
            "cutoff_cycles_per_px": {name: list(pair) for name, pair in self.cutoffs.items()},
            "cutoff_lp_per_mm": None
            if scale is None
            else {name: [scale * one for one in pair] for name, pair in self.cutoffs.items()},
            "pictures": [
                {"name": name, "gain": gain, "gain_std": std}
                for name, (gain, std) in zip(self.names, self.gains.tolist(), strict=True)
            ],
            "misfit": self.misfit,
            "left_out": list(self.left_out),
            "remarks": [remark.to_dict() for remark in self.remarks],
        }

    def _resolution(self, name: str) -> str:
        along, across = self.cutoffs[name]
        text = f"{along:.2g} x {across:.2g} cycles/px"
        if self.mm_per_px is None:
            return text
        return f"{text} ({along / self.mm_per_px:.2g} x {across / self.mm_per_px:.2g} lp/mm)"


def reconstruct_flat(
    capture: Capture,
    ndf: str = AUTO,
    *,
    masking: Masking = "smith",
    progress: Progress | None = None,
    workers: int = 1,
    kept: KeptWork | None = None,
) -> FlatReconstruction:
    """Reconstruct diffuse albedo and specular strength of every texel of a flat sample.

    Args:
        capture: capture of a flat sample, as returned by `read_capture`.
        ndf: family of the lobe, with roughness as its only parameter. Default: "auto", which is "ggx".
        masking: model of the masking of the lobe. Default: "smith".
        progress: function that is called with the name of a step, the number of finished parts and the number of all parts.
            Default: None.
        workers: number of images that are read at the same time. Default: 1.
        kept: stored results from which an interrupted computation resumes. Default: None, nothing is stored.

    Raises:
        ArgumentError: the family is unknown or has a second parameter, the number of tilts is wrong, or the blur of the
            lens depends on direction or colour.
        FitError: fewer than three images can be used, the images are too small or have a colour mosaic, or a lamp or the
            camera is behind the sample.
    """
    family = "ggx" if ndf == AUTO else ndf
    if family not in ONE_WIDTH:
        raise ArgumentError(f"ndf of a flat sample must be one of {', '.join((AUTO, *ONE_WIDTH))}, got {ndf}")
    remarks: list[Remark] = list(capture.problems)
    camera, lens = captured_lens(capture, remarks)
    camera = without_field(camera, "flat sample", remarks)
    tilts = dict(zip(capture.lamps, sample_tilts(capture).tolist(), strict=True))
    reader = MosaicReader(capture)
    next(reader.readable(capture.of("frames"), capture.region), None)  # decides whether the frames are mosaics
    if len(reader.channels) > 1:
        raise FitError(
            f"{capture.folder}: a flat sample needs grey images, got a mosaic, in which each colour shows only some of the "
            "texels: give frames of a monochrome camera, and omit camera.cfa"
        )
    merged, radiometry = merge(capture, capture.region, progress, workers=workers, kept=kept)
    remarks.extend(radiometry.remarks)
    pictures, lost = [], []
    for one in merged:
        towards = capture.lamps[one.name].direction
        if not np.all(np.isfinite(towards)):
            lost.append(f"{one.name} has no lamp direction (angle_deg and azimuth_deg of frames.csv)")
        elif one.clipped.mean() > _CLIPPED:
            lost.append(f"{one.name} has {one.clipped.mean():.1%} of its pixels clipped in every exposure")
        else:
            output, std = radiometry.lamp_output[one.name], float(capture.settings["lamp"]["gain_std"])
            if output.value > 0 and radiometry.reference_between < std:
                # relative to the reference: each gain is then 1 within the error of the reference
                one = replace(one, values=one.values / output.value, std=one.std / output.value)
                std = output.std / output.value
            pictures.append(FlatPicture(one, tilts[one.name], towards, std))
    remarks.extend(Remark("picture-left-out", f"{text}, so the image was left out") for text in lost)
    if len(pictures) < FEWEST:
        raise FitError(
            f"{capture.folder}: only {len(pictures)} of the images of the flat sample can be used, but {FEWEST} are required: "
            "add images, specify the lamp directions in frames.csv, or add shorter exposures if pixels are clipped"
        )
    size = capture.stated("mm_per_px")
    left_out = tuple(text.split(" ")[0] for text in lost)
    return reconstructed_flat(
        pictures, camera, family, masking=masking, lens_std=lens, mm_per_px=size, left_out=left_out, remarks=remarks
    )


def reconstructed_flat(
    pictures: Sequence[FlatPicture],
    camera: Camera,
    family: str = "ggx",
    *,
    masking: Masking = "smith",
    lens_std: float = 0.0,
    mm_per_px: tuple[float, float] | None = None,
    left_out: tuple[str, ...] = (),
    remarks: Sequence[Remark] = (),
) -> FlatReconstruction:
    """Reconstruct the maps of a flat sample from merged images.

    Args:
        pictures: merged images with tilt and lamp.
        camera: lens and pixel.
        family: family of the lobe, with roughness as its only parameter. Default: "ggx".
        masking: model of the masking of the lobe. Default: "smith".
        lens_std: relative standard deviation of the lens width. Default: 0, exact.
        mm_per_px: size of a texel and its standard deviation, mm. Default: None, unknown.
        left_out: names of images that could not be used. Default: ().
        remarks: remarks of the preceding steps. Default: ().

    Raises:
        ArgumentError: the blur of the lens depends on direction, colour or position.
        FitError: the images are too small, or a lamp or the camera is behind the sample.
    """
    shares = LobeShares(
        family, masking, np.array([one.tilt for one in pictures]), np.array([one.towards for one in pictures])
    )
    dark = [one.picture.name for one, lit in zip(pictures, shares.lit, strict=True) if not lit]
    if dark:
        raise FitError(
            f"{', '.join(dark)}: the lamp or the camera is behind the sample at the given angles: correct frames.csv or "
            "sample.tilt_deg"
        )
    stack = flat_stack(pictures, camera)
    fitted = fit_roughness(stack, shares, np.array([one.gain_std for one in pictures]))
    posterior = texture_posterior(stack, fitted.weights, lens_std)
    alpha = float(np.exp(fitted.log_alpha))
    unit = max(float(fitted.mean.max()), 1e-300)
    budgets = _budgets(fitted, alpha, unit)
    gain_std = np.sqrt(np.maximum(np.diag(fitted.covariance)[1:], 0.0))
    return FlatReconstruction(
        maps=_maps(stack, posterior, fitted.mean, unit, mm_per_px),
        parameters={one.name: (one.value, one.combined) for one in budgets},
        cutoffs={name: posterior.cutoff(stack.frequency, i) for i, name in enumerate(MAPS)},
        mm_per_px=None if mm_per_px is None else float(mm_per_px[0]),
        family=family,
        names=tuple(one.picture.name for one in pictures),
        gains=np.column_stack([np.exp(fitted.gains), gain_std]),
        misfit=fitted.misfit,
        left_out=left_out,
        remarks=tuple(dict.fromkeys([*remarks, *_remarks(fitted, shares)])),
        budgets=budgets,
    )


def _budgets(fitted: FlatRoughness, alpha: float, unit: float) -> tuple[UncertaintyBudget, ...]:
    """Build the uncertainty budgets of the roughness and of the mean of each map.

    `unit` is the value by which both maps are divided.
    """
    stated = [Statement("gains of the images, as specified", fitted.stated)]
    readings = Readings("images: texture of coarse frequencies", "A", fitted.freedom)
    by_alpha = np.zeros(len(fitted.covariance))
    by_alpha[0] = alpha
    budgets = [posterior_budget("alpha", alpha, by_alpha, fitted.covariance, stated, readings)]
    for i, name in enumerate(MAPS):
        noise = UncertaintySource(
            "noise of the means of the images", 0.0, float(np.sqrt(fitted.mean_noise[i, i])) / unit, 1.0, "A"
        )
        value, slope = float(fitted.mean[i] / unit), fitted.mean_slope[i] / unit
        budgets.append(posterior_budget(f"mean_{name}", value, slope, fitted.covariance, stated, readings, [noise]))
    return tuple(budgets)


def _remarks(fitted: FlatRoughness, shares: LobeShares) -> list[Remark]:
    found = [Remark("relative", "both maps are relative: they are scaled so that the larger mean is 1")]
    spread = float(np.sqrt(fitted.covariance[0, 0]))
    # standard deviation of ln alpha above which a remark is added
    if spread > 0.05:
        found.append(
            Remark(
                "roughness-loose",
                f"the images determine the roughness only to ±{spread:.0%}: tilt the sample or move the lamp, so that the "
                "half angles of the images differ more",
            )
        )
    # F may vary between images whose theta_d differ by more than 10 degrees
    if np.ptp(shares.theta_d) > np.radians(10.0):
        low, high = np.degrees([shares.theta_d.min(), shares.theta_d.max()])
        found.append(
            Remark(
                "theta-d-varies",
                f"theta_d varies from {low:.0f}° to {high:.0f}°, but F is assumed to be constant: keep the angle between "
                "lamp and camera constant",
            )
        )
    if fitted.misfit > 1.3:
        found.append(
            Remark(
                "misfit",
                "diffuse and specular maps with one roughness do not explain the images: the residuals are "
                f"{np.sqrt(fitted.misfit):.1f} times the noise; check the given angles, and that the sample is flat",
            )
        )
    return found


def _maps(
    stack: FlatStack,
    posterior: TexturePosterior,
    means: np.ndarray,
    unit: float,
    mm_per_px: tuple[float, float] | None,
) -> xr.Dataset:
    height, width = stack.taper.shape
    inner = slice(MARGIN, height - MARGIN), slice(MARGIN, width - MARGIN)
    root = np.sqrt((stack.taper**2).sum())
    x, y = (np.arange(n) - (n - 1) / 2 for n in (width, height))
    variables: dict[str, Any] = {}
    names = {"x": "position to the right on the sample seen head-on [px]", "y": "position upwards [px]"}
    for i, name in enumerate(MAPS):
        field = means[i] + np.fft.ifft2(posterior.estimate[i]).real * root
        variance = posterior.variance[i] + posterior.by_lens[i]
        std = np.sqrt(variance.mean())
        plane, frequencies = ("y", "x"), ("frequency_y", "frequency_x")
        variables[name] = plane, field[inner] / unit
        variables[f"{name}_std"] = plane, np.full(field[inner].shape, std / unit)
        variables[f"{name}_error"] = frequencies, np.fft.fftshift(variance) / unit**2
        variables[f"{name}_resolved"] = frequencies, np.fft.fftshift(posterior.resolved[i])
        names |= {
            name: f"{name} part, relative",
            f"{name}_std": f"standard deviation of {name} about its mean, including lost texture",
            f"{name}_error": f"variance of {name} at each frequency; the mean over all frequencies is the variance of a texel",
            f"{name}_resolved": "share of the prior variance that the images remove",
        }
    along, across = (np.fft.fftshift(one.ravel()) for one in stack.frequency)
    attrs: dict[str, Any] = {
        f"{name}_cutoff_cycles_per_px": posterior.cutoff(stack.frequency, i) for i, name in enumerate(MAPS)
    }
    for name, law in zip(MAPS, posterior.laws, strict=True):
        attrs[f"{name}_prior"] = f"power {law.level / unit**2:.4g} (frequency / 0.1 cycles/px)^{law.slope:.3g}"
    if mm_per_px is not None:
        attrs["mm_per_px"] = float(mm_per_px[0])
    data = xr.Dataset(
        variables,
        coords={
            "x": x[inner[1]],
            "y": -y[inner[0]],
            "frequency_x": along,
            "frequency_y": across,
        },
        attrs=attrs,
    )
    return named(data, names)
