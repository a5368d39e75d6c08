from .accuracy import Accuracy as Accuracy, Area as Area, ReferenceSettings as ReferenceSettings
from .base import (
    LOCAL as LOCAL,
    Angle as Angle,
    Count as Count,
    Finite as Finite,
    NonNegative as NonNegative,
    Odd as Odd,
    Positive as Positive,
    Section as Section,
    Share as Share,
    Sigma3 as Sigma3,
    Vector3 as Vector3,
)
from .bathymetry import Bathymetry as Bathymetry, EchoSounder as EchoSounder
from .calibration import (
    Board as Board,
    Calibration as Calibration,
    CameraClock as CameraClock,
    CameraLidarFit as CameraLidarFit,
    DisplayTest as DisplayTest,
    EchoSounderFit as EchoSounderFit,
    InsLidarFit as InsLidarFit,
    RunErrors as RunErrors,
)
from .deformation import (
    CLOUD_ENDINGS as CLOUD_ENDINGS,
    DSM_ENDINGS as DSM_ENDINGS,
    TEXT_ENDINGS as TEXT_ENDINGS,
    Classes as Classes,
    Deformation as Deformation,
    Epoch as Epoch,
    EpochErrors as EpochErrors,
    Visibility as Visibility,
)
from .fusion import (
    CloudFit as CloudFit,
    Fusion as Fusion,
    GroundFilter as GroundFilter,
    MeshSettings as MeshSettings,
    SectionSettings as SectionSettings,
    Vertical as Vertical,
)
from .images import (
    IMAGES_OF_JOB as IMAGES_OF_JOB,
    LARGE_BLOCK as LARGE_BLOCK,
    MOST_JOBS as MOST_JOBS,
    BlockAdjustment as BlockAdjustment,
    CameraCloud as CameraCloud,
    ControlSettings as ControlSettings,
    FeatureSettings as FeatureSettings,
    FinishedOrientations as FinishedOrientations,
    FixedCamera as FixedCamera,
    Images as Images,
    MappingSettings as MappingSettings,
    MaskSettings as MaskSettings,
    Panorama as Panorama,
    Rig as Rig,
    RigLens as RigLens,
    StatedClock as StatedClock,
)
from .lidar import (
    WEAK_RANGE_M as WEAK_RANGE_M,
    WEAK_REFLECTIVITY as WEAK_REFLECTIVITY,
    Colour as Colour,
    Figures as Figures,
    Filters as Filters,
    Georeferencing as Georeferencing,
    Lidar as Lidar,
    LidarAccuracy as LidarAccuracy,
    LidarClockStated as LidarClockStated,
    Scatter as Scatter,
    Strips as Strips,
)
from .light_sheet import (
    SCAN_PARTS as SCAN_PARTS,
    SERIES as SERIES,
    SHARED_PARTS as SHARED_PARTS,
    LightSheet as LightSheet,
    SheetCalibration as SheetCalibration,
    SheetLines as SheetLines,
    SheetWater as SheetWater,
    scan_stream as scan_stream,
)
from .logs import (
    STREAM_KEYS as STREAM_KEYS,
    CalibrationLogs as CalibrationLogs,
    FixedCameraLogs as FixedCameraLogs,
    GnssLogs as GnssLogs,
    LightSheetLogs as LightSheetLogs,
    Logs as Logs,
    is_rinex_name as is_rinex_name,
)
from .mounts import (
    Mounts as Mounts,
    OrientedMount as OrientedMount,
    is_calibration_path as is_calibration_path,
)
from .navigation import Fused as Fused, Ins as Ins, Orientation as Orientation, Ppk as Ppk
