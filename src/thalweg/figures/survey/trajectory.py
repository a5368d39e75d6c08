"""The trajectory with its sigmas and gaps: where it is weak, for how long, and in what."""

import datetime as dt
from collections.abc import Sequence
from typing import Any, Final

import matplotlib.dates as mdates
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from thalweg.core.errors import GeometryError
from thalweg.core.timescales import unix_from_gps, utc_text_from_gps
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF, ArrayI
from thalweg.figures.style import (
    BLUE,
    GREEN,
    HALO,
    RED,
    SIGMA_MAP,
    VERMILION,
    count,
    legend_below,
    new_figure,
    north_arrow,
    plan_height_mm,
    plural,
    scale_bar,
    styled,
)
from thalweg.figures.survey.maps import LOG_RATIO, draw_ends, map_extent, plain_numbers, sigma_norm

MOST_SEGMENTS: Final = 20_000
"""A track of more pieces is thinned: at this width a longer one shows nothing more."""

N_BINS: Final = 120
"""Bins of the share of valid nodes over the time axis."""

LABEL_SHARE: Final = 0.022
"""Width of the number of a gap as a share of an axis; nearer ones share a label."""

MAP_MM: Final = 120.0
"""Highest map: the four panels below it share the page."""

_PANELS_MM: Final = 92.0
_AXES_LOOK: Final = ((BLUE, "-"), (VERMILION, "--"), (GREEN, "-."))


@styled
def trajectory_sheet(
    trajectory: Trajectory,
    gaps: Sequence[tuple[float, float]] = (),
    *,
    title: str = "Trajectory",
    twin: bool = False,
) -> Figure:
    """Plan view coloured by horizontal sigma with numbered gaps; below it all sigmas and gaps over time.

    Parameters
    ----------
    trajectory : nodes of the ics origin with their covariances.
    gaps : start (adjusted GPS time) and length in seconds of known holes; joined with those that the nodes
        themselves show, see `gap_intervals`.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    GeometryError : no valid node, or none with a finite sigma.
    """
    valid = trajectory.valid
    if not valid.any():
        raise GeometryError(
            "a trajectory without a valid node",
            expected="at least one pose to draw",
            cure="Look at orientation/trajectory.json: which positions and attitudes were left out, and why",
        )
    sigma_m = np.where(valid[:, None], trajectory.sigma_position_m, np.nan)
    sigma_deg = np.rad2deg(np.where(valid[:, None], trajectory.sigma_roll_pitch_heading_rad(), np.nan))
    if not np.isfinite(sigma_m).any():
        raise GeometryError(
            "no valid node has a finite sigma of its position", expected="a covariance at each valid node"
        )
    holes = gap_intervals(trajectory, gaps)
    low, high = map_extent(trajectory.position_wcs_m[valid, :2], None)
    map_mm = min(plan_height_mm(high[0] - low[0], high[1] - low[1]), MAP_MM)
    head = f"{title}, n = {count(int(valid.sum()))} valid poses of {count(len(valid))}"
    head += f", {plural(len(holes), 'gap')}"
    if holes:
        head += f" of {sum(b - a for a, b in holes):.1f} s in all"
    figure = new_figure(map_mm + _PANELS_MM, head, twin=twin)
    shares = [map_mm, *(_PANELS_MM * share for share in (0.38, 0.38, 0.24))]
    plan, *panels = figure.subplots(4, 1, height_ratios=shares)
    _draw_plan(figure, plan, trajectory, np.hypot(sigma_m[:, 0], sigma_m[:, 1]), holes, low, high)
    t = _dates(trajectory.t_gps_s)
    unit, factor = _unit(sigma_m)
    _draw_sigmas(panels[0], t, factor * sigma_m, ("east", "north", "up"), f"sigma of\nposition / {unit}")
    _draw_sigmas(panels[1], t, sigma_deg, ("roll", "pitch", "heading"), "sigma of\nattitude / °")
    _draw_share(panels[2], trajectory)
    span = _time_axis(panels, trajectory, holes)
    for ax in panels:
        _hatch(ax, holes, span)
    _number_gaps(panels[0], holes, span)
    figure.align_ylabels(panels)
    legend_below(figure, plan)
    return figure


def gap_intervals(
    trajectory: Trajectory, listed: Sequence[tuple[float, float]] = ()
) -> list[tuple[float, float]]:
    """Begin and end (adjusted GPS time) of all stretches without a pose, in order of time.

    A hole between two valid nodes reaches from the one to the other, also where only one invalid node stands
    between them; invalid nodes before the first and behind the last valid one count too. Listed gaps that
    overlap or touch such a hole are the same gap, and the union is returned.

    Parameters
    ----------
    trajectory : the nodes.
    listed : start and length in seconds of known holes.
    """
    t, valid = trajectory.t_gps_s, trajectory.valid
    index = np.flatnonzero(valid)
    found = [(float(a), float(a + length)) for a, length in listed if length > 0]
    broken = np.flatnonzero(np.diff(index) > 1)
    found += [(float(t[index[i]]), float(t[index[i + 1]])) for i in broken]
    if index.size and index[0] > 0:
        found.append((float(t[0]), float(t[index[0]])))
    if index.size and index[-1] < len(t) - 1:
        found.append((float(t[index[-1]]), float(t[-1])))
    joined: list[tuple[float, float]] = []
    for begin, end in sorted(found):
        if joined and begin <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(joined[-1][1], end))
        else:
            joined.append((begin, end))
    return joined


def valid_share(trajectory: Trajectory, edges_gps_s: ArrayF) -> ArrayF:
    """Share of the valid nodes in percent between neighbouring edges; NaN where there is no node."""
    n, _ = np.histogram(trajectory.t_gps_s, edges_gps_s)
    good, _ = np.histogram(trajectory.t_gps_s[trajectory.valid], edges_gps_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(n > 0, 100.0 * good / n, np.nan)


def _draw_plan(
    figure: Figure,
    ax: Axes,
    trajectory: Trajectory,
    sigma_m: ArrayF,
    holes: list[tuple[float, float]],
    low: ArrayF,
    high: ArrayF,
) -> None:
    ax.set_aspect("equal")
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    unit, factor = _unit(sigma_m)
    segments, values = _segments(trajectory, factor * sigma_m)
    lines = LineCollection(segments, cmap=SIGMA_MAP, lw=2.2, capstyle="round", zorder=4, gid="track")
    lines.set_array(values)
    lines.set_norm(sigma_norm(factor * sigma_m))
    lines.set_rasterized(len(segments) > 2000)
    ax.add_collection(lines, autolim=False)
    bar = figure.colorbar(
        lines, ax=ax, shrink=0.9, aspect=25, pad=0.01, extend="max",
        label=f"horizontal sigma √(σE² + σN²) / {unit}",
    )  # fmt: skip
    plain_numbers(bar.ax.yaxis, bar.norm)
    _draw_gaps(ax, trajectory, holes)
    draw_ends(ax, trajectory)
    origin = trajectory.frame
    ax.set_xlabel(f"east / m   (local frame at {origin.lat_deg:.5f}°, {origin.lon_deg:.5f}°)")
    ax.set_ylabel("north / m")
    scale_bar(ax, span_m=float(high[0] - low[0]))
    east_north = trajectory.position_wcs_m[trajectory.valid, :2]
    crowded = bool(np.any(np.all(east_north > high - np.array([0.12, 0.4]) * (high - low), axis=1)))
    north_arrow(ax, xy=(0.035 if crowded else 0.965, 0.95))


def _segments(trajectory: Trajectory, values: ArrayF) -> tuple[list[ArrayF], ArrayF]:
    """Pieces of the track between valid nodes, thinned, and the mean value of each."""
    n = len(trajectory.valid)
    step = max(1, -(-n // MOST_SEGMENTS))
    at: ArrayI = np.unique(np.append(np.arange(0, n, step), n - 1))
    invalid = np.concatenate([[0], np.cumsum(~trajectory.valid)])
    unbroken = invalid[at[1:] + 1] == invalid[at[:-1]]
    en = trajectory.position_wcs_m[at, :2]
    pieces = np.stack([en[:-1], en[1:]], axis=1)[unbroken]
    return list(pieces), 0.5 * (values[at[:-1]] + values[at[1:]])[unbroken]


def _draw_gaps(ax: Axes, trajectory: Trajectory, holes: list[tuple[float, float]]) -> None:
    """A dotted line across each gap with its number; those outside the first and last pose have no place."""
    t, en = trajectory.t_gps_s[trajectory.valid], trajectory.position_wcs_m[trajectory.valid, :2]
    before = np.array([np.searchsorted(t, begin, side="right") - 1 for begin, _ in holes], dtype=np.int64)
    after = np.array([np.searchsorted(t, end, side="left") for _, end in holes], dtype=np.int64)
    placed = np.flatnonzero((before >= 0) & (after < len(t)))
    for number, i in enumerate(placed):
        ax.plot(
            *en[[before[i], after[i]]].T, color=RED, lw=1.4, ls=":", marker="o", ms=3.5, mfc="white", mec=RED,
            zorder=6, gid="gap",
            label="" if number else f"{plural(len(placed), 'gap')} without a pose",
        )  # fmt: skip
    middles = 0.5 * (en[before[placed]] + en[after[placed]]) if placed.size else np.empty((0, 2))
    near_m = LABEL_SHARE * float(np.ptp(ax.get_xlim()))
    for group in _groups(middles, near_m):
        first, last = placed[group[0]], placed[group[-1]]
        east, north = (float(v) for v in en[after[last]] - en[before[first]])
        points = 10.0 / max(float(np.hypot(east, north)), 1e-9)
        at = middles[group].mean(axis=0)
        ax.annotate(
            _name(int(first), int(last)), (float(at[0]), float(at[1])), textcoords="offset points",
            xytext=(-north * points, east * points), ha="center", va="center", fontsize=7, fontweight="bold",
            color=RED, zorder=7, gid="gap-number", path_effects=HALO,
        )  # fmt: skip


def _groups(places: ArrayF, near: float) -> list[list[int]]:
    """Runs of neighbours in a list of places (n, k) that are nearer to each other than a distance."""
    groups: list[list[int]] = []
    for i in range(len(places)):
        if groups and float(np.linalg.norm(places[i] - places[groups[-1][-1]])) < near:
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def _name(first: int, last: int) -> str:
    """Number of a gap, or the first and last number of a group."""
    return f"{first + 1}" if first == last else f"{first + 1}–{last + 1}"


def _unit(sigma_m: ArrayF) -> tuple[str, float]:
    """Unit in which sigmas are shown, and its number in a metre."""
    return ("m", 1.0) if float(np.nanmax(sigma_m)) >= 1.0 else ("cm", 100.0)


def _draw_sigmas(ax: Axes, t: ArrayF, sigma: ArrayF, names: tuple[str, ...], label: str) -> None:
    for values, name, (colour, dash) in zip(sigma.T, names, _AXES_LOOK, strict=True):
        ax.plot(t, values, color=colour, ls=dash, lw=1.2, label=name, gid=f"sigma-{name}")
    positive = sigma[np.isfinite(sigma) & (sigma > 0)]
    if positive.size and positive.max() > LOG_RATIO * positive.min():
        ax.set_yscale("log")
        ax.set_ylim(0.7 * float(positive.min()), 1.4 * float(positive.max()))
        plain_numbers(ax.yaxis, LogNorm())
    else:
        ax.set_ylim(0.0, 1.15 * (float(positive.max()) if positive.size else 1.0))
    ax.set_ylabel(label)
    # It stands in the free space below the colour bar of the map, which it must not push aside.
    legend = ax.legend(
        loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, borderaxespad=0.0, borderpad=0.2,
        handlelength=1.0, handletextpad=0.3,
    )  # fmt: skip
    legend.set_in_layout(False)


def _draw_share(ax: Axes, trajectory: Trajectory) -> None:
    t = trajectory.t_gps_s
    edges = np.linspace(t[0], np.nextafter(t[-1], np.inf), min(N_BINS, len(t)) + 1)
    share = valid_share(trajectory, edges)
    ax.stairs(np.nan_to_num(share), _dates(edges), fill=True, color="0.6", gid="share")
    ax.set_ylim(0, 108)
    ax.set_yticks([0, 50, 100])
    ax.set_ylabel("valid\nnodes / %")


def _time_axis(
    panels: Sequence[Axes], trajectory: Trajectory, holes: list[tuple[float, float]]
) -> tuple[float, float]:
    """One UTC axis for all panels; returns its limits in adjusted GPS time."""
    start = min([float(trajectory.t_gps_s[0]), *(a for a, _ in holes)])
    end = max([float(trajectory.t_gps_s[-1]), *(b for _, b in holes)])
    pad = 0.01 * (end - start)
    for ax in panels:
        ax.set_xlim(float(_dates(start - pad)), float(_dates(end + pad)))
        locator = mdates.AutoDateLocator(tz=dt.UTC, minticks=4, maxticks=8)  # type: ignore[no-untyped-call]
        form = mdates.ConciseDateFormatter(locator, tz=dt.UTC, show_offset=False)  # type: ignore[no-untyped-call]
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(form)
        ax.grid(axis="both")
        ax.tick_params(labelbottom=ax is panels[-1])
    panels[-1].set_xlabel(f"UTC on {utc_text_from_gps(start)[:10]} / h:min:s")
    return start - pad, end + pad


def _hatch(ax: Axes, holes: list[tuple[float, float]], span: tuple[float, float]) -> None:
    least = 0.002 * (span[1] - span[0])
    for begin, end in holes:
        more = 0.5 * max(0.0, least - (end - begin))
        look: dict[str, Any] = {"facecolor": "1.0", "edgecolor": RED, "hatch": "//////", "lw": 0.5}
        ax.axvspan(float(_dates(begin - more)), float(_dates(end + more)), zorder=1.5, gid="gap-span", **look)


def _number_gaps(ax: Axes, holes: list[tuple[float, float]], span: tuple[float, float]) -> None:
    """Number and length of the gaps above the upper panel; neighbours share a label."""
    middles = np.array([[0.5 * (begin + end)] for begin, end in holes]).reshape(-1, 1)
    near = LABEL_SHARE * (span[1] - span[0])
    groups = _groups(middles, 2.0 * near)
    places = [float(middles[group].mean()) for group in groups]
    for i, (group, place) in enumerate(zip(groups, places, strict=True)):
        text = _name(group[0], group[-1])
        room = min([abs(place - other) for j, other in enumerate(places) if j != i], default=np.inf)
        if room > 5.0 * near:
            text += f": {sum(holes[k][1] - holes[k][0] for k in group):.1f} s"
        ax.annotate(
            text, (float(_dates(place)), 1.02), xycoords=("data", "axes fraction"), ha="center", va="bottom",
            fontsize=7, color=RED, gid="gap-length",
        )  # fmt: skip


def _dates(t_gps_s: ArrayF | float) -> ArrayF:
    """Matplotlib's date numbers (days since 1970) of adjusted GPS times."""
    return np.asarray(unix_from_gps(t_gps_s)) / 86_400.0
