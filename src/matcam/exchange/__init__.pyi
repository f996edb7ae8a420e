from .inspection import LobeWidths, camera_trace, lobe_widths
from .materialx import OpenPBRSurface, fit_openpbr, write_openpbr
from .mitsuba_film import MitsubaFilm
from .parameterisation import adaptive_grid
from .receiver import metadata, solid_angles
from .renderers import mitsuba_material, pbrt_material, rendered_sphere

__all__ = [
    "LobeWidths",
    "MitsubaFilm",
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
