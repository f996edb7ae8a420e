"""Radiometric calibration of a capture: dark, gain, read noise, exposure ratios, clip level, linearity, lamp output.

All quantities are estimated from the images, as far as the images determine them. Nominal values and metadata are compared
with the estimates, and are used only for quantities that the images do not determine (docs/model.md 10). There are two
passes: the calibration keeps some pixels of every lamp position, and `merging.py` reads the frames again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from matcam.acquisition.bracket_sample import BracketSample
from matcam.acquisition.darkness import Darkness, FrameLevel, measure_darkness
from matcam.acquisition.exposure_ratios import (
    UNKNOWN_GAIN,
    ClipLevel,
    ExposureRatios,
    first_guess,
    fit_gain,
    fit_gain_of_single,
    fit_ratios,
    measure_clip_level,
)
from matcam.acquisition.light.bracket_reading import BracketReading
from matcam.acquisition.light.flat_field import FlatField, measure_flat
from matcam.acquisition.light.kept_work import KeptWork
from matcam.acquisition.light.mislabelled_frames import mislabelled_frames
from matcam.acquisition.light.pile_up import TopCodes, find_pile_up
from matcam.acquisition.light.reference_frames import SeenReference, in_own_frames, in_sample_frames, scatter_between
from matcam.acquisition.light.reference_light import lamp_output, reference_light
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.acquisition.radiometry_remarks import (
    clip_remarks,
    coarse_remarks,
    exposure_remarks,
    linearity_remarks,
    tone_exponent,
)
from matcam.camera.camera import Camera
from matcam.core.errors import FileFormatError, FitError, MatcamError
from matcam.core.remark import Remark, gathered, some_of
from matcam.core.threads import in_order
from matcam.files.capture import Capture, Region, Stated
from matcam.files.capture_frames import CaptureFrame
from matcam.numerics.alternation import alternation
from matcam.numerics.frame_noise import code_step

Progress = Callable[[str, int, int], None]
"""Function that receives the name of a step, the number of finished parts, and the total number of parts."""


@dataclass(frozen=True)
class Radiometry:
    """Radiometric calibration of a capture.

    Attributes:
        exposures: light of each exposure relative to `reference_exposure`, by name, the shortest first, with standard
            deviation.
        reference_exposure: name of the exposure that defines the unit of merged values.
        clip: code at which pixels clip, DN as read.
        gain: DN per electron, with standard deviation; NaN: not determined, and merged values are DN.
        read_noise: read noise, DN, with standard deviation.
        lamp_output: light of each lamp position from the reference, relative to the mean, with standard deviation; NaN
            without a usable reference. Merged values are not divided by this light, which is the prior of an image's gain.
        reference_light: merged value of the reference at each lamp position, by channel, with standard deviation; NaN
            without a usable reference.
        reference_between: relative standard deviation of the change of the lamp's light between an image of the
            reference and one of the sample; 0 if one frame shows both.
        linearity: departure from linearity in n ranges of codes, (n, 3): code relative to the largest code, relative
            departure, and standard deviation of the departure.
        tone_exponent: exponent of codes as a power of the nominal exposure time, with standard deviation; 1 for linear
            frames, NaN if the frames do not determine it.
        misfit: scatter of the exposures about the fitted ratios relative to noise, chi2 per degree of freedom.
        darkness: dark level to subtract, by exposure.
        used: usable frames of each lamp position, the shortest exposure first.
        channels: names of the colours.
        region: part of the frames that is used; None: the entire frame.
        remarks: warnings and limitations, with the names of the frames.
        flat: response of the pixels; None without usable flat frames.
    """

    exposures: dict[str, Stated]
    reference_exposure: str
    clip: ClipLevel
    gain: Stated
    read_noise: Stated
    lamp_output: dict[str, Stated]
    reference_light: dict[str, tuple[Stated, ...]]
    reference_between: float
    linearity: np.ndarray
    tone_exponent: Stated
    misfit: float
    darkness: dict[str, Darkness]
    used: dict[str, tuple[CaptureFrame, ...]]
    channels: tuple[str, ...]
    region: Region | None = None
    remarks: tuple[Remark, ...] = ()
    flat: FlatField | None = None

    @property
    def scale(self) -> float:
        """Unit of merged values, DN: one electron, or 1 DN if the gain is not determined."""
        return self.gain.value if math.isfinite(self.gain.value) else 1.0

    @property
    def unit(self) -> str:
        return "electrons" if math.isfinite(self.gain.value) else "DN"

    def to_dict(self) -> dict[str, Any]:
        return {
            "exposures": {name: list(value) for name, value in self.exposures.items()},
            "reference_exposure": self.reference_exposure,
            "clip_level_dn": [self.clip.level, self.clip.std],
            "clipped_pixels_seen": self.clip.pixels,
            "gain_dn_per_electron": list(self.gain),
            "read_noise_dn": list(self.read_noise),
            "lamp_output": {name: list(value) for name, value in self.lamp_output.items()},
            "reference_between": self.reference_between,
            "linearity": self.linearity.tolist(),
            "tone_exponent": list(self.tone_exponent),
            "misfit": self.misfit,
            "channels": list(self.channels),
            "flat": None if self.flat is None else {"frames": self.flat.frames, "prnu": self.flat.prnu},
            "remarks": [remark.to_dict() for remark in self.remarks],
        }


def capture_camera(capture: Capture) -> Camera | None:
    """Load the camera profile of a capture; None without a profile.

    A FileFormatError is raised if the profile is invalid, or if the mosaic of its sensor is not that of the capture. A
    FitError is raised if the sensor has a mosaic, but neither the capture nor its frames specify one.
    """
    if capture.profile is None:
        return None
    camera = Camera.load(capture.profile)
    cfa = capture.settings["camera"]["cfa"]
    if cfa and camera.sensor is not None and camera.sensor.cfa != cfa:
        raise FileFormatError(
            f"{capture.profile}: the profile is of a camera with the mosaic {camera.sensor.cfa}, but capture.toml has {cfa}: "
            "give the profile of the camera of the capture"
        )
    if not cfa and camera.sensor is not None and camera.sensor.cfa:
        reader = MosaicReader(capture)
        # a part of 2 x 2 px suffices to determine the kind of the frames
        part = next(reader.readable(capture.of("frames"), (0, 0, 2, 2)), None)
        if part is not None and reader.cfa is None:
            raise FitError(
                f"{capture.profile}: the profile is of a camera with the mosaic {camera.sensor.cfa}, but capture.toml has no "
                "camera.cfa, so the frames are read as grey: specify camera.cfa, or give the profile of the camera of the "
                "capture"
            )
    return camera


def measure_radiometry(
    capture: Capture,
    region: Region | None = None,
    progress: Progress | None = None,
    lamps: Sequence[str] | None = None,
    *,
    workers: int = 1,
    kept: KeptWork | None = None,
) -> Radiometry:
    """Calibrate a capture radiometrically.

    Args:
        capture: the capture.
        region: first column, first row, width, height of the part that is used, px; the first two even. None: that of
            the capture, or the whole frame. Default: None.
        progress: function that is called after each lamp position. Default: None.
        lamps: names of the lamp positions that are read. Default: None, all.
        workers: number of lamp positions that are read at a time. Default: 1.
        kept: cache of results from which an interrupted computation resumes. Default: None, no cache.

    Returns:
        The radiometry; its remarks name unusable frames.

    Raises:
        FitError: no lamp position has a frame that can be read, every frame is dark or clipped, or the frames are read as
            grey but their pixels alternate as in a mosaic.
    """
    region = capture.region if region is None else region
    reader, remarks = MosaicReader(capture), list(capture.problems)
    names = capture.exposures
    levels = _frame_levels(capture, reader, region, names)
    darkness, said = measure_darkness(reader, capture, region, names, levels)
    remarks += said
    step = min((level.step for level in levels.values() if math.isfinite(level.step)), default=1.0)
    noise = _read_noise(darkness, step)
    remarks += coarse_remarks(step, noise)
    samples: list[BracketSample] = []
    missing: dict[tuple[str, ...], list[str]] = {}
    wanted = list(capture.lamps if lamps is None else lamps)
    shape = next((level.shape for level in levels.values()), ())
    reading = BracketReading(capture, reader, region, names, darkness, noise, shape, kept)
    before = len(remarks)
    say = progress or (lambda step, done, total: None)
    for number, (sample, of_lamp) in enumerate(in_order(reading.read, list(enumerate(wanted)), workers)):
        remarks += of_lamp
        known = set() if sample is None else {frame.exposure for frame in sample.frames}
        lacking = tuple(name for name in names if name not in known)
        if lacking:
            missing.setdefault(lacking, []).append(wanted[number])
        if sample is not None:
            samples.append(sample)
        say("radiometry", number + 1, len(wanted))
    remarks += [
        Remark(
            "missing-frame",
            f"lamp{'s' * (len(of) > 1)} {some_of(of)}: there is no usable frame of exposure {', '.join(lacking)}; add such a "
            "frame",
        )
        for lacking, of in missing.items()
    ]
    if not samples:
        raise FitError(
            f"{capture.folder}: no frame of any lamp position can be read: {[*remarks[before:], *remarks, 'see frames.csv'][0]}"
        )
    remarks += reader.remarks.values()
    extent = np.concatenate([sample.extent for sample in samples])
    smallest, largest = float(extent[:, 0].min()), float(extent[:, 1].max())
    top = largest - min(smallest, *(d.mean for d in darkness.values()))
    samples, said = _without_mislabelled(capture, samples, names, top, noise)
    remarks += said
    order = _order(samples, len(names))
    names, samples = [names[k] for k in order], _renumbered(samples, order)
    nominal = np.array([capture.time(name) for name in names])
    if top < 10 * max(noise, 0.3) or not any(sample.codes.size for sample in samples):
        raise FitError(
            f"{capture.folder}: every frame is dark: the brightest code is {top:.0f} DN above dark; expose longer"
        )
    if all((sample.median > 0.99 * largest).all() for sample in samples):
        raise FitError(
            f"{capture.folder}: every frame is clipped: at least half of its pixels have {largest:.0f} DN; expose less"
        )
    guess = first_guess(samples, nominal, top, noise)
    clip, said = _clip_level(samples, names, guess, largest, reader.saturation, noise)
    remarks += said
    samples, said = _without_clipped(samples, names, clip, noise)
    remarks += said
    if not samples:
        raise FitError(f"{capture.folder}: every frame is clipped: its pixels have {clip.level:.0f} DN; expose less")
    seen_in = np.unique(np.concatenate([sample.exposures for sample in samples]))  # exposures that still have a frame
    names, nominal, guess = [names[k] for k in seen_in], nominal[seen_in], guess[seen_in] / guess[seen_in[0]]
    samples = _renumbered(samples, seen_in)
    gain = Stated(1.0)
    ratios = ExposureRatios(guess, np.zeros((len(names), len(names))), np.nan, np.zeros((0, 3)), False)
    for _ in range(2):  # weights require the gain, and the gain requires ratios
        ratios = fit_ratios(samples, ratios.value, clip, noise, gain.value)
        measured = fit_gain(samples, ratios.value, clip, noise)
        found = math.isfinite(measured.value) and measured.value > 0
        gain = measured if found else gain
    if not found:
        gain = _gain_without_brackets(capture, samples, clip, noise, remarks)
    reference = len(names) // 2
    value = ratios.value / ratios.value[reference]
    error = value * ratios.std(reference)
    remarks += exposure_remarks(names, ratios, nominal)
    remarks += clip_remarks(clip, names, samples)
    remarks += linearity_remarks(ratios)
    scale = gain.value if math.isfinite(gain.value) else 1.0
    flat, flat_remarks = measure_flat(reader, capture, region, darkness, clip=clip.threshold, gain=scale, noise=noise)
    response = np.ones(len(reader.channels)) if flat is None else flat.reference
    shown, between = in_sample_frames(samples), 0.0
    if capture.reference_apart:
        shown, said = in_own_frames(
            reader, capture, [sample.lamp for sample in samples], names, darkness, clip.threshold
        )
        remarks += said
    elif capture.of("reference"):
        text = "the images in reference/ are not read: specify a [reference] with apart = true, or remove them"
        remarks.append(Remark("reference-unread", text))
    seen = reference_light(shown, value, scale, noise, response)
    if capture.reference_apart:
        between = _between(capture, shown, seen, value, scale, noise, remarks)
    output = lamp_output(capture, shown, seen, between)
    remarks += flat_remarks
    return Radiometry(
        {name: Stated(float(v), float(e)) for name, v, e in zip(names, value, error, strict=True)},
        names[reference],
        clip,
        gain,
        Stated(noise, noise * _noise_error(darkness)),
        output,
        seen,
        between,
        ratios.curve,
        tone_exponent(ratios, nominal),
        ratios.misfit,
        darkness,
        {sample.lamp: sample.frames for sample in samples},
        reader.channels,
        region,
        tuple(remarks),
        flat,
    )


def _clip_level(
    samples: Sequence[BracketSample],
    names: Sequence[str],
    guess: np.ndarray,
    largest: float,
    saturation: float,
    noise: float,
) -> tuple[ClipLevel, list[Remark]]:
    """Determine the clip level, and collect remarks.

    The level is determined from shorter exposures, from a pile-up at one code, or from the file format.
    """
    clip = measure_clip_level(samples, guess, largest)
    if clip.pixels:
        return clip, []
    tops = [TopCodes(*row) for sample in samples for row in sample.tops]
    value, std = fit_gain(samples, guess, clip, noise)
    found = find_pile_up(tops, noise, value - 3 * std if math.isfinite(std) else math.nan)
    if found is None:
        return (clip if largest < saturation else ClipLevel(largest, 0.29, 0.0, 1)), []
    where = [f"lamp {sample.lamp}, exposure {names[k]}" for sample in samples for k in sample.exposures]
    remarks = [
        Remark(
            "clip-by-pile-up",
            f"{found.clip.pixels} pixels in {len(found.frames)} of the {len(tops)} frames that were read for this test have "
            f"the largest code, {found.clip.level:.0f} DN, within the read noise: this code is used as the clip level, because "
            "noise would distribute unclipped pixels over several codes",
        )
    ]
    if found.apart:
        apart = some_of([f"{where[k]} ({tops[k].level:.0f} DN)" for k in found.apart], 3)
        text = f"the largest codes of some frames differ from {found.clip.level:.0f} DN: {apart}; check for rescaled frames"
        remarks.append(Remark("clip-unclear", text))
    return found.clip, remarks


def _renumbered(samples: Sequence[BracketSample], order: np.ndarray) -> list[BracketSample]:
    """Replace the indices of the exposures by their positions in `order`, and sort the frames accordingly."""
    new = np.zeros(order.max() + 1, int)
    new[order] = np.arange(len(order))
    changed = [sample._replace(exposures=new[sample.exposures]) for sample in samples]
    return [sample.part(np.argsort(sample.exposures)) for sample in changed]


def _without(samples: Sequence[BracketSample], out: Sequence[np.ndarray]) -> list[BracketSample]:
    """Remove frames from the samples. `out` contains the mask of the removed frames of each sample."""
    return [sample.part(~mask) for sample, mask in zip(samples, out, strict=True) if not mask.all()]


def _without_mislabelled(
    capture: Capture,
    samples: Sequence[BracketSample],
    names: Sequence[str],
    top: float,
    noise: float,
) -> tuple[list[BracketSample], list[Remark]]:
    """Remove frames whose light contradicts their exposure from the samples, and report them.

    A FitError is raised if no frame remains.
    """
    nominal = np.array([capture.time(name) for name in names])
    out, said = [], []
    for sample, wrong in zip(samples, mislabelled_frames(samples, nominal, top, noise), strict=True):
        out.append(np.isin(np.arange(len(sample.exposures)), [frame for frame, _, _ in wrong]))
        for frame, factor, like in wrong:
            name = names[sample.exposures[frame]]
            file = sample.frames[frame].file
            text = f"{capture.folder / file}: the frame has {factor:.2g} times the light of exposure {name}, according to the "
            text += f"other lamp positions and time_s{'' if like is None else f', and thus that of exposure {names[like]}'}, "
            text += "so it was omitted: correct its exposure and time_s in frames.csv, or repeat it"
            said.append((file, Remark("frame-mislabelled", text)))
    remarks, kept = gathered(said), _without(samples, out)
    if not kept:
        raise FitError(f"{capture.folder}: no exposure agrees with its time_s: {remarks[0]}")
    return kept, remarks


def _without_clipped(
    samples: Sequence[BracketSample],
    names: Sequence[str],
    clip: ClipLevel,
    noise: float,
) -> tuple[list[BracketSample], list[Remark]]:
    """Remove frames that are clipped everywhere from the samples, and report them.

    A frame with a single bright code is treated as clipped at any clip level. The exception is a render of a uniform
    sample, because each frame of such a sample has a single code.
    """
    least, level, height = (TopCodes._fields.index(name) for name in ("least", "level", "height"))
    every = np.concatenate([sample.tops for sample in samples])
    even = (every[:, least] == every[:, level]).all()
    full = dict[tuple[str, float], list[str]]()
    out = []
    for sample in samples:
        low, high = sample.tops[:, least], sample.tops[:, level]
        out.append((low >= clip.threshold) | ((low == high) & (sample.tops[:, height] > 10 * noise) & ~even))
        for k in np.flatnonzero(out[-1]):
            full.setdefault((names[sample.exposures[k]], float(high[k])), []).append(sample.lamp)
    kept = _without(samples, out)
    return kept, [
        Remark(
            "frame-clipped",
            f"lamp{'s' * (len(lamps) > 1)} {some_of(lamps)}: every pixel of exposure {name} is clipped at {code:.0f} DN, "
            "so the frame was omitted: take shorter exposures",
        )
        for (name, code), lamps in full.items()
    ]


def _between(
    capture: Capture,
    shown: Sequence[SeenReference],
    light: dict[str, tuple[Stated, ...]],
    exposures: np.ndarray,
    scale: float,
    noise: float,
    remarks: list[Remark],
) -> float:
    """Determine the relative standard deviation of the change of light between images of reference and sample.

    The value is specified in the capture, or estimated from the images of the reference. If there are too few images, the
    value is lamp.gain_std.
    """
    stated = capture.settings["reference"]["between_std"]
    if stated is not None:
        return float(stated)
    found = scatter_between(shown, exposures, scale, noise, lamp_output(capture, shown, light))
    if math.isfinite(found):
        return found
    if any(one.light.size for one in shown):
        text = "the images in reference/ are too few to determine the change of light between them and those of the sample, "
        text += "so lamp.gain_std was used: take two at each lamp position, or specify reference.between_std"
        remarks.append(Remark("reference-once", text))
    return float(capture.settings["lamp"]["gain_std"])


def _frame_levels(
    capture: Capture, reader: MosaicReader, region: Region | None, names: Sequence[str]
) -> dict[str, FrameLevel]:
    """Compute the level of one frame of each exposure.

    A FitError is raised if such a frame is read as grey, but its pixels alternate as in a mosaic.
    """
    found = {}
    for name in names:
        for frame, codes in reader.readable(capture.of("frames", exposure=name), region):
            low = float(np.quantile(codes[::3, ::3], 0.05))
            found[name] = FrameLevel(low, codes.shape, code_step(codes))
            if reader.cfa is None and (share := alternation(codes - low)) > 0:
                raise FitError(
                    f"{capture.folder / frame.file}: alternate pixels differ by {share:.0%}, as in a colour mosaic that is "
                    "read as grey: if the frames are mosaics, specify camera.cfa (the colours of the first 2 x 2 px)"
                )
            break
    return found


def _order(samples: Sequence[BracketSample], count: int) -> np.ndarray:
    """Sort the indices of the exposures by the mean light of the samples, the smallest first.

    If no lamp position has all exposures, the given order is returned.
    """
    total, weight = np.zeros(count), np.zeros(count)
    for sample in samples:
        if len(sample.exposures) == count:
            total[sample.exposures] += sample.light.mean(1) if sample.light.size else 0.0
            weight[sample.exposures] += 1
    return np.argsort(total / np.maximum(weight, 1), kind="stable") if (weight > 0).all() else np.arange(count)


def _read_noise(darkness: dict[str, Darkness], step: float) -> float:
    """Compute the read noise of one frame including rounding to multiples of `step`, DN; 2 steps if it is unknown."""
    known = [d.read_noise for d in {id(d): d for d in darkness.values()}.values() if math.isfinite(d.read_noise)]
    # the variance of a rounding error is 1/12 of the squared step
    return float(max(np.median(known), math.sqrt(1 / 12) * step)) if known else 2.0 * step


def _noise_error(darkness: dict[str, Darkness]) -> float:
    known = [d for d in {id(d): d for d in darkness.values()}.values() if d.frames > 1]
    return 0.005 if known else 0.3


def _gain_without_brackets(
    capture: Capture, samples: Sequence[BracketSample], clip: ClipLevel, noise: float, remarks: list[Remark]
) -> Stated:
    try:
        camera = capture_camera(capture)
    except MatcamError:  # errors of the profile are reported where the lens is used
        camera = None
    if camera is not None and camera.sensor is not None:
        text = "the frames do not determine the gain, so that of the profile was used: take several exposures to measure it"
        remarks.append(Remark("gain-stated", text))
        return Stated(float(camera.sensor.gain), 0.1 * float(camera.sensor.gain))
    bound = fit_gain_of_single(samples, clip, noise)
    if math.isfinite(bound.value):
        text = "differences of neighbouring pixels give only an upper bound of the gain: take several exposures, or give a "
        text += "profile with a sensor"
        remarks.append(Remark("gain-bound", text))
        return bound
    remarks.append(
        Remark(
            "gain-unknown",
            "the frames do not determine the gain, and no profile specifies it: 1 DN per electron is assumed; give a profile "
            "with a sensor",
        )
    )
    return UNKNOWN_GAIN
