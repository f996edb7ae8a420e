from .material import albedo
from .measured import Adaptive, Tabulated
from .ndf.beckmann import AnisotropicBeckmann
from .ndf.ggx import AnisotropicGGX
from .optical_constants import metals
from .reflectance import Constant, Sampled

__all__ = ["Adaptive", "AnisotropicBeckmann", "AnisotropicGGX", "Constant", "Sampled", "Tabulated", "albedo", "metals"]
