"""Tables of lines and labels, for figures in the manner of T Fig. 4.3 and 4.4 and for points."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from thalweg.lightsheet.multi_line.detections import Hypotheses
from thalweg.lightsheet.multi_line.scan_labels import ScanLabels
from thalweg.lightsheet.multi_line.sheet_curves import Lines
from thalweg.lightsheet.multi_line.surface_map import Pose, in_map
from thalweg.lightsheet.optics.projection import project
from thalweg.lightsheet.optics.refracted_rays import refract_to_water
from thalweg.lightsheet.optics.sensor import Sensor


def line_table(
    sensor: Sensor, lines: Lines, depths_mm: Sequence[float], *, beams_per_line: int = 61
) -> pd.DataFrame:
    """Where the lines meet levels, in space and in the image: T Fig. 4.3 a to c.

    Returns
    -------
    ``line, fan_angle_deg, depth_mm, x_mm, y_mm, z_mm`` (lcs), ``x_px, y_px``, and ``in_picture``.
    """
    parts = []
    a = np.linspace(-lines.half_angle_rad, lines.half_angle_rad, beams_per_line)
    for label, sheet in zip(lines.labels, lines.sheets(), strict=True):
        water = refract_to_water(sheet.origin_lcs_mm, sheet.beams(a), sensor.window)
        for depth in depths_mm:
            xyz = water.at_depth(depth)
            xy = project(sensor, xyz)
            parts.append(
                pd.DataFrame({
                    "line": label, "fan_angle_deg": np.rad2deg(a), "depth_mm": depth,
                    "x_mm": xyz[:, 0], "y_mm": xyz[:, 1], "z_mm": xyz[:, 2],
                    "x_px": xy[:, 0], "y_px": xy[:, 1], "in_picture": sensor.camera.inside(xy),
                })
            )  # fmt: skip
    return pd.concat(parts, ignore_index=True)


def label_table(images: Sequence[Hypotheses], poses: Sequence[Pose], found: ScanLabels) -> pd.DataFrame:
    """All detections of a scan with label, reason and, where they have a label, place: T Fig. 4.4 d to f.

    Returns
    -------
    ``image, row, x_px, segment, line`` (-1 for none), ``best_line, margin, flag, x_mm, y_mm, depth_mm``, the
    places in the frame of the map and NaN without a label.
    """
    parts = []
    rows = zip(images, poses, found.labels, found.flags, strict=True)
    for k, (h, pose, labels, flags) in enumerate(rows):
        xyd = np.full((len(labels.label), 3), np.nan)
        i = np.flatnonzero(labels.label >= 0)
        xyd[i] = in_map(h, pose)[0][i, labels.label[i]]
        parts.append(
            pd.DataFrame({
                "image": k, "row": h.detections.row, "x_px": h.detections.x_px, "segment": h.segment,
                "line": labels.label, "best_line": labels.best, "margin": labels.margin, "flag": flags,
                "x_mm": xyd[:, 0], "y_mm": xyd[:, 1], "depth_mm": xyd[:, 2],
            })
        )  # fmt: skip
    return pd.concat(parts, ignore_index=True)
