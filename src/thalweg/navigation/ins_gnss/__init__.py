"""Trajectories from INS attitudes and GNSS positions, and how their errors behave."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
