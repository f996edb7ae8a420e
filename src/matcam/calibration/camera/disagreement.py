"""Exclusion of measurements that disagree with the blur of the edges, and the uncertainty due to the disagreement.

Noise does not explain significant differences between kinds of targets, or a wrong shape of the model MTF. Their cause is the
print, the tone curve or the lens model. The same cause may also change the measured blur of the edges.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from matcam.calibration.camera.evidence import MeanCurve
from matcam.calibration.camera.joint_fit import JointFit, Measurements
from matcam.core.errors import FitError
from matcam.core.remark import Remark
from matcam.numerics.normal import SIGNIFICANT


def without_disagreeing(
    measurements: Measurements, fit: Callable[[Measurements], JointFit], channel: str
) -> tuple[JointFit, dict[str, float]]:
    """Fit without the targets that contradict the edges of their chart.

    The second result is the relative difference of the blur of each excluded group, by name. A FitError is raised if
    measurements contradict one another, and no edges determine which measurements are wrong. `channel` is the name of the
    colour for the message.
    """
    groups, replaceable, disagreeing = measurements.groups, measurements.replaceable, dict[str, float]()
    while True:
        fitted = fit(measurements.without(disagreeing))
        candidates = replaceable - disagreeing.keys()
        off = fitted.differences(groups, set(groups) - candidates)
        # Targets of a chart whose blur differs significantly, and by more than 3 %, from that of its edges are excluded.
        more = {k: d for k, (d, std) in off.items() if k in candidates and abs(d) > max(0.03, SIGNIFICANT * std)}
        if not more:
            off = fitted.differences(groups, groups)
            name, (difference, std) = max(off.items(), key=lambda one: abs(one[1][0]), default=("", (0.0, 0.0)))
            # Other measurements that differ significantly, and by more than 10 %, are contradictory.
            if abs(difference) < max(0.1, SIGNIFICANT * std):
                return fitted, disagreeing
            if name not in candidates:
                others = [other for other in off if other != name]
                text = f"the blur of {name} differs by {difference:+.0%} from that of {', '.join(others[:2])}"
                text += f" and {len(others) - 2} more" if len(others) > 2 else ""
                raise FitError(
                    f"channel {channel}: the measurements are contradictory: {text}; omit the wrong measurements"
                )
            more = {name: difference}
        disagreeing |= more


def blur_disagreement(
    groups: Sequence[str], disagreeing: Mapping[str, float], curve: MeanCurve, slope: np.ndarray
) -> float:
    """Estimate the relative standard deviation of the blur due to measurements that disagree with the fit.

    Args:
        groups: image and kind of every measurement; a name ends with the kind in brackets.
        disagreeing: relative difference of the blur from the fit, by the name of each group that was excluded.
        curve: mean MTF of the edges and of the camera.
        slope: derivative of the MTF of the camera with respect to ln(blur), at the frequencies of `curve` (81,).
    """
    of_kind: dict[str, list[float]] = {}
    for name in dict.fromkeys(groups):
        of_kind.setdefault(name.rpartition(" (")[2], []).append(disagreeing.get(name, 0.0))
    # a single target may be damaged; one kind of target is described or printed like the other kinds
    kinds = [float(np.median(differences)) for differences in of_kind.values()]
    variance = sum(one**2 for one in kinds) / max(len(kinds) - 1, 1)
    if not curve.consistent:
        variance += (curve.misfit[0] / float(np.abs(slope[curve.frequency <= 0.5]).max())) ** 2
    return float(np.sqrt(variance))


def widened_remarks(share: float, channel: str) -> tuple[Remark, ...]:
    if not share:
        return ()
    text = (
        f"measurements or model disagree with the edges, so ±{share:.1%} is added to the standard deviation of the blur"
    )
    return (Remark("disagreement", f"{channel}: {text}"),)
