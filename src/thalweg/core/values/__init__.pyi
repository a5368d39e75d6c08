from .nothing import NOTHING as NOTHING, WORDS as WORDS, is_nothing as is_nothing
from .places import (
    FORMS as FORMS,
    check_degrees as check_degrees,
    check_heights as check_heights,
    check_places as check_places,
    in_words as in_words,
    near_world as near_world,
    readings as readings,
    utm_of as utm_of,
    world_of as world_of,
)
from .units import (
    FATHOM as FATHOM,
    FOOT as FOOT,
    METRE as METRE,
    US_SURVEY_FOOT as US_SURVEY_FOOT,
    Unit as Unit,
    unit_of_code as unit_of_code,
    unit_of_letter as unit_of_letter,
    unit_of_word as unit_of_word,
    units_of_crs as units_of_crs,
)
