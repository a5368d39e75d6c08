"""The sensor under a boat: a strip of the bed, and a survey beside an echo sounder."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF
from thalweg.figures import (
    HEIGHT_MAP,
    PURPLE,
    VERMILION,
    count,
    new_figure,
    plural,
    robust_limits,
    styled,
    thinned,
)
from thalweg.lightsheet.figures.views import line_numbers, need, spots

POINTS: Final = ("file", "t_gps_s", "east_m", "north_m", "up_m", "cov_uu_m2", "sigma_line_m")
TRUTH_LINES: Final = ("file", "n", "mean_m", "std_m")
"""Columns of `thalweg_lab.truth.points.compare_bed`."""
_MOST_POINTS: Final = 30_000
_CM_PER_M: Final = 100.0


# ---------------------------------------------------------------- strip of the bed


@styled
def bed_strip(
    points: pd.DataFrame,
    *,
    truth: pd.DataFrame | None = None,
    truth_lines: pd.DataFrame | None = None,
    title: str,
) -> Figure:
    """Points from above, along their lines, and by line with their predicted sigma.

    Parameters
    ----------
    points : columns `POINTS`, see `thalweg.lightsheet.scanning.world.BED_POINTS`.
    truth, truth_lines : for a twin, the heights over the true bed: of the strip, and by line.
    title : first words of the title.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(points, POINTS, "points of the bed")
    sigma_up = float(np.sqrt(points["cov_uu_m2"].mean()))
    head = (
        f"{title}, strip of the bed: n = {count(len(points))} points of "
        f"{plural(points['file'].nunique(), 'line')}, sigma of the height "
        f"{_CM_PER_M * sigma_up:.1f} cm, within a line {1e3 * float(points['sigma_line_m'].median()):.2f} mm"
    )
    if truth is not None and len(truth):
        row = truth.iloc[0]
        head += (
            f"; minus true bed {_CM_PER_M * row['mean_m']:+.1f} cm, within lines "
            f"{1e3 * row['std_within_lines_m']:.1f} mm"
        )
    figure = new_figure(126.0, head)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.0, 1.25])
    _plan(figure, figure.add_subplot(grid[:, 0]), points)
    section = figure.add_subplot(grid[0, 1])
    shades = _section(section, points)
    figure.colorbar(shades, ax=section, label="number of the line", aspect=20, pad=0.01)
    _along_time(figure.add_subplot(grid[1, 1]), points, truth_lines)
    return figure


def _plan(figure: Figure, ax: Axes, points: pd.DataFrame) -> None:
    shown = thinned(points, _MOST_POINTS)
    middle = points[["east_m", "north_m"]].mean().to_numpy()
    east, north = (_CM_PER_M * (shown[["east_m", "north_m"]] - middle)).to_numpy().T
    norm = Normalize(*robust_limits(_CM_PER_M * points["up_m"], 0.5, 99.5))
    drawn = spots(ax, east, north, _CM_PER_M * shown["up_m"], cmap=HEIGHT_MAP, norm=norm, s=1.0, gid="points")
    figure.colorbar(drawn, ax=ax, label="height / cm", location="bottom", aspect=30, pad=0.02, extend="both")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel=f"east of {middle[0]:.2f} m / cm", ylabel=f"north of {middle[1]:.2f} m / cm")
    ax.set_title("a: from above")
    ax.grid()


def along_lines(points: pd.DataFrame) -> ArrayF:
    """Places (n,) of points along the direction in which the lines run, in plan, metres."""
    xy = points[["east_m", "north_m"]].to_numpy()
    own = xy - points.groupby("file")[["east_m", "north_m"]].transform("mean").to_numpy()
    direction = np.linalg.svd(own[:: max(1, len(own) // 5000)], full_matrices=False)[2][0]
    # to the east, or to the north
    direction *= np.sign(direction[np.argmax(np.abs(direction))])
    return np.asarray((xy - xy.mean(axis=0)) @ direction)


def _section(ax: Axes, points: pd.DataFrame) -> ScalarMappable:
    number, shades = line_numbers(points["file"])
    shown = thinned(points.assign(along=along_lines(points), number=number), _MOST_POINTS)
    colours = shades.to_rgba(shown["number"].to_numpy())
    spots(ax, _CM_PER_M * shown["along"], _CM_PER_M * shown["up_m"], colours, s=0.8)
    ax.set(title="b: along the lines", xlabel="along the lines / cm", ylabel="height / cm")
    ax.grid()
    return shades


def _by_line(points: pd.DataFrame) -> pd.DataFrame:
    """Time since the first line, mean height and its predicted sigma of each line, in order."""
    table = points.groupby("file", sort=False).agg(
        t_gps_s=("t_gps_s", "first"), up_m=("up_m", "mean"), cov_uu_m2=("cov_uu_m2", "mean")
    )
    table["t_s"] = table["t_gps_s"] - table["t_gps_s"].iloc[0]
    table["sigma_up_m"] = np.sqrt(table["cov_uu_m2"])
    return table.reset_index()


def _along_time(ax: Axes, points: pd.DataFrame, truth_lines: pd.DataFrame | None) -> None:
    """Mean of each line with its predicted sigma: of its height, or of its error where the truth is known."""
    table = _by_line(points)
    mean, std = _CM_PER_M * table["up_m"], 0.0 * table["up_m"]
    ax.set(title="c: mean of each line with its predicted sigma", ylabel="mean height / cm")
    if truth_lines is not None:
        table = table.merge(need(truth_lines, TRUTH_LINES, "errors by line"), on="file", how="inner")
        mean, std = _CM_PER_M * table["mean_m"], _CM_PER_M * table["std_m"].fillna(0.0)
        ax.set(title="c: errors by line", ylabel="height minus true bed / cm")
        ax.axhline(0.0, color="black", lw=0.7)
    sigma = _CM_PER_M * table["sigma_up_m"]
    centre = mean if truth_lines is None else 0.0
    ax.fill_between(
        table["t_s"], centre - sigma, centre + sigma, color=PURPLE, alpha=0.3, lw=0, label="predicted sigma"
    )
    ax.errorbar(
        table["t_s"],
        mean,
        yerr=std,
        label="mean and standard deviation of a line",
        ls="none",
        marker="o",
        ms=3,
        color=VERMILION,
        capsize=2,
    )
    ax.set_xlabel("time since the first line / s")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.28))
    ax.grid()
