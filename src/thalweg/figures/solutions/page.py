"""One page on INS, camera and fused trajectory of a survey, side by side (T 3.1.4)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy.cloud_to_mesh.comparison_tables import ALL, WITHOUT_OUTLIERS
from thalweg.accuracy.solutions.comparison import COMMON, SHOTS, TRAJECTORY, chains_of, value
from thalweg.accuracy.solutions.ranges import LEAST
from thalweg.figures.page import Page
from thalweg.figures.solutions.comparison import IN_WORDS
from thalweg.figures.solutions.words import (
    PUBLISHED_WORDS,
    Costs,
    for_and_against,
    lead,
    outage_rows,
    outage_words,
    range_words,
    side_by_side,
)
from thalweg.figures.style import count

TWIN_NOTE: Final = (
    "The digital twin made these data: survey, images and reference are simulated. The figures speak of the "
    "software and of the models of the instruments, not of a real boat."
)
SHOWN: Final = {"m": (1e3, "mm"), "deg": (1.0, "°"), "1/m2": (1.0, "1/m²"), "s": (1.0, "s"), "1": (1.0, "")}
"""Unit of a table -> factor and unit for people."""

SETS: Final = (
    (SHOTS, "Points of the lidar"),
    (TRAJECTORY, "Poses and their predicted sigmas"),
    (ALL, "Distances to the reference, all points"),
    (WITHOUT_OUTLIERS, "Distances to the reference, without outliers"),
    (COMMON, "The same without outliers, at times at which every trajectory has a pose"),
)
TRUTH_SETS: Final = ("own poses", "times with a pose by every chain")

EVERY_RANGE: Final = 5
"""Of the range classes every so many-th stands in the table of the page; all are in the file."""


def trajectory_comparison_page(
    table: pd.DataFrame,
    by_range: pd.DataFrame,
    facts: Mapping[str, Any],
    *,
    truth: pd.DataFrame | None = None,
    costs: Costs | None = None,
    pictures: Sequence[Path] = (),
    captions: Mapping[str, str] | None = None,
    title: str = "INS, camera and fused trajectory",
    twin: bool = False,
) -> Page:
    """The page that compares the chains.

    Parameters
    ----------
    table : of `thalweg.accuracy.solutions.comparison.chains_table`.
    by_range, facts : of `thalweg.accuracy.solutions.ranges`; without rows where there is no reference.
    truth : for a twin, of `thalweg_lab.truth.solutions.chains_truth_table`.
    costs : what each chain needs.
    pictures : PNG files, shown in their order.
    captions : stem of a picture -> its caption.
    title : heading.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a picture is missing.
    """
    costs = costs or Costs()
    page = Page(title, lead(table))
    if twin:
        page.text(TWIN_NOTE)
    page.text(PUBLISHED_WORDS)
    page.section("Side by side")
    page.table(side_by_side(table, costs), "The decisive numbers")
    page.section("For and against")
    page.table(for_and_against(table, costs), "What the numbers say for and against each trajectory")
    if pictures:
        page.section("Figures")
    for picture in pictures:
        page.figure(picture, (captions or {}).get(picture.stem, picture.stem.replace("_", " ")))
    if costs.outages is not None:
        page.section("Without GNSS, without images").text(outage_words(costs.outages))
        if len(costs.outages):
            caption = "Sigma of the place in the longest gaps, root mean square and greatest"
            page.table(outage_rows(costs.outages), caption, {"begin": "UTC", "length": "s"})
    if len(by_range):
        _ranges(page, by_range, facts)
    page.section("All numbers").text(
        "Clouds of all trajectories went through the same filters, the same reference and the same outlier "
        "rule: a point is an outlier if its distance over its own sigma is too far from the median of these "
        "ratios. Published values stand beside for comparison only; the published mean is printed without a "
        "sign, and the figures of that paper show its points behind the reference."
    )
    for of, caption in SETS:
        rows = table[table["of"] == of]
        if len(rows):
            page.table(numbers(rows, chains_of(table)), f"{caption} (chains.csv)")
    if truth is not None and len(truth):
        _truth(page, truth)
    page.section("Limits").text(limits(table))
    return page


def numbers(rows: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Rows of a table of chains for people: words, unit, a column a chain, and the published ones if any."""
    columns = {name: IN_WORDS[name] for name in names}
    published = [name for name in rows.columns if name.startswith("published_") and rows[name].notna().any()]
    columns |= {name: f"published, {IN_WORDS[name.removeprefix('published_')]}" for name in published}
    out = []
    for row in rows.to_dict("records"):
        factor, unit = SHOWN.get(str(row["unit"]), (1.0, str(row["unit"])))
        cells = {heading: cell(factor * float(row[name])) for name, heading in columns.items()}
        out.append({"quantity": row["words"], "unit": unit} | cells)
    return pd.DataFrame(out)


def cell(number: float) -> str:
    """Three significant digits; whole numbers above a thousand with all of theirs."""
    if not np.isfinite(number):
        return "–"
    text = count(round(number)) if abs(number) >= 1000 else f"{number:.3g}"
    return text.replace("-", "\N{MINUS SIGN}")


def limits(table: pd.DataFrame) -> str:
    """What the page does not prove."""
    n = [value(table, WITHOUT_OUTLIERS, "independent_values", name) for name in chains_of(table)]
    words = [
        "All clouds come from one drive and one lidar: its noise, the plants on the bank and the errors of "
        "the reference are in all of them alike.",
    ]
    if np.isfinite(n).any():
        words.append(
            f"Their RMSE rest on {np.nanmin(n):.0f} to {np.nanmax(n):.0f} independent values each, under the "
            "correlation time of accuracy.correlation_s for every trajectory; another survey would "
            "give other numbers."
        )
    words.append(
        "The trajectory by the camera leans on the INS between images, and the outlier rule judges each "
        "cloud by its own sigmas: honest sigmas take out plants, too large ones keep them."
    )
    return " ".join(words)


def _ranges(page: Page, by_range: pd.DataFrame, facts: Mapping[str, Any]) -> None:
    page.section("By range").text(range_words(facts))
    names = facts["chains"]
    rows = by_range[by_range["points"] == facts["points"]]
    rows = rows[rows["range_m"] % EVERY_RANGE == 0]
    out = []
    for row in rows.to_dict("records"):
        line: dict[str, Any] = {"range": int(row["range_m"])}
        for name in names:
            enough = row[f"{name}_n"] >= LEAST
            line |= {
                f"n, {IN_WORDS[name]}": count(int(row[f"{name}_n"])),
                f"{IN_WORDS[name]}": cell(1e3 * row[f"{name}_rmse_observed_m"] if enough else np.nan),
                f"{IN_WORDS[name]}, predicted": cell(1e3 * row[f"{name}_rmse_predicted_m"]),
            }
        best = row["best_observed"]
        line["smallest"] = IN_WORDS.get(best, "–") + (" (certain)" if row["decided"] is True else "")
        out.append(line)
    caption = (
        f"RMSE in mm, {facts['points']}, every {EVERY_RANGE} m (all classes: chains_by_range.csv); fewer "
        f"than {LEAST} points: no RMSE"
    )
    page.table(pd.DataFrame(out), caption, {"range": "m"})


def _truth(page: Page, truth: pd.DataFrame) -> None:
    page.section("Against the truth of the digital twin").text(
        "The twin knows the true poses. Errors are true minus estimated; normalised ones are squares over "
        "the predicted covariance, with an expectation of 1 for honest sigmas. The poses by the camera are "
        "judged by the true poses of the camera, carried to the body by the mount that was used: the error "
        "of that mount drops out of the cloud, as the lidar is placed by the camera too. The bands of honest "
        "sigmas assume the longest correlation time of INS and antenna for all trajectories. Errors of one "
        "block of images are alike over longer stretches, so that the value of the camera may leave its "
        "band by chance."
    )
    names = chains_of(truth)
    for times in TRUTH_SETS:
        rows = truth[truth["times"] == times]
        if len(rows):
            page.table(numbers(rows, names), f"Errors of the poses, {times} (chains_truth.csv)")
