from .lines import departures_px as departures_px, measured as measured
from .page import light_sheet_page as light_sheet_page, read_scans as read_scans, strip_page as strip_page
from .scan_reference import mesh_picture as mesh_picture
from .views import (
    GLASS_COLOUR as GLASS_COLOUR,
    LIGHT_COLOUR as LIGHT_COLOUR,
    WATER_COLOUR as WATER_COLOUR,
    Look as Look,
    Space as Space,
    dots as dots,
    first_image as first_image,
    green_of as green_of,
    need as need,
    pair as pair,
    path_to as path_to,
    show_green as show_green,
    spots as spots,
)
