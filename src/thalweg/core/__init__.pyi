from .adjustment import (
    RANK_TOLERANCE as RANK_TOLERANCE,
    Adjusted as Adjusted,
    Linear as Linear,
    Observations as Observations,
    UnobservableError as UnobservableError,
    adjust as adjust,
    check_rank as check_rank,
    damped_step as damped_step,
    normal_equations as normal_equations,
    prior as prior,
    scaled_rows as scaled_rows,
    whitened as whitened,
)
from .camera import (
    COLMAP_MODELS as COLMAP_MODELS,
    PARAMETERS as PARAMETERS,
    Camera as Camera,
    Model as Model,
    from_metashape as from_metashape,
    read_colmap as read_colmap,
    read_metashape as read_metashape,
    read_opencv as read_opencv,
    write_colmap as write_colmap,
    write_opencv as write_opencv,
)
from .documents import (
    Document as Document,
    Key as Key,
    Mistake as Mistake,
    Name as Name,
    Part as Part,
    Text as Text,
    checked as checked,
    did_you_mean as did_you_mean,
    one_of as one_of,
    parse_yaml as parse_yaml,
    read_mapping as read_mapping,
    read_yaml as read_yaml,
    refuse as refuse,
    validated as validated,
    wrong as wrong,
)
from .errors import (
    ClockError as ClockError,
    ConfigError as ConfigError,
    CoverageError as CoverageError,
    GeometryError as GeometryError,
    InputError as InputError,
    ThalwegError as ThalwegError,
    UnsupportedError as UnsupportedError,
    file_trouble as file_trouble,
)
from .files import (
    UNFINISHED as UNFINISHED,
    decode_picture as decode_picture,
    final_path as final_path,
    parse_xml as parse_xml,
)
from .frames import (
    GRS80_SEMI_MAJOR_M as GRS80_SEMI_MAJOR_M,
    R_ENU_NED as R_ENU_NED,
    LocalFrame as LocalFrame,
    attitude_axes as attitude_axes,
    opk_axes as opk_axes,
    roll_pitch_heading as roll_pitch_heading,
    rotation_ecef_enu as rotation_ecef_enu,
    rotation_enu_body as rotation_enu_body,
    rotation_opk as rotation_opk,
    rotation_x as rotation_x,
    rotation_y as rotation_y,
    rotation_z as rotation_z,
)
from .kernels import (
    get_num_threads as get_num_threads,
    njit as njit,
    prange as prange,
    set_num_threads as set_num_threads,
)
from .las import (
    VLR_RECORD as VLR_RECORD,
    VLR_USER as VLR_USER,
    ExtraDimension as ExtraDimension,
    Frame as Frame,
    LazHeader as LazHeader,
    LazWriter as LazWriter,
    frame_json as frame_json,
    frame_wkt as frame_wkt,
    iter_laz as iter_laz,
    laz_header as laz_header,
    laz_layout as laz_layout,
    library_errors as library_errors,
    local_crs as local_crs,
    whole_chunks as whole_chunks,
)
from .pose_errors import (
    ErrorChain as ErrorChain,
    even_time as even_time,
    read_chains as read_chains,
    symmetric_roots as symmetric_roots,
    with_rest as with_rest,
    write_chains as write_chains,
)
from .progress import steps as steps, to_terminal as to_terminal
from .raster import Grid as Grid, read_raster as read_raster, write_raster as write_raster
from .rigid import (
    SHIFT as SHIFT,
    TURN as TURN,
    Chain as Chain,
    Link as Link,
    Rigid as Rigid,
    beam_axes as beam_axes,
    chain_derivatives as chain_derivatives,
    cross_matrix as cross_matrix,
    exp_rotation as exp_rotation,
    opk_of as opk_of,
    plane_rates as plane_rates,
    propagated as propagated,
    rotation_vector as rotation_vector,
)
from .statistics import NMAD as NMAD, robust_sigma as robust_sigma, root_mean_square as root_mean_square
from .tables import (
    column as column,
    frame_of as frame_of,
    read_marked as read_marked,
    read_parquet as read_parquet,
    read_table as read_table,
    table_kind as table_kind,
    write_marked as write_marked,
    write_table as write_table,
)
from .timescales import (
    ADJUSTED_OFFSET_S as ADJUSTED_OFFSET_S,
    DAY_S as DAY_S,
    GPS_EPOCH_UNIX_S as GPS_EPOCH_UNIX_S,
    LEAP_TABLE as LEAP_TABLE,
    LEAP_TABLE_VALID_UNTIL as LEAP_TABLE_VALID_UNTIL,
    WEEK_S as WEEK_S,
    gps_from_unix as gps_from_unix,
    gps_from_week as gps_from_week,
    gps_minus_utc as gps_minus_utc,
    unix_from_gps as unix_from_gps,
    utc_text_from_gps as utc_text_from_gps,
    utc_text_from_unix as utc_text_from_unix,
)
from .trajectory import Trajectory as Trajectory
from .types import (
    AnyArray as AnyArray,
    ArrayB as ArrayB,
    ArrayF as ArrayF,
    ArrayF32 as ArrayF32,
    ArrayI as ArrayI,
    ArrayU8 as ArrayU8,
)
