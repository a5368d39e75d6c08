from .page import bed_page as bed_page
from .pictures import bed_picture as bed_picture, depth_of as depth_of
