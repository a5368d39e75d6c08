"""Error of the riverbed by pattern of the survey, over many rivers of the twin (P1 4.2)."""

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from thalweg.figures import BLUE, VERMILION, count, legend_below, mark_twin, new_figure, styled


@styled
def draw_bed_patterns(*, table: Path) -> Figure:
    """Error of the bed by pattern of the survey and length of a leg, over many rivers of the twin."""
    rows = pd.read_csv(table)
    words = f"Error of the riverbed by pattern and leg, n = {count(rows['n'].sum() / len(rows))} cells of "
    figure = new_figure(100.0, words + f"{rows['rivers'].max():.0f} rivers each")
    mark_twin(figure)
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
