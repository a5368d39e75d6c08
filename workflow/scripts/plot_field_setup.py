"""Cones and poses of a calibration -> figures of the field and of the positions in it."""

from pathlib import Path
from typing import Any

from thalweg.figures.calibration_tables import POSES, read_cones, read_figure_table
from thalweg.figures.field_setup import field_positions, field_setup
from thalweg.figures.style import save
from thalweg.jobs.job import run_job


def main(
    *,
    cones: Path,
    field: Path,
    poses: Path,
    field_setup_png: Path,
    field_positions_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    bodies, stands = read_cones(cones, field), read_figure_table(poses, POSES)
    setup = field_setup(bodies, stands, title=f"Calibration field: {campaign['title']}", twin=twin)
    save(setup, field_setup_png, dpi=figures["dpi"])
    save(field_positions(bodies, stands, twin=twin), field_positions_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
