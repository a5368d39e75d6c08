from .integrity import (
    Gap as Gap,
    IntegrityReport as IntegrityReport,
    find_gaps as find_gaps,
    interpolated as interpolated,
)
from .moments import stated_zone as stated_zone
from .ouster import (
    OusterReader as OusterReader,
    describe_metadata as describe_metadata,
    is_ouster_capture as is_ouster_capture,
    is_ouster_metadata as is_ouster_metadata,
)
from .readers import (
    HEAD_BYTES as HEAD_BYTES,
    Cloud as Cloud,
    CloudReader as CloudReader,
    LidarClock as LidarClock,
    LidarOptions as LidarOptions,
    LidarReader as LidarReader,
    LidarScan as LidarScan,
    LogWindow as LogWindow,
    PointBlock as PointBlock,
    PoseLog as PoseLog,
    PoseReader as PoseReader,
    PositionLog as PositionLog,
    PositionReader as PositionReader,
    TrackOptions as TrackOptions,
    empty_points as empty_points,
    pings_of as pings_of,
    read_head as read_head,
)
from .recordings import (
    PublicFile as PublicFile,
    PublicRecording as PublicRecording,
    fetch_recording as fetch_recording,
    public_recordings as public_recordings,
    recording_named as recording_named,
)
from .schemas import (
    DEPTH as DEPTH,
    GNSS_POSITION as GNSS_POSITION,
    INS_STATE as INS_STATE,
    NAVIGATION_INITIALISED as NAVIGATION_INITIALISED,
)
from .stamps import (
    FIRST_UNIX_S as FIRST_UNIX_S,
    LAST_UNIX_S as LAST_UNIX_S,
    QUARTER_HOUR_S as QUARTER_HOUR_S,
    TIME_SCALES as TIME_SCALES,
    UNITS_A_SECOND as UNITS_A_SECOND,
    StreamTiming as StreamTiming,
    doubtful_date as doubtful_date,
    explain_shift as explain_shift,
    fit_clock as fit_clock,
    gps_from_scale as gps_from_scale,
    hours_text as hours_text,
    possible_unix as possible_unix,
    tell_time_scale as tell_time_scale,
    time_contradiction as time_contradiction,
    time_scale_words as time_scale_words,
    weighted_median as weighted_median,
)
from .tables import NAMES as NAMES, Column as Column, Places as Places, Table as Table, column_of as column_of
from .text_tables import (
    read_places as read_places,
    read_text as read_text,
    read_text_table as read_text_table,
)
