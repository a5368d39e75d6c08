from .appearance import surface_appearance as surface_appearance
from .daylight import HAZE as HAZE, Sun as Sun, sky as sky
