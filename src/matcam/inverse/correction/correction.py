"""Correction of a table for its camera, with the standard deviation of every entry (docs/model.md 8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.grid import Grid, checked_table, merl_grid, sampling_of
from matcam.core.registry import FAMILIES
from matcam.core.remark import Remark, to_attribute
from matcam.core.results.summary import Quantity, Summarised, Summary, parameters
from matcam.core.threads import done_behind
from matcam.core.workspace import Workspace, default_workspace
from matcam.inverse.correction.corrected_table import corrected_table
from matcam.inverse.correction.correction_limits import (
    LobeRatio,
    shrunk,
    with_channel_misfit,
    withheld,
)
from matcam.inverse.correction.explanation import UNEXPLAINED, explain, first_setup
from matcam.inverse.correction.farthest_glare import farthest_glare
from matcam.inverse.correction.lobe_ratio import CorrectionFits, lattices_ahead, lobe_ratio
from matcam.inverse.correction.lobe_shape import ShapeUncertainty
from matcam.inverse.correction.other_maskings import MOST_LINEAR, other_maskings
from matcam.inverse.correction.rig_refits import RigRefit, axes_of_refits
from matcam.inverse.fit.fit_setup import AUTO
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.normalised_fresnel import NO_CAMERA
from matcam.inverse.operator.chosen_cells import noise_shares
from matcam.inverse.operator.lobe_operator import check_rig
from matcam.inverse.operator.pixel_phase import located_rig
from matcam.inverse.picture_gain import gain_remarks, strengths_gain
from matcam.inverse.rig.rig_axes import known_lens
from matcam.inverse.saturated_values import without_saturated
from matcam.material.masking import MASKINGS, Masking
from matcam.numerics.budget import UncertaintyBudget
from matcam.numerics.fit_budget import VariancePart, parts_budget
from matcam.rigs import Rig

_MATTERS = 0.01
"""Relative change of the peak above which a remark reports a withheld correction."""
_WITHHELD = Remark(
    "correction-withheld",
    "rig and data contradict each other: the table is not corrected, and the standard deviation of the correction is the "
    "change that the rig predicts; check the radius of the sample, the camera and the lamp, or use force_correction=True",
)
_UNSEEN = Remark(
    "blur-not-seen",
    "the lens is a guess, and the data do not determine its blur: the table is not corrected, and the standard deviation of "
    "the correction is the change that the rig predicts; specify the lens, or use force_correction=True",
)
_ANGLES = (5, 45, 75)
"""Values of theta_d, degrees, at which the loss of the peak is reported."""


@dataclass(frozen=True, repr=False)
class Correction(Summarised):
    """Corrected table and the fits from which the correction was computed.

    Attributes:
        table: corrected table, a Dataset as `correct` returns it.
        recorded: table before the correction, 1/sr.
        fit: fit of the lobe through the camera.
        refits: fits with one parameter of the rig free, one for each parameter that was tested.
        shape: uncertainty of the shape of the lobe.
        remarks: remarks on the correction.
        without_camera: fit of the same lobe to the table without a camera. It has free masking and one lobe per channel if
            simpler models do not explain the data.
        no_camera: probability of the explanations without a camera (no unit).
        withheld: True if the table is not corrected because rig and data contradict each other, and a correction would change
            a peak by more than 1 %. Default: False.
        peak_parts: sources of the variance of `brdf` at the peak of each slice, (90, channels) each. Default: none.

    Example:
        >>> done = matcam.inverse.Correction.of(table, matcam.rigs.merl())  # doctest: +SKIP
        >>> print(done.summary())  # doctest: +SKIP
        >>> axes = done.plot(theta_d=np.radians(45))  # doctest: +SKIP
        >>> list(matcam.inverse.Correction.__dataclass_fields__)
        ['table', 'recorded', 'fit', 'refits', 'shape', 'remarks', 'without_camera', 'no_camera', 'withheld', 'peak_parts']
    """

    table: xr.Dataset
    recorded: xr.DataArray
    fit: MaterialFit
    refits: tuple[RigRefit, ...]
    shape: ShapeUncertainty
    remarks: tuple[Remark, ...]
    without_camera: MaterialFit
    no_camera: float
    withheld: bool = False
    peak_parts: tuple[VariancePart, ...] = ()

    @classmethod
    def of(
        cls,
        brdf: xr.DataArray,
        rig: Rig,
        ndf: str = AUTO,
        *,
        masking: Masking = "smith",
        noise: PixelNoise | None = None,
        glare: float = 1e-3,
        force_correction: bool = False,
        workspace: Workspace | None = None,
    ) -> Correction:
        """Correct a table, and keep the fits of the correction.

        The arguments are those of `correct`.

        Args:
            brdf: recorded table, 1/sr.
            rig: rig that recorded the table.
            ndf: family of the lobe. Default: "auto".
            masking: masking G of the lobe. Default: "smith".
            noise: noise of a pixel. Default: None, estimated.
            glare: share of the light that the lens may scatter (no unit). Default: 1e-3.
            force_correction: True to correct the table even if the data contradict the rig, or do not determine the blur of
                a lens that is a guess. Default: False.
            workspace: store of results that depend only on the rig. Default: None, that of the process.

        Returns:
            The corrected table, the fits from which the correction was computed, and remarks.

        Raises:
            ArgumentError: an argument is wrong.
            FitError: the table has no values to fit.
        """
        brdf = checked_table(brdf)
        check_rig(rig)
        checks.choice("ndf", ndf, (AUTO, *FAMILIES))
        checks.choice("masking", masking, MASKINGS)
        checks.within("glare", glare, 0, 0.5)
        checks.flag("force_correction", force_correction)
        workspace = checks.instance("workspace", default_workspace() if workspace is None else workspace, Workspace)
        brdf, saturated = without_saturated(brdf, rig)
        sampling, located = sampling_of(brdf), located_rig(rig, brdf)
        setup = first_setup(brdf, located.rig, masking=masking, noise=noise, workspace=workspace)
        expected = axes_of_refits(setup, located.rig)
        setup.rule()  # computed first, because the other fits reuse the compiled programs
        with done_behind(lambda: lattices_ahead(located.rig, sampling, expected, workspace)):
            found = explain(setup, located, ndf)
        best = found.fit
        maskings = other_maskings(best, min(found.weighing.kappa, MOST_LINEAR))
        fits = CorrectionFits(best, found.shape, found.base, found.refits, found.others, maskings, expected)
        fitted = lobe_ratio(located.rig, sampling, fits, workspace, located.std)
        fitted = with_channel_misfit(fitted, found.channel_misfit)
        held_back = found.contradicts and not force_correction
        said = held_back and _matters(fitted)
        if force_correction:
            added = found.no_camera * fitted.log**2
            ratio = fitted._replace(std=np.sqrt(fitted.std**2 + added), parts=fitted.parts_with(NO_CAMERA, added))
        else:
            ratio = withheld(fitted) if held_back or found.undecided else shrunk(fitted, found.no_camera)
        scattered = farthest_glare(sampling, rig, best, workspace)
        blind = held_back and found.no_blur
        left, lit = (found.without_camera.noise, found.blind) if blind else (found.shape.noise, best)
        if noise is None:  # free strengths contain the image gains, which are estimated from the irregularities of F
            lit = found.scattering(lit)
            left = left._replace(picture_gain=strengths_gain(lit.theta_d, *lit.strengths()[:3]))
        shares = noise_shares(located.rig, sampling)
        table, limit, parts = corrected_table(brdf, best, left, shares, ratio, scattered, glare)
        if said:  # the change that the rejected rig predicts is part of the uncertainty of all entries
            table["supported"].values[:] = False
        remarks = (*found.remarks, *saturated, *limit.remarks)
        if noise is None:
            remarks = (*remarks, *gain_remarks(left.picture_gain))
        if found.no_blur and _matters(fitted):
            remarks = (*remarks, found.no_blur_remark)
        if said:
            remarks = (*remarks, _WITHHELD)
        elif found.undecided and not force_correction and _matters(fitted):
            remarks = (*remarks, _UNSEEN)
        table.attrs.update(
            ndf=best.family, spline_modified=int(best.has_spline), masking=masking or "none", glare=glare,
            sampling=sampling, source=str(brdf.attrs.get("source", "")), remarks=to_attribute(remarks),
            camera_uncertainty=known_lens(rig.camera).words, withheld=int(said),
        )  # fmt: skip
        return cls(
            table, brdf, best, found.refits, found.shape, remarks, found.without_camera, found.no_camera, said, parts
        )

    def uncertainty_budget(self, theta_d: float, channel: int | None = None) -> UncertaintyBudget:
        """Compute the uncertainty budget of the corrected peak at an angle.

        The budget follows the Guide to the Expression of Uncertainty in Measurement (GUM). The combined uncertainty is
        `brdf_std` of the entry at theta_h = 0, phi_d = 90 degrees. The sources are the readings of the pixels, the specified
        camera, the other explanations of the table, glare, the body, and the noise of the entry.

        Args:
            theta_d: difference angle, rad. The slice that contains it is used.
            channel: index of the channel, no unit. Default: None, the middle channel.

        Raises:
            ArgumentError: an argument is out of range, or the table has no standard deviation of the peak at `theta_d`.

        Example:
            >>> done.uncertainty_budget(np.radians(45.0)).expanded  # doctest: +SKIP
        """
        count = self.table["brdf"].shape[-1]
        channel = count // 2 if channel is None else channel
        if type(channel) is not int or not 0 <= channel < count:
            raise ArgumentError(f"channel must be a whole number from 0 to {count - 1}, got {channel!r}")
        at = self._peak(float(checks.scalar("theta_d", checks.within("theta_d", theta_d, 0, np.pi / 2, "rad"))))
        value, std = (float(self.table[name].values[at][channel]) for name in ("brdf", "brdf_std"))
        label, degrees = self._channel_names[channel], float(np.degrees(self.table["theta_d"].values[at[1]]))
        if not np.isfinite(std):
            raise ArgumentError(
                f"the table has no standard deviation of the peak at {degrees:.1f} degrees, {label}: choose an angle at which "
                "brdf_std is not missing"
            )
        return parts_budget(f"peak at {degrees:.1f} deg, {label}, 1/sr", value, self.peak_parts, (int(at[1]), channel))

    def uncertainty_budgets(self) -> list[UncertaintyBudget]:
        """Compute the uncertainty budgets of the peaks at three angles.

        Returns:
            Budgets at theta_d = 5, 45 and 75 degrees for each channel. Peaks without a standard deviation are omitted.
        """
        angles = np.radians(_ANGLES)
        known = np.isfinite(self.table["brdf_std"].values[self._peak(angles)])
        return [
            self.uncertainty_budget(float(angle), channel)
            for channel in range(known.shape[1])
            for angle, there in zip(angles, known[:, channel], strict=True)
            if there
        ]

    @property
    def _channel_names(self) -> list[str]:
        brdf = self.table["brdf"]
        return [str(c) for c in (brdf["channel"].values if "channel" in brdf.coords else range(brdf.shape[-1]))]

    def peak_loss(self, theta_d: ArrayLike) -> np.ndarray:
        """Compute the loss of the highlight peak that the camera causes.

        Args:
            theta_d: one or several difference angles, rad. The slices that contain the angles are used.

        Returns:
            1 - recorded / true peak (no unit), averaged over the channels, in the shape of `theta_d`.

        Example:
            >>> done.peak_loss(np.radians([5, 45, 75]))  # doctest: +SKIP
        """
        return 1 - self._peak_response(theta_d)

    @property
    def supported_share(self) -> float:
        """Share of supported entries (no unit).

        Entries without a standard deviation are excluded.
        """
        return float(self.table["supported"].values[np.isfinite(self.table["brdf_std"].values)].mean())

    @property
    def determination(self) -> str:
        """Category that indicates whether the data determine the lobe.

        The value is "determined", "not determined", "family fails: spline-modified", or "withheld" if rig and data contradict
        each other.
        """
        if self.withheld:
            return "withheld"
        if self.fit.has_spline:
            return "family fails: spline-modified"
        return "determined" if self._determined else "not determined"

    @property
    def _determined(self) -> bool:
        return self.fit.determined and UNEXPLAINED not in (remark.code for remark in self.remarks)

    @property
    def verdict(self) -> str:
        """Summary of the result in three sentences."""
        if self.withheld:
            return (
                "Rig and data contradict each other, so the table is not corrected. The remarks name the contradiction. "
                "No entry is supported."
            )
        losses = self.peak_loss(np.radians(_ANGLES))
        lost = [f"{loss:.0%} at {angle}°" for angle, loss in zip(_ANGLES, losses, strict=True)]
        if np.abs(losses).max() < _MATTERS:
            lost = [f"less than {_MATTERS:.0%} up to {_ANGLES[-1]}°"]
        known = "well determined" if self._determined else "NOT determined by these images"
        rows = self._grid.index(theta_h=0.0, theta_d=np.radians(np.arange(_ANGLES[0], _ANGLES[-1] + 1)))
        supported, recorded = self.table["supported"].values[rows], np.isfinite(self.recorded.values[rows])
        peaks = f"none of the peaks up to {_ANGLES[-1]}°, which are missing,"
        if recorded.any():
            some = "" if recorded.all() else " that are not missing"
            peaks = f"{supported[recorded].mean():.0%} of the peaks up to {_ANGLES[-1]}°{some}"
        return (
            f"The camera reduced the peak of the highlight by {', '.join(lost)}. The roughness of the surface is {known}. "
            f"After correction {peaks} are supported (the correction is known to 5 %), and "
            f"{self.supported_share:.0%} of the entries with known uncertainty."
        )

    def _summary(self) -> Summary:
        lost = zip(_ANGLES, self.peak_loss(np.radians(_ANGLES)), strict=True)
        source = str(self.recorded.attrs.get("source", ""))
        return Summary(
            f"Corrected table{f' of {source}' if source else ''}",
            self.verdict,
            {
                "Share of the peak that the camera lost": [
                    Quantity(f"theta_d = {a}°", float(loss)) for a, loss in lost
                ],
                f"Lobe ({self.fit.lobe_name}): {self.determination}": parameters(self.fit.params, self.fit.std),
            },
            self.remarks,
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert the result, without the table, to JSON types.

        Returns:
            The dictionary that `matcam correct --json` prints. Fitted angles are in rad. The number 75 in a name, and the keys
            of "peak_lost", are values of theta_d, degrees.
        """
        lost = self.peak_loss(np.radians(_ANGLES))
        return {
            "fit": self.fit.to_dict(),
            "refits": {refit.axis.name: refit.to_dict() for refit in self.refits},
            "shape": {"scale": self.shape.scale},
            "no_camera": {"probability": self.no_camera, "noise": self.without_camera.noise._asdict()},
            "supported_share": self.supported_share,
            "peak_gain_75": float(1 / self._peak_response(np.radians(75.0))),
            "correction_std_75": float(self.table["correction_std"].values[self._peak(np.radians(75.0))].max()),
            "peak_lost": {str(angle): float(loss) for angle, loss in zip(_ANGLES, lost, strict=True)},
            "determination": self.determination,
            "withheld": self.withheld,
            "verdict": self.verdict,
            "remarks": [remark.to_dict() for remark in self.remarks],
        }

    def _peak_response(self, theta_d: ArrayLike) -> np.ndarray:
        """Compute recorded / corrected peak at phi_d = 90 degrees, averaged over the channels.

        It is interpolated between the slices of the table. For a missing or black peak, the response of the fitted material
        is used instead.
        """
        slices = self._grid.theta_d
        at = self._peak(slices)
        recorded, corrected = self.recorded.values[at], self.table["brdf"].values[at]
        with np.errstate(invalid="ignore", divide="ignore"):
            response = np.where(corrected > 0, recorded / corrected, self.table["response"].values[at])
        return np.interp(np.asarray(theta_d, dtype=float), slices, np.mean(response, axis=-1))

    def _peak(self, theta_d: ArrayLike) -> tuple[Any, ...]:
        return self._grid.index(theta_h=0.0, theta_d=theta_d, phi_d=np.pi / 2)

    @property
    def _grid(self) -> Grid:
        return merl_grid(self.table.attrs["sampling"])


def correct(
    brdf: xr.DataArray,
    rig: Rig,
    ndf: str = AUTO,
    *,
    masking: Masking = "smith",
    noise: PixelNoise | None = None,
    glare: float = 1e-3,
    force_correction: bool = False,
    workspace: Workspace | None = None,
) -> xr.Dataset:
    """Correct a table for the camera that recorded it.

    Lobes are fitted to the table through the camera. The Fresnel term is free in every slice, and a diffuse part is added. The
    lobes are averaged according to their evidence. Each entry is multiplied by the ratio of true to recorded value of
    the fitted material, so the details of the measurement are preserved. `Correction.of` also returns the fits.

    Args:
        brdf: table of the form that `read_merl` returns, 1/sr.
        rig: rig that recorded the table, with a sphere or a cylinder; camera and lamp are distant or near.
        ndf: family of the lobe. Default: "auto", the mean of several explanations, weighted by their evidence. The
            explanations are "ggx" and "epd". If their residuals exceed pixel noise, Student's t, two lobes, a lobe over a
            rough base, and a spline-modified lobe are added.
        masking: masking G of the lobe: "smith", "smith-separable", "van-ginneken" or None. Default: "smith".
        noise: noise of a pixel. Default: None, estimated from the table.
        glare: share of light (no unit) that the lens may scatter in addition to its profile. Default: 1e-3. A larger share
            leaves fewer supported entries beside a highlight; specify a smaller share for a lens that is known to be clean.
        force_correction: True to correct the table even if the data contradict the rig, or do not determine the blur of a
            lens that is a guess. Default: False, such a table is left unchanged.
        workspace: store of results that depend only on the rig. Default: None, that of the process.

    Returns:
        Dataset over the dimensions of the table. `brdf`: corrected BRDF, 1/sr. Missing values remain missing,
        negative noise remains, no other value becomes negative, and reciprocity is preserved. Uncertain corrections are
        reduced towards the recorded value. In directions with an albedo above 1, entries are reduced within the standard
        deviation of the correction.
        `correction_std`: standard deviation of true / recorded value (no unit), due to fitted parameters, the other
        explanations, the uncertainty of the camera, the shape of the lens, the body, a free lamp, and glare. `noise_std`:
        standard deviation of `brdf` due to pixel noise, 1/sr. `brdf_std`: standard deviation of `brdf` due to correction
        and noise, 1/sr. These three standard deviations are NaN for entries in the last pixels of the sphere, which are not
        corrected. `supported`: True if the standard deviation of the correction is below 5 % of `brdf`. `response`:
        recorded / true value of the fitted material.
        Attributes: `withheld`, 1 if the table is not corrected because rig and data contradict each other, and a
        correction would change a peak by more than 1 %; the response is then 1 and no entry is supported. `diffuse`,
        albedo of the diffuse part in each channel, and `coated_share`, the share of the diffuse part that is under a
        coat (no unit). If the material has a rough base: `base`, reflectance of the base in each channel, and
        `base_alpha`, roughness of the base.

    Raises:
        ArgumentError: an argument is wrong, or a fit does not support the rig.
        FitError: the table has no values to fit.

    Source:
        docs/model.md sections 3 and 8.

    Example:
        >>> table = matcam.read_merl("chrome.binary")  # doctest: +SKIP
        >>> corrected = matcam.correct(table, matcam.rigs.merl())  # doctest: +SKIP
        >>> matcam.correct(np.ones(3), matcam.rigs.merl())
        Traceback (most recent call last):
        ...
        matcam.core.errors.ArgumentError: a BRDF table must be an xarray.DataArray (see read_merl), got ndarray
    """
    return Correction.of(
        brdf,
        rig,
        ndf,
        masking=masking,
        noise=noise,
        glare=glare,
        force_correction=force_correction,
        workspace=workspace,
    ).table


def _matters(ratio: LobeRatio) -> bool:
    return bool(np.abs(ratio.log[0, : _ANGLES[-1]]).max() > _MATTERS)
