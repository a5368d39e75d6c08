"""What a registration did, in numbers and words."""

from typing import Any

import numpy as np
import pandas as pd

from thalweg.accuracy.comparison_tables import WITHOUT_OUTLIERS, point_sets
from thalweg.accuracy.registration import AXES, Registration
from thalweg.accuracy.statistics import describe_errors


def registration_facts(found: Registration, before: pd.DataFrame, after: pd.DataFrame) -> dict[str, Any]:
    """What a registration did, for a JSON file.

    Parameters
    ----------
    found : the registration.
    before, after : tables of kind ``cloud_to_mesh`` of the same points.
    """
    sigma = np.sqrt(np.diag(found.cov))
    square, limit = found.significance()
    changes = {name: _change(before, after, name) for name in point_sets(before)}
    return {
        "done": True,
        "words": _words(found, changes[WITHOUT_OUTLIERS], significant=square > limit),
        "centre_m": _named(found.motion.centre_m),
        "shift_m": _named(found.motion.shift_m),
        "sigma_shift_m": _named(sigma[:3]),
        "rotation_deg": _named(np.rad2deg(found.rotation_rad)),
        "sigma_rotation_deg": _named(np.rad2deg(sigma[3:])),
        "rotation_matrix": found.motion.R.tolist(),
        "covariance": found.cov.tolist(),
        "undetermined": list(found.undetermined),
        "visibility": found.visibility.tolist(),
        "iterations": found.iterations,
        "points": found.n,
        "independent_values": found.independent_values,
        "spread_m": found.spread_m,
        "motion_squared_over_variance": square,
        "exceeded_by_chance_in_5_percent": limit,
        "change": changes,
    }


def _named(values: Any) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip(AXES, values, strict=True)}


def _change(before: pd.DataFrame, after: pd.DataFrame, name: str) -> dict[str, float]:
    out: dict[str, float] = {}
    for when, table in (("before", before), ("after", after)):
        known = describe_errors(table["distance_m"].to_numpy()[point_sets(table)[name]])
        out |= {f"{word}_{when}_m": known[f"{word}_m"] for word in ("bias", "median", "std", "rmse", "nmad")}
        out[f"n_{when}"] = known["n"]
    offset = abs(out["bias_before_m"])
    out["share_of_bias_removed"] = 1 - abs(out["bias_after_m"]) / offset if offset > 0 else 0.0
    return out


def _words(found: Registration, change: dict[str, float], *, significant: bool) -> str:
    mm = {name: 1000 * value for name, value in change.items() if name.endswith("_m")}
    fixed = "; ".join(found.undetermined)
    left = f" Not determined by this surface, and left: {fixed}." if fixed else ""
    return (
        f"A motion of {1000 * np.linalg.norm(found.motion.shift_m):.0f} mm and "
        f"{np.rad2deg(np.linalg.norm(found.rotation_rad)):.3f} degrees takes the mean offset from "
        f"{mm['bias_before_m']:.0f} to {mm['bias_after_m']:.0f} mm "
        f"({100 * change['share_of_bias_removed']:.0f} % removed) and the RMSE from "
        f"{mm['rmse_before_m']:.0f} to {mm['rmse_after_m']:.0f} mm. "
        f"It is {'more than' if significant else 'within'} what {found.independent_values:.0f} "
        f"independent values of such errors explain.{left}"
    )
