from .gnss import gnss_page as gnss_page
from .maps import (
    centre_in_words as centre_in_words,
    draw_ends as draw_ends,
    map_extent as map_extent,
    plain_numbers as plain_numbers,
    sigma_norm as sigma_norm,
    track_gaps as track_gaps,
    track_length_m as track_length_m,
    track_of as track_of,
)
from .strips import strips_page as strips_page
