"""Plan views of a survey (P1 Fig. 3)."""

from typing import Final, Literal

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from thalweg.core.errors import GeometryError
from thalweg.core.timescales import utc_text_from_gps
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF
from thalweg.figures.style import (
    DEPTH_MAP,
    RED,
    TIME_MAP,
    count,
    fix_looks,
    legend_below,
    new_figure,
    north_arrow,
    plan_height_mm,
    plural,
    robust_limits,
    scale_bar,
    styled,
)

GOOD_FIXES: Final = ("fixed", "ppp")
"""Fixes that get no mark of their own on the track."""

LOG_RATIO: Final = 12.0
"""Largest over smallest sigma from which a logarithmic scale shows both."""

SHAPE: Final = (0.35, 1.2)
"""Least and largest height over width of a map; a longer reach gets free land beside it."""

GRID_PX: Final = 900
"""Longer side of the grey picture of the cloud."""


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
            soundings[:, 0], soundings[:, 1], c=soundings[:, 2], s=9, cmap=DEPTH_MAP, lw=0, rasterized=True,
            label=f"soundings, n = {count(len(soundings))}", zorder=3,
        )  # fmt: skip
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
            en[edge, 0], en[edge, 1], ls="none", marker="o", ms=4, mfc="none", mec=RED, mew=1.0, zorder=6,
            label=f"ends of {plural(len(gaps), 'gap')}, {total:.1f} s without a pose",
        )  # fmt: skip
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
    for fix, colour, marker in fix_looks(fixes):
        here = fixes == fix
        label = f"{fix.replace('_', ' ')}, n = {count(int(here.sum()))} epochs"
        if fix in GOOD_FIXES:
            ax.plot([], [], color="0.3", lw=1.8, label=label)
            continue
        ax.plot(
            enu[here, 0], enu[here, 1], ls="none", marker=marker, ms=4, mew=0.9, color=colour, zorder=5,
            label=label, rasterized=True,
        )  # fmt: skip


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
        value.reshape(shape[1], shape[0]), origin="lower", cmap="gray", vmin=a - 1.6 * (b - a),
        vmax=b + 0.25 * (b - a), zorder=1, gid="cloud",
        extent=(low[0], low[0] + shape[0] * cell, low[1], low[1] + shape[1] * cell),
    )  # fmt: skip
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
