"""Schemas of the published versions of the camera profile (pydantic).

A published version never changes: additions are made in the next one, and each version has its own lenses.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Union

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, create_model

from matcam.core.registry import LENSES, PIXELS

MODELS = {**LENSES, **PIXELS}
"""Class of each lens and pixel by its name in a profile."""
_VERSION_1_LENSES = ("gaussian", "diffraction", "measured")
_VERSION_2_LENSES = (*_VERSION_1_LENSES[:2], "defocus", "measured", "halo")
_CURVES = ("frequency_cycles_per_px", "mtf")
_PAIRS = {
    "zernike": ("astigmatism_waves", "coma_waves", "trefoil_waves"),
    "colour": ("red_shift_px", "green_shift_px", "blue_shift_px"),
}
_INNER_LENSES = ("core", "red", "green", "blue")


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class Part(_Strict):
    """Lens or pixel: the name of its model, and its fields."""

    model: str


_Pair = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]


def _kind(name: str, field: str) -> Any:
    """Return the type of a field of a model."""
    if field in _CURVES:
        return list[FiniteFloat]
    if field in _INNER_LENSES:
        return "_Optics"
    return _Pair if field in _PAIRS.get(name, ()) else FiniteFloat


def _part_schema(name: str) -> type[Part]:
    """Build the schema of one model of a lens or a pixel from the fields of its class."""
    title = "_" + "".join(word.capitalize() for word in name.split())
    fields: dict[str, Any] = {"model": (Literal[name], ...)}
    for field in MODELS[name].profile_fields:
        fields[field] = (_kind(name, field), ...)
    return create_model(title, __base__=Part, __module__=__name__, **fields)


def _one_of(names: Iterable[str]) -> Any:
    """Build the union of the schemas of the named models.

    A lens inside another lens may be any of these models, too.
    """
    schemas: Any = tuple(_part_schema(name) for name in names)
    union = Annotated[Union[schemas], Field(discriminator="model")]  # noqa: UP007
    for schema in schemas:
        schema.model_rebuild(_types_namespace={"_Optics": union})
    return union


_Optics1: Any = _one_of(_VERSION_1_LENSES)
_Optics2: Any = _one_of(_VERSION_2_LENSES)
_Optics4: Any = _one_of(LENSES)
_Pixel: Any = _one_of(PIXELS)


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


class _Sensor5(_Sensor):
    model_config = ConfigDict(title="_Sensor")
    dsnu_electrons: FiniteFloat


SENSOR_FIELDS = {
    field: re.sub(r"_(m|electrons|dn|dn_per_electron|electrons_per_s)$", "", field) for field in _Sensor5.model_fields
}
"""Attribute of `Sensor` by its name with the unit."""


class _LensField(_Strict):
    centre_px: _Pair
    unit_px: FiniteFloat
    k1: _Pair
    k2: _Pair
    growth: _Pair
    holds_at_px: FiniteFloat


FIELD_SCHEMA: Any = _LensField
"""Schema of the field of a lens, for other documents that contain a field."""


class _Uncertainty(_Strict):
    parameters: list[str]
    covariance: list[list[FiniteFloat]]


class _Provenance(_Strict):
    source: str = ""
    created: str = ""
    software: str = ""
    notes: str = ""


class _Profile1(_Strict):
    model_config = ConfigDict(title="_Profile")
    format: Literal["matcam camera profile"]
    version: Literal[1]
    optics: _Optics1
    pixel: _Pixel
    uncertainty: _Uncertainty | None
    provenance: _Provenance


class _Profile2(_Strict):
    format: Literal["matcam camera profile"]
    version: Literal[2]
    optics: _Optics2
    pixel: _Pixel
    sensor: _Sensor | None = None
    uncertainty: _Uncertainty | None
    provenance: _Provenance


class _Profile3(_Strict):
    format: Literal["matcam camera profile"]
    version: Literal[3]
    optics: _Optics2
    pixel: _Pixel
    sensor: _Sensor | None = None
    field: _LensField | None = None
    uncertainty: _Uncertainty | None
    provenance: _Provenance


class _Profile4(_Strict):
    format: Literal["matcam camera profile"]
    version: Literal[4]
    optics: _Optics4
    pixel: _Pixel
    sensor: _Sensor | None = None
    field: _LensField | None = None
    uncertainty: _Uncertainty | None
    provenance: _Provenance


class _Profile5(_Strict):
    format: Literal["matcam camera profile"]
    version: Literal[5]
    optics: _Optics4
    pixel: _Pixel
    sensor: _Sensor5 | None = None
    field: _LensField | None = None
    uncertainty: _Uncertainty | None
    provenance: _Provenance


VERSION = 5
"""Version of the profiles that are written: the newest one."""
VERSIONS: dict[int, type[BaseModel]] = {1: _Profile1, 2: _Profile2, 3: _Profile3, 4: _Profile4, 5: _Profile5}


def json_schema(version: int = VERSION) -> dict[str, Any]:
    """Return the JSON Schema of a version of the profile."""
    return VERSIONS[version].model_json_schema()
