"""Predicted sigmas of the poses of all chains over time, and where each of them has none."""

import datetime as dt
from collections.abc import Mapping
from typing import Final

import matplotlib.dates as mdates
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from thalweg.accuracy.solutions.comparison import CHAINS, length_s, longest_gap_s, valid_spans
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.timescales import unix_from_gps, utc_text_from_gps
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF
from thalweg.figures.solutions.comparison import IN_WORDS, LOOK
from thalweg.figures.style import count, legend_below, new_figure, plural, styled
from thalweg.figures.survey.maps import LOG_RATIO, plain_numbers

MOST_NODES: Final = 6000
"""A longer line shows nothing more at this width; of each piece its largest sigma is drawn."""


@styled
def pose_sigmas(
    trajectories: Mapping[str, Trajectory],
    *,
    title: str = "Predicted sigmas of the poses",
    twin: bool = False,
) -> Figure:
    """Sigmas of place, roll and pitch, and heading over time, and a bar of the times with a pose per chain.

    Parameters
    ----------
    trajectories : chain -> poses with their covariances.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : no chain.
    GeometryError : a chain without a valid pose.
    """
    names = [name for name in CHAINS if name in trajectories]
    if not names:
        raise InputError("no trajectory", expected=f"at least one of {', '.join(CHAINS)}")
    for name in names:
        if not trajectories[name].valid.any():
            raise GeometryError(f"the trajectory by {name} has no valid pose", expected="at least one")
    n = sum(int(trajectories[name].valid.sum()) for name in names)
    figure = new_figure(138.0, f"{title}, n = {count(n)} poses of {plural(len(names), 'chain')}", twin=twin)
    panels = figure.subplots(4, 1, sharex=True, height_ratios=[1.5, 1.2, 1.2, 0.35 + 0.22 * len(names)])
    shown: list[list[ArrayF]] = [[], [], []]
    for name in names:
        values = _sigmas(trajectories[name])
        colour = LOOK[name][0]
        for k, ax in enumerate(panels[:3]):
            t, line = _broken(trajectories[name], values[k])
            ax.plot(_dates(t), line, color=colour, lw=1.1, label=IN_WORDS[name], gid=f"sigma-{k}-{name}")
            shown[k].append(line)
    labels = ("place, 3D / mm", "roll and pitch / °", "heading / °")
    titles = (
        "a: sigma of the place, √(σE² + σN² + σU²)", "b: sigma of roll and pitch, √((σr² + σp²) / 2)",
        "c: sigma of the heading",
    )  # fmt: skip
    for ax, values_of, label, words in zip(panels[:3], shown, labels, titles, strict=True):
        _scale(ax, np.concatenate(values_of))
        ax.set_ylabel(label)
        ax.set_title(words)
        ax.grid(axis="both")
    whole = _time_axis(list(panels), [trajectories[name] for name in names])
    _draw_times(panels[3], {name: valid_spans(trajectories[name]) for name in names}, whole)
    figure.align_ylabels(list(panels))
    legend_below(figure, panels[0])
    return figure


def _sigmas(trajectory: Trajectory) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Place in millimetres, roll and pitch, and heading in degrees, each (n,)."""
    place = 1e3 * np.linalg.norm(trajectory.sigma_position_m, axis=1)
    angles = np.rad2deg(trajectory.sigma_roll_pitch_heading_rad())
    return place, np.sqrt(np.mean(angles[:, :2] ** 2, axis=1)), angles[:, 2]


def _broken(trajectory: Trajectory, values: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Times and values, thinned, NaN where there is no pose, so that a line breaks at each gap."""
    t, v = trajectory.t_gps_s, np.where(trajectory.valid, values, np.nan)
    step = -(-len(t) // MOST_NODES)
    if step == 1:
        return t, v
    pieces = np.arange(0, len(t), step)
    largest = np.fmax.reduceat(v, pieces)
    invalid = np.add.reduceat((~trajectory.valid).astype(np.int64), pieces) > 0
    return t[pieces], np.where(invalid, np.nan, largest)


def _scale(ax: Axes, values: ArrayF) -> None:
    positive = values[np.isfinite(values) & (values > 0)]
    if positive.size and positive.max() > LOG_RATIO * positive.min():
        ax.set_yscale("log")
        ax.set_ylim(0.7 * float(positive.min()), 1.5 * float(positive.max()))
        plain_numbers(ax.yaxis, LogNorm())
    else:
        ax.set_ylim(0.0, 1.15 * (float(positive.max()) if positive.size else 1.0))


def _draw_times(ax: Axes, spans: Mapping[str, ArrayF], whole: tuple[float, float]) -> None:
    """A bar a chain where it has poses; what it lacks stands beside it."""
    for row, (name, own) in enumerate(spans.items()):
        bars = [(float(_dates(a)), float(_dates(b)) - float(_dates(a))) for a, b in own]
        ax.broken_barh(
            bars, (row - 0.32, 0.64), facecolor=LOOK[name][0], edgecolor="none", gid=f"times-{name}"
        )
        without = whole[1] - whole[0] - length_s(own)
        words = "no gap"
        if without > 0.05:
            words = f"{without:.1f} s without, longest {longest_gap_s(own, whole):.1f} s"
        ax.annotate(
            f"{IN_WORDS[name]}: {words}", (0.006, row), xycoords=("axes fraction", "data"), ha="left",
            va="center", fontsize=7, gid="times-words", zorder=5,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"},
        )  # fmt: skip
    ax.set_ylim(len(spans) - 0.5, -0.5)
    ax.set_yticks([])
    ax.set_ylabel("poses")
    ax.set_title("d: times with a pose")


def _time_axis(panels: list[Axes], trajectories: list[Trajectory]) -> tuple[float, float]:
    start = min(float(trajectory.t_gps_s[0]) for trajectory in trajectories)
    end = max(float(trajectory.t_gps_s[-1]) for trajectory in trajectories)
    locator = mdates.AutoDateLocator(tz=dt.UTC, minticks=4, maxticks=8)  # type: ignore[no-untyped-call]
    form = mdates.ConciseDateFormatter(locator, tz=dt.UTC, show_offset=False)  # type: ignore[no-untyped-call]
    panels[-1].set_xlim(float(_dates(start)), float(_dates(end)))
    panels[-1].xaxis.set_major_locator(locator)
    panels[-1].xaxis.set_major_formatter(form)
    panels[-1].set_xlabel(f"UTC on {utc_text_from_gps(start)[:10]} / h:min:s")
    return start, end


def _dates(t_gps_s: ArrayF | float) -> ArrayF:
    """Matplotlib's date numbers (days since 1970) of adjusted GPS times."""
    return np.asarray(unix_from_gps(t_gps_s)) / 86_400.0
