"""Families of lobes, masking models and Fresnel terms, by the names that users give; free of JAX, for the command line."""

from __future__ import annotations

from typing import Any

from matcam.core.errors import ArgumentError, unknown_name
from matcam.core.registry import Registry

_MATERIAL = "matcam.material"

FAMILIES: Registry[Any] = Registry(
    {
        "gaussian": f"{_MATERIAL}.ndf.gaussian_lobe:GaussianNDF",
        "ggx": f"{_MATERIAL}.ndf.ggx:GGX",
        "beckmann": f"{_MATERIAL}.ndf.beckmann:Beckmann",
        "epd": f"{_MATERIAL}.ndf.power_lobes:EPD",
        "sgd": f"{_MATERIAL}.ndf.power_lobes:SGD",
    }
)
"""Isotropic normal distribution functions."""

WITH_POWER = FAMILIES.subset(lambda name: name in ("epd", "sgd"))
"""Families of a roughness and a power."""

ONE_WIDTH = FAMILIES.subset(lambda name: name not in WITH_POWER)
"""Families of a roughness alone, whose record by a camera has a closed form in the tangent plane."""

MASKING_MODELS: Registry[Any] = Registry(
    {
        "smith": f"{_MATERIAL}.masking:height_correlated",
        "smith-separable": f"{_MATERIAL}.masking:separable",
        "van-ginneken": f"{_MATERIAL}.masking:azimuth_correlated",
    }
)
"""Joint masking of light and view; instead of a name, None leaves masking out."""

FRESNEL_MODELS: Registry[Any] = Registry(
    {
        "conductor": f"{_MATERIAL}.reflectance:Conductor",
        "schlick": f"{_MATERIAL}.reflectance:Schlick",
        "dielectric": f"{_MATERIAL}.reflectance:Dielectric",
        "free": f"{_MATERIAL}.reflectance:Sampled",
    }
)
"""Fresnel terms that a fit can estimate; "free" is one value for each theta_d."""


def family_ndf(family: str, roughness: Any, power: Any = None) -> Any:
    """Return the NDF of a family.

    Args:
        family: one of `FAMILIES`.
        roughness: its first parameter (a slope; rad for "gaussian").
        power: the second, for `WITH_POWER` and only there.

    Raises:
        ArgumentError: the family is unknown, or its power is missing or does not belong there.
    """
    if family in ONE_WIDTH:
        if power is not None:
            raise ArgumentError(f"power belongs to {' and '.join(WITH_POWER)}, not to {family}, got {power}")
        return FAMILIES[family](roughness)
    if family not in WITH_POWER:
        raise unknown_name("family of lobes", family, FAMILIES)
    if power is None:
        raise ArgumentError(f"power must be given for {family}")
    return FAMILIES[family](roughness, power)
