from .photographs import orientation_page as orientation_page
