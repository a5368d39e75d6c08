from . import input as input
from .adjustment import (
    CameraLidar as CameraLidar,
    CameraLidarSettings as CameraLidarSettings,
    calibrate_camera_lidar as calibrate_camera_lidar,
    foreign_markers as foreign_markers,
)
from .files import ResultFiles as ResultFiles, write_camera_lidar as write_camera_lidar
from .input import (
    CAPTURES as CAPTURES,
    Statics as Statics,
    cone_references as cone_references,
    nominal_orientation as nominal_orientation,
    read_statics as read_statics,
    static_images as static_images,
    statics_of as statics_of,
    write_statics as write_statics,
)
from .model import ORIENTATION as ORIENTATION, FieldErrors as FieldErrors
