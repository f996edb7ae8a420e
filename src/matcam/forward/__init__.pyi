from .image import picture_values
from .measurement import table_values, true_table, with_pixel_noise
from .previews import highlight_preview, response_preview, sphere_preview
from .stamps import Highlights, highlight_stamps, rig_highlights
from .texture import texture_contrast, textured_picture

__all__ = [
    "Highlights",
    "highlight_preview",
    "highlight_stamps",
    "picture_values",
    "response_preview",
    "rig_highlights",
    "sphere_preview",
    "table_values",
    "texture_contrast",
    "textured_picture",
    "true_table",
    "with_pixel_noise",
]
