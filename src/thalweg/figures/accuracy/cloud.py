"""A finished cloud and its reference: distances from above and from the side, and their page."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.figures import Finding, Page, Pictures, colour_bar, count, new_figure, styled
from thalweg.figures.accuracy.distance_map import DISTANCE_MAP
from thalweg.figures.accuracy.distances import centimetres, compared, round_limit_m, statistics_text

CAPTIONS: Final = {
    "distances_in_plan": "Signed distances of the points from the reference, medians of cells: from above, "
    "and from the side along the longest direction of the cloud. Brown: in front of the reference.",
    "distance_histogram": "Distances with the normal distributions of mean and standard deviation and of "
    "median and NMAD, and their quantiles.",
}
_CELLS: Final = 220
_FEWEST: Final = 8
"""Most and fewest cells along a side of a view."""


@styled
def distances_in_plan(table: pd.DataFrame, *, title: str = "Distances to the reference") -> Figure:
    """Median distances of cells, from above and from the side.

    Parameters
    ----------
    table : of kind ``cloud_to_surface``.
    title : first words of the title.

    Raises
    ------
    CoverageError : no point was compared.
    """
    used = compared(table)
    d = used["distance_m"].to_numpy()
    xyz = used[["east_m", "north_m", "up_m"]].to_numpy()
    plan = xyz[:, :2] - xyz[:, :2].mean(axis=0)
    along = np.linalg.svd(plan[:: max(len(plan) // 20_000, 1)], full_matrices=False)[2][0]
    along = along if along[np.argmax(np.abs(along))] > 0 else -along
    limit = round_limit_m(d)
    head = f"{title}, n = {count(d.size)} points, {statistics_text(d)}"
    span = np.maximum(np.ptp(xyz, axis=0), 1e-3)
    side_m = max(float(np.ptp(plan @ along)), 1e-3)
    upper = float(np.clip(140.0 * span[1] / span[0], 25.0, 120.0))
    lower = float(np.clip(140.0 * span[2] / side_m, 25.0, 70.0))
    figure = new_figure(upper + lower + 30.0, head)
    above, side = np.ravel(figure.subplots(2, 1, height_ratios=[upper, lower]))
    norm = Normalize(-100 * limit, 100 * limit)
    cells = int(np.clip(np.sqrt(len(d)) / 1.5, _FEWEST, _CELLS))
    for ax, x, y in ((above, *xyz[:, :2].T), (side, plan @ along, xyz[:, 2])):
        ax.hexbin(
            x, y, 100 * d, gridsize=cells, reduce_C_function=np.median, cmap=DISTANCE_MAP, norm=norm, lw=0.1,
            rasterized=True,
        )  # fmt: skip
        ax.ticklabel_format(style="plain", useOffset=False)
    above.set(xlabel="east, x / m", ylabel="north, y / m")
    above.set_aspect("equal" if 0.1 < span[1] / span[0] < 10 else "auto")
    above.set_title("a: from above")
    heading = float(np.rad2deg(np.arctan2(along[0], along[1]))) % 360.0
    side.set(xlabel=f"along the direction {heading:.0f} degrees from north (y) / m", ylabel="up, z / m")
    side.set_title("b: from the side, heights not to the scale of lengths")
    colour_bar([above, side], DISTANCE_MAP, norm, "median distance / cm", extend="both", shrink=0.7)
    return figure


def cloud_page(
    facts: Mapping[str, Any],
    pictures: Pictures,
    *,
    captions: Mapping[str, str] = CAPTIONS,
    title: str = "Accuracy",
) -> Page:
    """The page of a finished cloud that was compared with a reference.

    Parameters
    ----------
    facts : of `thalweg.deformation.compare_with_surface`, with ``notes``.
    pictures, captions : by name.
    title : heading.
    """
    counts, raw, kept = facts["counts"], facts["all"], facts["without_outliers"]
    moved = facts.get("registration", {})
    share = counts["compared"] / max(counts["points"], 1)
    findings = [
        Finding("points compared", f"{count(counts['compared'])} of {count(counts['points'])} ({share:.0%})"),
        Finding(
            "mean distance, all and without outliers",
            f"{centimetres(raw['bias_m'], sign=True)}, {centimetres(kept['bias_m'], sign=True)}",
            _offset(moved),
        ),
        Finding(
            "RMSE, all and without outliers", f"{centimetres(raw['rmse_m'])}, {centimetres(kept['rmse_m'])}"
        ),
        Finding(
            "median and NMAD", f"{centimetres(raw['median_m'], sign=True)}, {centimetres(raw['nmad_m'])}"
        ),
    ]
    if moved.get("done"):
        after = moved["without_outliers"]
        findings.append(Finding("RMSE after registration", centimetres(after["rmse_m"])))
    findings.append(Finding("standard deviations of the cloud", "the file states none", "too few data"))
    lead = f"The cloud lies {centimetres(raw['rmse_m'])} (RMSE) from its reference"
    if counts["outliers"]:
        lead += f", {centimetres(kept['rmse_m'])} without {count(counts['outliers'])} outliers"
    lead += f"; {offset}." if (offset := _offset(moved)) else "."
    page = Page(title, lead, findings).pictures(pictures, captions, section="Distances")
    rows = {"all": raw, "without outliers": kept}
    if moved.get("done"):
        rows |= {"registered": moved["all"], "registered, without outliers": moved["without_outliers"]}
    statistics = pd.DataFrame([{"points": name, **row} for name, row in rows.items()])
    statistics["n"] = statistics["n"].astype(int)
    units = {name: "m" for name in statistics.columns if name.endswith("_m")}
    page.table(
        statistics, "Statistics of the signed distances; P95: of their absolute values.", units, digits=3
    )
    page.table(
        pd.DataFrame(counts.items(), columns=["points", "number"]).replace("_", " ", regex=True),
        "Points by class.",
    )
    if moved:
        page.section("Registration")
        _motion(page, moved)
    page.section("Notes").lines(list(facts["notes"]) or ["none"])
    return page


def _offset(moved: Mapping[str, Any]) -> str:
    """What a registration says of an offset of the cloud."""
    if not moved.get("done"):
        return f"no registration: {moved['reason']}" if moved else ""
    size = centimetres(float(np.linalg.norm(list(moved["shift_m"].values()))))
    if moved["f"] is None:
        return f"a motion of {size} fits it better; too few locations to test it"
    if moved["f"] > moved["f_exceeded_in_5_percent"]:
        return f"it lies off by {size}, more than its location explains"
    return f"it lies off by {size}, explained by its location"


def _motion(page: Page, moved: Mapping[str, Any]) -> None:
    if not moved["done"]:
        page.text(f"No registration: {moved['reason']}.")
        return
    rows = []
    for name, unit in (("shift", "m"), ("rotation", "deg")):
        sigma = moved[f"sigma_{name}_{unit}"] or {}
        for axis, value in moved[f"{name}_{unit}"].items():
            rows.append((f"{name} {axis}", value, sigma.get(axis, np.nan), unit))
    table = pd.DataFrame(rows, columns=["motion", "value", "sigma", "unit"])
    page.table(
        table, "Motion that brings the cloud onto the reference, about the middle of the points.", digits=3
    )
    fixed = "; ".join(moved["undetermined"])
    page.text(
        f"Standard deviations from what leaving out one of {moved['cells']} cells of {moved['cell_m']:.3g} m "
        "changes: they hold what differs from place to place, and nothing that the whole cloud shares. "
        + (f"Not determined by this surface, and left: {fixed}." if fixed else "")
    )
