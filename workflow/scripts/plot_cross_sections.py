"""Cloud, reference and their comparison -> cross sections through both."""

import json
from pathlib import Path
from typing import Any

from thalweg.accuracy.cloud_to_mesh.comparison import CLOUD_TO_MESH
from thalweg.core.geometry.mesh_ply import read_mesh
from thalweg.core.las.files import iter_laz
from thalweg.core.tables import read_table
from thalweg.core.trajectory import Trajectory
from thalweg.figures.accuracy.cross_sections import Slabs, cross_sections
from thalweg.figures.accuracy.distances import bank_frame_of
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    comparison: Path,
    mesh: Path,
    mesh_facts: Path,
    points: Path,
    reference: Path,
    trajectory: Path,
    cross_sections_png: Path,
    sections: dict[str, Any],
    water_line_ics_m: float,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    table, _ = read_table(comparison, CLOUD_TO_MESH)
    slabs = Slabs(table, bank_frame_of(json.loads(mesh_facts.read_text())), sections)
    for chunk in iter_laz(points, 1_000_000):
        slabs.add("cloud", chunk["xyz_m"], chunk["t_gps_s"])
    for chunk in iter_laz(reference, 1_000_000):
        slabs.add("reference", chunk["xyz_m"])
    figure = cross_sections(
        slabs,
        read_mesh(mesh)[0],
        Trajectory.read(trajectory),
        water_line_ics_m=water_line_ics_m,
        title=f"Cross sections of cloud and reference: {campaign['title']}",
        twin=twin,
    )
    save(figure, cross_sections_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
