"""The calibration field of the digital twin: a yard with cones, printed markers and a boat in it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
