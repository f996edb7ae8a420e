"""From photographs to the material: what `matcam.reconstruct` returns, and the joint fit of all pictures behind it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
