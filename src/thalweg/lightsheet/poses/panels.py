"""A plane panel at known depths: how far the measured depths are off (P3 3.1.2)."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.clocks import read_number_columns, read_text_columns
from thalweg.core import InputError, root_mean_square
from thalweg.lightsheet.optics import Sensor
from thalweg.lightsheet.poses.series import points_on_sheet

PUBLISHED: Final = {128.9: (0.03, 0.21), 122.7: (0.03, 0.21), 83.1: (0.46, 0.34), 72.7: (0.07, 0.15)}
"""Mean and standard deviation in mm that P3 3.1.2 gives for its depths; one pair for the first two."""
_SAME_MM: Final = 0.5


def read_panels(path: Path) -> pd.DataFrame:
    """Depths of the panel by image: CSV with file, depth_mm, sigma_mm; other columns are left out.

    Raises
    ------
    InputError : the file is missing, no table or lacks columns, a number is missing or impossible, or an
        image has two depths.
    """
    (names,) = read_text_columns(path, ("file",))
    depth, sigma = read_number_columns(path, ("depth_mm", "sigma_mm"))
    wrong = np.flatnonzero((depth <= 0.0) | (sigma < 0.0))
    if wrong.size:
        k = int(wrong[0])
        raise InputError(
            f"a depth of {depth[k]:g} mm with a sigma of {sigma[k]:g} mm in row {k + 1} ({names[k]})",
            expected="a depth above 0, counted from the window's outer face, and a sigma",
            where=path,
        )
    if depth.max() < 1.0:
        raise InputError(
            f"no depth exceeds {depth.max():g} mm",
            expected="depths of the panel in millimetres",
            where=path,
            cure="Multiply depth_mm and sigma_mm by 1000 if they are metres",
        )
    table = pd.DataFrame({"file": names, "depth_mm": depth, "sigma_mm": sigma})
    twice = table["file"][table["file"].duplicated()]
    if len(twice):
        raise InputError(f"two depths for {twice.iloc[0]}", expected="one depth an image", where=path)
    return table


def measure_panels(
    sensor: Sensor, line_points: pd.DataFrame, panels: pd.DataFrame, images: pd.DataFrame
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Depths of panels by a calibrated sensor, see `compare_panels`.

    Parameters
    ----------
    sensor : calibrated.
    line_points : `thalweg.lightsheet.poses.series.SERIES_POINTS` of the panels' images.
    panels, images : see `compare_panels`.

    Raises
    ------
    InputError : see `compare_panels`.
    GeometryError : no line point lies on the light sheet.
    """
    return compare_panels(points_on_sheet(sensor, line_points)[0], panels, images)


def compare_panels(
    points: pd.DataFrame, panels: pd.DataFrame, images: pd.DataFrame
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Measured depths against those of the panel.

    Parameters
    ----------
    points : `thalweg.lightsheet.poses.series.SHEET_POINTS`.
    panels : see `read_panels`.
    images : the images of the series with ``file``, ``points`` (of the line) and ``reason`` (why there are
        none), as `thalweg.lightsheet.poses.series.detect_series` gives them.

    Returns
    -------
    The points with ``expected_depth_mm``, and a row a panel: file, depth_mm and sigma_mm as stated; n points,
    mean_mm, std_mm, rms_mm, largest_mm of measured minus stated; predicted_mm (root mean square of the
    predicted sigmas of the depth); published_mean_mm, published_std_mm; n_off_sheet line points that do not
    meet the light sheet; reason why an image gives no point.

    Raises
    ------
    InputError : images without a depth, or depths without an image; depths that fit other images.
    """
    _require_same_names(set(images["file"]), set(panels["file"]))
    depth = panels.set_index("file")["depth_mm"]
    found = points.assign(expected_depth_mm=depth.loc[points["file"]].to_numpy())
    of_image = images.set_index("file")
    rows = [_row(row, found, of_image) for row in panels.itertuples()]
    return found, pd.DataFrame(rows)


def _row(panel: Any, found: pd.DataFrame, of_image: pd.DataFrame) -> dict[str, object]:
    mine = found[found["file"] == panel.file]
    e = (mine["depth_mm"] - panel.depth_mm).to_numpy()
    known = next((v for d, v in PUBLISHED.items() if abs(d - panel.depth_mm) < _SAME_MM), (np.nan, np.nan))
    lines, reason = int(of_image.loc[panel.file, "points"]), of_image.loc[panel.file, "reason"]
    if lines and not len(e):
        reason = "no line point lies on the light sheet"
    return {
        "file": panel.file,
        "depth_mm": panel.depth_mm,
        "sigma_mm": panel.sigma_mm,
        "n": len(e),
        "mean_mm": e.mean() if len(e) else np.nan,
        "std_mm": e.std(ddof=1) if len(e) > 1 else np.nan,
        "rms_mm": root_mean_square(e) if len(e) else np.nan,
        "largest_mm": np.abs(e).max() if len(e) else np.nan,
        "predicted_mm": root_mean_square(mine["sigma_depth_mm"]) if len(e) else np.nan,
        "published_mean_mm": known[0],
        "published_std_mm": known[1],
        "n_off_sheet": lines - len(e),
        "reason": "" if pd.isna(reason) else reason,
    }


def _require_same_names(images: set[str], panels: set[str]) -> None:
    for names, what in (
        (images - panels, "images without a depth"),
        (panels - images, "depths without image"),
    ):
        if names:
            raise InputError(
                f"{len(names)} {what}, such as {min(names)}",
                expected="one depth for each image, and an image for each depth",
                cure="Make the column file of the panels' table agree with the names of the images, such as "
                f"{min(images)}",
            )
