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
    cloud_to_cloud as cloud_to_cloud,
)
from .core_points import CORE_POINTS as CORE_POINTS, place_core_points as place_core_points
from .coregistration import (
    Registration as Registration,
    read_registration as read_registration,
    write_registration as write_registration,
)
from .differences import (
    difference_of_epochs as difference_of_epochs,
    difference_of_models as difference_of_models,
)
from .epochs import (
    Epoch as Epoch,
    check_order as check_order,
    highest_water_m as highest_water_m,
    prepare_epoch as prepare_epoch,
)
from .field import ErrorField as ErrorField, benjamini_hochberg as benjamini_hochberg
from .foreign import (
    DISTANCES as DISTANCES,
    TEXT as TEXT,
    compare_clouds as compare_clouds,
    compare_files as compare_files,
    compare_nearest as compare_nearest,
    compare_with_surface as compare_with_surface,
    point_spacing_m as point_spacing_m,
    read_points as read_points,
    sigma_of_mean as sigma_of_mean,
    write_changes as write_changes,
)
from .foreign_epochs import (
    ForeignEpoch as ForeignEpoch,
    check_epoch_files as check_epoch_files,
    notes_of_pair as notes_of_pair,
    place_of_file as place_of_file,
    prepare_foreign_epoch as prepare_foreign_epoch,
    read_epoch as read_epoch,
)
from .series import (
    HEIGHTS as HEIGHTS,
    SERIES as SERIES,
    closure as closure,
    find_jumps as find_jumps,
    fit_series as fit_series,
    heights_table as heights_table,
)
from .surfaces import (
    Dsm as Dsm,
    HeightErrors as HeightErrors,
    Shapes as Shapes,
    SurfaceDifference as SurfaceDifference,
    difference_of_surfaces as difference_of_surfaces,
    difference_on_lines as difference_on_lines,
    onto_grid as onto_grid,
    read_difference as read_difference,
    read_dsm as read_dsm,
    read_shapes as read_shapes,
    write_difference as write_difference,
)
from .visibility import VISIBILITY as VISIBILITY, observe_visibility as observe_visibility
from .volumes import (
    STATES as STATES,
    classify_changes as classify_changes,
    estimate_retreat as estimate_retreat,
    estimate_volumes as estimate_volumes,
)
