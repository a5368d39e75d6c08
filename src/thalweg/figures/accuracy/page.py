"""One page on the accuracy of a cloud: the verdict first, then what it rests on, then its limits."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy import (
    ALL,
    AS_MEASURED,
    REGISTERED,
    WITHOUT_OUTLIERS,
    classes_in_words,
    verdict_of_ratio,
)
from thalweg.core import InputError, utc_text_from_gps
from thalweg.figures import Finding, Page, count
from thalweg.figures.accuracy.distances import centimetres

# ---------------------------------------------------------------- the accuracy of a cloud in words: verdict,
# explanation, limits


POINTS_IN_WORDS: Final = {
    "points": "points of the cloud",
    "outside_area": "outside the area of interest",
    "far_from_reference": "nowhere near the reference",
    "not_in_sample": "left out of the sample (accuracy.max_points)",
    "beyond_max_distance": "farther from the reference than accuracy.max_distance_m",
    "left_out_at_border": "nearest to the border of the reference",
    "without_normal": "where the reference has no normal",
    "compared": "compared",
    "compared_at_border": "of the compared: nearest to the border of the reference",
    "outliers": "of the compared: outliers",
}
OF_COMPARED: Final = ("compared_at_border", "outliers")
"""Counts that are a part of the compared points; all others are a part of the cloud."""

REFERENCE_IN_WORDS: Final = {
    "read": "points of the reference",
    "outside_area": "outside the area of interest and its margin",
    "given": "inside it",
    "not_finite": "without finite coordinates",
    "duplicates": "twice in the files",
    "isolated": "isolated",
    "in_front": "in front of the ground: plants, posts, wires",
    "behind": "behind the ground",
    "off_surface": "off the local surface",
    "merged": "merged with others of the same cell",
    "spikes": "spikes of single points",
    "kept": "points that are left",
    "unused_vertices": "of the points that are left: in no triangle",
    "long_faces": "triangles left out for a long edge",
    "flat_faces": "triangles left out for having no area",
    "fragment_faces": "triangles left out in small separate pieces",
}
MESH_IN_WORDS: Final = (
    ("vertices", "vertices", "1"),
    ("faces", "triangles", "1"),
    ("border_faces", "triangles at the border", "1"),
    ("pieces", "separate pieces", "1"),
    ("area_m2", "area of the surface", "m²"),
    ("median_edge_m", "median edge", "m"),
    ("median_sigma_m", "median sigma of a vertex", "m"),
)


def value_of(
    statistics: pd.DataFrame, quantity: str, points: str = WITHOUT_OUTLIERS, registration: str = AS_MEASURED
) -> float:
    """A number of the table of statistics; NaN if it is not there."""
    chosen = (statistics["registration"] == registration) & (statistics["points"] == points)
    rows = statistics.loc[chosen & (statistics["quantity"] == quantity), "value"]
    return float(rows.iloc[0]) if len(rows) else float("nan")


def head(facts: Mapping[str, Any], statistics: pd.DataFrame) -> tuple[str, list[Finding]]:
    """The first sentence and the numbers that matter most, each with what follows from it."""
    rmse, mean = value_of(statistics, "rmse"), value_of(statistics, "bias")
    n, n_all = value_of(statistics, "n"), value_of(statistics, "n", ALL)
    band = [value_of(statistics, name) for name in ("ratio", "ratio_low95", "ratio_high95")]
    told = verdict_of_ratio(*band)
    certain = abs(mean) > 2 * value_of(statistics, "sigma_of_bias")
    findings = [
        Finding("points compared", count(n_all), f"{100.0 * (1.0 - n / n_all):.1f} % outliers"),
        Finding("RMSE of the distances, without outliers", centimetres(rmse)),
        Finding(
            "predicted by their standard deviations",
            centimetres(value_of(statistics, "predicted_rmse")),
            told,
        ),
        Finding(
            "mean distance",
            centimetres(abs(mean)),
            f"{'in front of' if mean > 0 else 'behind'} the reference, "
            + ("beyond twice its standard deviation" if certain else "no certain offset"),
        ),
    ]
    after = value_of(statistics, "rmse", registration=REGISTERED)
    if np.isfinite(after):
        findings.append(Finding("RMSE after a rigid registration", centimetres(after)))
    caution = f"Caution: {facts['warning']}. " if facts.get("warning") else ""
    predicted = centimetres(value_of(statistics, "predicted_rmse"))
    lead = f"The cloud by INS and GNSS lies {centimetres(rmse)} (RMSE) from the reference, "
    lead += f"with {predicted} predicted: {told}."
    return caution + lead, findings


def verdict(facts: Mapping[str, Any], statistics: pd.DataFrame) -> list[str]:
    """The first sentences: how accurate, whether the sigmas know it, and what a registration would change.

    Raises
    ------
    InputError : no point was compared.
    """
    n_all = value_of(statistics, "n", ALL)
    rmse, mean = value_of(statistics, "rmse"), value_of(statistics, "bias")
    if not (n_all > 0 and np.isfinite(rmse)):
        raise InputError("statistics without compared points", expected=f"rows '{AS_MEASURED}', '{ALL}'")
    n, out = value_of(statistics, "n"), value_of(statistics, "outliers")
    words = [
        f"{count(n_all)} points of the cloud were compared with the reference. Without the "
        f"{100.0 * (1.0 - n / n_all):.1f} % of them that are outliers, the distances have an RMSE of "
        f"{centimetres(rmse)}, 95 % of them are smaller than {centimetres(value_of(statistics, 'p95'))}, and "
        f"on average the cloud lies {centimetres(abs(mean))} {'in front of' if mean > 0 else 'behind'} the "
        f"reference.",
        f"Its own sigmas predict {centimetres(value_of(statistics, 'predicted_rmse'))}; "
        f"{sentence_of(facts.get('verdicts', []), 'sigmas')}.",
        f"Mean and tails: {sentence_of(facts.get('verdicts', []), 'parts')}.",
    ]
    if out > 0:
        front, behind = (value_of(statistics, f"outliers_{side}") for side in ("in_front", "behind"))
        words.append(
            f"Of the outliers {100.0 * front / out:.0f} % lie in front of the reference and "
            f"{100.0 * behind / out:.0f} % behind it. With them the RMSE is "
            f"{centimetres(value_of(statistics, 'rmse', ALL))} and predicted over observed "
            f"{value_of(statistics, 'ratio', ALL):.2f}."
        )
    if facts.get("warning"):
        words.insert(0, f"Caution: {facts['warning']}.")
    after = value_of(statistics, "bias", registration=REGISTERED)
    if np.isfinite(after):
        words.append(
            f"A rigid registration would leave a mean of {centimetres(after, sign=True)} and an RMSE of "
            f"{centimetres(value_of(statistics, 'rmse', registration=REGISTERED))}."
        )
    return words


def explanation(statistics: pd.DataFrame) -> str:
    """In plain words what a comparison with a surface cannot see (P2 7)."""
    full, normal, observed = (
        centimetres(value_of(statistics, name)) for name in ("predicted_rmse_3d", "predicted_rmse", "rmse")
    )
    return (
        "A cloud-to-surface distance measures only the error along the normal of the surface. A point that "
        "is shifted within a plane bank still lies on the bank. Where errors are isotropic, the normal "
        "component is 58 % of the 3D error (1/√3).\n\n"
        f"Here the predicted 3D error is {full}, and the predicted error along the normal, reference "
        f"included, is {normal}. Only the latter is comparable with the observed RMSE of {observed}. An RMSE "
        "below the 3D prediction does not mean that points are better than predicted.\n\n"
        "Each distance is taken to the nearest point of the surface. On rough ground this is often not the "
        "point that was measured, and the distance is smaller than the error. Sardemann et al. (2023, "
        "section 7) suspected this when they observed 14 cm at 25 to 50 m: they had predicted a 3D error of "
        "13 to 25 cm."
    )


def limits(
    facts: Mapping[str, Any], statistics: pd.DataFrame, mesh_facts: Mapping[str, Any] | None = None
) -> str:
    """What the page does not prove."""
    independent = value_of(statistics, "independent_values")
    return (
        "Points measured at the same time share the error of one pose. With a correlation time of "
        f"{facts.get('correlation_s', float('nan')):g} s (accuracy.correlation_s) the effective number of "
        f"independent values is {independent:.0f}; the acceptance bands follow from it. "
        f"{_observed_correlation(facts, statistics)} Systematic errors of the whole survey, such as those of "
        "the mount or of the base station, are outside the bands.\n\n"
        f"The reference has a position sigma of {centimetres(facts.get('reference_sigma_m', float('nan')))} "
        "as a whole; the noise of its vertices is taken from its own points. "
        f"{_representativity(mesh_facts or {})}\n\n"
        f"{_outlier_rule(facts)}\n\n"
        "Only the area that the reference covers was compared. Points nearest to the border of the reference "
        f"are {'left out' if facts.get('border') == 'exclude' else 'kept'}: their distance depends "
        "on the extent of the reference."
    )


def _observed_correlation(facts: Mapping[str, Any], statistics: pd.DataFrame) -> str:
    """What the distances say about the assumed correlation time."""
    seen, assumed = value_of(statistics, "observed_correlation"), facts.get("correlation_s", float("nan"))
    if not np.isfinite(seen):
        return "The distances themselves show no correlation time."
    words = f"The distances themselves are correlated over {seen:.2g} s (lag of 1/e)"
    if seen > 2 * assumed:
        return f"{words}: longer than assumed, and the bands are too narrow if errors of the pose cause it."
    if seen < 0.5 * assumed:
        return (
            f"{words}: shorter than assumed, which makes the bands too wide rather than too narrow, unless "
            "there are errors so slow that they look like a constant offset in a survey of this length."
        )
    return f"{words}, which agrees."


def _representativity(mesh_facts: Mapping[str, Any]) -> str:
    """What a mesh and a footprint of different size do."""
    edge = mesh_facts.get("median_edge_m")
    size = f" (median edge {centimetres(edge)})" if edge else ""
    return (
        f"The footprint of the beam and the triangles{size} of the mesh sample different areas. On rough "
        "ground they differ although neither is wrong. No sigma here includes that difference."
    )


def _outlier_rule(facts: Mapping[str, Any]) -> str:
    rule = facts.get("outlier_limits_sigmas")
    if not rule:
        return "No outlier rule was applied."
    low, high = (f"{limit:+.1f}".replace("-", "\N{MINUS SIGN}") for limit in rule)
    return (
        f"Outliers are points whose distance over sigma is outside {low} to {high}, "
        f"{facts.get('outlier_nmads', 0):g} NMAD from the median. The rule cannot distinguish a wrong point "
        "from a good point on a bush. All numbers are therefore given with and without outliers."
    )


def covered(facts: Mapping[str, Any]) -> str:
    """What the area holds, when it was measured, and what single points are predicted to be good for."""
    words = []
    known = facts.get("coverage", {})
    if "without_reference" in known:
        words.append(
            f"{100 * known['without_reference']:.0f} % of the polygon have no reference (water, shadows, "
            "gaps)."
        )
    if "without_points" in known:
        words.append(
            f"Of the reference's surface in the area, {count(known['reference_area_m2'])} m², "
            f"{100 * known['without_points']:.0f} % hold no compared point and are not tested."
        )
    if facts.get("survey_gps_s"):
        first, last = (utc_text_from_gps(t, 0) for t in facts["survey_gps_s"])
        words.append(
            f"The compared points were measured from {first} to {last}; when the reference was measured "
            "is not known here. A bank moves: what changed in between is in the distances."
        )
    single = facts.get("predicted_95", {})
    if single:
        plan, plan_95, height_half, height_95 = (
            centimetres(single[f"{what}_{name}_m"])
            for what in ("plan", "height")
            for name in ("median", "p95")
        )
        words.append(
            f"For single points the sigmas predict that 95 % of the errors are below {plan} in plan and "
            f"{height_half} in height for half of the compared points, and below {plan_95} and {height_95} "
            "for 95 % of them. A comparison with a surface tests neither of these by itself."
        )
    return " ".join(words)


def sentence_of(entries: Sequence[Mapping[str, str]], key: str, points: str = WITHOUT_OUTLIERS) -> str:
    """A verdict of the comparison on the points as measured; "no verdict" if there is none."""
    found = [e[key] for e in entries if e["registration"] == AS_MEASURED and e["points"] == points]
    return found[0] if found else "no verdict"


# ---------------------------------------------------------------- page


DISTANCES: Final = (
    ("n", "n", "1", 1.0),
    ("bias", "mean", "mm", 1e3),
    ("median", "median", "mm", 1e3),
    ("std", "std", "mm", 1e3),
    ("nmad", "NMAD", "mm", 1e3),
    ("rmse", "RMSE", "mm", 1e3),
    ("p95", "95 % of |d| below", "mm", 1e3),
)
CONSISTENCY: Final = (
    ("rmse", "observed", "mm", 1e3),
    ("predicted_rmse", "predicted", "mm", 1e3),
    ("predicted_rmse_3d", "3D", "mm", 1e3),
    ("ratio", "ratio", "1", 1.0),
    ("ratio_low95", "from", "1", 1.0),
    ("ratio_high95", "to", "1", 1.0),
    ("independent_values", "values", "1", 1.0),
)
PARTS: Final = (
    ("bias", "mean", "mm", 1e3),
    ("sigma_of_bias", "predicted for the mean (1 sigma)", "mm", 1e3),
    ("normalised_median", "median of distance over sigma", "1", 1.0),
    ("normalised_nmad", "NMAD of distance over sigma", "1", 1.0),
    ("ratio_of_middle", "robust ratio (median and NMAD)", "1", 1.0),
    ("middle_low95", "95 % acceptance band, lower limit", "1", 1.0),
    ("middle_high95", "95 % acceptance band, upper limit", "1", 1.0),
    ("normalised_squared_error", "mean of squared distance over variance", "1", 1.0),
    ("consistent_low95", "95 % acceptance band, lower limit", "1", 1.0),
    ("consistent_high95", "95 % acceptance band, upper limit", "1", 1.0),
    ("observed_correlation", "distances are correlated over (lag of 1/e)", "s", 1.0),
)
SHAPE: Final = (
    ("within_1_std", "within 1 std", "%", 1e2),
    ("within_2_std", "within 2 std", "%", 1e2),
    ("within_3_std", "within 3 std", "%", 1e2),
    ("skewness", "skewness", "1", 1.0),
    ("excess_kurtosis", "excess kurtosis", "1", 1.0),
)
TRUTH: Final = (
    *DISTANCES,
    ("predicted_rmse", "predicted", "mm", 1e3),
    ("normalised_squared_error", "e² / sigma²", "1", 1.0),
)
"""Columns of the tables: quantity, heading, unit, units in one of the table's own."""

ERRORS_IN_WORDS: Final = {
    "position": "positions, slow part: factor",
    "roll_pitch": "roll and pitch: factor",
    "heading": "heading: factor",
    "white": "positions, white noise: factor",
    "position_time_s": "positions: correlation time, s",
    "attitude_time_s": "attitude: correlation time, s",
    "component": "lidar, range and directions: factor",
    "footprint": "lidar, position in the footprint: factor",
}

TRUTH_PICTURES: Final = ("error_versus_range",)
"""Stems of pictures that belong to the comparison with the truth."""

RANGE: Final = (
    ("range_m", "range", "m", 1.0),
    ("n", "n", "1", 1.0),
    ("rmse_observed_m", "observed", "mm", 1e3),
    ("rmse_predicted_m", "predicted", "mm", 1e3),
    ("rmse_predicted_3d_m", "3D", "mm", 1e3),
    ("ratio", "ratio", "1", 1.0),
    ("ratio_low95", "from", "1", 1.0),
    ("ratio_high95", "to", "1", 1.0),
    ("inside", "inside", "", 0.0),
)


def accuracy_page(
    facts: Mapping[str, Any],
    statistics: pd.DataFrame,
    by_range: pd.DataFrame,
    registration: Mapping[str, Any],
    mesh_facts: Mapping[str, Any],
    *,
    pictures: Sequence[Path] = (),
    captions: Mapping[str, str] | None = None,
    truth: pd.DataFrame | None = None,
    error_model: Mapping[str, Any] | None = None,
    title: str = "Accuracy of the cloud",
    twin: bool = False,
) -> Page:
    """The page that says how accurate a cloud is, whether its sigmas know it, and how that was found out.

    Parameters
    ----------
    facts : of the comparison, as they stand in the metadata of its table.
    statistics, by_range : tables of the comparison (CSV).
    registration : what a rigid motion onto the reference does.
    mesh_facts : of the reference mesh.
    pictures : PNG files, shown in their order.
    captions : stem of a picture -> its caption.
    truth : for a twin, the statistics of the cloud's errors against the truth.
    error_model : report of the errors of the poses, see `thalweg.navigation.ins_gnss.error_model`.
    title : heading.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : the statistics hold no compared points as measured, or a picture is missing.
    """
    sentences = verdict(facts, statistics)
    page = Page(title, *head(facts, statistics))
    if twin:
        page.text(
            "The digital twin made these data: survey and reference are simulated. The figures speak of the "
            "software and of the models of the instruments, not of a real boat."
        )
    _statistics(page, facts, statistics, " ".join(sentences))
    of_truth = [path for path in pictures if path.stem in TRUTH_PICTURES and truth is not None]
    page.pictures([path for path in pictures if path not in of_truth], captions)
    _ranges(page, by_range)
    page.section("Distances and 3D errors").text(explanation(statistics))
    _places(page, facts)
    _registration(page, registration)
    if error_model is not None:
        _error_model(page, error_model)
    _compared(page, facts, mesh_facts)
    if truth is not None and len(truth):
        _truth(page, truth)
        for picture in of_truth:
            page.figure(picture, (captions or {}).get(picture.stem, picture.stem.replace("_", " ")))
    page.section("Limits").text(limits(facts, statistics, mesh_facts))
    return page


def pivot(
    table: pd.DataFrame, by: Sequence[str], columns: Sequence[tuple[str, str, str, float]]
) -> tuple[pd.DataFrame, dict[str, str]]:
    """A table of quantity and value with one row a set of points, and the units of its columns.

    Parameters
    ----------
    table : columns ``quantity``, ``value`` and those of ``by``.
    by : what names a row.
    columns : quantity, heading, unit, factor; quantities that are not there are left out.
    """
    rows = []
    for names, part in table.groupby(list(by), sort=False):
        known = dict(zip(part["quantity"], part["value"], strict=True))
        row: dict[str, Any] = dict(zip(by, names, strict=True))
        for quantity, heading, _, factor in columns:
            if quantity in known:
                value = known[quantity] * factor
                row[heading] = int(value) if quantity == "n" and np.isfinite(value) else float(value)
        rows.append(row)
    out = pd.DataFrame(rows)
    units = {heading: unit for _, heading, unit, _ in columns if unit != "1" and heading in out.columns}
    return out, units


def _statistics(page: Page, facts: Mapping[str, Any], statistics: pd.DataFrame, words: str) -> None:
    by = ("registration", "points")
    page.section("Statistics").text(words).text(
        "Distances are positive in front of the reference, toward river and air, and negative behind it. "
        "Mean and std are those of a maximum-likelihood normal fit, median and NMAD those of a robust one."
    )
    page.table(*_with_caption(statistics, by, DISTANCES, "Distances of the cloud to the reference"))
    tested = statistics[statistics["registration"] == AS_MEASURED]
    caption = (
        "RMSE observed and predicted: along the normal, and of all three components (3D); ratio of predicted "
        "to observed, its 95 % acceptance band, effective n. A registered cloud cannot test its sigmas"
    )
    page.table(*_with_caption(tested, ("points",), CONSISTENCY, caption))
    rows = [
        {"quantity": words, "unit": "" if unit == "1" else unit}
        | {name: factor * value_of(statistics, quantity, name) for name in (ALL, WITHOUT_OUTLIERS)}
        for quantity, words, unit, factor in PARTS
    ]
    page.table(rows, "Mean, robust ratio, and squared errors over variances")
    page.table(
        *_with_caption(statistics, by, SHAPE, "Shape; a normal has 68.3, 95.4, 99.7 % and zero"), digits=3
    )
    sentences = pd.DataFrame(facts.get("verdicts", []))
    if len(sentences):
        sentences = sentences.drop(columns=["classes", "parts"], errors="ignore")
        page.table(sentences.rename(columns={"normal": "normal distribution"}), "Interpretation")


def _with_caption(
    table: pd.DataFrame, by: Sequence[str], columns: Sequence[tuple[str, str, str, float]], caption: str
) -> tuple[pd.DataFrame, str, dict[str, str]]:
    frame, units = pivot(table, by, columns)
    return frame, caption, units


def _ranges(page: Page, by_range: pd.DataFrame) -> None:
    chosen = (by_range["registration"] == AS_MEASURED) & (by_range["points"] == WITHOUT_OUTLIERS)
    rows = by_range[chosen]
    out, units = pd.DataFrame(index=rows.index), {}
    for name, heading, unit, factor in RANGE:
        out[heading] = rows[name] * factor if factor not in (0.0, 1.0) else rows[name]
        if unit not in ("", "1"):
            units[heading] = unit
    out["inside"] = out["inside"].astype(bool)
    page.section("By range").text(
        f"{classes_in_words(rows)}. If the sigmas are right, the acceptance band holds 95 % of ratios."
    )
    caption = (
        "RMSE in classes of 1 m (D − 0.5 < d ≤ D + 0.5), as measured, without outliers; columns as above"
    )
    page.table(out, caption, units)


def _places(page: Page, facts: Mapping[str, Any]) -> None:
    page.section("Spatial dependency").text(
        "Sardemann et al. (2023) found no local dependency of the accuracy on their bank. The test here is "
        "Moran's I of the mean distances of neighbouring cells. A cell is measured from few poses, so that a "
        "dependency on location may be one on time."
    )
    sentences = pd.DataFrame(facts.get("local_dependency", []))
    if len(sentences):
        page.table(sentences.rename(columns={"words": "verdict"}), "Dependency of the accuracy on location")


def _registration(page: Page, registration: Mapping[str, Any]) -> None:
    page.section("Registration").text(str(registration.get("words", "")))
    if not registration.get("done"):
        return
    rows = [
        {
            "motion": f"{what} {axis}",
            "value": factor * values[axis],
            "sigma": float("nan") if sigmas[axis] is None else factor * sigmas[axis],
            "unit": unit,
        }
        for what, values, sigmas, factor, unit in (
            ("shift", registration["shift_m"], registration["sigma_shift_m"], 1e3, "mm"),
            ("rotation about", registration["rotation_deg"], registration["sigma_rotation_deg"], 1.0, "°"),
        )
        for axis in values
    ]
    caption = "Motion of the cloud onto the reference, about the middle of its points"
    page.table(rows, caption)
    changes = []
    for points, change in registration["change"].items():
        row: dict[str, Any] = {"points": points}
        for word, heading in (("bias", "mean"), ("rmse", "RMSE")):
            row |= {f"{heading} {when}": 1e3 * change[f"{word}_{when}_m"] for when in ("before", "after")}
        changes.append(row | {"share of the mean removed": 100.0 * change["share_of_bias_removed"]})
    frame = pd.DataFrame(changes)
    units = {name: "%" if name.startswith("share") else "mm" for name in frame.columns[1:]}
    page.table(frame, "Effect", units)


def _error_model(page: Page, model: Mapping[str, Any]) -> None:
    a, b = model["heading_deviation_deg"]
    page.section("Pose errors").text(
        "Pose sigmas are those stated in the logs, times factors estimated from the survey. Planes that the "
        "lidar measured twice lie apart by the difference of two pose errors. "
        f"{count(model['planes'])} planes in {model['windows']} time windows were used. Parameters that they "
        "do not determine stay at their priors, whose width enlarges the sigmas. A constant error moves all "
        "surfaces alike and remains undetected. The heading error is "
        f"{a:+.2f} sin h {b:+.2f} cos h degrees with the heading h: "
        + ("corrected." if model["heading_corrected"] else "not significant, not corrected.")
    )
    rows = [
        {
            "parameter": ERRORS_IN_WORDS[name],
            "presumed": e["prior"],
            "estimated": e["value"],
            "68 % from": e["value"] / np.exp(e["sigma_log"]),
            "to": e["value"] * np.exp(e["sigma_log"]),
            "from the": e["from"],
        }
        for name, e in model["estimates"].items()
    ]
    page.table(rows, "Factors on stated sigmas, and correlation times in seconds")
    for note in model["notes"]:
        page.text(str(note))


def _compared(page: Page, facts: Mapping[str, Any], mesh_facts: Mapping[str, Any]) -> None:
    page.section("Data").text(
        f"Area of interest: {facts.get('area', 'not stated')}. Each point is compared with the nearest "
        "point of the reference surface; distances in front of it are positive."
    ).text(covered(facts))
    for caption, counts, words, whole in (
        ("Points of the cloud by class", facts.get("counts", {}), POINTS_IN_WORDS, "points"),
        ("Points of the reference by class", mesh_facts.get("counts", {}), REFERENCE_IN_WORDS, "read"),
    ):
        rows = [
            {
                "class": words.get(name, name.replace("_", " ")),
                "n": int(n),
                "share": float("nan")
                if name.endswith("_faces")
                else 100.0 * n / max(counts.get("compared" if name in OF_COMPARED else whole, 0), 1),
            }
            for name, n in counts.items()
        ]
        if rows:
            page.table(rows, caption, {"share": "%"})
    rows = [
        {
            "quantity": words,
            "value": f"{mesh_facts[name]:.4g}" if unit != "1" else count(mesh_facts[name]),
            "unit": "" if unit == "1" else unit,
        }
        for name, words, unit in MESH_IN_WORDS
        if name in mesh_facts
    ]
    if rows:
        page.table(rows, f"The reference surface (method {mesh_facts.get('method', '?')})")
    lost = [
        {"class": name.replace("_", " "), "n": int(n)}
        for name, n in mesh_facts.get("ingest_losses", {}).items()
        if n
    ]
    if lost:
        page.table(lost, "Lost while the reference was read")
    for note in (*mesh_facts.get("ingest_notes", []), *mesh_facts.get("notes", [])):
        page.text(str(note))


def _truth(page: Page, truth: pd.DataFrame) -> None:
    page.section("Against the truth of the digital twin").text(
        "The twin knows the true surface. The errors of the points along its normal, without any reference "
        "in between, say how much of the numbers above is due to the reference and to plants: bare ground "
        "has no plants."
    )
    frame, units = pivot(truth, ("points",), TRUTH)
    page.table(frame, "Errors of the cloud against the true surface", units)
