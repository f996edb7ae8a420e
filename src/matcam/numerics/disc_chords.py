"""A disc of even light as chords: where they lie, how long they are, and what share of the light each has.

Their distance from the disc's centre is sin t, with Gauss's nodes in t: that is smooth for chords that are long beside the blur
and for short ones. Few chords of a small disc are Gauss's for the disc itself (Chebyshev's second kind), which keep all light
and its variance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

COUNTS = (4, 6, 9, 13, 18, 26, 36, 48, 64)
"""Numbers of chords. The first is for small discs."""
_SMALL = 1.2
"""Radius of the disc over the blur's standard deviation up to which it is small."""
_LEAST, _ACROSS, _ALONG = 2.0, 2.4, 1.0
"""Chords, and how many more for each standard deviation of the blur in half the disc's width across them, and along."""
CHORD_RULE = (COUNTS, _SMALL, _LEAST, _ACROSS, _ALONG)


class Chords(NamedTuple):
    """Chords of the unit disc: arrays of one shape.

    Attributes:
        at: distances from its centre.
        half: half lengths.
        share: shares of the light; their sum is 1.
    """

    at: np.ndarray
    half: np.ndarray
    share: np.ndarray


def chords_of(count: int) -> Chords:
    """Return one of `COUNTS` chords."""
    if count == COUNTS[0]:
        at, weight = 2 * np.arange(1, count + 1) / (count + 1) - 1, np.full(count, 2 / (count + 1))
    else:
        at, weight = np.polynomial.legendre.leggauss(count)
    half = np.cos(np.pi / 2 * at)
    return Chords(np.sin(np.pi / 2 * at), half, weight * half**2)


def half_of(chords: Chords) -> Chords:
    """Return the chords on one side of the centre; each stands for two, one of them mirrored."""
    side = chords.at > -1e-12
    at, half, share = (a[side] for a in chords)
    return Chords(at, half, np.where(at < 1e-12, share / 2, share))


def chord_rule(across: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return which of `COUNTS` discs need. across, along: half their widths over the blur's standard deviation."""
    large = np.maximum(COUNTS[1], _LEAST + _ACROSS * across + _ALONG * along)
    needed = np.where(np.maximum(across, along) <= _SMALL, 0.0, large)
    return np.minimum(np.searchsorted(COUNTS, needed), len(COUNTS) - 1)
