"""Cloud and reference mesh -> distances, statistics, range classes, local dependency, registration."""

import json
from pathlib import Path
from typing import Any

from thalweg.accuracy import CLOUD_TO_MESH, ComparisonSettings, check_frames, compare_with_reference
from thalweg.core import write_table
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
    campaign: dict[str, Any],
    accuracy: Accuracy,
    reference: ReferenceSettings,
) -> None:
    surface, mesh_frame, _ = read_mesh(mesh)
    frame = check_frames(points, mesh, mesh_frame)
    found = compare_with_reference(
        points,
        surface,
        area=Area.from_section(accuracy.area, frame, campaign["crs"]),
        settings=ComparisonSettings.of(
            accuracy,
            reference,
            campaign["seed"],
            estimated_correlation_s=json.loads(error_model.read_text())["correlation_s"],
        ),
        registration=accuracy.registration,
    )
    write_table(cloud_to_mesh, found.table, CLOUD_TO_MESH, found.facts)
    found.statistics.to_csv(statistics, index=False)
    found.by_range.to_csv(by_range, index=False)
    found.spatial.to_csv(spatial, index=False)
    registration.write_text(json.dumps(found.registration, indent=2) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
