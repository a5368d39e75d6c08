"""Report of a survey, or of a change between epochs, to hand in: its words and tables, and its looks."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
