"""Camera calibration: lens, pixel and sensor with their uncertainties, from photographs of edges and charts."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
