"""What changed between epochs: distances with the errors that moving platforms really have."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
