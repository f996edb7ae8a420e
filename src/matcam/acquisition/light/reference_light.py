"""Merged value of the reference at every lamp position, and the resulting output of the lamps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from matcam.acquisition.light.reference_frames import SeenReference
from matcam.acquisition.light.reference_patch import GRAZING
from matcam.files.capture import Capture, Stated

_NONE = Stated(math.nan, math.nan)


def reference_light(
    seen: Sequence[SeenReference],
    exposures: np.ndarray,
    scale: float,
    noise: float,
    response: np.ndarray,
) -> dict[str, tuple[Stated, ...]]:
    """Merge the values of the reference at every lamp position, with their noise.

    Args:
        seen: the reference in the frames of each lamp position.
        exposures: light of each exposure relative to the one that defines the unit of merged values.
        scale: unit of merged values, DN.
        noise: read noise, DN.
        response: response of the pixels of the reference in each channel, from flat frames, (channels,).

    Returns:
        Value of each channel with its standard deviation, by lamp position; NaN where the reference is not usable.
    """
    found = {}
    for one in seen:
        good = np.isfinite(one.light).all(1)
        if not good.any() or not one.pixels.all():
            found[one.lamp] = tuple(_NONE for _ in one.pixels)
            continue
        light, relative = one.light[good], exposures[one.exposures[good]]
        variance = (np.maximum(light, 0) * scale + noise**2).sum(0) / one.pixels
        unit = relative.sum() * response * scale
        pairs = zip(light.sum(0) / unit, np.sqrt(variance) / unit, strict=True)
        found[one.lamp] = tuple(Stated(float(v), float(s)) for v, s in pairs)
    return found


def lamp_output(
    capture: Capture,
    seen: Sequence[SeenReference],
    light: Mapping[str, tuple[Stated, ...]],
    between: float = 0.0,
) -> dict[str, Stated]:
    """Compute the light of each lamp position from the reference, relative to the mean of all lamp positions.

    The light is NaN where the reference is not usable. For a diffuse reference the lamp is assumed to be distant.

    Args:
        capture: capture with the specified properties of reference and lamps.
        seen: the reference in the frames of each lamp position.
        light: merged value of the reference at each lamp position, by channel.
        between: standard deviation of the change of light between an image of the reference and one of the sample,
            relative. Default: 0, one frame shows both.
    """
    diffuse = capture.settings["reference"] is not None and capture.settings["reference"]["kind"] == "diffuse"
    found: dict[str, Stated] = {}
    for one in seen:
        share = one.pixels / max(int(one.pixels.sum()), 1)
        value = float(share @ [channel.value for channel in light[one.lamp]])
        std = math.hypot(*(share * [channel.std for channel in light[one.lamp]]))
        if math.isfinite(value):
            if diffuse:  # a white patch that faces the camera
                angle = capture.lamps[one.lamp].angle
                cosine = math.cos(angle)
                if not cosine > GRAZING:
                    value = math.nan
                else:
                    value, std = value / cosine, std / cosine
                    std = math.hypot(std, value * math.tan(angle) * capture.direction_std)
            if not value > 3 * std:
                value = math.nan
            std = math.hypot(std, value * between)
        found[one.lamp] = Stated(value, std)
    known = [v.value for v in found.values() if math.isfinite(v.value)]
    usual = float(np.mean(known)) if known else math.nan
    return {
        lamp: Stated(v.value / usual, v.std / usual) if math.isfinite(v.value) else _NONE for lamp, v in found.items()
    }
