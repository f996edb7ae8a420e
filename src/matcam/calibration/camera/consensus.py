"""Selection of the edges that agree with each other, and check of their number.

Any image contains edges, for example of a printed page or a shadow. A single such edge does not determine a camera. Edges
whose blur differs from that of the others, or whose levels are impossible, are excluded. Enough edges must remain to
verify that they agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from matcam.calibration.edge.edge_result import EdgeStack
from matcam.core.errors import FitError
from matcam.core.remark import Remark
from matcam.numerics.normal import SIGNIFICANT, robust_std

FEWEST_EDGES = 8
"""Smallest number of edges for a camera. Fewer edges are not sufficient to verify that they agree."""
_APART = np.radians(20.0)
"""Smallest angle between the directions of two edges of a camera, rad."""
_PROCESSED = 0.3
"""Share of sharpened, crushed or saturated edges above which the others are assumed to be processed as well."""
_LEAST = 0.5
"""Smallest deviation of ln sigma for which an edge is excluded: variation over the field."""
_IMPOSSIBLE = 0.5
"""Negative dark level, relative to the step, beyond which an edge is excluded."""


def in_consensus(stacks: Sequence[EdgeStack]) -> list[EdgeStack]:
    """Mark the edges that do not agree with the others as problems."""
    good = [stack.good for stack in stacks]
    counts = [which.size for which in good]
    if not sum(counts):
        return list(stacks)
    value = np.concatenate([np.log(s.parametric.values[g, 0]) for s, g in zip(stacks, good, strict=True)])
    variance = np.concatenate([s.parametric.covariance[g, 0, 0] for s, g in zip(stacks, good, strict=True)])
    std = np.sqrt(variance) / np.exp(value)
    middle = np.median(value)
    scatter = robust_std(value - middle)
    far = np.abs(value - middle) > np.maximum(SIGNIFICANT * np.hypot(std, scatter), _LEAST)
    result = []
    for stack, which, off in zip(stacks, good, np.split(far, np.cumsum(counts)[:-1]), strict=True):
        impossible = stack.dark[which] < -_IMPOSSIBLE * (stack.bright[which] - stack.dark[which])
        problems = list(stack.problems)
        for i, blurred, wrong in zip(which, off, impossible, strict=True):
            if blurred or wrong:
                text = "its dark level is negative" if wrong else "its blur differs from that of the other edges"
                problems[i] = Remark("no-consensus", text)
        result.append(replace(stack, problems=tuple(problems)))
    return result


def refuse_too_few(stacks: Sequence[EdgeStack], channel: str, *, accept_sharpened: bool) -> None:
    """Raise FitError if the edges are too few, too parallel, or often processed.

    The check applies if edges are the only measurements. `accept_sharpened`: whether sharpened edges are treated as good.
    """
    codes = [problem.code if problem else "" for stack in stacks for problem in stack.problems]
    good, processed = codes.count(""), codes.count("saturated")
    processed += codes.count("crushed")
    processed += 0 if accept_sharpened else codes.count("sharpened")
    if processed > _PROCESSED * (good + processed):
        raise FitError(
            f"channel {channel}: {processed} of {good + processed} edges are sharpened or saturated, or have crushed blacks: "
            "this is a processed or overexposed image, whose MTF is not that of the lens; use camera raw, and expose less"
        )
    if good < FEWEST_EDGES:
        raise FitError(
            f"channel {channel}: {good} good edges are too few for a camera, which requires {FEWEST_EDGES} in two directions: "
            "photograph a chart of slanted squares (matcam chart), or measure one edge with matcam edge"
        )
    angle = np.concatenate([stack.angle[stack.good] for stack in stacks])
    off = widest_angle(angle)
    if off < _APART:
        raise FitError(
            f"channel {channel}: all {good} edges lie within {np.degrees(off):.0f} degrees: a camera requires edges in two "
            "directions"
        )


def widest_angle(angle: np.ndarray) -> float:
    """Compute the largest angle between any two of n axes, rad, at most pi / 2.

    Not all pairs are compared, because the axis at the largest angle to a given axis is next to its perpendicular.
    """
    turned = np.sort(angle % np.pi)
    beyond = np.searchsorted(turned, (angle + np.pi / 2) % np.pi)
    beside = turned[np.stack([beyond - 1, beyond % turned.size])]
    return float(np.abs((angle - beside + np.pi / 2) % np.pi - np.pi / 2).max())


def disagreement_remarks(disagreeing: Mapping[str, float], channel: str) -> tuple[Remark, ...]:
    """Describe the targets that were excluded, with one remark for each kind of target.

    `disagreeing`: relative difference of the blur by name; a name ends with the kind in brackets.
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
    """Format a relative difference; above 100 % its linear estimate is not valid."""
    return (
        f"{difference:+.0%}"
        if abs(difference) <= 1
        else f"{'more' if difference > 0 else 'less'} than {np.sign(difference):+.0f}00%"
    )
