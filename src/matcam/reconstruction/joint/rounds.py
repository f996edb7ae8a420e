"""Reports of the progress of a joint fit, and the criterion for its termination if a round does not improve the fit."""

from __future__ import annotations

import math
from collections.abc import Sequence

_STUCK = 0.1
"""Unexplained share of the light below which an increase does not end the rounds, because new windows contain other pixels."""
_RISE = 1.05
"""Ratio of the share to its previous minimum above which a round has not improved the fit."""

_NOTHING, _FALL = 0.5, 0.95
"""Unexplained share above which each round must reduce the share, and largest ratio to the previous minimum.

If the ratio is larger, the model does not describe the images.
"""


def round_line(shares: Sequence[float], most: int, pictures: int, seconds: float) -> str:
    """Announce the next round of the joint fit of one explanation.

    The number of explanations that follow is unknown, because it depends on the result.

    Args:
        shares: unexplained share of the light after each finished round.
        most: largest number of rounds.
        pictures: number of fitted images.
        seconds: time of the finished rounds, s.
    """
    done = len(shares)
    line = f"round {done + 1} of at most {most}, {pictures} images"
    if not done:
        return line
    return (
        f"{line}, {shares[-1]:.1%} unexplained so far, at most {seconds / done * (most - done):.0f} s left for this "
        "explanation; others may follow"
    )


def is_stuck(shares: Sequence[float]) -> bool:
    """Decide whether the last round did not improve the fit, although the unexplained share of the light is large.

    `shares` contains the share after each round.
    """
    *before, share = shares
    least = min(before, default=math.inf)
    return share > max(_STUCK, _RISE * least) or share > max(_NOTHING, _FALL * least)
