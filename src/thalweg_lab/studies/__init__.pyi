from . import laser_lines as laser_lines
from .laser_lines import (
    labelled_scans as labelled_scans,
    multi_line_images as multi_line_images,
    write_images as write_images,
)
from .study import (
    Batch as Batch,
    batches as batches,
    load as load,
    run_seeds as run_seeds,
    write_results as write_results,
)
