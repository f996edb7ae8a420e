"""Charts to photograph, and the targets on them: design, find, measure."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub("matcam", __file__)
