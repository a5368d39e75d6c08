"""The light-sheet sensor in a tank: rendered lines, scanned objects, a strip of the bed."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
