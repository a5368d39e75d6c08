from .coloured import colour_check as colour_check
from .from_above import from_above as from_above
from .overview import cloud_overview as cloud_overview
from .views import Splat as Splat, choose_segment as choose_segment
