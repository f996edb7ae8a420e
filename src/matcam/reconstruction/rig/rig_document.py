"""Schema of the JSON document of `matcam reconstruct`, and reader of the rig in this document.

docs/reconstruct.md describes the fields. `json_schema()` is the published schema (docs/reconstruction-v1.schema.json).
The parameters of the rig (lens, distances, lamps) are read as an `EarlierRig` with a common covariance matrix.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from matcam.camera.lens_field import LensField
from matcam.camera.profile import FIELD_SCHEMA, field_from
from matcam.core.errors import ArgumentError, FileFormatError
from matcam.core.readers.texts import checked_version, first_problem, read_json

FORMAT, VERSION = "matcam reconstruction", 1
SCENE_NAMES = ("lens", "camera nearness", "lamp nearness", "distortion", "blur growth")
"""Parameters of the rig that precede those of the lamps, in the order of the covariance."""
_WHAT = "a reconstruction"

# models have no docstrings, because pydantic would include them in the published schema


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


_Vector = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
_Position = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
_Pair = Annotated[list[FiniteFloat | None], Field(min_length=2, max_length=2)]


class _Lamp(_Strict):
    name: str
    direction: _Vector
    std_deg: FiniteFloat
    centre_px: _Position
    gain: FiniteFloat


class _Covariance(_Strict):
    names: list[str]
    matrix: list[list[FiniteFloat]]


class _Geometry(_Strict):
    frame_px: Annotated[list[int], Field(min_length=2, max_length=2)] | None
    sample_radius_mm: FiniteFloat | None
    centre_px: Annotated[list[_Position], Field(min_length=2, max_length=2)]
    radius_px: _Position
    lamps: list[_Lamp]
    camera_radii: _Pair
    lamp_radii: _Pair
    sigma_px: FiniteFloat | None
    field: FIELD_SCHEMA | None
    covariance: _Covariance


class _Lobe(_Strict):
    family: str
    masking: str | None
    spline_modified: bool
    anisotropic: bool = False


class _Fresnel(_Strict):
    theta_d_deg: list[FiniteFloat]
    channels: list[str]
    value: list[list[FiniteFloat]]
    std: list[list[FiniteFloat | None]]
    model: list[str]
    absolute: bool
    unit_std: list[FiniteFloat | None] | None


class _Picture(_Strict):
    name: str
    chi2: FiniteFloat
    left_out_px: int


class _Pairwise(_Strict):
    names: Annotated[list[str], Field(min_length=2, max_length=2)]
    correlation: FiniteFloat


class _Remark(_Strict):
    code: str
    text: str


class _Document(BaseModel):
    model_config = ConfigDict(extra="allow", title="matcam reconstruction")
    format: Literal["matcam reconstruction"]
    version: Literal[1]
    verdict: str
    sample: Literal["sphere", "cylinder"] = "sphere"
    lobe: _Lobe
    parameters: dict[str, _Pair]
    geometry: _Geometry
    fresnel: _Fresnel
    budget: dict[str, dict[str, FiniteFloat | None]]
    unexplained: FiniteFloat
    tried: dict[str, FiniteFloat]
    probabilities: dict[str, FiniteFloat] = Field(default_factory=dict)
    pictures: list[_Picture]
    not_determined: list[_Pairwise]
    radiometry: dict[str, Any] | None
    left_out: list[str]
    remarks: list[_Remark]


class EarlierRig(NamedTuple):
    """Rig of an earlier reconstruction.

    Attributes:
        file: path of the JSON file of the reconstruction.
        frame: width and height of the frames, px; None: unknown.
        sample_radius: radius of the sphere, mm; None: unknown.
        sigma: standard deviation of the fitted lens, px; None: the lens is not Gaussian.
        nearness: inverse of the distances of camera and lamp, 1/radii.
        field: field of the lens; None: uniform.
        lamps: names of the lamp positions.
        directions: unit vectors to the lamps, (lamps, 3).
        covariance: covariance of ln of the lens width, inverse distances of camera and lamp, distortion coefficient k1,
            growth of the blur, and two rotations (rad) of each lamp, (5 + 2 lamps, 5 + 2 lamps).
    """

    file: str
    frame: tuple[int, int] | None
    sample_radius: float | None
    sigma: float | None
    nearness: tuple[float, float]
    field: LensField | None
    lamps: tuple[str, ...]
    directions: np.ndarray
    covariance: np.ndarray


def json_schema() -> dict[str, Any]:
    return _Document.model_json_schema()


def read_rig(path: str | Path) -> EarlierRig:
    """Read the rig of an earlier reconstruction.

    Args:
        path: JSON file written by `matcam reconstruct`.

    Raises:
        FileFormatError: the file cannot be read, is not a reconstruction of a sphere or cylinder, or has an inconsistent
            rig.
    """
    geometry = _checked(read_json(path, _WHAT), path).geometry
    names = tuple(lamp.name for lamp in geometry.lamps)
    size = len(SCENE_NAMES) + 2 * len(names)
    try:
        covariance = np.array(geometry.covariance.matrix, dtype=float)
    except ValueError:
        covariance = np.zeros(0)
    if covariance.shape != (size, size) or len(geometry.covariance.names) != size:
        raise FileFormatError(
            f"{path}: field geometry.covariance: names and matrix must cover {size} parameters: 5 of the rig, and 2 for "
            "each lamp"
        )
    if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-12) or np.diag(covariance).min() < 0:
        raise FileFormatError(f"{path}: field geometry.covariance: the matrix must be symmetric with variances >= 0")
    directions = np.array([lamp.direction for lamp in geometry.lamps], dtype=float).reshape(-1, 3)
    if not np.allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-3):
        raise FileFormatError(f"{path}: field geometry.lamps: each direction must be a unit vector")
    if len(set(names)) != len(names):
        raise FileFormatError(
            f"{path}: field geometry.lamps: two lamps have the same name: each lamp must have its own name"
        )
    try:
        field = None if geometry.field is None else field_from(geometry.field)
    except ArgumentError as error:
        raise FileFormatError(f"{path}: field geometry.field: {error}") from None
    camera, lamp = (0.0 if not one[0] else 1 / one[0] for one in (geometry.camera_radii, geometry.lamp_radii))
    frame = None if geometry.frame_px is None else (geometry.frame_px[0], geometry.frame_px[1])
    return EarlierRig(
        str(path),
        frame,
        geometry.sample_radius_mm,
        geometry.sigma_px,
        (camera, lamp),
        field,
        names,
        directions,
        covariance,
    )


def _checked(document: Any, where: str | Path) -> _Document:
    checked_version(document, where, _WHAT, FORMAT, (VERSION,))
    try:
        return _Document.model_validate(document)
    except ValidationError as error:
        raise FileFormatError(f"{where}: {first_problem(error)}") from None
