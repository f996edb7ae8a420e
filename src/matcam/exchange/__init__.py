"""From one format to another, and to renderers: conversion, parameterisations, what a table shows of its camera."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
