from .camera.calibration import Calibration
from .edge.edge_result import EdgeMTF

__all__ = ["Calibration", "EdgeMTF"]
