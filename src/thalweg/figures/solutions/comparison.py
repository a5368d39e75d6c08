"""Distances to the reference of the clouds by INS, camera and fused trajectory (T Fig. 3.3)."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from scipy.stats import norm

from thalweg.accuracy import (
    ALL,
    CHAINS,
    LEAST,
    PUBLISHED_CROSSING_M,
    WITHOUT_OUTLIERS,
    crossing_of,
    normalised_distances,
    range_facts,
)
from thalweg.core import ArrayF, InputError, root_mean_square
from thalweg.figures import (
    BLUE,
    GREEN,
    GREY,
    HALO,
    PURPLE,
    VERMILION,
    count,
    legend_below,
    new_figure,
    styled,
)
from thalweg.figures.accuracy import centimetres, compared, outlier_rule, round_limit_m

STYLE: Final = {
    "ins": (BLUE, "o"),
    "camera": (VERMILION, "s"),
    "fused": (GREEN, "^"),
    "strips": (PURPLE, "D"),
}
"""Colour and marker of each chain."""
WIDTHS: Final = {"ins": 2.6, "camera": 1.8, "fused": 1.0, "strips": 0.7}
"""Of lines that may lie upon each other: the later and thinner one leaves the others visible."""
IN_WORDS: Final = {"ins": "INS", "camera": "camera", "fused": "fused", "strips": "strips"}
PUBLISHED_FROM: Final = {"ins": "T Table 3.1", "camera": "P2 Table 1"}
BINS: Final = 81
SIGMAS: Final = 5.0
"""Ends of the histogram of distances over their sigmas."""
TOP_SHARE: Final = 0.995
"""Share of the points whose range classes decide about the axes."""


@styled
def chains_by_range(
    table: pd.DataFrame,
    *,
    outlier_nmads: float | None = None,
    title: str = "Distances to the reference by range and trajectory",
) -> Figure:
    """RMSE by range for all chains, achieved and predicted; the error budgets; points per class.

    Parameters
    ----------
    table : of `thalweg.accuracy.solutions.chains_by_range`.
    outlier_nmads : limit of the outlier rule; None: there is none.
    title : first words of the title.

    """
    rows, names = _rows(table)
    n = max(int(rows[f"{name}_n"].sum()) for name in names)
    figure = new_figure(165.0, f"{title}, n = {count(n)} points")
    upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=[2.2, 1.9, 1.0])
    r = rows["range_m"].to_numpy()
    _draw_achieved(upper, rows, r, names)
    words = "a: RMSE of the distances, achieved (solid) and predicted (dashed)"
    upper.set_title(words + outlier_rule(outlier_nmads))
    _draw_theory(middle, rows, r, names)
    for name in names:
        of_class = rows[f"{name}_n"].to_numpy()
        lower.step(
            r, np.where(of_class > 0, of_class, np.nan), where="mid", color=STYLE[name][0], lw=WIDTHS[name]
        )
    lower.set_yscale("log")
    lower.set_ylim(0.7, None)
    lower.set_ylabel("points")
    lower.set_title(f"c: points per class of 1 m; dotted line: {LEAST}, fewer are drawn hollow in a")
    lower.axhline(LEAST, color=GREY, lw=0.8, ls=":")
    lower.yaxis.set_major_locator(LogLocator(numticks=5))
    lower.yaxis.set_major_formatter(FuncFormatter(lambda value, _: count(value) if value >= 1 else ""))
    lower.yaxis.set_minor_formatter(NullFormatter())
    lower.set_xlabel("range / m")
    lower.set_xlim(0.0, _farthest(rows, r, names))
    for ax in (upper, middle, lower):
        ax.grid(axis="y")
    figure.align_ylabels([upper, middle, lower])
    legend_below(figure, upper)
    return figure


@styled
def chain_histograms(
    distances: Sequence[pd.DataFrame],
    *,
    limit_m: float | None = None,
    title: str = "Distances to the reference by trajectory",
) -> Figure:
    """Normalised histograms of the distances of all chains with fitted normal distributions.

    Parameters
    ----------
    distances : tables of kind ``cloud_to_mesh``, in the order of `CHAINS`.
    limit_m : distance at both ends of the axis.
    title : first words of the title.

    Raises
    ------
    InputError : no chain, or a column is missing.
    CoverageError : no point of a chain was compared.
    """
    used = {name: compared(table) for name, table in zip(CHAINS, distances, strict=False)}
    if not used:
        raise InputError("no chain", expected=f"at least one of {', '.join(CHAINS)}")
    of_chains = {name: table["distance_m"].to_numpy() for name, table in used.items()}
    limit = limit_m or max(round_limit_m(d) for d in of_chains.values())
    n = sum(d.size for d in of_chains.values())
    figure = new_figure(98.0, f"{title}, n = {count(n)} points of {len(used)} clouds")
    left, right = figure.subplots(1, 2, width_ratios=[1.5, 1.0])
    for name, table in used.items():
        _draw_histogram(left, of_chains[name], ~table["outlier"].to_numpy(bool), name, limit)
        _draw_normalised(right, normalised_distances(table), name)
    beyond = ", ".join(f"{IN_WORDS[k]} {100 * np.mean(np.abs(d) > limit):.1f}" for k, d in of_chains.items())
    left.set_title(f"a: all points\nbeyond the axis: {beyond} %")
    left.set_xlim(-100 * limit, 100 * limit)
    left.set_xlabel("behind  \N{LEFTWARDS ARROW}   signed distance / cm   \N{RIGHTWARDS ARROW}  in front")
    left.set_ylabel("share per centimetre / %")
    left.axvline(0.0, color="black", lw=0.7, zorder=1)
    x = np.linspace(-SIGMAS, SIGMAS, 301)
    right.plot(x, norm.pdf(x), color="black", lw=1.2, ls=":", label="standard normal")
    right.set_xlim(-SIGMAS, SIGMAS)
    right.set_xlabel("distance over its predicted sigma")
    right.set_ylabel("density")
    right.set_title("b: over sigma; dotted: N(0, 1)")
    for ax in (left, right):
        ax.set_ylim(0.0, None)
        ax.grid(axis="y")
    legend_below(figure, left)
    return figure


def _rows(table: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    names = [name for name in CHAINS if f"{name}_n" in table.columns]
    kept = table[table["points"] == WITHOUT_OUTLIERS]
    kept = kept if len(kept) else table[table["points"] == ALL]
    return kept.sort_values("range_m"), names


def _farthest(rows: pd.DataFrame, r: ArrayF, names: Sequence[str]) -> float:
    """Ranges beyond which hardly a point lies are not drawn."""
    n = sum(rows[f"{name}_n"].to_numpy() for name in names)
    share = np.cumsum(n) / np.sum(n)
    return float(r[min(int(np.searchsorted(share, TOP_SHARE)), len(r) - 1)]) + 1.0


def _draw_achieved(ax: Axes, rows: pd.DataFrame, r: ArrayF, names: Sequence[str]) -> None:
    inside = r <= _farthest(rows, r, names)
    tops = []
    for name in names:
        colour, marker = STYLE[name]
        observed, predicted = (
            1e3 * rows[f"{name}_rmse_{what}_m"].to_numpy() for what in ("observed", "predicted")
        )
        many = rows[f"{name}_n"].to_numpy() >= LEAST
        total = count(rows[f"{name}_n"].sum())
        ax.plot(r, observed, color=colour, lw=1.0, zorder=3)
        words = f"{IN_WORDS[name]}, achieved, n = {total}"
        look: dict[str, Any] = {"color": colour, "ms": 3.2, "zorder": 4}
        ax.plot(r[many], observed[many], marker, **look, label=words)
        ax.plot(r[~many], observed[~many], marker, **look, mfc="white")
        ax.plot(r, predicted, "--", color=colour, lw=1.5, label=f"{IN_WORDS[name]}, predicted")
        tops += [observed[many & inside], predicted[many & inside]]
    values = np.concatenate(tops)
    values = values[np.isfinite(values)]
    # single classes with few points do not decide about the axis
    ax.set_ylim(0.0, 1.15 * float(np.percentile(values, 99)) if values.size else None)
    ax.set_ylabel("RMSE / mm")


def _draw_theory(ax: Axes, rows: pd.DataFrame, r: ArrayF, names: Sequence[str]) -> None:
    """The 3D standard deviations, which is what the papers print."""
    ends: list[float] = []
    at = min(int(np.searchsorted(r, 0.85 * _farthest(rows, r, names))), len(r) - 1)
    known = {
        name: 1e3 * rows[f"published_{name}_3d_m"].to_numpy()
        for name in names
        if f"published_{name}_3d_m" in rows.columns
    }
    for name in names:
        colour = STYLE[name][0]
        own = 1e3 * rows[f"{name}_rmse_predicted_3d_m"].to_numpy()
        ax.plot(r, own, color=colour, lw=WIDTHS[name], ls="--")
        if name in known and np.isfinite(known[name][at]):
            ax.plot(r, known[name], color=colour, lw=1.1, ls=":")
            ends.append(float(known[name][at]))
            words = f"{IN_WORDS[name]}, {PUBLISHED_FROM[name]}"
            ax.annotate(
                words,
                (r[at], known[name][at]),
                xytext=(0, 6),
                textcoords="offset points",
                fontsize=7,
                color=colour,
                path_effects=HALO,
                ha="right",
                zorder=6,
            )
    low, high = PUBLISHED_CROSSING_M
    ax.axvspan(low, high, color="0.88", lw=0, zorder=0)
    words = f"published curves cross\nbetween {low:g} and {high:g} m"
    if {"ins", "camera"} <= set(names):
        facts = range_facts(rows, str(rows["points"].iloc[0]))
        own_m = crossing_of(facts, "ins", "camera", "rmse_predicted_3d").get("crossing_m")
        if own_m is None or own_m > _farthest(rows, r, names):
            words += "\nhere INS and camera do not cross"
        else:
            words += f"\nhere (dashed): at {own_m:.1f} m"
            ax.axvline(own_m, color="black", lw=0.8, ls="--")
    ax.annotate(
        words,
        (high, 0.97),
        xycoords=("data", "axes fraction"),
        xytext=(4, 0),
        textcoords="offset points",
        fontsize=7,
        zorder=6,
        path_effects=HALO,
        ha="left",
        va="top",
        annotation_clip=True,
    )
    shown = [1e3 * rows[f"{name}_rmse_predicted_3d_m"].to_numpy() for name in names]
    inside = r <= _farthest(rows, r, names)
    highest = max([*(float(np.nanmax(s[inside])) for s in shown), *ends])
    ax.set_ylim(0.0, 1.25 * highest)
    ax.set_ylabel("3D sigma / mm")
    ax.set_title("b: predicted for all three components (P2 eq. 9); dashed: here, dotted: published budgets")


def _draw_histogram(ax: Axes, d: ArrayF, kept: ArrayF, name: str, limit: float) -> None:
    colour = STYLE[name][0]
    edges = np.linspace(-limit, limit, BINS + 1)
    per_cm = 1.0 / (d.size * (edges[1] - edges[0]))  # 100 % over 100 cm
    n, _ = np.histogram(d, edges)
    ax.stairs(n * per_cm, 100 * edges, fill=True, color=colour, alpha=0.18)
    ax.stairs(n * per_cm, 100 * edges, color=colour, lw=0.9, gid=f"histogram-{name}")
    inner = d[kept]
    mean, std = float(np.mean(inner)), float(np.std(inner))
    if std > 0:
        x = np.linspace(-limit, limit, 601)
        share = inner.size / d.size
        rmse = root_mean_square(inner)
        ax.plot(
            100 * x,
            share * norm.pdf(x, mean, std),
            color=colour,
            lw=1.6,
            ls="--",
            gid=f"fit-{name}",
            label=f"{IN_WORDS[name]}, n = {count(d.size)}; normal fit without {100 * (1 - share):.1f} % "
            f"outliers: mean {centimetres(mean, sign=True)}, std {centimetres(std)}, "
            f"RMSE {centimetres(rmse)}",
        )


def _draw_normalised(ax: Axes, z: ArrayF, name: str) -> None:
    edges = np.linspace(-SIGMAS, SIGMAS, 51)
    n, _ = np.histogram(z, edges)
    ax.stairs(n / (z.size * np.diff(edges)), edges, color=STYLE[name][0], lw=1.2)
