from . import panels as panels, sources as sources
from .poses import (
    M_PER_MM as M_PER_MM,
    SensorPoses as SensorPoses,
    by_pose as by_pose,
    factor as factor,
    pose_table as pose_table,
    read_poses as read_poses,
    write_poses as write_poses,
)
from .series import (
    SERIES_POINTS as SERIES_POINTS,
    detect_series as detect_series,
    read_sheet_image as read_sheet_image,
    require_levels as require_levels,
    require_one_image as require_one_image,
)
from .sources import (
    panel_poses as panel_poses,
    read_panel as read_panel,
    read_standing_camera as read_standing_camera,
    sigmas_at as sigmas_at,
    trajectory_poses as trajectory_poses,
)
