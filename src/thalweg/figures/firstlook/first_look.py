"""The pictures that suit a recording, whatever it holds."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from thalweg.core import ArrayB, ArrayF, InputError, LocalFrame, utc_text_from_gps
from thalweg.figures import (
    BLUE,
    GREEN,
    GREY,
    INTENSITY_MAP,
    RING_MAP,
    VERMILION,
    Page,
    count,
    fix_styles,
    legend_below,
    new_figure,
    robust_limits,
    styled,
)
from thalweg.figures.cloud import cloud_overview
from thalweg.ingest import IntegrityReport
from thalweg.ingest.registry import Recording

MAX_DOTS: Final = 150_000
"""Most dots of a scatter plot; beyond it one of k points is drawn and the title says so."""
LEAST_REACH_M: Final = 0.5
"""Smallest half width of a plan view."""


# ---------------------------------------------------------------- first look


def first_looks_of(recording: Recording, *, title: str, twin: bool = False) -> dict[str, Figure]:
    """First pictures of a recording, one for each kind of data in it: name -> figure.

    Parameters
    ----------
    recording : from `load_recording`.
    title : first words of the titles.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : the recording holds nothing that could be drawn.
    """
    figures: dict[str, Figure] = {}
    if recording.points_scs_m is not None and recording.intensity is not None and recording.ring is not None:
        figures["points"] = lidar_first_look(
            recording.points_scs_m, recording.intensity, recording.ring, title=title, twin=twin
        )
    if recording.cloud_m is not None and len(recording.cloud_m):
        figures["cloud"] = cloud_overview(recording.cloud_m, title=title, twin=twin)
    for name, draw in (
        ("depths", depth_first_look),
        ("states", attitude_first_look),
        ("positions", track_first_look),
    ):
        table = recording.tables.get(name)
        if table is not None and not table.empty:
            figures[name] = draw(table, title=title, twin=twin)
    if not figures:
        raise InputError(
            "the recording holds no points, depths, attitudes or positions",
            where=", ".join(recording.report.files),
            cure="Look at its integrity report with `thalweg describe`",
        )
    return figures


# ---------------------------------------------------------------- first looks at single recordings: is this
# what the instrument should have seen?


@styled
def lidar_first_look(
    points_scs_m: ArrayLike,
    intensity: ArrayLike,
    ring: ArrayLike,
    *,
    title: str = "Lidar recording",
    twin: bool = False,
) -> Figure:
    """Plan view coloured by intensity and side view coloured by ring, in the scanner frame.

    Parameters
    ----------
    points_scs_m : (n, 3) points, x right, y forward, z up.
    intensity : (n,) as the scanner states it.
    ring : (n,) 0 is the lowest.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : no finite point.
    """
    points = np.asarray(points_scs_m, dtype=np.float64)
    finite = np.isfinite(points).all(axis=1)
    n = int(finite.sum())
    if not n:
        raise InputError("a recording without a finite point", expected="decoded lidar points")
    step = -(-n // MAX_DOTS)
    points = points[finite][::step]
    shown = np.asarray(intensity, dtype=np.float64)[finite][::step]
    rings = np.asarray(ring)[finite][::step]
    drawn = f", 1 of {step} drawn" if step > 1 else ""
    figure = new_figure(98.0, f"{title}, n = {count(n)} points{drawn}", twin=twin)
    plan, side = figure.subplots(1, 2, width_ratios=[1.0, 1.0])
    low, high = robust_limits(shown, 2, 98)
    reach = max(1.05 * float(np.percentile(np.abs(points[:, :2]), 99.5)), LEAST_REACH_M)
    dots = plan.scatter(
        *points[:, :2].T, c=shown, s=0.8, lw=0, cmap=INTENSITY_MAP, vmin=low, vmax=high, rasterized=True
    )
    plan.plot(0, 0, marker="+", color=VERMILION, ms=8, mew=1.2)
    plan.set(
        xlim=(-reach, reach),
        ylim=(-reach, reach),
        aspect="equal",
        xlabel="x (right) / m",
        ylabel="y (forward) / m",
        title="from above",
    )
    figure.colorbar(dots, ax=plan, label="intensity / 1", orientation="horizontal", aspect=35, extend="both")
    distance = np.hypot(points[:, 0], points[:, 1])
    dots = side.scatter(distance, points[:, 2], c=rings, s=0.8, lw=0, cmap=RING_MAP, rasterized=True)
    side.set_xlim(0, max(1.05 * float(np.percentile(distance, 99.5)), LEAST_REACH_M))
    side.set(xlabel="horizontal distance / m", ylabel="z (up) / m")
    side.set_title("from the side, all directions in one")
    a, b = robust_limits(points[:, 2], 0.2, 99.8)
    side.set_ylim(a - 0.05 * (b - a), b + 0.05 * (b - a))
    side.grid()
    figure.colorbar(dots, ax=side, label="ring / 1 (0 lowest)", orientation="horizontal", aspect=35)
    return figure


@styled
def track_first_look(positions: pd.DataFrame, *, title: str = "GNSS positions", twin: bool = False) -> Figure:
    """Plan view relative to the median position, height and stated sigma over time, coloured by fix.

    Parameters
    ----------
    positions : table ``GNSS_POSITION``; without GPS time the records are counted instead.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : no row with a position.
    """
    rows = positions[np.isfinite(positions["lat_deg"]) & np.isfinite(positions["lon_deg"])]
    if rows.empty:
        raise InputError("no epoch with a position", expected="at least one GNSS fix")
    height = rows["h_ell_m"].to_numpy(dtype=np.float64)
    known = np.isfinite(height)
    centre = LocalFrame(
        lat_deg=float(rows["lat_deg"].median()),
        lon_deg=float(rows["lon_deg"].median()),
        h_ell_m=float(np.median(height[known])) if known.any() else 0.0,
    )
    enu = centre.from_geodetic(
        rows["lat_deg"].to_numpy(), rows["lon_deg"].to_numpy(), np.where(known, height, centre.h_ell_m)
    )
    when, label = _time_axis(rows["t_gps_s"].to_numpy(dtype=np.float64), "epoch")
    figure = new_figure(100.0, f"{title}, n = {count(len(rows))} epochs", twin=twin)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.15, 1.0])
    plan = figure.add_subplot(grid[:, 0])
    up, sigma = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    fixes = rows["fix"].to_numpy()
    for fix, colour, marker in fix_styles(fixes):
        here = fixes == fix
        look: dict[str, Any] = {"ls": "none", "marker": marker, "ms": 3, "color": colour, "rasterized": True}
        plan.plot(
            enu[here, 0], enu[here, 1], **look, label=f"{fix.replace('_', ' ')}, n = {count(int(here.sum()))}"
        )
        up.plot(when[here], height[here], **look)
    plan.set(xlabel="east of the median / m", ylabel="north of the median / m", aspect="equal")
    plan.set_adjustable("datalim")
    plan.set_title(f"median {centre.lat_deg:.6f}°, {centre.lon_deg:.6f}°")
    plan.grid()
    plan.margins(0.08)
    up.set(ylabel="ellipsoidal height / m", title="height" if known.any() else "height unknown")
    up.grid()
    up.tick_params(labelbottom=False)
    up.sharex(sigma)
    for name, colour, dash in (("east", BLUE, "-"), ("north", GREEN, "--"), ("up", VERMILION, "-")):
        values = rows[f"sigma_{name}_m"].to_numpy(dtype=np.float64)
        if np.any(values > 0):
            sigma.plot(when, np.where(values > 0, values, np.nan), lw=0.9, ls=dash, color=colour, label=name)
    if sigma.lines:
        sigma.set_yscale("log")
        _legend_above(sigma)
    else:
        sigma.set_title("no sigma stated")
    sigma.set(xlabel=label, ylabel="stated sigma / m")
    sigma.grid()
    legend_below(figure, plan)
    return figure


@styled
def attitude_first_look(states: pd.DataFrame, *, title: str = "INS states", twin: bool = False) -> Figure:
    """Roll and pitch, heading, and velocity over time, with the fix of each state.

    Parameters
    ----------
    states : table ``INS_STATE``; where GPS time is missing the device's own clock is used.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : no row.
    """
    if states.empty:
        raise InputError("no INS state", expected="at least one state record")
    t_gps = states["t_gps_s"].to_numpy(dtype=np.float64)
    if np.isfinite(t_gps).any():
        when, label = _time_axis(t_gps, "state")
    else:
        device = states["t_device_s"].to_numpy(dtype=np.float64)
        when, label = device - device[0], "device clock, not GPS time, since the first state / s"
    order = when if np.isfinite(when).any() else np.arange(len(states), dtype=np.float64)
    broken = _breaks(order)
    figure = new_figure(118.0, f"{title}, n = {count(len(states))} states", twin=twin)
    tilt, heading, speed, fix = figure.subplots(4, 1, sharex=True, height_ratios=[3, 3, 3, 1.2])
    for name, colour in (("roll", BLUE), ("pitch", VERMILION)):
        _line(tilt, order, np.rad2deg(states[f"{name}_rad"].to_numpy()), broken, color=colour, label=name)
    degrees = np.rad2deg(states["heading_rad"].to_numpy(dtype=np.float64))
    jumps = broken | (np.abs(np.diff(degrees)) > 180.0)
    _line(heading, order, degrees, jumps, color=BLUE)
    for name, colour in (("north", GREEN), ("east", BLUE), ("down", VERMILION)):
        _line(speed, order, states[f"v_{name}_mps"].to_numpy(), broken, color=colour, label=name)
    kinds = fix_styles(states["fix"])
    numbers = states["fix"].value_counts()
    for row, (kind, colour, _) in enumerate(kinds):
        here = (states["fix"] == kind).to_numpy()
        fix.plot(
            order[here],
            np.full(int(here.sum()), row),
            ls="none",
            marker="|",
            ms=5,
            color=colour,
            rasterized=True,
        )
    fix.set_yticks(range(len(kinds)), [f"{kind}, n = {count(int(numbers[kind]))}" for kind, _, _ in kinds])
    fix.set_ylim(len(kinds) - 0.4, -0.6)
    tilt.set_ylabel("angle / °")
    heading.set_ylabel("heading / °")
    speed.set_ylabel("velocity / (m/s)")
    fix.set_xlabel(label)
    for ax in (tilt, heading, speed):
        ax.grid()
    for ax in (tilt, speed):
        _legend_above(ax)
    figure.align_ylabels([tilt, heading, speed])
    return figure


@styled
def depth_first_look(
    depths: pd.DataFrame, *, title: str = "Depth below the transducer", twin: bool = False
) -> Figure:
    """Depth over GPS time, or over UTC of the day, or over the line of the log; by kind of sentence.

    Parameters
    ----------
    depths : table ``DEPTH``.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : no row with a depth.
    """
    rows = depths[np.isfinite(depths["depth_m"])]
    if rows.empty:
        raise InputError("no sounding", expected="at least one depth")
    t_gps, t_day = (rows[name].to_numpy(dtype=np.float64) for name in ("t_gps_s", "t_day_s"))
    if np.isfinite(t_gps).any():
        x, label = _time_axis(t_gps, "sounding")
    elif np.isfinite(t_day).any():
        x, label = t_day / 3600.0, "UTC of the day (date unknown) / h"
    else:
        x, label = rows["line"].to_numpy(dtype=np.float64), "line of the log / 1 (no time)"
    figure = new_figure(72.0, f"{title}, n = {count(len(rows))} soundings", twin=twin)
    ax = figure.add_subplot()
    looks = zip(sorted(set(rows["sentence"])), (BLUE, VERMILION, GREEN, GREY), "oxs+", strict=False)
    for sentence, colour, marker in looks:
        here = (rows["sentence"] == sentence).to_numpy()
        offsets = rows["offset_m"].to_numpy(dtype=np.float64)[here]
        given = np.unique(offsets[np.isfinite(offsets)])
        said = f", offset {given[0]:+.2f} m" if given.size == 1 else ""
        ax.plot(
            x[here],
            rows["depth_m"].to_numpy()[here],
            ls="none",
            marker=marker,
            ms=3,
            mew=0.8,
            mfc="none",
            color=colour,
            rasterized=True,
            label=f"{sentence}, n = {count(int(here.sum()))}{said}",
        )
    low, high = float(rows["depth_m"].min()), float(rows["depth_m"].max())
    margin = max(0.08 * (high - low), 0.05)
    ax.set_ylim(high + margin, low - margin)
    ax.set(xlabel=label, ylabel="depth / m (downwards)")
    ax.grid()
    legend_below(figure, ax)
    return figure


def _legend_above(ax: Axes) -> None:
    """A legend that hides nothing: above the right end of the axes."""
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.0)


def _time_axis(t_gps_s: ArrayF, what: str) -> tuple[ArrayF, str]:
    """Seconds since the first stamp with the label that names it; without stamps the running number."""
    finite = t_gps_s[np.isfinite(t_gps_s)]
    if not finite.size:
        return np.arange(len(t_gps_s), dtype=np.float64), f"number of the {what} / 1 (no GPS time)"
    start = float(finite.min())
    utc = utc_text_from_gps(start, 0)
    return t_gps_s - start, f"time since {utc[:10]} {utc[11:19]} UTC / s"


def _breaks(t: ArrayF) -> ArrayB:
    """(n - 1,) true where a step is so long that no line is drawn across it."""
    step = np.diff(t)
    normal = np.nanmedian(step) if np.isfinite(step).any() else 0.0
    with np.errstate(invalid="ignore"):
        return np.asarray(~(step <= 20.0 * normal) if normal > 0 else np.zeros(len(step), dtype=bool))


def _line(ax: Axes, x: ArrayF, y: ArrayF, broken: ArrayB, *, color: str, label: str | None = None) -> None:
    """A line with holes where it is broken."""
    at = np.flatnonzero(broken) + 1
    ax.plot(
        np.insert(x, at, np.nan),
        np.insert(np.asarray(y, dtype=np.float64), at, np.nan),
        lw=0.9,
        color=color,
        label=label,
    )


# ---------------------------------------------------------------- page of recordings


def recordings_table(reports: list[IntegrityReport], titles: list[str]) -> pd.DataFrame:
    """One row a recording.

    Returns
    -------
    Columns ``recording, format, model, time, duration_s, counts, losses, gaps``.
    """
    rows = []
    for report, title in zip(reports, titles, strict=True):
        known = report.t_first_s is not None and report.t_last_s is not None
        start = (
            utc_text_from_gps(report.t_first_s or 0.0, 0)
            if report.synchronised and known
            else "unsynchronised"
        )
        rows.append(
            {
                "recording": title,
                "format": report.format,
                "model": report.model,
                "time": start,
                "duration_s": (report.t_last_s or 0.0) - (report.t_first_s or 0.0) if known else float("nan"),
                "counts": ", ".join(f"{k} {v:,}" for k, v in report.counts.items()),
                "losses": ", ".join(f"{k} {v:,}" for k, v in report.losses.items() if v) or "none",
                "gaps": len(report.gaps),
            }
        )
    names = ["recording", "format", "model", "time", "duration_s", "counts", "losses", "gaps"]
    return pd.DataFrame(rows, columns=names)


def recordings_page(reports: list[IntegrityReport], titles: list[str], pictures: list[list[Path]]) -> Page:
    """The page: overview table, then a section for each recording.

    Parameters
    ----------
    reports, titles, pictures : one each a recording, in the same order; pictures are lists of PNG files.
    """
    page = Page(
        "Real recordings",
        "Logs that other people recorded with the instruments that Thalweg reads. Nothing here was made "
        "by the digital twin; sources, licences and checksums stand in the PROVENANCE.md of each folder.",
    )
    overview = recordings_table(reports, titles)
    # All counts stand in the sections; the largest is enough here, and words instead of keys can be wrapped.
    largest = [max(r.counts.items(), key=lambda item: item[1], default=("none", 0)) for r in reports]
    overview["counts"] = [f"{n:,} {what}" for what, n in largest]
    for name in ("counts", "losses"):
        overview[name] = [words.replace("_", " ") for words in overview[name]]
    page.section("All recordings").table(
        overview, "Recordings and their integrity", units={"duration_s": "s"}
    )
    for report, title, looks in zip(reports, titles, pictures, strict=True):
        page.section(title).lines(report.lines())
        for picture in looks:
            page.figure(picture, f"First look at the {picture.stem}: {title}")
    return page
