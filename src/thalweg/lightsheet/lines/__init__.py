"""Laser lines in images: found, linked row to row, measured to sub-pixels with a sigma for each point."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
