"""The page of adjusted strips: what the bank told, where passes lay apart before and after, what it left."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from thalweg.core import ArrayF
from thalweg.figures import BLUE, GREEN, VERMILION, Finding, Page, drawn, new_figure, styled
from thalweg.lidar import LEAST_TOLD, POSE, Adjusted

_BINS = 30


def strips_page(found: Adjusted, *, title: str, twin: bool, notes: list[str]) -> Page:
    """The page.

    Parameters
    ----------
    found : of `thalweg.lidar.adjust_strips`.
    title : heading.
    twin : true for logs of the digital twin.
    notes : of the readers.
    """
    facts = found.facts
    before, after = 1e3 * facts["distance_before_m"], 1e3 * facts["distance_after_m"]
    page = Page(
        title,
        f"Surfaces that were seen again lie {before:.1f} mm apart before and {after:.1f} mm after the "
        "adjustment (root mean square).",
        [
            Finding("plane spots", f"{facts['planes']:,}"),
            Finding("unknowns that the bank told", f"{facts['told_unknowns']:,.0f}"),
            Finding("observations, redundancy", f"{facts['observations']:,}, {facts['redundancy']:,.0f}"),
            Finding("not on their plane", f"{facts['not_on_planes']:,}"),
            Finding("knots", f"{facts['knots']:,}, one every {facts['knot_s']:.2f} s"),
            Finding("stays as it was", ", ".join(facts["not_told"]) or "nothing"),
        ],
    )
    page.section("Strips")
    page.figure(
        drawn(distances, found.observations, title=title, twin=twin),
        "Distances of the observations from the planes of all passes, root mean square by range (left) and "
        "over time (middle), before and after. Right: residuals by their standard deviations, and the normal "
        "density.",
    )
    page.section("Poses")
    page.figure(
        drawn(corrections, found.knots, title=title, twin=twin),
        "Corrections of the poses with twice their standard deviation (band) and that of before (dashed).",
    )
    told = pd.DataFrame({"error": list(facts["told"]), "share": list(facts["told"].values())})
    page.text(
        f"Share of the variance that the bank took away, mean of all knots. Below {LEAST_TOLD:g} the error "
        "stays as it was: a straight wall tells nothing of a shift along it."
    )
    page.table(told, "Share by error.", digits=3)
    page.table(found.border, "Mount, range and clock: radians, metres, seconds.", digits=3)
    page.section("Notes").lines([*facts["notes"], *notes] or ["none"])
    return page


@styled
def distances(observations: pd.DataFrame, *, title: str, twin: bool) -> Figure:
    """Distances of strips before and after by range and time, and the residuals' histogram."""
    figure = new_figure(70, f"{title}, n = {len(observations)} distances", twin=twin)
    axes = figure.subplots(1, 3)
    for ax, column, label in zip(axes, ("range_m", "t_gps_s"), ("range / m", "time / s"), strict=False):
        x = observations[column].to_numpy() - (observations[column].min() if column == "t_gps_s" else 0.0)
        edges = np.linspace(x.min(), x.max() + 1e-9, _BINS + 1)
        for name, colour in (("before", VERMILION), ("after", BLUE)):
            ax.plot(
                (edges[1:] + edges[:-1]) / 2,
                1e3 * _rms(x, observations[f"{name}_m"], edges),
                color=colour,
                label=name,
            )
        ax.set_xlabel(label)
        ax.set_ylabel("distance / mm")
        ax.set_ylim(bottom=0)
    axes[0].legend()
    z = np.linspace(-5, 5, 101)
    axes[2].hist(observations["z"].clip(-5, 5), bins=z[::2], density=True, color=GREEN)
    axes[2].plot(z, np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi), color="black")
    axes[2].set_xlabel("standardised residual")
    axes[2].set_ylabel("density")
    return figure


def _rms(x: ArrayF, values: pd.Series, edges: ArrayF) -> ArrayF:
    """Root mean square (k,) of values between edges; NaN where there are none."""
    bin_ = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    n, total = (np.bincount(bin_, w, len(edges) - 1) for w in (None, values.to_numpy() ** 2))
    return np.asarray(np.sqrt(np.divide(total, n, out=np.full(len(n), np.nan), where=n > 0)))


@styled
def corrections(knots: pd.DataFrame, *, title: str, twin: bool) -> Figure:
    """Corrections over time, each with its sigma before and after."""
    figure = new_figure(110, f"{title}, n = {len(knots)} knots", twin=twin)
    axes = figure.subplots(3, 2, sharex=True)
    t = knots["t_gps_s"] - knots["t_gps_s"].iloc[0]
    for i, name in enumerate(POSE):
        ax, unit = axes[i % 3, i // 3], "rad" if i >= 3 else "m"
        scale = np.rad2deg(1.0) if i >= 3 else 1e3
        key = name.replace(" ", "_")
        value, sigma, before = (
            scale * knots[column]
            for column in (f"{key}_{unit}", f"sigma_{key}_{unit}", f"sigma_{key}_before_{unit}")
        )
        ax.fill_between(t, value - 2 * sigma, value + 2 * sigma, color=BLUE, alpha=0.25, linewidth=0)
        ax.plot(t, value, color=BLUE)
        for side in (-2, 2):
            ax.plot(t, side * before, color=VERMILION, linestyle="--")
        ax.set_ylabel(f"{name} / {'deg' if i >= 3 else 'mm'}")
        if i % 3 == 2:
            ax.set_xlabel("time / s")
    return figure
