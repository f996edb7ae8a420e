"""Two explanations of a table: its camera, or free shadowing.

Both fits have a lobe of any smooth shape, and F free in every slice. One models the lobe through the camera, with
Smith's masking, which follows from the lobe. The other has no camera and a free masking (Bagher, Snyder &
Nowrouzezahrai 2016). Both use the same cells and estimate their own noise. Akaike's criterion penalises the parameters
that the data determine (Akaike 1974).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import xarray as xr

from matcam.core.workspace import Workspace
from matcam.forward.pixel_grid import grid_of
from matcam.inverse.fit.fit_setup import FitSetup, free_setup
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.sample_view import sample_view
from matcam.rigs import Rig

_BEND = 1.0
_CLEAR = 10.0
"""Difference of Akaike's criterion beyond which the worse of two models has no support (Burnham & Anderson 2002)."""


class Rival(NamedTuple):
    """One explanation of a table.

    Attributes:
        fit: the fit.
        parameters: number of parameters that the data determine (no unit); those that smoothness determines do not count.
        akaike: 2 parameters - 2 ln likelihood (no unit).
    """

    fit: MaterialFit
    parameters: float
    akaike: float

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as numbers.

        Returns:
            The criterion, and how well the fit explains the data.
        """
        return {
            "parameters": self.parameters,
            "akaike": self.akaike,
            "misfit": self.fit.misfit,
            "degrees_of_freedom": self.fit.freedom,
            "noise": self.fit.noise._asdict(),
        }


class Rivals(NamedTuple):
    """Both explanations of a table, as `rivals` found them.

    Attributes:
        camera: the fit through the camera.
        shadowing: the fit without a camera, with free masking.

    Example:
        >>> found = matcam.rivals(table, matcam.rigs.merl())  # doctest: +SKIP
        >>> found.difference > 0  # doctest: +SKIP
        >>> matcam.inverse.Rivals._fields
        ('camera', 'shadowing')
    """

    camera: Rival
    shadowing: Rival

    @property
    def difference(self) -> float:
        """Return the difference of Akaike's criterion in favour of the camera."""
        return self.shadowing.akaike - self.camera.akaike

    @property
    def verdict(self) -> str:
        """State which explanation is better, and the noise that each requires."""
        noise = (
            f"a pixel's noise would be {self.camera.fit.noise.relative:.2%} with the camera, "
            f"{self.shadowing.fit.noise.relative:.2%} with free shadowing"
        )
        if abs(self.difference) < _CLEAR:
            return f"camera and free shadowing explain the data equally well: {noise}"
        better = "the camera" if self.difference > 0 else "free shadowing"
        return f"{better} explains the data better (Akaike's criterion differs by {abs(self.difference):.0f}): {noise}"

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as numbers and texts.

        Returns:
            A dictionary that `matcam fit --rival --json` prints.
        """
        return {"verdict": self.verdict, "camera": self.camera.to_dict(), "shadowing": self.shadowing.to_dict()}


def rivals(
    brdf: xr.DataArray, rig: Rig, ndf: str = "ggx", *, slice_step: int = 6, workspace: Workspace | None = None
) -> Rivals:
    """Fit a table through its camera, and with free shadowing instead.

    Masking is not an argument, because the two fits differ in it: Smith's or free.

    Args:
        brdf: table as from `read_merl`, 1/sr.
        rig: the rig that recorded it: a sphere; camera and lamp are distant or near.
        ndf: family that both spline-modified lobes start from. Default: "ggx". The choice hardly matters, because the
            splines are free.
        slice_step: spacing of the slices of theta_d that are used (no unit). Default: 6, unlike `fit`, because
            spline-modified lobes are slow to fit and few slices suffice.
        workspace: keeps what depends on the rig alone for the next call. Default: None, that of the process.

    Returns:
        Both fits, with Akaike's criterion of each.

    Raises:
        ArgumentError: an argument is wrong, or the rig is not one that a fit can follow.
        FitError: the table has no values to fit.

    Source:
        Bagher, Snyder & Nowrouzezahrai (2016), free shadowing; Akaike (1974); docs/model.md section 8.

    Example:
        >>> table = matcam.read_merl("chrome.binary")  # doctest: +SKIP
        >>> print(matcam.rivals(table, matcam.rigs.merl()).verdict)  # doctest: +SKIP
        >>> matcam.rivals(np.ones(3), matcam.rigs.merl())
        Traceback (most recent call last):
        ...
        matcam.core.errors.ArgumentError: a BRDF table must be an xarray.DataArray (see read_merl), got ndarray
    """
    setup = free_setup([brdf], rig, slice_step=slice_step, workspace=workspace).with_(ndf=ndf)
    camera = setup.with_(bend=_BEND).solve(start=setup.solve())
    blind = FitSetup(
        (brdf,), None, ndf, fresnel="free", diffuse=True, masking="smith-separable", slice_step=slice_step,
        view=sample_view(setup.rig), pixels=grid_of(setup.rig or rig), workspace=workspace,
    )  # fmt: skip
    shadowing = blind.with_(bend=_BEND, free_masking=True).solve(start=blind.solve(), weights="start")
    return Rivals(_rival(camera), _rival(shadowing))


def _rival(found: MaterialFit) -> Rival:
    parameters = found.effective_parameters()
    return Rival(found, parameters, 2 * parameters - 2 * found.log_likelihood)
