"""Correction of many tables of one rig, in parallel and with resumption after an interruption."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
