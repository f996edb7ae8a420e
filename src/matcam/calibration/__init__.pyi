from .camera.calibration import Calibration
from .camera.camera_fit import CameraFit, MeanCurve
from .camera.evidence import EdgeTable
from .camera.lateral_colour import LateralColour
from .edge.edge_result import EdgeMTF, EdgeSamples, EdgeStack
from .edge.parametric_result import ParametricEdge, ParametricStack
from .sensor.characteristics import SensorCharacteristics

__all__ = [
    "Calibration",
    "CameraFit",
    "EdgeMTF",
    "EdgeSamples",
    "EdgeStack",
    "EdgeTable",
    "LateralColour",
    "MeanCurve",
    "ParametricEdge",
    "ParametricStack",
    "SensorCharacteristics",
]
