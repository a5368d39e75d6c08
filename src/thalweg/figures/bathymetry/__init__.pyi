from .page import bed_page as bed_page
from .pictures import draw_bed_of_table as draw_bed_of_table
