"""The accuracy of a cloud in words: verdict, explanation, limits."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy.cloud_to_mesh.comparison_tables import ALL, AS_MEASURED, REGISTERED, WITHOUT_OUTLIERS
from thalweg.core.errors import InputError
from thalweg.core.timescales import utc_text_from_gps
from thalweg.figures.accuracy.distances import centimetres
from thalweg.figures.style import count

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
        f"{count(int(n_all))} points of the cloud were compared with the reference. Without the "
        f"{100.0 * (1.0 - n / n_all):.1f} % of them that are outliers, the distances have an RMSE of "
        f"{centimetres(rmse)}, 95 % of them are smaller than {centimetres(value_of(statistics, 'p95'))}, and "
        f"on average the cloud lies {centimetres(abs(mean))} {'in front of' if mean > 0 else 'behind'} the "
        f"reference.",
        f"Its own sigmas predict {centimetres(value_of(statistics, 'predicted_rmse'))}; "
        f"{sentence_of(facts.get('verdicts', []), 'sigmas')}.",
        f"Seen by parts, {sentence_of(facts.get('verdicts', []), 'parts')}.",
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
        "A comparison with a surface sees only that part of a point's error that points along the "
        "surface's normal. A point that is shifted within a plane bank still lies on the bank. Where "
        "errors are the same in all directions this part is the 3D error divided by the square root of "
        "three, 58 % of it.\n\n"
        f"Here the sigmas of the points predict {full} for all three components together, and {normal} for "
        f"the component along the normal with the reference's own sigma. Only the latter can be held against "
        f"the {observed} that were observed. An observed RMSE below the 3D prediction is therefore no sign "
        "that points are better than predicted.\n\n"
        "Besides, each distance goes to the nearest place of the surface. On rough ground a point that is "
        "off lies near another place than the one it belongs to, and its distance is smaller than its "
        "error. Sardemann et al. (2023, section 7) suspected that when they observed 14 cm where 13 to 25 "
        "cm were predicted for 25 to 50 m; what they predicted was the 3D error."
    )


def limits(
    facts: Mapping[str, Any], statistics: pd.DataFrame, mesh_facts: Mapping[str, Any] | None = None
) -> str:
    """What the page does not prove."""
    independent = value_of(statistics, "independent_values")
    return (
        "Points of one moment share the errors of one pose. For the errors that change over "
        f"{facts.get('correlation_s', float('nan')):g} s (accuracy.correlation_s) the "
        f"compared points are worth {independent:.0f} independent values; the bands follow from that. "
        f"{_observed_correlation(facts, statistics)} Errors that stay the same for a whole survey, such as "
        "those of the mount or of the base station, are one value, and no band covers them.\n\n"
        f"The reference has errors of its own; {centimetres(facts.get('reference_sigma_m', float('nan')))} "
        "are taken for its position as a whole, and the noise of its vertices from its own points. "
        f"{_representativity(mesh_facts or {})}\n\n"
        f"{_outlier_rule(facts)}\n\n"
        "Only the area that the reference covers was compared. Points nearest to the border of the reference "
        f"are {'left out' if facts.get('border') == 'exclude' else 'kept'}: their distance says where the "
        "reference ends, not how good the point is."
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
        f"A beam meets a spot of several centimetres and more at long range, the triangles{size} are another "
        "piece of the same ground. On rough ground, grass and stones both differ without either being wrong; "
        "no sigma here holds that difference."
    )


def _outlier_rule(facts: Mapping[str, Any]) -> str:
    rule = facts.get("outlier_limits_sigmas")
    if not rule:
        return "No outlier rule was applied."
    low, high = (f"{limit:+.1f}".replace("-", "\N{MINUS SIGN}") for limit in rule)
    return (
        f"Outliers are points whose distance is outside {low} to {high} of its own sigmas, "
        f"{facts.get('outlier_nmads', 0):g} NMAD from the median. Sigmas grow with the range, and the limits "
        "with them. The rule cannot tell a bad point from a good point on a bush; all numbers are therefore "
        "given with and without it."
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
            f"Of the reference's surface in the area, {known['reference_area_m2']:,.0f} m², "
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
