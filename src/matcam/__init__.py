"""matcam: effect of a camera on reflectance measurements, and its correction.

Angles are in rad, lengths on the sensor in px (pixel pitches), and wavelengths and other lengths in m. The public names
are listed in `__init__.pyi`; each is loaded on first use, so that importing matcam is fast.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
