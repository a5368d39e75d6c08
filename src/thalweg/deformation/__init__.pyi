from .changes import (
    DRAWS as DRAWS,
    YEAR_S as YEAR_S,
    Compared as Compared,
    Pair as Pair,
    compare_epochs as compare_epochs,
    draw_errors as draw_errors,
    measure_pair as measure_pair,
    register_pair as register_pair,
    registered_distances as registered_distances,
    series_of_epochs as series_of_epochs,
)
from .compare import (
    CHANGES as CHANGES,
    CLOUD_TO_CLOUD as CLOUD_TO_CLOUD,
    Comparison as Comparison,
    Distances as Distances,
    cloud_to_cloud as cloud_to_cloud,
    judge_changes as judge_changes,
    measure_distances as measure_distances,
)
from .core_points import CORE_POINTS as CORE_POINTS, place_core_points as place_core_points
from .coregistration import (
    Registration as Registration,
    design_of as design_of,
    read_registration as read_registration,
    write_registration as write_registration,
)
from .epochs import (
    Epoch as Epoch,
    between_frames as between_frames,
    check_order as check_order,
    highest_water_m as highest_water_m,
    prepare_epoch as prepare_epoch,
)
from .field import (
    COMMON as COMMON,
    ErrorField as ErrorField,
    ErrorGroup as ErrorGroup,
    benjamini_hochberg as benjamini_hochberg,
    rows_of_weights as rows_of_weights,
)
from .m3c2 import ColumnIndex as ColumnIndex, pose_weights as pose_weights
from .series import (
    HEIGHTS as HEIGHTS,
    SERIES as SERIES,
    closure as closure,
    find_jumps as find_jumps,
    fit_series as fit_series,
    heights_table as heights_table,
)
from .spatial import (
    SpatialErrors as SpatialErrors,
    place_in_cells as place_in_cells,
    torus_spectrum as torus_spectrum,
)
from .visibility import VISIBILITY as VISIBILITY, observe_visibility as observe_visibility
from .volumes import (
    IN_VOLUME as IN_VOLUME,
    STATES as STATES,
    classify_changes as classify_changes,
    estimate_retreat as estimate_retreat,
    estimate_volumes as estimate_volumes,
)
