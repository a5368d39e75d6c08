from . import echo_sounder as echo_sounder
from .boards import (
    BoardSettings as BoardSettings,
    Checkerboard as Checkerboard,
    board_calibration as board_calibration,
    calibrate_board as calibrate_board,
    find_corners as find_corners,
    pose_table as pose_table,
    read_board_poses as read_board_poses,
)
from .boat import (
    EchoPlace as EchoPlace,
    assemble as assemble,
    read_mounts as read_mounts,
    resolve_mounts as resolve_mounts,
    write_mounts as write_mounts,
)
from .camera import (
    network_pose_table as network_pose_table,
    orient_on_field as orient_on_field,
    read_poses as read_poses,
    starting_boat_camera as starting_boat_camera,
    write_poses as write_poses,
)
from .camera_files import (
    LENS_SIGMA as LENS_SIGMA,
    SUFFIX as SUFFIX,
    camera_of as camera_of,
    free_of_lens as free_of_lens,
    guessed_lens as guessed_lens,
    interior_calibration as interior_calibration,
    nominal_camera as nominal_camera,
    read_camera as read_camera,
    same_size as same_size,
    starting_camera_by as starting_camera_by,
)
from .collinearity import collinear as collinear
from .cone_search import (
    AGAIN as AGAIN,
    WORDS as WORDS,
    ConeScan as ConeScan,
    Position as Position,
    Selection as Selection,
    SelectionLimits as SelectionLimits,
    Verdict as Verdict,
    beside_its_place as beside_its_place,
    fit_of as fit_of,
    nowhere as nowhere,
    search as search,
    select as select,
    without_support as without_support,
)
from .cones import (
    FORM_SIGMA_M as FORM_SIGMA_M,
    PARAMETERS as PARAMETERS,
    Cone as Cone,
    ConeFit as ConeFit,
    ConePoints as ConePoints,
    ConeReference as ConeReference,
    fit_reference as fit_reference,
    parameter_cov as parameter_cov,
)
from .echo_sounder import (
    Bed as Bed,
    EchoSettings as EchoSettings,
    estimate_echo_sounder as estimate_echo_sounder,
)
from .fixed_camera import Interior as Interior, resect_series as resect_series, starting_lens as starting_lens
from .lens import (
    LensCalibration as LensCalibration,
    calibrate_lens as calibrate_lens,
    corners_of_pictures as corners_of_pictures,
    lens_calibration_file as lens_calibration_file,
    read_corners as read_corners,
)
from .marker_sheets import (
    MARGIN_MODULES as MARGIN_MODULES,
    SADDLES_MODULES as SADDLES_MODULES,
    SHEET_MODULES as SHEET_MODULES,
    MarkerLayout as MarkerLayout,
    mark_name as mark_name,
    parse_mark as parse_mark,
    sheet_picture as sheet_picture,
    write_sheets as write_sheets,
)
from .markers import (
    MARKS as MARKS,
    Block as Block,
    block_of as block_of,
    detect_pictures as detect_pictures,
    fit_saddles as fit_saddles,
    recordings_folder as recordings_folder,
    report_of as report_of,
    sheet_centres as sheet_centres,
)
from .rig import (
    LENSES as LENSES,
    Rig as Rig,
    RigCalibration as RigCalibration,
    calibrate_rig as calibrate_rig,
    check_rig as check_rig,
    detect_rig_marks as detect_rig_marks,
    lens_view as lens_view,
    read_rig as read_rig,
    read_rig_masks as read_rig_masks,
    read_views as read_views,
    remeasure_rig_marks as remeasure_rig_marks,
    rig_calibration_file as rig_calibration_file,
    rig_of as rig_of,
    view_size_px as view_size_px,
)
from .target_search import Found as Found, SearchRange as SearchRange
