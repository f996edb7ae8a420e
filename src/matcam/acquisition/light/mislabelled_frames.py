"""Detection of frames whose light contradicts their exposure: exchanged frames, or frames under a wrong name."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from matcam.acquisition.bracket_sample import BracketSample

_LEAST = math.log(1.22)
"""Smallest reported departure of the logarithm of the light of a frame: just below the smallest usual step of exposures, a
third of a stop.
"""


def light_ratios(samples: Sequence[BracketSample], nominal: np.ndarray, top: float, noise: float) -> np.ndarray:
    """Compute the logarithm of the light of each exposure relative to each other exposure, (samples + 1, count, count).

    The last matrix is that of the nominal times. Ratios without common well-exposed pixels are NaN.

    Args:
        samples: samples of all lamp positions.
        nominal: nominal times of the exposures, s (count,); NaN: unknown.
        top: largest code above dark, DN.
        noise: read noise, DN.
    """
    found = np.full((len(samples) + 1, len(nominal), len(nominal)), np.nan)
    found[-1] = np.log(nominal / nominal[:, None])
    for ratios, sample in zip(found, samples, strict=False):
        lit = sample.around > 20 * noise
        below = (sample.around < 0.7 * top) & (sample.light < 0.8 * top)
        for i, first in enumerate(sample.exposures):
            for j, second in enumerate(sample.exposures[:i]):
                good = lit[i] & lit[j] & below[i] & below[j]
                light = [float(sample.light[k][good].sum()) for k in (i, j)]
                # at 20 times the read noise, 10 pixels have a relative error below 5 %
                if good.sum() >= 10 and min(light) > 0:
                    ratios[second, first] = math.log(light[0] / light[1])
                    ratios[first, second] = -ratios[second, first]
    return found


def mislabelled_frames(
    samples: Sequence[BracketSample], nominal: np.ndarray, top: float, noise: float
) -> list[list[tuple[int, float, int | None]]]:
    """Find the frames of each lamp position whose light contradicts the other lamp positions and the nominal times.

    The expected ratio of two exposures is the median of the ratios of all lamp positions and of the nominal times.

    Args:
        samples: samples of all lamp positions.
        nominal: nominal times of the exposures, s (count,); NaN: unknown.
        top: largest code above dark, DN.
        noise: read noise, DN.

    Returns:
        For each sample: index of the frame in the sample, its light relative to the expected light, and index of the
        exposure that has this light; None: no exposure has it.
    """
    ratios = light_ratios(samples, nominal, top, noise)
    # fewer than three ratios do not show which of them is wrong
    enough = np.isfinite(ratios).sum(axis=0) >= 3
    expected = np.where(enough, np.nanmedian(np.where(enough, ratios, 0.0), axis=0), np.nan)
    found = []
    for sample, measured in zip(samples, ratios, strict=False):
        one = (measured - expected)[np.ix_(sample.exposures, sample.exposures)]
        first, second = np.nonzero(np.isfinite(np.triu(one, 1)) & np.triu(np.ones_like(one, bool), 1))
        pairs = np.zeros((len(first), len(one)))
        pairs[np.arange(len(first)), second], pairs[np.arange(len(first)), first] = 1.0, -1.0
        off = np.linalg.lstsq(pairs, one[first, second], rcond=None)[0]
        off = np.where(np.abs(pairs).any(axis=0), off - np.median(off), 0.0)
        wrong = []
        for frame in np.flatnonzero(np.abs(off) > _LEAST):
            away = np.abs(expected[sample.exposures[frame]] - off[frame])
            like = int(np.argmin(np.nan_to_num(away, nan=np.inf)))
            wrong.append((int(frame), math.exp(off[frame]), like if away[like] < _LEAST else None))
        found.append(wrong)
    return found
