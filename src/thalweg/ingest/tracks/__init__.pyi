from .bed_survey import read_bed_survey as read_bed_survey
from .rtklib_pos import event_marks as event_marks, read_pos as read_pos
from .sbet import read_sbet as read_sbet
from .trajectories import (
    BODY_AXES as BODY_AXES,
    TextPoses as TextPoses,
    is_inertial_explorer as is_inertial_explorer,
    pose_columns as pose_columns,
    read_gpx as read_gpx,
    read_inertial_explorer as read_inertial_explorer,
    read_text_poses as read_text_poses,
    states_of_poses as states_of_poses,
)
