"""Velodyne VLP-16, Puck Hi-Res, HDL-32E, VLP-32C: packets to points on GPS time."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
