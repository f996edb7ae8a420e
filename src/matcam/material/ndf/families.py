"""Families of isotropic NDFs, by the name that users give."""

from __future__ import annotations

from typing import Any

from matcam.core.errors import ArgumentError, unknown_name
from matcam.material.ndf.beckmann import Beckmann
from matcam.material.ndf.distribution import NDF, MixtureNDF
from matcam.material.ndf.epd import EPD
from matcam.material.ndf.gaussian_lobe import GaussianNDF
from matcam.material.ndf.ggx import GGX
from matcam.material.ndf.sgd import SGD

ONE_WIDTH: dict[str, type[MixtureNDF]] = {cls.family: cls for cls in (GaussianNDF, GGX, Beckmann)}
"""Those of one roughness and nothing else, whose record by a camera has a closed form in the tangent plane."""

WITH_POWER: dict[str, type[NDF]] = {cls.family: cls for cls in (EPD, SGD)}
"""Those of a roughness and a power."""

FAMILIES: dict[str, type[NDF]] = {**ONE_WIDTH, **WITH_POWER}
"""All of them."""


def ndf_of(family: str, roughness: Any, power: Any = None) -> NDF:
    """The NDF of a family; power: for `WITH_POWER` and only there. ArgumentError for what does not fit together."""
    if family in ONE_WIDTH:
        if power is not None:
            raise ArgumentError(f"power belongs to {' and '.join(WITH_POWER)}, not to {family}, got {power}")
        return FAMILIES[family](roughness)
    if family not in WITH_POWER:
        raise unknown_name("family of lobes", family, FAMILIES)
    if power is None:
        raise ArgumentError(f"power must be given for {family}")
    return FAMILIES[family](roughness, power)
