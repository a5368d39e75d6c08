from .calibration import compare_calibration as compare_calibration, compare_sensor as compare_sensor
from .change import (
    POINTS as POINTS,
    change_outlines as change_outlines,
    judge_changes as judge_changes,
    judge_differences as judge_differences,
    judge_places as judge_places,
    judge_polygons as judge_polygons,
    outlines_of as outlines_of,
    true_changes as true_changes,
    true_points as true_points,
    true_polygons as true_polygons,
    true_volumes as true_volumes,
)
from .consistency import consistency_by_range as consistency_by_range, ratio_of_surveys as ratio_of_surveys
from .points import (
    PointErrors as PointErrors,
    PointErrors3d as PointErrors3d,
    TrueReturns as TrueReturns,
    Truth as Truth,
    compare_bed as compare_bed,
    compare_cloud as compare_cloud,
    point_errors as point_errors,
    point_errors_3d as point_errors_3d,
    sample_of_known_points as sample_of_known_points,
)
from .rig import judge_colours as judge_colours
from .riverbed import (
    DISTANCES_M as DISTANCES_M,
    compare_riverbed as compare_riverbed,
    compare_soundings as compare_soundings,
    true_bed_m as true_bed_m,
)
from .solutions import (
    OWN_TIMES as OWN_TIMES,
    carried_by_camera as carried_by_camera,
    chains_truth_table as chains_truth_table,
)
