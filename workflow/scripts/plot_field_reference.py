"""Reference points, an image with its marks, lidar points of the cones -> figure of the calibration."""

from pathlib import Path
from typing import Any

from thalweg.figures.calibration.field_reference import field_reference
from thalweg.figures.calibration.tables import (
    CONE_POINTS,
    FIELD_POINTS,
    first_picture,
    placed,
    read_cones,
    read_figure_table,
    read_image_marks,
    read_place,
)
from thalweg.figures.images.pictures import read_picture
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    field_points: Path,
    cones: Path,
    field: Path,
    place: Path,
    images: list[Path],
    marks: Path,
    measured: Path,
    cone_points: Path,
    field_reference_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    all_marks = read_image_marks(marks, measured)
    image = first_picture(images, choice=all_marks["image"].unique().tolist())
    T_wcs_pcs = read_place(place)
    figure = field_reference(
        placed(read_figure_table(field_points, FIELD_POINTS), T_wcs_pcs),
        placed(read_cones(cones, field), T_wcs_pcs),
        read_picture(image),
        all_marks[all_marks["image"] == image.name],
        placed(read_figure_table(cone_points, CONE_POINTS), T_wcs_pcs),
        image_name=image.name,
        title=campaign["title"],
        twin=twin,
    )
    save(figure, field_reference_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
