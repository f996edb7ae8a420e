"""Frames of a capture as mosaics of linear codes: one value per pixel, with its colour.

Grey images and raw mosaics are used directly. In an image in full colour, only one of the three values of each pixel is
used, as in a mosaic of the specified colours. If the image was demosaiced from a mosaic of these colours, the used
values are the measured ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from matcam.core.errors import FileFormatError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Region
from matcam.files.capture_frames import CaptureFrame
from matcam.files.photographs import Photograph
from matcam.files.tone_curve import decoded

ASSUMED_CFA = "RGGB"
"""Mosaic that is assumed for an image in full colour if the capture does not specify it. With another original mosaic the
values are interpolated, but do not mix colours.
"""


def origin_of(region: Region | None) -> tuple[int, int]:
    """Return row and column of the first pixel of a region, px; (0, 0) for None, the whole frame."""
    return (0, 0) if region is None else (region[1], region[0])


def frame_size(capture: Capture) -> tuple[int, int] | None:
    """Return width and height of the first readable frame of the sample, px; None if no frame is readable."""
    for frame in capture.of("frames"):
        try:
            height, width = capture.read(frame).values.shape[:2]
        except FileFormatError:
            continue
        return int(width), int(height)
    return None


@dataclass
class MosaicReader:
    """Reader of the frames of a capture as mosaics. It requires that all frames are of one kind.

    Attributes:
        capture: the capture.
        remarks: remarks on the kind of the frames, without duplicates.
        saturation: largest code that the format of the frames can hold, DN; infinite if unknown.
    """

    capture: Capture
    remarks: dict[str, Remark] = field(default_factory=dict)
    saturation: float = np.inf
    _first: tuple[str, str | None, str, bool] | None = None

    @property
    def cfa(self) -> str | None:
        """Colours of the first 2 x 2 px of an entire frame, row by row; None: grey.

        The capture or the first frame specifies the colours. Otherwise `ASSUMED_CFA` is used for frames in full colour.
        """
        stated = self.capture.settings["camera"]["cfa"] or (self._first[1] if self._first else None)
        return stated or (ASSUMED_CFA if self._first and self._first[3] else None)

    @property
    def channels(self) -> tuple[str, ...]:
        return ("grey",) if self.cfa is None else ("R", "G", "B")

    @property
    def step(self) -> int:
        """Distance between pixels of the same colour along a row, px."""
        return 1 if self.cfa is None else 2

    def channel_map(self, shape: tuple[int, ...], region: Region | None = None) -> np.ndarray:
        if self.cfa is None:
            return np.zeros(shape, np.int8)
        tile = np.array(["RGB".index(c) for c in self.cfa], np.int8).reshape(2, 2)
        rows, columns = (np.arange(n) + start for n, start in zip(shape, origin_of(region), strict=True))
        return tile[rows[:, None] % 2, columns % 2]

    def channel_means(self, codes: np.ndarray, region: Region) -> tuple[np.ndarray, np.ndarray]:
        """Compute the mean code, DN, and the number of pixels of each channel in a region, (channels,) each."""
        of, count = self.channel_map(codes.shape, region).ravel(), len(self.channels)
        pixels = np.bincount(of, minlength=count)
        return np.bincount(of, codes.ravel().astype(np.float64), count) / np.maximum(pixels, 1), pixels

    def read(self, frame: CaptureFrame, region: Region | None = None) -> np.ndarray:
        """Read the codes of a frame or a region, float32 (height, width), DN.

        A FileFormatError is raised if the file cannot be read, if its kind differs from that of the first frame, or if its
        mosaic differs from camera.cfa. It is also raised if the frame is processed and accept_processed is not set.
        """
        photograph = self.capture.read(frame, region)
        self._check(frame, photograph)
        values = photograph.values
        if self.capture.settings["camera"]["tone"] == "srgb":
            full = photograph.saturation if np.isfinite(photograph.saturation) else 1.0
            values = decoded(np.asarray(values, np.float64) / full) * full
        if values.ndim == 3:
            channel = self.channel_map(values.shape[:2], region)
            values = np.take_along_axis(values, channel[..., None].astype(np.intp), axis=2)[..., 0]
        return np.asarray(values, np.float32)

    def readable(
        self, frames: Iterable[CaptureFrame], region: Region | None = None, remarks: list[Remark] | None = None
    ) -> Iterator[tuple[CaptureFrame, np.ndarray]]:
        """Yield the frames that can be read, each with its codes. Remarks on other frames are added to `remarks`."""
        for frame in frames:
            try:
                codes = self.read(frame, region)
            except FileFormatError as error:
                if remarks is not None:
                    remarks.append(Remark("bad-frame", str(error)))
                continue
            yield frame, codes

    def _check(self, frame: CaptureFrame, photograph: Photograph) -> None:
        path = self.capture.folder / frame.file
        values, camera = photograph.values, self.capture.settings["camera"]
        colour = values.ndim == 3
        kind = (str(values.dtype), photograph.cfa, photograph.exif.camera, colour)
        if camera["cfa"] and photograph.cfa and camera["cfa"] != photograph.cfa:
            raise FileFormatError(
                f"{path}: the mosaic of the frame is {photograph.cfa}, but capture.toml has {camera['cfa']}: correct "
                "camera.cfa"
            )
        if self._first is None:
            self._first, self.saturation = kind, photograph.saturation
        elif kind != self._first:
            what = [
                f"{name} {new} instead of {old}"
                for name, new, old in zip(
                    ("samples", "mosaic", "camera", "full colour"), kind, self._first, strict=True
                )
                if new != old
            ]
            raise FileFormatError(
                f"{path}: the frame differs from the first frame ({', '.join(what)}): give frames of one kind"
            )
        processed = []
        if colour:
            processed.append(
                "demosaiced: this blurs by up to half a pixel, which a profile of the raw camera does not contain"
            )
            if camera["cfa"] is None:
                processed.append(
                    f"in full colour, and capture.toml has no camera.cfa: the mosaic {ASSUMED_CFA} is assumed; specify it"
                )
        if values.dtype.kind == "u" and values.dtype.itemsize == 1:
            processed.append(
                "of 8 bits: rounding adds 0.3 codes of noise, and a tone curve probably changes every ratio"
            )
        if camera["tone"] != "linear":
            processed.append("decoded from a tone curve: this limits the accuracy of exposure ratios and clip level")
        if processed and not camera["accept_processed"]:
            raise FileFormatError(
                f"{path}: the frame is {processed[0].split(':')[0]}: give raw frames, or accept it with "
                "camera.accept_processed = true"
                f"{', and specify its original mosaic as camera.cfa' if colour and camera['cfa'] is None else ''}"
            )
        for text in processed:
            self.remarks.setdefault(text, Remark("processed", f"the frames are {text}"))
