"""Changes and the twin's scenes -> how well measured and true changes agree."""

from pathlib import Path

import pandas as pd

from thalweg.core import read_table
from thalweg.deformation import CHANGES, CORE_POINTS
from thalweg.settings.sections import Deformation
from thalweg.workflow import run_job
from thalweg_lab.river import Scene
from thalweg_lab.truth import judge_changes


def main(
    *,
    changes: Path,
    core_points: Path,
    volumes: Path,
    scenes: list[Path],
    measures: Path,
    cores: Path,
    deformation: Deformation,
) -> None:
    before, after = (Scene.read(path) for path in scenes)
    table, by_core = judge_changes(
        read_table(changes, CHANGES)[0],
        read_table(core_points, CORE_POINTS)[0],
        pd.read_csv(volumes),
        before,
        after,
        radius_m=deformation.cylinder_radius_m,
        reach_m=deformation.reach_m,
    )
    table.to_csv(measures, index=False)
    by_core.to_parquet(cores, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
