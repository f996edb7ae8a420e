"""Reports of the progress of a joint fit, and the criterion for its termination if a round does not improve the fit."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

_STUCK = 0.1
"""Unexplained share of the light below which an increase does not end the rounds, because new windows contain other pixels."""
_RISE = 1.05
"""Ratio of the share to its previous minimum above which a round has not improved the fit."""

_NOTHING, _FALL = 0.5, 0.95
"""Unexplained share above which each round must reduce the share, and largest ratio to the previous minimum.

If the ratio is larger, the model does not describe the images.
"""


class Rounds:
    """Progress of the rounds of one joint fit, which is that of one explanation.

    The number of explanations that follow is unknown, because it depends on the result.

    Args:
        most: largest number of rounds.
        say: function that is called with a line about each round.
        pictures: number of fitted images.
    """

    def __init__(self, most: int, say: Callable[[str], None], pictures: int):
        self.most, self.say, self.pictures = most, say, pictures
        self.shares: list[float] = []
        self._started = time.monotonic()

    def begin(self) -> None:
        done = len(self.shares)
        line = f"round {done + 1} of at most {self.most}, {self.pictures} images"
        if done:
            left = (time.monotonic() - self._started) / done * (self.most - done)
            line += f", {self.shares[-1]:.1%} unexplained so far, at most {left:.0f} s left for this explanation; others may "
            line += "follow"
        self.say(line)

    def end(self, share: float) -> None:
        self.shares.append(share)

    @property
    def stuck(self) -> bool:
        """True if the last round did not improve the fit, although the unexplained share is large."""
        *before, share = self.shares
        least = min(before, default=math.inf)
        return share > max(_STUCK, _RISE * least) or share > max(_NOTHING, _FALL * least)
