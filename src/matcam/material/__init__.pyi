from .adaptive import Adaptive
from .material import albedo
from .metals import metals
from .ndf.beckmann import AnisotropicBeckmann
from .ndf.ggx import AnisotropicGGX
from .reflectance import Constant, Sampled
from .tabulated import Tabulated

__all__ = ["Adaptive", "AnisotropicBeckmann", "AnisotropicGGX", "Constant", "Sampled", "Tabulated", "albedo", "metals"]
