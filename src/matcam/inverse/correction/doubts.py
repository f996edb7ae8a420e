"""Doubts about the rig: the fit again, with a parameter of the rig free that the user took for certain.

If rig and data agree, nothing changes. If not, something is wrong: lens, lamp or family. It need not be the parameter that was
left free. What the correction would have been with it counts as uncertainty, several times over.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from matcam.camera.uncertainty import Uncertainty
from matcam.core.remark import Remark
from matcam.inverse.fit.fit_setup import FitSetup
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.rig_axes import LAMP, LENS, Axis
from matcam.rigs import Rig

CONTRADICTION_WEIGHT = 3.0
"""How often the change counts where rig and data contradict each other."""

_SIGNIFICANT = 4.0
"""Standard deviations by which a free parameter has to move for that, and"""
_LEAST = 0.002
"""the relative change of the blur's width."""


class Doubt(NamedTuple):
    """Hold what the data say of one parameter of the rig that was left free.

    Attributes:
        axis: the parameter.
        coordinate: where the data put it; 0 is the rig's value.
        value: the parameter there, in its own unit.
        std: standard deviation of `value`.
        contradicts: whether rig and data contradict each other.
        fit: the fit with the parameter free.
    """

    axis: Axis
    coordinate: float
    value: float
    std: float
    contradicts: bool
    fit: MaterialFit

    @property
    def weight(self) -> float:
        """Return how often the change that it makes counts as uncertainty."""
        return CONTRADICTION_WEIGHT if self.contradicts else 1.0

    @property
    def remark(self) -> Remark:
        """Say what a reader should know of it."""
        if self.axis.name == LENS:
            code = "lens-contradicts-data"
            found = (
                f"left free, the lens would be {self.value:.3f} +- {self.std:.1g} px instead of {self.axis.base:.3f} px"
            )
        else:
            code = "lamp-contradicts-data"
            radius, std, base = (float(np.degrees(v)) for v in (self.value, self.std, self.axis.base))
            found = f"left free, the lamp's radius would be {radius:.3f} +- {std:.1g} degrees instead of {base:.3f}"
        return Remark(
            code,
            f"{found}: camera, lamp or family contradict the data; {CONTRADICTION_WEIGHT:g} times the difference counts "
            "as uncertainty",
        )

    def to_dict(self) -> dict[str, Any]:
        """Return its fit as plain numbers and texts, and whether it contradicts the rig."""
        return {**self.fit.to_dict(), "contradicts": self.contradicts}


def rig_doubts(setup: FitSetup, rig: Rig, found: MaterialFit) -> tuple[Doubt, ...]:
    """Leave the lens's width and the lamp's radius free, one after the other. found: the solution of `setup`."""
    exact = eqx.tree_at(lambda r: r.camera.uncertainty, rig, None, is_leaf=lambda x: x is None)
    free = setup.with_(rig=exact, camera_parameters="free")
    names = [LENS] if LENS in rig.camera.parameters() else []
    return tuple(
        _doubt(free.with_(free=(name,)).solve(start=found, weights="start"), name, rig) for name in (*names, LAMP)
    )


def _doubt(fit: MaterialFit, name: str, rig: Rig) -> Doubt:
    at = fit.coordinates
    (axis,), (coordinate,) = at.axes, at.rig.tolist()
    variance = float(at.covariance[-1, -1])
    uncertainty = rig.camera.uncertainty
    if isinstance(uncertainty, Uncertainty) and axis.base > 0:
        stated = uncertainty.std().get(name, 0.0)
        variance += (axis.base * stated / (axis.base**2 + axis.softening**2)) ** 2
    contradicts = abs(coordinate) > max(_SIGNIFICANT * np.sqrt(variance), _LEAST)
    return Doubt(axis, coordinate, fit.params[name], fit.std[name], bool(contradicts), fit)
