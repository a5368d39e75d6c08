"""Where the survey went: map, trajectory with its sigmas and gaps."""

import datetime as dt
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import matplotlib.dates as mdates
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import ArrayLike
from scipy.stats import binned_statistic_2d

from thalweg.core import ArrayF, GeometryError, Trajectory, unix_from_gps, utc_text_from_gps
from thalweg.figures import (
    BLUE,
    GREEN,
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
MAP_MM: Final = 120.0
"""Highest map: the panels below it share the page."""
_PANELS_MM: Final = 75.0
_AXES_STYLE: Final = ((BLUE, "-"), (VERMILION, "--"), (GREEN, "-."))


# ---------------------------------------------------------------- map (P1 Fig. 3)


@styled
def survey_map(
    trajectory: Trajectory,
    positions: pd.DataFrame | None = None,
    *,
    points: Sequence[Path] = (),
    max_points: int = 0,
    crs: str = "",
    title: str = "Survey map",
) -> Figure:
    """Track of the boat in plan view by time, with fix quality, gaps and cloud.

    Parameters
    ----------
    trajectory : nodes of the ics origin; pieces between invalid nodes are drawn apart.
    positions : table `thalweg.ingest.GNSS_POSITION`; those not fixed are marked where the antenna was.
    points : none, or a cloud for a grey picture behind the track, of which at most ``max_points`` are read.
    crs : name of the map grid of the campaign, for the note on frames.
    title : first words of the title.
    """
    valid = trajectory.valid
    east_north = trajectory.position_wcs_m[:, :2]
    cloud = sample_cloud(points[0], max_points)["xyz_m"] if points else None
    low, high = map_extent(east_north[valid], cloud)
    first, last = (utc_text_from_gps(t, 0) for t in trajectory.span())
    head = f"{title}, n = {count(valid.sum())} poses, {first[:10]} {first[11:19]} to {last[11:19]} UTC"
    figure = new_figure(plan_height_mm(high[0] - low[0], high[1] - low[1]), head)
    ax = figure.add_subplot()
    if cloud is not None and len(cloud):
        _draw_cloud(ax, cloud, low, high)
    elapsed = trajectory.t_gps_s - trajectory.t_gps_s[valid][0]
    scale = Normalize(0.0, elapsed[valid][-1])
    lines = _draw_plan(ax, trajectory, elapsed, TIME_MAP, scale, (low, high), grid=crs)
    figure.colorbar(lines, ax=ax, label="time since the start / s", shrink=0.8, aspect=30, pad=0.01)
    if gaps := track_gaps(trajectory):
        edge = np.zeros(len(valid), dtype=bool)
        edge[:-1] |= valid[:-1] & ~valid[1:]
        edge[1:] |= valid[1:] & ~valid[:-1]
        words = f"ends of {plural(len(gaps), 'gap')}, {sum(s for _, s in gaps):.1f} s without a pose"
        ax.plot(*east_north[edge].T, "o", ms=4, mfc="none", color=RED, zorder=6, label=words)
    if positions is not None:
        _draw_fixes(ax, trajectory, positions)
    legend_below(figure, ax)
    return figure


def _draw_plan(
    ax: Axes,
    trajectory: Trajectory,
    values: ArrayF,
    colours: Colormap,
    scale: Normalize,
    box: tuple[ArrayF, ArrayF],
    *,
    grid: str = "",
) -> LineCollection:
    """A track by a value of each node (n,), thinned, broken at gaps, in a plan with bar, arrow and ends."""
    n, (low, high), frame = len(trajectory.valid), box, trajectory.frame
    at = np.unique(np.append(np.arange(0, n, max(1, -(-n // MOST_SEGMENTS))), n - 1))
    invalid = np.concatenate([[0], np.cumsum(~trajectory.valid)])
    unbroken = invalid[at[1:] + 1] == invalid[at[:-1]]
    en = trajectory.position_wcs_m[at, :2]
    pieces = np.stack([en[:-1], en[1:]], axis=1)[unbroken]
    lines = LineCollection(list(pieces), cmap=colours, norm=scale, lw=2, capstyle="round", gid="track")
    lines.set_array(0.5 * (values[at[:-1]] + values[at[1:]])[unbroken])
    lines.set(zorder=4, rasterized=len(pieces) > 2000)
    ax.add_collection(lines, autolim=False)
    ax.set_aspect("equal")
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    draw_ends(ax, trajectory)
    grid = f"; map grid {grid}" if grid else ""
    ax.set_xlabel(f"east / m   (local frame at {frame.lat_deg:.5f}°, {frame.lon_deg:.5f}°{grid})")
    ax.set_ylabel("north / m")
    scale_bar(ax, span_m=float(high[0] - low[0]))
    crowded = np.any(np.all(en > high - np.array([0.12, 0.4]) * (high - low), axis=1))
    north_arrow(ax, xy=(0.035 if crowded else 0.965, 0.95))
    return lines


def track_gaps(trajectory: Trajectory) -> list[tuple[float, float]]:
    """Start (adjusted GPS time) and length in seconds of the stretches without a usable pose."""
    t = trajectory.t_gps_s[trajectory.valid]
    broken = np.flatnonzero(np.diff(np.flatnonzero(trajectory.valid)) > 1)
    return [(float(t[i]), float(t[i + 1] - t[i])) for i in broken]


def track_length_m(trajectory: Trajectory) -> float:
    """Horizontal length of the track by seconds: the noise of each pose is no way travelled."""
    _, by_second = np.unique(trajectory.t_gps_s[trajectory.valid].astype(np.int64), return_index=True)
    steps = np.diff(trajectory.position_wcs_m[trajectory.valid, :2][by_second], axis=0)
    return float(np.hypot(*steps.T).sum())


def centre_in_words(trajectory: Trajectory) -> str:
    """Latitude and longitude of the middle of the track: ``51.0500° N, 13.2500° E``."""
    middle = trajectory.position_wcs_m[trajectory.valid].mean(axis=0)
    (lat,), (lon,), _ = trajectory.frame.to_geodetic(middle[None])
    return f"{abs(lat):.4f}°\u00a0{'N' if lat >= 0 else 'S'}, {abs(lon):.4f}°\u00a0{'E' if lon >= 0 else 'W'}"


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
        bulk = np.percentile(cloud[:: max(1, len(cloud) // 200_000), :2], [1, 99], axis=0)
        low, high = np.minimum(low, bulk[0]), np.maximum(high, bulk[1])
    margin = 0.05 * max(float(np.max(high - low)), 1.0)
    # The scale bar stands in the free strip below.
    low, high = low - margin * np.array([1.0, 1.8]), high + margin
    width, height = high - low
    more = 0.5 * np.array([max(0.0, height / SHAPE[1] - width), max(0.0, SHAPE[0] * width - height)])
    return low - more, high + more


def _draw_fixes(ax: Axes, trajectory: Trajectory, positions: pd.DataFrame) -> None:
    """Mark the epochs whose fix is not a good one; the legend counts all."""
    frame, (first, last) = trajectory.frame, trajectory.t_gps_s[[0, -1]]
    use = positions[positions["t_gps_s"].between(first - 1.0, last + 1.0)]
    place = use["lat_deg"], use["lon_deg"], use["h_ell_m"].fillna(frame.h_ell_m)
    enu = frame.from_geodetic(*(each.to_numpy() for each in place))
    fixes = use["fix"].to_numpy()
    for fix, colour, marker in fix_styles(fixes):
        here = fixes == fix
        label = f"{fix.replace('_', ' ')}, n = {count(here.sum())} epochs"
        if fix in GOOD_FIXES:
            ax.plot([], [], color="0.3", lw=1.8, label=label)
        else:
            ax.plot(
                *enu[here, :2].T,
                ls="none",
                marker=marker,
                ms=4,
                color=colour,
                rasterized=True,
                zorder=5,
                label=label,
            )


def track_of(trajectory: Trajectory) -> ArrayF:
    """East and north (n, 2) of all nodes; NaN, at which a line breaks, where there is no pose."""
    return np.where(trajectory.valid[:, None], trajectory.position_wcs_m[:, :2], np.nan)


def draw_ends(ax: Axes, trajectory: Trajectory) -> None:
    """Mark where the track begins and where it ends."""
    en = trajectory.position_wcs_m[trajectory.valid, :2]
    for point, name, face in ((en[0], "start", "white"), (en[-1], "end", "black")):
        ax.plot(*point, "D", ms=5.5, mfc=face, mec="black", mew=1.0, zorder=8, label=name)


def _draw_cloud(ax: Axes, cloud: ArrayF, low: ArrayF, high: ArrayF) -> None:
    """Mean height of the cloud per cell as a light grey picture."""
    shape = np.maximum(np.ceil(GRID_PX * (high - low) / np.max(high - low)).astype(int), 1)
    x, y, z = cloud.T
    height = binned_statistic_2d(x, y, z, bins=shape, range=np.transpose([low, high]).tolist()).statistic
    a, b = robust_limits(height, 2, 98)
    # The lower half of the grey scale stays free for the track.
    ax.imshow(
        height.T, origin="lower", cmap="gray", vmin=a - 1.6 * (b - a), vmax=b + 0.25 * (b - a),
        extent=(low[0], high[0], low[1], high[1]), zorder=1,
    )  # fmt: skip
    ax.plot([], [], "s", color="0.75", label=f"cloud, n = {count(len(cloud))} points drawn")


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


# ---------------------------------------------------------------- trajectory


@styled
def trajectory_sheet(trajectory: Trajectory, *, title: str = "Trajectory") -> Figure:
    """Plan view coloured by horizontal sigma with gaps; below it all sigmas and gaps over time.

    Parameters
    ----------
    trajectory : nodes of the ics origin with their covariances.
    title : first words of the title.

    Raises
    ------
    GeometryError : no valid node, or none with a finite sigma.
    """
    valid, t = trajectory.valid, trajectory.t_gps_s
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
    holes = gap_intervals(trajectory)
    low, high = map_extent(trajectory.position_wcs_m[valid, :2], None)
    map_mm = min(plan_height_mm(high[0] - low[0], high[1] - low[1]), MAP_MM)
    head = f"{title}, n = {count(valid.sum())} valid poses of {count(len(valid))}"
    head += f", {plural(len(holes), 'gap')}"
    if holes:
        head += f" of {sum(b - a for a, b in holes):.1f} s in all"
    figure = new_figure(map_mm + _PANELS_MM, head)
    plan, *panels = figure.subplots(3, 1, height_ratios=[map_mm, 0.5 * _PANELS_MM, 0.5 * _PANELS_MM])
    unit, factor = ("m", 1.0) if np.nanmax(sigma_m) >= 1.0 else ("cm", 100.0)
    horizontal = factor * np.hypot(sigma_m[:, 0], sigma_m[:, 1])
    scale = sigma_norm(horizontal)
    lines = _draw_plan(plan, trajectory, horizontal, SIGMA_MAP, scale, (low, high))
    words = f"horizontal sigma √(σE² + σN²) / {unit}"
    bar = figure.colorbar(lines, ax=plan, shrink=0.9, aspect=25, pad=0.01, extend="max", label=words)
    plain_numbers(bar.ax.yaxis, scale)
    en, poses_s = trajectory.position_wcs_m[valid, :2], t[valid]
    for a, b in holes:
        ends = np.searchsorted(poses_s, [a, b])
        if poses_s[0] <= a and b <= poses_s[-1]:  # others have no place in plan
            plan.plot(*en[ends].T, "o:", color=RED, lw=1.4, ms=3.5, mfc="white", zorder=6, gid="gap")
    _draw_sigmas(panels[0], t, factor * sigma_m, ("east", "north", "up"), f"sigma of\nposition / {unit}")
    _draw_sigmas(panels[1], t, sigma_deg, ("roll", "pitch", "heading"), "sigma of\nattitude / °")
    for ax in panels:
        utc_axis(ax, float(t[0]), float(t[-1]))
        least_s = 0.002 * (t[-1] - t[0])
        for a, b in holes:
            more = 0.5 * max(0.0, least_s - (b - a))
            ax.axvspan(
                date_of(a - more),
                date_of(b + more),
                zorder=1.5,
                facecolor="1.0",
                edgecolor=RED,
                hatch="//////",
                lw=0.5,
            )
    panels[0].tick_params(labelbottom=False)
    panels[0].set_xlabel("")
    figure.align_ylabels(panels)
    legend_below(figure, plan)
    return figure


def gap_intervals(trajectory: Trajectory) -> list[tuple[float, float]]:
    """Begin and end (adjusted GPS time) of all stretches without a pose, in order of time.

    A hole between two valid nodes reaches from the one to the other, also where only one invalid node stands
    between them; invalid nodes before the first and behind the last valid one count too.
    """
    t, valid = trajectory.t_gps_s, trajectory.valid
    ends = np.unique(np.append(np.flatnonzero(valid), [0, len(t) - 1]))
    return [(float(t[a]), float(t[b])) for a, b in pairwise(ends) if b - a > 1 or not (valid[a] and valid[b])]


def _draw_sigmas(ax: Axes, t_gps_s: ArrayF, sigma: ArrayF, names: tuple[str, ...], label: str) -> None:
    for values, name, (colour, dash) in zip(sigma.T, names, _AXES_STYLE, strict=True):
        ax.plot(date_of(t_gps_s), values, color=colour, ls=dash, lw=1.2, label=name, gid=f"sigma-{name}")
    positive = sigma[np.isfinite(sigma) & (sigma > 0)]
    if positive.size and positive.max() > LOG_RATIO * positive.min():
        ax.set_yscale("log")
        ax.set_ylim(0.7 * positive.min(), 1.4 * positive.max())
        plain_numbers(ax.yaxis, LogNorm())
    else:
        ax.set_ylim(0.0, 1.15 * (float(positive.max()) if positive.size else 1.0))
    ax.set_ylabel(label)
    ax.grid(axis="both")
    # It stands in the free space below the colour bar of the map, which it must not push aside.
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, handlelength=1.0).set_in_layout(
        False
    )


def utc_axis(ax: Axes, start_gps_s: float, end_gps_s: float) -> None:
    """Limits, ticks and words of an axis of UTC."""
    pad = 0.01 * (end_gps_s - start_gps_s)
    ax.set_xlim(date_of(start_gps_s - pad), date_of(end_gps_s + pad))
    locator = mdates.AutoDateLocator(tz=dt.UTC, minticks=4, maxticks=8)  # type: ignore[no-untyped-call]
    form = mdates.ConciseDateFormatter(locator, tz=dt.UTC, show_offset=False)  # type: ignore[no-untyped-call]
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(form)
    ax.set_xlabel(f"UTC on {utc_text_from_gps(start_gps_s)[:10]} / h:min:s")


def date_of(t_gps_s: ArrayLike) -> Any:
    """Matplotlib's date numbers (days since 1970) of adjusted GPS times."""
    return unix_from_gps(t_gps_s) / 86_400.0
