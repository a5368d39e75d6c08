from . import compare as compare, world as world
from .compare import (
    SCAN_DISTANCES as SCAN_DISTANCES,
    compare_scan as compare_scan,
    single_profile as single_profile,
    to_reference as to_reference,
)
from .distances import bimodality as bimodality, filtered as filtered, mesh_distances as mesh_distances
from .levels import fit_levels as fit_levels
from .ortho import orthophoto as orthophoto, write_orthophoto as write_orthophoto
from .profile import (
    SCAN_POINTS as SCAN_POINTS,
    ScanCloud as ScanCloud,
    joined_counts as joined_counts,
    merge as merge,
    profile as profile,
    profiles as profiles,
    scan_points as scan_points,
)
from .world import BED_POINTS as BED_POINTS, image_times as image_times
