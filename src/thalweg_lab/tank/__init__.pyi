from .camera_field import record_camera_field as record_camera_field
from .forward import sized as sized
from .glow import line_on as line_on, lines_of as lines_of
from .grating import (
    Grating as Grating,
    GratingErrors as GratingErrors,
    calibration_points as calibration_points,
    make_grating as make_grating,
    seen_points as seen_points,
    sub_beams as sub_beams,
)
from .motion import (
    SIGMA_MARK_MM as SIGMA_MARK_MM,
    SIGMA_PX as SIGMA_PX,
    build_panel as build_panel,
    observe as observe,
    set_up as set_up,
)
from .objects import stepped_object as stepped_object, wreck as wreck
from .plan import (
    Plan as Plan,
    calibration_plan as calibration_plan,
    panel_plan as panel_plan,
    scan_plan as scan_plan,
)
from .render import render_sheet_image as render_sheet_image
from .series import (
    WINDOW_MARKERS as WINDOW_MARKERS,
    Basin as Basin,
    record_camera_station as record_camera_station,
    record_series as record_series,
    record_strip as record_strip,
)
from .surfaces import Posed as Posed, Surface as Surface
