from .first_look import (
    first_looks_of as first_looks_of,
    recordings_page as recordings_page,
    recordings_table as recordings_table,
)
