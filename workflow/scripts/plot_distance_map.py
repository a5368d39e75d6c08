"""Comparison and reference mesh -> map of the distances on the bank."""

import json
from pathlib import Path
from typing import Any

from thalweg.accuracy.cloud_to_mesh.comparison import CLOUD_TO_MESH
from thalweg.core.geometry.mesh_ply import read_mesh
from thalweg.core.tables import read_table
from thalweg.figures.accuracy.distance_map import distance_map
from thalweg.figures.accuracy.distances import bank_frame_of
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    comparison: Path,
    mesh: Path,
    mesh_facts: Path,
    distance_map_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    table, facts = read_table(comparison, CLOUD_TO_MESH)
    figure = distance_map(
        table,
        read_mesh(mesh)[0],
        bank_frame_of(json.loads(mesh_facts.read_text())),
        max_distance_m=facts["max_distance_m"],
        max_points=figures["max_points"],
        title=f"Distance to the reference: {campaign['title']}",
        twin=twin,
    )
    save(figure, distance_map_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
