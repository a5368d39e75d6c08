from .errors import FusionErrors as FusionErrors, Prior as Prior, with_errors as with_errors
from .model import (
    SPREAD as SPREAD,
    FusionSettings as FusionSettings,
    Layout as Layout,
    Reference as Reference,
    camera_of as camera_of,
    make_reference as make_reference,
    place_nodes as place_nodes,
    stated as stated,
    with_own_jitter as with_own_jitter,
)
from .solver import Observed as Observed, jumped_images as jumped_images, solve as solve
from .trajectory import Fused as Fused, count_table as count_table, fuse_trajectory as fuse_trajectory
