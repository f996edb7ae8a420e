"""Reading of the exposures of each lamp position for the radiometric calibration, with a cache of the results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from matcam.acquisition.bracket_sample import BracketSample, choose_pixels, noise_correlation, same_colour_neighbours
from matcam.acquisition.darkness import Darkness
from matcam.acquisition.light.kept_work import KeptWork, fingerprint, identity
from matcam.acquisition.light.pile_up import top_codes
from matcam.acquisition.mosaic_frames import MosaicReader
from matcam.acquisition.radiometry_remarks import processing_remarks
from matcam.core.errors import FileFormatError
from matcam.core.remark import Remark
from matcam.files.capture import Capture, Region
from matcam.files.capture_frames import CaptureFrame

ReadBracket = tuple[BracketSample | None, tuple[Remark, ...]]
"""Selected pixels of a lamp position, None without a usable frame, and remarks that name frames."""


@dataclass
class BracketReading:
    """Reader of the brackets (series of exposures) of one capture.

    Attributes:
        capture: the capture.
        reader: the reader of frames.
        region: part of the frames that is used; None: the whole frame.
        names: names of the exposures.
        darkness: dark signal of each exposure.
        noise: standard deviation of one pixel's read noise, DN.
        shape: height and width of the first frames, px.
        kept: cache of results; None: no cache.
    """

    capture: Capture
    reader: MosaicReader
    region: Region | None
    names: Sequence[str]
    darkness: dict[str, Darkness]
    noise: float
    shape: tuple[int, ...]
    kept: KeptWork | None = None

    def __post_init__(self) -> None:
        about = (
            self.region,
            self.capture.reference_region,
            self.capture.settings["camera"],
            list(self.names),
            self.noise,
        )
        levels = [value for name in self.names for value in (self.darkness[name].level, self.darkness[name].hot)]
        self._about = "" if self.kept is None else fingerprint(*about, *levels)

    def read(self, numbered: tuple[int, str]) -> ReadBracket:
        """Read the frames of a lamp position, or load the result from the cache.

        `numbered` contains the index and the name of the lamp position.
        """
        if self.kept is None:
            return self._read(numbered)
        frames = self.capture.of("frames", lamp=numbered[1])
        paths = [self.capture.folder / frame.file for frame in frames]
        text = f"bracket of {BracketSample._fields} {numbered} {self.shape} {self._about} {frames}\n{identity(paths)}"
        failed: list[ReadBracket] = []

        def made() -> dict[str, np.ndarray]:
            found = self._read(numbered)
            if any(remark.code == "bad-frame" for remark in found[1]):
                failed.append(found)  # not stored, because a slow disk or little memory may be temporary
                return {}
            return _packed(found)

        arrays = self.kept.store(text, made)
        if failed:
            return failed[0]
        return _unpacked(arrays, frames)

    def _read(self, numbered: tuple[int, str]) -> ReadBracket:
        number, lamp = numbered
        remarks: list[Remark] = []
        bracket = self._bracket(lamp, remarks)
        if not bracket:
            return None, tuple(remarks)
        sample = self._sample(lamp, bracket, number)
        if number == 0:
            frame, codes = bracket[0]
            light = codes - np.asarray(self.darkness[frame.exposure].level, np.float32)
            correlation = noise_correlation(light, self.noise)
            remarks += processing_remarks(str(self.capture.folder / frame.file), *correlation)
        return sample, tuple(remarks)

    def _bracket(self, lamp: str, remarks: list[Remark]) -> list[tuple[CaptureFrame, np.ndarray]]:
        found: dict[str, tuple[CaptureFrame, np.ndarray]] = {}
        for frame in self.capture.of("frames", lamp=lamp):
            path = self.capture.folder / frame.file
            if frame.exposure in found:
                text = (
                    f"{path}: this second frame of lamp {lamp}, exposure {frame.exposure}, was omitted: "
                    "remove one of the two"
                )
                remarks.append(Remark("extra-frame", text))
                continue
            try:
                codes = self.reader.read(frame, self.region)
            except FileFormatError as error:
                remarks.append(Remark("bad-frame", str(error)))
                continue
            if codes.shape != self.shape:
                text = f"{path}: the frame has {codes.shape[1]} x {codes.shape[0]} px, but the first frames have "
                text += f"{self.shape[1]} x {self.shape[0]} px, so it was omitted: give frames of one size"
                remarks.append(Remark("other-size", text))
                continue
            if not np.isfinite(codes).all():
                text = (
                    f"{path}: the frame contains values that are not finite, so it was omitted: repeat it, or remove it"
                )
                remarks.append(Remark("bad-frame", text))
                continue
            found[frame.exposure] = frame, codes
        return [found[name] for name in self.names if name in found]

    def _sample(self, lamp: str, bracket: list[tuple[CaptureFrame, np.ndarray]], seed: int) -> BracketSample:
        reader, darkness = self.reader, self.darkness
        hot = np.zeros(bracket[0][1].shape, bool)
        around, light = [], []
        for frame, codes in bracket:
            dark = darkness[frame.exposure]
            hot |= dark.hot_pixels(hot.shape)
            light.append(codes - np.asarray(dark.level, np.float32))
            around.append(same_colour_neighbours(light[-1], self.reader.step).ravel())
        neighbours = np.stack(around)
        neighbours[:, hot.ravel()] = 0
        order = np.argsort(neighbours.mean(1))
        chosen = choose_pixels(neighbours[order], self.noise, seed)
        channels = len(reader.channels)
        reference, numbers = np.full((len(bracket), channels), np.nan), np.zeros(channels, int)
        patch_region = self.capture.reference_region
        if patch_region is not None:
            ceiling = max(codes.max() for _, codes in bracket)
            for i, (frame, _) in enumerate(bracket):
                patch = reader.read(frame, patch_region)
                means, numbers = reader.channel_means(patch, patch_region)
                if patch.max() < 0.9 * ceiling:
                    reference[i] = means - darkness[frame.exposure].mean
        return BracketSample(
            lamp,
            tuple(frame for frame, _ in bracket),
            np.array([list(self.names).index(frame.exposure) for frame, _ in bracket]),
            np.stack([codes.ravel()[chosen] for _, codes in bracket]),
            np.stack([one.ravel()[chosen] for one in light]),
            neighbours[:, chosen],
            reference,
            numbers,
            np.array([float(np.median(codes[::3, ::3])) for _, codes in bracket]),
            np.array(
                [
                    top_codes(codes, darkness[f.exposure].level, hot, self.reader.step, self.noise)
                    for f, codes in bracket
                ]
            ),
            np.array([(codes.min(), codes.max()) for _, codes in bracket], float),
        )


def _packed(found: ReadBracket) -> dict[str, np.ndarray]:
    sample, remarks = found
    arrays: dict[str, Any] = (
        {} if sample is None else {f"sample_{name}": value for name, value in sample._asdict().items()}
    )
    if sample is not None:
        arrays["sample_frames"] = [frame.file for frame in sample.frames]
    arrays |= {"codes": [remark.code for remark in remarks], "texts": [remark.text for remark in remarks]}
    return {name: np.asarray(value) for name, value in arrays.items()}


def _unpacked(arrays: Mapping[str, np.ndarray], frames: Sequence[CaptureFrame]) -> ReadBracket:
    remarks = tuple(Remark(*pair) for pair in zip(arrays["codes"].tolist(), arrays["texts"].tolist(), strict=True))
    if "sample_lamp" not in arrays:
        return None, remarks
    by_file = {frame.file: frame for frame in frames}
    parts: dict[str, Any] = {name: arrays[f"sample_{name}"] for name in BracketSample._fields}
    parts |= {"lamp": str(parts["lamp"]), "frames": tuple(by_file[name] for name in parts["frames"].tolist())}
    return BracketSample(**parts), remarks
