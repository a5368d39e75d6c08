from .distance_map import DISTANCE_MAP as DISTANCE_MAP
from .distances import (
    centimetres as centimetres,
    compared as compared,
    round_above as round_above,
    round_limit_m as round_limit_m,
)
from .page import accuracy_page as accuracy_page
