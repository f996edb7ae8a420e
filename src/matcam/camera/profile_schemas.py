"""Schemas of the published versions of the camera profile (pydantic).

A published version never changes: additions are made in the next version. Versions differ in the lens models that they
support.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Union

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, create_model

from matcam.core.readers.schemas import Strict
from matcam.core.registry import LENSES, PIXELS

MODELS = {**LENSES, **PIXELS}
"""Class of each lens and pixel by its name in a profile."""
_VERSION_1_LENSES = ("gaussian", "diffraction", "measured")
_PAIRS = {
    "zernike": ("astigmatism_waves", "coma_waves", "trefoil_waves"),
    "colour": ("red_shift_px", "green_shift_px", "blue_shift_px"),
}


class Part(Strict):
    """Lens or pixel in a profile. Derived schemas add the fields of a model."""

    model: str


_Pair = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]


def _kind(name: str, field: str) -> Any:
    if field in ("frequency_cycles_per_px", "mtf"):
        return list[FiniteFloat]
    if field in ("core", "red", "green", "blue"):
        return "_Optics"
    return _Pair if field in _PAIRS.get(name, ()) else FiniteFloat


def _part_schema(name: str) -> type[Part]:
    title = "_" + "".join(word.capitalize() for word in name.split())
    fields: dict[str, Any] = {"model": (Literal[name], ...)}
    for field in MODELS[name].profile_fields:
        fields[field] = (_kind(name, field), ...)
    return create_model(title, __base__=Part, __module__=__name__, **fields)


def _one_of(names: Iterable[str]) -> Any:
    """Build the union of the schemas of the named models.

    A lens inside another lens may also be any of these models.
    """
    schemas: Any = tuple(_part_schema(name) for name in names)
    union = Annotated[Union[schemas], Field(discriminator="model")]  # noqa: UP007
    for schema in schemas:
        schema.model_rebuild(_types_namespace={"_Optics": union})
    return union


_Optics2: Any = _one_of((*_VERSION_1_LENSES[:2], "defocus", "measured", "halo"))
_Optics4: Any = _one_of(LENSES)
_Pixel: Any = _one_of(PIXELS)


class _Sensor(Strict):
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


class _Sensor5(_Sensor):
    model_config = ConfigDict(title="_Sensor")
    dsnu_electrons: FiniteFloat


SENSOR_FIELDS = {
    field: re.sub(r"_(m|electrons|dn|dn_per_electron|electrons_per_s)$", "", field) for field in _Sensor5.model_fields
}
"""Attribute of `Sensor` by its name with the unit."""


class _LensField(Strict):
    centre_px: _Pair
    unit_px: FiniteFloat
    k1: _Pair
    k2: _Pair
    growth: _Pair
    holds_at_px: FiniteFloat


FIELD_SCHEMA: Any = _LensField
"""Schema of the field of a lens, for other documents that contain a field."""


class _Uncertainty(Strict):
    parameters: list[str]
    covariance: list[list[FiniteFloat]]


class _Provenance(Strict):
    source: str = ""
    created: str = ""
    software: str = ""
    notes: str = ""


def _profile(version: int, optics: Any, **parts: type[BaseModel]) -> type[BaseModel]:
    """Build the schema of a version. The sections `parts` may be null or missing."""
    fields: dict[str, Any] = {
        "format": (Literal["matcam camera profile"], ...),
        "version": (Literal[version], ...),
        "optics": (optics, ...),
        "pixel": (_Pixel, ...),
        **{name: (schema | None, None) for name, schema in parts.items()},
        "uncertainty": (_Uncertainty | None, ...),
        "provenance": (_Provenance, ...),
    }
    return create_model(f"_Profile{version if version > 1 else ''}", __base__=Strict, __module__=__name__, **fields)


VERSION = 5
"""Version of the profiles that are written: the newest one."""
VERSIONS = {
    1: _profile(1, _one_of(_VERSION_1_LENSES)),
    2: _profile(2, _Optics2, sensor=_Sensor),
    3: _profile(3, _Optics2, sensor=_Sensor, field=_LensField),
    4: _profile(4, _Optics4, sensor=_Sensor, field=_LensField),
    5: _profile(5, _Optics4, sensor=_Sensor5, field=_LensField),
}


def json_schema(version: int = VERSION) -> dict[str, Any]:
    return VERSIONS[version].model_json_schema()
