"""Which line a detection belongs to: in one image, and along a scan against the growing map.

In a row the labels of the lines grow with the place, at least where nothing thin stands before the surface;
lines may be hidden and detections spurious. A dynamic programme over each row gives for every detection and
label the least cost of the whole row (min-marginals), and segments, which are nearly always of one line,
share these costs among their rows. What remains is a shift: where lines are hidden, all labels of a patch
may move by one with hardly any cost. So a label is given only where it is cheaper than the second best by a
margin, and along a scan the map decides (`surface_map`).
"""

from dataclasses import dataclass

import numpy as np

from thalweg.core.types import ArrayF, ArrayI, ArrayU8
from thalweg.lightsheet.multi_line.detections import Hypotheses, LabelSettings
from thalweg.lightsheet.multi_line.label_kernels import row_marginals
from thalweg.lightsheet.multi_line.surface_map import (
    CONTRADICTED,
    IMPOSSIBLE,
    SUPPORTED,
    Pose,
    SurfaceMap,
    in_map,
)

_CAP = 6.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Labels:
    """Labels of the detections of an image.

    Parameters
    ----------
    label : (n,) index of the line, -1 where it is not sure.
    best : (n,) the most likely index, whether sure or not; -1 where none is possible.
    margin : (n,) mean cost of a row that another label would add to the detection's segment.
    """

    label: ArrayI
    best: ArrayI
    margin: ArrayF

    @property
    def labelled_share(self) -> float:
        """Share of the detections that have a label."""
        return float(np.mean(self.label >= 0)) if len(self.label) else 0.0


def label_image(
    h: Hypotheses, settings: LabelSettings, *, evidence: ArrayF | None = None, shape: float = 1.0
) -> Labels:
    """Labels of one image.

    Parameters
    ----------
    evidence : (n, L) cost of a label from elsewhere; of a depth that is known, or of the map.
    shape : weight of what is usual but not certain: that lines are seen, and that depths are alike. Zero
        leaves the order and the evidence.
    """
    n, L = h.possible.shape
    if n == 0:
        nothing = np.zeros(0, dtype=np.int64)
        return Labels(label=nothing, best=nothing, margin=np.zeros(0))
    columns = np.arange(L)[:: h.order]
    unary = np.where(h.possible, 0.0 if evidence is None else evidence, np.inf)[:, columns]
    depth = np.nan_to_num(h.xyd_mm[:, columns, 2], nan=-999.0)
    missing = np.full(L, shape * settings.missing)
    segment = h.segment
    size = np.bincount(segment, minlength=h.n_segments)
    shared = np.zeros((h.n_segments, L))
    for turn in range(settings.rounds):
        weight = min(1.0, (turn + 1) / 3)
        cost = unary + weight * shared[segment]
        m = row_marginals(
            h.detections.row,
            cost,
            depth,
            missing,
            settings.skip,
            shape * settings.smooth_per_mm,
            settings.smooth_cap_mm,
        )
        shared = _segment_costs(m, segment, size)
    best = shared.argmin(axis=1)
    two = np.partition(shared, 1, axis=1)[:, :2]
    margin = np.where(np.isfinite(two[:, 1] - two[:, 0]), two[:, 1] - two[:, 0], 0.0)
    sure = (margin >= settings.margin) & (size >= settings.min_points)
    best_label = columns[best][segment]
    possible = h.possible[np.arange(n), best_label]
    label = np.where(sure[segment] & possible, best_label, -1)
    label = _in_order(h, label, margin[segment])
    return Labels(label=label, best=np.where(possible, best_label, -1), margin=margin[segment])


def depth_evidence(h: Hypotheses, depth_mm: float, sigma_mm: float) -> ArrayF:
    """Costs (n, L) of labels where the depth of the ground is known, as at the start of a scan."""
    off = (h.xyd_mm[:, :, 2] - depth_mm) / sigma_mm
    return np.where(h.possible, np.minimum(0.5 * np.nan_to_num(off, nan=99.0) ** 2, _CAP), np.inf)


def map_evidence(
    h: Hypotheses, surface: SurfaceMap, pose: Pose, frame: int, settings: LabelSettings
) -> tuple[ArrayF, ArrayU8]:
    """Costs (n, L) of labels from the map, and states (n, L) of the hypotheses.

    A point counts as likely as it is for a true and for a wrong label to be supported or contradicted;
    points of a segment count together.
    """
    xyd, slope, _ = in_map(h, pose)
    state, _ = surface.ask(xyd, slope, h.possible.astype(np.uint8), frame)
    size = np.maximum(np.bincount(h.segment, minlength=h.n_segments), 1)[:, None]
    support = np.zeros((h.n_segments, h.possible.shape[1]))
    np.add.at(support, h.segment, (state == SUPPORTED).astype(np.float64))
    # at the rim of what is known a few points lie on the map by chance: they say nothing
    lies_on_map = (support / size >= settings.support)[h.segment]
    cost = np.zeros(h.possible.shape)
    cost[(state == SUPPORTED) & lies_on_map] = -2.0
    cost[state == CONTRADICTED] = 2.5
    cost[state == IMPOSSIBLE] = 4.0
    total = np.zeros_like(support)
    np.add.at(total, h.segment, cost)
    mean = (total / size)[h.segment]
    both = 0.75 * mean + 0.25 * cost
    return both - both.min(axis=1, keepdims=True), state


def add_labelled(h: Hypotheses, labels: Labels, surface: SurfaceMap, pose: Pose, frame: int) -> None:
    """Put the labelled points of an image on the map."""
    i = np.flatnonzero(labels.label >= 0)
    j = labels.label[i]
    xyd, slope, laser = in_map(h, pose)
    surface.add(xyd[i, j], j, frame, slope[i], laser[i, j])


def _segment_costs(marginals: ArrayF, segment: ArrayI, size: ArrayI) -> ArrayF:
    """Mean over the rows of a segment of what a label costs above the best one, (segments, L)."""
    above = marginals - np.min(marginals, axis=1, keepdims=True, initial=1e6)
    above = np.minimum(np.where(np.isfinite(above), above, _CAP), _CAP)
    total = np.zeros((len(size), marginals.shape[1]))
    np.add.at(total, segment, above)
    return total / np.maximum(size, 1)[:, None]


def _in_order(h: Hypotheses, label: ArrayI, margin: ArrayF) -> ArrayI:
    """Take labels away that stand against the order in their row: of two the less sure one."""
    out = label.copy()
    at = np.flatnonzero(label >= 0)
    while True:
        row = h.detections.row[at]
        wrong = np.flatnonzero((np.diff(row) == 0) & (h.order * np.diff(out[at]) <= 0))
        if len(wrong) == 0:
            return out
        first, second = at[wrong], at[wrong + 1]
        out[np.where(margin[first] < margin[second], first, second)] = -1
        at = np.flatnonzero(out >= 0)
