from .sensor import Merged, PixelNoise, expose_bracket, merge_bracket
from .uncertainty import Provenance, Uncertainty

__all__ = ["Merged", "PixelNoise", "Provenance", "Uncertainty", "expose_bracket", "merge_bracket"]
