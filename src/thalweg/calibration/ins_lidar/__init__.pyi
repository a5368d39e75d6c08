from . import file as file
from .adjustment import (
    START as START,
    InsLidarSettings as InsLidarSettings,
    RunGates as RunGates,
    calibrate as calibrate,
)
from .antenna import AntennaLever as AntennaLever
from .file import read_mount_result as read_mount_result
from .model import AntennaPoint as AntennaPoint
from .pose_errors import (
    BorderedNormals as BorderedNormals,
    Knots as Knots,
    PoseErrors as PoseErrors,
    pose_rows as pose_rows,
)
from .run_points import (
    FieldCones as FieldCones,
    MountRange as MountRange,
    NearCones as NearCones,
    RunPoints as RunPoints,
)
