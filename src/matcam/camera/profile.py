"""The camera profile: a camera as a JSON file that ships with a data set. Its format lives here and nowhere else.

    {
      "format": "matcam camera profile",  "version": 1,
      "optics": {"model": "gaussian", "sigma_px": 0.5},
      "pixel": {"model": "box", "half_width_px": 0.5},
      "uncertainty": {"parameters": ["optics.sigma_px"], "covariance": [[0.000225]]},     or null: taken as exact
      "provenance": {"source": "", "created": "2026-01-31", "software": "matcam 0.1.0", "notes": ""}
    }

Units stand in the names. `json_schema()` is the published schema (docs/camera-profile-v1.schema.json).
"""

from __future__ import annotations

import datetime
import json
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal

import equinox as eqx
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from matcam.atomic import replacing
from matcam.camera.optics import Optics
from matcam.camera.parameters import MODELS, model_of
from matcam.camera.pixel import PixelResponse
from matcam.camera.uncertainty import Provenance, Uncertainty
from matcam.errors import ArgumentError, FileFormatError

FORMAT = "matcam camera profile"
VERSION = 1
_LARGEST = 16 << 20  # bytes; a measured curve of 1e5 samples stays far below


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Gaussian(_Part):
    model: Literal["gaussian"]
    sigma_px: FiniteFloat


class _Diffraction(_Part):
    model: Literal["diffraction"]
    f_number: FiniteFloat
    wavelength_m: FiniteFloat
    pixel_pitch_m: FiniteFloat


class _Measured(_Part):
    model: Literal["measured"]
    frequency_cycles_per_px: list[FiniteFloat]
    mtf: list[FiniteFloat]


class _Box(_Part):
    model: Literal["box"]
    half_width_px: FiniteFloat


class _WindowedGaussian(_Part):
    model: Literal["windowed gaussian"]
    sigma_px: FiniteFloat
    half_width_px: FiniteFloat


class _Uncertainty(_Part):
    parameters: list[str]
    covariance: list[list[FiniteFloat]]


class _Provenance(_Part):
    source: str = ""
    created: str = ""
    software: str = ""
    notes: str = ""


class _Profile(_Part):
    format: Literal["matcam camera profile"]
    version: Literal[1]
    optics: Annotated[_Gaussian | _Diffraction | _Measured, Field(discriminator="model")]
    pixel: Annotated[_Box | _WindowedGaussian, Field(discriminator="model")]
    uncertainty: _Uncertainty | None
    provenance: _Provenance


def write(
    path: str | Path,
    optics: Optics,
    pixel: PixelResponse,
    uncertainty: Uncertainty | None,
    provenance: Provenance,
    *,
    force: bool = False,
) -> None:
    """Write a camera's parts to `path`."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        "optics": _as_json(optics),
        "pixel": _as_json(pixel),
        "uncertainty": None
        if uncertainty is None
        else {"parameters": list(uncertainty.names), "covariance": np.asarray(uncertainty.covariance).tolist()},
        "provenance": {
            "source": provenance.source,
            "created": provenance.created or datetime.datetime.now(datetime.UTC).date().isoformat(),
            "software": provenance.software or f"matcam {metadata.version('matcam')}",
            "notes": provenance.notes,
        },
    }
    with replacing(path, force=force) as temporary:
        temporary.write_text(
            json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
        )


def read(path: str | Path) -> dict[str, Any]:
    """Arguments of the `Camera` in the profile at `path`. FileFormatError naming file and field."""
    path = Path(path)
    document = _read_json(path)
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise FileFormatError(f'{path}: not a camera profile: field "format" must be "{FORMAT}"')
    if document.get("version") != VERSION:
        raise FileFormatError(
            f"{path}: profile version {document.get('version')!r} is unknown; this matcam ({metadata.version('matcam')}) "
            f"reads version {VERSION}"
        )
    try:
        profile = _Profile.model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"] if part not in MODELS)
        raise FileFormatError(f"{path}: field {field}: {first['msg'][0].lower()}{first['msg'][1:]}") from None
    try:
        return {
            "optics": _from_json(profile.optics),
            "pixel": _from_json(profile.pixel),
            "uncertainty": profile.uncertainty
            and Uncertainty(profile.uncertainty.parameters, np.array(profile.uncertainty.covariance)),
            "provenance": Provenance(**profile.provenance.model_dump()),
        }
    except (ArgumentError, ValueError) as error:
        raise FileFormatError(f"{path}: {error}") from None


def json_schema() -> dict[str, Any]:
    """JSON Schema of the profile."""
    return _Profile.model_json_schema()


def _as_json(module: eqx.Module) -> dict[str, Any]:
    model = model_of(module)
    fields = MODELS[model][1].items()
    return {"model": model} | {field: np.asarray(getattr(module, attribute)).tolist() for field, attribute in fields}


def _from_json(part: Any) -> Any:
    cls, fields = MODELS[part.model]
    return cls(*(getattr(part, field) for field in fields))


def _read_json(path: Path) -> Any:
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not a number")

    try:
        if path.stat().st_size > _LARGEST:
            raise FileFormatError(f"{path}: {path.stat().st_size} bytes is too large for a camera profile")
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    except FileNotFoundError:
        raise FileFormatError(f"{path}: no such file") from None
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a camera profile: {error}") from None
