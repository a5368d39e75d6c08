"""The sensor under a boat: a strip of the bed, and a survey beside an echo sounder."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF, read_table
from thalweg.figures import (
    BLUE,
    HEIGHT_MAP,
    PURPLE,
    VERMILION,
    count,
    new_figure,
    plural,
    robust_limits,
    styled,
)
from thalweg.lightsheet.figures.views import need
from thalweg.lightsheet.scanning import BED_POINTS

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
    title: str = "Strip of the bed",
    twin: bool = False,
) -> Figure:
    """Points from above, along their lines, and by line with their predicted sigma.

    Parameters
    ----------
    points : columns `POINTS`, see `thalweg.lightsheet.scanning.world.BED_POINTS`.
    truth, truth_lines : for a twin, the heights over the true bed: of the strip, and by line.
    title : first words of the title.
    twin : true if the digital twin made the images.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(points, POINTS, "points of the bed")
    lines = list(dict.fromkeys(points["file"]))
    sigma_up = float(np.sqrt(points["cov_uu_m2"].mean()))
    head = (
        f"{title}: n = {count(len(points))} points of {plural(len(lines), 'line')}, sigma of the height "
        f"{_CM_PER_M * sigma_up:.1f} cm, within a line {1e3 * float(points['sigma_line_m'].median()):.2f} mm"
    )
    if truth is not None and len(truth):
        row = truth.iloc[0]
        head += (
            f"; minus true bed {_CM_PER_M * row['mean_m']:+.1f} cm, within lines "
            f"{1e3 * row['std_within_lines_m']:.1f} mm"
        )
    figure = new_figure(126.0, head, twin=twin)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.0, 1.25])
    _plan(figure, figure.add_subplot(grid[:, 0]), points)
    section = figure.add_subplot(grid[0, 1])
    shades = _section(section, points, lines)
    figure.colorbar(shades, ax=section, label="number of the line", aspect=20, pad=0.01)
    last = figure.add_subplot(grid[1, 1])
    if truth_lines is None:
        _heights(last, points)
    else:
        _errors(last, points, need(truth_lines, TRUTH_LINES, "errors by line"))
    return figure


def _some(points: pd.DataFrame) -> pd.DataFrame:
    return points.iloc[:: max(1, -(-len(points) // _MOST_POINTS))]


def _plan(figure: Figure, ax: Axes, points: pd.DataFrame) -> None:
    shown = _some(points)
    middle = points[["east_m", "north_m"]].mean().to_numpy()
    low, high = robust_limits(_CM_PER_M * points["up_m"], 0.5, 99.5)
    drawn = ax.scatter(
        _CM_PER_M * (shown["east_m"] - middle[0]),
        _CM_PER_M * (shown["north_m"] - middle[1]),
        c=_CM_PER_M * shown["up_m"],
        cmap=HEIGHT_MAP,
        norm=Normalize(low, high),
        s=1.0,
        lw=0,
        gid="points",
        rasterized=True,
    )
    figure.colorbar(drawn, ax=ax, label="height / cm", location="bottom", aspect=30, pad=0.02, extend="both")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel=f"east of {middle[0]:.2f} m / cm", ylabel=f"north of {middle[1]:.2f} m / cm")
    ax.set_title("a: from above")
    ax.grid()


def along_lines(points: pd.DataFrame) -> ArrayF:
    """Places (n,) of points along the direction in which the lines run, in plan, metres."""
    xy = points[["east_m", "north_m"]].to_numpy(np.float64)
    own = xy - points.groupby("file")[["east_m", "north_m"]].transform("mean").to_numpy(np.float64)
    direction = np.linalg.svd(own[:: max(1, len(own) // 5000)], full_matrices=False)[2][0]
    # to the east, or to the north
    direction *= np.sign(direction[np.argmax(np.abs(direction))])
    return np.asarray((xy - xy.mean(axis=0)) @ direction)


def _section(ax: Axes, points: pd.DataFrame, lines: list[str]) -> ScalarMappable:
    shown = points.assign(along=along_lines(points), number=points["file"].map(lines.index) + 1)
    shown = _some(shown)
    shades = ScalarMappable(Normalize(1, max(len(lines), 2)), cm.batlow)
    ax.scatter(
        _CM_PER_M * shown["along"],
        _CM_PER_M * shown["up_m"],
        c=shades.to_rgba(shown["number"].to_numpy(np.float64)),
        s=0.8,
        lw=0,
        gid="lines",
        rasterized=True,
    )
    ax.set(xlabel="along the lines / cm", ylabel="height / cm")
    ax.set_title("b: along the lines")
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


def _heights(ax: Axes, points: pd.DataFrame) -> None:
    table = _by_line(points)
    ax.errorbar(
        table["t_s"],
        _CM_PER_M * table["up_m"],
        yerr=_CM_PER_M * table["sigma_up_m"],
        ls="none",
        marker="o",
        ms=3,
        color=BLUE,
        ecolor=PURPLE,
        capsize=2,
        gid="heights",
    )
    ax.set(xlabel="time since the first line / s", ylabel="mean height / cm")
    ax.set_title("c: mean of each line with its predicted sigma")
    ax.grid()


def _errors(ax: Axes, points: pd.DataFrame, truth_lines: pd.DataFrame) -> None:
    table = _by_line(points).merge(truth_lines, on="file", how="inner")
    sigma = _CM_PER_M * table["sigma_up_m"]
    ax.fill_between(
        table["t_s"], -sigma, sigma, color=PURPLE, alpha=0.3, lw=0, gid="predicted", label="predicted sigma"
    )
    mean, std = _CM_PER_M * table["mean_m"], _CM_PER_M * table["std_m"].fillna(0.0)
    ax.errorbar(
        table["t_s"],
        mean,
        yerr=std,
        ls="none",
        marker="o",
        ms=3,
        color=VERMILION,
        capsize=2,
        gid="errors",
        label="mean and standard deviation of a line",
    )
    ax.axhline(0.0, color="black", lw=0.7)
    largest = max(1.1 * float((mean.abs() + std).max()), 1.2 * float(sigma.max()))
    ax.set_ylim(-largest, 1.6 * largest)
    ax.set(xlabel="time since the first line / s", ylabel="height minus true bed / cm")
    ax.set_title("c: errors by line")
    ax.legend(loc="upper right")
    ax.grid()


def draw_bed_strip(
    *, points: Path, truth: list[Path], truth_lines: list[Path], title: str, twin: bool
) -> Figure:
    """Points of the bed under the boat, for a twin with their errors -> figure."""
    return bed_strip(
        read_table(points, BED_POINTS)[0],
        truth=pd.read_csv(truth[0]) if truth else None,
        truth_lines=pd.read_csv(truth_lines[0]) if truth_lines else None,
        title=f"{title}, strip of the bed",
        twin=twin,
    )


# ---------------------------------------------------------------- beside an echo sounder (T Fig. 3.5)
