"""Raw logs and files of other programs as tables in SI units on GPS time, nothing lost without being
counted.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
