from .inspection import LobeWidths, camera_trace, lobe_widths
from .materialx import OpenPBRSurface, fit_openpbr, write_openpbr
from .parameterisation import adaptive_grid
from .receiver import metadata, solid_angles
from .renderers import mitsuba_material, pbrt_material, rendered_sphere

__all__ = [
    "LobeWidths",
    "OpenPBRSurface",
    "adaptive_grid",
    "camera_trace",
    "fit_openpbr",
    "lobe_widths",
    "metadata",
    "mitsuba_material",
    "pbrt_material",
    "rendered_sphere",
    "solid_angles",
    "write_openpbr",
]
