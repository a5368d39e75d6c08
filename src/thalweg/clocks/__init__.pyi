from . import synchronise as synchronise, ties as ties
from .camera_offset import (
    CameraOffset as CameraOffset,
    CameraPoses as CameraPoses,
    InsAttitude as InsAttitude,
    OffsetOptions as OffsetOptions,
    camera_offset as camera_offset,
)
from .display import read_display as read_display
from .stability import clock_stability as clock_stability
from .streams import (
    Lag as Lag,
    Speeds as Speeds,
    apart_words as apart_words,
    common_span as common_span,
    ins_position_lag as ins_position_lag,
    report_lines as report_lines,
    span_text as span_text,
    stream_table as stream_table,
    time_report as time_report,
)
from .synchronise import (
    ANTENNA_TRACK as ANTENNA_TRACK,
    IMAGE_FIXES as IMAGE_FIXES,
    IMAGE_TIMES as IMAGE_TIMES,
    antenna_track as antenna_track,
    image_fixes as image_fixes,
)
from .ties import (
    TIE_COLUMNS as TIE_COLUMNS,
    ClockModel as ClockModel,
    clock_from_ties as clock_from_ties,
    read_number_columns as read_number_columns,
    read_run_image_times as read_run_image_times,
    read_text_columns as read_text_columns,
    triggered_images as triggered_images,
)
from .track import Track as Track
