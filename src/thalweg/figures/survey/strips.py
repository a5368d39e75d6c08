"""The page of adjusted strips: what the bank told, where passes lay apart before and after, what it left."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import binned_statistic

from thalweg.figures import BLUE, GREEN, VERMILION, Finding, Page, count, new_figure, styled
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
        f"Surfaces in overlapping strips lie {before:.1f} mm apart before and {after:.1f} mm after the "
        "adjustment (root mean square).",
        [
            Finding("planar patches", count(facts["planes"])),
            Finding("unknowns that the overlaps determine", count(facts["told_unknowns"])),
            Finding("observations", count(facts["observations"]), f"redundancy {count(facts['redundancy'])}"),
            Finding("rejected, off their plane", count(facts["not_on_planes"])),
            Finding("knots", count(facts["knots"]), f"one every {facts['knot_s']:.2f} s"),
            Finding(
                "unknowns left unchanged",
                count(len(facts["not_told"])),
                f"not determined: {', '.join(each.partition(' [')[0] for each in facts['not_told'])}"
                if facts["not_told"]
                else "",
            ),
        ],
    )
    page.section("Strips")
    page.figure(
        distances(found.observations, title=title, twin=twin),
        "Distances of the observations from the planes of all passes, root mean square by range (left) and "
        "over time (middle), before and after. Right: residuals over their standard deviations, and the "
        "normal density.",
    )
    page.section("Poses")
    page.figure(
        corrections(found.knots, title=title, twin=twin),
        "Corrections of the poses; band: ± 2 sigma, dashed: ± 2 sigma before the adjustment.",
    )
    told = pd.DataFrame({"error": list(facts["told"]), "share": list(facts["told"].values())})
    page.text(
        f"An error whose share is below {LEAST_TOLD:g} is not corrected: a straight wall does not determine "
        "a shift along it."
    )
    page.table(told, "Share of the prior variance that the overlaps remove, mean of all knots.", digits=3)
    border = found.border.rename(columns={"sigma_before": "sigma before", "told": "share"})
    page.table(border, "Mount, range and clock: radians, metres, seconds.", digits=3)
    page.section("Notes").lines([*facts["notes"], *notes] or ["none"])
    return page


@styled
def distances(observations: pd.DataFrame, *, title: str) -> Figure:
    """Distances of strips before and after by range and time, and the residuals' histogram."""
    figure = new_figure(70, f"{title}, n = {count(len(observations))} distances")
    axes = figure.subplots(1, 3)
    for ax, column, label in zip(axes, ("range_m", "t_gps_s"), ("range / m", "time / s"), strict=False):
        x = observations[column].to_numpy() - (observations[column].min() if column == "t_gps_s" else 0.0)
        edges = np.linspace(x.min(), x.max() + 1e-9, _BINS + 1)
        for name, colour in (("before", VERMILION), ("after", BLUE)):
            square = binned_statistic(x, observations[f"{name}_m"] ** 2, bins=edges).statistic
            ax.plot((edges[1:] + edges[:-1]) / 2, 1e3 * np.sqrt(square), color=colour, label=name)
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


@styled
def corrections(knots: pd.DataFrame, *, title: str) -> Figure:
    """Corrections over time, each with its sigma before and after."""
    figure = new_figure(110, f"{title}, n = {count(len(knots))} knots")
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
