"""Post-processed kinematic positions by RTKLIB, from SBP and RINEX."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
