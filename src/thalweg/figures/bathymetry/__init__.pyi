from .page import bed_page as bed_page
from .pictures import table_bed_map as table_bed_map
