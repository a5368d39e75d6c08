"""Track of the antenna from GNSS and from images, and what remains between them (P2 Fig. 9)."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from thalweg.core.types import ArrayB
from thalweg.figures.calibration.tables import IMAGE_FIXES, TRACK, checked, filled, points_of
from thalweg.figures.style import (
    BLUE,
    GREEN,
    ORANGE,
    count,
    marks_in_free_corners,
    new_figure,
    plural,
    styled,
)

PINK: Final = "#D6488F"
PARTS: Final = (("along", BLUE, "o"), ("across", ORANGE, "^"), ("up", GREEN, "s"))
CROSSES: Final = 400
"""Crosses of the track that are drawn at most; between them there is a line."""

GAP_S: Final = 2.0
"""Seconds without a fix that interrupt the line."""


@styled
def clock_offset(
    images: pd.DataFrame,
    track: pd.DataFrame,
    facts: Mapping[str, Any],
    *,
    title: str = "Camera clock against GNSS",
    twin: bool = False,
) -> Figure:
    """Plan of both tracks with the offset applied, and the residuals along, across and up over time.

    Parameters
    ----------
    images, track : see `thalweg.figures.calibration.tables`.
    facts : ``offset_s`` and ``sigma_offset_s``; others are not used.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing.
    CoverageError : no image.
    """
    images = filled(checked(images, IMAGE_FIXES), "image with a pose").sort_values("t_gps_s")
    track = checked(track, TRACK).sort_values("t_gps_s")
    used = images["used"].to_numpy(bool)
    offset = f"GPS minus camera {facts['offset_s']:+.4f} s ± {1e3 * facts['sigma_offset_s']:.1f} ms"
    rejected = int((~used).sum())
    figure = new_figure(
        132.0,
        f"{title}: {offset}, n = {plural(int(used.sum()), 'image')}, {count(rejected)} rejected",
        twin=twin,
    )
    plan, below, right = _axes(figure)
    _plan(plan, images, track, used)
    t0 = float(track["t_gps_s"].iloc[0]) if len(track) else float(images["t_gps_s"].iloc[0])
    _residuals(below, right, images[used], t0)
    handles, labels = plan.get_legend_handles_labels()
    looks = [Line2D([], [], color=c, marker=m, mfc="none", ms=3.5, lw=1.1) for _, c, m in PARTS]
    labels += [name for name, _, _ in PARTS]
    figure.legend([*handles, *looks], labels, loc="outside lower left", ncols=6)
    return figure


def _axes(figure: Figure) -> tuple[Axes, Axes, Axes]:
    grid = figure.add_gridspec(2, 2, height_ratios=[1.7, 1.0], width_ratios=[3.2, 1.0])
    below = figure.add_subplot(grid[1, 0])
    return figure.add_subplot(grid[0, :]), below, figure.add_subplot(grid[1, 1], sharey=below)


def _plan(ax: Axes, images: pd.DataFrame, track: pd.DataFrame, used: ArrayB) -> None:
    gnss = points_of(track, ("east_m", "north_m"))
    fixes = points_of(images, ("east_m", "north_m"))
    line = gnss.copy()
    line[1:][np.diff(track["t_gps_s"].to_numpy()) > GAP_S] = np.nan
    step = max(-(-len(gnss) // CROSSES), 1)
    ax.plot(line[:, 0], line[:, 1], color="0.75", lw=0.8, zorder=1)
    every = "" if step == 1 else f", 1 of {step} drawn"
    ax.plot(gnss[::step, 0], gnss[::step, 1], ls="none", marker="x", ms=3.2, mew=0.8, color="black", zorder=2,
            label=f"GNSS, n = {count(len(gnss))}{every}", gid="track")  # fmt: skip
    ax.plot(fixes[used, 0], fixes[used, 1], ls="none", marker="o", ms=5.0, mew=1.2, mfc="none", color=PINK,
            zorder=3, label=f"antenna from images, n = {count(int(used.sum()))}", gid="images")  # fmt: skip
    if not used.all():
        ax.plot(fixes[~used, 0], fixes[~used, 1], ls="none", marker="o", ms=5.0, mew=0.8, mfc="none",
                color="0.5", label=f"rejected, n = {count(int((~used).sum()))}", gid="rejected")  # fmt: skip
    both = np.concatenate([gnss, fixes])
    low, high = np.nanmin(both, axis=0), np.nanmax(both, axis=0)
    pad = 0.07 * max(float((high - low).max()), 0.1)
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(low[0] - pad, high[0] + pad)
    ax.set_ylim(low[1] - pad, high[1] + pad)
    ax.set(xlabel="east / m", ylabel="north / m")
    ax.set_title("a: tracks of the antenna, images at their corrected times")
    ax.grid()
    marks_in_free_corners(ax, both)


def _residuals(ax: Axes, right: Axes, images: pd.DataFrame, t0: float) -> None:
    t = images["t_gps_s"].to_numpy() - t0
    texts = []
    edges = np.linspace(*_limits(images), 31)
    for name, colour, marker in PARTS:
        mm = 1e3 * images[f"residual_{name}_m"].to_numpy(np.float64)
        ax.plot(
            t, mm, ls="none", marker=marker, ms=2.4, mew=0.6, mfc="none", color=colour, label=name, gid=name
        )
        right.hist(
            mm[np.isfinite(mm)],
            edges.tolist(),
            orientation="horizontal",
            histtype="step",
            color=colour,
            lw=1.1,
        )
        texts.append(f"{name} {np.nanmean(mm):+.1f} ± {np.nanstd(mm):.1f}")
    ax.axhline(0.0, color="black", lw=0.6, zorder=1)
    ax.set_ylim(edges[0], edges[-1])
    ax.set(xlabel="time since the first fix / s", ylabel="track minus image / mm")
    ax.set_title(f"b: residuals; mean ± std / mm: {', '.join(texts)}")
    ax.grid()
    right.set_xlabel("images / 1")
    right.tick_params(labelleft=False)
    right.grid()


def _limits(images: pd.DataFrame) -> tuple[float, float]:
    mm = 1e3 * np.concatenate([images[f"residual_{name}_m"].to_numpy() for name, _, _ in PARTS])
    reach = 1.15 * max(float(np.nanpercentile(np.abs(mm), 99.5)), 1.0)
    return -reach, reach
