"""Cloud and reference mesh -> distances, statistics, range classes, local dependency, registration."""

import json
from pathlib import Path
from typing import Any

from thalweg.accuracy.cloud_to_mesh.comparison import CLOUD_TO_MESH, ComparisonSettings
from thalweg.accuracy.cloud_to_mesh.overlap_check import check_frames
from thalweg.accuracy.cloud_to_mesh.reference_comparison import compare_with_reference
from thalweg.core.geometry.mesh_ply import read_mesh
from thalweg.core.tables import write_table
from thalweg.surface.area import Area
from thalweg.workflow.job import run_job


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
    campaign: dict[str, Any],
    accuracy: dict[str, Any],
    reference: dict[str, Any],
) -> None:
    surface, mesh_frame, _ = read_mesh(mesh)
    frame = check_frames(points, mesh, mesh_frame)
    found = compare_with_reference(
        points,
        surface,
        area=Area.from_section(accuracy["area"], frame, campaign["crs"]),
        settings=ComparisonSettings.from_sections(
            accuracy,
            reference,
            campaign["seed"],
            estimated_correlation_s=json.loads(error_model.read_text())["correlation_s"],
        ),
        registration=accuracy["registration"],
    )
    write_table(cloud_to_mesh, found.table, CLOUD_TO_MESH, found.facts)
    found.statistics.to_csv(statistics, index=False)
    found.by_range.to_csv(by_range, index=False)
    found.spatial.to_csv(spatial, index=False)
    registration.write_text(json.dumps(found.registration, indent=2) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
