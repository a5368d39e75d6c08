"""Changes and the twin's scenes -> how well measured and true changes agree."""

from pathlib import Path

import pandas as pd

from thalweg.core import LocalFrame, read_table
from thalweg.deformation import CHANGES, CORE_POINTS, DRAWS
from thalweg.deformation.foreign import read_difference
from thalweg.settings.sections import Deformation
from thalweg.workflow import run_job
from thalweg_lab.river import Scene
from thalweg_lab.truth import POINTS, judge_changes, judge_differences, judge_places, judge_polygons


def main(
    *,
    changes: Path,
    core_points: Path,
    volumes: Path,
    draws: Path,
    difference: Path,
    places: Path,
    polygons: Path,
    scenes: list[Path],
    measures: Path,
    cores: Path,
    by_polygon: Path,
    frame: LocalFrame,
    deformation: Deformation,
) -> None:
    before, after = (Scene.read(path) for path in scenes)
    measured, taken = read_table(changes, CHANGES)[0], read_table(core_points, CORE_POINTS)[0]
    table, by_core = judge_changes(
        measured,
        taken,
        pd.read_csv(volumes),
        before,
        after,
        radius_m=deformation.cylinder_radius_m,
        reach_m=deformation.reach_m,
    )
    more = judge_places(measured, read_table(places, POINTS)[0], deformation.core_spacing_m)
    more += judge_differences(read_difference(difference), before, after, frame, reach_m=deformation.reach_m)
    table = pd.concat([table, pd.DataFrame(more, columns=table.columns)])
    table.to_csv(measures, index=False)
    found = judge_polygons(
        measured,
        taken,
        read_table(draws, DRAWS)[0],
        by_core["true_distance_m"].to_numpy(),
        pd.read_csv(polygons),
    )
    found.to_csv(by_polygon, index=False)
    by_core.to_parquet(cores, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
