"""Simulated records of a material: tables, images, and peaks of highlights."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
