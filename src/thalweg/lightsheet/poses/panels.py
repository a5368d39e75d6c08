"""A plane panel at known depths: how far the measured depths are off (P3 3.1.2)."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.clocks import read_number_columns, read_text_columns
from thalweg.core import ArrayF, ArrayI, GeometryError, InputError, ThalwegError, root_mean_square
from thalweg.lightsheet.calibration import other_readings
from thalweg.lightsheet.optics import Sensor
from thalweg.lightsheet.poses.series import points_on_sheet

PUBLISHED: Final = {128.9: (0.03, 0.21), 122.7: (0.03, 0.21), 83.1: (0.46, 0.34), 72.7: (0.07, 0.15)}
"""Mean and standard deviation in mm that P3 3.1.2 gives for its depths; one pair for the first two."""
_SAME_MM: Final = 0.5
_FAR_MM: Final = 3.0
"""Mean error of a depth that no calibrated sensor has (P3: 0.5 mm): then another order is looked for."""
_BETTER: Final = 0.2
_LEAST_SHARE: Final = 0.5
"""Of the line points that must lie on the light sheet for another reading to count."""


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
    GeometryError : no panel lies within 3 mm of its depth, and another reading of the pictures (medium,
        turned, mirrored) brings all of them there; the cure names it.
    """
    try:
        points, rows = compare_panels(points_on_sheet(sensor, line_points)[0], panels, images)
    except GeometryError as error:
        cure = _explanation(sensor, line_points, panels, images, np.inf)
        raise GeometryError(
            error.found, expected=error.expected, where=error.where, cure=cure or error.cure
        ) from error
    off = rows["mean_mm"].abs()
    if off.min() > _FAR_MM:
        cure = _explanation(sensor, line_points, panels, images, _BETTER * float(off.max()))
        if cure:
            raise GeometryError(
                f"the panels lie {off.min():.1f} to {off.max():.1f} mm off their stated depths",
                expected=f"less than {_FAR_MM:g} mm",
                where=f"sensor {sensor.name!r}",
                cure=cure,
            )
    return points, rows


def _explanation(
    sensor: Sensor, line_points: pd.DataFrame, panels: pd.DataFrame, images: pd.DataFrame, limit_mm: float
) -> str:
    """The reading with the smallest worst mean below a limit; "" if there is none."""
    best, told = min(limit_mm, _FAR_MM), ""
    for reading in other_readings(sensor, line_points):
        try:
            points, _ = points_on_sheet(reading.sensor, reading.points)
            _, rows = compare_panels(points, panels, images)
        except ThalwegError:
            continue
        worst = float(rows["mean_mm"].abs().max())
        if (rows["n"] >= _LEAST_SHARE * rows["n"].add(rows["n_off_sheet"])).all() and worst < best:
            best, told = worst, f"{reading.cure} (then {worst:.2f} mm at most)"
    return told


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
    _require_order(found, panels)
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


def _require_order(found: pd.DataFrame, panels: pd.DataFrame) -> None:
    """Refuse depths that belong to other images of the series."""
    means = found.groupby("file")["depth_mm"].mean()
    stated = panels[panels["file"].isin(means.index)]
    expected, measured = stated["depth_mm"].to_numpy(), means.loc[stated["file"]].to_numpy()
    off = float(np.abs(measured - expected).max(initial=0.0))
    if off < _FAR_MM:
        return
    order = _best_order(measured, expected)
    if np.abs(measured[order] - expected).max() > _BETTER * off:
        return
    names = stated["file"].to_numpy()
    moved = np.flatnonzero(names[order] != names)
    told = ", ".join(f"{expected[k]:g} mm to {names[order[k]]}" for k in moved[:3])
    raise InputError(
        f"the depths fit the images in another order: in {names[moved[0]]} the panel is "
        f"{measured[moved[0]]:.1f} mm deep, not {expected[moved[0]]:g} mm",
        expected="the depth of the panel in each image",
        cure=f"Put the column file in order: {told}{', ...' if len(moved) > 3 else ''}",
    )


def _best_order(measured: ArrayF, expected: ArrayF) -> ArrayI:
    """Places (n,) of the measured depths that fit the expected ones best."""
    order = np.empty(len(expected), dtype=np.int64)
    order[np.argsort(expected, kind="stable")] = np.argsort(measured, kind="stable")
    return order
