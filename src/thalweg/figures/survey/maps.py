"""Where the survey went: map, trajectory with its sigmas and gaps."""

import datetime as dt
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import matplotlib.dates as mdates
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from thalweg.core import (
    ArrayB,
    ArrayF,
    ArrayI,
    GeometryError,
    Trajectory,
    read_table,
    unix_from_gps,
    utc_text_from_gps,
)
from thalweg.figures import (
    BLUE,
    DEPTH_MAP,
    GREEN,
    HALO,
    RED,
    SIGMA_MAP,
    TIME_MAP,
    VERMILION,
    count,
    fix_styles,
    legend_below,
    new_figure,
    north_arrow,
    plan_height_mm,
    plural,
    robust_limits,
    scale_bar,
    styled,
)
from thalweg.ingest import GNSS_POSITION
from thalweg.lidar import sample_cloud

GOOD_FIXES: Final = ("fixed", "ppp")
"""Fixes that get no mark of their own on the track."""
LOG_RATIO: Final = 12.0
"""Largest over smallest sigma from which a logarithmic scale shows both."""
SHAPE: Final = (0.35, 1.2)
"""Least and largest height over width of a map; a longer reach gets free land beside it."""
GRID_PX: Final = 900
"""Longer side of the grey picture of the cloud."""

MOST_SEGMENTS: Final = 20_000
"""A track of more pieces is thinned: at this width a longer one shows nothing more."""
N_BINS: Final = 120
"""Bins of the share of valid nodes over the time axis."""
LABEL_SHARE: Final = 0.022
"""Width of the number of a gap as a share of an axis; nearer ones share a label."""
MAP_MM: Final = 120.0
"""Highest map: the four panels below it share the page."""
_PANELS_MM: Final = 92.0
_AXES_STYLE: Final = ((BLUE, "-"), (VERMILION, "--"), (GREEN, "-."))


# ---------------------------------------------------------------- map (P1 Fig. 3)


@styled
def survey_map(
    trajectory: Trajectory,
    positions: pd.DataFrame | None = None,
    *,
    cloud_en: ArrayF | None = None,
    soundings: ArrayF | None = None,
    colour_by: Literal["time", "speed"] = "time",
    crs: str = "",
    title: str = "Survey map",
    twin: bool = False,
) -> Figure:
    """Track of the boat in plan view with fix quality, gaps, cloud and soundings.

    Parameters
    ----------
    trajectory : nodes of the ics origin; pieces between invalid nodes are drawn apart.
    positions : table ``GNSS_POSITION``; epochs that are not fixed are marked where the antenna was.
    cloud_en : (n, 2) east, north or (n, 3) with up, metres in wcs: grey picture behind the track.
    soundings : (n, 3) east, north in wcs and depth in metres.
    colour_by : what the colour of the track shows.
    crs : name of the map grid of the campaign, for the note on frames.
    title : first words of the title.
    twin : true if the digital twin made the data.
    """
    east_north = trajectory.position_wcs_m[:, :2]
    valid = trajectory.valid
    has_depth = soundings is not None and len(soundings) > 0
    shown = [east_north[valid]] + ([soundings[:, :2]] if soundings is not None else [])
    low, high = map_extent(np.concatenate(shown), cloud_en)
    first, last = (utc_text_from_gps(t, 0) for t in trajectory.span())
    head = f"{title}, n = {count(int(valid.sum()))} poses, {first[:10]} {first[11:19]} to {last[11:19]} UTC"
    figure = new_figure(plan_height_mm(high[0] - low[0], high[1] - low[1]), head, twin=twin)
    ax = figure.add_subplot()
    ax.set_aspect("equal")
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    if cloud_en is not None and len(cloud_en):
        _draw_cloud(ax, cloud_en, low, high)
    lines = _draw_track(ax, trajectory, colour_by)
    if soundings is not None and has_depth:
        # Soundings lie on the track: they take its place, and the track becomes a thin line.
        lines.set(array=None, color="black", linewidth=0.5)
        dots = ax.scatter(
            soundings[:, 0],
            soundings[:, 1],
            c=soundings[:, 2],
            s=9,
            cmap=DEPTH_MAP,
            lw=0,
            rasterized=True,
            label=f"soundings, n = {count(len(soundings))}",
            zorder=3,
        )
        figure.colorbar(dots, ax=ax, label="depth / m", shrink=0.8, aspect=30, pad=0.01)
    else:
        label = "time since the start / s" if colour_by == "time" else "speed over ground / (m/s)"
        figure.colorbar(lines, ax=ax, label=label, shrink=0.8, aspect=30, pad=0.01)
    if positions is not None:
        _draw_fixes(ax, trajectory, positions)
    draw_ends(ax, trajectory)
    origin = trajectory.frame
    grid = f"; map grid {crs}" if crs else ""
    ax.set_xlabel(f"east / m   (local frame at {origin.lat_deg:.5f}°, {origin.lon_deg:.5f}°{grid})")
    ax.set_ylabel("north / m")
    scale_bar(ax, span_m=float(high[0] - low[0]))
    crowded = np.sum(np.all(east_north[valid] > high - 0.2 * (high - low), axis=1)) > 0
    north_arrow(ax, xy=(0.035 if crowded else 0.965, 0.95))
    legend_below(figure, ax)
    return figure


def track_gaps(trajectory: Trajectory) -> list[tuple[float, float]]:
    """Start (adjusted GPS time) and length in seconds of the stretches without a usable pose."""
    t = trajectory.t_gps_s[trajectory.valid]
    index = np.flatnonzero(trajectory.valid)
    broken = np.flatnonzero(np.diff(index) > 1)
    return [(float(t[i]), float(t[i + 1] - t[i])) for i in broken]


def map_extent(track: ArrayF, cloud: ArrayF | None) -> tuple[ArrayF, ArrayF]:
    """Lower and upper east, north of a map: the track with the bulk of the cloud and a margin.

    Parameters
    ----------
    track : (n, 2) east, north in wcs.
    cloud : (m, 2) or (m, 3) in wcs; its outermost percent on each side has no say.

    Raises
    ------
    GeometryError : a track without a point.
    """
    if not len(track):
        raise GeometryError("a trajectory without a valid node", expected="at least one pose to draw")
    low, high = track.min(axis=0), track.max(axis=0)
    if cloud is not None and len(cloud):
        step = max(1, len(cloud) // 200_000)
        bulk = np.percentile(cloud[::step, :2], [1, 99], axis=0)
        low, high = np.minimum(low, bulk[0]), np.maximum(high, bulk[1])
    margin = 0.05 * max(float(np.max(high - low)), 1.0)
    # The scale bar stands in the free strip below.
    low, high = low - margin * np.array([1.0, 1.8]), high + margin
    width, height = high - low
    more = 0.5 * np.array([max(0.0, height / SHAPE[1] - width), max(0.0, SHAPE[0] * width - height)])
    return low - more, high + more


def _pieces(trajectory: Trajectory) -> ArrayB:
    """(n - 1,) true where two neighbouring nodes are valid, so that poses lie between them."""
    return np.asarray(trajectory.valid[1:] & trajectory.valid[:-1])


def _draw_track(ax: Axes, trajectory: Trajectory, colour_by: str) -> LineCollection:
    both = _pieces(trajectory)
    en = trajectory.position_wcs_m[:, :2]
    segments = np.stack([en[:-1], en[1:]], axis=1)[both]
    t = trajectory.t_gps_s
    if colour_by == "time":
        start = t[trajectory.valid][0]
        values = (0.5 * (t[:-1] + t[1:]) - start)[both]
        limits = (0.0, float(t[trajectory.valid][-1] - start))
    else:
        values = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1) / np.diff(t)[both]
        limits = robust_limits(values)
    lines = LineCollection(list(segments), cmap=TIME_MAP, lw=1.8, capstyle="round", zorder=4, gid="track")
    lines.set_array(values)
    lines.set_clim(*limits)
    ax.add_collection(lines, autolim=False)
    gaps = track_gaps(trajectory)
    if gaps:
        valid = trajectory.valid
        edge = np.zeros(len(valid), dtype=bool)
        edge[:-1] |= valid[:-1] & ~valid[1:]
        edge[1:] |= valid[1:] & ~valid[:-1]
        total = sum(duration for _, duration in gaps)
        ax.plot(
            en[edge, 0],
            en[edge, 1],
            ls="none",
            marker="o",
            ms=4,
            mfc="none",
            mec=RED,
            mew=1.0,
            zorder=6,
            label=f"ends of {plural(len(gaps), 'gap')}, {total:.1f} s without a pose",
        )
    return lines


def _draw_fixes(ax: Axes, trajectory: Trajectory, positions: pd.DataFrame) -> None:
    """Mark the epochs whose fix is not a good one; the legend counts all."""
    frame = trajectory.frame
    first, last = trajectory.t_gps_s[0], trajectory.t_gps_s[-1]
    t = positions["t_gps_s"].to_numpy()
    use = positions[(t >= first - 1.0) & (t <= last + 1.0)]
    height = use["h_ell_m"].fillna(frame.h_ell_m)
    enu = frame.from_geodetic(use["lat_deg"].to_numpy(), use["lon_deg"].to_numpy(), height.to_numpy())
    fixes = use["fix"].to_numpy()
    for fix, colour, marker in fix_styles(fixes):
        here = fixes == fix
        label = f"{fix.replace('_', ' ')}, n = {count(int(here.sum()))} epochs"
        if fix in GOOD_FIXES:
            ax.plot([], [], color="0.3", lw=1.8, label=label)
            continue
        ax.plot(
            enu[here, 0],
            enu[here, 1],
            ls="none",
            marker=marker,
            ms=4,
            mew=0.9,
            color=colour,
            zorder=5,
            label=label,
            rasterized=True,
        )


def draw_ends(ax: Axes, trajectory: Trajectory) -> None:
    """Mark where the track begins and where it ends."""
    en = trajectory.position_wcs_m[trajectory.valid, :2]
    for point, name, face in ((en[0], "start", "white"), (en[-1], "end", "black")):
        ax.plot(*point, ls="none", marker="D", ms=5.5, mfc=face, mec="black", mew=1.0, zorder=8, label=name)


def _draw_cloud(ax: Axes, cloud: ArrayF, low: ArrayF, high: ArrayF) -> None:
    """Mean height of the cloud per cell (density, without heights) as a light grey picture."""
    cell = float(np.max(high - low)) / GRID_PX
    shape = np.maximum(np.ceil((high - low) / cell).astype(np.int64), 1)
    index = np.floor((cloud[:, :2] - low) / cell)
    inside = np.all((index >= 0) & (index < shape), axis=1)
    flat = (index[inside, 1] * shape[0] + index[inside, 0]).astype(np.int64)
    n = np.bincount(flat, minlength=int(shape.prod())).astype(np.float64)
    if cloud.shape[1] > 2:
        total = np.bincount(flat, weights=cloud[inside, 2], minlength=int(shape.prod()))
        value = np.where(n > 0, total / np.maximum(n, 1), np.nan)
    else:
        value = np.where(n > 0, np.log10(np.maximum(n, 1)), np.nan)
    a, b = robust_limits(value, 2, 98)
    # The lower half of the grey scale stays free for the track.
    ax.imshow(
        value.reshape(shape[1], shape[0]),
        origin="lower",
        cmap="gray",
        vmin=a - 1.6 * (b - a),
        vmax=b + 0.25 * (b - a),
        zorder=1,
        gid="cloud",
        extent=(low[0], low[0] + shape[0] * cell, low[1], low[1] + shape[1] * cell),
    )
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.plot([], [], ls="none", marker="s", color="0.75", label=f"cloud, n = {count(len(cloud))} points drawn")


def sigma_norm(sigma: ArrayF) -> Normalize:
    """Colour scale of sigmas: logarithmic where they differ much, never narrower than a fifth of its middle.

    Without the second, rounding errors of a constant sigma would fill the whole scale.
    """
    finite = sigma[np.isfinite(sigma) & (sigma > 0)]
    if not finite.size:
        return Normalize(0.0, 1.0)
    low, high = (float(v) for v in np.percentile(finite, [0.5, 99.5]))
    if high > LOG_RATIO * low:
        return LogNorm(low, high)
    middle = 0.5 * (low + high)
    half = max(0.5 * (high - low), 0.1 * middle)
    return Normalize(middle - half, middle + half)


def plain_numbers(axis: Axis, norm: Normalize) -> None:
    """Numbers such as 0.05 and 20 in place of powers of ten, if the scale is logarithmic."""
    if isinstance(norm, LogNorm):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def draw_survey_map(
    *,
    trajectory: Path,
    positions: Path,
    points: list[Path],
    max_points: int,
    crs: str,
    title: str,
    twin: bool,
) -> Figure:
    """Trajectory, positions and cloud -> survey map."""
    return survey_map(
        Trajectory.read(trajectory),
        read_table(positions, GNSS_POSITION)[0],
        cloud_en=sample_cloud(points[0], max_points)["xyz_m"] if points else None,
        crs=crs,
        title=f"Survey map: {title}",
        twin=twin,
    )


# ---------------------------------------------------------------- trajectory


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
        lines,
        ax=ax,
        shrink=0.9,
        aspect=25,
        pad=0.01,
        extend="max",
        label=f"horizontal sigma √(σE² + σN²) / {unit}",
    )
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
            *en[[before[i], after[i]]].T,
            color=RED,
            lw=1.4,
            ls=":",
            marker="o",
            ms=3.5,
            mfc="white",
            mec=RED,
            zorder=6,
            gid="gap",
            label="" if number else f"{plural(len(placed), 'gap')} without a pose",
        )
    middles = 0.5 * (en[before[placed]] + en[after[placed]]) if placed.size else np.empty((0, 2))
    near_m = LABEL_SHARE * float(np.ptp(ax.get_xlim()))
    for group in _groups(middles, near_m):
        first, last = placed[group[0]], placed[group[-1]]
        east, north = (float(v) for v in en[after[last]] - en[before[first]])
        points = 10.0 / max(float(np.hypot(east, north)), 1e-9)
        at = middles[group].mean(axis=0)
        ax.annotate(
            _name(int(first), int(last)),
            (float(at[0]), float(at[1])),
            textcoords="offset points",
            xytext=(-north * points, east * points),
            ha="center",
            va="center",
            fontsize=7,
            fontweight="bold",
            color=RED,
            zorder=7,
            gid="gap-number",
            path_effects=HALO,
        )


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
    for values, name, (colour, dash) in zip(sigma.T, names, _AXES_STYLE, strict=True):
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
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        frameon=False,
        borderaxespad=0.0,
        borderpad=0.2,
        handlelength=1.0,
        handletextpad=0.3,
    )
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
            text,
            (float(_dates(place)), 1.02),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="bottom",
            fontsize=7,
            color=RED,
            gid="gap-length",
        )


def _dates(t_gps_s: ArrayF | float) -> ArrayF:
    """Matplotlib's date numbers (days since 1970) of adjusted GPS times."""
    return np.asarray(unix_from_gps(t_gps_s)) / 86_400.0


def draw_trajectory(*, trajectory: Path, summary: Path, title: str, twin: bool) -> Figure:
    """Trajectory and its summary -> sheet of the track with sigmas and gaps."""
    gaps = [(float(start), float(length)) for start, length in json.loads(summary.read_text())["gaps"]]
    return trajectory_sheet(Trajectory.read(trajectory), gaps, title=f"Trajectory: {title}", twin=twin)
