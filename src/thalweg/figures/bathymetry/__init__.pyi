from .page import bed_page as bed_page
from .pictures import (
    draw_bed_map as draw_bed_map,
    draw_bed_sections as draw_bed_sections,
    draw_left_out as draw_left_out,
    draw_sounding_errors as draw_sounding_errors,
    draw_soundings as draw_soundings,
    draw_variogram as draw_variogram,
)
from .terrain import draw_long_profile as draw_long_profile, draw_terrain_model as draw_terrain_model
