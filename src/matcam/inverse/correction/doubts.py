"""What else could have blurred the pictures: the fit again, with a number of the rig free that the user took for certain.

If rig and data agree, nothing changes. If not, something is wrong - lens, lamp or family - and it need not be the number that
was freed: what the correction would have been with it counts as uncertainty, several times over.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np
import xarray as xr

from matcam.camera.sensor import PixelNoise
from matcam.camera.uncertainty import Uncertainty
from matcam.inverse.fit.candidates import freed
from matcam.inverse.fit.fit_result import MaterialFit
from matcam.inverse.operator.rig_axes import LAMP, LENS, Axis
from matcam.rigs import Rig

DOUBT = 3.0
"""How often the change counts where rig and data contradict each other."""

_SIGNIFICANT = 4.0
"""Standard deviations by which a freed number has to move for that, and"""
_LEAST = 0.002
"""the relative change of the blur's width."""


class Doubt(NamedTuple):
    """One number of the rig, left free. fit: with it."""

    axis: Axis
    coordinate: float
    """Where the data put it; 0 is the rig's value."""
    value: float
    std: float
    contradicts: bool
    """Whether rig and data contradict each other."""
    fit: MaterialFit

    @property
    def weight(self) -> float:
        """How often the change that it makes counts as uncertainty."""
        return DOUBT if self.contradicts else 1.0

    @property
    def remark(self) -> str:
        """What a reader should know of it, in plain words."""
        if self.axis.name == LENS:
            found = (
                f"left free, the lens would be {self.value:.3f} +- {self.std:.1g} px instead of {self.axis.base:.3f} px"
            )
        else:
            radius, std, base = (float(np.degrees(v)) for v in (self.value, self.std, self.axis.base))
            found = f"left free, the lamp's radius would be {radius:.3f} +- {std:.1g} degrees instead of {base:.3f}"
        return (
            f"{found}: camera, lamp or family contradict the data; {DOUBT:g} times the difference counts as uncertainty"
        )


def doubts(found: MaterialFit, brdf: xr.DataArray, rig: Rig, noise: PixelNoise | None, every: int) -> tuple[Doubt, ...]:
    """The lens's width and the lamp's radius, each left free. found: a fit of `brdf` to every `every`-th slice."""
    exact = eqx.tree_at(lambda r: r.camera.uncertainty, rig, None, is_leaf=lambda x: x is None)
    names = [LENS] if LENS in rig.camera.parameters() else []
    return tuple(_doubt(freed(found, brdf, exact, name, noise, every), name, rig) for name in (*names, LAMP))


def _doubt(fit: MaterialFit, name: str, rig: Rig) -> Doubt:
    (axis,) = fit.prior.axes
    place = fit.problem.layout.camera.start
    coordinate, variance = float(fit.solved.p[place]), float(fit.solved.covariance[place, place])
    known = rig.camera.uncertainty
    if isinstance(known, Uncertainty) and axis.base > 0:
        stated = known.std().get(name, 0.0)
        variance += (axis.base * stated / (axis.base**2 + axis.softening**2)) ** 2
    contradicts = abs(coordinate) > max(_SIGNIFICANT * np.sqrt(variance), _LEAST)
    return Doubt(axis, coordinate, fit.params[name], fit.std[name], bool(contradicts), fit)
