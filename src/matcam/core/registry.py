"""Registries of objects that users choose by name: lenses, pixels, families of lobes, masking models, Fresnel terms.

A registry lists names immediately and imports their objects on first use, so that the command line can list its choices
without loading JAX.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from typing import Any, Generic, TypeVar

from matcam.core.errors import ArgumentError, unknown_name

T = TypeVar("T")


def imported(home: str) -> Any:
    """Import an object by its location, "package.module:attribute"."""
    module, attribute = home.split(":")
    return getattr(import_module(module), attribute)


class Registry(Mapping[str, T], Generic[T]):
    """Mapping from names to classes or functions, each imported on first use.

    Attributes:
        homes: location of each object by its name, "package.module:attribute".
    """

    def __init__(self, homes: Mapping[str, str]):
        self.homes = dict(homes)

    def __getitem__(self, name: str) -> T:
        return imported(self.homes[name])

    def __contains__(self, name: object) -> bool:
        return name in self.homes  # a membership test imports nothing

    def __iter__(self) -> Iterator[str]:
        return iter(self.homes)

    def __len__(self) -> int:
        return len(self.homes)

    def subset(self, keep: Callable[[str], bool]) -> Registry[T]:
        return Registry({name: home for name, home in self.homes.items() if keep(name)})

    def __repr__(self) -> str:
        return f"Registry({', '.join(self.homes)})"


_OPTICS = "matcam.camera.optics"

LENSES: Registry[Any] = Registry(
    {
        "gaussian": f"{_OPTICS}.gaussian:GaussianOptics",
        "diffraction": f"{_OPTICS}.pupil:DiffractionOptics",
        "defocus": f"{_OPTICS}.pupil:DefocusOptics",
        "measured": f"{_OPTICS}.measured:MeasuredOptics",
        "halo": f"{_OPTICS}.halo:HaloOptics",
        "zernike": f"{_OPTICS}.zernike:ZernikeOptics",
        "colour": f"{_OPTICS}.colour:ColourOptics",
        "seidel": f"{_OPTICS}.seidel:SeidelOptics",
    }
)
"""All lenses; camera profiles support each of them."""

FITTED_LENSES = LENSES.subset(lambda name: name not in ("zernike", "colour", "seidel"))
"""Isotropic lenses, which `calibrate` fits."""

PARAMETRIC_LENSES = FITTED_LENSES.subset(lambda name: name != "measured")
"""Lenses of a few parameters, which can be fitted to a single edge."""

PIXELS: Registry[Any] = Registry(
    {
        "box": "matcam.camera.pixel:BoxPixel",
        "windowed gaussian": "matcam.camera.pixel:WindowedGaussianPixel",
    }
)
"""All pixel responses."""

CFAS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Bayer mosaics: the colours of the upper left 2 x 2 pixels, row by row."""


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
"""Families with a roughness and a power."""

ONE_WIDTH = FAMILIES.subset(lambda name: name not in WITH_POWER)
"""Families with only a roughness, whose record by a camera has a closed form in the tangent plane."""

MASKING_MODELS: Registry[Any] = Registry(
    {
        "smith": f"{_MATERIAL}.masking:height_correlated",
        "smith-separable": f"{_MATERIAL}.masking:separable",
        "van-ginneken": f"{_MATERIAL}.masking:azimuth_correlated",
    }
)
"""Joint masking of light and view. None instead of a name means no masking."""

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
    """Build the normal distribution function of a family.

    Args:
        family: one of `FAMILIES`.
        roughness: first parameter of the family (a slope without unit; rad for "gaussian").
        power: second parameter of the families in `WITH_POWER`, no unit. Default: None, for the other families.

    Raises:
        ArgumentError: the family is unknown, a parameter is out of range, the power is missing for a family with a power,
            or a power is given for another family.
    """
    if family in ONE_WIDTH:
        if power is not None:
            raise ArgumentError(
                f"power can be given for {' and '.join(WITH_POWER)}, but not for {family}, got {power}: omit power"
            )
        return FAMILIES[family](roughness)
    if family not in WITH_POWER:
        raise unknown_name("family of lobes", family, FAMILIES)
    if power is None:
        raise ArgumentError(f"power must be given for {family}")
    return FAMILIES[family](roughness, power)
