"""Cloud and reference mesh -> distances, statistics, range classes, local dependency, registration."""

from pathlib import Path

from thalweg.accuracy import CLOUD_TO_MESH, ComparisonSettings, check_frames, compare_with_reference
from thalweg.core import read_json, write_json, write_table
from thalweg.core.geometry import read_mesh
from thalweg.settings.sections import Accuracy, ReferenceSettings
from thalweg.surface import Area
from thalweg.workflow import run_job


def main(
    *,
    points: Path,
    mesh: Path,
    error_model: Path,
    cloud_to_mesh: Path,
    statistics: Path,
    by_range: Path,
    spatial: Path,
    registration: Path,
    crs: str,
    seed: int,
    accuracy: Accuracy,
    reference: ReferenceSettings,
) -> None:
    surface, mesh_frame, _ = read_mesh(mesh)
    frame = check_frames(points, mesh, mesh_frame)
    found = compare_with_reference(
        points,
        surface,
        area=Area.from_section(accuracy.area, frame, crs),
        settings=ComparisonSettings.of(
            accuracy, reference, seed, estimated_correlation_s=read_json(error_model)["correlation_s"]
        ),
        registration=accuracy.registration,
    )
    write_table(cloud_to_mesh, found.table, CLOUD_TO_MESH, found.facts)
    found.statistics.to_csv(statistics, index=False)
    found.by_range.to_csv(by_range, index=False)
    found.spatial.to_csv(spatial, index=False)
    write_json(registration, found.registration)


if "snakemake" in globals():
    run_job(main, snakemake)
