"""matcam: what a camera does to a reflectance measurement, and how to undo it.

Angles in rad, lengths on the sensor in px (pixel pitches), wavelengths and other lengths in m. The public names stand in
`__init__.pyi`; each is loaded when it is first used, so that importing matcam costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
