"""Vignetting and pixel response non-uniformity, from frames of a uniform field.

For each colour, the dark-subtracted mean of the flat frames is the product of a smooth field and the relative response of
each pixel. The smooth field contains vignetting and shadows of dust. The relative response is shrunk towards 1 according to
the noise of the flat frames (James and Stein 1961). For example, two frames of 15,000 electrons determine the response of a
pixel to 0.6 %, and the responses of a sensor differ by about 1 %. The remaining uncertainty is added to the errors of the
merged values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial
from scipy.ndimage import uniform_filter

from matcam.acquisition.darkness import Darkness, dark_level
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.core.errors import FileFormatError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Region
from matcam.files.capture_frames import CaptureFrame
from matcam.files.picture_header import read_exif
from matcam.numerics.normal import robust_fit, robust_std


@dataclass(frozen=True)
class FlatField:
    """Response of the pixels, about 1 in the middle of the frames.

    Attributes:
        response: response of each pixel relative to the mean of its colour in the middle of the frame, float32
            (height, width); NaN if it is too small to be corrected.
        std: relative standard deviation of `response`, one value for each colour, (channels,).
        reference: mean response over the reference region in each channel, (channels,); 1 without a reference.
        prnu: photo-response non-uniformity: relative standard deviation of the pixels' responses about the smooth field,
            without noise, averaged over the colours, no unit.
        frames: number of flat frames that were used.
    """

    response: np.ndarray
    std: np.ndarray
    reference: np.ndarray
    prnu: float
    frames: int


def measure_flat(
    reader: MosaicReader,
    capture: Capture,
    region: Region | None,
    darkness: dict[str, Darkness],
    *,
    clip: float,
    gain: float,
    noise: float,
) -> tuple[FlatField | None, list[Remark]]:
    """Measure the response of the pixels from the flat frames, and collect remarks.

    Args:
        reader: the reader of frames.
        capture: the capture.
        region: part of the frames that is used; None: the whole frame.
        darkness: dark signal of the exposures of the sample.
        clip: smallest code of a clipped pixel, DN.
        gain: DN per electron.
        noise: read noise, DN.

    Returns:
        The flat field, or None without a usable flat frame, and the remarks.
    """
    total: np.ndarray | None = None
    patch: np.ndarray | None = None
    count, remarks = 0, []
    # 16 frames bound the time of reading
    for frame in capture.of("flat")[:16]:
        path = capture.folder / frame.file
        try:
            codes = reader.read(frame, region)
            known = darkness.get(frame.exposure)
            level = dark_level(reader, capture, frame.exposure, region) if known is None else known.level
            light = codes - np.asarray(level, np.float32)
            beside = _beside(reader, capture, frame, darkness)
        except (FileFormatError, ValueError) as error:
            text = (
                str(error)
                if isinstance(error, FileFormatError)
                else f"{path}: the flat frame differs in size from its dark frames: repeat them with the same settings"
            )
            remarks.append(Remark("bad-flat", text))
            continue
        wrong = _wrong(capture, frame, codes, light, clip, noise, None if total is None else total.shape)
        if wrong:
            remarks.append(Remark("bad-flat", f"{path}: {wrong}; the frame was omitted"))
            continue
        total = light.astype(np.float64) if total is None else total + light
        patch = beside if patch is None or beside is None else patch + beside
        count += 1
    if total is None:
        return None, remarks
    channel = reader.channel_map(total.shape, region)
    response, stds, spreads, levels = np.ones(total.shape, np.float32), [], [], []
    for c in range(len(reader.channels)):
        of = channel == c
        field, level = smooth_field(total, of)
        departure = total[of] / field - 1
        chance = float(np.mean((gain * field + count * noise**2) / field**2))
        scatter = robust_std(departure) ** 2
        own = max(scatter - chance, 0.0)
        share = own / max(own + chance, 1e-30)
        response[of] = field / level * (1 + share * departure)
        stds.append(np.sqrt(own * chance / max(own + chance, 1e-30)))
        spreads.append(np.sqrt(own))
        levels.append(level)
    # a correction of a smaller response would amplify the noise of a pixel more than tenfold
    response[response < 0.1] = np.nan
    beside = np.ones(len(levels)) if patch is None else patch / np.array(levels)
    return FlatField(response, np.array(stds), beside, float(np.mean(spreads)), count), remarks


def smooth_field(total: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit a smooth field to the pixels of one colour in a flat frame.

    The results are the field at these pixels, DN (n,), and its mean in the middle of the frame, DN.

    Args:
        total: dark-subtracted flat frame, (height, width), DN.
        of: mask of the pixels of the colour, (height, width).
    """
    row, column = (np.linspace(-1, 1, size) for size in total.shape)
    some = tuple(np.argwhere(of)[:: max(1, int(of.sum()) // 20_000)].T)
    low = np.add.outer(range(5), range(5)) < 5  # powers of row and column of a polynomial of degree 4
    design = polynomial.polyvander2d(row[some[0]], column[some[1]], (4, 4))[:, low.ravel()]
    coefficients = np.zeros(low.shape)
    coefficients[low] = robust_fit(design, total[some]).parameters
    trend = np.maximum(polynomial.polygrid2d(row, column, coefficients), 1e-9)
    # the local residual contains dust, and structure that a polynomial does not describe
    local, weight = np.where(of, total / trend, 0.0), of.astype(float)
    for _ in range(2):
        # width of the square moving average that is applied twice for the smooth field, px
        local, weight = (uniform_filter(one, 33, mode="constant") for one in (local, weight))
    field = np.maximum(trend[of] * local[of] / np.maximum(weight[of], 1e-9), 1e-9)
    middle = np.hypot(row[:, None], column)[of] < 0.5
    return field, float(np.mean(field[middle] if middle.any() else field))


def _beside(
    reader: MosaicReader, capture: Capture, frame: CaptureFrame, darkness: dict[str, Darkness]
) -> np.ndarray | None:
    region = capture.reference_position
    if region is None:
        return None
    means, _ = reader.channel_means(reader.read(frame, region), region)
    return np.asarray(means - darkness.get(frame.exposure, next(iter(darkness.values()))).mean)


def _wrong(
    capture: Capture,
    frame: CaptureFrame,
    codes: np.ndarray,
    light: np.ndarray,
    clip: float,
    noise: float,
    shape: Sequence[int] | None,
) -> str:
    """Describe the fault of a flat frame; the text is empty if the frame is usable."""
    sizes = [read_exif(capture.folder / one.file).size for one in (frame, capture.of("frames")[0])]
    if shape not in (None, codes.shape) or (None not in sizes and sizes[0] != sizes[1]):
        return "the flat frame differs in size from other frames: repeat it with the settings of the sample's frames"
    if np.mean(codes >= clip) > 1e-3:
        return f"{np.mean(codes >= clip):.1%} of the flat frame's pixels are clipped: expose it less"
    level = float(np.median(light))
    # the read noise is then at most 1 % of the signal
    if level < 100.0 * max(noise, 0.3):
        return f"the flat frame is too dark, only {level:.0f} DN above the dark level: expose it more"
    return ""
