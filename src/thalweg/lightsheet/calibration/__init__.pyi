from . import report as report
from .calibrate_sheet import calibrate_sheet as calibrate_sheet
from .camera_over_window import orient_camera as orient_camera, read_camera_marks as read_camera_marks
from .grid import GridObject as GridObject, parse_grid as parse_grid, read_grid as read_grid
from .lens import (
    NAME as NAME,
    calibrate_lens as calibrate_lens,
    lens_report as lens_report,
    read_lens_marks as read_lens_marks,
    with_lens as with_lens,
)
from .rank import SINGULAR as SINGULAR
from .settings import CalibrationSettings as CalibrationSettings
from .sheet_calibration import fit_sheet as fit_sheet
