"""The page on INS, camera and fused trajectory."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy import (
    ALL,
    CERTAIN,
    CHAINS,
    COMMON,
    LEAST,
    PUBLISHED_CROSSING_M,
    REFERENCE,
    SHOTS,
    TRAJECTORY,
    WITHOUT,
    WITHOUT_OUTLIERS,
    chains_of,
    crossing_of,
    outage_table,
    value,
)
from thalweg.core import Trajectory, read_json, utc_text_from_gps
from thalweg.figures import Finding, Page, count, number, plural
from thalweg.figures.accuracy import centimetres
from thalweg.figures.solutions.comparison import IN_WORDS

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

EVERYWHERE: Final = 0.98
"""A chain with poses for a greater share of a gap has them all through: its nodes end short of the edge."""
PUBLISHED_WORDS: Final = (
    "Published for the Freiberger Mulde: an RMSE of 23 cm by INS (Sardemann 2024, 3.1.3) and of 14 cm with a "
    "mean of 6 cm by camera (Sardemann et al. 2023, 6.2), 6 million points by INS against 560 000 by camera, "
    "and error budgets by which the INS is better beyond 11 to 13 m. That was another boat, river and "
    "reference; nothing here is fitted to these numbers."
)
BY_NAME: Final = {
    "ins": "the INS",
    "camera": "the camera",
    "fused": "the fused trajectory",
    "strips": "the trajectory by strips",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """What a chain asks for besides its trajectory.

    Parameters
    ----------
    control : the adjustment's report on control and check points, or None.
    images : number of images that the camera's trajectory rests on, or None.
    seconds : chain -> computing time of its own steps.
    outages : of `thalweg.accuracy.solutions.outage_table`, or None.
    """

    control: pd.DataFrame | None = None
    images: int | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    outages: pd.DataFrame | None = None

    def points(self, role: str) -> int:
        """Control or check points that are marked in images."""
        if self.control is None:
            return 0
        return int(((self.control["role"] == role) & (self.control["images"] > 0)).sum())


# ---------------------------------------------------------------- page


def trajectory_comparison_page(
    table: pd.DataFrame,
    by_range: pd.DataFrame,
    facts: Mapping[str, Any],
    *,
    truth: pd.DataFrame | None = None,
    costs: Costs | None = None,
    pictures: Sequence[Path] = (),
    captions: Mapping[str, str] | None = None,
    title: str = "Trajectories compared",
    twin: bool = False,
) -> Page:
    """The page that compares the chains.

    Parameters
    ----------
    table : of `thalweg.accuracy.solutions.chains_table`.
    by_range, facts : of `thalweg.accuracy.solutions`; without rows where there is no reference.
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
    page = Page(title, *head(table))
    if twin:
        page.text(TWIN_NOTE)
    page.text(PUBLISHED_WORDS)
    page.section("Side by side")
    page.table(side_by_side(table, costs), "The decisive numbers")
    page.pictures(pictures, captions)
    if costs.outages is not None:
        page.section("Without GNSS, without images").text(outage_words(costs.outages))
        if len(costs.outages):
            caption = "Position sigma in the longest gaps, root mean square and greatest"
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


def write_trajectory_comparison_page(
    *,
    chains: Path,
    by_range: Path,
    facts: Path,
    camera_facts: Path,
    fused_facts: Path,
    control: list[Path],
    trajectories: list[Path],
    truth: list[Path],
    pictures: list[Path],
    captions: dict[str, str],
    steps: dict[str, list[str]],
    title: str,
    twin: bool,
    page: Path,
) -> None:
    """The same from files, as the workflow has them; see `trajectory_comparison_page`.

    Parameters
    ----------
    control, truth : none, or one table.
    trajectories : in the order of `CHAINS`; strips are last, where they were adjusted.
    steps : chain -> results of its own jobs, whose records tell their computing times.
    title : of the campaign.
    page : target.
    """
    trajectory_comparison_page(
        pd.read_csv(chains),
        pd.read_csv(by_range),
        read_json(facts),
        truth=pd.read_csv(truth[0]) if truth else None,
        costs=Costs(
            control=pd.read_csv(control[0]) if control else None,
            images=read_json(camera_facts)["images_used"],
            seconds=computing_seconds(steps),
            outages=outage_table(
                read_json(fused_facts)["outages"],
                {name: Trajectory.read(path) for name, path in zip(CHAINS, trajectories, strict=False)},
            ),
        ),
        pictures=pictures,
        captions=captions,
        title=f"Trajectories compared: {title}",
        twin=twin,
    ).write(page)


def numbers(rows: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Rows of a table of chains for people: words, unit, a column a chain, and the published ones if any."""
    columns = {name: IN_WORDS[name] for name in names}
    published = [name for name in rows.columns if name.startswith("published_") and rows[name].notna().any()]
    columns |= {name: f"published, {IN_WORDS[name.removeprefix('published_')]}" for name in published}
    out = []
    for row in rows.to_dict("records"):
        factor, unit = SHOWN.get(str(row["unit"]), (1.0, str(row["unit"])))
        cells = {heading: number(factor * float(row[name])) for name, heading in columns.items()}
        out.append({"quantity": row["words"], "unit": unit} | cells)
    return pd.DataFrame(out)


def limits(table: pd.DataFrame) -> str:
    """What the page does not prove."""
    n = [value(table, WITHOUT_OUTLIERS, "independent_values", name) for name in chains_of(table)]
    words = [
        "All clouds come from one survey and one lidar: noise, plants and errors of the reference are common."
    ]
    if np.isfinite(n).any():
        words.append(
            f"Each RMSE has an effective n of {np.nanmin(n):.0f} to {np.nanmax(n):.0f} "
            "(accuracy.correlation_s); another survey would give other numbers."
        )
    words.append(
        "Between images the camera trajectory is bridged by the INS. Outliers are judged by the sigmas of "
        "each cloud: right ones remove plants, too large ones keep them."
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
                f"n, {IN_WORDS[name]}": count(row[f"{name}_n"]),
                f"{IN_WORDS[name]}": number(1e3 * row[f"{name}_rmse_observed_m"] if enough else np.nan),
                f"{IN_WORDS[name]}, predicted": number(1e3 * row[f"{name}_rmse_predicted_m"]),
            }
        best = row["best_observed"]
        line["smallest"] = IN_WORDS.get(best, "–") + (" (certain)" if row["decided"] is True else "")
        out.append(line)
    caption = (
        f"RMSE in mm, {facts['points']}, every {EVERY_RANGE} m (all classes: chains_by_range.csv); fewer "
        f"than {LEAST} points: no RMSE"
    )
    page.table(out, caption, {"range": "m"})


def _truth(page: Page, truth: pd.DataFrame) -> None:
    page.section("Against the truth of the digital twin").text(
        "The twin knows the true poses. Errors are true minus estimated; normalised ones are squares over "
        "the predicted covariance, with an expectation of 1 for consistent ones. The poses by the camera are "
        "judged by the true poses of the camera, carried to the body by the mount that was used: the error "
        "of that mount drops out of the cloud, as the lidar is placed by the camera too. The bands of "
        "consistent sigmas assume the longest correlation time of INS and antenna for all trajectories. "
        "Errors of one block of images are alike over longer stretches, so that the value of the camera may "
        "leave its band by chance."
    )
    names = chains_of(truth)
    for times in TRUTH_SETS:
        rows = truth[truth["times"] == times]
        if len(rows):
            page.table(numbers(rows, names), f"Errors of the poses, {times} (chains_truth.csv)")


# ---------------------------------------------------------------- words


def head(table: pd.DataFrame) -> tuple[str, list[Finding]]:
    """The first sentence, and of each chain how much of the recording it places and how well."""
    names = chains_of(table)
    findings = []
    rmse = {name: value(table, WITHOUT_OUTLIERS, "rmse", name) for name in names}
    ranked = sorted(names, key=lambda name: rmse[name]) if np.isfinite(list(rmse.values())).all() else []
    for name in names:
        placed = percent(value(table, SHOTS, "share_with_pose", name))
        smallest = "; smallest RMSE" if [name] == ranked[:1] else ""
        findings.append(
            Finding(
                f"cloud to reference, RMSE, by {BY_NAME[name]}",
                centimetres(rmse[name]),
                f"{placed} of the points have a pose{smallest}",
            )
            if ranked
            else Finding(f"points with a pose, by {BY_NAME[name]}", placed)
        )
    if len(ranked) < 2:
        return "No reference surface judges the trajectories.", findings
    best = value(table, WITHOUT_OUTLIERS, "rmse", ranked[0])
    name = BY_NAME[ranked[0]]
    first = f"{name[0].upper()}{name[1:]} has the smallest RMSE ({centimetres(best)})"
    return f"{first}; {certainty(table, *ranked[:2])}.", findings


def certainty(table: pd.DataFrame, first: str, second: str) -> str:
    """Is the difference of two RMSE more than their independent values allow by chance?"""
    n_first, n_second = (
        value(table, WITHOUT_OUTLIERS, "independent_values", name) for name in (first, second)
    )
    ratio = value(table, WITHOUT_OUTLIERS, "rmse", second) / value(table, WITHOUT_OUTLIERS, "rmse", first)
    if not np.isfinite([n_first, n_second, ratio]).all():
        return f"its difference from {BY_NAME[second]} was not tested"
    limit = CERTAIN * float(np.sqrt(1 / (2 * n_first) + 1 / (2 * n_second)))
    certain = "" if np.log(ratio) > limit else "not "
    return (
        f"its difference from {BY_NAME[second]} is {certain}significant (with {n_first:.0f} and "
        f"{n_second:.0f} independent values a ratio of up to {np.exp(limit):.1f} may be chance)"
    )


def range_words(facts: Mapping[str, Any]) -> str:
    """Which chain is better where, and whether theory and result agree on it."""
    names = facts["chains"]
    won = [
        f"{BY_NAME[n]} in {runs_words(facts['best_observed'][n])}" for n in names if facts["best_observed"][n]
    ]
    total, sure = facts["classes"], sum(facts["decided"].values())
    words = [
        f"Of {count(total)} range classes with enough points, the smallest RMSE has {'; '.join(won)}."
        if won
        else "No range class holds enough points of two clouds."
    ]
    if won:
        words.append(
            f"In {count(sure)} of them the lead is certain: points of one class share poses, and few of "
            "their errors are independent."
        )
    words.append(growth_words(facts))
    if {"ins", "camera"} <= set(names):
        words.append(theory_words(facts))
    return " ".join(filter(None, words))


def growth_words(facts: Mapping[str, Any]) -> str:
    """Constant and growing part of the predictions."""
    parts = [
        f"{BY_NAME[name]} {centimetres(form['constant_m'])} and {1e3 * form['per_metre']:.1f} mm per metre "
        "of range"
        for name, form in facts.get("growth", {}).items()
    ]
    return f"The predicted 3D sigmas have a constant and a growing part: {'; '.join(parts)}." if parts else ""


def theory_words(facts: Mapping[str, Any]) -> str:
    """Predicted order of INS and camera, near and far, against the published one and the result."""
    theory = crossing_of(facts, "ins", "camera", "rmse_predicted_3d")
    low, high = PUBLISHED_CROSSING_M
    computed = facts.get("published_crossing_m") or []
    exact = f" (the budgets recomputed: {computed[0]:.1f} m)" if computed else ""
    published = f"published: between {low:g} and {high:g} m{exact}, camera nearer, INS farther"
    if theory.get("crossing_m") is not None:
        here = (
            f"By prediction INS and camera change places at {theory['crossing_m']:.1f} m, "
            f"{BY_NAME[theory['nearer']]} being better nearer and {BY_NAME[theory['farther']]} farther "
            f"({published})."
        )
    elif theory.get("nearer") in BY_NAME:
        here = (
            f"By prediction {BY_NAME[theory['nearer']]} is the better of both at every range ({published})."
        )
    else:
        here = f"Too few points for a prediction ({published})."
    won = {n: _length(facts["best_of_two"][n]) for n in ("ins", "camera")} if "best_of_two" in facts else {}
    if sum(won.values()):
        here += (
            f" Achieved: of these two {BY_NAME['ins']} is better in {won['ins']} classes, "
            f"{BY_NAME['camera']} in {won['camera']}."
        )
    return here


def runs_words(runs: Sequence[Sequence[int]], most: int = 4) -> str:
    """Runs of range classes in words.

    Examples
    --------
    >>> runs_words([[5, 9], [12, 12]])
    '6 classes (5 to 9, 12 m)'
    """
    shown = ", ".join(f"{a} to {b}" if b > a else f"{a}" for a, b in list(runs)[:most])
    more = f" and {len(runs) - most} more runs" if len(runs) > most else ""
    return f"{_length(runs)} class{'es' * (_length(runs) != 1)} ({shown} m{more})"


def _without_gnss(costs: Costs) -> pd.DataFrame | None:
    if costs.outages is None:
        return None
    rows = costs.outages[costs.outages["without"] == "positions"]
    return rows if len(rows) else None


def outage_words(outages: pd.DataFrame) -> str:
    """How many gaps there are of each kind, and how long."""
    parts = []
    for kind, words in WITHOUT.items():
        rows = outages[outages["without"] == kind]
        if len(rows):
            parts.append(
                f"{plural(len(rows), 'gap')} {words}, {rows['length_s'].sum():.1f} s in all, "
                f"longest {rows['length_s'].max():.1f} s"
            )
    if not parts:
        return "Positions and images run through: the fused trajectory had nothing to bridge."
    return (
        f"The fused trajectory found {'; '.join(parts)}. A trajectory has its poses there from the other "
        "sensors, or none; its sigma says what they are worth."
    )


def outage_rows(outages: pd.DataFrame, most: int = 12) -> pd.DataFrame:
    """The longest gaps for people: what lacks, when, how long, and the sigma of each trajectory."""
    names = [name for name in CHAINS if f"{name}_share" in outages.columns]
    shown = outages.sort_values("length_s", ascending=False, kind="stable").head(most)
    out = []
    for row in shown.sort_values("begin_gps_s", kind="stable").to_dict("records"):
        line = {
            "gap": WITHOUT[row["without"]],
            "begin": utc_text_from_gps(row["begin_gps_s"])[11:19],
            "length": f"{row['length_s']:.1f}",
        }
        for name in names:
            cell = "no pose"
            if np.isfinite(row[f"{name}_sigma_m"]):
                cell = f"{centimetres(row[f'{name}_sigma_m'])}, at most {centimetres(row[f'{name}_most_m'])}"
                if row[f"{name}_share"] <= EVERYWHERE:
                    cell += f", poses for {percent(row[f'{name}_share'])}"
            line[IN_WORDS[name]] = cell
        out.append(line)
    return pd.DataFrame(out)


def side_by_side(table: pd.DataFrame, costs: Costs) -> pd.DataFrame:
    """The decisive numbers, one row a question and one column a chain."""
    names = chains_of(table)

    def row(what: str, cells: Mapping[str, str]) -> dict[str, str]:
        """A question, and an answer or a dash for each chain."""
        return {"": what} | {IN_WORDS[name]: cells.get(name, "–") for name in names}

    def of(where: str, quantity: str) -> dict[str, float]:
        """A quantity of the chains that have it."""
        found = {name: value(table, where, quantity, name) for name in names}
        return {name: number for name, number in found.items() if np.isfinite(number)}

    rows = [
        row("points with a pose", {n: percent(x) for n, x in of(SHOTS, "share_with_pose").items()}),
        row("points in the cloud", {n: count(x) for n, x in of(SHOTS, "in_cloud").items()}),
        row("points on a square metre", {n: f"{x:.3g}" for n, x in of(REFERENCE, "density").items()}),
        row("reference that holds points", {n: percent(x) for n, x in of(REFERENCE, "covered").items()}),
    ]
    for quantity, what in (("rmse", "RMSE"), ("bias", "mean"), ("predicted_rmse", "predicted RMSE")):
        cells = {
            n: centimetres(x, sign=quantity == "bias") for n, x in of(WITHOUT_OUTLIERS, quantity).items()
        }
        rows.append(row(f"{what}, without outliers", cells))
    rows += [
        row(
            "longest time without a pose", {n: f"{x:.1f} s" for n, x in of(TRAJECTORY, "longest_gap").items()}
        ),
        row(
            "poses where the INS has none",
            {n: f"{x:.1f} s" for n, x in of(TRAJECTORY, "time_without_ins").items() if n != "ins"},
        ),
    ]
    if costs.control is not None:
        needed = f"{costs.points('control')}, and {costs.points('check')} that check"
        rows.append(row("control points", {n: "none" if n == "ins" else needed for n in names}))
    if costs.images is not None:
        rows.append(row("images", {n: "none" if n == "ins" else count(costs.images) for n in names}))
    without = _without_gnss(costs)
    if without is not None:
        words = f"position sigma without GNSS ({plural(len(without), 'gap')})"
        rows.append(row(words, {n: _sigma_cell(without, n) for n in names}))
    if costs.seconds:
        cells = {n: time_words(s) for n, s in costs.seconds.items()}
        rows.append(row("computing time of its own steps", cells))
    return pd.DataFrame([r for r in rows if any(r[IN_WORDS[n]] not in ("–", "") for n in names)])


def _sigma_cell(outages: pd.DataFrame, name: str) -> str:
    """Root mean square of a chain's sigmas over gaps, and for how much of them it has poses."""
    if f"{name}_sigma_m" not in outages.columns or not outages[f"{name}_sigma_m"].notna().any():
        return "no pose"
    sigma = float(np.sqrt(np.nanmean(outages[f"{name}_sigma_m"] ** 2)))
    share = float(np.average(outages[f"{name}_share"], weights=outages["length_s"]))
    return centimetres(sigma) + ("" if share > EVERYWHERE else f", poses for {percent(share)} of it")


def percent(share: float) -> str:
    """A share in percent; nothing is rounded to 0 or 100 % that is not."""
    if 0.9995 <= share < 1.0:
        return "more than 99.9 %"
    return f"{100 * share:.3g} %" if np.isfinite(share) else "–"


def time_words(seconds: float) -> str:
    """Seconds, minutes or hours with two digits."""
    if seconds < 120:
        return f"{float(f'{seconds:.2g}'):g} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _length(runs: Sequence[Sequence[int]]) -> int:
    return sum(b - a + 1 for a, b in runs)


# ---------------------------------------------------------------- computing time


def computing_seconds(steps: Mapping[str, Sequence[str | Path]]) -> dict[str, float]:
    """Wall time of the jobs that made some results, in seconds, for each chain.

    Parameters
    ----------
    steps : chain -> one result of each of its jobs. The record of a job is ``<result>.meta.json``; a result
        without one (made by hand, or copied) makes the time of its chain unknown, and the chain is left out.
    """
    out = {}
    for chain, results in steps.items():
        records = [Path(f"{str(result).rstrip('/')}.meta.json") for result in results]
        if records and all(record.is_file() for record in records):
            out[chain] = float(sum(read_json(record)["wall_s"] for record in records))
    return out
