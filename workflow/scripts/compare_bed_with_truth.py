"""Bed points of the twin's boat -> their distances from the true bed."""

from pathlib import Path

from thalweg.core import read_table
from thalweg.core.geometry import read_mesh
from thalweg.lightsheet.scanning import BED_POINTS
from thalweg.workflow import run_job
from thalweg_lab.truth import compare_bed


def main(*, points: Path, truth: Path, statistics: Path, lines: Path) -> None:
    table, by_line = compare_bed(read_table(points, BED_POINTS)[0], read_mesh(truth / "bed.ply")[0])
    table.to_csv(statistics, index=False, float_format="%.6g")
    by_line.to_csv(lines, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
