"""Which edges speak for a camera, and whether there are enough of them.

Any picture has edges: a doll's, a page's, a shadow's. One of them is no camera. Edges that lie far from all others in their
blur, or have impossible levels, are left out; what is left must be enough to know that they agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from matcam.calibration.edge.edge_result import EdgeStack
from matcam.core.errors import FitError
from matcam.core.remark import Remark

FEWEST_EDGES = 8
_APART = np.radians(20.0)  # least angle between two directions
_PROCESSED = 0.3  # share of sharpened, crushed or saturated edges, beyond which the rest is no sample of the lens
_FAR, _LEAST = 5.0, 0.5  # standard deviations; of ln sigma: blur may vary by a half over a field
_IMPOSSIBLE = 0.5  # of the step: a dark level below minus that is none


def in_consensus(stacks: Sequence[EdgeStack]) -> list[EdgeStack]:
    """Return the stacks with problems for edges that no other edge agrees with."""
    good = [stack.good for stack in stacks]
    counts = [which.size for which in good]
    if not sum(counts):
        return list(stacks)
    value = np.concatenate([np.log(s.parametric.values[g, 0]) for s, g in zip(stacks, good, strict=True)])
    std = np.concatenate([_relative_std(s, g) for s, g in zip(stacks, good, strict=True)])
    middle = np.median(value)
    scatter = 1.4826 * np.median(np.abs(value - middle))
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
    """Raise FitError where edges alone are to make a camera, and are too few, too alike, or mostly processed.

    accept_sharpened: sharpened edges do not count against a picture.
    """
    codes = [problem.code if problem else "" for stack in stacks for problem in stack.problems]
    good, processed = codes.count(""), codes.count("saturated")
    processed += codes.count("crushed")
    processed += 0 if accept_sharpened else codes.count("sharpened")
    if processed > _PROCESSED * (good + processed):
        raise FitError(
            f"channel {channel}: {processed} of {good + processed} edges are sharpened, crushed or saturated: this is a "
            "processed or overexposed picture, whose MTF is not the lens's: use camera raw, and expose less"
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
    """Return the widest angle between any two of n directions without a sign, rad: at most a quarter turn.

    It is found without comparing all pairs, which takes a second for 4,000 edges: what lies least like a direction is beside
    the one at a right angle to it.
    """
    turned = np.sort(angle % np.pi)
    beyond = np.searchsorted(turned, (angle + np.pi / 2) % np.pi)
    beside = turned[np.stack([beyond - 1, beyond % turned.size])]
    return float(np.abs((angle - beside + np.pi / 2) % np.pi - np.pi / 2).max())


def _relative_std(stack: EdgeStack, which: np.ndarray) -> np.ndarray:
    return np.sqrt(stack.parametric.covariance[which, 0, 0]) / stack.parametric.values[which, 0]


def strangers_remarks(strangers: Mapping[str, float], channel: str) -> tuple[Remark, ...]:
    """Name the targets that were left out, one remark for each kind of target.

    strangers: relative difference of the blur by name, which ends in the kind in brackets.
    """
    kinds: dict[str, dict[str, float]] = {}
    for name, off in strangers.items():
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
    """Write a relative difference as text; beyond 100 % its linear estimate has no meaning."""
    return (
        f"{difference:+.0%}"
        if abs(difference) <= 1
        else f"{'more' if difference > 0 else 'less'} than {np.sign(difference):+.0f}00%"
    )
