"""Pictures of bed and banks as one model: terrain, sources, sigma, long profile."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from thalweg.core import CoverageError
from thalweg.figures import (
    BLUE,
    GREEN,
    GREY,
    HEIGHT_MAP,
    ORANGE,
    PURPLE,
    SIGMA_MAP,
    SKY,
    VERMILION,
    count,
    new_figure,
    robust_limits,
    scale_bar,
    styled,
)
from thalweg.fusion import SOURCE_WORDS, WIDE, Dtm, Source

_COLOURS = {
    Source.BED: BLUE,
    Source.LIGHT_SHEET: GREEN,
    Source.LIDAR: ORANGE,
    Source.SURROUNDINGS: PURPLE,
    Source.FILLED: GREY,
}
_AROUND = 0.4
"""Drawn beside the bed, in shares of its smaller extent."""


@styled
def draw_terrain_model(*, dtm: Path, title: str, twin: bool) -> Figure:
    """Height, source and standard deviation of the terrain model from above."""
    model = Dtm.read(dtm)
    known = np.isfinite(model.height_m)
    # banks are seen for hundreds of metres: the river is what this picture is about
    bed = known & np.isin(model.source, (int(Source.BED), int(Source.LIGHT_SHEET)))
    middle = bed if bed.any() else known
    rows, columns = np.flatnonzero(middle.any(axis=1)), np.flatnonzero(middle.any(axis=0))
    around = max(int(_AROUND * min(np.ptp(rows), np.ptp(columns))), 2)
    rows, columns = (
        np.arange(max(k[0] - around, 0), min(k[-1] + around, most - 1) + 1)
        for k, most in zip((rows, columns), known.shape, strict=True)
    )
    part = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    west, north = model.corner_m + model.cell_m * np.array([columns[0], -rows[0]])
    extent = (
        west,
        west + model.cell_m * (columns[-1] - columns[0] + 1),
        north - model.cell_m * (rows[-1] - rows[0] + 1),
        north,
    )
    wide = extent[1] - extent[0] > 1.3 * (extent[3] - extent[2])
    ratio = (extent[3] - extent[2]) / (extent[1] - extent[0])
    figure = new_figure(
        float(np.clip(3 * 140.0 * ratio + 50.0 if wide else 52.0 * ratio + 55.0, 90.0, 230.0)),
        f"Bed and banks: {title}, n = {count(int(known.sum()))} cells of {model.cell_m:g} m",
        twin=twin,
    )
    axes = figure.subplots(3, 1, sharex=True) if wide else figure.subplots(1, 3, sharey=True)
    heights = model.vertical or "ellipsoidal"
    low, high = robust_limits(model.height_m[part], 0.5, 99.5)
    shown = axes[0].imshow(
        model.height_m[part], extent=extent, cmap=HEIGHT_MAP, vmin=low, vmax=high, interpolation="nearest"
    )
    figure.colorbar(shown, ax=axes[0], shrink=0.9, pad=0.01).set_label(f"height, {heights} / m")
    there = [s for s in _COLOURS if (model.source[part] == int(s)).any()]
    number = np.full(model.source.shape, np.nan)
    for k, s in enumerate(there):
        number[known & (model.source == int(s))] = k
    sources = axes[1].imshow(
        number[part],
        extent=extent,
        cmap=ListedColormap([_COLOURS[s] for s in there]),
        norm=BoundaryNorm(np.arange(len(there) + 1) - 0.5, max(len(there), 1)),
        interpolation="nearest",
    )
    # a bar that is not seen keeps the panels aligned
    figure.colorbar(sources, ax=axes[1], shrink=0.9, pad=0.01).ax.set_visible(False)
    sigma = 100 * model.sigma_m
    shown = axes[2].imshow(
        sigma[part],
        extent=extent,
        cmap=SIGMA_MAP,
        norm=LogNorm(*robust_limits(sigma[part], 0.5, 99.5)),
        interpolation="nearest",
    )
    bar = figure.colorbar(shown, ax=axes[2], shrink=0.9, pad=0.01)
    bar.set_label("sigma / cm")
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    bar.ax.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
    for ax in axes:
        ax.set_aspect("equal")
        ax.ticklabel_format(useOffset=False, style="plain")
        ax.xaxis.set_major_locator(MaxNLocator(5 if wide else 3))
        ax.yaxis.set_major_locator(MaxNLocator(5))
    scale_bar(axes[0], span_m=float(extent[1] - extent[0]))
    for ax in axes if wide else axes[:1]:
        ax.set_ylabel("north / m")
    axes[-1 if wide else 1].set_xlabel(f"east / m, {model.crs.name}")
    figure.legend(
        handles=[Patch(color=_COLOURS[s], label=SOURCE_WORDS[s]) for s in there],
        loc="outside lower left",
        ncols=3,
    )
    return figure


@styled
def draw_long_profile(*, profile: Path, title: str, twin: bool) -> Figure:
    """Thalweg with its band of 95 %, mean bed and water along the river."""
    table = pd.read_csv(profile)
    if table.empty:
        raise CoverageError("no section has heights from bank to bank", expected="soundings on both sides")
    figure = new_figure(90.0, f"Long profile: {title}, n = {count(len(table))} sections", twin=twin)
    ax = figure.subplots()
    s, z = table["s_m"].to_numpy(), table["thalweg_m"].to_numpy()
    band = WIDE * table["sigma_thalweg_m"].to_numpy()
    ax.fill_between(s, z - band, z + band, color=SKY, alpha=0.5, lw=0, label="95 % of the thalweg")
    ax.plot(s, z, color=BLUE, marker="o", ms=3, label="thalweg")
    ax.plot(s, table["mean_bed_m"], color=ORANGE, ls="--", label="mean bed of the section")
    ax.plot(s, table["level_m"], color=VERMILION, lw=1.0, label="water")
    ax.set_xlabel("distance along the centre line, downstream / m")
    ax.set_ylabel("height / m")
    ax.ticklabel_format(useOffset=False, style="plain")
    figure.legend(loc="outside lower left", ncols=4)
    return figure
