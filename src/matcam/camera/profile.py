"""The camera profile: a camera as a JSON file that ships with a data set. Its format lives here and nowhere else.

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
from typing import Any

import equinox as eqx
import numpy as np
from pydantic import ValidationError

from matcam.camera.optics import Optics
from matcam.camera.parameters import MODELS, model_of, values_of
from matcam.camera.pixel import PixelResponse
from matcam.camera.profile_schema import FORMAT, VERSION, VERSIONS, Part
from matcam.camera.sensor import Sensor
from matcam.camera.uncertainty import Provenance, Uncertainty
from matcam.errors import ArgumentError, FileFormatError
from matcam.json_file import checked_version, first_problem, read_json

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
