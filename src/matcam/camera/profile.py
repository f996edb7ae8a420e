"""Camera profile: JSON file that describes the camera of a data set.

    {
      "format": "matcam camera profile",  "version": 5,
      "optics": {"model": "gaussian", "sigma_px": 0.5},
      "pixel": {"model": "box", "half_width_px": 0.5},
      "sensor": {"pitch_m": 4.73e-6, "full_well_electrons": 2e4, ...},     or null: not specified
      "field": {"centre_px": [999.5, 749.5], "unit_px": 1249, "k1": [-0.01, 0.001], "k2": [0, 0],
                "growth": [0.2, 0.03], "holds_at_px": 800},     or null: the lens is uniform
      "uncertainty": {"parameters": ["optics.sigma_px"], "covariance": [[0.000225]]},     or null: exact
      "provenance": {"source": "", "created": "2026-01-31", "software": "matcam 0.1.0", "notes": ""}
    }

The names of the fields end in the units. An inner lens is an object: {"model": "halo", "core": {"model": ...}, ...}. The
name of a parameter is its path: "optics.sigma_px", "optics.mtf[3]", "optics.core.sigma_px". The profile includes the
covariance of the parameters, because a correction requires the uncertainty of the kernel.

Profiles of older versions can be read. Each version lacks the following, in addition to what later versions lack:

    4    "dsnu_electrons" of the sensor
    3    the lens models "zernike", "colour" and "seidel"
    2    "field"
    1    "sensor", and the lens models "defocus" and "halo"

A published version never changes: additions are made in the next version. The published schemas are
docs/camera-profile-v1.schema.json to docs/camera-profile-v5.schema.json (`profile_schemas.py`). pydantic validates the JSON.
"""

from __future__ import annotations

import datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from matcam.camera.lens_field import Coefficient, LensField
from matcam.camera.optics.optics import Optics
from matcam.camera.parameters import Provenance, Uncertainty, fields_of
from matcam.camera.pixel import PixelResponse
from matcam.camera.profile_schemas import FIELD_SCHEMA as FIELD_SCHEMA
from matcam.camera.profile_schemas import MODELS, SENSOR_FIELDS, VERSION, VERSIONS, Part
from matcam.camera.profile_schemas import json_schema as json_schema
from matcam.camera.sensor import Sensor
from matcam.core.arrays.module import Module
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.readers.schemas import validated
from matcam.core.readers.texts import checked_version, read_json

FORMAT = "matcam camera profile"
_WHAT = "a camera profile"


def model_name(module: Module) -> str:
    return next(name for name, cls in MODELS.items() if type(module) is cls)


# ------------------------------------------------------------------------------------------------- writing and reading


def as_document(
    optics: Optics,
    pixel: PixelResponse,
    sensor: Sensor | None,
    field: LensField | None,
    uncertainty: Uncertainty | None,
    provenance: Provenance,
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "optics": _as_json(optics),
        "pixel": _as_json(pixel),
        "sensor": sensor
        and {field: np.asarray(getattr(sensor, attribute)).tolist() for field, attribute in SENSOR_FIELDS.items()},
        "field": None if field is None else field_document(field),
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


def read_profile(path: str | Path) -> dict[str, Any]:
    """Read the arguments of a `Camera` from the profile at `path`.

    A FileFormatError is raised if the profile is invalid. Its message names the file and the field.
    """
    return from_document(read_json(path, _WHAT), path)


def from_document(document: Any, where: str | Path) -> dict[str, Any]:
    """Build the arguments of a `Camera` from the JSON document of a profile.

    A FileFormatError is raised if the profile is invalid. Its message names `where`, the location of the profile, and the
    field.
    """
    version = checked_version(document, where, _WHAT, FORMAT, VERSIONS)
    profile: Any = validated(VERSIONS[version], document, where, MODELS)
    try:
        return {
            "optics": _from_json(profile.optics),
            "pixel": _from_json(profile.pixel),
            "sensor": getattr(profile, "sensor", None)  # version 1 has no sensor
            and Sensor(
                **{
                    attribute: getattr(profile.sensor, field)
                    for field, attribute in SENSOR_FIELDS.items()
                    if field in type(profile.sensor).model_fields  # version 4 has no DSNU
                }
            ),
            "field": None if getattr(profile, "field", None) is None else field_from(profile.field),
            "uncertainty": profile.uncertainty
            and Uncertainty(profile.uncertainty.parameters, np.array(profile.uncertainty.covariance)),
            "provenance": Provenance(**profile.provenance.model_dump()),
        }
    except (ArgumentError, ValueError) as error:
        raise FileFormatError(f"{where}: {error}") from None


def field_document(field: LensField) -> dict[str, Any]:
    return {
        "centre_px": list(field.centre),
        "unit_px": field.unit,
        "k1": list(field.k1),
        "k2": list(field.k2),
        "growth": list(field.growth),
        "holds_at_px": field.holds_at,
    }


def field_from(part: Any) -> LensField:
    """Build the field of a lens from the validated section "field" of a profile.

    An ArgumentError is raised if a value is out of range.
    """
    k1, k2, growth = (Coefficient(*pair) for pair in (part.k1, part.k2, part.growth))
    return LensField((part.centre_px[0], part.centre_px[1]), part.unit_px, k1, k2, growth, part.holds_at_px)


def _as_json(module: Any) -> dict[str, Any]:
    values = {
        field: _as_json(value) if isinstance(value, Module) else np.asarray(value).tolist()
        for field, value in fields_of(module).items()
    }
    return {"model": model_name(module)} | values


def _from_json(part: Any) -> Any:
    cls = MODELS[part.model]
    values = (getattr(part, field) for field in cls.profile_fields)
    return cls(*(_from_json(value) if isinstance(value, Part) else value for value in values))
