"""Two labelled scans of a wreck by fifteen lines, equally and unequally spaced, point by point (T 4.2.1).

The study `line_labels` counts over many scenes; this is one of them, for a picture of what a scan can tell
where a single image cannot.
"""

from collections.abc import Sequence
from typing import Final

import pandas as pd

from thalweg.lightsheet.multi_line.scan_labels import Flag, label_scan
from thalweg.lightsheet.multi_line.tables import label_table
from thalweg_lab.studies.calibrated_sensor import calibrated_sensor
from thalweg_lab.studies.line_labels import MAP, Setting, calibrated_lines, simulate_scan

SPACINGS: Final = (0.0, 0.3)
"""Designed irregularities of the spacing: none, and each step up to 30 percent off."""
STEP_MM: Final = 5.0
LASER_SEED: Final = 1
_SIGMA_GROUND_MM: Final = 2.0


def labelled_scans(
    seed: int, *, spacings: Sequence[float] = SPACINGS, step_mm: float = STEP_MM, end_mm: float = -75.0
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Simulate and label one scan of a wreck for each spacing.

    Parameters
    ----------
    seed : of the scene and of all noise; the laser is that of the study.
    spacings : designed irregularities.
    step_mm : from image to image.
    end_mm : where the way of the sensor ends; it begins at 95 mm.

    Returns
    -------
    points : `label_table` with ``irregular``, ``true_line`` (-1: nothing was there) and ``reason``, the flag
        in words.
    shifts : for each spacing how much lines disagree with all labels shifted, see `ScanLabels`, and whether
        the scan was ``resolved``.
    """
    pair, points, shifts = calibrated_sensor(LASER_SEED), [], []
    for irregular in spacings:
        setting = Setting(irregular=irregular, step_mm=step_mm, end_mm=end_mm)
        grating, lines = calibrated_lines(pair, irregular, LASER_SEED)
        scan = simulate_scan(pair, grating, lines, setting, seed)
        found = label_scan(
            scan.images, scan.poses, MAP, ground_depth_mm=scan.ground_depth_mm,
            sigma_ground_mm=_SIGMA_GROUND_MM,
        )  # fmt: skip
        table = label_table(scan.images, scan.poses, found)
        words = table["flag"].map({int(flag): flag.name.lower().replace("_", " ") for flag in Flag})
        points.append(table.assign(irregular=irregular, true_line=scan.truth, reason=words))
        shifts.append(found.shift_test.assign(irregular=irregular, resolved=found.resolved))
    return pd.concat(points, ignore_index=True), pd.concat(shifts, ignore_index=True)
