"""Whole scan lines that lie off: poses that are worse than their sigmas say (P4 7.3, C324).

For each line its distances from the reference give a mean and a slope along the line. Both are predicted by
the covariance of the line's pose and by the errors of its points::

    e = B^+ d,     Cov e = B^+ (G C_pose G^T + own errors) B^+^T,     T = e^T Cov^-1 e

with ``B = [1, s]``. T follows a chi-square distribution of two degrees of freedom if the pose is as good as
stated. The limit scales with the median of T over all lines where that is larger than expected: errors that
all lines have, such as those of the sensor, do not make a pose bad.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.lightsheet.poses.poses import M_PER_MM
from thalweg.lightsheet.scanning.against_mesh import MeshDistances
from thalweg.lightsheet.scanning.cloud import ScanCloud
from thalweg.lightsheet.scanning.outliers import NMAD

LEVEL: Final = 0.01
"""Probability with which a scan without bad poses gets one marked."""

LEAST_POINTS: Final = 30
_CUT_NMAD: Final = 5.0
_DEGREES: Final = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class LineCheck:
    """Result of `check_lines`.

    ``table`` one row for each image: image, number, n, mean_mm, sigma_mean_mm (predicted), slope_mm (half the
    change along the line), sigma_slope_mm, statistic, limit, bad, reason; ``scale`` by which the limit was
    widened; ``bad`` (n,) points of bad lines.
    """

    table: pd.DataFrame
    scale: float
    bad: ArrayB

    @property
    def images(self) -> list[str]:
        """Names of the images with bad poses."""
        return [str(name) for name in self.table["image"][self.table["bad"]]]


def check_lines(cloud: ScanCloud, found: MeshDistances, *, level: float = LEVEL) -> LineCheck:
    """Find lines whose distances do not agree with the covariance of their pose.

    Parameters
    ----------
    cloud, found : points in the frame of the reference, and their distances. Lines with fewer than
        `LEAST_POINTS` points on the reference are not judged.
    level : probability of a false alarm in the whole scan.
    """
    rates = cloud.pose_rates(found.normal) / M_PER_MM
    rows = []
    for k in range(len(cloud.poses)):
        on = np.flatnonzero((cloud.number == k) & found.used)
        row = {"image": cloud.poses.images[k], "number": k, "n": len(on)}
        if len(on) < LEAST_POINTS:
            rows.append({**row, "reason": f"fewer than {LEAST_POINTS} points on the reference"})
            continue
        rows.append({**row, **_line(cloud, found, rates, on), "reason": ""})
    columns = ["image", "number", "n", "mean_mm", "sigma_mean_mm", "slope_mm", "sigma_slope_mm", "statistic",
               "reason"]  # fmt: skip
    table = pd.DataFrame(rows, columns=columns)
    values = table["statistic"].to_numpy(np.float64)
    judged = np.isfinite(values)
    scale = 1.0
    if judged.sum() >= 3:
        scale = max(1.0, float(np.median(values[judged])) / float(chi2.median(_DEGREES)))
    limit = scale * float(chi2.isf(level / max(int(judged.sum()), 1), _DEGREES))
    table["limit"] = limit
    table["bad"] = judged & (np.nan_to_num(values) > limit)
    bad_numbers: ArrayI = table["number"].to_numpy(np.int64)[table["bad"].to_numpy()]
    return LineCheck(table=table, scale=scale, bad=np.isin(cloud.number, bad_numbers))


def _line(cloud: ScanCloud, found: MeshDistances, rates: ArrayF, on: ArrayI) -> dict[str, float]:
    """Mean and slope of one line, their predicted sigmas, and the statistic."""
    d = found.distance_mm[on]
    away = np.abs(d - np.median(d))
    on = on[away <= _CUT_NMAD * max(NMAD * float(np.median(away)), 1e-6)]
    d = found.distance_mm[on]
    X = cloud.xyz_m[on] - cloud.xyz_m[on].mean(axis=0)
    along = X @ np.linalg.svd(X, full_matrices=False)[2][0]
    half = max(float(np.abs(along).max()), 1e-9)
    B = np.stack([np.ones(len(on)), along / half], axis=1)
    back = np.linalg.pinv(B)
    e = back @ d
    by_pose = back @ rates[on]
    # what the image measurement leaves: predicted, or what the line shows where that is more
    single = np.hypot(found.sigma_own_mm[on], found.sigma_reference_mm[on])
    seen = float(np.std(d - B @ e)) / max(float(np.sqrt(np.mean(single**2))), 1e-12)
    variance = (single * max(seen, 1.0)) ** 2 / cloud.where(on).independent_share
    cov = by_pose @ cloud.poses.cov[cloud.number[on[0]]] @ by_pose.T + (back * variance) @ back.T
    sigma = np.sqrt(np.diag(cov))
    return {
        "mean_mm": float(e[0]), "sigma_mean_mm": float(sigma[0]), "slope_mm": float(e[1]),
        "sigma_slope_mm": float(sigma[1]), "statistic": float(e @ np.linalg.solve(cov, e)),
    }  # fmt: skip
