"""A panorama with its directions, and what the base of the rig costs at the seam."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from thalweg.core import ArrayU8, read_table
from thalweg.core.calibration import read_calibration
from thalweg.figures import BLUE, GREEN, GREY, VERMILION, new_figure, read_picture, styled
from thalweg.panorama import PANORAMAS

_POINTS: Final = {0: "N", 45: "NE", 90: "E", 135: "SE", 180: "S", 225: "SW", 270: "W", 315: "NW"}


def draw_panorama(*, pictures: Path, table: Path, title: str, twin: bool) -> Figure:
    """Panoramas and their table -> the middle one."""
    rows = read_table(table, PANORAMAS)[0]
    row = rows.iloc[len(rows) // 2]
    return panorama_picture(
        read_picture(pictures / str(row["panorama"])), row, title=f"Panorama: {title}", twin=twin
    )


@styled
def panorama_picture(picture: ArrayU8, row: pd.Series, *, title: str, twin: bool) -> Figure:
    """A panorama over heading and elevation.

    Parameters
    ----------
    picture : (h, 2 h, 3).
    row : its row of the table kind ``panoramas``.
    title : first words of the title.
    twin : true if the digital twin made the data.
    """
    words = (
        f"{title}, {row['width_px']} px, stitched by {row['mode']}, centre ± "
        f"{100 * float(np.hypot(row['sigma_east_m'], row['sigma_north_m'])):.1f} cm"
    )
    figure = new_figure(100.0, words, twin=twin)
    ax = figure.subplots()
    ax.imshow(picture, extent=(-180, 180, -90, 90), aspect="equal", interpolation="antialiased")
    heading = float(row["heading_deg"])
    ticks = {(point - heading + 180) % 360 - 180: name for point, name in _POINTS.items()}
    ax.set_xticks(list(ticks), list(ticks.values()))
    ax.set_yticks([-90, -45, 0, 45, 90])
    ax.set_xlabel("heading, grid north")
    ax.set_ylabel("elevation / degrees")
    return figure


def draw_panorama_seam(*, calibration: Path, table: Path, radius_m: float, title: str, twin: bool) -> Figure:
    """Calibration of a rig and table of panoramas -> shifts at the seam, expected and measured."""
    pose = read_calibration(calibration).pose("back_front")
    return seam_cost(
        float(np.linalg.norm(pose.shift_m)),
        read_table(table, PANORAMAS)[0],
        radius_m,
        title=f"Parallax at the stitching line: {title}",
        twin=twin,
    )


@styled
def seam_cost(base_m: float, rows: pd.DataFrame, radius_m: float, *, title: str, twin: bool) -> Figure:
    """Shift of both lenses against each other over the range of a thing, by the range that it is given.

    Parameters
    ----------
    base_m : distance of the projection centres.
    rows : table kind ``panoramas``.
    radius_m : of ``sphere``.
    title : first words of the title.
    twin : true if the digital twin made the data.
    """
    width = int(rows["width_px"].iloc[0])
    figure = new_figure(
        90.0, f"{title}, base {1e3 * base_m:.1f} mm, {width} px, n = {len(rows)} panoramas", twin=twin
    )
    ax = figure.subplots()
    range_m = np.geomspace(0.7, 60, 300)
    px = base_m * width / (2 * np.pi)
    off = 0.2
    ax.plot(range_m, px / range_m, color=VERMILION, label="infinitely far (none)")
    ax.plot(
        range_m,
        px * np.abs(1 / range_m - 1 / radius_m),
        color=BLUE,
        linestyle="--",
        label=f"all at {radius_m:g} m (sphere)",
    )
    ax.plot(
        range_m,
        px * (1 / (range_m - off) - 1 / range_m),
        color=GREEN,
        linestyle="-.",
        label=f"range of the cloud, {off:g} m wrong (depth)",
    )
    measured = rows["seam_rms_px"].dropna()
    for value in measured:
        ax.axhline(value, color=GREY, linewidth=0.8, linestyle=":")
    if len(measured):
        ax.plot(
            [], [], color=GREY, linewidth=0.8, linestyle=":", label=f"measured rms, {rows['mode'].iloc[0]}"
        )
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(0.01, 1.2 * px / range_m[0])
    ax.set_xlabel("object distance / m")
    ax.set_ylabel("shift at the stitching line / px")
    ax.legend(loc="lower left", fontsize=8)
    return figure
