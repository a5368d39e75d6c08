"""The accuracy of a cloud in words: verdict, explanation, limits."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy.comparison_tables import ALL, AS_MEASURED, REGISTERED, WITHOUT_OUTLIERS
from thalweg.core.errors import InputError
from thalweg.figures.distances import centimetres
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
    "compared_at_border": "of these nearest to the border of the reference",
    "outliers": "of these outliers",
}
REFERENCE_IN_WORDS: Final = {
    "given": "points of the reference",
    "outside_area": "outside the area of interest and its margin",
    "not_finite": "without finite coordinates",
    "duplicates": "twice in the files",
    "isolated": "isolated",
    "in_front": "in front of the ground: plants, posts, wires",
    "behind": "behind the ground",
    "off_surface": "off the local surface",
    "merged": "merged with others of the same cell",
    "kept": "points that are left",
    "unused_vertices": "of these in no triangle",
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
    share = 100.0 * (1.0 - value_of(statistics, "n") / n_all)
    side = "in front of" if mean > 0 else "behind"
    words = [
        f"Without outliers, {share:.1f} % of {count(int(n_all))} points, the distances of the cloud to the "
        f"reference have an RMSE of {centimetres(rmse)}; 95 % of them are below "
        f"{centimetres(value_of(statistics, 'p95'))}, and on the mean the cloud lies "
        f"{centimetres(abs(mean))} {side} the reference.",
        f"Its own sigmas predict {centimetres(value_of(statistics, 'predicted_rmse'))}: "
        f"{sentence_of(facts.get('verdicts', []), 'sigmas')}.",
        "With all points, plants and whatever else stands in front of the ground included, the RMSE is "
        f"{centimetres(value_of(statistics, 'rmse', ALL))}.",
    ]
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


def limits(facts: Mapping[str, Any], statistics: pd.DataFrame) -> str:
    """What the page does not prove."""
    independent = value_of(statistics, "independent_values")
    rule = facts.get("outlier_limits_m")
    outliers = (
        f"Outliers are distances outside {centimetres(rule[0], sign=True)} to "
        f"{centimetres(rule[1], sign=True)}, {facts.get('outlier_nmads', 0):g} NMAD from the median. The "
        "rule cannot tell a bad point from a good point on a bush; all numbers are therefore given with "
        "and without it."
        if rule
        else "No outlier rule was applied."
    )
    return (
        "Points of one moment share the errors of one pose. For the errors that change over "
        f"{facts.get('correlation_s', float('nan')):g} s the compared points are worth {independent:.0f} "
        "independent values; the bands follow from that. A wide band means that little was tested. Errors "
        "that stay the same for a whole survey, such as those of the mount or of the base station, are one "
        "value, and no band covers them.\n\n"
        f"The reference has errors of its own; {centimetres(facts.get('reference_sigma_m', float('nan')))} "
        "are taken for its position as a whole, and the noise of its vertices from its own points.\n\n"
        f"{outliers}\n\n"
        "Only the area that the reference covers was compared. Points nearest to the border of the reference "
        f"are {'left out' if facts.get('border') == 'exclude' else 'kept'}: their distance says where the "
        "reference ends, not how good the point is."
    )


def sentence_of(entries: Sequence[Mapping[str, str]], key: str, points: str = WITHOUT_OUTLIERS) -> str:
    """A verdict of the comparison on the points as measured; "no verdict" if there is none."""
    found = [e[key] for e in entries if e["registration"] == AS_MEASURED and e["points"] == points]
    return found[0] if found else "no verdict"
