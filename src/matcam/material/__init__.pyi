from .adaptive import Adaptive
from .material import Tabulated, albedo
from .metals import metal_sources, metals
from .ndf.anisotropic import AnisotropicBeckmann, AnisotropicGGX
from .ndf.distribution import MixtureNDF
from .reflectance import Constant, Sampled

__all__ = [
    "Adaptive",
    "AnisotropicBeckmann",
    "AnisotropicGGX",
    "Constant",
    "MixtureNDF",
    "Sampled",
    "Tabulated",
    "albedo",
    "metal_sources",
    "metals",
]
