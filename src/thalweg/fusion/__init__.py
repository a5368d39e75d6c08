"""One terrain model of bed, banks and surroundings, and what others make of it: meshes, sections, volumes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
