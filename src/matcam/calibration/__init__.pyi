from .camera.calibration import Calibration
from .camera.camera_fit import CameraFit, MeanCurve
from .camera.evidence import EdgeTable
from .edge.edge_result import EdgeMTF, EdgeStack

__all__ = ["Calibration", "CameraFit", "EdgeMTF", "EdgeStack", "EdgeTable", "MeanCurve"]
