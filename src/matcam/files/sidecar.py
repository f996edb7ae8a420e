"""The sidecar of a picture: a JSON file beside it that holds all that is needed to invert it.

    {
      "format": "matcam picture sidecar",  "version": 1,
      "software": "matcam 0.1.0",  "created": "2026-01-31",
      "picture": {"file": "copper.exr", "shape": [512, 512, 3], "quantity": "radiance", "channel_wavelengths_m": [...],
                  "axis_column_px": 255.5, "axis_row_px": 255.5},
      "camera": {...},                                        a camera profile, whole
      "sample": {"kind": "sphere", "radius_px": 256.0, "distance_radii": null},           null: infinitely far
      "lamp": {"angles_rad": [0.5], "radius_rad": 0.004},     angle lamp-camera = 2 theta_d, lamp towards +x
      "blur": {"jitter_px": 0.0, "aperture": 0.0, "focus_rad": 0.0},        registration; pupil over distance, and focus
      "exposure": {"electrons_per_radiance": [1e4], "times_s": [0.01], "seed": 1},        null: no noise was added
      "material": {...},                                      free
      "notes": ""
    }

Units stand in the names; row 0 is on top, pixel centres lie on integers, and the axis is the optical axis, which a crop
may have left outside the picture. `json_schema()` is the published schema (docs/picture-sidecar-v1.schema.json). The
camera is checked by its own format, which lives elsewhere: `Camera.from_profile`.
"""

from __future__ import annotations

import datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.json import checked_version, first_problem, read_json, write_json

FORMAT = "matcam picture sidecar"
VERSION = 1
_WHAT = "a picture sidecar"

_Positive = Annotated[FiniteFloat, Field(gt=0)]
_NotNegative = Annotated[FiniteFloat, Field(ge=0)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Picture(_Strict):
    file: Annotated[str, Field(min_length=1, max_length=255, pattern=r"^[^/\\\x00-\x1f]+$")]
    shape: Annotated[list[Annotated[int, Field(ge=1)]], Field(min_length=2, max_length=3)]
    quantity: Literal["radiance", "electrons", "digital"]
    channel_wavelengths_m: list[_Positive] | None = None
    axis_column_px: FiniteFloat
    axis_row_px: FiniteFloat


class _Round(_Strict):
    kind: Literal["sphere", "cylinder"]
    radius_px: _Positive
    distance_radii: Annotated[FiniteFloat, Field(gt=1)] | None


class _Flat(_Strict):
    kind: Literal["flat"]
    theta_o_rad: _NotNegative
    texture_pitch_px: _Positive | None


class _Lamp(_Strict):
    angles_rad: Annotated[list[FiniteFloat], Field(min_length=1)]
    radius_rad: _NotNegative


class _Blur(_Strict):
    jitter_px: _NotNegative
    aperture: _NotNegative
    focus_rad: _NotNegative


class _Exposure(_Strict):
    electrons_per_radiance: Annotated[list[_Positive], Field(min_length=1)]
    times_s: list[_NotNegative]
    seed: Annotated[int, Field(ge=0)]


class _Sidecar(_Strict):
    format: Literal["matcam picture sidecar"]
    version: Literal[1]
    software: str
    created: str
    picture: _Picture
    camera: dict[str, Any]
    sample: Annotated[_Round | _Flat, Field(discriminator="kind")]
    lamp: _Lamp
    blur: _Blur
    exposure: _Exposure | None
    material: dict[str, Any]
    notes: str = ""


def sidecar_path(picture: str | Path) -> Path:
    """Where the sidecar of a picture lies: "copper.exr" -> "copper.exr.json"."""
    picture = Path(picture)
    return picture.with_name(picture.name + ".json")


def write_sidecar(
    path: str | Path,
    *,
    picture: dict[str, Any],
    camera: dict[str, Any],
    sample: dict[str, Any],
    lamp: dict[str, Any],
    blur: dict[str, Any],
    exposure: dict[str, Any] | None,
    material: dict[str, Any],
    notes: str = "",
    force: bool = False,
) -> None:
    """Write a sidecar from its sections, as the head of this file shows them. ArgumentError naming the field that is
    missing, unknown or out of its range; OutputError where the file cannot go."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        "software": f"matcam {metadata.version('matcam')}",
        "created": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "picture": picture,
        "camera": camera,
        "sample": sample,
        "lamp": lamp,
        "blur": blur,
        "exposure": exposure,
        "material": material,
        "notes": notes,
    }
    try:
        _Sidecar.model_validate(document)
        write_json(path, document, force=force)
    except ValidationError as error:
        raise ArgumentError(f"sidecar: {first_problem(error)}") from None
    except (TypeError, ValueError, RecursionError) as error:
        raise ArgumentError(f"sidecar cannot be written as JSON: {error}") from None


def read_sidecar(path: str | Path) -> dict[str, Any]:
    """Read a sidecar: its sections as dicts, checked, all fields present. FileFormatError naming file and field."""
    path = Path(path)
    document = read_json(path, _WHAT)
    checked_version(document, path, _WHAT, FORMAT, (VERSION,))
    try:
        return _Sidecar.model_validate(document).model_dump()
    except ValidationError as error:
        raise FileFormatError(f"{path}: {first_problem(error)}") from None


def json_schema() -> dict[str, Any]:
    """JSON Schema of the sidecar."""
    return _Sidecar.model_json_schema()
