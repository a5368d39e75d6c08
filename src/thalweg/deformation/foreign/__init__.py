"""Epochs from elsewhere, clouds and surface models with a date, and differences of heights on a grid."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
