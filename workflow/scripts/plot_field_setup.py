"""Cones and poses of a calibration -> figures of the field and of the positions in it."""

from pathlib import Path
from typing import Any

from thalweg.calibration.field.description import read_field
from thalweg.figures.calibration.field_setup import field_positions, field_setup
from thalweg.figures.calibration.tables import POSES, placed, read_cones, read_figure_table, read_place
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    cones: Path,
    field: Path,
    place: Path,
    poses: Path,
    field_setup_png: Path,
    field_positions_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    T_wcs_pcs = read_place(place)
    bodies = placed(read_cones(cones, field), T_wcs_pcs)
    stands = placed(read_figure_table(poses, POSES), T_wcs_pcs)
    frame = "pcs" if T_wcs_pcs is None else "wcs"
    described = [cone.name for cone in read_field(field).cones]
    unseen = [name for name in described if name not in set(bodies["name"].astype(str))]
    setup = field_setup(bodies, stands, frame=frame, unseen=unseen, title=campaign["title"], twin=twin)
    save(setup, field_setup_png, dpi=figures["dpi"])
    positions = field_positions(bodies, stands, frame=frame, twin=twin)
    save(positions, field_positions_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
