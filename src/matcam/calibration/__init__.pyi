from .camera.calibration import Calibration
from .edge.edge_result import EdgeMTF, EdgeSamples, EdgeStack
from .edge.parametric_result import ParametricEdge, ParametricStack

__all__ = ["Calibration", "EdgeMTF", "EdgeSamples", "EdgeStack", "ParametricEdge", "ParametricStack"]
