"""Fields of capture.toml: types, limits and defaults. docs/capture.md describes their meaning."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    FiniteFloat,
    WithJsonSchema,
    model_validator,
)

from matcam.core.readers.schemas import Strict


class Stated(NamedTuple):
    """Specified value and its standard deviation, both in the same unit.

    A standard deviation of 0 means that the value is exact.
    """

    value: float
    std: float = 0.0


def _stated(low: float, high: float = math.inf) -> tuple[BeforeValidator, WithJsonSchema]:
    """Build the validator and the schema of a field that is a value or [value, standard deviation].

    The validator checks the limits of the value, and converts both forms to a list of two.
    """

    def check(value: Any) -> list[float]:
        pair = value if isinstance(value, list) else [value, 0.0]
        if len(pair) != 2 or any(isinstance(v, bool) or not isinstance(v, int | float) for v in pair):
            raise ValueError("must be a value or [value, standard deviation]")
        if not all(abs(v) < 1e12 for v in pair) or pair[1] < 0:  # integers may be too large for a float
            raise ValueError("must be finite, with a standard deviation of at least 0")
        number, std = map(float, pair)
        if not low <= number <= high:
            raise ValueError(f"must lie in [{low:g}, {high:g}], got {number:g}")
        return [number, std]

    number = {"type": "number", "minimum": low}
    pair = {"type": "array", "prefixItems": [number, {"type": "number", "minimum": 0}], "minItems": 2, "maxItems": 2}
    return BeforeValidator(check), WithJsonSchema({"anyOf": [number, pair]})


_Positive = Annotated[list[float], *_stated(1e-12)]
_NotNegative = Annotated[list[float], *_stated(0.0)]


def _with_pixels(box: list[int]) -> list[int]:
    if min(box[2:]) < 1:
        raise ValueError("width and height (the last two) must be at least 1 px")
    return box


_Box = Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=4, max_length=4), AfterValidator(_with_pixels)]
_Rows = Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=2, max_length=2)]
_ONLY = {
    "flat": ("tilt_deg", "mm_per_px"),
    "cylinder": ("outline_radius_px", "axis_column_px", "centre_row_px", "strip_rows_px", "strip_turn_deg"),
}
"""Fields of [sample] that apply to only one kind of sample."""
LEAST_STRIP = 12
"""Smallest number of rows of a strip of a cylinder. Four rows at each end are not read."""


class _Camera(Strict):
    profile: str | None = None
    cfa: str | None = None
    tone: Literal["linear", "srgb"] = "linear"
    accept_processed: bool = False
    black_level_dn: FiniteFloat | None = None


class _Sample(Strict):
    kind: Literal["sphere", "cylinder", "flat"] = "sphere"
    radius_mm: _Positive | None = None
    region_px: _Box | None = None
    outline_radius_px: _Positive | None = None
    axis_column_px: _NotNegative | None = None
    centre_row_px: _NotNegative | None = None
    strip_rows_px: Annotated[list[_Rows], Field(min_length=1, max_length=64)] | None = None
    strip_turn_deg: Annotated[list[FiniteFloat], Field(min_length=1, max_length=64)] | None = None

    tilt_deg: Annotated[list[Annotated[FiniteFloat, Field(gt=-85, lt=85)]], Field(min_length=1)] | None = None
    mm_per_px: _Positive | None = None

    @model_validator(mode="after")
    def _of_one_kind(self) -> _Sample:
        for kind, names in _ONLY.items():
            for name in names:
                if self.kind != kind and getattr(self, name) is not None:
                    raise ValueError(f"{name} applies only if kind is {kind}, but kind is {self.kind}: delete it")
        rows, turns = self.strip_rows_px, self.strip_turn_deg
        if turns is not None and len(turns) != len(rows or ()):
            raise ValueError(
                f"strip_turn_deg has {len(turns)} angles, but strip_rows_px has {len(rows or ())} strips: give one angle for "
                "each"
            )
        for first, last in rows or ():
            if last <= first:
                raise ValueError(
                    f"strip_rows_px must have [first row, last row] of each strip, first < last, got [{first}, {last}]"
                )
            if last - first + 1 < LEAST_STRIP:
                raise ValueError(
                    f"each strip of strip_rows_px must have at least {LEAST_STRIP} rows, got [{first}, {last}]: give wider "
                    "strips"
                )
        for before, after in pairwise(sorted(rows or ())):
            if after[0] <= before[1]:
                raise ValueError(f"the strips {before} and {after} of strip_rows_px overlap: give separate rows")
        return self


class _Distances(Strict):
    camera_mm: _Positive | None = None
    lamp_mm: _Positive | None = None


class _LampSection(Strict):
    radius_mm: _NotNegative = Field(default=[0.0, 0.0])
    motion: Literal["arc", "free", "table"] = "free"
    intensity: Literal["reference", "constant", "table"] = "constant"
    gain_std: Annotated[FiniteFloat, Field(ge=0, lt=1)] = 0.005
    direction_std_deg: Annotated[FiniteFloat, Field(ge=0, le=180)] = 1.0


class _Reference(Strict):
    kind: Literal["diffuse", "monitor"]
    reflectance: Annotated[list[float], *_stated(0.0, 1.0)] | None = None
    depth_mm: Annotated[list[float], *_stated(-1e6)] | None = None
    tilt_std_deg: Annotated[FiniteFloat, Field(ge=0, le=45)] = 1.0
    region_px: _Box | None = None
    apart: bool = False
    between_std: Annotated[FiniteFloat, Field(ge=0, lt=1)] | None = None


class _Outline(Strict):
    field_beyond_deg: Annotated[FiniteFloat, Field(ge=0, le=90)] = 3.0
    centre_px: Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)] | None = None
    radius_px: _Positive | None = None
    mask: str | None = None
    mask_std_px: Annotated[FiniteFloat, Field(gt=0)] = 0.5

    @model_validator(mode="after")
    def _whole(self) -> _Outline:
        if (self.centre_px is None) != (self.radius_px is None):
            raise ValueError("centre_px and radius_px describe one circle: give both or neither")
        return self


class CaptureSettings(Strict):
    """Tables of capture.toml; docs/capture.md describes the fields."""

    format: Literal["matcam capture"]
    version: Literal[1]
    camera: _Camera = _Camera()
    sample: _Sample = _Sample()
    distances: _Distances = _Distances()
    lamp: _LampSection = _LampSection()
    reference: _Reference | None = None
    outline: _Outline = _Outline()

    @model_validator(mode="after")
    def _circle_of_a_sphere(self) -> CaptureSettings:
        if self.sample.kind != "sphere" and (self.outline.centre_px is not None or self.outline.mask is not None):
            raise ValueError(
                f"outline.centre_px and outline.mask apply only to a sphere, but sample.kind is {self.sample.kind}: delete them"
            )
        return self
