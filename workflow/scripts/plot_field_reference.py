"""Reference points, an image with its marks, lidar points of the cones -> figure of the calibration."""

from pathlib import Path
from typing import Any

from thalweg.figures.calibration_tables import (
    CONE_POINTS,
    FIELD_POINTS,
    IMAGE_MARKS,
    read_cones,
    read_figure_table,
)
from thalweg.figures.field_reference import field_reference
from thalweg.figures.pictures import read_picture
from thalweg.figures.style import save
from thalweg.jobs.job import run_job


def main(
    *,
    field_points: Path,
    cones: Path,
    field: Path,
    image: Path,
    marks: Path,
    cone_points: Path,
    field_reference_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    all_marks = read_figure_table(marks, IMAGE_MARKS)
    figure = field_reference(
        read_figure_table(field_points, FIELD_POINTS),
        read_cones(cones, field),
        read_picture(image),
        all_marks[all_marks["image"] == image.name] if "image" in all_marks else all_marks,
        read_figure_table(cone_points, CONE_POINTS),
        image_name=image.name,
        title=f"Camera and lidar: {campaign['title']}",
        twin=twin,
    )
    save(figure, field_reference_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
