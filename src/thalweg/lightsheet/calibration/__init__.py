"""Calibration of camera, window and light sheet from a grid object in two levels."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
