"""Results of the characterisation of a sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from matcam.calibration.sensor.photon_transfer import Transfer
from matcam.camera.sensor import Sensor
from matcam.core import checks
from matcam.core.remark import Remark
from matcam.core.results.summary import Quantity, Summarised, Summary
from matcam.files.capture_settings import Stated


@dataclass(frozen=True, repr=False)
class SensorCharacteristics(Summarised):
    """Characteristics of a sensor according to EMVA Standard 1288.

    A measured value is a `Stated`, which contains the value and its standard deviation in the same unit.

    Attributes:
        gain: system gain K, DN per e-.
        read_noise: temporal noise of a dark pixel, without the noise of rounding, e-; an upper limit if
            `read_noise_hidden`.
        read_noise_hidden: whether rounding hides the read noise.
        black_level: mean dark code at exposure time 0, DN; at the shortest exposure if there are fewer than three times.
        dark_current: increase of the dark signal with time, e-/s; NaN for fewer than three exposure times.
        dark_current_by_variance: increase of the dark variance with time, e-/s; NaN for fewer than three exposure times.
        dark_nonuniformity: relative standard deviation of the dark currents of the pixels, no unit; NaN if the dark
            current is not significant.
        saturation: saturation capacity, e-: signal at the largest temporal variance; a lower limit if not `saturated`.
        saturated: whether the series contains an exposure beyond saturation.
        full_well: largest mean signal of an exposure, e-, if the series contains an exposure beyond saturation;
            otherwise the saturation capacity.
        prnu: photo-response non-uniformity: relative standard deviation of the sensitivities of the pixels, including the
            variation of the illumination, no unit.
        prnu_pixel: as `prnu`, but without the variation that the pixels of a row or a column have in common, no unit.
        dsnu: dark signal non-uniformity: standard deviation of the dark signals of the pixels, e-.
        dsnu_time: exposure time of the dark frames from which `dsnu` was determined, s.
        linearity_error: smallest and largest deviation from a straight line between 5 and 95 % of saturation, no unit.
        quantum_efficiency: electrons per photon, no unit; NaN if the number of photons is not specified.
        bits: bit depth of the codes; None if the codes are not rounded.
        cfa: colours of the first 2 x 2 px; None if there is no mosaic.
        prnu_map: sensitivity of each pixel relative to the mean of its colour, dark signal subtracted, (height, width).
        dsnu_map: dark signal of each pixel minus the mean of its colour, e-, (height, width).
        transfers: signal, variance and deviation from linearity of every exposure, for each plane of the mosaic.
        light_unit: unit of the light of the exposures, "photons" or "s".
        remarks: remarks on the result, such as the exposures that were not used. Default: (), no remarks.

    Source:
        EMVA Standard 1288, release 4.0 linear (2021).

    Example:
        >>> import pathlib, tempfile
        >>> sensor = matcam.Sensor(5e-6, full_well=2000, read_noise=5.0, gain=0.5, bits=12)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     for seed in range(32):
        ...         time, kind = 1 + seed // 4, "dark" if seed % 2 else "flat"
        ...         frame = sensor.expose(np.full((64, 64), 100.0 * time if kind == "flat" else 0.0), 1.0, seed)
        ...         matcam.io.write_float_tiff(pathlib.Path(folder, f"{kind}_{time}ms_{seed}.tif"), frame)
        ...     found = matcam.characterise_sensor(folder, bits=12)
        >>> abs(found.gain.value - 0.5) < 4 * found.gain.std, found.saturated
        (True, False)
        >>> print(found.summary().splitlines()[0])
        [[Sensor characteristics (EMVA 1288)]]
    """

    gain: Stated
    read_noise: Stated
    read_noise_hidden: bool
    black_level: Stated
    dark_current: Stated
    dark_current_by_variance: Stated
    dark_nonuniformity: Stated
    saturation: Stated
    saturated: bool
    full_well: Stated
    prnu: Stated
    prnu_pixel: Stated
    dsnu: Stated
    dsnu_time: float
    linearity_error: tuple[float, float]
    quantum_efficiency: Stated
    bits: int | None
    cfa: str | None
    prnu_map: np.ndarray
    dsnu_map: np.ndarray
    transfers: Sequence[Transfer]
    light_unit: str
    remarks: tuple[Remark, ...] = field(default=())

    @property
    def snr_max(self) -> Stated:
        """Signal-to-noise ratio of a pixel at saturation, no unit."""
        value = math.sqrt(self.saturation.value)
        return Stated(value, self.saturation.std / (2 * value))

    @property
    def dynamic_range(self) -> Stated:
        """Dynamic range: saturation capacity divided by the smallest detectable signal, no unit."""
        rounding = 0.0 if self.bits is None else 1 / (12 * self.gain.value**2)
        noise = math.sqrt(self.read_noise.value**2 + rounding)
        value = self.saturation.value / (noise + 0.5)
        noise_error = self.read_noise.value * self.read_noise.std / max(noise, 1e-12) / (noise + 0.5)
        return Stated(value, value * math.hypot(self.saturation.std / self.saturation.value, noise_error))

    def sensor(self, pitch: float) -> Sensor:
        """Build the sensor of a camera profile.

        `picture`, `simulate` and `reconstruct` use this sensor. Its PRNU is `prnu_pixel`, because the model has independent
        pixels. Its DSNU is the part of `dsnu` that does not increase with time.

        Args:
            pitch: pixel pitch, m.

        Raises:
            ArgumentError: the pitch or a measured value is out of the range of `Sensor`.
        """
        return Sensor(
            pitch,
            full_well=self.full_well.value,
            read_noise=min(self.read_noise.value, 1e6),
            gain=self.gain.value,
            bits=self.bits,
            cfa=self.cfa,
            prnu=min(self.prnu_pixel.value, 1.0),
            dark_current=max(np.nan_to_num(self.dark_current.value), 0.0),
            dark_nonuniformity=min(np.nan_to_num(self.dark_nonuniformity.value), 10.0),
            black_level=max(self.black_level.value, 0.0),
            dsnu=self._offset_nonuniformity,
        )

    @property
    def _offset_nonuniformity(self) -> float:
        """Standard deviation of the offsets of pixels, e-: `dsnu` without the contribution of the dark currents."""
        grown = np.nan_to_num(self.dark_nonuniformity.value * max(self.dark_current.value, 0.0)) * self.dsnu_time
        return math.sqrt(max(self.dsnu.value**2 - grown**2, 0.0))

    def snr(self, signal: np.ndarray) -> np.ndarray:
        """Compute the signal-to-noise ratio from gain and read noise, no unit.

        Args:
            signal: code above dark, DN, any shape.
        """
        signal = np.asarray(checks.within("signal", signal, 0, np.inf, "DN above dark"))
        rounding = 0.0 if self.bits is None else 1 / 12
        variance = self.gain.value * signal + (self.gain.value * self.read_noise.value) ** 2 + rounding
        return np.asarray(signal / np.sqrt(variance))

    def columns(self) -> dict[str, Any]:
        """List signal, noise and deviation from linearity of every lit exposure.

        Returns:
            Arrays by name. The arrays of the planes of a mosaic are concatenated.
        """
        parts = []
        for number, plane in enumerate(self.transfers):
            judged = plane.judged
            parts.append(
                {
                    "plane": np.full(len(plane.light), number),
                    "exposure_s": plane.time,
                    f"light_{self.light_unit}": plane.light,
                    "signal_dn": plane.signal,
                    "dark_dn": plane.dark,
                    "variance_dn2": plane.variance,
                    "variance_std_dn2": plane.variance_std,
                    "dark_variance_dn2": plane.dark_variance,
                    "snr": plane.signal / np.sqrt(np.maximum(plane.variance, 1e-12)),
                    "snr_model": self.snr(np.maximum(plane.signal, 0)),
                    "departure": np.where(judged, plane.departure, np.nan),
                    "used": plane.used.astype(int),
                }
            )
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    @property
    def verdict(self) -> str:
        """Linearity of the sensor in one sentence."""
        used = sum(int(plane.used.sum()) for plane in self.transfers)
        low, high = (100 * error for error in self.linearity_error)
        return f"the gain was fitted to {used} exposures; the signal deviates by {low:+.2f} to {high:+.2f} % from linearity"

    def quantities(self) -> list[Quantity]:
        """List the values that are determined, with their standard deviations."""
        rows = [
            ("gain, DN per e-", self.gain),
            ("read noise" + (" (upper limit)" if self.read_noise_hidden else "") + ", e-", self.read_noise),
            ("dark current, e-/s", self.dark_current),
            ("black level, DN", self.black_level),
            ("saturation capacity" + ("" if self.saturated else " (lower limit)") + ", e-", self.saturation),
            ("full well, e-", self.full_well),
            ("PRNU, %", _percent(self.prnu)),
            ("PRNU of single pixels, %", _percent(self.prnu_pixel)),
            ("DSNU, e-", self.dsnu),
            ("largest signal-to-noise ratio", self.snr_max),
            ("dynamic range", self.dynamic_range),
            ("quantum efficiency, %", _percent(self.quantum_efficiency)),
        ]
        return [Quantity(name, value, std) for name, (value, std) in rows if np.isfinite(value)]

    def _summary(self) -> Summary:
        return Summary(
            "Sensor characteristics (EMVA 1288)", f"{self.verdict}.", {"Values": self.quantities()}, self.remarks
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert the result to the JSON object of `matcam sensor --json`.

        Returns:
            Values with their standard deviations by name, with units in the names.
        """
        values = {
            "gain_dn_per_electron": self.gain,
            "read_noise_electrons": self.read_noise,
            "black_level_dn": self.black_level,
            "dark_current_electrons_per_s": self.dark_current,
            "dark_current_by_variance_electrons_per_s": self.dark_current_by_variance,
            "dark_nonuniformity": self.dark_nonuniformity,
            "saturation_electrons": self.saturation,
            "full_well_electrons": self.full_well,
            "prnu": self.prnu,
            "prnu_pixel": self.prnu_pixel,
            "dsnu_electrons": self.dsnu,
            "quantum_efficiency": self.quantum_efficiency,
            "snr_max": self.snr_max,
            "dynamic_range": self.dynamic_range,
        }
        return {
            **{name: list(value) for name, value in values.items()},
            "read_noise_hidden": self.read_noise_hidden,
            "saturated": self.saturated,
            "linearity_error": list(self.linearity_error),
            "bits": self.bits,
            "cfa": self.cfa,
            "remarks": [remark.to_dict() for remark in self.remarks],
        }


def _percent(share: Stated) -> Stated:
    return Stated(100 * share.value, 100 * share.std)
