from .page import bed_page as bed_page
from .pictures import picture_of_bed as picture_of_bed
