from .field import Oblique as Oblique, fit_axes as fit_axes
from .page import TWIN_NOTE as TWIN_NOTE, calibration_page as calibration_page, with_units as with_units
from .tables import points_of as points_of
