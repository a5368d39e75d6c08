from .banks import (
    SIDES as SIDES,
    Banks as Banks,
    bank_observations as bank_observations,
    flow_of_survey as flow_of_survey,
    read_banks as read_banks,
    shore_points as shore_points,
)
from .bed import (
    BANDS as BANDS,
    OBSERVATIONS as OBSERVATIONS,
    Bed as Bed,
    bed_observations as bed_observations,
    error_lengths as error_lengths,
    krige_bed as krige_bed,
    observations_of as observations_of,
)
from .crossings import (
    Agreement as Agreement,
    Crossings as Crossings,
    agreement as agreement,
    estimate_slow_errors as estimate_slow_errors,
    find_crossings as find_crossings,
)
from .flow import FlowLine as FlowLine
from .kriging import (
    CovarianceModel as CovarianceModel,
    Observations as Observations,
    krige as krige,
    krige_by_pykrige as krige_by_pykrige,
    krige_dense as krige_dense,
)
from .lake import Levels as Levels, Plane as Plane
from .plan import PATTERNS as PATTERNS, SurveyPlan as SurveyPlan, course as course, plan_survey as plan_survey
from .soundings import (
    REASONS as REASONS,
    S44 as S44,
    SOUNDINGS as SOUNDINGS,
    Sound as Sound,
    Transducer as Transducer,
    axis_range_m as axis_range_m,
    locate_soundings as locate_soundings,
    s44_orders as s44_orders,
    soundings_on_map as soundings_on_map,
    speed_of_sound_mps as speed_of_sound_mps,
    with_bed_normals as with_bed_normals,
)
from .tables import (
    BedOfTable as BedOfTable,
    TableOfSoundings as TableOfSoundings,
    Water as Water,
    against_reference as against_reference,
    bed_of_table as bed_of_table,
    map_crs as map_crs,
    read_bank_lines as read_bank_lines,
    read_islands as read_islands,
    read_line as read_line,
    read_other_soundings as read_other_soundings,
    read_soundings as read_soundings,
    usual_cell_m as usual_cell_m,
    water_of as water_of,
)
from .through_water import correct_refraction as correct_refraction, read_columns as read_columns
from .validation import measures as measures, methods as methods, validate_bed as validate_bed
from .variogram import (
    DRIFTS as DRIFTS,
    Across as Across,
    BedModel as BedModel,
    Drift as Drift,
    choose_model as choose_model,
)
from .water import WaterLevel as WaterLevel, level_water as level_water
