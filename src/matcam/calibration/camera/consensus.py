"""Selection of the edges that agree with each other, and a check of their number.

Any image contains edges, for example of a printed page or a shadow. A single such edge does not determine a camera. Edges
whose blur differs from that of the others, or whose levels are impossible, are excluded. Enough edges must remain to
verify that they agree.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from matcam.calibration.edge.edge_result import EdgeStack
from matcam.core.errors import FitError
from matcam.core.remark import Remark, some_of
from matcam.numerics.normal import SIGNIFICANT, robust_std

FEWEST_EDGES = 8
"""Smallest number of edges for a camera. Fewer edges are not sufficient to verify that they agree."""
_APART = np.radians(20.0)
"""Angle that two edges of a camera must enclose at least, rad. Parallel edges determine the MTF in one direction only."""


def in_consensus(stacks: Sequence[EdgeStack]) -> list[EdgeStack]:
    """Record a problem for each edge that does not agree with the others."""
    known = np.log(np.concatenate([stack.parametric.values[stack.good, 0] for stack in stacks] or [np.zeros(0)]))
    if not known.size:
        return list(stacks)
    middle = np.median(known)
    scatter = robust_std(known - middle)
    result = []
    for stack in stacks:
        sigma = stack.parametric.values[:, 0]
        std = np.sqrt(stack.parametric.covariance[:, 0, 0]) / sigma
        # The blur may vary over the field by up to 0.5 in ln sigma. A dark level below -0.5 times the step is impossible.
        far = np.abs(np.log(sigma) - middle) > np.maximum(SIGNIFICANT * np.hypot(std, scatter), 0.5)
        impossible = stack.dark < -0.5 * (stack.bright - stack.dark)
        reasons = np.where(far, "its blur differs from that of the other edges", "")
        reasons = np.where(impossible, "its dark level is negative", reasons).tolist()
        problems = [
            problem or (Remark("no-consensus", reason) if reason else None)
            for problem, reason in zip(stack.problems, reasons, strict=True)
        ]
        result.append(replace(stack, problems=tuple(problems)))
    return result


def refuse_too_few(
    stacks: Sequence[EdgeStack], channel: str, without: Collection[str], *, accept_sharpened: bool
) -> None:
    """Raise FitError if the edges are too few, too parallel, or often processed.

    The check applies if edges are the only measurements. `without` contains the names of the images without good edges. If
    `accept_sharpened` is True, sharpened edges are not counted as processed.
    """
    codes = [problem.code if problem else "" for stack in stacks for problem in stack.problems]
    good, processed = codes.count(""), codes.count("saturated")
    processed += codes.count("crushed")
    processed += 0 if accept_sharpened else codes.count("sharpened")
    # If more than 30 % of the edges show processing, the others are assumed to be processed as well.
    if processed > 0.3 * (good + processed):
        raise FitError(
            f"channel {channel}: {processed} of {good + processed} edges are sharpened or saturated, or have crushed blacks: "
            "this is a sign of processed or overexposed images, whose MTF is not that of the lens; use camera raw, and expose "
            "less"
        )
    if good < FEWEST_EDGES:
        none = f"; none are in {some_of(without)}" if good and without else ""
        raise FitError(
            f"channel {channel}: the number of good edges is {good}, but a camera requires at least {FEWEST_EDGES} in two "
            f"directions{none}: photograph a chart of slanted squares (matcam chart), or measure one edge with matcam edge"
        )
    angle = np.concatenate([stack.angle[stack.good] for stack in stacks])
    off = widest_angle(angle)
    if off < _APART:
        raise FitError(
            f"channel {channel}: the directions of all {good} edges differ by at most {np.degrees(off):.0f} degrees: add "
            f"edges, because a camera requires two directions at least {np.degrees(_APART):.0f} degrees apart"
        )


def widest_angle(angle: np.ndarray) -> float:
    """Compute the largest angle between any two of n axes, rad, at most pi / 2.

    Not all pairs are compared. In the order of the angles, the axis at the largest angle to a given axis is next to the
    perpendicular of that axis.
    """
    turned = np.sort(angle % np.pi)
    beyond = np.searchsorted(turned, (angle + np.pi / 2) % np.pi)
    beside = turned[np.stack([beyond - 1, beyond % turned.size])]
    return float(np.abs((angle - beside + np.pi / 2) % np.pi - np.pi / 2).max())


def disagreement_remarks(disagreeing: Mapping[str, float], channel: str) -> tuple[Remark, ...]:
    """Create one remark for each kind of target that was excluded.

    `disagreeing` contains the relative difference of the blur, by the name of each excluded group. A name ends with the kind
    in brackets.
    """
    kinds: dict[str, dict[str, float]] = {}
    for name, off in disagreeing.items():
        kinds.setdefault(name.rpartition(" (")[2].rstrip(")"), {})[name] = off
    remarks = []
    for kind, names in kinds.items():
        low, high = (_as_share(end) for end in (min(names.values()), max(names.values())))
        first = next(iter(names))
        if len(names) == 1:
            text = f"the blur of {first} differs by {low} from that of the edges: it was excluded"
        else:
            text = f"the blurs of {len(names)} targets of one kind ({kind}) differ by {low} to {high} from that of the edges"
            text += f": {first} and {len(names) - 1} more were excluded"
        remarks.append(Remark("target-disagrees", f"{channel}: {text}"))
    return tuple(remarks)


def _as_share(difference: float) -> str:
    """Format a relative difference. Above 100 %, only a bound is given, because the linear estimate is not valid."""
    return (
        f"{difference:+.0%}"
        if abs(difference) <= 1
        else f"{'more' if difference > 0 else 'less'} than {np.sign(difference):+.0f}00%"
    )
