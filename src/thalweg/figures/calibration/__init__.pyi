from .field import Oblique as Oblique
from .page import TWIN_NOTE as TWIN_NOTE, calibration_page as calibration_page, with_units as with_units
