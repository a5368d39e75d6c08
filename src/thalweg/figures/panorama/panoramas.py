"""A panorama with its directions, and what the base of the rig costs at the seam."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from thalweg.core import ArrayU8, read_table
from thalweg.figures import new_figure, read_picture, styled
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
