"""Where the lines of a fifteen-line laser meet levels -> figure in space, in a section, in the image."""

from pathlib import Path

import pandas as pd

from thalweg.figures.style import save
from thalweg.lightsheet.figures.multi_line_geometry import multi_line_geometry
from thalweg.workflow.job import run_job


def main(*, lines: Path, multi_line_geometry_png: Path, dpi: int) -> None:
    save(multi_line_geometry(pd.read_csv(lines)), multi_line_geometry_png, dpi=dpi)


if "snakemake" in globals():
    run_job(main, snakemake)
