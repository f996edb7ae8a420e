from .bracketing import RadianceEstimate, expose_bracket, merge_bracket
from .profile import Provenance, Uncertainty
from .sensor import PixelNoise

__all__ = ["PixelNoise", "Provenance", "RadianceEstimate", "Uncertainty", "expose_bracket", "merge_bracket"]
