"""One profile of a scan by itself: outlier rules beside P4 Table 2, brightness and planes (P4 7.2)."""

from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.errors import GeometryError, InputError
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.lightsheet.scanning.bimodality import bimodality
from thalweg.lightsheet.scanning.compare import level_facts, published
from thalweg.lightsheet.scanning.levels import fit_levels
from thalweg.lightsheet.scanning.outliers import RULES, TABLE_2, filtered
from thalweg.lightsheet.scanning.profile import independent_share, profile_of_table, sigma_along

TILT_SIGMA_RAD: Final = 0.003
"""How well the window stands parallel to the levels: a single line tells no tilt across itself."""


def middle_image(distances: pd.DataFrame) -> str:
    """Name of the image in the middle of a scan, among those that have at least half of the most points.

    Parameters
    ----------
    distances : `thalweg.lightsheet.scanning.compare.SCAN_DISTANCES`.

    Raises
    ------
    InputError : no point is used.
    """
    counts = distances[distances["used"]].groupby("file", sort=False).size()
    if not len(counts):
        raise InputError("no point of the scan is used", expected="points on the reference", where="profile")
    full = counts[counts >= 0.5 * counts.max()].index
    return str(full[len(full) // 2])


def single_profile(
    sensor: Sensor, line_points: pd.DataFrame, distances: pd.DataFrame, name: str,
    heights_mm: tuple[float, ...] | None = None,
) -> tuple[pd.DataFrame, dict[str, Any]]:  # fmt: skip
    """Statistics of the scan's middle profile.

    Parameters
    ----------
    sensor : calibrated.
    line_points : of all images of the scan.
    distances : of the scan from its reference; for an object without levels its alignment counts for the
        profile too, because a line alone leaves the motion along a surface free.
    name : of the scan.
    heights_mm : levels of the object, which are then fitted to this line alone.

    Returns
    -------
    A row for each outlier rule and the published one, and facts: image, levels, bimodality.
    """
    image = middle_image(distances)
    facts: dict[str, Any] = {"image": image}
    if heights_mm is None:
        mine = distances[(distances["file"] == image) & distances["used"]]
        d, peak = mine["distance_mm"].to_numpy(), mine["peak_dn"].to_numpy()
        share = 1.0 / max(float(line_points["rows"][line_points["file"] == image].mean()), 1.0)
    else:
        one = profile_of_table(sensor, line_points, image)
        up = sensor.window.normal_lcs
        own, _ = sigma_along(one.own_mm, one.shared_mm, up)
        found = fit_levels(
            one.xyz_lcs_mm, up, heights_mm=heights_mm, sigma_mm=own, tilt_sigma_rad=TILT_SIGMA_RAD
        )
        on = found.used
        d, peak = found.distance_mm[on], one.peak_dn[on]
        share = independent_share(one.rows[on], one.piece[on])
        facts |= {"levels": level_facts(found, heights_mm), "points_on_no_level": int((~on).sum())}
    rows = pd.DataFrame([{"points": "middle line", "lines": 1, **filtered(d, rule).row()} for rule in RULES])
    try:
        facts["bimodality"] = bimodality(d, peak, independent_share=share).words()
    except GeometryError as error:
        facts["bimodality"] = error.found
    facts["rms_mm"] = float(np.sqrt(np.mean(d**2)))
    return pd.concat([rows, published(name, TABLE_2)], ignore_index=True), facts
