"""matcam: prediction and correction of camera effects on reflectance measurements.

Unless a docstring specifies another unit, angles are in rad, lengths on the sensor in px (pixel pitches), and wavelengths
and other lengths in m. The public names are listed in `__init__.pyi`. Each name is loaded on first use, so that importing
matcam is fast.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
