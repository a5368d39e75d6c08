"""Change between epochs: M3C2 distances with the correlated errors of a moving platform."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
