"""What the numbers of a file mean: units, values that stand for none, places that can be meant."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
