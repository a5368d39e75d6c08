"""An image of the laser line on a panel -> scatter of each method of line measurement about a smooth line."""

from pathlib import Path
from typing import get_args

import numpy as np
import pandas as pd

from thalweg.lightsheet.figures import departures_px, first_image, measured
from thalweg.lightsheet.lines import Method
from thalweg.workflow import run_job


def main(*, images: list[Path], line_points: Path, line_methods: Path) -> None:
    image, smooth = first_image(images, line_points)
    rows = []
    for name, points in measured(image, get_args(Method)).items():
        off = departures_px(points, smooth)
        std, n = float(np.nanstd(off)), int(np.isfinite(off).sum())
        rows.append((name, n, len(off) - n, std, std / np.sqrt(2 * n), points["sigma_px"].median()))
    columns = ["method", "n", "n_beyond_the_line", "std_px", "sigma_std_px", "predicted_px"]
    pd.DataFrame(rows, columns=columns).to_csv(line_methods, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
