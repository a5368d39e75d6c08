from .clock import (
    clock_by_hand as clock_by_hand,
    clock_from_motion as clock_from_motion,
    clock_from_sentences as clock_from_sentences,
    with_stated_clock as with_stated_clock,
)
from .cloud import (
    CORRELATION_DIMENSIONS as CORRELATION_DIMENSIONS,
    CORRELATIONS as CORRELATIONS,
    EXTRA_DIMENSIONS as EXTRA_DIMENSIONS,
    REMOVED_POINTS as REMOVED_POINTS,
    SIGMAS as SIGMAS,
    LogSample as LogSample,
    LogSettings as LogSettings,
    cloud_covariance as cloud_covariance,
    export_map as export_map,
    georeference_log as georeference_log,
    georeference_window as georeference_window,
    join_windows as join_windows,
    sample_cloud as sample_cloud,
    write_density as write_density,
)
from .colour import (
    COLOUR_DIMENSIONS as COLOUR_DIMENSIONS,
    GAMMA as GAMMA,
    UNSEEN_GREY as UNSEEN_GREY,
    Coloured as Coloured,
    NoColour as NoColour,
    Photographs as Photographs,
    colour_cloud as colour_cloud,
    exposure_gains as exposure_gains,
)
from .colour_check import check_colours as check_colours
from .copc import export_copc as export_copc
from .filters import (
    MOST_COUNTED as MOST_COUNTED,
    REMOVED as REMOVED,
    WORDS as WORDS,
    Occupancy as Occupancy,
    Reason as Reason,
)
from .georeference import georeference_points as georeference_points
from .overlap import (
    CELL_M as CELL_M,
    error_model_of_log as error_model_of_log,
    estimate_pose_errors as estimate_pose_errors,
    windows_of as windows_of,
)
from .strips import (
    LEAST_TOLD as LEAST_TOLD,
    POSE as POSE,
    Adjusted as Adjusted,
    adjust_strips as adjust_strips,
    mounts_by_strips as mounts_by_strips,
    read_stable as read_stable,
    thin_log as thin_log,
)
