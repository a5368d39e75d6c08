"""An image of the light-sheet sensor with the line that was measured in it (P4 Fig. 18)."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from thalweg.core.types import AnyArray
from thalweg.figures.style import ORANGE, VERMILION, count, new_figure, plural, styled
from thalweg.lightsheet.figures.views import green_of, need, show_green

POINTS: Final = ("piece", "x_px", "y_px", "sigma_px", "flags")
DETAIL: Final = 0.14
"""Side of the detail as a share of the picture's."""


@styled
def sheet_image(
    image: AnyArray, points: pd.DataFrame, *, title: str = "Laser line", twin: bool = False
) -> Figure:
    """The green channel with the measured line, and a detail with single points.

    Parameters
    ----------
    image : (h, w) mosaic or grey, or (h, w, 3).
    points : columns `POINTS`, of this image.
    title : first words of the title.
    twin : true if the digital twin made the image.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(points, POINTS, "line points")
    green = green_of(image)
    pieces = int(points["piece"].nunique())
    flagged = int((points["flags"] != 0).sum())
    head = (
        f"{title}: line in {plural(pieces, 'piece')}, median sigma {points['sigma_px'].median():.2f} px, "
        f"{count(flagged)} flagged, n = {count(len(points))} points"
    )
    figure = new_figure(96.0, head, twin=twin)
    left, right = figure.subplots(1, 2)
    show_green(left, green)
    _line(left, points, 0.9)
    side = max(int(DETAIL * max(green.shape)), 40)
    # where the line bends most between neighbours there is most to see: an edge of the object
    order = points.sort_values("y_px" if np.ptp(points["y_px"]) > np.ptp(points["x_px"]) else "x_px")
    step = np.abs(np.diff(order[["x_px", "y_px"]].to_numpy(np.float64), axis=0)).sum(axis=1)
    k = int(np.argmax(np.where(step < side / 2, step, 0.0))) if len(step) else 0
    middle = order[["x_px", "y_px"]].iloc[k : k + 2].mean().to_numpy()
    x0, y0 = (int(np.clip(m - side / 2, 0, n - side)) for m, n in zip(middle, green.shape[::-1], strict=True))
    left.add_patch(Rectangle((x0, y0), side, side, fill=False, ec="white", lw=0.9))
    show_green(right, green[y0 : y0 + side, x0 : x0 + side], left=x0, top=y0)
    _line(right, points, 3.0)
    right.set_xlim(x0, x0 + side)
    right.set_ylim(y0 + side, y0)
    left.set(title="a: image, green channel", xlabel="column / px", ylabel="row / px")
    right.set(title="b: detail (frame in a)", xlabel="column / px")
    right.legend(loc="upper right")
    return figure


def _line(ax: Axes, points: pd.DataFrame, size: float) -> None:
    good = points["flags"] == 0
    for keep, colour, words in ((good, VERMILION, "measured"), (~good, ORANGE, "measured, flagged")):
        if keep.any():
            ax.plot(points["x_px"][keep], points["y_px"][keep], ls="none", marker=".", ms=size, mew=0,
                    color=colour, label=words, gid=words.replace(", ", "-"), zorder=3)  # fmt: skip
