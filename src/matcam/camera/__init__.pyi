from .bracketing import RadianceEstimate, expose_bracket, merge_bracket
from .lens_field import Coefficient, LensField
from .parameters import Provenance, Uncertainty
from .sensor import PixelNoise

__all__ = [
    "Coefficient",
    "LensField",
    "PixelNoise",
    "Provenance",
    "RadianceEstimate",
    "Uncertainty",
    "expose_bracket",
    "merge_bracket",
]
