"""Labels from one image alone, with a test against a shift of all labels.

Where all lines are seen side by side, their number leaves no room for a shift. Elsewhere only the distances
of the lines can tell: across three neighbouring lines a surface is nearly straight, and with irregular
spacing a shift by one bends it by as much as the spacing is irregular. With regular spacing it does not,
and then one image cannot know.
"""

from dataclasses import replace
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.types import ArrayB, ArrayF
from thalweg.lightsheet.multi_line.detections import Hypotheses, LabelSettings
from thalweg.lightsheet.multi_line.labels import Labels, label_image
from thalweg.lightsheet.multi_line.sheet_curves import Lines

_SHIFTS: Final = (-2, -1, 0, 1, 2)
_LEAST_IRREGULARITY: Final = 0.05
_LEAST_BEND_MM: Final = 0.25
"""Regular lines bend a shifted surface by some 0.05 mm only, and the roughness of a bed is more."""


def label_single_image(
    h: Hypotheses,
    lines: Lines,
    settings: LabelSettings,
    *,
    evidence: ArrayF | None = None,
    ratio: float = 2.0,
    full_share: float = 0.6,
) -> Labels:
    """Labels of one image without a map.

    Parameters
    ----------
    lines : whose spacing decides whether the surface can be asked.
    evidence : see `label_image`.
    ratio : how much more a shifted segment must bend the surface than the segment as it is.
    full_share : share of a segment's rows in which all lines must be seen, else.
    """
    found = label_image(h, settings, evidence=evidence)
    sure = _all_lines_seen(h, found, full_share)
    if spacing_irregularity(lines) > _LEAST_IRREGULARITY:
        sure |= _straightest(h, found, ratio)
    return replace(found, label=np.where(sure, found.label, -1))


def spacing_irregularity(lines: Lines) -> float:
    """Standard deviation of the steps from line to line over their mean, from the middles of the fans."""
    middle = lines.R_lcs_las @ np.array([0.0, 0.0, -1.0])
    axis = lines.R_lcs_las[len(lines.v) // 2]
    across = np.sqrt(1 - np.square(lines.v)) * (middle @ axis[:, 1]) + lines.v * (
        lines.R_lcs_las[:, :, 1] @ axis[:, 1]
    )
    steps = np.diff(across)
    return float(np.std(steps) / abs(np.mean(steps)))


def _straightest(h: Hypotheses, found: Labels, ratio: float) -> ArrayB:
    """Whether a segment bends the surface less than shifted by one or two, (n,)."""
    n, L = h.possible.shape
    given = np.flatnonzero(found.label >= 0)
    if len(given) < 3:
        return np.zeros(n, dtype=np.bool_)
    left, middle, right = given[:-2], given[1:-1], given[2:]
    row, label = h.detections.row, found.label
    beside = (row[left] == row[middle]) & (row[right] == row[middle])
    beside &= (label[middle] - label[left] == h.order) & (label[right] - label[middle] == h.order)
    left, middle, right = left[beside], middle[beside], right[beside]
    bend = pd.DataFrame({"segment": h.segment[middle]})
    for shift in _SHIFTS:
        j = [label[at] + shift for at in (left, middle, right)]
        inside = (np.min(j, axis=0) >= 0) & (np.max(j, axis=0) < L)
        depth = [
            h.xyd_mm[at, np.clip(k, 0, L - 1), 2] for at, k in zip((left, middle, right), j, strict=True)
        ]
        bend[shift] = np.where(inside, np.abs(depth[0] - 2 * depth[1] + depth[2]), np.nan)
    groups = bend.groupby("segment")
    median = groups.median()
    others = median[[shift for shift in _SHIFTS if shift]].min(axis=1)
    clear = (others > ratio * median[0]) & (others - median[0] > _LEAST_BEND_MM)
    good = clear & (groups.size() >= max(8, 30 // h.detections.row_step))
    out = np.zeros(h.n_segments, dtype=np.bool_)
    out[good.index[good.to_numpy()].to_numpy(dtype=np.int64)] = True
    return out[h.segment]


def _all_lines_seen(h: Hypotheses, found: Labels, share: float) -> ArrayB:
    """Whether all lines have a detection in most rows of a segment, (n,)."""
    rows, at = np.unique(h.detections.row, return_inverse=True)
    count = np.zeros(len(rows))
    np.add.at(count, at, found.label >= 0)
    full = count[at] == h.possible.shape[1]
    size = np.maximum(np.bincount(h.segment, minlength=h.n_segments), 1)
    seen = np.bincount(h.segment, weights=full.astype(np.float64), minlength=h.n_segments)
    return np.asarray((seen / size >= share)[h.segment])
