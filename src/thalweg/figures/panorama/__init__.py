"""Figures of a camera with two fisheye lenses: its calibration, its panoramas and their seam."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
