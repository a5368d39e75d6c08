from .lines import departures_px as departures_px, measured as measured
from .page import light_sheet_page as light_sheet_page, read_scans as read_scans, strip_page as strip_page
from .views import first_image as first_image
