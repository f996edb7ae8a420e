"""Refits in which one parameter of the rig, specified as exact, is free.

If rig and data agree, the result hardly changes. Otherwise the lens, the lamp or the family is wrong, not necessarily the free
parameter. A multiple of the change of the correction is then included in its uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from matcam.core.remark import Remark
from matcam.inverse.fit.fit_setup import FitSetup
from matcam.inverse.fit.material_fit import MaterialFit
from matcam.inverse.rig.rig_axes import LAMP, LENS, Axis, is_guess, known_lens, widths_of
from matcam.rigs import Rig

CONTRADICTION_WEIGHT = 3.0
"""Factor of the change that is included in the uncertainty if rig and data contradict each other. It is above 1 because the
parameter that is wrong may not be the free one.
"""

REFITTED = (LENS, LAMP)
"""Parameters of a rig that are tested by refits: the width of the lens and the radius of the lamp."""

_INSIDE = 0.8
"""Largest coordinate of an accepted solution near the specified value, as a share of the end of the range. The optimum may lie
outside the range for larger coordinates.
"""
_SIGNIFICANT = 4.0
"""Change of a free parameter above which rig and data contradict each other, in standard deviations."""
_NARROWEST_BLUR = 0.02
"""Change of the variance of a lens, px^2, that lobes at their lower bound may cause: three times the largest value found. The
fit of a mirror narrows an exact lens of 0.5 px by 0.006 px^2, because the lobe has at least the smallest width.
"""
_LEAST = 0.002
"""Relative change of the width of the blur up to which rig and data do not contradict each other."""


class RigRefit(NamedTuple):
    """Refit with one parameter of the rig free.

    Attributes:
        axis: free parameter of the rig.
        coordinate: coordinate of the parameter from the data alone, without its prior, within the range of the axis; 0 is the
            specified value.
        value: value of the parameter at this coordinate, px for the lens and rad for the lamp.
        std: standard deviation of `value`, in the same unit.
        contradicts: True if rig and data contradict each other.
        fit: fit with this parameter free.
        weight: weight (no unit) of the change of the correction in its uncertainty; 0 if the covariance of the fit includes
            the parameter.
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
        """Weight of the change in the uncertainty, which is larger if rig and data contradict each other."""
        return self.weight * (CONTRADICTION_WEIGHT if self.contradicts else 1.0)

    @property
    def remark(self) -> Remark:
        scale, unit = (1.0, "px") if self.axis.name == LENS else (float(np.degrees(1.0)), "degrees")
        value, std, base = (scale * one for one in (self.value, self.std, self.axis.base))
        if self.axis.low < self.coordinate < self.axis.high:
            decimals = max(3, 1 - int(np.floor(np.log10(max(std, 1e-9)))))
            gives = f"{value:.{decimals}f} ± {std:.1g}"
        else:
            decimals, gives = 3, f"{'at least' if self.coordinate > 0 else 'at most'} {value:.3f}"
        code, what = ("lens", "lens width") if self.axis.name == LENS else ("lamp", "lamp radius")
        included = f"the {what} is fitted with its specified uncertainty"
        if self.counted:
            included = f"the uncertainty includes {self.counted:g} times the difference"
        return Remark(
            f"{code}-contradicts-data",
            f"a fit with free {what} gives {gives} {unit} instead of {base:.{decimals}f} {unit}; {included}: check the "
            "specified camera, radius of the sample, lamp and family of the lobe",
        )

    def to_dict(self) -> dict[str, Any]:
        return {**self.fit.to_dict(), "contradicts": self.contradicts}


def axes_of_refits(setup: FitSetup, rig: Rig) -> tuple[Axis, ...]:
    """List the parameters of the rig that a fit or one of its refits may change."""
    fitted = [axis.name for axis in setup.prior.axes]
    also = tuple(name for name in REFITTED if name not in fitted and _is_there(name, rig))
    return setup.with_(also=also, nearby=True).prior.axes


def rig_refits(setup: FitSetup, rig: Rig, found: MaterialFit, names: Sequence[str] = REFITTED) -> tuple[RigRefit, ...]:
    """Refit with each of several parameters of the rig free.

    A parameter with a prior is already fitted, and no refit is required.

    Args:
        setup: setup of `found`.
        rig: rig that recorded the table.
        found: fit with the specified rig.
        names: names of the parameters. Default: REFITTED.
    """
    refits = []
    for name in names:
        if name in [axis.name for axis in found.coordinates.axes]:
            refits.append(_fitted_refit(found, name, rig))
        elif _is_there(name, rig):
            refits.append(_followed_refit(setup.with_(also=(name,)), found, name))
    if not found.resolved:  # a lobe at its lower bound biases the width of the lens
        return tuple(_with_any_lens(refit, setup, rig) if refit.axis.name == LENS else refit for refit in refits)
    return tuple(refits)


def _is_there(name: str, rig: Rig) -> bool:
    return name in widths_of(rig) or name in rig.camera.parameters()


def _with_any_lens(refit: RigRefit, setup: FitSetup, rig: Rig) -> RigRefit:
    """Test the width of the lens for a lobe that is too narrow to be resolved.

    A lens that is specified as too wide explains the whole highlight, so that no width remains for the lobe. Rig and data
    contradict each other only if a fit of any lens and any lobe resolves the lobe, with a clearly different lens.
    """
    known = known_lens(rig.camera).uncertainty
    relative = (known.std()[LENS] if known and LENS in known.names else 0.0) / refit.axis.base
    if is_guess(LENS, relative):
        return refit
    free = _free_refit(setup.with_(camera_parameters="free", free=(LENS,), also=()).solve(), LENS)
    limit = max(_SIGNIFICANT * np.hypot(free.std / free.axis.base, relative), _LEAST)
    clear = abs(free.value**2 - free.axis.base**2) > _NARROWEST_BLUR
    wrong = clear and free.fit.resolved and abs(free.value / free.axis.base - 1) > limit
    return (free if wrong else refit)._replace(weight=refit.weight, contradicts=bool(wrong))


def _followed_refit(free: FitSetup, found: MaterialFit, name: str) -> RigRefit:
    """Refit with a parameter free near its specified value, or in its whole range if the data require a distant value."""
    refit = _free_refit(free.with_(nearby=True).solve(start=found, weights="start"), name)
    axis, whole = refit.axis, next(axis for axis in free.prior.axes if axis.name == name)
    ends = [own for own, far in ((axis.low, whole.low), (axis.high, whole.high)) if own != far]
    if all(abs(refit.coordinate) < _INSIDE * abs(end) or refit.coordinate * end < 0 for end in ends):
        return refit
    return _free_refit(free.solve(start=found, weights="start"), name)


def _free_refit(fit: MaterialFit, name: str) -> RigRefit:
    at = fit.coordinates
    position = [axis.name for axis in at.axes].index(name)
    own = len(at.lobe) + position
    coordinate, std = float(at.rig[position]), float(np.sqrt(at.covariance[own, own]))
    contradicts = bool(abs(coordinate) > max(_SIGNIFICANT * std, _LEAST))
    return RigRefit(at.axes[position], coordinate, fit.params[name], fit.std[name], contradicts, fit, weight=1.0)


def _fitted_refit(fit: MaterialFit, name: str, rig: Rig) -> RigRefit:
    """Compare the prior of a fitted parameter with its estimate from the data alone."""
    at = fit.coordinates
    position = [axis.name for axis in at.axes].index(name)
    own = len(at.lobe) + position
    axis, coordinate, variance = at.axes[position], float(at.rig[position]), float(at.covariance[own, own])
    known = known_lens(rig.camera).uncertainty
    relative = (known.std()[name] if known else 0.0) / axis.base
    if is_guess(name, relative):  # no exact value that the data could contradict
        return RigRefit(axis, coordinate, fit.params[name], fit.std[name], False, fit, weight=0.0)
    stated = axis.std(relative)
    # a smaller relative difference from the information of the prior is due to the tolerance of the fit, not to the data
    by_data = float(np.sqrt(1 / max(1 / variance - 1 / stated**2, 1e-6 / stated**2)))
    likeliest = coordinate * by_data**2 / variance
    contradicts = abs(likeliest) > _SIGNIFICANT * np.hypot(by_data, stated)
    inside = float(np.clip(likeliest, axis.low, axis.high))
    std = axis.slope(inside, stated) * by_data
    return RigRefit(axis, inside, axis.value(inside), std, bool(contradicts), fit, weight=0.0)
