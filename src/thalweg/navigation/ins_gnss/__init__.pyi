from .error_model import (
    BEAM as BEAM,
    BEAM_SPREAD as BEAM_SPREAD,
    NAMES as NAMES,
    ErrorModel as ErrorModel,
    Estimate as Estimate,
    PoseCorrelation as PoseCorrelation,
    PriorErrors as PriorErrors,
    beam_factors as beam_factors,
    typical_sigmas as typical_sigmas,
)
from .interpolation import JITTER_S as JITTER_S
from .trajectory import (
    ATTITUDE_INITIALISED as ATTITUDE_INITIALISED,
    TrajectorySummary as TrajectorySummary,
    agree_with_ins as agree_with_ins,
    break_at_gaps as break_at_gaps,
    build_trajectory as build_trajectory,
    check_origin as check_origin,
    states_along_course as states_along_course,
    trajectory_from_states as trajectory_from_states,
    usable_positions as usable_positions,
    usable_states as usable_states,
    with_stated as with_stated,
)
