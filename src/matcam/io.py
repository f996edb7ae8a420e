"""Reading and writing of files, in any format by recognition, or in a specific one."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub("matcam", __file__)
