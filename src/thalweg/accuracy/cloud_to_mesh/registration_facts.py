"""What a registration did, in numbers and words."""

from typing import Any

import numpy as np
import pandas as pd

from thalweg.accuracy.cloud_to_mesh.comparison_tables import WITHOUT_OUTLIERS, point_sets
from thalweg.accuracy.cloud_to_mesh.registration import AXES, Registration
from thalweg.accuracy.cloud_to_mesh.statistics import describe_errors
from thalweg.core.types import ArrayF


def registration_facts(found: Registration, before: pd.DataFrame, after: pd.DataFrame) -> dict[str, Any]:
    """What a registration did, for a JSON file.

    Sigmas, covariance and what follows from them are None if the survey is too short to tell them.

    Parameters
    ----------
    found : the registration.
    before, after : tables of kind ``cloud_to_mesh`` of the same points.
    """
    sigma = np.full(6, np.nan) if found.cov is None else np.sqrt(np.diag(found.cov))
    test = found.significance()
    changes = {name: _change(before, after, name) for name in point_sets(before)}
    return {
        "done": True,
        "words": _words(found, changes[WITHOUT_OUTLIERS], test),
        "centre_m": _named(found.motion.centre_m),
        "shift_m": _named(found.motion.shift_m),
        "sigma_shift_m": _named(sigma[:3]),
        "rotation_deg": _named(np.rad2deg(found.rotation_rad)),
        "sigma_rotation_deg": _named(np.rad2deg(sigma[3:])),
        "rotation_matrix": found.motion.R.tolist(),
        "covariance": None if found.cov is None else found.cov.tolist(),
        "undetermined": list(found.undetermined),
        "visibility": found.visibility.tolist(),
        "iterations": found.iterations,
        "last_step_m": found.last_step_m,
        "points": found.n,
        "time_blocks": found.blocks,
        "time_blocks_needed": found.blocks_needed,
        "time_block_s": found.block_s,
        "spread_m": found.spread_m,
        "hotelling_f": None if test is None else test[0],
        "hotelling_f_exceeded_in_5_percent": None if test is None else test[1],
        "change": changes,
    }


def _named(values: ArrayF) -> dict[str, float | None]:
    return {a: float(v) if np.isfinite(v) else None for a, v in zip(AXES, values, strict=True)}


def _change(before: pd.DataFrame, after: pd.DataFrame, name: str) -> dict[str, float]:
    out: dict[str, float] = {}
    for when, table in (("before", before), ("after", after)):
        known = describe_errors(table["distance_m"].to_numpy()[point_sets(table)[name]])
        out |= {f"{word}_{when}_m": known[f"{word}_m"] for word in ("bias", "median", "std", "rmse", "nmad")}
        out[f"n_{when}"] = known["n"]
    offset = abs(out["bias_before_m"])
    out["share_of_bias_removed"] = 1 - abs(out["bias_after_m"]) / offset if offset > 0 else 0.0
    return out


def _words(found: Registration, change: dict[str, float], test: tuple[float, float] | None) -> str:
    mm = {name: 1000 * value for name, value in change.items() if name.endswith("_m")}
    fixed = "; ".join(found.undetermined)
    left = f" Not determined by this surface, and left: {fixed}." if fixed else ""
    return (
        f"A motion of {1000 * np.linalg.norm(found.motion.shift_m):.0f} mm and "
        f"{np.rad2deg(np.linalg.norm(found.rotation_rad)):.3f} degrees takes the mean offset from "
        f"{mm['bias_before_m']:.0f} to {mm['bias_after_m']:.0f} mm "
        f"({100 * change['share_of_bias_removed']:.0f} % removed) and the RMSE from "
        f"{mm['rmse_before_m']:.0f} to {mm['rmse_after_m']:.0f} mm. {_significance(found, test)}{left}"
    )


def _significance(found: Registration, test: tuple[float, float] | None) -> str:
    blocks = f"{found.blocks:.0f} time blocks of {found.block_s:g} s"
    if test is None and found.blocks < found.blocks_needed:
        return (
            f"The survey is too short to test that, or to give its sigmas: it is worth {blocks}, "
            f"{found.blocks_needed} are needed."
        )
    if test is None:
        return f"Sigmas cannot be given: of {blocks} one alone determines a part of the motion."
    found_f, limit = test
    size = f"F = {found_f:.1f}, exceeded by chance in 5 % of cases: {limit:.1f}"
    if found_f <= limit:
        return f"This is within what errors that change with time explain, by {blocks} ({size})."
    return (
        f"This is more than errors that change with time explain, by {blocks} ({size}). What is the same at "
        "all times is not in the sigmas: an error of the mount or of the reference, or plants in front."
    )
