from .control import (
    COLUMNS as COLUMNS,
    LOCAL as LOCAL,
    Loader as Loader,
    Measured as Measured,
    matched_marks as matched_marks,
    measure_boards as measure_boards,
    read_all_control_points as read_all_control_points,
    read_control_points as read_control_points,
    read_marks as read_marks,
)
from .photographs import PhotographBlock as PhotographBlock, orient_photographs as orient_photographs
