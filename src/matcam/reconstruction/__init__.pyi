from .flat.flat_reconstruction import FlatReconstruction
from .reconstruction import Reconstruction

__all__ = ["FlatReconstruction", "Reconstruction"]
