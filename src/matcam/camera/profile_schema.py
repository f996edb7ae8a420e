"""What a camera profile must look like, version by version. It validates JSON; the numbers live in the camera's objects.

A published version never changes: what is new goes into the next one.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

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
