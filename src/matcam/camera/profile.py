"""What a camera profile must look like, version by version. It validates JSON; the numbers live in the camera's objects.

A published version never changes: what is new goes into the next one.

The camera profile: a camera as a JSON file that ships with a data set. Its format lives here and nowhere else.

    {
      "format": "matcam camera profile",  "version": 2,
      "optics": {"model": "gaussian", "sigma_px": 0.5},
      "pixel": {"model": "box", "half_width_px": 0.5},
      "sensor": {"pitch_m": 4.73e-6, "full_well_electrons": 2e4, ...},     or null: nobody said
      "uncertainty": {"parameters": ["optics.sigma_px"], "covariance": [[0.000225]]},     or null: taken as exact
      "provenance": {"source": "", "created": "2026-01-31", "software": "matcam 0.1.0", "notes": ""}
    }

Units stand in the names. A lens inside a lens is an object of its own: {"model": "halo", "core": {"model": ...}, ...}.
Version 1, which knows neither "defocus" nor "halo" nor sensors, is read as well. The published schemas are
docs/camera-profile-v1.schema.json and -v2.
"""

from __future__ import annotations

import datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal

import equinox as eqx
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from matcam.camera.optics.optics import Optics
from matcam.camera.parameters import MODELS, model_of, values_of
from matcam.camera.pixel import PixelResponse
from matcam.camera.sensor import Sensor
from matcam.camera.uncertainty import Provenance, Uncertainty
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.json import checked_version, first_problem, read_json

FORMAT = "matcam camera profile"
VERSION = 2
"""The version that is written."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class Part(_Strict):
    """A lens or a pixel; its `model` is one of `parameters.MODELS`, its fields are that model's."""


class _Gaussian(Part):
    model: Literal["gaussian"]
    sigma_px: FiniteFloat


class _Diffraction(Part):
    model: Literal["diffraction"]
    f_number: FiniteFloat
    wavelength_m: FiniteFloat
    pixel_pitch_m: FiniteFloat


class _Defocus(Part):
    model: Literal["defocus"]
    f_number: FiniteFloat
    wavelength_m: FiniteFloat
    pixel_pitch_m: FiniteFloat
    blur_diameter_px: FiniteFloat


class _Measured(Part):
    model: Literal["measured"]
    frequency_cycles_per_px: list[FiniteFloat]
    mtf: list[FiniteFloat]


class _Halo(Part):
    model: Literal["halo"]
    core: _Optics
    fraction: FiniteFloat
    radius_px: FiniteFloat


class _Box(Part):
    model: Literal["box"]
    half_width_px: FiniteFloat


class _WindowedGaussian(Part):
    model: Literal["windowed gaussian"]
    sigma_px: FiniteFloat
    half_width_px: FiniteFloat


class _Sensor(_Strict):
    pitch_m: FiniteFloat
    full_well_electrons: FiniteFloat
    read_noise_electrons: FiniteFloat
    gain_dn_per_electron: FiniteFloat
    bits: int | None
    cfa: str | None
    prnu: FiniteFloat
    dark_current_electrons_per_s: FiniteFloat
    dark_nonuniformity: FiniteFloat
    black_level_dn: FiniteFloat
    pattern_seed: int


class _Uncertainty(_Strict):
    parameters: list[str]
    covariance: list[list[FiniteFloat]]


class _Provenance(_Strict):
    source: str = ""
    created: str = ""
    software: str = ""
    notes: str = ""


_Optics = Annotated[_Gaussian | _Diffraction | _Defocus | _Measured | _Halo, Field(discriminator="model")]
_Pixel = Annotated[_Box | _WindowedGaussian, Field(discriminator="model")]


class _Profile1(_Strict):
    model_config = ConfigDict(title="_Profile")
    format: Literal["matcam camera profile"]
    version: Literal[1]
    optics: Annotated[_Gaussian | _Diffraction | _Measured, Field(discriminator="model")]
    pixel: _Pixel
    uncertainty: _Uncertainty | None
    provenance: _Provenance


class _Profile2(_Strict):
    format: Literal["matcam camera profile"]
    version: Literal[2]
    optics: _Optics
    pixel: _Pixel
    sensor: _Sensor | None = None
    uncertainty: _Uncertainty | None
    provenance: _Provenance


VERSIONS: dict[int, type[BaseModel]] = {1: _Profile1, 2: _Profile2}


def json_schema(version: int = VERSION) -> dict[str, Any]:
    """JSON Schema of a version of the profile."""
    return VERSIONS[version].model_json_schema()


_WHAT = "a camera profile"
_SENSOR = {
    "pitch_m": "pitch",
    "full_well_electrons": "full_well",
    "read_noise_electrons": "read_noise",
    "gain_dn_per_electron": "gain",
    "bits": "bits",
    "cfa": "cfa",
    "prnu": "prnu",
    "dark_current_electrons_per_s": "dark_current",
    "dark_nonuniformity": "dark_nonuniformity",
    "black_level_dn": "black_level",
    "pattern_seed": "pattern_seed",
}
"""Field -> attribute of `Sensor`."""


def as_document(
    optics: Optics,
    pixel: PixelResponse,
    sensor: Sensor | None,
    uncertainty: Uncertainty | None,
    provenance: Provenance,
) -> dict[str, Any]:
    """A camera's parts as the profile's JSON."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "optics": _as_json(optics),
        "pixel": _as_json(pixel),
        "sensor": sensor
        and {field: np.asarray(getattr(sensor, attribute)).tolist() for field, attribute in _SENSOR.items()},
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


def read(path: str | Path) -> dict[str, Any]:
    """Arguments of the `Camera` in the profile at `path`. FileFormatError naming file and field."""
    return from_document(read_json(path, _WHAT), path)


def from_document(document: Any, where: str | Path) -> dict[str, Any]:
    """Arguments of the `Camera` that a profile's JSON describes. FileFormatError naming `where` it stands, and the field."""
    version = checked_version(document, where, _WHAT, FORMAT, VERSIONS)
    try:
        profile: Any = VERSIONS[version].model_validate(document)
    except ValidationError as error:
        raise FileFormatError(f"{where}: {first_problem(error, MODELS)}") from None
    try:
        return {
            "optics": _from_json(profile.optics),
            "pixel": _from_json(profile.pixel),
            "sensor": getattr(profile, "sensor", None)  # version 1 has none
            and Sensor(**{attribute: getattr(profile.sensor, field) for field, attribute in _SENSOR.items()}),
            "uncertainty": profile.uncertainty
            and Uncertainty(profile.uncertainty.parameters, np.array(profile.uncertainty.covariance)),
            "provenance": Provenance(**profile.provenance.model_dump()),
        }
    except (ArgumentError, ValueError) as error:
        raise FileFormatError(f"{where}: {error}") from None


def _as_json(module: eqx.Module) -> dict[str, Any]:
    values = {
        field: _as_json(value) if isinstance(value, eqx.Module) else np.asarray(value).tolist()
        for field, value in values_of(module).items()
    }
    return {"model": model_of(module)} | values


def _from_json(part: Any) -> Any:
    cls, fields = MODELS[part.model]
    values = (getattr(part, field) for field in fields)
    return cls(*(_from_json(v) if isinstance(v, Part) else v for v in values))
