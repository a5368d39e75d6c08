from .appearance import surface_look as surface_look
from .daylight import HAZE as HAZE, Sun as Sun, sky as sky
