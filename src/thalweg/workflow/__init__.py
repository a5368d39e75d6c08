"""Services for jobs: provenance, code versions, protection of the truth of the digital twin."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
