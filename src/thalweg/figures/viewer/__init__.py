"""A point cloud in a browser, opened from disk: no server, no network, no library of others."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
