"""A camera's uncertainty and its profile: the JSON file that ships with a data set, whose format lives here and nowhere else.

    {
      "format": "matcam camera profile",  "version": 4,
      "optics": {"model": "gaussian", "sigma_px": 0.5},
      "pixel": {"model": "box", "half_width_px": 0.5},
      "sensor": {"pitch_m": 4.73e-6, "full_well_electrons": 2e4, ...},     or null: not stated
      "field": {"centre_px": [999.5, 749.5], "unit_px": 1249, "k1": [-0.01, 0.001], "k2": [0, 0],
                "growth": [0.2, 0.03], "holds_at_px": 800},     or null: the lens is alike everywhere
      "uncertainty": {"parameters": ["optics.sigma_px"], "covariance": [[0.000225]]},     or null: exact
      "provenance": {"source": "", "created": "2026-01-31", "software": "matcam 0.1.0", "notes": ""}
    }

Units stand in the names. A lens inside a lens is an object of its own: {"model": "halo", "core": {"model": ...}, ...}.
Parameters are named by their place: "optics.sigma_px", "optics.mtf[3]", "optics.core.sigma_px". The covariance of the
parameters and where they come from travel with the camera, because a kernel without its uncertainty cannot correct anything
honestly.

Version 3, which knows no "zernike", "colour" and "seidel", version 2, which knows no field, and version 1, which knows neither
"defocus" nor "halo" nor sensors, are read as well. A published version never changes: what is new goes into the next one. The
published schemas are docs/camera-profile-v1.schema.json to -v4 (`profile_schemas.py`). pydantic validates JSON; the parameters
live in the camera's objects.
"""

from __future__ import annotations

import datetime
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike
from pydantic import ValidationError

from matcam.camera.lens_field import Coefficient, LensField
from matcam.camera.optics.optics import Optics
from matcam.camera.pixel import PixelResponse
from matcam.camera.profile_schemas import FIELD_SCHEMA, MODELS, SENSOR_FIELDS, VERSION, VERSIONS, Part, json_schema
from matcam.camera.sensor import Sensor
from matcam.core import checks
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.jax import is_concrete, jax, jnp
from matcam.core.readers.texts import checked_version, first_problem, read_json


class Uncertainty(eqx.Module):
    """State the covariance of a camera's parameters; parameters without one are exact.

    Args:
        names: of the parameters, as in `Camera.parameters()`, such as "optics.sigma_px"; (n,).
        covariance: in the units of the names, shape (n, n), symmetric, positive semidefinite.

    Raises:
        ArgumentError: the shape does not fit, a name stands twice, or this is no covariance.

    Example:
        >>> known = matcam.camera.Uncertainty.of({"optics.sigma_px": 0.02})
        >>> known.std()
        {'optics.sigma_px': 0.02}
    """

    names: tuple[str, ...] = eqx.field(static=True)
    covariance: jax.Array

    def __init__(self, names: Iterable[str], covariance: ArrayLike):
        self.names = tuple(names)
        self.covariance = checks.number("covariance", covariance)
        n = len(self.names)
        if self.covariance.shape != (n, n):
            raise ArgumentError(f"covariance of {n} parameters must have shape ({n}, {n}), got {self.covariance.shape}")
        if len(set(self.names)) != n:
            raise ArgumentError(f"covariance names a parameter twice: {', '.join(self.names)}")
        if not is_concrete(covariance):
            return
        matrix = np.asarray(covariance, dtype=float)  # as it was given: within jax.jit its copy is a tracer
        scale = np.sqrt(np.maximum(np.diag(matrix), 0))
        tolerance = 1e-9 * np.outer(scale, scale) + 1e-300
        if np.any(np.diag(matrix) < 0) or np.any(np.abs(matrix - matrix.T) > tolerance):
            raise ArgumentError("covariance must be symmetric with variances >= 0 on its diagonal")
        correlation = matrix / np.where(scale > 0, scale, 1) / np.where(scale > 0, scale, 1)[:, None]
        if n and np.linalg.eigvalsh(correlation)[0] < -1e-9:
            raise ArgumentError("covariance is not positive semidefinite: some combination has a negative variance")

    @classmethod
    def of(cls, std: Mapping[str, float]) -> Uncertainty:
        """Build the uncertainty of independent parameters from standard deviations.

        Args:
            std: standard deviation by name, in the unit of the name, >= 0.

        Raises:
            ArgumentError: a standard deviation is negative or not finite.
        """
        for name, value in std.items():
            checks.within(f"standard deviation of {name}", value, 0, np.inf, open_high=True)
        return cls(std.keys(), np.diag([float(s) ** 2 for s in std.values()]))

    def check_names(self, parameters: Iterable[str]) -> None:
        """Check that every name belongs to a camera.

        Args:
            parameters: names that the camera has.

        Raises:
            ArgumentError: a name is not among them.
        """
        known = set(parameters)
        for name in self.names:
            if name not in known:
                raise ArgumentError(
                    f"uncertainty names {name!r}, which this camera has not; it has {', '.join(sorted(known))}"
                )

    def std(self) -> dict[str, float]:
        """Return the standard deviations by name, in the units of the names."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def __repr__(self) -> str:
        return f"Uncertainty({self.names!r}, {jnp.asarray(self.covariance).tolist()!r})"


@dataclass(frozen=True)
class Provenance:
    """Tell where a camera profile comes from; all texts are free.

    Attributes:
        source: measurement or assumption behind the profile. Default: "".
        created: ISO 8601 date. Default: "", the day on which the profile is written.
        software: program and version. Default: "", this one.
        notes: anything else. Default: "".

    Example:
        >>> matcam.camera.Provenance(source="slanted edges, f/8").source
        'slanted edges, f/8'
    """

    source: str = ""
    created: str = ""
    software: str = ""
    notes: str = ""


__all__ = [
    "FIELD_SCHEMA",
    "VERSION",
    "VERSIONS",
    "Provenance",
    "Uncertainty",
    "as_document",
    "field_document",
    "field_from",
    "from_document",
    "json_schema",
    "model_name",
    "parameters_of",
    "read_profile",
    "replace_parameters",
]

FORMAT = "matcam camera profile"
_WHAT = "a camera profile"
_NAME = re.compile(r"((?:\w+\.)+)(\w+?)(?:\[(\d+)\])?")

# ---------------------------------------------------------------------------------------------------- parameters by name


def model_name(module: eqx.Module) -> str:
    """Return the name of the model that a lens or a pixel is."""
    return next(name for name, cls in MODELS.items() if type(module) is cls)


def parameters_of(part: str, module: Any) -> dict[str, jax.Array]:
    """Return the scalars that describe the lens or pixel that is the camera's `part` ("optics", "optics.core")."""
    named = {}
    for field, value in _fields_of(module).items():
        if isinstance(value, eqx.Module):
            named.update(parameters_of(f"{part}.{field}", value))
        elif isinstance(value, tuple):
            continue  # the frequencies of a curve's samples are known exactly
        elif jnp.ndim(value):
            named.update({f"{part}.{field}[{i}]": value[i] for i in range(value.size)})
        else:
            named[f"{part}.{field}"] = value
    return named


def replace_parameters(part: str, module: Any, values: Mapping[str, Any]) -> Any:
    """Return `module` with the parameters of this part replaced by `values`. Works under JAX transformations."""
    for name, value in values.items():
        found = _NAME.fullmatch(name)
        if found is None or found[1].split(".")[0] != part:
            continue
        path = _path(module, found[1].split(".")[1:-1], found[2])
        value = jnp.asarray(value, dtype=jnp.float64)
        new = value if found[3] is None else path(module).at[int(found[3])].set(value)
        module = eqx.tree_at(path, module, new)
    return module


def _fields_of(module: Any) -> dict[str, Any]:
    """Return what describes a lens or a pixel by names with units: scalars, curves, and the lens inside a lens."""
    return {field: operator.attrgetter(path)(module) for field, path in module.profile_fields.items()}


def _path(module: Any, inner: list[str], field: str) -> Callable[[Any], Any]:
    """Return the way from a lens to one of its parameters, through the lenses inside it."""
    steps = []
    for name in (*inner, field):
        steps.append(module.profile_fields[name])
        module = operator.attrgetter(steps[-1])(module)
    return operator.attrgetter(".".join(steps))


# ------------------------------------------------------------------------------------------------- writing and reading


def as_document(
    optics: Optics,
    pixel: PixelResponse,
    sensor: Sensor | None,
    field: LensField | None,
    uncertainty: Uncertainty | None,
    provenance: Provenance,
) -> dict[str, Any]:
    """Return a camera's parts as the profile's JSON."""
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
    """Return the arguments of the `Camera` in the profile at `path`. FileFormatError naming file and field."""
    return from_document(read_json(path, _WHAT), path)


def from_document(document: Any, where: str | Path) -> dict[str, Any]:
    """Return the arguments of the `Camera` that a profile's JSON describes.

    Raises:
        FileFormatError: naming `where` the profile stands, and the field.
    """
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
            and Sensor(**{attribute: getattr(profile.sensor, field) for field, attribute in SENSOR_FIELDS.items()}),
            "field": None if getattr(profile, "field", None) is None else field_from(profile.field),
            "uncertainty": profile.uncertainty
            and Uncertainty(profile.uncertainty.parameters, np.array(profile.uncertainty.covariance)),
            "provenance": Provenance(**profile.provenance.model_dump()),
        }
    except (ArgumentError, ValueError) as error:
        raise FileFormatError(f"{where}: {error}") from None


def field_document(field: LensField) -> dict[str, Any]:
    """Return a lens's field as it stands in a profile."""
    return {
        "centre_px": list(field.centre),
        "unit_px": field.unit,
        "k1": list(field.k1),
        "k2": list(field.k2),
        "growth": list(field.growth),
        "holds_at_px": field.holds_at,
    }


def field_from(part: Any) -> LensField:
    """Return the field that a checked part of a document describes. ArgumentError where a value is out of range."""
    k1, k2, growth = (Coefficient(*pair) for pair in (part.k1, part.k2, part.growth))
    return LensField((part.centre_px[0], part.centre_px[1]), part.unit_px, k1, k2, growth, part.holds_at_px)


def _as_json(module: Any) -> dict[str, Any]:
    values = {
        field: _as_json(value) if isinstance(value, eqx.Module) else np.asarray(value).tolist()
        for field, value in _fields_of(module).items()
    }
    return {"model": model_name(module)} | values


def _from_json(part: Any) -> Any:
    cls = MODELS[part.model]
    values = (getattr(part, field) for field in cls.profile_fields)
    return cls(*(_from_json(value) if isinstance(value, Part) else value for value in values))
