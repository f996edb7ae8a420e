"""Characterisation of a sensor from a series of lit and dark exposures (EMVA Standard 1288)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from matcam.calibration.sensor.characteristics import SensorCharacteristics
from matcam.calibration.sensor.exposure_statistics import (
    ExposureStatistics,
    FrameReader,
    Progress,
    measure_exposures,
)
from matcam.calibration.sensor.photon_transfer import Transfer, fit_gain, is_clipped, measure_transfer
from matcam.core import checks
from matcam.core.errors import ArgumentError
from matcam.core.registry import CFAS
from matcam.core.remark import Remark, some_of
from matcam.files.capture_settings import Stated
from matcam.files.exposure_series import read_exposure_series
from matcam.numerics.frame_noise import fixed_pattern_variance, fixed_pattern_variance_error
from matcam.numerics.normal import SIGNIFICANT

_HIDDEN = 0.24
"""Temporal variance of dark codes below which rounding hides the noise, DN^2 (EMVA 1288, 6.6)."""
_UNKNOWN = Stated(math.nan, math.inf)
"""Value that is not determined."""


def characterise_sensor(
    source: str | Path, *, bits: int | None = None, cfa: str | None = None, progress: Progress | None = None
) -> SensorCharacteristics:
    """Measure noise, gain, linearity and fixed patterns of a sensor.

    The series contains frames of an evenly lit field at several exposures, and dark frames at the same exposure times, with
    at least two frames each. For accurate fixed patterns, fifty lit and fifty dark frames at one exposure are recommended.

    Args:
        source: folder of the frames, or a descriptor of the EMVA 1288 reference data sets. In a folder, the frames are in
            the subfolders dark/ and flat/, or their names begin with these words. Exposure times are part of the names
            ("flat_20ms_1.tif") or of the metadata.
        bits: bit depth of the codes. Default: None, the bit depth in the descriptor, or the smallest bit depth that
            can represent the largest code.
        cfa: colours of the first 2 x 2 px, such as "RGGB". Default: None, those of the files, or no mosaic.
        progress: function that is called with the name of a step, the number of finished parts, and the number of all parts.
            Default: None.

    Returns:
        The characteristics; the remarks list the exposures that were not used.

    Raises:
        FileFormatError: the source contains no series, a frame is damaged, or frames differ in shape or data type.
        ArgumentError: no lit exposure or no dark exposure has two frames, a code needs more than `bits`, or an argument is
            invalid.
        FitError: dark and lit frames are exchanged, too few exposures can be used, or the codes are not linear.

    Source:
        EMVA Standard 1288, release 4.0 linear (2021); docs/sensor.md.

    Example:
        >>> matcam.characterise_sensor("no-such-folder")
        Traceback (most recent call last):
        matcam.core.errors.FileFormatError: no-such-folder: no such file
    """
    if cfa is not None:
        checks.choice("cfa", cfa, CFAS)
    checks.whole_number("bits", bits, 1, 32, optional=True)
    series = read_exposure_series(source)
    reader = FrameReader(cfa)
    found, remarks = measure_exposures(series, reader, progress or (lambda step, done, total: None))
    dark = [one for one in found if not one.exposure.lit]
    flat = [one for one in found if one.exposure.lit]
    # A stack in a descriptor, with more than twice the median number of frames, may have been taken under a different
    # illumination from the series (EMVA 1288, 8.2). Therefore, it is used for the fixed patterns only. In a folder, the
    # illumination is constant, and a stack is part of the series.
    usual = 2 * float(np.median([len(one.exposure.files) for one in flat]))
    lit = [one for one in flat if series.light_unit == "s" or len(one.exposure.files) <= usual]
    if len(lit) < len(flat):
        names = some_of([one.exposure.name for one in flat if len(one.exposure.files) > usual], 3)
        text = f"exposures with more than {usual:g} frames were used for the fixed patterns only: {names}"
        remarks.append(Remark("fixed-patterns-only", text))
    brightest = max(found, key=lambda one: one.largest)
    needed = max(int(brightest.largest), 1).bit_length()
    bits = bits or series.bits or needed
    if bits < needed:
        raise ArgumentError(
            f"bits must be at least {needed}, got {bits}: the largest code of the exposure of "
            f"{brightest.exposure.files[0]} is {brightest.largest:g}"
        )
    planes: list[Transfer] = []
    for plane in range(len(lit[0].mean)):
        transfer, transfer_remarks = measure_transfer(lit, dark, plane)
        planes.append(transfer)
        remarks += [one for one in transfer_remarks if one not in remarks]
    remarks += _dark_times(lit, dark)
    gain = fit_gain(planes)
    level = [float(one.mean.mean()) for one in dark]
    level_std = [math.sqrt(one.variance.mean() / (one.pixels * len(one.mean))) for one in dark]
    black_level, level_growth = _over_time(dark, level, level_std)
    dark_current = _per_gain(level_growth, gain)
    variance = [float(one.variance.mean()) for one in dark]
    variance_std = [
        v * one.variance_error / math.sqrt(len(one.variance)) for v, one in zip(variance, dark, strict=True)
    ]
    temporal, variance_growth = _over_time(dark, variance, variance_std)
    hidden = temporal.value < _HIDDEN
    # The variance of a rounded code is 1/12 DN^2.
    noise = math.sqrt(max(temporal.value, _HIDDEN) - 1 / 12)
    read_noise = _per_gain(Stated(noise, temporal.std / (2 * noise)), gain)
    if hidden:
        text = f"rounding hides the read noise, which is at most {read_noise.value:.3g} e-"
        remarks.append(Remark("read-noise-hidden", text))
    saturation, saturated = _saturation(planes, gain)
    if not saturated:
        remarks.append(
            Remark(
                "not-saturated",
                "no exposure saturates: the saturation capacity is a lower limit; add a longer exposure",
            )
        )
    bright = _chosen(flat, planes) or lit[0]
    shade = max(dark, key=lambda one: (-abs(one.exposure.time - bright.exposure.time), len(one.exposure.files)))
    patterns = _fixed_patterns(reader, bright, shade, gain)
    if patterns["dsnu"].value == 0:
        text = "the dark signals of the pixels do not differ significantly: the DSNU is set to 0"
        remarks.append(Remark("dsnu-not-seen", text))
    judged = np.concatenate([plane.departure[plane.judged] for plane in planes])
    full_well = saturation
    if saturated:
        full_well = _per_gain(Stated(max(float(plane.signal.max()) for plane in planes)), gain)
    return SensorCharacteristics(
        gain=gain,
        read_noise=read_noise,
        read_noise_hidden=hidden,
        black_level=black_level,
        dark_current=dark_current,
        dark_current_by_variance=_per_gain(variance_growth, gain, 2),
        dark_nonuniformity=_dark_nonuniformity(reader, dark, dark_current),
        saturation=saturation,
        saturated=saturated,
        full_well=full_well,
        linearity_error=(float(judged.min()), float(judged.max())) if judged.size else (math.nan, math.nan),
        quantum_efficiency=_per_gain(max(plane.responsivity for plane in planes), gain)
        if series.light_unit == "photons"
        else _UNKNOWN,
        bits=bits,
        cfa=reader.cfa,
        transfers=tuple(planes),
        light_unit=series.light_unit,
        remarks=tuple(remarks),
        **patterns,
    )


def _dark_times(lit: Sequence[ExposureStatistics], dark: Sequence[ExposureStatistics]) -> list[Remark]:
    times = np.array([one.exposure.time for one in dark])
    lacking = [
        t for t in (one.exposure.time for one in lit) if np.abs(times / max(t, 1e-12) - 1).min() > 0.01 and t > 0
    ]
    if not lacking:
        return []
    times_text = f"{min(lacking):g} s"
    if len(lacking) > 1:
        times_text += f" to {max(lacking):g} s ({len(lacking)} exposure times)"
    text = f"there are no dark frames of {times_text}: those of the nearest exposure time are used"
    return [Remark("dark-missing", text)]


def _over_time(dark: Sequence[ExposureStatistics], values: list[float], errors: list[float]) -> tuple[Stated, Stated]:
    """Fit a line over exposure time to a statistic of the dark frames.

    The results are the value at time 0 and the increase per second. With fewer than three exposure times, the value is that of
    the shortest time, and the increase is unknown. `errors`: standard deviations of the values due to temporal noise.
    """
    times = np.array([one.exposure.time for one in dark])
    if len(np.unique(times)) < 3:  # EMVA 1288, 7.2
        first = int(np.argmin(times))
        return Stated(values[first], errors[first]), _UNKNOWN
    parameters, covariance = np.polyfit(times, np.array(values), 1, cov=True)
    slope, offset = (Stated(float(p), float(s)) for p, s in zip(parameters, np.sqrt(np.diag(covariance)), strict=True))
    return Stated(offset.value, max(offset.std, min(errors) / math.sqrt(len(dark)))), slope


def _per_gain(value: Stated, gain: Stated, power: int = 1) -> Stated:
    """Divide a value by a power of the gain. The errors of both are assumed to be independent."""
    scaled = value.value / gain.value**power
    return Stated(scaled, math.hypot(value.std / gain.value**power, power * scaled * gain.std / gain.value))


def _saturation(planes: Sequence[Transfer], gain: Stated) -> tuple[Stated, bool]:
    """Compute the saturation capacity, e-, of the plane that saturates first.

    The second result is True if the series contains an exposure beyond saturation. The standard deviation includes the step
    between neighbouring exposures, because the true value may be anywhere between them.
    """
    plane = min(planes, key=lambda one: (not one.saturated, one.light[one.saturation]))
    at = plane.saturation
    distances = np.abs(plane.light - plane.light[at])
    step = float(np.min(distances, where=distances > 0, initial=np.inf)) / math.sqrt(12) / plane.light[at]
    signal = float(plane.responsivity.value * plane.light[at])
    relative = math.hypot(plane.responsivity.std / plane.responsivity.value, step)
    return _per_gain(Stated(signal, signal * relative), gain), plane.saturated


def _chosen(lit: Sequence[ExposureStatistics], planes: Sequence[Transfer]) -> ExposureStatistics | None:
    """Select the unclipped exposure with the most frames; None if no exposure is suitable.

    The signal must lie between 20 and 80 % of saturation. Among exposures with equally many frames, the one nearest to the
    50 % that the standard prescribes is selected.
    """

    def share(one: ExposureStatistics) -> float:
        return max((one.mean[k] - p.dark[0]) / p.signal[p.saturation] for k, p in enumerate(planes))

    good = [one for one in lit if 0.2 < share(one) < 0.8 and not is_clipped(one, lit)]
    return max(good, key=lambda one: (len(one.exposure.files), -abs(share(one) - 0.5)), default=None)


def _dark_nonuniformity(reader: FrameReader, dark: Sequence[ExposureStatistics], current: Stated) -> Stated:
    """Estimate the relative standard deviation of the dark currents of the pixels.

    Two differences of a long and a short exposure are used. Their temporal noise is independent, so that their
    covariance is the variance of the dark signals. The result is NaN if the dark current is not significant.
    """
    short, long = (pick(dark, key=lambda one: one.exposure.time) for pick in (min, max))
    if not current.value > SIGNIFICANT * current.std:
        return _UNKNOWN
    frames = [list(reader.read(one.exposure))[:2] for one in (short, long)]
    first, second = (frames[1][k].astype(np.float64) - frames[0][k] for k in (0, 1))
    products = (first - first.mean()) * (second - second.mean())
    covariance, error = float(products.mean()), float(products.std() / math.sqrt(products.size))
    growth = float(first.mean() + second.mean()) / 2
    if covariance <= 0 or growth <= 0:
        return Stated(0.0, math.sqrt(error) / max(growth, 1e-12))
    value = math.sqrt(covariance) / growth
    return Stated(value, value * error / (2 * covariance))


def _fixed_patterns(
    reader: FrameReader, bright: ExposureStatistics, dark: ExposureStatistics, gain: Stated
) -> dict[str, Any]:
    """Measure the fixed patterns of a lit and of a dark exposure. The keys are attributes of `SensorCharacteristics`."""
    exposures = bright, dark
    means = [reader.mean(one.exposure) for one in exposures]
    planes = [reader.planes(mean) for mean in means]

    def variances(own: bool) -> np.ndarray:
        """Compute the variances between pixels and the errors of the variances, (exposures, planes, 2) DN^2."""
        parts = [
            [_variance(p, of, k, own) for k, p in enumerate(some)] for some, of in zip(planes, exposures, strict=True)
        ]
        return np.array(parts)

    def root(square: np.ndarray, error: np.ndarray) -> Stated:
        return _root(float(square.mean()), float(np.hypot.reduce(error)) / error.size)

    level = np.array([[plane.mean() for plane in some] for some in planes])
    signal = (level[0] - level[1]) ** 2

    def response(own: bool) -> Stated:
        value, error = np.moveaxis(variances(own), -1, 0)
        return root((value[0] - value[1]) / signal, np.hypot(*error) / signal)

    prnu, prnu_pixel, dsnu = response(False), response(True), _per_gain(root(*variances(False)[1].T), gain)
    light = means[0] - means[1]
    for plane, shade in zip(reader.planes(light), planes[1], strict=True):
        plane /= plane.mean()
        shade -= shade.mean()
    return {
        "prnu": prnu, "prnu_pixel": prnu_pixel, "dsnu": dsnu, "dsnu_time": float(dark.exposure.time), "prnu_map": light,
        "dsnu_map": means[1] / gain.value,
    }  # fmt: skip


def _variance(pixels: np.ndarray, of: ExposureStatistics, plane: int, own: bool) -> Stated:
    """Compute the variance between the temporal means of the pixels of a plane, without temporal noise, DN^2.

    If `own` is True, the variance of the row means and column means is excluded.
    """
    temporal, frames = float(of.variance[plane]), len(of.exposure.files)
    value = fixed_pattern_variance(float(pixels.var(ddof=1)), temporal, frames)
    if own:
        # The means of the rows and columns reduce the degrees of freedom (EMVA 1288, 8.2.3).
        for axis, count in enumerate(pixels.shape):
            value -= fixed_pattern_variance(float(pixels.mean(axis).var()), temporal, frames * count)
        value *= pixels.size / (pixels.size - sum(pixels.shape))
    return Stated(value, fixed_pattern_variance_error(value, temporal, frames, pixels.size))


def _root(square: float, error: float) -> Stated:
    if square <= 0:
        return Stated(0.0, math.sqrt(max(error, 0.0)))
    return Stated(math.sqrt(square), min(error / (2 * math.sqrt(square)), math.sqrt(error)))
