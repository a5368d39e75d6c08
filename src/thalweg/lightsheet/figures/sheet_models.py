"""Errors that simpler models of the light sheet leave against the strict one."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.figures.style import GREY, new_figure, plural, styled
from thalweg.lightsheet.figures.views import depth_looks, need

COLUMNS: Final = ("model", "depth_mm", "mean_mm", "std_mm", "low_mm", "high_mm", "n", "lost")
"""Columns of `thalweg.lightsheet.optics.sheet_models.model_errors`."""

PALOMER: Final = "cone, as Palomer et al. (2017) state it: about 2 mm"
PALOMER_MM: Final = 2.0
"""Order of the errors that Palomer et al. (2017) state for an elliptical cone."""

ORDER: Final = ("elliptical cone", "plane", "no glass", "Snell as printed", "no refraction")
WORDS: Final = {
    "elliptical cone": "elliptical cone,\nrefracted image rays",
    "plane": "plane,\nrefracted image rays",
    "no glass": "no glass,\nwater from its inner face",
    "Snell as printed": "Snell's law\nas printed in P3 and P4",
    "no refraction": "no refraction\nat all",
}


@styled
def model_errors_view(errors: pd.DataFrame, *, title: str = "Simpler models", twin: bool = False) -> Figure:
    """Root mean square and largest error of each model in each depth, on a logarithmic scale.

    Parameters
    ----------
    errors : columns `COLUMNS`.
    title : first words of the title.
    twin : true if the sensor is that of the digital twin.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(errors, COLUMNS, "errors of models")
    known = [name for name in ORDER if name in set(errors["model"])]
    names = known + sorted(set(errors["model"].astype(str)) - set(known))
    depths = sorted(float(depth) for depth in errors["depth_mm"].unique())
    lost = int(errors["lost"].sum())
    head = (
        f"{title}: errors in depth against the strict intersection, n = {int(errors['n'].min())} or more "
        f"places in each of {plural(len(depths), 'depth')}" + (f", {lost} without a depth" if lost else "")
    )
    figure = new_figure(36.0 + 12.0 * len(names), head, twin=twin)
    ax = figure.subplots()
    looks = depth_looks(depths)
    step = 0.5 / max(len(depths) - 1, 1)
    for k, depth in enumerate(depths):
        colour, _, marker = looks[depth]
        rows = errors[errors["depth_mm"] == depth].set_index("model").reindex(names)
        place = np.arange(len(names)) + step * (k - 0.5 * (len(depths) - 1))
        rms = np.hypot(rows["mean_mm"].to_numpy(np.float64), rows["std_mm"].to_numpy(np.float64))
        most = rows[["low_mm", "high_mm"]].abs().max(axis=1).to_numpy(np.float64)
        ax.hlines(place, rms, most, color=colour, lw=1.0)
        ax.plot(rms, place, ls="none", marker=marker, ms=5, color=colour,
                label=f"{depth:g} mm deep: root mean square", gid=f"rms {depth:g}")  # fmt: skip
        ax.plot(most, place, ls="none", marker=marker, ms=5, mfc="white", mec=colour,
                label=f"{depth:g} mm deep: largest", gid=f"most {depth:g}")  # fmt: skip
    _finish(figure, ax, names)
    return figure


def _finish(figure: Figure, ax: Axes, names: list[str]) -> None:
    ax.axvline(PALOMER_MM, color=GREY, lw=1.2, ls=":", label=PALOMER)
    ax.set_yticks(range(len(names)), [WORDS.get(name, name) for name in names])
    ax.set(xscale="log", xlabel="error of the depth / mm", ylim=(len(names) - 0.5, -0.5))
    ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.grid(axis="x")
    handles, labels = ax.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda i: ("Palomer" in labels[i], "largest" in labels[i]))
    figure.legend([handles[i] for i in order], [labels[i] for i in order], loc="outside lower left", ncols=3)
