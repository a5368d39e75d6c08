"""Point clouds of others: LAS, PLY, E57, PCD; reference scans in the local frame."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
