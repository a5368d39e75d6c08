"""A camera with two fisheye lenses: its pictures of the river and of a room of markers, and its truth."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
