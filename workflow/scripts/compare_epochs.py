"""Two registered epochs -> distances with sigma, states, patches of change, volumes."""

from pathlib import Path

from thalweg.core import LocalFrame, read_table, write_json, write_table
from thalweg.deformation import (
    CHANGES,
    CORE_POINTS,
    DRAWS,
    VISIBILITY,
    YEAR_S,
    classify_changes,
    compare_epochs,
    draw_errors,
    estimate_retreat,
    estimate_volumes,
    highest_water_m,
    observe_visibility,
    read_registration,
)
from thalweg.deformation.foreign import notes_of_pair, read_epoch, write_changes
from thalweg.settings.sections import Deformation
from thalweg.workflow import run_job


def main(
    *,
    epochs: list[Path],
    core_points: Path,
    registration: Path,
    weights: Path,
    visibility: Path,
    changes: Path,
    draws: Path,
    cloud: Path,
    patches: Path,
    volumes: Path,
    along: Path,
    retreat: Path,
    facts: Path,
    frame: LocalFrame,
    seed: int,
    deformation: Deformation,
) -> None:
    before, after = (read_epoch(path.parent) for path in epochs)
    cores = read_table(core_points, CORE_POINTS)[0]
    moved = read_registration(registration, weights)
    table, compared, found = compare_epochs(cores, before, after, moved, deformation, seed)
    places = compared.pair.found
    seen = observe_visibility(places.cores_m, places.normals, places.n, (before, after), deformation)
    write_table(visibility, seen, VISIBILITY)
    table, connected = classify_changes(table, compared, seen, deformation)
    write_table(changes, table, CHANGES)
    write_table(draws, draw_errors(compared, seed), DRAWS)
    write_changes(cloud, table, frame)
    connected.to_csv(patches, index=False)
    sums, by_stretch = estimate_volumes(table, compared, deformation, seed)
    sums.to_csv(volumes, index=False)
    by_stretch.to_csv(along, index=False)
    moved_lines = estimate_retreat(
        table,
        compared,
        deformation,
        water_m=highest_water_m((before, after)),
        years=(after.start_gps_s - before.start_gps_s) / YEAR_S,
    )
    moved_lines.to_csv(retreat, index=False)
    found |= {"notes": notes_of_pair(before, after, places.n, moved.facts)}
    write_json(facts, found)


if "snakemake" in globals():
    run_job(main, snakemake)
