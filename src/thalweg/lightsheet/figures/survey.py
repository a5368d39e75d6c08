"""The sensor under a boat: a strip of the bed, and a survey beside an echo sounder."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF, read_parquet, read_table
from thalweg.figures import (
    BLUE,
    GREEN,
    GREY,
    HEIGHT_MAP,
    PURPLE,
    VERMILION,
    count,
    legend_below,
    new_figure,
    plural,
    robust_limits,
    styled,
)
from thalweg.lightsheet.figures.views import WATER_COLOUR, need
from thalweg.lightsheet.scanning import BED_POINTS

POINTS: Final = ("file", "t_gps_s", "east_m", "north_m", "up_m", "cov_uu_m2", "sigma_line_m")
TRUTH_LINES: Final = ("file", "n", "mean_m", "std_m")
"""Columns of `thalweg_lab.truth.points.compare_bed`."""
_MOST_POINTS: Final = 30_000
_CM_PER_M: Final = 100.0

PLACES: Final = ("along_m", "across_m", "depth_m", "instrument")
TABLE: Final = ("from_m", "to_m", "area_m2", "share_echo", "share_laser", "share_joint")
STYLES: Final = (("echo sounder", BLUE), ("light sheet", GREEN))
_MOST: Final = 20_000


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


@styled
def joint_survey_figure(
    places: pd.DataFrame,
    table: pd.DataFrame,
    facts: Mapping[str, Any],
    *,
    title: str = "Joint survey of a small river",
    twin: bool = True,
) -> Figure:
    """Cross-section and plan of a simulated survey, and the share of the bed that is measured by depth.

    Parameters
    ----------
    places : columns `PLACES`; ``instrument`` is section, track, echo sounder or light sheet.
    table : columns `TABLE`, see `thalweg.lightsheet.scanning.joint_survey`.
    facts : of the same survey: ``rmse_section_echo_m`` and ``_joint_m``.
    title : first words of the title.
    twin : true if the survey is simulated, as it is here always.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(places, PLACES, "places of the survey"), need(table, TABLE, "shares by depth")
    own = {name: places[places["instrument"] == name] for name, _ in STYLES}
    alone, joint = (
        f"{100 * facts[f'rmse_section_{name}_m']:.1f}\N{NO-BREAK SPACE}cm" for name in ("echo", "joint")
    )
    head = (
        f"{title}: error of the interpolated section {alone} by the echo sounder, "
        f"{joint} with the light sheet, "
        f"n = {count(len(own['echo sounder']))} soundings"
    )
    figure = new_figure(150.0, head, twin=twin)
    grid = figure.add_gridspec(3, 2, height_ratios=[1.0, 1.0, 1.0], width_ratios=[2.2, 1.0])
    section = places[places["instrument"] == "section"]
    whole, shallow = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, :])
    for ax, words in ((whole, "a: cross-section"), (shallow, "b: its shallow part")):
        _joint_section(ax, section, own)
        ax.set(title=words, ylabel="depth / m", xlim=(section["across_m"].min(), section["across_m"].max()))
    deepest = float(section["depth_m"].max())
    whole.set_ylim(1.06 * deepest, -0.08 * deepest)
    shallow.set_ylim(0.3, -0.02)
    shallow.set_xlabel("across the river / m")
    _joint_plan(figure.add_subplot(grid[2, 0]), places[places["instrument"] == "track"], own)
    _shares(figure.add_subplot(grid[2, 1]), table)
    legend_below(figure, shallow)
    return figure


def _joint_section(ax: Axes, section: pd.DataFrame, own: Mapping[str, pd.DataFrame]) -> None:
    ax.fill_between(section["across_m"], 0.0, section["depth_m"], color=WATER_COLOUR, lw=0)
    ax.plot(section["across_m"], section["depth_m"], color="0.35", lw=0.9, label="bed", gid="bed")
    ax.axhline(0.0, color=BLUE, lw=0.6)
    for name, colour in STYLES:
        mine = own[name].iloc[:: max(1, len(own[name]) // _MOST)]
        ax.plot(
            mine["across_m"],
            mine["depth_m"],
            ls="none",
            marker=".",
            ms=3.0,
            mew=0,
            color=colour,
            label=f"{name}, n = {count(len(own[name]))}",
            gid=name,
            rasterized=True,
        )
    ax.grid()


def _joint_plan(ax: Axes, track: pd.DataFrame, own: Mapping[str, pd.DataFrame]) -> None:
    ax.plot(track["along_m"], track["across_m"], color=GREY, lw=0.5, gid="track")
    for name, colour in STYLES:
        mine = own[name].iloc[:: max(1, len(own[name]) // _MOST)]
        ax.plot(
            mine["along_m"],
            mine["across_m"],
            ls="none",
            marker=".",
            ms=1.4,
            mew=0,
            color=colour,
            gid=f"plan {name}",
            rasterized=True,
        )
    ax.set(title="c: from above, with the boat's way", xlabel="along the river / m", ylabel="across / m")
    ax.set_aspect("equal", adjustable="datalim")


def _shares(ax: Axes, table: pd.DataFrame) -> None:
    """Share of the bed's area that was measured, by class of depth."""
    place = np.arange(len(table), dtype=np.float64)
    kinds = (("share_echo", BLUE, -0.27), ("share_laser", GREEN, 0.0), ("share_joint", GREY, 0.27))
    for column, colour, aside in kinds:
        ax.barh(place + aside, 100 * table[column], height=0.25, color=colour, gid=column)
    names = [
        f"{low:g} to {high:g} m" if np.isfinite(high) else f"over {low:g} m"
        for low, high in zip(table["from_m"], table["to_m"], strict=True)
    ]
    ax.set_yticks(place, names)
    ax.invert_yaxis()
    ax.set(title="d: measured area (grey: both)", xlabel="share of the bed / %")
    ax.grid(axis="x")


def draw_joint_survey(*, table: Path, facts: Path, places: Path) -> Figure:
    """Simulated survey with echo sounder and light sheet -> figure of what each measures."""
    return joint_survey_figure(
        read_parquet(places), pd.read_csv(table), json.loads(facts.read_text()), twin=True
    )
