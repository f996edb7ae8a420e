"""Selection of the edges that agree with each other, and the check that they are enough.

Any image has edges, for example of a printed page or a shadow. A single such edge does not determine a camera. Edges
whose blur differs from that of all others, or whose levels are impossible, are left out. The remaining edges must be
enough to check their agreement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from matcam.calibration.edge.edge_result import EdgeStack
from matcam.core.errors import FitError
from matcam.core.remark import Remark
from matcam.numerics.normal import robust_std

FEWEST_EDGES = 8
_APART = np.radians(20.0)  # smallest angle between two directions
# share of sharpened, crushed or saturated edges above which the others are not representative of the lens
_PROCESSED = 0.3
_FAR, _LEAST = 5.0, 0.5  # standard deviations of ln sigma: the blur may vary by a half over the field
_IMPOSSIBLE = 0.5  # share of the step: a dark level below minus this value is impossible


def in_consensus(stacks: Sequence[EdgeStack]) -> list[EdgeStack]:
    """Return the stacks, with a problem for each edge that agrees with no other edge."""
    good = [stack.good for stack in stacks]
    counts = [which.size for which in good]
    if not sum(counts):
        return list(stacks)
    value = np.concatenate([np.log(s.parametric.values[g, 0]) for s, g in zip(stacks, good, strict=True)])
    std = np.concatenate([_relative_std(s, g) for s, g in zip(stacks, good, strict=True)])
    middle = np.median(value)
    scatter = robust_std(value - middle)
    far = np.abs(value - middle) > np.maximum(_FAR * np.hypot(std, scatter), _LEAST)
    result = []
    for stack, which, off in zip(stacks, good, np.split(far, np.cumsum(counts)[:-1]), strict=True):
        impossible = stack.dark[which] < -_IMPOSSIBLE * (stack.bright[which] - stack.dark[which])
        problems = list(stack.problems)
        for i, blurred, wrong in zip(which, off, impossible, strict=True):
            if blurred or wrong:
                text = "its dark level is impossible" if wrong else "its blur is not that of the other edges"
                problems[i] = Remark("no-consensus", text)
        result.append(replace(stack, problems=tuple(problems)))
    return result


def refuse_too_few(stacks: Sequence[EdgeStack], channel: str, *, accept_sharpened: bool) -> None:
    """Raise FitError if edges are the only measurements and too few, too parallel, or mostly processed.

    If `accept_sharpened` is true, sharpened edges are counted as good.
    """
    codes = [problem.code if problem else "" for stack in stacks for problem in stack.problems]
    good, processed = codes.count(""), codes.count("saturated")
    processed += codes.count("crushed")
    processed += 0 if accept_sharpened else codes.count("sharpened")
    if processed > _PROCESSED * (good + processed):
        raise FitError(
            f"channel {channel}: {processed} of {good + processed} edges are sharpened, crushed or saturated: this is a "
            "processed or overexposed image, whose MTF is not the lens's: use camera raw, and expose less"
        )
    if good < FEWEST_EDGES:
        raise FitError(
            f"channel {channel}: {good} good edges are too few for a camera, it takes {FEWEST_EDGES} in two directions: "
            "photograph a chart of slanted squares (matcam chart), or measure one edge with matcam edge"
        )
    angle = np.concatenate([stack.angle[stack.good] for stack in stacks])
    off = widest_angle(angle)
    if off < _APART:
        raise FitError(
            f"channel {channel}: all {good} edges lie within {np.degrees(off):.0f} degrees: a camera takes edges in two "
            "directions"
        )


def widest_angle(angle: np.ndarray) -> float:
    """Return the largest angle between any two of n axes, rad, at most a quarter turn.

    Not all pairs are compared, which would take a second for 4,000 edges: the axis at the largest angle to a given one
    is next to the perpendicular.
    """
    turned = np.sort(angle % np.pi)
    beyond = np.searchsorted(turned, (angle + np.pi / 2) % np.pi)
    beside = turned[np.stack([beyond - 1, beyond % turned.size])]
    return float(np.abs((angle - beside + np.pi / 2) % np.pi - np.pi / 2).max())


def _relative_std(stack: EdgeStack, which: np.ndarray) -> np.ndarray:
    return np.sqrt(stack.parametric.covariance[which, 0, 0]) / stack.parametric.values[which, 0]


def disagreement_remarks(disagreeing: Mapping[str, float], channel: str) -> tuple[Remark, ...]:
    """Describe the targets that were left out, one remark for each kind of target.

    disagreeing: relative difference of the blur by name, which ends in the kind in brackets.
    """
    kinds: dict[str, dict[str, float]] = {}
    for name, off in disagreeing.items():
        kinds.setdefault(name.rpartition(" (")[2].rstrip(")"), {})[name] = off
    remarks = []
    for kind, names in kinds.items():
        low, high = (_as_share(end) for end in (min(names.values()), max(names.values())))
        first = next(iter(names))
        if len(names) == 1:
            text = f"{first} sees a blur {low} against that of the edges, and is left out"
        else:
            text = f"{len(names)} targets of one kind ({kind}) see blurs from {low} to {high} against that of the edges"
            text += f", and are left out: {first} and {len(names) - 1} more"
        remarks.append(Remark("target-disagrees", f"{channel}: {text}"))
    return tuple(remarks)


def _as_share(difference: float) -> str:
    """Format a relative difference; above 100 % its linear estimate is not valid."""
    return (
        f"{difference:+.0%}"
        if abs(difference) <= 1
        else f"{'more' if difference > 0 else 'less'} than {np.sign(difference):+.0f}00%"
    )
