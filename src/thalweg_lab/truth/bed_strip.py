"""Bed points by the light-sheet sensor on the twin's boat against the true bed (T 3.2)."""

from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.errors import CoverageError
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.geometry.raycast import RayCaster

ABOVE_M: Final = 1.0
"""Heights of the bed are looked up from so far above a point."""


def compare_bed(points: pd.DataFrame, bed: TriangleMesh) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Heights of bed points over the true bed below them, positive above it.

    The nearest place of the bed would not do: stones reach into the ground, and a point below the bed may be
    nearest to the underside of one. Errors of the mount and slow errors of the positions are alike in all
    lines of a strip that lasts a second and shift it as a whole, so ``ratio`` is hardly more than one draw;
    errors of single epochs of the positions, interpolated between them, move neighbouring lines up and down.
    Where the bed is rough a shift sideways scatters the heights within a line as well.

    Parameters
    ----------
    points : `thalweg.lightsheet.scanning.world.BED_POINTS`.
    bed : true bed in wcs.

    Returns
    -------
    One row: points, off_bed (beside the true bed), lines, mean_m, std_m, rms_m, predicted_sigma_m (root mean
    square of the predicted sigmas of the height), ratio (RMS of height over sigma), std_within_lines_m, and
    sigma_line_m (predicted by the image alone, median). And a row a line: file, n, mean_m, std_m.

    Raises
    ------
    CoverageError : no point lies over the bed.
    """
    xyz = points[["east_m", "north_m", "up_m"]].to_numpy(np.float64)
    above = xyz + np.array([0.0, 0.0, ABOVE_M])
    down = np.tile([0.0, 0.0, -1.0], (len(xyz), 1))
    hits = RayCaster(bed.vertices_m, bed.faces).cast(above, down)
    use = hits.primitive >= 0
    if use.sum() < 2:
        raise CoverageError(
            f"{int(use.sum())} of {len(xyz)} points lie over the true bed", expected="points of this strip",
            where="bed strip",
        )  # fmt: skip
    d = hits.t_hit_m[use].astype(np.float64) - ABOVE_M
    sigma = np.sqrt(points["cov_uu_m2"].to_numpy(np.float64)[use])
    own = pd.DataFrame({"file": points["file"].to_numpy()[use], "d": d})
    by_line = own.groupby("file", sort=False)["d"].agg(n="size", mean_m="mean", std_m="std").reset_index()
    within = d - own.groupby("file", sort=False)["d"].transform("mean").to_numpy()
    row = {
        "points": len(xyz), "off_bed": int((~use).sum()), "lines": len(by_line), "mean_m": d.mean(),
        "std_m": d.std(ddof=1), "rms_m": np.sqrt(np.mean(d**2)),
        "predicted_sigma_m": np.sqrt(np.mean(sigma**2)), "ratio": np.sqrt(np.mean((d / sigma) ** 2)),
        "std_within_lines_m": within.std(ddof=1),
        "sigma_line_m": float(np.median(points["sigma_line_m"].to_numpy()[use])),
    }  # fmt: skip
    return pd.DataFrame([row]), by_line
