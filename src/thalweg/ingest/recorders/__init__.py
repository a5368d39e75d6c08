"""What the recorders of small boats hold: autopilots, u-blox receivers, bags of ROS, echo sounders."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
