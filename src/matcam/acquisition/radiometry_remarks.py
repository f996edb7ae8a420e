"""Remarks on the radiometry of a capture: wrong times, clipping, tone curves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from matcam.acquisition.bracket_sample import BracketSample
from matcam.acquisition.exposure_ratios import ClipLevel, ExposureRatios
from matcam.core.remark import Remark, gathered
from matcam.core.results.summary import with_std
from matcam.files.capture_settings import Stated
from matcam.numerics.frame_noise import not_linear

_PROVEN, _POWER = 5.0, 0.1
"""Number of standard deviations from 1 above which an exponent proves a tone curve, and smallest such difference."""
_CORRELATED, _SHARPENED = 0.06, -0.015
"""Correlation of neighbouring pixels' noise above which a frame was smoothed (noise of whole rows is correlated, too),
and below which it was sharpened (few other causes make it negative).
"""


def tone_exponent(ratios: ExposureRatios, nominal: np.ndarray) -> Stated:
    """Estimate the exponent of codes as a power of the nominal exposure time, with its standard deviation.

    The exponent is 1 for linear frames. A tone curve changes every ratio of exposures approximately to a power of the ratio,
    with an exponent of 0.45 for a gamma of 2.2. In contrast, wrong nominal times cause scatter of the measured ratios about
    the nominal ratios. The result is NaN for fewer than three exposures, because a single wrong time then has the same
    effect as a power. It is also NaN if the exposures are not linked, or if a nominal time is unknown.
    """
    # smallest number of exposures that distinguish a power law of the nominal times from a single wrong time
    if len(nominal) < 3 or not ratios.linked or not np.isfinite(nominal).all():
        return Stated(math.nan, math.inf)
    x, y = (np.log(values) - np.log(values).mean() for values in (nominal, ratios.value))
    square = float(x @ x)
    if square < 1e-6:
        return Stated(math.nan, math.inf)
    value = float(x @ y) / square
    scatter = math.sqrt(float(((y - value * x) ** 2).sum()) / (len(x) - 2))
    # shutters have errors of 1 to 7 %, and nominal times are rounded (1/30 for 1/32): 10 % in all
    return Stated(value, max(scatter, 0.1) / math.sqrt(square))


def tone_curve_proof(exponent: Stated) -> str | None:
    """Describe the evidence of a tone curve in the frames; None: there is no evidence.

    Args:
        exponent: exponent from `tone_exponent`.
    """
    if not abs(exponent.value - 1) > max(_PROVEN * exponent.std, _POWER):
        return None
    return (
        f"codes increase as the exposure time to the power {exponent.value:.2f} ± {exponent.std:.2f} instead of 1: the frames "
        "have a tone curve, or time_s in frames.csv is wrong"
    )


def coarse_remarks(step: float, noise: float) -> list[Remark]:
    """Report codes in steps that hide the noise of dark frames.

    Args:
        step: difference of neighbouring codes, DN.
        noise: read noise including rounding, DN.
    """
    # with noise of half a step, rounding biases a mean by only exp(-2 pi^2 0.5^2) / pi = 0.2 % of a step
    if step == 1 or noise > 0.5 * step:
        return []
    text = f"the codes occur only in steps of {step:g} DN, larger than the noise of dark frames: the signal has fewer bits "
    text += "than the file, and faint light is rounded; give frames with the full number of bits of the camera"
    return [Remark("codes-coarse", text)]


def exposure_remarks(names: Sequence[str], ratios: ExposureRatios, nominal: np.ndarray) -> list[Remark]:
    found = []
    if len(names) > 1 and not ratios.linked:
        found.append(
            Remark(
                "exposures-not-linked",
                "some exposures share no well-exposed pixels with the others, so nominal times are used for their ratios: take "
                "exposures with smaller steps",
            )
        )
    if np.isnan(nominal).any():
        missing = ", ".join(name for name, time in zip(names, nominal, strict=True) if math.isnan(time))
        found.append(
            Remark(
                "times-missing",
                f"the nominal time of exposure {missing} is unknown, so the measured ratio is not checked: add time_s to "
                "frames.csv",
            )
        )
        return found
    if len(names) < 2:
        return found
    if (np.diff(nominal) < 0).any():
        found.append(
            Remark(
                "times-contradict",
                "the exposures have a different order by brightness and by nominal time: check time_s in frames.csv",
            )
        )
    said = nominal / nominal[0]
    wrong = ratios.value / said - 1
    for name, error, std in zip(names, wrong, ratios.std(), strict=True):
        # relative error of a nominal exposure time above which there is a remark
        if np.isfinite(std) and abs(error) > max(0.02, 4 * std):
            measured = with_std(1 + error, max(std, 1e-9))
            found.append(
                Remark(
                    "times-wrong",
                    f"exposure {name}: the light relative to exposure {names[0]} is {measured} times the nominal ratio; the "
                    "measured ratio is used: check time_s in frames.csv",
                )
            )
    slope = float(np.polyfit(np.log(said), np.log(ratios.value), 1)[0]) if said[-1] > 1.5 else 1.0
    proof = tone_curve_proof(tone_exponent(ratios, nominal))
    if proof is not None:
        found.append(Remark("tone-curve", proof))
    elif abs(slope - 1) > 0.2:
        text = f"codes increase as the exposure to the power {slope:.2f}: give frames without a tone curve, or correct time_s"
        found.append(Remark("tone-curve", text))
    return found


def clip_remarks(clip: ClipLevel, names: Sequence[str], samples: Sequence[BracketSample]) -> list[Remark]:
    found = []
    if not clip.pixels:
        found.append(Remark("clip-not-seen", f"no clipped pixel was found; codes up to {clip.level:.0f} DN are used"))
    elif clip.spread > 0.02 * clip.level:
        text = f"clipped pixels scatter by {clip.spread / clip.level:.1%} about {clip.level:.0f} DN: check for rescaled frames"
        found.append(Remark("clip-unclear", text))
    peaks = []
    for sample in samples:
        peak = (sample.codes[0] >= clip.threshold).sum() if sample.codes.size else 0
        if peak:
            peaks.append(peak_remark(sample.lamp, int(peak), names[int(sample.exposures[0])]))
    return found + gathered(peaks)


def peak_remark(lamp: str, count: int, exposure: str) -> tuple[str, Remark]:
    """Report the number of clipped pixels in the shortest exposure of a lamp position.

    The result contains the name of the lamp position and the remark.
    """
    pixels = "pixel is" if count == 1 else "pixels are"
    text = f"lamp {lamp}: {count} {pixels} clipped in the shortest exposure, {exposure}: add a shorter exposure"
    return lamp, Remark("peak-clipped", text)


def processing_remarks(where: str, correlation: float, std: float) -> list[Remark]:
    """Report sharpening or smoothing according to the noise of neighbouring pixels.

    Args:
        where: source of the noise.
        correlation: correlation of the noise of neighbouring pixels.
        std: standard deviation of `correlation`.
    """
    if _SHARPENED < correlation < _CORRELATED or abs(correlation) < 5 * std:
        return []
    what = "sharpened: highlights overshoot and appear too narrow" if correlation < 0 else "smoothed or demosaiced"
    return [
        Remark(
            "sharpened" if correlation < 0 else "smoothed",
            f"{where}: the noise of neighbouring pixels has a correlation of {correlation:+.2f}: the frames were probably "
            f"{what}; use raw frames",
        )
    ]


def linearity_remarks(ratios: ExposureRatios) -> list[Remark]:
    curve = ratios.curve
    curve = curve[curve[:, 0] > 0.02] if len(curve) else curve
    if not len(curve):
        return []
    # good sensors stay below 1 %
    bad = not_linear(curve[:, 1], curve[:, 2], 0.01)
    if not bad.any():
        return []
    worst = curve[bad][np.abs(curve[bad][:, 1]).argmax()]
    return [
        Remark(
            "not-linear",
            f"codes deviate by {worst[1]:+.1%} from linearity at {worst[0]:.0%} of the largest code: check for a tone curve, "
            "or for motion of the sample",
        )
    ]
