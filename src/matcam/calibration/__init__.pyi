from .camera.calibration import Calibration
from .edge.edge_result import EdgeMTF, EdgeStack

__all__ = ["Calibration", "EdgeMTF", "EdgeStack"]
