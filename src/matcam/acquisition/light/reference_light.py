"""What the reference in the frames recorded: its merged value in every lamp position, and the lamps' light by it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from matcam.acquisition.bracket_sample import BracketSample
from matcam.files.capture import Capture, Stated

_GRAZING = 0.2
"""Cosine below which a diffuse reference is not used."""
_NONE = Stated(math.nan, math.nan)


def reference_light(
    samples: Sequence[BracketSample],
    exposures: np.ndarray,
    gain: Stated,
    noise: float,
    response: np.ndarray,
) -> dict[str, tuple[Stated, ...]]:
    """Return the merged value of the reference in every lamp position, by channel, with its noise.

    Args:
        samples: of all lamp positions.
        exposures: light of each exposure relative to the one whose unit merged values have.
        gain: DN per electron; not finite: merged values are DN.
        noise: read noise, DN.
        response: of the pixels there over the usual, by channel, as flat frames say, (channels,).
    """
    scale = gain.value if math.isfinite(gain.value) else 1.0
    found = {}
    for sample in samples:
        good = np.isfinite(sample.reference).all(1)
        relative = exposures[sample.exposures[good]]
        if not good.any() or not sample.reference_pixels.all():
            found[sample.lamp] = tuple(_NONE for _ in sample.reference_pixels)
            continue
        light = sample.reference[good]
        value = light.sum(0) / relative.sum() / response
        variance = (np.maximum(light, 0) * scale + noise**2).sum(0) / sample.reference_pixels
        std = np.sqrt(variance) / relative.sum() / response
        found[sample.lamp] = tuple(Stated(float(v / scale), float(s / scale)) for v, s in zip(value, std, strict=True))
    return found


def lamp_output(
    capture: Capture, samples: Sequence[BracketSample], exposures: np.ndarray, gain: Stated, noise: float
) -> dict[str, Stated]:
    """Return the lamps' light by the reference, relative to its mean; the lamp of a diffuse one is taken as distant.

    Args:
        capture: what is stated of reference and lamps.
        samples: of all lamp positions.
        exposures: light of each exposure relative to the one whose unit merged values have.
        gain: DN per electron; not finite: merged values are DN.
        noise: read noise, DN.
    """
    diffuse = capture.settings["reference"] is not None and capture.settings["reference"]["kind"] == "diffuse"
    found: dict[str, Stated] = {}
    scale = gain.value if math.isfinite(gain.value) else 1.0
    for sample in samples:
        pixels = max(int(sample.reference_pixels.sum()), 1)
        mean = sample.reference_total / pixels
        good = np.isfinite(mean)
        value, std = math.nan, math.nan
        if good.any() and sample.reference_pixels.any():
            relative, light = exposures[sample.exposures[good]], mean[good]
            value = float(light.sum() / relative.sum())
            std = math.sqrt(float(np.sum(np.maximum(light, 0) * scale + noise**2)) / pixels) / float(relative.sum())
            if diffuse:  # a white patch that faces the camera
                angle = capture.lamps[sample.lamp].angle
                cosine = math.cos(angle)
                if not cosine > _GRAZING:
                    value = math.nan
                else:
                    value, std = value / cosine, std / cosine
                    std = math.hypot(std, value * math.tan(angle) * capture.direction_std)
            if not value > 3 * std:
                value = math.nan
        found[sample.lamp] = Stated(value, std)
    known = [v.value for v in found.values() if math.isfinite(v.value)]
    usual = float(np.mean(known)) if known else math.nan
    return {
        lamp: Stated(v.value / usual, v.std / usual) if math.isfinite(v.value) else _NONE for lamp, v in found.items()
    }
