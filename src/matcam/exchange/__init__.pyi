from .inspection import LobeWidths, camera_trace, lobe_widths
from .parameterisation import adaptive_grid
from .receiver import metadata, solid_angles
from .renderers import mitsuba_material, pbrt_material, rendered_sphere

__all__ = [
    "LobeWidths",
    "adaptive_grid",
    "camera_trace",
    "lobe_widths",
    "metadata",
    "mitsuba_material",
    "pbrt_material",
    "rendered_sphere",
    "solid_angles",
]
