from .gnss import gnss_page as gnss_page
from .maps import (
    draw_ends as draw_ends,
    map_extent as map_extent,
    plain_numbers as plain_numbers,
    sigma_norm as sigma_norm,
    track_gaps as track_gaps,
    track_of as track_of,
)
from .strips import strips_page as strips_page
