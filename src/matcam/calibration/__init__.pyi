from .camera.calibration import Calibration
from .camera.camera_fit import CameraFit
from .camera.evidence import EdgeTable, MeanCurve
from .camera.lateral_colour import LateralColour
from .edge.edge_result import EdgeMTF, EdgeStack
from .edge.free_curve import EdgeSamples
from .edge.parametric_result import ParametricEdge, ParametricStack
from .readings.edge_numbers import EdgeNumber, level_frequency, mtf_at, rise_distance
from .readings.iso12233 import ISOEdge, iso12233_sfr
from .readings.through_focus import BestFocus, best_focus
from .sensor.characteristics import SensorCharacteristics

__all__ = [
    "BestFocus",
    "Calibration",
    "CameraFit",
    "EdgeMTF",
    "EdgeNumber",
    "EdgeSamples",
    "EdgeStack",
    "EdgeTable",
    "ISOEdge",
    "LateralColour",
    "MeanCurve",
    "ParametricEdge",
    "ParametricStack",
    "SensorCharacteristics",
    "best_focus",
    "iso12233_sfr",
    "level_frequency",
    "mtf_at",
    "rise_distance",
]
