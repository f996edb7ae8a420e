"""A capture: a folder of photographs of a sample under a moved lamp, and what is known of the rig.

    capture.toml    what is known: units in the names, a value or [value, standard deviation]
    frames.csv      file,lamp,angle_deg,azimuth_deg,exposure,time_s     one line a picture; empty where it does not apply
    frames/         pictures of the sample, one for each lamp position and exposure
    dark/           lens covered, by exposure
    flat/           evenly lit, pairs of one exposure
    outline/        the sample before a bright field
    reference/      a white or monitor picture for a lamp position

docs/capture.md lists the fields, `json_schema()` is the published schema (docs/capture-v1.schema.json). Bad settings are an
error; a bad picture is left out and named in `Capture.problems`. Nothing outside of the folder is read.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat, ValidationError, WithJsonSchema

from matcam.core.errors import FileFormatError
from matcam.core.io import checked_version, first_problem
from matcam.core.registry import CFAS
from matcam.core.remark import Remark
from matcam.files.capture_list import LIST, CaptureFrame, LampGuess, inside, read_list, read_text, unlisted
from matcam.files.photographs import Photograph, open_photograph

FORMAT, VERSION = "matcam capture", 1
SETTINGS = "capture.toml"
_WHAT = "a capture"

Region = tuple[int, int, int, int]
"""Part of a frame: first column, first row, width, height, px."""


class Stated(NamedTuple):
    """Hold a stated value with its standard deviation, in one unit; a standard deviation of 0 says that it is exact."""

    value: float
    std: float = 0.0


def _stated(low: float, high: float = math.inf) -> tuple[BeforeValidator, WithJsonSchema]:
    """Return what checks a value or [value, standard deviation] within limits, and its schema; it is kept as a list of two."""

    def check(value: Any) -> list[float]:
        pair = value if isinstance(value, list) else [value, 0.0]
        if len(pair) != 2 or any(isinstance(v, bool) or not isinstance(v, int | float) for v in pair):
            raise ValueError("must be a value or [value, standard deviation]")
        number, std = map(float, pair)
        if not (math.isfinite(number) and math.isfinite(std)) or std < 0:
            raise ValueError("must be finite, with a standard deviation of at least 0")
        if not low <= number <= high:
            raise ValueError(f"must lie in [{low:g}, {high:g}], got {number:g}")
        return [number, std]

    number = {"type": "number", "minimum": low}
    pair = {"type": "array", "prefixItems": [number, {"type": "number", "minimum": 0}], "minItems": 2, "maxItems": 2}
    return BeforeValidator(check), WithJsonSchema({"anyOf": [number, pair]})


_Positive = Annotated[list[float], *_stated(1e-12)]
_Share = Annotated[list[float], *_stated(0.0, 1.0)]
_NotNegative = Annotated[list[float], *_stated(0.0)]
_Box = Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=4, max_length=4)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Camera(_Strict):
    profile: str | None = None
    cfa: str | None = None
    tone: Literal["linear", "srgb"] = "linear"
    accept_processed: bool = False
    black_level_dn: FiniteFloat | None = None


class _Sample(_Strict):
    kind: Literal["sphere", "cylinder", "flat"] = "sphere"
    radius_mm: _Positive | None = None
    region_px: _Box | None = None


class _Distances(_Strict):
    camera_mm: _Positive | None = None
    lamp_mm: _Positive | None = None


class _LampSection(_Strict):
    radius_mm: _NotNegative = [0.0, 0.0]
    motion: Literal["arc", "free", "table"] = "free"
    intensity: Literal["reference", "constant", "table"] = "constant"
    gain_std: Annotated[FiniteFloat, Field(ge=0, lt=1)] = 0.005
    direction_std_deg: Annotated[FiniteFloat, Field(ge=0, le=180)] = 1.0


class _Reference(_Strict):
    kind: Literal["diffuse", "monitor"]
    reflectance: _Share | None = None
    region_px: _Box | None = None


class _Outline(_Strict):
    field_beyond_deg: Annotated[FiniteFloat, Field(ge=0, le=90)] = 3.0


class _Settings(_Strict):
    format: Literal["matcam capture"]
    version: Literal[1]
    camera: _Camera = _Camera()
    sample: _Sample = _Sample()
    distances: _Distances = _Distances()
    lamp: _LampSection = _LampSection()
    reference: _Reference | None = None
    outline: _Outline = _Outline()


@dataclass(frozen=True)
class Capture:
    """Hold what a capture states, and read its frames when they are asked for.

    Attributes:
        folder: where it lies.
        frames: the pictures that can be used, in the order of `frames.csv`.
        lamps: lamp positions by name, in the same order.
        settings: capture.toml, checked, with all defaults.
        problems: what is wrong with the other pictures, each naming its frame.
    """

    folder: Path
    frames: tuple[CaptureFrame, ...]
    lamps: dict[str, LampGuess]
    settings: dict[str, Any]
    problems: tuple[Remark, ...] = ()

    def of(self, kind: str, lamp: str | None = None, exposure: str | None = None) -> list[CaptureFrame]:
        """Return the frames of a kind, of one lamp position or exposure where that is given."""
        return [
            frame
            for frame in self.frames
            if frame.kind == kind and lamp in (None, frame.lamp) and exposure in (None, frame.exposure)
        ]

    @property
    def exposures(self) -> list[str]:
        """Return the exposures of the sample's pictures, the shortest nominal time first."""
        times: dict[str, float] = {}
        for frame in self.of("frames"):
            times.setdefault(frame.exposure, frame.time)
        return sorted(times, key=lambda name: (math.isnan(times[name]), times[name]))

    def time(self, exposure: str) -> float:
        """Return the nominal time of an exposure, s; NaN where it is not stated."""
        return next((f.time for f in self.frames if f.exposure == exposure and not math.isnan(f.time)), math.nan)

    @property
    def profile(self) -> Path | None:
        """Return the file of the camera's profile; None where there is none."""
        name = self.settings["camera"]["profile"]
        return None if name is None else self.folder / name

    @property
    def radius_mm(self) -> Stated | None:
        """Return the sample's radius, mm; None: not stated."""
        return _as_stated(self.settings["sample"]["radius_mm"])

    @property
    def camera_radii(self) -> Stated | None:
        """Return the camera's distance from the sample's centre, in its radii; None: not stated."""
        return self._in_radii("camera_mm")

    @property
    def lamp_radii(self) -> Stated | None:
        """Return the lamp's distance from the sample's centre, in its radii; None: not stated."""
        return self._in_radii("lamp_mm")

    @property
    def direction_std(self) -> float:
        """Return how well the lamps' directions are stated: standard deviation of each of two angles, rad."""
        return math.radians(self.settings["lamp"]["direction_std_deg"])

    @property
    def reference_region(self) -> Region | None:
        """Return where the reference stands in every frame; None: it is not in the frames."""
        section = self.settings["reference"]
        return None if section is None or section["region_px"] is None else tuple(section["region_px"])

    @property
    def region(self) -> Region | None:
        """Return the part of the frames that is used; None: all of it."""
        box = self.settings["sample"]["region_px"]
        return None if box is None else tuple(box)

    def _in_radii(self, name: str) -> Stated | None:
        distance, radius = _as_stated(self.settings["distances"][name]), self.radius_mm
        if distance is None or radius is None:
            return None
        ratio = distance.value / radius.value
        return Stated(ratio, ratio * math.hypot(distance.std / distance.value, radius.std / radius.value))

    def read(self, frame: CaptureFrame, region: Region | None = None) -> Photograph:
        """Read a frame, or a region of it, as it lies in its file.

        Args:
            frame: one of `frames`.
            region: first column, first row, width, height, px. None: the whole frame. Default: None.

        Returns:
            The picture's codes; nothing is converted.

        Raises:
            FileFormatError: the file is missing, damaged, or no longer inside the folder.
        """
        return open_photograph(inside(self.folder, frame.file), region)


def _as_stated(pair: list[float] | None) -> Stated | None:
    return None if pair is None else Stated(*pair)


def read_capture(folder: str | Path) -> Capture:
    """Read what a capture states, and which of its frames are there.

    No picture is decoded. Frames that are missing or stated wrongly are left out and listed in `problems`.

    Args:
        folder: where `capture.toml` and `frames.csv` lie.

    Returns:
        The capture.

    Raises:
        FileFormatError: one of the two files is missing or wrong, or no frame can be used; the message names the field.

    Example:
        >>> read_capture("none")
        Traceback (most recent call last):
        ...
        matcam.core.errors.FileFormatError: none: no such folder
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileFormatError(
            f"{folder}: " + ("is no folder: give a capture's" if folder.exists() else "no such folder")
        )
    settings = read_settings(folder / SETTINGS)
    if settings["camera"]["profile"] is not None:
        inside(folder, settings["camera"]["profile"])
    frames, lamps, problems = read_list(folder)
    problems += unlisted(folder, frames, problems)
    if not any(frame.kind == "frames" for frame in frames):
        why = f": {problems[0]}" if problems else ": list them in it"
        raise FileFormatError(f"{folder / LIST}: no frame of the sample can be used{why}")
    return Capture(folder, tuple(frames), lamps, settings, tuple(problems))


def read_settings(path: Path) -> dict[str, Any]:
    """Read and check a `capture.toml`; FileFormatError names the field."""
    try:
        document = tomllib.loads(read_text(path))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise FileFormatError(f"{path}: not TOML: {error}") from None
    checked_version(document, path, _WHAT, FORMAT, (VERSION,))
    try:
        settings = _Settings.model_validate(document).model_dump()
    except ValidationError as error:
        raise FileFormatError(f"{path}: {first_problem(error)}") from None
    cfa = settings["camera"]["cfa"]
    if cfa is not None and cfa not in CFAS:
        raise FileFormatError(f"{path}: field camera.cfa: must be one of {', '.join(CFAS)}, got {cfa!r:.20}")
    return settings


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of capture.toml."""
    return _Settings.model_json_schema()
