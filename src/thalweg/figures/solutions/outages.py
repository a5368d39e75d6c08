"""Error of the place against the length of an outage of GNSS, by chain."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

from thalweg.core.errors import InputError
from thalweg.figures.style import BLUE, GREEN, SKY, VERMILION, legend_below, new_figure, styled
from thalweg.figures.survey.maps import plain_numbers

COLUMNS: Final = ("length_s", "chain", "outages", "rms_m", "max_m", "sigma_m", "normalised")
OUTAGE_LOOK: Final = {
    "ins_model": (SKY, "v", "INS without its velocity"),
    "ins_velocity": (BLUE, "o", "INS with its velocity"),
    "camera": (VERMILION, "s", "camera with INS, no GNSS at all"),
    "fused": (GREEN, "^", "fused"),
}
"""Colour, marker and words of each chain of the study, worst first."""


@styled
def outage_study(
    table: pd.DataFrame, *, title: str = "Error of the place while GNSS is gone", twin: bool = True
) -> Figure:
    """Rms of the error during outages by their length, and the normalised error below.

    Parameters
    ----------
    table : columns ``length_s``, ``chain``, ``outages`` (number), ``rms_m``, ``max_m``, ``sigma_m``
        (predicted), ``normalised`` (mean normalised square).
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing, or there is no row.
    """
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing or table.empty:
        raise InputError(
            f"columns missing: {missing}" if missing else "a table without a row",
            expected=f"columns {', '.join(COLUMNS)}",
        )
    n = int(table.groupby("chain")["outages"].sum().max())
    figure = new_figure(118.0, f"{title}, n = {n} outages", twin=twin)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.3, 1.0])
    lengths = np.unique(table["length_s"].to_numpy(np.float64))
    for chain, (colour, marker, words) in OUTAGE_LOOK.items():
        rows = table[table["chain"] == chain].sort_values("length_s")
        if rows.empty:
            continue
        x = rows["length_s"].to_numpy(np.float64)
        rms, worst, sigma = (1e3 * rows[name].to_numpy(np.float64) for name in ("rms_m", "max_m", "sigma_m"))
        upper.plot(x, rms, color=colour, marker=marker, lw=1.2, label=words, gid=f"rms-{chain}", zorder=3)
        upper.plot(x, sigma, color=colour, lw=1.2, ls="--", gid=f"sigma-{chain}")
        upper.plot(x, worst, color=colour, ls="none", marker="_", ms=7, mew=1.2, gid=f"max-{chain}")
        normalised = rows["normalised"].to_numpy(np.float64)
        lower.plot(x, normalised, color=colour, marker=marker, lw=1.0, gid=f"normalised-{chain}")
    for ax in (upper, lower):
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.grid(axis="both")
    plain_numbers(upper.yaxis, LogNorm())
    lower.axhline(1.0, color="black", lw=0.8, ls=":")
    values = table["normalised"].to_numpy(np.float64)
    low, high = min(0.5, 0.8 * float(np.nanmin(values))), max(2.0, 1.2 * float(np.nanmax(values)))
    lower.set_ylim(low, high)
    lower.yaxis.set_major_locator(FixedLocator([0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 10.0, 40.0, 100.0]))
    lower.yaxis.set_minor_locator(NullLocator())
    lower.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    lower.xaxis.set_major_locator(FixedLocator(list(lengths)))
    lower.xaxis.set_minor_locator(NullLocator())
    lower.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    lower.xaxis.set_minor_formatter(NullFormatter())
    upper.set_title("a: rms of the 3D error during an outage (solid), predicted (dashed), largest (bars)")
    upper.set_ylabel("error / mm")
    lower.set_title("b: error over its covariance; 1: honest sigmas")
    lower.set_ylabel("normalised\nsquare / 1")
    lower.set_xlabel("length of the outage / s")
    figure.align_ylabels([upper, lower])
    legend_below(figure, upper)
    return figure
