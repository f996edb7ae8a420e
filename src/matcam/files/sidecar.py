"""Sidecar of an image: JSON file beside the image, with all information that an inversion requires.

    {
      "format": "matcam picture sidecar",  "version": 1,
      "software": "matcam 0.1.0",  "created": "2026-01-31",
      "picture": {"file": "copper.exr", "shape": [512, 512, 3], "quantity": "radiance", "channel_wavelengths_m": [...],
                  "axis_column_px": 255.5, "axis_row_px": 255.5},
      "camera": {...},                                        a complete camera profile
      "sample": {"kind": "sphere", "radius_px": 256.0, "distance_radii": null},           null: infinite
      "lamp": {"angles_rad": [0.5], "azimuths_rad": [0.0],    seen from the sample's centre; azimuth from +x to up
               "radius_rad": 0.004, "distance_radii": null},  null: infinite
      "blur": {"jitter_px": 0.0, "aperture": 0.0, "focus_rad": 0.0},        registration; pupil over distance; angle in focus
      "exposure": {"electrons_per_radiance": [1e4], "times_s": [0.01], "seed": 1},        null: no noise was added
      "material": {...},                                      free description
      "notes": ""
    }

Units are in the names. Row 0 is on top, and pixel centres have integer coordinates. The axis is the optical axis, which
may lie outside a cropped image. `json_schema()` returns the published schema (docs/picture-sidecar-v1.schema.json).
`Camera.from_profile` checks the camera profile.
"""

from __future__ import annotations

import datetime
import math
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, FiniteFloat, ValidationError, model_validator

from matcam.core.errors import ArgumentError
from matcam.core.io import write_json
from matcam.core.readers.schemas import Strict, validated
from matcam.core.readers.texts import checked_version, first_problem, read_json

FORMAT = "matcam picture sidecar"
VERSION = 1
_WHAT = "a picture sidecar"

_Positive = Annotated[FiniteFloat, Field(gt=0)]
_NotNegative = Annotated[FiniteFloat, Field(ge=0)]


def _not_a_folder(name: str) -> str:
    if name in (".", ".."):
        raise ValueError("is a folder: give the name of an image file, which must be beside its sidecar")
    return name


class _Picture(Strict):
    file: Annotated[
        str, Field(min_length=1, max_length=255, pattern=r"^[^/\\\x00-\x1f]+$"), AfterValidator(_not_a_folder)
    ]
    shape: Annotated[list[Annotated[int, Field(ge=1)]], Field(min_length=2, max_length=3)]
    quantity: Literal["radiance", "electrons", "digital"]
    channel_wavelengths_m: list[_Positive] | None = None
    axis_column_px: FiniteFloat
    axis_row_px: FiniteFloat


class _Round(Strict):
    kind: Literal["sphere", "cylinder"]
    radius_px: _Positive
    distance_radii: Annotated[FiniteFloat, Field(gt=1)] | None


class _Flat(Strict):
    kind: Literal["flat"]
    theta_o_rad: _NotNegative
    texture_pitch_px: _Positive | None


class _Lamp(Strict):
    angles_rad: Annotated[list[FiniteFloat], Field(min_length=1, fail_fast=True)]
    azimuths_rad: (
        Annotated[list[Annotated[FiniteFloat, Field(ge=-2 * math.pi, le=2 * math.pi)]], Field(fail_fast=True)] | None
    ) = None
    radius_rad: _NotNegative
    distance_radii: Annotated[FiniteFloat, Field(gt=1)] | None = None

    @model_validator(mode="after")
    def _one_azimuth_for_each_angle(self) -> _Lamp:
        if self.azimuths_rad is not None and len(self.azimuths_rad) != len(self.angles_rad):
            raise ValueError("azimuths_rad must have as many entries as angles_rad, or be null (all towards +x)")
        return self


class _Blur(Strict):
    jitter_px: _NotNegative
    aperture: _NotNegative
    focus_rad: _NotNegative


class _Exposure(Strict):
    electrons_per_radiance: Annotated[list[_Positive], Field(min_length=1)]
    times_s: list[_NotNegative]
    seed: Annotated[int, Field(ge=0)]


class _Sidecar(Strict):
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
    """Derive the path of the sidecar of an image.

    Args:
        picture: file of the image.

    Returns:
        Path of the image with ".json" appended.

    Example:
        >>> matcam.io.sidecar_path("copper.exr").name
        'copper.exr.json'
    """
    picture = Path(picture)
    if not picture.name:
        raise ArgumentError(f"picture must be a file with a name, got {str(picture)!r}")
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
    """Write the sidecar of an image from its sections.

    docs/forward.md and the published schema (docs/picture-sidecar-v1.schema.json) list the fields. The names of fields
    contain the units.

    Args:
        path: file to write, such as the path returned by `sidecar_path`.
        picture: file, shape (rows, columns, channels), quantity, wavelengths in m, position of the optical axis in px.
        camera: camera profile, such as the result of `Camera.profile()`.
        sample: for the kinds "sphere" and "cylinder", radius in px and distance of the camera in radii (None:
            infinite); for the kind "flat", viewing angle in rad and pitch of the texture in px (None: no texture).
        lamp: angles between lamp and optical axis, azimuths about the axis (None: 0) and the lamp's angular radius,
            rad, all seen from the centre of the sample; distance of the lamp in radii (None: infinite).
        blur: jitter in px, aperture over distance (no unit), angle of the normals in focus in rad.
        exposure: electrons per unit of radiance, times in s, and seed of the noise. None if no noise was added.
        material: free description of the material.
        notes: free text. Default: "".
        force: True to replace an existing file. Default: False.

    Raises:
        ArgumentError: a field is missing, unknown or out of its range, or a value cannot be written as JSON. The
            message contains the wrong field.
        OutputError: the file cannot be written, or exists and `force` is False.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> about = matcam.rigs.merl().description()
        >>> sections = {
        ...     "picture": {
        ...         "file": "a.exr", "shape": [4, 5], "quantity": "radiance", "axis_column_px": 2.0, "axis_row_px": 1.5
        ...     },
        ...     "camera": about["camera"], "sample": about["sample"], "blur": about["blur"],
        ...     "lamp": {"angles_rad": [0.5], "radius_rad": 0.0}, "exposure": None, "material": {},
        ... }
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     matcam.io.write_sidecar(Path(folder) / "a.exr.json", **sections)
        ...     matcam.io.read_sidecar(Path(folder) / "a.exr.json")["lamp"]["angles_rad"]
        [0.5]
    """
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
    """Read the sidecar of an image.

    Args:
        path: JSON file, such as the path returned by `sidecar_path`.

    Returns:
        Sections of the sidecar by name, as dicts with all fields.

    Raises:
        FileFormatError: the file is missing or not a sidecar, or a field is missing, unknown or out of its range. The
            message contains the wrong field.

    Example:
        >>> matcam.io.read_sidecar("none.exr.json")
        Traceback (most recent call last):
        ...
        matcam.core.errors.FileFormatError: none.exr.json: no such file
    """
    path = Path(path)
    document = read_json(path, _WHAT)
    checked_version(document, path, _WHAT, FORMAT, (VERSION,))
    return validated(_Sidecar, document, path).model_dump()


def json_schema() -> dict[str, Any]:
    return _Sidecar.model_json_schema()
