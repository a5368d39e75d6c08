from .ardupilot import (
    USUAL_LAG_S as USUAL_LAG_S,
    is_dataflash as is_dataflash,
    is_telemetry as is_telemetry,
    read_ardupilot as read_ardupilot,
)
from .gopro import begin_by_gps as begin_by_gps, is_gopro as is_gopro, read_gopro as read_gopro
from .loggers import (
    is_depth_table as is_depth_table,
    is_track_table as is_track_table,
    read_depth_table as read_depth_table,
    read_track_table as read_track_table,
)
from .ros import (
    BagLidar as BagLidar,
    describe_bag as describe_bag,
    is_bag as is_bag,
    mounts_of_bag as mounts_of_bag,
    packets_of_bag as packets_of_bag,
    read_bag_depths as read_bag_depths,
    read_bag_poses as read_bag_poses,
    read_bag_positions as read_bag_positions,
    streams_of_bag as streams_of_bag,
    write_bag_images as write_bag_images,
)
from .sounders import (
    is_deeper as is_deeper,
    is_lowrance as is_lowrance,
    is_matlab as is_matlab,
    is_pd0 as is_pd0,
    read_deeper as read_deeper,
    read_lowrance as read_lowrance,
    read_pd0 as read_pd0,
    read_sontek as read_sontek,
)
from .ubx import (
    RAW_OBSERVATIONS as RAW_OBSERVATIONS,
    read_ubx as read_ubx,
    ubx_frames as ubx_frames,
    ubx_share as ubx_share,
)
