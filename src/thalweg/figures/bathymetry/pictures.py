"""Pictures of the riverbed: soundings and their reasons, errors over depth, the bed, sections."""

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

from thalweg.bathymetry import OBSERVATIONS, SOUNDINGS, Banks, FlowLine, WaterLevel
from thalweg.core import (
    ArrayF,
    Grid,
    LocalFrame,
    read_json,
    read_parquet,
    read_raster,
    read_table,
    utc_text_from_gps,
)
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
    new_figure,
    raster_maps,
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
_SECTIONS: Final = 6
_LINES: Final = 24
_MARGIN_M: Final = 8.0
_POINTS: Final = 60_000
"""So many points of a cloud are drawn."""


@styled
def draw_sounding_lines(*, soundings: Path, title: str) -> Figure:
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
    figure = new_figure(max(26.0 + 27.0 * rows, 70.0), words)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, k in zip(axes, lines.tolist(), strict=False):
        of = table[number == k]
        place = of[["transducer_east_m", "transducer_north_m"]].interpolate(limit_direction="both")
        way = np.hypot(*place.diff().fillna(0.0).to_numpy().T).cumsum()
        for reason, (colour, marker) in ({"": (BLUE, ".")} | REASON_STYLE).items():
            at = (of["reason"] == reason).to_numpy()
            if at.any():
                size, label = (2.5, "used") if marker == "." else (4.5, reason)
                ax.plot(way[at], of["range_m"][at], marker, ms=size, color=colour, label=label)
        ax.invert_yaxis()
        first, last = (utc_text_from_gps(t, 0)[11:19] for t in of["t_gps_s"].iloc[[0, -1]])
        ax.set_title(f"line {k}: {first} to {last} UTC", fontsize="small", loc="left")
    for ax in axes[len(lines) :]:
        ax.set_axis_off()
    figure.supxlabel("along the track / m", fontsize="medium")
    figure.supylabel("range below the transducer / m", fontsize="medium")
    legend_below(figure, *axes.ravel())
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
    figure, axes = _value_and_sigma(grid, depth, look, "depth below the water / m", sigma, words)
    clouds = joined_parts(model)
    for source, colour in ((Source.SURROUNDINGS, "0.75"), (Source.LIDAR, SKY)):
        if source in clouds:
            xyz = clouds[source].xyz_m
            some = frame.to_map(xyz[:: max(1, len(xyz) // _POINTS)], onto)
            words = SOURCE_WORDS[source]
            axes[0].plot(*some[:, :2].T, ".", ms=1.0, color=colour, zorder=0.5, label=words)
    for ax in axes:
        ax.plot(*track.T, ".", ms=1.2, color="black", label="soundings")
        for side, of in shores.groupby("side"):
            places = frame.to_map(of[["east_m", "north_m", "up_m"]].to_numpy(), onto)[:, :2]
            seen = of["seen"].to_numpy()
            colour = VERMILION if side == "left" else BLUE
            ax.plot(*places.T, color=colour, lw=1.2, label=f"{side} bank")
            ax.plot(*places[~seen].T, "o", mfc="white", ms=3, color=colour)
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
) -> Figure:
    """Height of a bed from a table of soundings and its standard deviation, from above.

    Parameters
    ----------
    bed : raster of `thalweg.bathymetry.BANDS`.
    observations : table of kind ``bed_observations``, east and north on the map of the raster.
    line : centre line, on the same map; None: there is none.
    area, edge : polygon of the water and what its rings are; None: not drawn.
    title : of the figure.
    """
    grid, bands, tags = read_raster(bed)
    height = bands["height_m"]
    kind = "Bed" if line is None else "Riverbed"
    words = f"{kind}: {title}, n = {count(np.isfinite(height).sum())} cells of {grid.cell_m:g} m"
    low, high = robust_limits(height, 0.5, 99.5)
    look = {"cmap": DEPTH_MAP.reversed(), "vmin": low, "vmax": high}
    sigma = np.hypot(bands["sigma_m"], np.nan_to_num(bands["sigma_common_m"]))
    above = " above the water" if "water surface" in tags.get("heights", "") else ""
    figure, axes = _value_and_sigma(grid, height, look, f"height{above} / m", sigma, words)
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
                ax.plot(*of.T, marker, ms=size, color=colour, label=name)
    legend_below(figure, axes[0])
    return figure


def _value_and_sigma(
    grid: Grid, value: ArrayF, look: dict[str, Any], label: str, sigma: ArrayF, title: str
) -> tuple[Figure, list[Axes]]:
    """Two maps of a raster: a value, and sigma in centimetres."""
    east_m, south_m = grid.west_m + grid.columns * grid.cell_m, grid.north_m - grid.rows * grid.cell_m
    of_sigma = {"cmap": SIGMA_MAP, "norm": LogNorm(*robust_limits(100 * sigma, 0.5, 99.5))}
    panels = [(value, label, look), (100 * sigma, "sigma / cm", of_sigma)]
    extent_m = (grid.west_m, east_m, south_m, grid.north_m)
    return raster_maps(title, extent_m, panels, crs=grid.crs.name, margin_m=_MARGIN_M)


def depth_of(
    grid: Grid, bands: Mapping[str, ArrayF], frame: LocalFrame, line: FlowLine, level: Path
) -> tuple[ArrayF, ArrayF]:
    """Depth below the water and its whole standard deviation (rows, columns)."""
    centres = grid.centres_m()
    height = bands["height_m"].ravel()
    known = np.isfinite(height)
    depth = np.full(len(height), np.nan)
    world = frame.from_map(np.column_stack([centres[known], height[known]]), grid.crs)
    water = WaterLevel.of_report(read_json(level))
    depth[known] = water.at(line.to_flow(world[:, :2])[0])[0] - world[:, 2]
    sigma = np.hypot(bands["sigma_m"], bands["sigma_common_m"])
    return depth.reshape(grid.rows, grid.columns), sigma


@styled
def draw_left_out(*, predicted: Path, title: str) -> Figure:
    """What the bed foretells of lines and stretches that were left out, against what was measured there."""
    table = read_parquet(predicted)
    lines, blocks = (table[table["group"] == group] for group in ("line", "block"))
    figure = new_figure(78.0, f"Cross-validation: {title}, n = {count(len(lines))} soundings")
    left, right = figure.subplots(1, 2)
    for of, colour, marker, name in ((blocks, ORANGE, "s", "stretches"), (lines, BLUE, ".", "lines")):
        if len(of):
            left.plot(of["up_m"], of["predicted_m"], marker, ms=2.5, color=colour, label=f"{name} left out")
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
) -> Figure:
    """Sections across the river with their band of 95 %, and the data near them."""
    frame, onto = LocalFrame(**origin), CRS.from_user_input(crs)
    grid, bands, _ = read_raster(bed)
    centre = FlowLine.read(line)
    shores = Banks.read(banks, centre)
    data = read_table(observations, OBSERVATIONS)[0]
    depth, sigma = depth_of(grid, bands, frame, centre, level)
    water = WaterLevel.of_report(read_json(level))
    low, high = np.percentile(data["s_m"], [4, 96])
    stations = np.linspace(low, high, _SECTIONS)
    figure = new_figure(125.0, f"Sections across the river: {title}, n = {_SECTIONS} of them")
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
                ax.plot(of["n_m"], deep, marker, ms=4, color=colour, label=source)
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
    legend_below(figure, *axes.ravel())
    return figure


def _onto_map(places_m: ArrayF, frame: LocalFrame, crs: CRS) -> ArrayF:
    return np.asarray(frame.to_map(np.column_stack([places_m, np.zeros(len(places_m))]), crs)[:, :2])
