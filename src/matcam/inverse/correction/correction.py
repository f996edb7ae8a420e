"""A whole table as a perfect camera would have measured it, with the error of every entry (docs/model.md 8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from matcam.camera.sensor import PixelNoise
from matcam.core import checks
from matcam.core.errors import FitError
from matcam.core.grid import Grid, checked_table, merl_grid, sampling_of
from matcam.core.registry import FAMILIES
from matcam.core.remark import Remark, to_attribute
from matcam.core.workspace import Workspace, default_workspace
from matcam.inverse.correction.doubts import Doubt, ShapeCorrection, no_correction, rig_doubts, shape_correction
from matcam.inverse.correction.lobe_ratio import CorrectionFits, LobeRatio, lobe_ratio, seen_cells
from matcam.inverse.fit.fit_setup import AUTO, SEARCH_EVERY, candidate_fits, free_setup, likeliest
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.lobe_operator import check_rig, sphere_radius
from matcam.material.masking import MASKINGS, Masking
from matcam.rigs import Rig

SUPPORTED = 0.05
"""Relative standard deviation up to which an entry is supported."""

_BEND = 1.0
"""How far a lobe whose family fails may leave it (`fit`, bend)."""
_BEND_EVERY = 3 * SEARCH_EVERY
_NEAREST_GLARE = 8.0
"""px; a halo closer to the highlight than this is the lens's core, and described by its profile."""
_ANGLES = (5, 45, 75)
"""Degrees of theta_d at which the loss of the peak is reported."""


@dataclass(frozen=True)
class Correction:
    """Hold a corrected table, and the fits that it was corrected by.

    Attributes:
        table: Dataset as from `correct`.
        fit: fit of the lobe through the camera.
        doubts: the same fit with a parameter of the rig free, one for each parameter.
        shape: what was changed of the family's lobe.
        remarks: what a reader should know of the correction.

    Example:
        >>> done = matcam.inverse.Correction.of(table, matcam.rigs.merl())  # doctest: +SKIP
        >>> print(done.verdict)  # doctest: +SKIP
        >>> list(matcam.inverse.Correction.__dataclass_fields__)
        ['table', 'fit', 'doubts', 'shape', 'remarks']
    """

    table: xr.Dataset
    fit: MaterialFit
    doubts: tuple[Doubt, ...]
    shape: ShapeCorrection
    remarks: tuple[Remark, ...]

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
        workspace: Workspace | None = None,
    ) -> Correction:
        """Correct a table as `correct` does, and keep the fits.

        Args:
            brdf: as for `correct`, 1/sr.
            rig: as for `correct`.
            ndf: as for `correct`. Default: "auto".
            masking: as for `correct`. Default: "smith".
            noise: as for `correct`. Default: None, estimated.
            glare: as for `correct` (no unit). Default: 1e-3.
            workspace: as for `correct`. Default: None, the process's own.

        Returns:
            The table, the fits that it was corrected by, and remarks.

        Raises:
            ArgumentError: an argument is wrong.
            FitError: the table holds nothing to fit.
        """
        brdf = checked_table(brdf)
        check_rig(rig)
        checks.choice("ndf", ndf, (AUTO, *FAMILIES))
        checks.choice("masking", masking, MASKINGS)
        checks.within("glare", glare, 0, 0.5)
        workspace = workspace or default_workspace()
        setup = free_setup([brdf], rig, masking=masking, noise=noise, workspace=workspace)
        best = family = likeliest(candidate_fits(setup, ndf))
        setup = setup.with_(ndf=family.family)
        doubts = rig_doubts(setup, rig, family)
        shape = shape_correction(best, noise)
        if shape.family_fails:  # too far for what is linear: the lobe itself is bent
            best = setup.with_(bend=_BEND, every=_BEND_EVERY).solve(start=family)
            shape = no_correction(best, shape.scale)
        ratio = lobe_ratio(rig, sampling_of(brdf), CorrectionFits(best, shape, family, doubts), workspace)
        remarks = _correction_remarks(best, doubts, shape)
        table = _corrected_table(brdf, best, shape.noise, ratio, glare * _farthest_glare(brdf, rig, best), glare)
        table.attrs.update(
            ndf=best.family, masking=masking or "none", glare=glare, sampling=sampling_of(brdf),
            source=str(brdf.attrs.get("source", "")), remarks=to_attribute(remarks),
            camera_uncertainty="stated" if rig.camera.uncertainty else "none stated: taken as exact",
        )  # fmt: skip
        return cls(table, best, doubts, shape, remarks)

    def peak_loss(self, theta_d: ArrayLike) -> np.ndarray:
        """Return the share of the highlight's peak that the camera lost.

        Args:
            theta_d: difference angle, rad, or several of them (n,). The slice that contains it answers.

        Returns:
            1 - recorded / true peak, no unit, of the shape of `theta_d`.

        Example:
            >>> done.peak_loss(np.radians([5, 45, 75]))  # doctest: +SKIP
        """
        return 1 - self._peak_response(theta_d)

    @property
    def supported_share(self) -> float:
        """Return the share of the table's entries that are supported (no unit)."""
        return float(self.table["supported"].values[np.isfinite(self.table["brdf"].values)].mean())

    @property
    def determination(self) -> str:
        """Say in a word or two whether the lobe is known.

        It is "determined", "not determined" or "family fails: bent".
        """
        if self.shape.family_fails:
            return "family fails: bent"
        return "determined" if self.fit.determined else "not determined"

    @property
    def verdict(self) -> str:
        """Say in three plain sentences what was found."""
        lost = [
            f"{loss:.0%} at {angle}°" for angle, loss in zip(_ANGLES, self.peak_loss(np.radians(_ANGLES)), strict=True)
        ]
        known = "well determined" if self.fit.determined else "NOT determined by these pictures"
        if self.fit.determined and self.shape.family_fails:
            known = f"determined only if its lobe is {self.fit.family}, which does not explain the data"
        rows = self._grid.index(theta_h=0.0, theta_d=np.radians(np.arange(_ANGLES[0], _ANGLES[-1] + 1)))
        peak = self.table["supported"].values[rows].mean()
        return (
            f"The camera took {', '.join(lost)} of the highlight's peak. The roughness of the surface is {known}. After "
            f"correction the peak is supported (known to 5 %) at {peak:.0%} of the angles up to 75°, and "
            f"{self.supported_share:.0%} of all entries are."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the table, as plain numbers and texts.

        Returns:
            A dictionary that `matcam correct --json` prints. Angles are in rad, and their names say so.
        """
        lost = self.peak_loss(np.radians(_ANGLES))
        return {
            "fit": self.fit.to_dict(),
            "doubts": {doubt.axis.name: doubt.to_dict() for doubt in self.doubts},
            "shape": {"scale": self.shape.scale, "b": self.shape.b},
            "supported_share": self.supported_share,
            "peak_gain_75": float(1 / self._peak_response(np.radians(75.0))),
            "peak_lost": {str(angle): float(loss) for angle, loss in zip(_ANGLES, lost, strict=True)},
            "determination": self.determination,
            "verdict": self.verdict,
            "remarks": [remark.to_dict() for remark in self.remarks],
        }

    def _peak_response(self, theta_d: ArrayLike) -> np.ndarray:
        """Return recorded over true peak, across the plane of incidence."""
        return self.table["response"].values[self._grid.index(theta_h=0.0, theta_d=theta_d, phi_d=np.pi / 2)]

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
    workspace: Workspace | None = None,
) -> xr.Dataset:
    """Correct a whole table for the camera that recorded it.

    A lobe is fitted through the camera, with F free in every slice and a Lambertian part. Then it is bent as far as the data
    ask. Each entry's part above the Lambertian one is multiplied by true over recorded lobe. So the measurement keeps its own
    detail. `Correction.of` does the same and keeps the fits.

    Args:
        brdf: table as from `read_merl`, 1/sr.
        rig: the rig that recorded it: a sphere, a distant camera and a distant lamp.
        ndf: family of the lobe. Default: "auto", the likelier of "ggx" and "epd", as the result is a table and not parameters.
        masking: the lobe's G: "smith", "smith-separable", "van-ginneken" or None. Default: "smith".
        noise: noise of a pixel. Default: None, estimated from the residuals.
        glare: share of light (no unit) that the lens may scatter far beyond what its profile says. Default: 1e-3. It limits
            what is supported beside a highlight; a lens that is known to be clean allows less.
        workspace: keeps what depends on the rig alone for the next call. Default: None, the process's own.

    Returns:
        Dataset over the table's dims. `brdf`, 1/sr: missing stays missing, negative noise becomes 0, reciprocal as the table
        is. `brdf_std`, 1/sr: standard deviation from pixel noise, fitted parameters, stated uncertainty of the camera, shape,
        a free lens or lamp, and glare. It is NaN where the sphere's last pixels show the entry, which is left as it was.
        `supported`: whether brdf_std is under 5 % of brdf. `response`: recorded / true lobe, over the first three dims.

    Raises:
        ArgumentError: an argument is wrong, or the rig is not one that a fit can follow.
        FitError: the table holds nothing to fit.

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
    return Correction.of(brdf, rig, ndf, masking=masking, noise=noise, glare=glare, workspace=workspace).table


def _corrected_table(
    brdf: xr.DataArray,
    found: MaterialFit,
    noise: PixelNoise,
    ratio_of_lobes: LobeRatio,
    scattered: np.ndarray,
    glare: float,
) -> xr.Dataset:
    """Return the corrected table. scattered: most light of the highlight, 1/sr, that glare adds to each entry."""
    data = brdf.values
    body = found.diffuse / np.pi
    seen = seen_cells(sampling_of(brdf))[..., None]
    ratio = np.where(seen, np.exp(ratio_of_lobes.log)[..., None], 1.0)
    above = data - body
    lobe = above > 0
    corrected = np.maximum(np.where(lobe, body + above * ratio, data), 0.0)

    peak = np.nanmax(np.where(np.isfinite(data), data, 0), axis=(0, 2))[None, :, None, :]
    variance = (noise.relative**2 + noise.picture_gain**2) * data**2 + (noise.floor * peak) ** 2
    variance = variance * np.where(lobe, ratio, 1.0) ** 2
    variance += np.where(lobe, above * ratio * ratio_of_lobes.std[..., None], 0.0) ** 2
    variance += (scattered**2 + (glare * data) ** 2) * np.where(lobe, ratio, 1.0) ** 2
    std = np.where(seen & np.isfinite(data), np.sqrt(variance), np.nan)
    # of a bent lobe, the shape's own uncertainty says it
    good = found.is_bent or found.determined or found.hwhm_std < SUPPORTED * found.hwhm
    with np.errstate(invalid="ignore"):
        supported = seen & (std < SUPPORTED * corrected) & good
    first = brdf.dims[:3]
    return xr.Dataset(
        {
            "brdf": (brdf.dims, corrected, {**brdf.attrs, "units": "1/sr", "long_name": "BRDF freed from the camera"}),
            "brdf_std": (brdf.dims, std, {"units": "1/sr", "long_name": "standard deviation of brdf"}),
            "supported": (brdf.dims, supported, {"long_name": "standard deviation under 5 %"}),
            "response": (first, np.exp(-ratio_of_lobes.log), {"long_name": "recorded / true lobe"}),
        },
        coords=brdf.coords,
    )


def _farthest_glare(brdf: xr.DataArray, rig: Rig, found: MaterialFit) -> np.ndarray:
    """Return the most that a halo of any radius, holding all of the highlight's light, could add to an entry, 1/sr.

    A Gaussian of std s adds flux exp(-d^2 / 2 s^2) / (2 pi s^2) at distance d. Its maximum over s is flux / (pi e d^2).
    """
    grid = merl_grid(sampling_of(brdf))
    strength = found.curves["fresnel"].values
    there = np.isfinite(strength).all(axis=1)
    if not there.any():
        raise FitError("no slice of theta_d shows a highlight: there is nothing to correct")
    seen = found.theta_d[there]
    f = np.stack([np.interp(grid.theta_d, seen, column[there]) for column in strength.T], axis=-1)
    radius = sphere_radius(rig)
    th, td, ph = grid.theta_h[:, None, None], grid.theta_d[:, None], grid.phi_d
    x = radius * (np.sin(td) * (np.cos(th) - 1) - np.sin(th) * np.cos(ph) * np.cos(td))
    distance2 = np.maximum(x**2 + (radius * np.sin(th) * np.sin(ph)) ** 2, _NEAREST_GLARE**2)
    # integral of D over normals is about 1: flux = F r^2 / 4
    cos_i = np.maximum(np.cos(th) * np.cos(td) - np.sin(th) * np.sin(td) * np.abs(np.cos(ph)), 0.05)
    return f[None, :, None, :] * (radius**2 / 4 / (np.pi * np.e * distance2 * cos_i))[..., None]


def _correction_remarks(found: MaterialFit, doubts: tuple[Doubt, ...], shape: ShapeCorrection) -> tuple[Remark, ...]:
    """Say what a reader should know of a correction."""
    remarks = list(found.remarks)
    if shape.family_fails:
        remarks.append(shape.remark(found.family))
    return (*remarks, *(doubt.remark for doubt in doubts if doubt.contradicts))
