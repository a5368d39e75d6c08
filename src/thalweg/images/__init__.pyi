from .control import (
    COLUMNS as COLUMNS,
    NAMES as NAMES,
    CameraPositions as CameraPositions,
    Loader as Loader,
    Measured as Measured,
    crs_of as crs_of,
    matched_marks as matched_marks,
    measure_boards as measure_boards,
    named_rows as named_rows,
    numbers as numbers,
    read_all_control_points as read_all_control_points,
    read_all_marks as read_all_marks,
    read_camera_positions as read_camera_positions,
    read_control_points as read_control_points,
    read_marks as read_marks,
    required as required,
    sigmas as sigmas,
)
from .finished import judge_points as judge_points, place_files as place_files
from .fixed_camera import resect_files as resect_files, resect_pictures as resect_pictures
from .photographs import (
    PhotographBlock as PhotographBlock,
    orient_files as orient_files,
    orient_photographs as orient_photographs,
    what_is_given as what_is_given,
)
