"""Uniform disc as chords: positions, lengths, and shares of the light.

The distance of a chord from the centre of the unit disc is sin t, with Gauss-Legendre nodes in t, rad. A blurred disc is an
integral over t, whose integrand is smooth whether the chords are longer or shorter than the blur. The few chords of a
small disc are at the nodes of a Gauss rule (Chebyshev polynomials of the second kind). They preserve the total light of
the disc and its variance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

COUNTS = (4, 6, 9, 13, 18, 26, 36, 48, 64)
"""Available numbers of chords. The first is for small discs."""
_SMALL = 1.2
"""Ratio of the radius of a disc to the standard deviation of the blur up to which the disc is small."""
_LEAST, _ACROSS, _ALONG = 2.0, 2.4, 1.0
"""Number of chords: minimum, and additional chords per unit of the half width of the disc divided by the standard
deviation of the blur, across and along the chords.
"""
CHORD_RULE = (COUNTS, _SMALL, _LEAST, _ACROSS, _ALONG)


class Chords(NamedTuple):
    """Chords of the unit disc, as arrays of shape (chords,).

    Attributes:
        at: distances of the chords from the centre, in radii of the disc; negative on one side of the centre.
        half: half lengths of the chords, in radii of the disc.
        share: shares of the light in the chords, no unit; the shares of all chords add up to 1.
    """

    at: np.ndarray
    half: np.ndarray
    share: np.ndarray


def chords_of(count: int) -> Chords:
    """Build the chords of the unit disc.

    count: number of chords, one of `COUNTS`.
    """
    if count == COUNTS[0]:
        at, weight = 2 * np.arange(1, count + 1) / (count + 1) - 1, np.full(count, 2 / (count + 1))
    else:
        at, weight = np.polynomial.legendre.leggauss(count)
    half = np.cos(np.pi / 2 * at)
    return Chords(np.sin(np.pi / 2 * at), half, weight * half**2)


def half_of(chords: Chords) -> Chords:
    """Select the chords on one side of the centre.

    The shares add up to 1/2. A chord through the centre has half its share.
    """
    side = chords.at > -1e-12
    at, half, share = (a[side] for a in chords)
    return Chords(at, half, np.where(at < 1e-12, share / 2, share))


def chord_rule(across: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Choose the number of chords of each disc. The result is the index of the number in `COUNTS`.

    across, along: half widths of discs divided by the standard deviation of the blur, across and along the chords.
    """
    large = np.maximum(COUNTS[1], _LEAST + _ACROSS * across + _ALONG * along)
    needed = np.where(np.maximum(across, along) <= _SMALL, 0.0, large)
    return np.minimum(np.searchsorted(COUNTS, needed), len(COUNTS) - 1)
