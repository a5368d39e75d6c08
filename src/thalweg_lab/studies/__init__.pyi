from .study import (
    Batch as Batch,
    Result as Result,
    Seed as Seed,
    Study as Study,
    Tables as Tables,
    batches as batches,
    load as load,
    read_studies as read_studies,
    run_seeds as run_seeds,
    write_results as write_results,
)
