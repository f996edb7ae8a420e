"""Read and write files: any of the formats by recognition, or one of them by name."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub("matcam", __file__)
