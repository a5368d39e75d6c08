from .appearance import surface_look as surface_look
from .daylight import HAZE as HAZE, Sun as Sun, sky as sky
from .view import simulate_view as simulate_view
