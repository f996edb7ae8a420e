"""Pixels that pile up at the largest code of a frame: clipping below the largest code that the file can hold.

Noise spreads the codes of equally bright pixels. Let sigma be the noise of a pixel at the largest code. If a normal
variable exceeds a code, the excess is less than w with a probability of at most 1 - exp(-z w / sigma). Here z is the
hazard rate of the normal distribution, in inverse standard deviations. It is at most `_HAZARD` in frames of 10^7
pixels. The n largest pixels of a frame therefore lie within w of each other with probability

    p <= (1 - exp(-z w / sigma))^(n - 1),

for any brightness and structure of the scene, because structure only spreads the codes further. Pixels are clipped if p
is negligible. The bound requires a sigma that is not overestimated, so sigma is measured in the frames. If codes do not
resolve the noise (renders without noise, images of 8 bits), p is close to 1 and no conclusion is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from matcam.acquisition.exposure_ratios import ClipLevel
from matcam.numerics.frame_noise import code_step
from matcam.numerics.normal import robust_std

_HAZARD = 5.5
"""Largest hazard rate of a normal variable, in inverse standard deviations, up to 5.3 standard deviations above its
mean: one pixel in 10^7."""
_IMPROBABLE = -9.0
"""log10 of the probability below which a pile-up is clipping: one false alarm in 10^9 frames, so that a sigma
overestimated twofold is still harmless."""
_SPREAD = 8.0
"""Width of a pile-up, as a multiple of the read noise: noise after the clipping spreads a thousand pixels over this width."""
_BINS, _IN_BIN = 12, 200
"""Number of brightness bins in which noise is measured, and smallest number of pixels in a bin, which gives an accuracy
of 6 %.
"""
_LARGEST_SIDE = 1500
"""Largest side of the part of a frame in which noise is measured, px; it bounds the time for frames of many
megapixels.
"""


class TopCodes(NamedTuple):
    """Brightest pixels of one frame, and their expected noise.

    Attributes:
        level: largest code, DN.
        same: number of pixels with the code `level`.
        near: number of pixels whose code is less than the width of a pile-up below `level`.
        median: median code of the pixels that `near` counts, DN.
        height: `level` above dark, DN.
        gain: lower bound of the ratio of photon noise variance to light, DN per electron; NaN: not determined.
        unit: difference of neighbouring codes, DN.
        least: code that 1 % of the frame's pixels do not exceed, DN.
    """

    level: float
    same: float
    near: float
    median: float
    height: float
    gain: float
    unit: float
    least: float


class PileUp(NamedTuple):
    """Common clip level of pile-ups in several frames.

    Attributes:
        clip: the common clip level.
        frames: indices of the frames whose brightest pixels pile up at the common level.
        apart: indices of the frames whose brightest pixels pile up at another code.
    """

    clip: ClipLevel
    frames: tuple[int, ...]
    apart: tuple[int, ...]


def top_codes(codes: np.ndarray, dark: np.ndarray | float, hot: np.ndarray, step: int, noise: float) -> TopCodes:
    """Measure the brightest pixels of a frame.

    Args:
        codes: frame as read, (height, width), DN.
        dark: dark code of each pixel, or one value for all pixels, DN.
        hot: mask of the pixels that are omitted, (height, width).
        step: distance between pixels of the same colour along a row, px.
        noise: read noise, DN.
    """
    good = codes[~hot] if hot.any() else codes.ravel()
    level = float(good.max())
    unit = code_step(codes)
    # float images are stored with half precision or better
    unit = unit if math.isfinite(unit) and level >= 2 else 2.0**-11 * abs(level)
    near = good[good > level - _width(noise, unit)]
    same = int((near == level).sum())
    gain = math.nan
    # with fewer than three pixels, no probability bound falls below `_IMPROBABLE`
    if max(same, near.size / 3) >= 3:
        row, column = (int(np.median(at)) for at in np.nonzero(codes >= level - _width(noise, unit)))
        part = tuple(slice(max(at - _LARGEST_SIDE // 2, 0), at + _LARGEST_SIDE // 2) for at in (row, column))
        light = (codes - dark)[part]
        gain = _least_gain(light, level - float(np.mean(dark)) - _width(noise, unit), step, noise)
    return TopCodes(
        level,
        same,
        near.size,
        float(np.median(near)),
        level - float(np.mean(dark)),
        gain,
        unit,
        float(np.quantile(codes[::3, ::3], 0.01)),
    )


def find_pile_up(tops: Sequence[TopCodes], noise: float, gain: float) -> PileUp | None:
    """Find the code at which the brightest pixels of many frames pile up.

    The result is None if noise explains the brightest pixels of all frames.

    Args:
        tops: brightest pixels of all frames.
        noise: read noise, DN.
        gain: gain that is used if no frame determines it, DN per electron; NaN: unknown.
    """
    gains = [top.gain for top in tops if math.isfinite(top.gain)]
    common = float(np.median(gains)) if gains else gain
    levels = np.array([top.level for top in tops])
    best, found = _IMPROBABLE, None
    for exact in (True, False):
        widths = np.array([top.unit if exact else _width(noise, top.unit) for top in tops])
        counts = np.array([top.same if exact else top.near for top in tops])
        # log10 of the probability of one more pixel within the width
        log_p = np.array([_log_share(top, width, noise, common) for top, width in zip(tops, widths, strict=True)])
        for level in np.unique(levels):
            merged = (levels <= level) & (levels > level - (0.5 if exact else 1.0) * widths)
            total = float(np.sum(counts[merged] * log_p[merged]) - log_p[merged].min())
            if total < best:
                frames = np.flatnonzero(merged).tolist()
                apart = np.flatnonzero(((counts - 1) * log_p < _IMPROBABLE) & ~merged).tolist()
                pixels, spread = int(counts[merged].sum()), 0.0 if exact else noise
                at = float(np.median([tops[k].level if exact else tops[k].median for k in frames]))
                std = math.hypot(1.25 * spread / math.sqrt(pixels), 0.29 * tops[frames[0]].unit)
                best = total
                found = PileUp(ClipLevel(at, std, spread, pixels), tuple(frames), tuple(apart))
    return found


def _width(noise: float, unit: float) -> float:
    """Compute the width of the range of codes over which read noise spreads clipped pixels, DN."""
    return unit * math.ceil(_SPREAD * noise / unit)


def _log_share(top: TopCodes, width: float, noise: float, gain: float) -> float:
    """Compute log10 of 1 - exp(-z w / sigma), with the symbols of the module docstring; w is `width`, DN.

    The argument of log10 is the factor of the bound for each pixel beyond the first. The result is 0 if sigma is unknown or
    negligible, or if the codes are near dark.
    """
    own = top.gain if math.isfinite(top.gain) else gain
    sigma = math.sqrt(max(own * top.height, 0.0)) if math.isfinite(own) else 0.0
    if top.height < _SPREAD * noise or sigma <= width * 1e-6:
        return 0.0
    return math.log10(-math.expm1(-_HAZARD * width / sigma))


def _least_gain(light: np.ndarray, below: float, step: int, noise: float) -> float:
    """Compute a lower bound of the ratio of photon noise variance to light, DN per electron.

    Second differences in both directions have 36 times the variance of a pixel and vanish for light that is quadratic in
    position. Structure only increases the differences. In frames with smooth parts, the smallest ratio among bins of
    brightness is therefore a lower bound. The result is 0 in frames without noise, and NaN if too few pixels are lit.

    Args:
        light: part of a dark-subtracted frame, DN.
        below: brightness of the largest codes, DN; only pixels darker than 90 % of it are used.
        step: distance between pixels of the same colour along a row, px.
        noise: read noise, DN.
    """
    if min(light.shape) <= 2 * step:
        return math.nan
    across = light[:, : -2 * step] - 2 * light[:, step:-step] + light[:, 2 * step :]
    both = across[: -2 * step] - 2 * across[step:-step] + across[2 * step :]
    total = light[:, : -2 * step] + light[:, step:-step] + light[:, 2 * step :]
    mean = (total[: -2 * step] + total[step:-step] + total[2 * step :]) / 9
    used = (mean > 10 * noise) & (mean < 0.9 * below)
    if used.sum() < _IN_BIN:
        return math.nan
    mean, both = mean[used], both[used]
    order = np.argsort(mean)
    found = []
    for part in np.array_split(order, max(1, min(_BINS, len(order) // _IN_BIN))):
        variance = robust_std(both[part]) ** 2 / 36
        found.append((variance - noise**2) / float(mean[part].mean()))
    return max(min(found), 0.0)
