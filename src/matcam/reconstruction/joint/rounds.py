"""Rounds of one joint fit: progress with the remaining time, and the end if another round does not improve the fit."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

_STUCK = 0.1
"""Unexplained share up to which an increase does not end the rounds, because new windows contain other pixels."""
_RISE = 1.05
"""Increase of the share, relative to its minimum, above which a round has not improved the fit."""

_NOTHING, _FALL = 0.5, 0.95
"""Unexplained share above which a round must lower it, and the required ratio to the minimum; otherwise the model is
useless.
"""


class Rounds:
    """Progress of the rounds of one fit.

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
        """Announce a round; after the first, with an upper bound of the remaining time."""
        done = len(self.shares)
        line = f"round {done + 1} of at most {self.most}, {self.pictures} images"
        if done:
            left = (time.monotonic() - self._started) / done * (self.most - done)
            line += f", {self.shares[-1]:.1%} unexplained so far, at most {left:.0f} s left"
        self.say(line)

    def end(self, share: float) -> None:
        """Record the unexplained share after a round."""
        self.shares.append(share)

    @property
    def stuck(self) -> bool:
        """Check whether the last round did not improve the fit and the unexplained share is large."""
        *before, share = self.shares
        least = min(before, default=math.inf)
        return share > max(_STUCK, _RISE * least) or share > max(_NOTHING, _FALL * least)
