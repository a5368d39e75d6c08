"""The shift of a line with its width, pooled over the images of a series (`albedo` says how it comes about).

A single image has some ten edges of brightness, too few to tell the coefficient from nothing. The surface,
the lens and the exposure of a series are the same in all of its images::

    k = sum(k_i / s_i^2) / sum(1 / s_i^2),      s_k^2 = max(1, chi^2 / (n - 1)) / sum(1 / s_i^2)
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from thalweg.lightsheet.lines.albedo import SIGNIFICANT, WidthShift
from thalweg.lightsheet.lines.points import LinePoints
from thalweg.lightsheet.lines.settings import LineFlag


def pooled_shift(facts: Sequence[Mapping[str, float]]) -> WidthShift:
    """Coefficient of a series from the ones that `detect_lines` has found in each image.

    Parameters
    ----------
    facts : of `LinePoints`; images without a coefficient or its sigma take no part.
    """
    found = np.array([
        (each["width_shift"], each["sigma_width_shift"], each["width_shift_edges"])
        for each in facts if np.isfinite(each.get("sigma_width_shift", np.nan))
    ]).reshape(-1, 3)  # fmt: skip
    if not len(found):
        return WidthShift(0.0, float("nan"), 0, False)
    k, sigma, edges = found.T
    weight = 1.0 / np.square(sigma)
    mean = float(np.sum(weight * k) / weight.sum())
    factor = max(1.0, float(np.sum(weight * np.square(k - mean))) / max(len(k) - 1, 1))
    sigma_k = float(np.sqrt(factor / weight.sum()))
    return WidthShift(mean, sigma_k, int(edges.sum()), bool(abs(mean) > SIGNIFICANT * sigma_k))


def without_shift(points: LinePoints, shift: WidthShift) -> LinePoints:
    """Points of one image without the shift of a series; as they are if it does not stand out or is removed.

    Parameters
    ----------
    points : measured without removal of a shift (``LineSettings.apply_shift`` false).
    shift : see `pooled_shift`.
    """
    usual = points.facts.get("width_unsaturated_px", float("nan"))
    done = points.facts.get("width_shift_applied", 0.0) > 0.0
    if done or not shift.applied or not np.isfinite(usual):
        return points
    wider = np.where(points.has(LineFlag.SATURATED), points.width_px - usual, 0.0)
    along = np.stack([np.cos(points.angle_rad), np.sin(points.angle_rad)])
    # the coefficient counts along a row or a column, whichever the line was measured in
    step = -shift.coefficient * wider * along / np.abs(along).max(axis=0)
    return replace(
        points, x_px=points.x_px + step[0], y_px=points.y_px + step[1],
        sigma_px=np.hypot(points.sigma_px, shift.sigma * np.abs(wider)),
        facts=points.facts | {
            "width_shift": shift.coefficient, "sigma_width_shift": shift.sigma, "width_shift_applied": 1.0,
        },
    )  # fmt: skip
