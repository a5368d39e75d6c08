"""Budget of the depth by cause, and errors that simpler models of the sheet leave."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core import CoverageError
from thalweg.figures import GREY, new_figure, plural, styled
from thalweg.lightsheet.budget import TOTAL, TOTAL_CORRELATED, budget_on_lines
from thalweg.lightsheet.figures.views import depth_styles, need
from thalweg.lightsheet.optics import paper_4

COLUMNS: Final = ("depth_mm", "x_px", "y_px", "panel", "cause", "sigma_depth_mm")
"""Columns of `thalweg.lightsheet.budget.budget.budget_on_lines`."""
PUBLISHED: Final = ("cause", "bound", "published_mm", "verdict")
"""Columns of `thalweg.lightsheet.budget.checks.verdicts`."""
OR: Final = " or "
"""Between causes for which P4 states one figure."""
ACROSS: Final = 4
"""Panels in a row."""
_MM_PER_ROW: Final = 37.0
_LEAST_MM: Final = 84.0
"""One row of panels holds the words of the axis that all share."""

MODEL_COLUMNS: Final = ("model", "depth_mm", "mean_mm", "std_mm", "low_mm", "high_mm", "n", "lost")
"""Columns of `thalweg.lightsheet.optics.approximations.model_errors`."""
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


# ---------------------------------------------------------------- budget of the depth (P4 Fig. 13)


@styled
def depth_budget(
    lines: pd.DataFrame,
    published: pd.DataFrame | None = None,
    *,
    title: str = "Sigma of the depth",
    twin: bool = False,
) -> Figure:
    """A panel for each cause that has a share, and for the total with and without correlations.

    Parameters
    ----------
    lines : columns `COLUMNS`.
    published : figures of P4 beside those of the same geometry, columns `PUBLISHED`; None to show none.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    CoverageError : no cause has a share.
    """
    need(lines, COLUMNS, "a budget along lines of equal depth")
    depths = sorted(float(depth) for depth in lines["depth_mm"].unique())
    most = lines.groupby("cause", sort=False)["sigma_depth_mm"].max()
    causes = [str(name) for name in most.index if most[name] > 0.0 and name != TOTAL_CORRELATED]
    if not causes:
        raise CoverageError("no cause of errors", expected="a sensor with a covariance")
    places = lines[lines["cause"] == causes[0]].groupby("depth_mm").size()
    head = (
        f"{title} by cause in {plural(len(depths), 'depth')}, n = {plural(int(places.min()), 'place')} "
        "or more on each line"
    )
    rows = -(-len(causes) // ACROSS)
    figure = new_figure(max(20.0 + _MM_PER_ROW * rows, _LEAST_MM), head, twin=twin)
    axes = figure.subplots(rows, ACROSS, sharex=True, squeeze=False)
    along = "y_px" if np.ptp(lines["y_px"]) >= np.ptp(lines["x_px"]) else "x_px"
    for k, (ax, cause) in enumerate(zip(axes.flat, causes, strict=False)):
        _panel(ax, lines, cause, along, depths, total=cause == TOTAL)
        _published(ax, published, cause)
        panel = str(lines.loc[lines["cause"] == cause, "panel"].fillna("").iloc[0])
        ax.set_title(f"{cause}" + (f" (P4: {panel})" if panel else ""))
        ax.set_ylim(0.0, 1.25 * ax.get_ylim()[1])
        if k + ACROSS >= len(causes):
            ax.set_xlabel("row / px" if along == "y_px" else "column / px")
            ax.tick_params(labelbottom=True)
        ax.grid()
    for ax in axes.flat[len(causes) :]:
        ax.axis("off")
    label = "standard deviation of the depth / mm; each panel has its own scale"
    figure.supylabel(label if rows > 1 else label.replace("; ", ";\n"), fontsize=8)
    _legend(figure, list(axes.flat[: len(causes)]))
    return figure


def _panel(
    ax: Axes, lines: pd.DataFrame, cause: str, along: str, depths: Sequence[float], *, total: bool
) -> None:
    looks = depth_styles(depths)
    for depth in depths:
        colour, style, _ = looks[depth]
        part = lines[(lines["depth_mm"] == depth) & (lines["cause"] == cause)]
        ax.plot(
            part[along],
            part["sigma_depth_mm"],
            color=colour,
            ls=style,
            lw=1.3,
            label=f"{depth:g} mm deep",
            gid=f"{cause} {depth:g}",
        )
        whole = lines[(lines["depth_mm"] == depth) & (lines["cause"] == TOTAL_CORRELATED)]
        if total and len(whole):
            ax.plot(
                whole[along],
                whole["sigma_depth_mm"],
                color=colour,
                ls=style,
                lw=2.6,
                alpha=0.45,
                gid=f"correlated {depth:g}",
            )
    if total and (lines["cause"] == TOTAL_CORRELATED).any():
        ax.plot([], [], color=GREY, lw=2.6, alpha=0.6, label="broad: total with correlations")


def _published(ax: Axes, published: pd.DataFrame | None, cause: str) -> None:
    """The published figure as a line, with the verdict in words."""
    if published is None:
        return
    need(published, PUBLISHED, "published figures")
    mine = published[[cause in str(name).split(OR) for name in published["cause"]]]
    for _, row in mine.iterrows():
        ax.axhline(
            float(row["published_mm"]),
            color="black",
            lw=0.9,
            ls=(0, (1, 1)),
            gid="published",
            label="as published in P4",
        )
    most = mine[mine["bound"] == "most"]
    if len(most):
        several = len(str(most.iloc[0]["cause"]).split(OR))
        words = str(most.iloc[0]["verdict"]) + (f", most of {several}" if several > 1 else "")
        ax.text(0.03, 0.97, words, transform=ax.transAxes, va="top", fontsize=7, gid="verdict")


def _legend(figure: Figure, axes: Sequence[Axes]) -> None:
    found: dict[str, Artist] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(list(found.values()), list(found), loc="outside lower left", ncols=6)


def draw_depth_budget(*, budget: Path, title: str, twin: bool) -> Figure:
    """Budget of the depth of a light-sheet sensor -> figure by cause."""
    return depth_budget(pd.read_csv(budget), title=f"{title}: sigma of the depth", twin=twin)


def draw_published_depth_budget(*, published: Path) -> Figure:
    """The best-fit geometry of P4 and the verdicts on its published budget -> figure by cause."""
    return depth_budget(
        budget_on_lines(paper_4()),
        pd.read_csv(published),
        title="Best-fit geometry of P4: sigma of the depth",
    )


# ---------------------------------------------------------------- simpler models of the sheet


@styled
def model_errors_view(errors: pd.DataFrame, *, title: str = "Simpler models", twin: bool = False) -> Figure:
    """Root mean square and largest error of each model in each depth, on a logarithmic scale.

    Parameters
    ----------
    errors : columns `MODEL_COLUMNS`.
    title : first words of the title.
    twin : true if the sensor is that of the digital twin.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(errors, MODEL_COLUMNS, "errors of models")
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
    looks = depth_styles(depths)
    step = 0.5 / max(len(depths) - 1, 1)
    for k, depth in enumerate(depths):
        colour, _, marker = looks[depth]
        rows = errors[errors["depth_mm"] == depth].set_index("model").reindex(names)
        place = np.arange(len(names)) + step * (k - 0.5 * (len(depths) - 1))
        rms = np.hypot(rows["mean_mm"].to_numpy(np.float64), rows["std_mm"].to_numpy(np.float64))
        most = rows[["low_mm", "high_mm"]].abs().max(axis=1).to_numpy(np.float64)
        ax.hlines(place, rms, most, color=colour, lw=1.0)
        ax.plot(
            rms,
            place,
            ls="none",
            marker=marker,
            ms=5,
            color=colour,
            label=f"{depth:g} mm deep: root mean square",
            gid=f"rms {depth:g}",
        )
        ax.plot(
            most,
            place,
            ls="none",
            marker=marker,
            ms=5,
            mfc="white",
            mec=colour,
            label=f"{depth:g} mm deep: largest",
            gid=f"most {depth:g}",
        )
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


def draw_sheet_models(*, models: Path, title: str, twin: bool) -> Figure:
    """Errors of simpler models of the light sheet -> figure."""
    return model_errors_view(pd.read_csv(models), title=title, twin=twin)
