"""Boresight and lever arm of the lidar on the moving boat, from a run around cones."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
