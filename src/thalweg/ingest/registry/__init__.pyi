from .calibrations import (
    CalibrationReport as CalibrationReport,
    largest_correlations as largest_correlations,
    with_sigma as with_sigma,
)
from .formats import (
    ALSO_MARKS as ALSO_MARKS,
    KINDS as KINDS,
    KINDS_OF_STREAM as KINDS_OF_STREAM,
    LIDAR_KINDS as LIDAR_KINDS,
    LOOSE_KINDS as LOOSE_KINDS,
    TABLE_KINDS as TABLE_KINDS,
    also_streams as also_streams,
    describe as describe,
    load_recording as load_recording,
    recognise as recognise,
    stream_of as stream_of,
    topics_to_choose as topics_to_choose,
    what_it_is_for as what_it_is_for,
)
from .lidar import lidar_reader as lidar_reader, mounts_of_bag as mounts_of_bag
from .poses import read_poses as read_poses
from .positions import (
    choose_tracks as choose_tracks,
    read_depths as read_depths,
    read_positions as read_positions,
    read_receiver as read_receiver,
    soundings_table as soundings_table,
)
