"""A scan as a table of points with their covariance, in the frame of its poses."""

from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.core.tables import column, frame_of, table_kind
from thalweg.lightsheet.scanning.cloud import ScanCloud

_F = pa.float64()
_COVS: Final = ("xx", "xy", "xz", "yy", "yz", "zz")

SCAN_POINTS: Final = table_kind(
    "scan_points",
    1,
    [
        column("file", pa.string(), "1", "name of the image"),
        column("t_gps_s", _F, "s", "adjusted standard GPS time of the image, NaN if unknown"),
        *(column(f"{a}_m", _F, "m", f"{a} in the frame of the poses") for a in "xyz"),
        *(
            column(f"cov_{ab}_m2", _F, "m^2", f"covariance of {ab[0]} and {ab[1]}, all errors")
            for ab in _COVS
        ),
        column("line", pa.int32(), "1", "number of the laser line, -1 if unknown"),
        column("x_px", _F, "px", "column of the line's point in the image"),
        column("y_px", _F, "px", "row of the line's point in the image"),
        column("peak_dn", _F, "1", "height of the line above its background"),
        column("flags", pa.uint8(), "1", "as in the line points"),
    ],
)
"""Points of a scan. The errors of the sensor and of a panel are common to all points, those of a pose to the
points of its line: the covariances are right for each point, and too large for differences."""


def scan_points(cloud: ScanCloud) -> pd.DataFrame:
    """Table of kind `SCAN_POINTS`."""
    C = cloud.cov_m2
    at = dict(zip(_COVS, ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), strict=True))
    names = np.array(cloud.poses.images, dtype=object)
    return frame_of(SCAN_POINTS, {
        "file": names[cloud.number], "t_gps_s": cloud.t_gps_s,
        **{f"{a}_m": cloud.xyz_m[:, i] for i, a in enumerate("xyz")},
        **{f"cov_{ab}_m2": C[:, i, j] for ab, (i, j) in at.items()},
        "line": cloud.line, "x_px": cloud.xy_px[:, 0], "y_px": cloud.xy_px[:, 1], "peak_dn": cloud.peak_dn,
        "flags": cloud.flags,
    })  # fmt: skip
