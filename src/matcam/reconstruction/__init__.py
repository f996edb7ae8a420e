"""Reconstruction of a material from photographs: the result of `matcam.reconstruct`, and the joint fit of all images."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
