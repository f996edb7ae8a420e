"""Mean, temporal variance and clipping of the frames of each exposure, for each plane of the mosaic."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.remark import Remark
from matcam.files.exposure_series import ExposureSeries, ExposureSet
from matcam.files.photographs import open_photograph
from matcam.numerics.frame_noise import pair_variance, pair_variance_error

Progress = Callable[[str, int, int], None]
"""Function that is called with the name of a step, the number of finished parts, and the number of all parts."""


class ExposureStatistics(NamedTuple):
    """Statistics of the frames of one exposure.

    Attributes:
        exposure: frames of the exposure.
        light: photons per pixel, or exposure time, s.
        mean: mean code of each plane, DN, (planes,).
        variance: temporal variance of a pixel, DN^2, (planes,).
        variance_error: relative standard deviation of `variance`, no unit.
        largest: largest code, DN.
        at_largest: share of the pixels of a plane that have the largest code; maximum over the planes, no unit.
        pixels: number of pixels of a plane.
    """

    exposure: ExposureSet
    light: float
    mean: np.ndarray
    variance: np.ndarray
    variance_error: float
    largest: float
    at_largest: float
    pixels: int


class FrameReader:
    """Reader of the frames of a series. All frames must have the same shape and data type.

    Args:
        cfa: colours of the first 2 x 2 px; None to use those of the files.

    Attributes:
        cfa: colours of the first 2 x 2 px; None if there is no mosaic.
    """

    def __init__(self, cfa: str | None):
        self.cfa = cfa
        self._kind: tuple[tuple[int, ...], str] | None = None

    def read(self, exposure: ExposureSet) -> Iterator[np.ndarray]:
        """Read the frames of an exposure, (height, width) each, in the data type of the file."""
        for path in exposure.files:
            photograph = open_photograph(path)
            values = photograph.values
            if values.ndim == 3:
                if not (values[..., :1] == values).all():
                    raise FileFormatError(
                        f"{path}: the frame is a colour image, whose noise was changed by processing: give raw or grey frames"
                    )
                values = values[..., 0]
            kind = (values.shape, str(values.dtype))
            if self._kind is None:
                self._kind, self.cfa = kind, self.cfa or photograph.cfa
            elif kind != self._kind:
                was, new = (f"{shape[1]} x {shape[0]} px of {dtype}" for shape, dtype in (self._kind, kind))
                raise FileFormatError(
                    f"{path}: the frame has {new}, but the preceding frames have {was}: give frames of the same "
                    "shape and data type"
                )
            yield values

    def planes(self, frame: np.ndarray) -> list[np.ndarray]:
        return [frame] if self.cfa is None else [frame[i::2, j::2] for i in (0, 1) for j in (0, 1)]

    def mean(self, exposure: ExposureSet) -> np.ndarray:
        """Compute the mean frame of an exposure, DN, (height, width)."""
        total, count = np.zeros(()), 0
        for frame in self.read(exposure):
            total, count = total + frame.astype(np.float64), count + 1
        return total / count


def measure_exposures(
    series: ExposureSeries, reader: FrameReader, progress: Progress
) -> tuple[list[ExposureStatistics], list[Remark]]:
    """Compute the statistics of every exposure with at least two frames.

    Args:
        series: the exposures.
        reader: reader of the frames.
        progress: function that is called after each exposure.

    Returns:
        Statistics in the order of the series, and remarks on exposures that were excluded.

    Raises:
        ArgumentError: no dark exposure, or no lit exposure, has two frames.
    """
    found, remarks = [], []
    for number, exposure in enumerate(series.sets):
        if len(exposure.files) < 2:
            text = (
                f"{exposure.files[0]}: this exposure was excluded, because an estimate of its noise requires two frames: "
                "add a frame"
            )
            remarks.append(Remark("single-frame", text))
        else:
            found.append(_statistics(series, exposure, reader))
        progress("exposures", number + 1, len(series.sets))
    for lit, kind in ((True, "lit"), (False, "dark")):
        if not any(one.exposure.lit == lit for one in found):
            raise ArgumentError(
                f"{series.source}: no {kind} exposure has two frames: give at least two frames of each exposure"
            )
    return found, remarks


def _statistics(series: ExposureSeries, exposure: ExposureSet, reader: FrameReader) -> ExposureStatistics:
    means, variances, largest, at_largest = [], [], -np.inf, 0.0
    before: Sequence[np.ndarray] = ()
    for frame in reader.read(exposure):
        planes = reader.planes(frame)
        means.append([float(plane.mean(dtype=np.float64)) for plane in planes])
        if before:
            variances.append([pair_variance(a, b) for a, b in zip(before, planes, strict=True)])
        top = float(frame.max())
        share = max(float(np.mean(plane == top)) for plane in planes)
        at_largest = share if top > largest else max(share, at_largest) if top == largest else at_largest
        largest, before = max(largest, top), planes
    pixels = min(plane.size for plane in before)
    error = pair_variance_error(len(means), pixels)
    mean, variance = np.mean(means, axis=0), np.mean(variances, axis=0)
    return ExposureStatistics(exposure, series.light(exposure), mean, variance, error, largest, at_largest, pixels)
