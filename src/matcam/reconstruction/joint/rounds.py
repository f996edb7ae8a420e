"""Rounds of one joint fit: progress with the time left, and the end where another round explains no more."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

_STUCK = 0.1
"""Unexplained share of the light up to which a rise is no reason to end: windows laid anew hold other pixels."""
_RISE = 1.05
"""Relative rise of the share, from its least, from which a round has explained no more."""

_NOTHING, _FALL = 0.5, 0.95
"""Unexplained share from which a round must lower it, and to what part of the least: beyond it the model explains nothing."""


class Rounds:
    """Progress of the rounds of one fit.

    Args:
        most: largest number of rounds.
        say: is called with a line about each round.
        pictures: number of pictures that are fitted.
    """

    def __init__(self, most: int, say: Callable[[str], None], pictures: int):
        self.most, self.say, self.pictures = most, say, pictures
        self.shares: list[float] = []
        self._started = time.monotonic()

    def begin(self) -> None:
        """Announce a round; after the first with the time that the rounds left take at most."""
        done = len(self.shares)
        line = f"round {done + 1} of at most {self.most}, {self.pictures} pictures"
        if done:
            left = (time.monotonic() - self._started) / done * (self.most - done)
            line += f", {self.shares[-1]:.1%} unexplained so far, at most {left:.0f} s left"
        self.say(line)

    def end(self, share: float) -> None:
        """Take note of the unexplained share that a round leaves."""
        self.shares.append(share)

    @property
    def stuck(self) -> bool:
        """Tell whether the last round explains no more of the light than one before it, and leaves much unexplained."""
        *before, share = self.shares
        least = min(before, default=math.inf)
        return share > max(_STUCK, _RISE * least) or share > max(_NOTHING, _FALL * least)
