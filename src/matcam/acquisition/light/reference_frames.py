"""Light of the reference patch in the frames of the sample, or in separate images (reference/).

A separate image is taken before or after that of the sample, and the light of the lamp may change in between. The
change is specified, or estimated from repeated images of one lamp position. Without repeated images it is estimated
from the changes between lamp positions, which are further apart in time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from matcam.acquisition.bracket_sample import BracketSample
from matcam.acquisition.darkness import Darkness
from matcam.acquisition.light.reference_patch import GRAZING
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.core.remark import Remark, some_of
from matcam.files.capture import Capture, Region, Stated
from matcam.files.capture_frames import CaptureFrame

_FEWEST = 3
"""Smallest number of degrees of freedom for an estimate of scatter: with fewer, Student's distribution has no finite
variance.
"""
_STEADY = 0.001
"""Smallest relative change of light in the weight of a step, which keeps the weight finite."""


class SeenReference(NamedTuple):
    """Light of the reference patch in the frames of one lamp position.

    Attributes:
        lamp: name of the lamp position.
        exposures: index of each frame's exposure among all exposures, (k,).
        light: mean over the reference in each frame and channel, less the dark signal, (k, channels), DN; NaN if the
            reference is absent or clipped.
        pixels: number of pixels of the reference in each channel, (channels,).
    """

    lamp: str
    exposures: np.ndarray
    light: np.ndarray
    pixels: np.ndarray


def in_sample_frames(samples: Sequence[BracketSample]) -> list[SeenReference]:
    """Collect the light of the reference patch in the frames of the sample.

    Args:
        samples: samples of all lamp positions.
    """
    return [SeenReference(one.lamp, one.exposures, one.reference, one.reference_pixels) for one in samples]


def in_own_frames(
    reader: MosaicReader,
    capture: Capture,
    lamps: Sequence[str],
    exposures: Sequence[str],
    darkness: Mapping[str, Darkness],
    threshold: float,
) -> tuple[list[SeenReference], list[Remark]]:
    """Measure the light of the reference patch in its separate images, and report unusable images.

    Args:
        reader: the reader of frames.
        capture: the capture.
        lamps: names of the required lamp positions.
        exposures: names of the sample's exposures, the shortest first.
        darkness: dark signal of each exposure.
        threshold: smallest code of a clipped pixel, DN.
    """
    region, remarks = capture.reference_position, list[Remark]()
    if region is None:
        text = "reference.region_px is not specified, so the images in reference/ were not read: add it to capture.toml"
        return [_unseen(lamp, len(reader.channels)) for lamp in lamps], [Remark("no-reference", text)]
    wrong: dict[str, list[str]] = {}
    found: dict[str, list[tuple[int, np.ndarray]]] = {lamp: [] for lamp in lamps}
    pixels = np.zeros(len(reader.channels), int)
    diffuse = capture.settings["reference"]["kind"] == "diffuse"
    # at grazing incidence a white patch does not determine the light of a lamp
    grazing = {lamp: diffuse and math.cos(capture.lamps[lamp].angle) <= GRAZING for lamp in lamps}
    usable = []
    for frame in capture.of("reference"):
        if not frame.lamp or frame.lamp not in capture.lamps:
            wrong.setdefault("the sample has no frame of the same lamp", []).append(frame.file)
        elif frame.lamp in found and frame.exposure not in exposures:
            wrong.setdefault("the sample has no frame of the same exposure", []).append(frame.file)
        elif frame.lamp in found:
            usable.append(frame)
    for frame, codes in reader.readable(usable, region, remarks):
        means, pixels = reader.channel_means(codes, region)
        if not pixels.all() or not np.isfinite(codes).all():
            wrong.setdefault("the region lacks a colour, or contains values that are not finite", []).append(frame.file)
        elif codes.max() >= threshold:
            wrong.setdefault("the reference is clipped", []).append(frame.file)
        else:
            level = darkness[frame.exposure].mean
            found[frame.lamp].append((list(exposures).index(frame.exposure), means - level))
            if not grazing[frame.lamp]:
                remarks += _uneven(capture, frame, codes - level, region)
    remarks += [
        Remark(
            "reference-left-out",
            f"{capture.folder}: {some_of(files, 3)} {'were' if len(files) > 1 else 'was'} omitted, because {why}: correct "
            "frames.csv or reference.region_px, or repeat the exposure",
        )
        for why, files in wrong.items()
    ]
    lacking = [lamp for lamp, seen in found.items() if not seen and not grazing[lamp]]
    if lacking:
        text = f"lamp{'s' * (len(lacking) > 1)} {some_of(lacking)}: no usable image in reference/"
        text += ", so the value of lamp.gain_std is used: add an image of the reference for each of these lamps"
        remarks.append(Remark("reference-missing", text))
    return [
        SeenReference(lamp, np.array([k for k, _ in seen]), np.array([light for _, light in seen]), pixels)
        if seen
        else _unseen(lamp, len(pixels))
        for lamp, seen in found.items()
    ], remarks


def scatter_between(
    seen: Sequence[SeenReference], exposures: np.ndarray, gain: float, noise: float, output: Mapping[str, Stated]
) -> float:
    """Estimate the relative standard deviation of the change of light between two images of one lamp position.

    Args:
        seen: light of the reference at each lamp position, in the order in which the images were taken.
        exposures: light of each exposure relative to a common exposure.
        gain: DN per electron.
        noise: read noise, DN.
        output: light of each lamp position from the reference. Its standard deviation does not include the change of
            light between images.

    Returns:
        The standard deviation; NaN with too few images.

    Source:
        With repeated images, the variance of the change is twice the variance of the images about the means of lamp position
        and exposure. Otherwise it is the mean square of the steps between successive lamp positions (von Neumann 1941),
        which includes drift. The variance due to noise is subtracted. The result is increased according to Student's
        distribution.
    """
    rows, values, variances = [], [], []
    lamps = [one for one in seen if len(one.exposures) > 1]
    for number, one in enumerate(lamps):
        total = one.light @ one.pixels
        for exposure, light in zip(one.exposures, total, strict=True):
            row = np.zeros(len(lamps) + len(exposures))
            row[[number, len(lamps) + exposure]] = 1.0
            rows.append(row)
            values.append(math.log(max(light, 1e-9) / exposures[exposure]))
            variances.append((max(light, 0.0) * gain + noise**2 * one.pixels.sum()) / max(light, 1e-9) ** 2)
    if rows:
        design, value = np.array(rows), np.array(values)
        solution, _, rank, _ = np.linalg.lstsq(design, value, rcond=None)
        free = len(value) - int(rank)
        if free >= _FEWEST:
            square = float(((value - design @ solution) ** 2).sum()) / free
            return math.sqrt(2 * max(square - float(np.mean(variances)), 0.0) * free / (free - 2))
    known = [output[one.lamp] for one in seen if math.isfinite(output[one.lamp].value)]
    if len(known) <= _FEWEST:
        return math.nan
    steps = np.array([math.log(b.value / a.value) for a, b in pairwise(known)])
    error = np.array([(a.std / a.value) ** 2 + (b.std / b.value) ** 2 for a, b in pairwise(known)])
    weight = 1 / (error + _STEADY**2)
    square = float((weight * (steps**2 - error)).sum() / weight.sum())
    return math.sqrt(max(square, _STEADY**2 / 2) * len(steps) / (len(steps) - 2))


def _unseen(lamp: str, channels: int) -> SeenReference:
    return SeenReference(lamp, np.zeros(0, int), np.zeros((0, channels)), np.zeros(channels, int))


def _uneven(capture: Capture, frame: CaptureFrame, light: np.ndarray, region: Region) -> list[Remark]:
    """Report light that varies more over the reference region than the light of a near lamp varies over a patch."""
    half = light.shape[0] // 2, light.shape[1] // 2
    parts = [light[: half[0]], light[half[0] :], light[:, : half[1]], light[:, half[1] :]]
    levels = [float(part.mean()) for part in parts if part.size]
    low, high = min(levels), max(levels)
    chance = 10 * float(light.std()) / np.sqrt(light.size / 2)
    # a near lamp causes ratios of the halves below 1.5
    if high < 1.5 * max(low, 0.0) or high - low < chance:
        return []
    return [
        Remark(
            "reference-uneven",
            f"{capture.folder / frame.file}: the mean codes of the halves of reference.region_px range from {low:.0f} to "
            f"{high:.0f} DN above dark: check that the region {list(region)} lies within the reference",
        )
    ]
