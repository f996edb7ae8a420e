"""Dark signal of a camera by exposure: level, fixed pattern, read noise, hot pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from matcam.acquisition.bracket_sample import lagged
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.acquisition.radiometry_remarks import processing_remarks
from matcam.core.errors import FitError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Region
from matcam.numerics.frame_noise import clipped_variance, fixed_pattern_variance, pair_variance
from matcam.numerics.normal import robust_std

_HOT = 12.0
"""Number of standard deviations from the dark level above which a pixel is hot."""


class FrameLevel(NamedTuple):
    """Dark parts of a frame of the sample, and its size.

    Attributes:
        low: low code (5 % quantile), DN.
        shape: height and width, px.
        step: difference of neighbouring codes, DN; NaN for fractional codes.
    """

    low: float
    shape: tuple[int, ...]
    step: float


@dataclass(frozen=True)
class Darkness:
    """Dark signal of the frames of one exposure.

    Attributes:
        level: dark code of each pixel, float32 (height, width), or one value for all pixels, DN.
        hot: mask of the pixels whose dark code differs too much from the mean, (height, width); False if unknown.
        read_noise: standard deviation of the noise of one dark frame, DN; NaN without dark frames. If there is only one
            dark frame, the fixed pattern is included.
        frames: number of dark frames.
    """

    level: np.ndarray | float
    hot: np.ndarray | bool
    read_noise: float
    frames: int

    @property
    def mean(self) -> float:
        """Mean of the level over the pixels, DN."""
        return float(np.mean(self.level))

    def hot_pixels(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the mask of hot pixels of a frame, (height, width).

        All values are False if the hot pixels of frames of this shape are unknown.
        """
        hot = np.asarray(self.hot)
        return hot if hot.shape == shape else np.zeros(shape, bool)


def dark_of(stack: Sequence[np.ndarray]) -> Darkness:
    """Estimate the dark signal from the dark frames of one exposure.

    The mean of each pixel is shrunk towards the mean of all pixels (James and Stein 1961). The shrinkage depends on the
    ratio of fixed pattern to noise.

    Args:
        stack: the dark frames, (height, width) each, DN.
    """
    n = len(stack)
    mean = np.mean(np.asarray(stack, np.float32), axis=0)
    level = float(mean.mean()) if mean.size < 100 else _trimmed_mean(mean)
    spread = robust_std(mean - np.median(mean))
    if n < 2:
        noise = float(np.sqrt(clipped_variance(mean - level)))
        return Darkness(level, np.abs(mean - level) > _HOT * max(spread, noise, 0.5), noise, n)
    variance = float(np.mean([pair_variance(a, b) for a, b in pairwise(stack)]))
    pattern = max(fixed_pattern_variance(clipped_variance(mean - level), variance, n), 0.0)
    # an insignificant pattern is set to 0
    if pattern < 4 * variance / n * np.sqrt(2 / mean.size):
        pattern = 0.0
    share = pattern / (pattern + variance / n) if pattern else 0.0
    hot = np.abs(mean - level) > _HOT * max(np.sqrt(pattern + variance / n), 0.5)
    return Darkness(level + share * (mean - level) if share else level, hot, float(np.sqrt(variance)), n)


def dark_level(reader: MosaicReader, capture: Capture, exposure: str, region: Region | None) -> np.ndarray | float:
    """Compute the dark level of frames that do not show the sample, DN, from the dark frames of their exposure.

    If there are no dark frames of this exposure, dark frames of all exposures are used. Without readable dark frames, the
    level is the specified black level, or 0.
    """
    frames = capture.of("dark", exposure=exposure) or capture.of("dark")
    stack = [codes for _, codes in reader.readable(frames[:8], region)]
    return dark_of(stack).level if stack else float(capture.settings["camera"]["black_level_dn"] or 0.0)


def measure_darkness(
    reader: MosaicReader,
    capture: Capture,
    region: Region | None,
    exposures: Sequence[str],
    frame_levels: dict[str, FrameLevel],
) -> tuple[dict[str, Darkness], list[Remark]]:
    """Measure the dark signal of every exposure, and collect remarks.

    Args:
        reader: the reader of frames.
        capture: the capture.
        region: part of the frames that is used; None: the entire frame.
        exposures: names of the exposures, in the order of their times.
        frame_levels: level of one frame of each exposure.

    Returns:
        Dark signal of each exposure, and the remarks. An exposure without usable dark frames has the dark signal of the
        nearest exposure. If no dark frame is usable, the dark level is camera.black_level_dn.

    Raises:
        FitError: no dark frame is usable, and camera.black_level_dn is not specified. A low code of the frames would
            contain light of the sample, so all results would be wrong by an unknown amount.
    """
    found: dict[str, Darkness] = {}
    remarks: list[Remark] = []
    pairs: list[np.ndarray] = []
    for exposure in exposures:
        stack: list[np.ndarray] = []
        lit = frame_levels.get(exposure)
        for frame, one in reader.readable(capture.of("dark", exposure=exposure), region, remarks):
            level, noise = float(np.median(one)), float(np.std(one))
            if lit is not None and level > lit.low + max(6 * noise, 2.0):
                text = f"{capture.folder / frame.file}: this dark frame has {level:.0f} DN, more than dark parts of a frame "
                text += f"of its exposure ({lit.low:.0f} DN), and was omitted: cover the lens, and repeat it"
                remarks.append(Remark("dark-too-bright", text))
                continue
            expected = lit.shape if lit is not None else stack[0].shape if stack else one.shape
            if one.shape != expected:
                text = (
                    f"{capture.folder / frame.file}: this dark frame differs in size from the others and was omitted: "
                )
                text += "repeat it with their settings"
                remarks.append(Remark("other-size", text))
                continue
            stack.append(one)
        if stack:
            found[exposure] = dark_of(stack)
            pairs += [second - first for first, second in pairwise(stack)]
    if pairs:
        steps = (1,) if reader.cfa is None else (1, 2)
        correlation, std = max((pair_correlation(pairs, step) for step in steps), key=lambda one: abs(one[0]))
        remarks += processing_remarks(f"{capture.folder}: dark frames", correlation, std)
    missing = [name for name in exposures if name not in found]
    if found and missing:
        for name in missing:
            nearest = min(found, key=lambda other: abs(list(exposures).index(other) - list(exposures).index(name)))
            found[name] = found[nearest]
        text = (
            f"there is no usable dark frame of exposure {', '.join(missing)}, so that of the nearest exposure was "
            "subtracted: take dark frames of each exposure"
        )
        remarks.append(Remark("dark-missing", text))
    if not found:
        stated = capture.settings["camera"]["black_level_dn"]
        if stated is None:
            omitted = f" ({remarks[0].text})" if remarks else ""
            raise FitError(
                f"{capture.folder}: there are no usable dark frames{omitted}: add dark frames of each exposure, or specify "
                "camera.black_level_dn, the code without light"
            )
        found = dict.fromkeys(exposures, Darkness(stated, False, float("nan"), 0))
        text = "there are no usable dark frames, so camera.black_level_dn was subtracted: add dark frames"
        remarks.append(Remark("dark-missing", text))
    return found, remarks


def pair_correlation(pairs: Sequence[np.ndarray], step: int = 1) -> tuple[float, float]:
    """Estimate the correlation of the noise of neighbouring pixels, and the standard deviation of the correlation.

    Args:
        pairs: differences of two frames without light, (height, width) each, DN.
        step: distance of the two pixels along rows and columns, px. Default: 1.

    Example:
        >>> flicker = np.random.default_rng(0).standard_normal((200, 200))
        >>> value, std = pair_correlation([flicker])
        >>> abs(value) < 3 * std
        True
    """
    products, squares, count = 0.0, 0.0, 0
    for one in pairs:
        noise = np.abs(one) <= 8 * max(robust_std(one), 0.5)
        for axis in (0, 1):
            product, square, number = lagged(one, noise, axis, step)
            products, squares, count = products + number * product, squares + number * square, count + number
    return (products / squares, 1 / count**0.5) if squares > 0 else (0.0, float("inf"))


def _trimmed_mean(values: np.ndarray) -> float:
    """Compute the mean of the values without hot pixels, DN.

    Rounding of the codes limits the accuracy of a median, but not that of a mean.
    """
    middle = np.median(values)
    width = 6 * max(robust_std(values - middle), 1.0)
    return float(values[np.abs(values - middle) <= width].mean(dtype=np.float64))
