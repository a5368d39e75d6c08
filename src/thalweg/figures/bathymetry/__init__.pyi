from .page import bed_page as bed_page
