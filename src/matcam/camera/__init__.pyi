from .bracketing import RadianceEstimate, expose_bracket, merge_bracket
from .sensor import PixelNoise
from .uncertainty import Provenance, Uncertainty

__all__ = ["PixelNoise", "Provenance", "RadianceEstimate", "Uncertainty", "expose_bracket", "merge_bracket"]
