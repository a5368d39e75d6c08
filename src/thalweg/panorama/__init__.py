"""Panoramas of a camera with two fisheye lenses: equirectangular, stitched at the ranges of the cloud."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
