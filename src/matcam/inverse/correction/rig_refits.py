"""Refits with one exact parameter of the rig free.

If rig and data agree, the result does not change. Otherwise lens, lamp or family is wrong, not necessarily the free
parameter. The change of the correction then counts several times as uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from matcam.core.remark import Remark
from matcam.inverse.fit.fit_setup import FitSetup
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.operator.rig_axes import LAMP, LENS, Axis, is_guess, known_lens, widths_of
from matcam.rigs import Rig

CONTRADICTION_WEIGHT = 3.0
"""Factor of the change as uncertainty where rig and data contradict each other."""

REFITTED = (LENS, LAMP)
"""Exact parameters of a rig that are tested: the width of the lens and the radius of the lamp."""

_INSIDE = 0.8
"""Share of the half range of an axis up to which a nearby solution is accepted; beyond it the optimum may lie outside."""
_SIGNIFICANT = 4.0
"""Standard deviations by which a free parameter must move to contradict the rig."""
_LEAST = 0.002
"""Smallest relative change of the width of the blur that contradicts the rig."""


class RigRefit(NamedTuple):
    """Refit with one parameter of the rig free.

    Attributes:
        axis: the parameter.
        coordinate: fitted coordinate; 0 is the value of the rig.
        value: the parameter there, in its own unit.
        std: standard deviation of `value`.
        contradicts: whether rig and data contradict each other.
        fit: the fit with the parameter free.
        weight: factor of its change as uncertainty; 0 where the covariance of the fit includes it.
    """

    axis: Axis
    coordinate: float
    value: float
    std: float
    contradicts: bool
    fit: MaterialFit
    weight: float

    @property
    def counted(self) -> float:
        """Return the factor of the change as uncertainty."""
        return self.weight * (CONTRADICTION_WEIGHT if self.contradicts else 1.0)

    @property
    def remark(self) -> Remark:
        """State the fitted value, and whether it contradicts the rig."""
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
        """Return the fit as numbers and texts, with its contradiction flag."""
        return {**self.fit.to_dict(), "contradicts": self.contradicts}


def rig_refits(setup: FitSetup, rig: Rig, found: MaterialFit, names: Sequence[str] = REFITTED) -> tuple[RigRefit, ...]:
    """Fit with parameters of the rig free, one after the other. found: the solution of `setup`.

    For a width with a prior, the fit that exists is used.
    """
    refits = []
    for name in names:
        if name in [axis.name for axis in found.coordinates.axes]:
            refits.append(_fitted_refit(found, name, rig))
        elif name in widths_of(rig) or name in rig.camera.parameters():
            refits.append(_followed_refit(setup.with_(also=(name,)), found, name))
    if not found.resolved:  # a lobe at its bound biases the lens
        return tuple(refit._replace(contradicts=refit.contradicts and refit.axis.name != LENS) for refit in refits)
    return tuple(refits)


def _followed_refit(free: FitSetup, found: MaterialFit, name: str) -> RigRefit:
    """Refit with a parameter free near its value, and over its whole range if the data require it."""
    refit = _free_refit(free.with_(nearby=True).solve(start=found, weights="start"), name)
    axis, whole = refit.axis, next(axis for axis in free.prior.axes if axis.name == name)
    ends = [own for own, far in ((axis.low, whole.low), (axis.high, whole.high)) if own != far]
    if all(abs(refit.coordinate) < _INSIDE * abs(end) or refit.coordinate * end < 0 for end in ends):
        return refit
    return _free_refit(free.solve(start=found, weights="start"), name)


def _free_refit(fit: MaterialFit, name: str) -> RigRefit:
    """Refit with a parameter free that the rig gives as exact."""
    at = fit.coordinates
    position = [axis.name for axis in at.axes].index(name)
    own = len(at.lobe) + position
    coordinate, std = float(at.rig[position]), float(np.sqrt(at.covariance[own, own]))
    contradicts = bool(abs(coordinate) > max(_SIGNIFICANT * std, _LEAST))
    return RigRefit(at.axes[position], coordinate, fit.params[name], fit.std[name], contradicts, fit, weight=1.0)


def _fitted_refit(fit: MaterialFit, name: str, rig: Rig) -> RigRefit:
    """Compare a parameter that has a prior with its estimate from the data alone."""
    at = fit.coordinates
    position = [axis.name for axis in at.axes].index(name)
    own = len(at.lobe) + position
    axis, coordinate, variance = at.axes[position], float(at.rig[position]), float(at.covariance[own, own])
    known = known_lens(rig.camera).uncertainty
    relative = (known.std()[name] if known else 0.0) / axis.base
    if is_guess(name, relative):  # no exact value that the data could contradict
        return RigRefit(axis, coordinate, fit.params[name], fit.std[name], False, fit, weight=0.0)
    by_data = 1 / max(1 / variance - 1 / relative**2, 1e-9)
    likeliest = coordinate * by_data / variance
    contradicts = abs(likeliest) > _SIGNIFICANT * np.hypot(np.sqrt(by_data), relative)
    return RigRefit(axis, coordinate, fit.params[name], fit.std[name], bool(contradicts), fit, weight=0.0)
