from .laser_lines import (
    labelled_scans as labelled_scans,
    multi_line_images as multi_line_images,
    write_images as write_images,
)
