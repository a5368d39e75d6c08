"""Studies that no rule runs: commands that print the tables of docs/validation/real_consistency.md."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
