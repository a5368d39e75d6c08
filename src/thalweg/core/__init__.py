"""What every package stands on: frames, time, trajectories, covariance propagation, tables, errors
that users read.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
