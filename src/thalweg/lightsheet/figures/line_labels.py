"""What a scan tells about the numbers of lines: labelled points, one image, shifted labels (T 4.2.1)."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.figures.style import (
    DEPTH_MAP,
    GREY,
    SKY,
    VERMILION,
    count,
    new_figure,
    robust_limits,
    styled,
)
from thalweg.lightsheet.figures.multi_line_geometry import LINE_MAP
from thalweg.lightsheet.figures.views import need

POINTS: Final = (
    "irregular", "image", "row", "x_px", "line", "true_line", "reason", "x_mm", "y_mm", "depth_mm",
)  # fmt: skip
SHIFTS: Final = ("irregular", "shift", "median_mm", "resolved")

_MOST_POINTS: Final = 40_000


@styled
def line_labels(points: pd.DataFrame, shifts: pd.DataFrame) -> Figure:
    """For each spacing: labelled points from above, the middle image, and the test with shifted labels.

    Parameters
    ----------
    points, shifts : columns `POINTS` and `SHIFTS`, see `thalweg_lab.studies.line_label_scans`.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(points, POINTS, "labelled points"), need(shifts, SHIFTS, "shifted labels")
    spacings = sorted(points["irregular"].unique())
    images = int(points["image"].nunique())
    head = (
        f"Fifteen lines over a wreck, scans of {images} images: n = {count(len(points))} detections, "
        f"{count(int((points['line'] >= 0).sum()))} with a label"
    )
    figure = new_figure(42.0 + 62.0 * len(spacings), head, twin=True)
    axes = figure.subplots(len(spacings), 3, squeeze=False, width_ratios=[1.15, 1.0, 1.0])
    depths = Normalize(*robust_limits(points["depth_mm"]))
    numbers = ScalarMappable(Normalize(0, max(int(points["true_line"].max()), 1)), LINE_MAP)
    for k, irregular in enumerate(spacings):
        mine = points[points["irregular"] == irregular]
        letters = "abcdef"[3 * k : 3 * k + 3]
        _map(axes[k, 0], mine, depths)
        axes[k, 0].set_title(f"{letters[0]}: {spacing_words(irregular)}\n{label_words(mine)}", fontsize=7.5)
        middle = int(np.median(mine["image"].unique()))
        _image(axes[k, 1], mine[mine["image"] == middle], numbers)
        axes[k, 1].set_title(f"{letters[1]}: image {middle + 1}", fontsize=7.5)
        _shifts(axes[k, 2], shifts[shifts["irregular"] == irregular])
        axes[k, 2].set_title(f"{letters[2]}: lines about the surface", fontsize=7.5)
    for ax, shades, words in (
        (axes[:, 0], ScalarMappable(depths, DEPTH_MAP), "depth / mm"),
        (axes[:, 1], numbers, "number of the line"),
    ):
        figure.colorbar(shades, ax=ax, label=words, location="bottom", aspect=30, pad=0.02)
    return figure


def spacing_words(irregular: float) -> str:
    """The spacing in words.

    Examples
    --------
    >>> spacing_words(0.0), spacing_words(0.3)
    ('equal spacing', 'steps up to 30 % unequal')
    """
    return f"steps up to {100 * irregular:.0f} % unequal" if irregular else "equal spacing"


def label_words(points: pd.DataFrame) -> str:
    """How many of the detections of real lines have a label, and how many labels are right."""
    has = points["line"] >= 0
    if not has.any():
        return "no label given"
    right = float((points["line"] == points["true_line"])[has].mean())
    share = float(has[points["true_line"] >= 0].mean())
    return f"{100 * share:.0f} % labelled, {100 * right:.1f} % of them right"


def _map(ax: Axes, points: pd.DataFrame, depths: Normalize) -> None:
    """Places of labelled points from above, and those whose label is wrong."""
    given = points[points["line"] >= 0]
    wrong = given[given["line"] != given["true_line"]]
    shown = given.iloc[:: max(1, -(-len(given) // _MOST_POINTS))]
    ax.scatter(shown["x_mm"], shown["y_mm"], c=shown["depth_mm"], cmap=DEPTH_MAP, norm=depths, s=0.5, lw=0,
               gid="labelled", rasterized=True)  # fmt: skip
    if len(wrong):
        ax.plot(wrong["x_mm"], wrong["y_mm"], ls="none", marker="x", ms=3, mew=0.7, color=VERMILION,
                label=f"wrong label: {count(len(wrong))}", gid="wrong")  # fmt: skip
        ax.legend(loc="upper left", fontsize=6.5)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x / mm", ylabel="y / mm")
    ax.grid()


def _image(ax: Axes, points: pd.DataFrame, numbers: ScalarMappable) -> None:
    """Detections of one image, coloured by label; grey ones have none, with the reason."""
    has = points["line"] >= 0
    none = points[~has]
    ax.plot(none["x_px"], none["row"], ls="none", marker=".", ms=1.4, mew=0, color="0.6", gid="without label")
    shades = numbers.to_rgba(points["line"][has].to_numpy(np.float64))
    ax.scatter(points["x_px"][has], points["row"][has], c=shades, s=1.6, lw=0, gid="detections")
    reasons = none["reason"].value_counts()
    words = [
        f"no label (grey): {count(len(none))}",
        *(f"{name}: {count(int(n))}" for name, n in reasons.items()),
    ]
    ax.text(0.98, 0.02, "\n".join(words), transform=ax.transAxes, fontsize=6, ha="right", va="bottom")
    low, high = float(points["row"].min()), float(points["row"].max())
    # room for the reasons
    ax.set_ylim(high + 0.45 * (high - low), low - 0.03 * (high - low))
    ax.set(xlabel="column / px", ylabel="row / px")


def _shifts(ax: Axes, shifts: pd.DataFrame) -> None:
    """By how much lines disagree about the surface, with the labels and with all of them shifted."""
    colours = [SKY if shift == 0 else GREY for shift in shifts["shift"]]
    bars = ax.bar(shifts["shift"], shifts["median_mm"], color=colours, gid="shifts")
    ax.bar_label(bars, [f"{value:.2f}" for value in shifts["median_mm"]], fontsize=6, padding=1)
    ax.set_ylim(0.0, 1.35 * max(float(shifts["median_mm"].max()), 1e-3))
    verdict = (
        "told apart: labels are given" if bool(shifts["resolved"].iloc[0]) else "not told apart: no labels"
    )
    ax.text(0.5, 0.97, verdict, transform=ax.transAxes, fontsize=7, ha="center", va="top")
    ax.set_xticks(shifts["shift"])
    ax.set(xlabel="all labels shifted by", ylabel="median disagreement / mm")
    ax.grid(axis="y")
