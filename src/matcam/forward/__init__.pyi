from .image import picture_values
from .measurement import table_values
from .noisy_table import with_pixel_noise
from .stamps import highlight_stamps
from .texture import texture_contrast, textured_picture

__all__ = [
    "highlight_stamps",
    "picture_values",
    "table_values",
    "texture_contrast",
    "textured_picture",
    "with_pixel_noise",
]
