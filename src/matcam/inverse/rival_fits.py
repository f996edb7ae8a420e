"""Comparison of two explanations of a table: by its camera, or by free shadowing.

Both are explanations as in `correct` (`inverse/correction/explanation.py`), with F free in every slice. The first is the
most probable lobe through the camera. The second is a lobe of any smooth shape for each channel, without a camera and with
free masking (Bagher, Snyder & Nowrouzezahrai 2016). Both are fitted to the same cells and compared by their evidence.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from matcam.core import checks
from matcam.core.grid import checked_table
from matcam.core.workspace import Workspace, default_workspace
from matcam.inverse.correction.evidence import Weighing
from matcam.inverse.correction.explanation import PROBABLE, Member, explain, first_setup, with_free_masking
from matcam.inverse.fit.fit_data import SEARCH_STEP, noise_text
from matcam.inverse.fit.fit_parameters import FAMILIES
from matcam.inverse.fit.fit_setup import AUTO
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.lobe_operator import check_rig
from matcam.inverse.operator.pixel_phase import located_rig
from matcam.inverse.saturated_values import without_saturated
from matcam.rigs import Rig


class Rival(NamedTuple):
    """Fit of one explanation of a table, with its evidence.

    Attributes:
        fit: the fit.
        log_evidence: natural logarithm of the marginal likelihood, no unit, see `inverse/correction/evidence.py`.
    """

    fit: MaterialFit
    log_evidence: float

    def to_dict(self) -> dict[str, Any]:
        """Convert the fit to a dictionary of JSON types.

        Returns:
            Dictionary with the logarithm of the evidence, and misfit, degrees of freedom and noise of the fit.
        """
        return {
            "log_evidence": self.log_evidence,
            "misfit": self.fit.misfit,
            "degrees_of_freedom": self.fit.freedom,
            "noise": self.fit.noise._asdict(),
        }


class Rivals(NamedTuple):
    """Comparison of two explanations of a table; result of `rivals`.

    Attributes:
        camera: fit through the camera.
        shadowing: fit without a camera, with free masking.

    Example:
        >>> found = matcam.rivals(table, matcam.rigs.merl())  # doctest: +SKIP
        >>> found.probability > 0.95  # doctest: +SKIP
        >>> matcam.inverse.Rivals._fields
        ('camera', 'shadowing')
    """

    camera: Rival
    shadowing: Rival

    @property
    def probability(self) -> float:
        """Probability of the explanation by the camera, no unit.

        Both explanations have equal prior probability.
        """
        difference = self.camera.log_evidence - self.shadowing.log_evidence
        return float(1 / (1 + np.exp(np.clip(-difference, -500, 500))))

    @property
    def verdict(self) -> str:
        """Text with the better explanation and the pixel noise of both."""
        noise = (
            f"the noise of a pixel would be {noise_text(self.camera.fit.noise, 2)} with the camera and "
            f"{noise_text(self.shadowing.fit.noise, 2)} with free shadowing"
        )
        if PROBABLE > self.probability > 1 - PROBABLE:
            return f"camera and free shadowing explain the data equally well: {noise}"
        better = "the camera" if self.probability > PROBABLE else "free shadowing"
        apart = abs(self.camera.log_evidence - self.shadowing.log_evidence)
        return f"{better} explains the data better (the logarithm of the evidence is larger by {apart:.0f}): {noise}"

    def to_dict(self) -> dict[str, Any]:
        """Convert the comparison to a dictionary of numbers and strings.

        Returns:
            The dictionary that `matcam fit --rival --json` prints.
        """
        return {
            "verdict": self.verdict,
            "probability_of_camera": self.probability,
            "camera": self.camera.to_dict(),
            "shadowing": self.shadowing.to_dict(),
        }


def rivals(
    brdf: xr.DataArray, rig: Rig, ndf: str = AUTO, *, slice_step: int = SEARCH_STEP, workspace: Workspace | None = None
) -> Rivals:
    """Compare a fit through the camera with a fit of free shadowing.

    The first is the most probable lobe through the camera, with Smith's masking. The second is a spline-modified lobe without
    a camera, with free masking.

    Args:
        brdf: table, 1/sr, for example from `read_merl`.
        rig: rig that recorded the table, with a sphere or a cylinder; camera and lamp are distant or near.
        ndf: family of the lobe. Default: "auto", the same explanations as in `correct`.
        slice_step: spacing of the slices of theta_d that are used (no unit). Default: 6, unlike `fit`, because few slices
            suffice.
        workspace: store of results that depend only on the rig. Default: None, the store of the process.

    Returns:
        Both fits, with the evidence of each.

    Raises:
        ArgumentError: an argument is wrong, or a fit does not support the rig.
        FitError: the table does not have enough values to fit, the cells contradict the rig, or a fit produced non-finite
            parameters.

    Source:
        Bagher, Snyder & Nowrouzezahrai (2016), free shadowing; MacKay (2003), chapter 28; docs/model.md section 8.

    Example:
        >>> table = matcam.read_merl("chrome.binary")  # doctest: +SKIP
        >>> print(matcam.rivals(table, matcam.rigs.merl()).verdict)  # doctest: +SKIP
        >>> matcam.rivals(np.ones(3), matcam.rigs.merl())
        Traceback (most recent call last):
        ...
        matcam.core.errors.ArgumentError: a BRDF table must be an xarray.DataArray (see read_merl), got ndarray
    """
    brdf = checked_table(brdf)
    check_rig(rig)
    checks.choice("ndf", ndf, (AUTO, *FAMILIES))
    workspace = checks.instance("workspace", default_workspace() if workspace is None else workspace, Workspace)
    brdf, _ = without_saturated(brdf, rig)
    located = located_rig(rig, brdf)
    setup = first_setup(brdf, located.rig, masking="smith", noise=None, workspace=workspace, slice_step=slice_step)
    explained = explain(setup, located, ndf)
    camera = Member(explained.setup, explained.fit)
    both = camera.fit, with_free_masking(camera, located.rig).fit
    weighing = Weighing.of(both, explained.weighing.noise if explained.weighing.known else None)
    return Rivals(*(Rival(fit, weighing.log_evidence(fit)) for fit in both))
