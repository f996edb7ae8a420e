"""Estimation of a material from its record: fits through the camera, corrections, and bounds."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
