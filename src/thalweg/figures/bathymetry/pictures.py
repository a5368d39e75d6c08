"""Pictures of the riverbed: soundings and their reasons, errors over depth, the bed, sections."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import shapely
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from pyproj import CRS
from scipy.ndimage import map_coordinates
from scipy.stats import norm

from thalweg.bathymetry import (
    OBSERVATIONS,
    REASONS,
    SOUNDINGS,
    Banks,
    BedModel,
    FlowLine,
    WaterLevel,
    directional_variogram,
    observations_of,
)
from thalweg.core import ArrayF, Grid, LocalFrame, read_parquet, read_raster, read_table, utc_text_from_gps
from thalweg.figures import (
    BLUE,
    DEPTH_MAP,
    GREEN,
    GREY,
    HALO,
    ORANGE,
    PURPLE,
    SIGMA_MAP,
    SKY,
    VERMILION,
    count,
    legend_below,
    marks_in_free_corners,
    new_figure,
    robust_limits,
    styled,
)
from thalweg.fusion import SOURCE_WORDS, Source, joined_parts

REASON_STYLE: Final[dict[str, tuple[str, str]]] = {
    "dead zone": (SKY, "s"),
    "too deep": (PURPLE, "^"),
    "no pose": (GREY, "x"),
    "turn": ("black", "+"),
    "second echo": (ORANGE, "D"),
    "spike": (VERMILION, "x"),
    "weeds": (GREEN, "v"),
    "by hand": (PURPLE, "*"),
}
"""Colour and marker of soundings that do not count; those without depth or time cannot be drawn."""
_PARTS: Final = (
    ("sigma_white_m", "random", BLUE, "-"),
    ("sigma_slow_m", "time-correlated (trajectory)", ORANGE, "--"),
    ("sigma_common_m", "systematic", GREEN, "-."),
)
_KINDS: Final = {"exponential": "exponential", "matern32": "Matérn 3/2", "spherical": "spherical"}
_SECTIONS: Final = 6
_LINES: Final = 24
_STRIPS: Final = 12
"""Pairs of a variogram lie in the same one of so many strips of the river."""
_FEWEST_PAIRS: Final = 20
_MARGIN_M: Final = 8.0
_POINTS: Final = 60_000
"""So many points of a cloud are drawn."""


@styled
def draw_soundings(*, soundings: Path, title: str, twin: bool) -> Figure:
    """Soundings along the survey, those that do not count marked by their reason."""
    table = read_table(soundings, SOUNDINGS)[0]
    timed = table[np.isfinite(table["t_gps_s"]) & (table["range_m"] > 0)]
    t = timed["t_gps_s"].to_numpy() - float(timed["t_gps_s"].min())
    used = timed["used"].to_numpy()
    figure = new_figure(
        95.0,
        f"Soundings: {title}, n = {count(int(table['used'].sum()))} of {count(len(table))} used",
        twin=twin,
    )
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1.0])
    top.plot(t[used], timed["range_m"][used], ls="none", marker=".", ms=2.0, color=BLUE, label="used")
    for reason, (colour, marker) in REASON_STYLE.items():
        of = (timed["reason"] == reason).to_numpy()
        if of.any():
            label = f"{reason}: {REASONS[reason]}, n = {count(int(of.sum()))}"
            top.plot(t[of], timed["range_m"][of], ls="none", marker=marker, ms=4.5, color=colour, label=label)
    undrawn = table["reason"].isin(["no time", "no bottom"]).sum()
    top.set_ylabel("range below\ntransducer / m")
    low, high = robust_limits(timed["range_m"], 0.0, 99.5)
    top.set_ylim(high + 0.25 * (high - low), max(low - 0.1 * (high - low), 0.0))
    edges = np.flatnonzero(np.diff(timed["line"].to_numpy()) != 0)
    for k in edges[(timed["line"].to_numpy()[edges + 1] >= 0)]:
        top.axvline(t[k], color="0.85", lw=0.6, zorder=0)
    for name, label, colour, style in _PARTS:
        below.plot(t[used], 100 * timed[name][used], color=colour, ls=style, lw=1.0, label=label)
    below.set_ylim(0.0)
    below.set(xlabel="time since the first sounding / s", ylabel="sigma of the\nheight / cm")
    if undrawn:
        top.annotate(
            f"{count(int(undrawn))} without bottom or time are not drawn",
            (0.99, 0.04),
            xycoords="axes fraction",
            ha="right",
        )
    handles = [*top.get_legend_handles_labels()[0], *below.get_legend_handles_labels()[0]]
    figure.legend(
        handles, [str(h.get_label()) for h in handles], loc="outside lower left", ncols=2, alignment="left"
    )
    return figure


@styled
def draw_sounding_lines(*, soundings: Path, title: str, twin: bool) -> Figure:
    """Each line of soundings by itself, those that do not count marked by their reason."""
    table = read_table(soundings, SOUNDINGS)[0]
    table = table[np.isfinite(table["t_gps_s"]) & (table["range_m"] > 0)].sort_values("t_gps_s")
    # what does not count is on no line: it belongs to the one before it
    number = table["line"].where(table["line"] >= 0).ffill().bfill().fillna(0).astype(int)
    lost = (~table["used"]).groupby(number).sum()
    lines = np.sort(lost.sort_values(ascending=False, kind="stable").index[:_LINES].to_numpy())
    of_all = f"{len(lines)} of {count(len(lost))} lines" + (", most left out" if len(lost) > _LINES else "")
    columns = min(len(lines), 3)
    rows = -(-len(lines) // max(columns, 1))
    words = f"Lines of soundings: {title}, n = {of_all}"
    figure = new_figure(max(26.0 + 27.0 * rows, 70.0), words, twin=twin)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, k in zip(axes, lines.tolist(), strict=False):
        of = table[number == k]
        place = of[["transducer_east_m", "transducer_north_m"]].interpolate(limit_direction="both")
        way = np.hypot(*place.diff().fillna(0.0).to_numpy().T).cumsum()
        for reason, (colour, marker) in ({"": (BLUE, ".")} | REASON_STYLE).items():
            at = (of["reason"] == reason).to_numpy()
            if at.any():
                size, label = (2.5, "used") if marker == "." else (4.5, reason)
                ax.plot(
                    way[at], of["range_m"][at], ls="none", marker=marker, ms=size, color=colour, label=label
                )
        ax.invert_yaxis()
        first, last = (utc_text_from_gps(t, 0)[11:19] for t in of["t_gps_s"].iloc[[0, -1]])
        ax.set_title(f"line {k}: {first} to {last} UTC", fontsize="small", loc="left")
    for ax in axes[len(lines) :]:
        ax.set_axis_off()
    figure.supxlabel("along the track / m", fontsize="medium")
    figure.supylabel("range below the transducer / m", fontsize="medium")
    _one_legend(figure, axes)
    return figure


@styled
def draw_sounding_errors(*, soundings: Path, title: str, twin: bool) -> Figure:
    """Standard deviation of the height of a sounding over depth, by its parts."""
    table = read_table(soundings, SOUNDINGS)[0]
    table = table[table["used"]]
    depth = table["depth_m"].to_numpy()
    edges = np.linspace(depth.min(), depth.max() + 1e-9, 13)
    number = np.digitize(depth, edges) - 1
    figure = new_figure(72.0, f"Error of a sounding over depth: {title}, n = {count(len(table))}", twin=twin)
    ax = figure.subplots()
    middle, total = [], np.zeros(len(table))
    taken = [k for k in range(12) if np.sum(number == k) >= 3]
    middle = [float(np.median(depth[number == k])) for k in taken]
    for name, label, colour, style in _PARTS:
        value = table[name].to_numpy()
        total += value**2
        ax.plot(
            middle, [100 * np.median(value[number == k]) for k in taken], color=colour, ls=style, label=label
        )
    ax.plot(
        middle,
        [100 * np.median(np.sqrt(total[number == k])) for k in taken],
        color="black",
        lw=1.8,
        label="all",
    )
    horizontal = [100 * np.median(table["sigma_horizontal_m"].to_numpy()[number == k]) for k in taken]
    ax.plot(middle, horizontal, color=PURPLE, ls=":", label="horizontal, each coordinate")
    ax.set_ylim(0.0)
    ax.set(xlabel="depth below the water / m", ylabel="standard deviation / cm,\nmedian of a class")
    legend_below(figure, ax)
    return figure


@styled
def draw_bed_map(
    *,
    bed: Path,
    banks: Path,
    line: Path,
    level: Path,
    soundings: Path,
    model: Path,
    crs: str,
    origin: Mapping[str, Any],
    title: str,
    twin: bool,
) -> Figure:
    """Depth of the bed and its standard deviation from above, with soundings and clouds (P1 Fig. 6)."""
    frame, onto = LocalFrame(**origin), CRS.from_user_input(crs)
    grid, bands, _ = read_raster(bed)
    depth, sigma = depth_of(grid, bands, frame, FlowLine.read(line), level)
    table = read_table(soundings, SOUNDINGS)[0]
    track = frame.to_map(table.loc[table["used"], ["east_m", "north_m", "up_m"]].to_numpy(), onto)[:, :2]
    shores = pd.read_csv(banks)
    known = int(np.isfinite(depth).sum())
    words = f"Riverbed: {title}, n = {count(known)} cells of {grid.cell_m:g} m"
    low, high = robust_limits(depth, 0.5, 99.5)
    look = {"cmap": DEPTH_MAP, "vmin": max(low, 0.0), "vmax": high}
    figure, axes = _value_and_sigma(grid, depth, look, "depth below the water / m", sigma, words, twin=twin)
    clouds = joined_parts(model)
    for source, colour in ((Source.SURROUNDINGS, "0.75"), (Source.LIDAR, SKY)):
        if source in clouds:
            xyz = clouds[source].xyz_m
            some = frame.to_map(xyz[:: max(1, len(xyz) // _POINTS)], onto)
            words = SOURCE_WORDS[source]
            axes[0].plot(*some[:, :2].T, ls="none", marker=".", ms=1.0, color=colour, zorder=0.5, label=words)
    for ax in axes:
        ax.plot(*track.T, ls="none", marker=".", ms=1.2, color="black", label="soundings")
        for side, of in shores.groupby("side"):
            places = frame.to_map(of[["east_m", "north_m", "up_m"]].to_numpy(), onto)[:, :2]
            seen = of["seen"].to_numpy()
            colour = VERMILION if side == "left" else BLUE
            ax.plot(*places.T, color=colour, lw=1.2, label=f"{side} bank")
            ax.plot(*places[~seen].T, ls="none", marker="o", mfc="white", ms=3, color=colour)
    legend_below(figure, axes[0])
    return figure


@styled
def bed_picture(
    *,
    bed: Path,
    observations: pd.DataFrame,
    line: FlowLine | None,
    area: Any = None,
    edge: str = "",
    title: str,
    twin: bool,
) -> Figure:
    """Height of a bed from a table of soundings and its standard deviation, from above.

    Parameters
    ----------
    bed : raster of `thalweg.bathymetry.BANDS`.
    observations : table of kind ``bed_observations``, east and north on the map of the raster.
    line : centre line, on the same map; None: there is none.
    area, edge : polygon of the water and what its rings are; None: not drawn.
    title, twin : of the figure.
    """
    grid, bands, tags = read_raster(bed)
    height = bands["height_m"]
    kind = "Bed" if line is None else "Riverbed"
    words = f"{kind}: {title}, n = {count(int(np.isfinite(height).sum()))} cells of {grid.cell_m:g} m"
    low, high = robust_limits(height, 0.5, 99.5)
    look = {"cmap": DEPTH_MAP.reversed(), "vmin": low, "vmax": high}
    sigma = np.hypot(bands["sigma_m"], np.nan_to_num(bands["sigma_common_m"]))
    above = " above the water" if "water surface" in tags.get("heights", "") else ""
    figure, axes = _value_and_sigma(grid, height, look, f"height{above} / m", sigma, words, twin=twin)
    looks = (("bank", "x", 3.0, VERMILION, "banks"), ("sounding", ".", 1.2, "black", "soundings"))
    for ax in axes:
        if line is not None:
            course = line.to_map(np.linspace(0.0, line.length_m, 400), 0.0)
            ax.plot(*course.T, color=GREY, lw=0.8, ls="--", label="centre line", scalex=False, scaley=False)
        for k, ring in enumerate(shapely.get_rings(shapely.get_parts(area)) if area is not None else ()):
            name = edge if k == 0 else None
            ax.plot(*ring.xy, color=VERMILION, lw=0.8, label=name, scalex=False, scaley=False)
        for source, marker, size, colour, name in looks[line is None :]:
            of = observations.loc[observations["source"] == source, ["east_m", "north_m"]].to_numpy()
            if len(of):
                ax.plot(*of.T, ls="none", marker=marker, ms=size, color=colour, label=name)
    legend_below(figure, axes[0])
    return figure


def _value_and_sigma(
    grid: Grid, value: ArrayF, look: dict[str, Any], label: str, sigma: ArrayF, title: str, *, twin: bool
) -> tuple[Figure, list[Axes]]:
    """Two maps of a raster, one above the other or side by side: a value, and sigma in centimetres."""
    extent = (
        grid.west_m,
        grid.west_m + grid.columns * grid.cell_m,
        grid.north_m - grid.rows * grid.cell_m,
        grid.north_m,
    )
    box = np.array([[extent[0], extent[2]], [extent[1], extent[3]]])
    box += np.array([[-_MARGIN_M], [_MARGIN_M]])
    wide = (box[1, 0] - box[0, 0]) > 1.3 * (box[1, 1] - box[0, 1])
    ratio = float((box[1, 1] - box[0, 1]) / (box[1, 0] - box[0, 0]))
    height_mm = 2 * 145.0 * ratio + 42.0 if wide else 55.0 * ratio + 42.0
    figure = new_figure(float(np.clip(height_mm, 80.0, 225.0)), title, twin=twin)
    axes = figure.subplots(2, 1, sharex=True) if wide else figure.subplots(1, 2, sharey=True)
    row, column = np.nonzero(np.isfinite(value))
    cells_m = np.stack(
        [extent[0] + grid.cell_m * (column + 0.5), extent[3] - grid.cell_m * (row + 0.5)], axis=1
    )
    of_sigma = {"cmap": SIGMA_MAP, "norm": LogNorm(*robust_limits(100 * sigma, 0.5, 99.5))}
    for ax, values, how, words in zip(
        axes, (value, 100 * sigma), (look, of_sigma), (label, "sigma / cm"), strict=True
    ):
        drawn = ax.imshow(values, extent=extent, interpolation="nearest", zorder=1, **how)
        bar = figure.colorbar(drawn, ax=ax, shrink=0.85, pad=0.01)
        bar.set_label(words)
        if "norm" in how:
            bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
            bar.ax.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
        ax.set_aspect("equal")
        ax.set_xlim(box[:, 0])
        ax.set_ylim(box[:, 1])
        ax.ticklabel_format(useOffset=False, style="plain")
        ax.xaxis.set_major_locator(_few())
        ax.yaxis.set_major_locator(_few())
        marks_in_free_corners(ax, cells_m)
    axes[-1 if wide else 0].set_xlabel(f"east / m{', ' if wide else chr(10)}{grid.crs.name}")
    for ax in axes if wide else axes[:1]:
        ax.set_ylabel("north / m")
    return figure, list(axes)


def _few() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(5)


def depth_of(
    grid: Grid, bands: Mapping[str, ArrayF], frame: LocalFrame, line: FlowLine, level: Path
) -> tuple[ArrayF, ArrayF]:
    """Depth below the water and its whole standard deviation (rows, columns)."""
    centres = grid.centres_m()
    height = bands["height_m"].ravel()
    known = np.isfinite(height)
    depth = np.full(len(height), np.nan)
    world = frame.from_map(np.column_stack([centres[known], height[known]]), grid.crs)
    water = WaterLevel.of_report(json.loads(level.read_text()))
    depth[known] = water.at(line.to_flow(world[:, :2])[0])[0] - world[:, 2]
    sigma = np.hypot(bands["sigma_m"], bands["sigma_common_m"])
    return depth.reshape(grid.rows, grid.columns), sigma


@styled
def draw_variogram(*, observations: Path, variogram: Path, title: str, twin: bool) -> Figure:
    """Robust variogram of soundings along and across the river, and what the model says of the same pairs."""
    data = observations_of(read_table(observations, OBSERVATIONS)[0])
    # shorelines are level all along: their pairs say nothing of the bed
    data = data.where(data.line >= 0)
    model = BedModel.of_report(json.loads(variogram.read_text()))
    figure = new_figure(75.0, f"Variogram of the bed: {title}, n = {count(len(data))} soundings", twin=twin)
    axes = figure.subplots(1, 2)
    of = model.covariance
    extent = {True: float(np.ptp(data.s_m)), False: float(np.ptp(data.n_m))}
    for ax, along in zip(axes, (True, False), strict=True):
        reach = extent[along] / 2 if along else extent[along]
        tolerance = extent[not along] / _STRIPS
        found = directional_variogram(data, model, along=along, reach_m=reach, tolerance_m=tolerance)
        use = found.pairs >= _FEWEST_PAIRS
        ax.plot(
            found.lag_m[use],
            found.semivariance_m2[use],
            ls="none",
            marker="o" if along else "s",
            color=BLUE if along else VERMILION,
            label=f"pairs (robust), n = {count(int(found.pairs[use].sum()))}",
        )
        ax.plot(
            found.lag_m[use],
            found.expected_m2[use],
            color="black",
            label=f"same pairs, {_KINDS[of.kind]}, range {of.range_s_m if along else of.range_n_m:.1f} m",
        )
        ax.fill_between(
            found.lag_m[use],
            found.low_m2[use],
            found.high_m2[use],
            color="0.88",
            lw=0,
            zorder=0,
            label="95 % of surveys of that model",
        )
        both = np.concatenate([found.semivariance_m2[use], found.expected_m2[use], [0.0]])
        ax.set_ylim(0.0, 1.7 * max(float(both.max()), 1e-6))
        ax.set_xlabel(
            f"distance {'along' if along else 'across'} the river / m\n"
            f"pairs within {tolerance:.1f} m {'across' if along else 'along'} it"
        )
        ax.set_xlim(0.0)
        ax.legend(loc="upper left")
    axes[0].set_ylabel("semivariance / m²")
    return figure


@styled
def draw_left_out(*, predicted: Path, title: str, twin: bool) -> Figure:
    """What the bed foretells of lines and stretches that were left out, against what was measured there."""
    table = read_parquet(predicted)
    lines, blocks = (table[table["group"] == group] for group in ("line", "block"))
    figure = new_figure(78.0, f"Cross-validation: {title}, n = {count(len(lines))} soundings", twin=twin)
    left, right = figure.subplots(1, 2)
    for of, colour, marker, name in ((blocks, ORANGE, "s", "stretches"), (lines, BLUE, ".", "lines")):
        if len(of):
            left.plot(
                of["up_m"],
                of["predicted_m"],
                ls="none",
                marker=marker,
                ms=2.5,
                color=colour,
                label=f"{name} left out",
            )
    ends = robust_limits(np.concatenate([lines["up_m"], lines["predicted_m"]]), 0.0, 100.0)
    left.plot(ends, ends, color="black", lw=0.8)
    left.set_aspect("equal")
    left.set(xlabel="measured height / m", ylabel="predicted height / m")
    left.legend(loc="best")
    z = ((lines["up_m"] - lines["predicted_m"]) / lines["sigma_m"]).to_numpy()
    x = np.linspace(-5, 5, 41)
    right.hist(np.clip(z, -5, 5), x, density=True, color=BLUE, alpha=0.5, label="lines left out")
    right.plot(x, norm.pdf(x), color="black", label="as predicted: standard normal")
    outside = float(np.mean(np.abs(z) > 1.96))
    right.set_title(f"mean square {np.mean(z**2):.2f}, outside 95 %: {100 * outside:.1f} %", fontsize=8)
    right.set(xlabel="error over its predicted sigma", ylabel="density")
    right.set_ylim(top=1.3 * right.get_ylim()[1])
    right.legend(loc="upper right")
    return figure


@styled
def draw_bed_sections(
    *,
    bed: Path,
    line: Path,
    level: Path,
    banks: Path,
    observations: Path,
    crs: str,
    origin: Mapping[str, Any],
    title: str,
    twin: bool,
) -> Figure:
    """Sections across the river with their band of 95 %, and the data near them."""
    frame, onto = LocalFrame(**origin), CRS.from_user_input(crs)
    grid, bands, _ = read_raster(bed)
    centre = FlowLine.read(line)
    shores = Banks.read(banks, centre)
    data = read_table(observations, OBSERVATIONS)[0]
    depth, sigma = depth_of(grid, bands, frame, centre, level)
    water = WaterLevel.of_report(json.loads(level.read_text()))
    low, high = np.percentile(data["s_m"], [4, 96])
    stations = np.linspace(low, high, _SECTIONS)
    figure = new_figure(125.0, f"Sections across the river: {title}, n = {_SECTIONS} of them", twin=twin)
    axes = figure.subplots(3, 2, sharex=True, sharey=True)
    near = max(0.25 * float(stations[1] - stations[0]), 1.0)
    for ax, s in zip(axes.flat, stations.tolist(), strict=True):
        left, right = (float(side[0]) for side in shores.half_widths_m(np.array([s])))
        half = [each if np.isfinite(each) else float(np.abs(data["n_m"]).max()) for each in (left, right)]
        n = np.linspace(-half[1], half[0], 300)
        there = _onto_map(centre.to_map(s, n), frame, onto)
        cell = np.stack([grid.north_m - there[:, 1], there[:, 0] - grid.west_m]) / grid.cell_m - 0.5
        d, e = (map_coordinates(a, cell, order=1, cval=np.nan) for a in (depth, 1.96 * sigma))
        ax.fill_between(n, d - e, d + e, color=SKY, alpha=0.5, lw=0, label="95 %")
        ax.plot(n, d, color=BLUE, label="bed")
        ax.axhline(0.0, color="0.6", lw=0.8)
        here = data[np.abs(data["s_m"] - s) < near]
        for source, marker, colour in (
            ("sounding", ".", "black"),
            ("light sheet", "+", GREEN),
            ("bank", "^", VERMILION),
        ):
            of = here[here["source"] == source]
            if len(of):
                deep = water.at(of["s_m"].to_numpy())[0] - of["up_m"].to_numpy()
                ax.plot(of["n_m"], deep, ls="none", marker=marker, ms=4, color=colour, label=source)
        ax.annotate(
            f"s = {s:.0f} m",
            (0.5, 0.78),
            xycoords="axes fraction",
            ha="center",
            va="top",
            path_effects=list(HALO),
        )
    axes[0, 0].invert_yaxis()
    for ax in axes[-1]:
        ax.set_xlabel("across the river, left positive / m")
    for ax in axes[:, 0]:
        ax.set_ylabel("depth / m")
    _one_legend(figure, axes)
    return figure


@styled
def draw_bed_patterns(*, table: Path) -> Figure:
    """Error of the bed by pattern of the survey and length of a leg, over many rivers of the twin."""
    rows = pd.read_csv(table)
    words = (
        f"Error of the riverbed by pattern and leg, n = {count(int(rows['n'].sum() / len(rows)))} cells of "
    )
    figure = new_figure(100.0, words + f"{rows['rivers'].max():.0f} rivers each", twin=True)
    ax = figure.subplots()
    looks = zip(rows.groupby("pattern", sort=False), (BLUE, VERMILION), ("o", "s"), strict=False)
    for (name, of), colour, marker in looks:
        leg, expected = of["leg_m"], 100 * of["rmse_predicted_m"]
        ax.fill_between(
            leg, expected / of["high"], expected / of["low"], color=colour, alpha=0.18, lw=0,
            label=f"{name}, predicted, 95 %",
        )  # fmt: skip
        ax.plot(leg, 100 * of["rmse_observed_m"], color=colour, marker=marker, label=f"{name}, kriging")
        ax.plot(
            leg, 100 * of["rmse_distance_m"], color=colour, marker=marker, mfc="white", ls=":", lw=1.0,
            label=f"{name}, elliptical inverse distance",
        )  # fmt: skip
    ax.set(xscale="log", yscale="log", ylabel="root mean square error / cm")
    ax.set_xlabel("length of river per leg, or spacing of the sections / m")
    legs = sorted(rows["leg_m"].unique())
    ax.set_xticks(legs, [f"{leg:g}" for leg in legs])
    ax.minorticks_off()
    ticks = [t for t in (2, 5, 10, 20, 50, 100) if ax.get_ylim()[0] < t < ax.get_ylim()[1]]
    ax.set_yticks(ticks, [f"{t:g}" for t in ticks])
    ax.grid(axis="y")
    legend_below(figure, ax)
    return figure


def _onto_map(places_m: ArrayF, frame: LocalFrame, crs: CRS) -> ArrayF:
    return np.asarray(frame.to_map(np.column_stack([places_m, np.zeros(len(places_m))]), crs)[:, :2])


def _one_legend(figure: Figure, axes: Any) -> None:
    """One legend below all panels for everything that any of them shows."""
    found: dict[str, Any] = {}
    ax: Axes
    for ax in axes.flat:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(list(found.values()), list(found), loc="outside lower left", ncols=5)
