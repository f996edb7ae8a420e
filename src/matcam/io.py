"""Reading and writing of files, in a specific format or in a format that is recognised."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub("matcam", __file__)
