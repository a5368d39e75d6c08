"""Photographs of the bank: masks, structure from motion, control points, adjustment with covariances."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
