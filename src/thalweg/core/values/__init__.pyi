from .nothing import HUGE as HUGE, NOTHING as NOTHING, WORDS as WORDS, is_nothing as is_nothing
from .places import (
    FAR_M as FAR_M,
    FORMS as FORMS,
    HIGHEST_M as HIGHEST_M,
    LOWEST_M as LOWEST_M,
    Reading as Reading,
    check_degrees as check_degrees,
    check_heights as check_heights,
    check_places as check_places,
    in_words as in_words,
    near_world as near_world,
    readings as readings,
    utm_of as utm_of,
    world_of as world_of,
)
from .stated import (
    Stated as Stated,
    crs_of_geokeys as crs_of_geokeys,
    heights_in_words as heights_in_words,
    in_metres as in_metres,
    onto_map as onto_map,
    same_heights as same_heights,
    vertical_of as vertical_of,
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
from .vectors import (
    VECTOR_ENDINGS as VECTOR_ENDINGS,
    VECTOR_FORMATS as VECTOR_FORMATS,
    Vectors as Vectors,
    describe_layers as describe_layers,
    is_vector_file as is_vector_file,
    read_vectors as read_vectors,
    vector_format as vector_format,
)
