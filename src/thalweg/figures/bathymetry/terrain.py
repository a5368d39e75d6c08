"""Pictures of bed and banks as one model: terrain, sources, sigma, long profile."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm
from matplotlib.figure import Figure

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
    legend_below,
    new_figure,
    raster_maps,
    robust_limits,
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
def draw_terrain_model(*, dtm: Path, title: str) -> Figure:
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
    there = [s for s in _COLOURS if (model.source[part] == int(s)).any()]
    number = np.full(model.source.shape, np.nan)
    for k, s in enumerate(there):
        number[known & (model.source == int(s))] = k
    sources = {
        "cmap": ListedColormap([_COLOURS[s] for s in there]),
        "norm": BoundaryNorm(np.arange(len(there) + 1) - 0.5, max(len(there), 1)),
    }
    height_m, sigma_cm = model.height_m[part], 100 * model.sigma_m[part]
    low, high = robust_limits(height_m, 0.5, 99.5)
    of_sigma = {"cmap": SIGMA_MAP, "norm": LogNorm(*robust_limits(sigma_cm, 0.5, 99.5))}
    words = f"height, {model.vertical or 'ellipsoidal'} / m"
    figure, axes = raster_maps(
        f"Bed and banks: {title}, n = {count(known.sum())} cells of {model.cell_m:g} m",
        extent,
        [
            (height_m, words, {"cmap": HEIGHT_MAP, "vmin": low, "vmax": high}),
            (number[part], "", sources),
            (sigma_cm, "sigma / cm", of_sigma),
        ],
        crs=model.crs.name,
    )
    bar = axes[1].images[0].colorbar
    assert bar is not None
    bar.ax.set_visible(False)  # it keeps the panels aligned
    for s in there:
        axes[1].plot([], [], "s", color=_COLOURS[s], label=SOURCE_WORDS[s])
    legend_below(figure, axes[1])
    return figure


@styled
def draw_long_profile(*, profile: Path, title: str) -> Figure:
    """Thalweg with its band of 95 %, mean bed and water along the river."""
    table = pd.read_csv(profile)
    if table.empty:
        raise CoverageError("no section has heights from bank to bank", expected="soundings on both sides")
    figure = new_figure(90.0, f"Long profile: {title}, n = {count(len(table))} sections")
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
