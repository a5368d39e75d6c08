from .cloud import CAPTIONS as CAPTIONS, cloud_page as cloud_page, distances_in_plan as distances_in_plan
from .distance_map import DISTANCE_MAP as DISTANCE_MAP
from .distances import (
    centimetres as centimetres,
    compared as compared,
    distance_histogram as distance_histogram,
    outlier_rule as outlier_rule,
    round_above as round_above,
    round_limit_m as round_limit_m,
)
from .page import accuracy_page as accuracy_page
