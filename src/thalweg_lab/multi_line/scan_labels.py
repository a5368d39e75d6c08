"""Labels along a scan and from single images, and the tests that decide which of them are given out.

1. Forward: from ground of known depth, image after image against the growing map (`labels`).
   A label is taken where the map supports it, or where the map and the order rule all others out.
2. Confirmation against the finished map: other lines in other images must have seen the same surface at the
   label's place, closely, and at no neighbouring label's place; repeated, because who was confirmed by a
   wrong label falls with it.
3. Shift test of the whole scan. A scan with all labels shifted by one is a surface, too, but lines then
   disagree about it: a little with regular spacing, because angles are not depths, and much with irregular
   spacing. If the labels are not clearly more consistent than those shifted, nothing is given out.
4. Shift test of each segment against its surroundings, and a limit for its disagreement, from the scan's
   own median.

**One image alone** is tested against a shift of all labels. Where all lines are seen side by side, their
number leaves no room for a shift. Elsewhere only the distances of the lines can tell: across three
neighbouring lines a surface is nearly straight, and with irregular spacing a shift by one bends it by as much
as the spacing is irregular. With regular spacing it does not, and then one image cannot know.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import ArrayB, ArrayF, ArrayI, ArrayU8, GeometryError
from thalweg.lightsheet.optics import Sensor, project, refract_to_water
from thalweg_lab.multi_line.labels import (
    CONTRADICTED,
    SUPPORTED,
    Hypotheses,
    Labels,
    MapSettings,
    Pose,
    SurfaceMap,
    add_labelled,
    depth_evidence,
    in_map,
    label_image,
    map_evidence,
)
from thalweg_lab.multi_line.models import Lines

_START_IMAGES: Final = 6
"""Images in which the depth of the ground counts."""
_CONFIRM_RADIUS_MM: Final = 0.7
_CONFIRM_TOLERANCE_MM: Final = 0.2
"""How near other lines must have seen the surface."""
_CONFIRM_SHARE: Final = 0.5
"""Least share of a segment's points that are confirmed."""
_CONFIRM_ROUNDS: Final = 2
_DISAGREEMENT: Final = 2.5
"""Limit of a segment's median difference to other lines, in medians of the scan."""
_SHIFT_RATIO: Final = 1.5
"""Least ratio of the disagreement of the shifted scan to that of the scan."""
_BEND_RATIO: Final = 2.0
"""How much more a shifted segment of one image must bend the surface than the segment as it is."""
_FULL_SHARE: Final = 0.6
"""Share of a segment's rows in which all lines must be seen, else."""

_NEXT: Final = (-1, 0, 1)
_SHIFTS: Final = (-4, -3, -2, -1, 0, 1, 2, 3, 4)
"""Where the leading line is taken for one behind it, patches are shifted by several lines."""

_IMAGE_SHIFTS: Final = (-2, -1, 0, 1, 2)
_LEAST_IRREGULARITY: Final = 0.05
_LEAST_BEND_MM: Final = 0.25
"""Regular lines bend a shifted surface by some 0.05 mm only, and the roughness of a bed is more."""


class Flag(IntEnum):
    """Why a detection has no label; only `GIVEN` has one."""

    GIVEN = 0
    UNSURE = 1
    """Another label is as good, or the segment is too short."""
    NOT_CONFIRMED = 2
    """No other line saw the surface there, or the map speaks against it."""
    INCONSISTENT = 3
    """Other lines disagree more than is usual in this scan."""
    SHIFT_LIKELY = 4
    """Shifted by one the segment fits its surroundings better."""
    SCAN_SHIFT_UNRESOLVED = 5
    """The whole scan would be as consistent with all labels shifted by one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanLabels:
    """Labels of all images of a scan.

    Parameters
    ----------
    labels : for each image.
    flags : for each image (n,) `Flag`.
    shift_test : for each shift ``shift, n, share_met, median_mm``: how much lines disagree.
    resolved : whether the scan as a whole is clearly better than shifted by one or a few lines.
    """

    labels: tuple[Labels, ...]
    flags: tuple[ArrayU8, ...]
    shift_test: pd.DataFrame
    resolved: bool

    def counts(self) -> dict[str, int]:
        """Number of detections with each flag."""
        n = np.bincount(np.concatenate([np.zeros(0, dtype=np.uint8), *self.flags]), minlength=len(Flag))
        return {flag.name: int(n[flag]) for flag in Flag}


def label_scan(
    images: Sequence[Hypotheses],
    poses: Sequence[Pose],
    map_settings: MapSettings,
    *,
    ground_depth_mm: float,
    sigma_ground_mm: float = 2.0,
) -> ScanLabels:
    """Label the detections of a scan that starts on ground of known depth.

    Parameters
    ----------
    images, poses : in the order of the scan; best with the laser ahead of the camera, so that new surface
        is met by the leading line.
    ground_depth_mm, sigma_ground_mm : depth of the ground in the first images; it must be known to half the
        depth that separates two labels (2.5 mm at 150 mm with lines 1.7 degrees apart).

    Raises
    ------
    GeometryError : no images, or another number of poses.
    """
    if not images or len(images) != len(poses):
        raise GeometryError(
            f"{len(images)} images and {len(poses)} poses", expected="one pose for each image"
        )
    found: list[Labels] = []
    surface = SurfaceMap(map_settings)
    for k, (h, pose) in enumerate(zip(images, poses, strict=True)):
        evidence = np.zeros(h.possible.shape)
        state: ArrayU8 | None = None
        if k > 0:
            evidence, state = map_evidence(h, surface, pose, k)
        if k < _START_IMAGES:
            evidence = evidence + np.minimum(depth_evidence(h, ground_depth_mm, sigma_ground_mm), 3.0)
        got = label_image(h, evidence=evidence, shape=0.0 if k else 1.0)
        if state is not None:
            against = (
                np.take_along_axis(state, np.maximum(got.label, 0)[:, None], axis=1)[:, 0] == CONTRADICTED
            )
            got = replace(got, label=np.where(against, -1, got.label))
        add_labelled(h, got, surface, pose, k)
        found.append(got)
    labels = [each.label for each in found]
    flags = [np.where(label < 0, Flag.UNSURE, Flag.GIVEN).astype(np.uint8) for label in labels]
    for _ in range(_CONFIRM_ROUNDS):
        kept = _confirmed(images, poses, labels, map_settings)
        labels = _without(labels, flags, kept, Flag.NOT_CONFIRMED)
    off = {shift: _disagreement(images, poses, labels, map_settings, shift) for shift in _SHIFTS}
    test = pd.DataFrame(
        [
            {
                "shift": shift,
                "n": int(sum(len(each) for each in off[shift])),
                "share_met": _share_met(np.concatenate(off[shift])),
                "median_mm": _median(np.concatenate(off[shift])),
            }
            for shift in _SHIFTS
        ]
    )
    medians = dict(zip(_SHIFTS, test["median_mm"], strict=True))
    # a shift at which no two lines meet has no median and is none that could be confused
    others = [median for shift, median in medians.items() if shift and np.isfinite(median)]
    resolved = bool(others) and min(others) > _SHIFT_RATIO * medians[0]
    if not resolved:
        labels = _without(labels, flags, [label < -1 for label in labels], Flag.SCAN_SHIFT_UNRESOLVED)
    else:
        close, best = _segment_tests(images, labels, off, _DISAGREEMENT * medians[0])
        labels = _without(labels, flags, best, Flag.SHIFT_LIKELY)
        labels = _without(labels, flags, close, Flag.INCONSISTENT)
    return ScanLabels(
        labels=tuple(replace(each, label=label) for each, label in zip(found, labels, strict=True)),
        flags=tuple(flags),
        shift_test=test,
        resolved=resolved,
    )


def label_single_image(h: Hypotheses, lines: Lines) -> Labels:
    """Labels of one image without a map; the spacing of the lines decides if the surface can be asked."""
    found = label_image(h)
    sure = _all_lines_seen(h, found)
    if spacing_irregularity(lines) > _LEAST_IRREGULARITY:
        sure |= _straightest(h, found)
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
                pd.DataFrame(
                    {
                        "line": label,
                        "fan_angle_deg": np.rad2deg(a),
                        "depth_mm": depth,
                        "x_mm": xyz[:, 0],
                        "y_mm": xyz[:, 1],
                        "z_mm": xyz[:, 2],
                        "x_px": xy[:, 0],
                        "y_px": xy[:, 1],
                        "in_picture": sensor.camera.inside(xy),
                    }
                )
            )
    return pd.concat(parts, ignore_index=True)


def _without(labels: list[ArrayI], flags: list[ArrayU8], kept: Sequence[ArrayB], why: Flag) -> list[ArrayI]:
    out = []
    for label, flag, keep in zip(labels, flags, kept, strict=True):
        taken = (label >= 0) & ~keep
        flag[taken] = why
        out.append(np.where(taken, -1, label))
    return out


def _map_of(
    images: Sequence[Hypotheses], poses: Sequence[Pose], labels: Sequence[ArrayI], settings: MapSettings
) -> SurfaceMap:
    surface = SurfaceMap(settings)
    for k, (h, pose, label) in enumerate(zip(images, poses, labels, strict=True)):
        dummy = Labels(label=label, best=label, margin=np.zeros(len(label)))
        add_labelled(h, dummy, surface, pose, k)
    return surface


def _confirmed(
    images: Sequence[Hypotheses], poses: Sequence[Pose], labels: Sequence[ArrayI], settings: MapSettings
) -> list[ArrayB]:
    """Which labels (n,) other lines confirm, for each image."""
    near = replace(settings, radius_mm=_CONFIRM_RADIUS_MM, tolerance_mm=_CONFIRM_TOLERANCE_MM)
    surface = _map_of(images, poses, labels, near)
    out = []
    for k, (h, pose, label) in enumerate(zip(images, poses, labels, strict=True)):
        given = np.flatnonzero(label >= 0)
        n, L = h.possible.shape
        asked = np.zeros((n, L), dtype=np.uint8)
        for shift in _NEXT:
            j = label[given] + shift
            inside = (j >= 0) & (j < L)
            asked[given[inside], j[inside]] = h.possible[given[inside], j[inside]]
        xyd, slope = in_map(h, pose)
        state, _ = surface.ask(xyd, slope, asked, k)
        size = np.maximum(np.bincount(h.segment, minlength=h.n_segments), 1)[:, None]
        share = np.zeros((h.n_segments, L))
        np.add.at(share, h.segment, (state == SUPPORTED).astype(np.float64))
        share = (share / size)[h.segment[given]]
        own = np.take_along_axis(share, label[given, None], axis=1)[:, 0]
        np.put_along_axis(share, label[given, None], 0.0, axis=1)
        against = state[given, label[given]] == CONTRADICTED
        good = np.zeros(len(label), dtype=np.bool_)
        good[given] = (own >= _CONFIRM_SHARE) & ~against & (share.max(axis=1, initial=0.0) <= 0.6 * own)
        out.append(good)
    return out


def _disagreement(
    images: Sequence[Hypotheses],
    poses: Sequence[Pose],
    labels: Sequence[ArrayI],
    settings: MapSettings,
    shift: int,
) -> list[ArrayF]:
    """Differences of depth (mm) of labelled points to what other lines saw there, all labels shifted."""
    near = replace(settings, radius_mm=_CONFIRM_RADIUS_MM, tolerance_mm=1.0, growth=0.0, free_length_mm=0.0)
    moved = []
    for h, label in zip(images, labels, strict=True):
        j = label + shift
        good = (label >= 0) & (j >= 0) & (j < h.possible.shape[1])
        good &= np.take_along_axis(h.possible, np.clip(j, 0, h.possible.shape[1] - 1)[:, None], axis=1)[:, 0]
        moved.append(np.where(good, j, -1))
    surface = _map_of(images, poses, moved, near)
    out = []
    for k, (h, pose, label, j) in enumerate(zip(images, poses, labels, moved, strict=True)):
        i = np.flatnonzero(j >= 0)
        asked = np.zeros(h.possible.shape, dtype=np.uint8)
        asked[i, j[i]] = 1
        xyd, slope = in_map(h, pose)
        off = np.full(len(label), np.nan)
        off[i] = np.abs(surface.ask(xyd, slope, asked, k)[1][i, j[i]])
        out.append(off[label >= 0])
    return out


def _segment_tests(
    images: Sequence[Hypotheses], labels: Sequence[ArrayI], off: dict[int, list[ArrayF]], limit_mm: float
) -> tuple[list[ArrayB], list[ArrayB]]:
    """Which labels (n,) of each image agree with other lines, and which fit better than their neighbours."""
    close: list[ArrayB] = []
    best: list[ArrayB] = []
    for k, (h, label) in enumerate(zip(images, labels, strict=True)):
        given = np.flatnonzero(label >= 0)
        table = pd.DataFrame({str(shift): off[shift][k] for shift in _SHIFTS})
        groups = table.groupby(h.segment[given])
        size = np.bincount(h.segment[given], minlength=h.n_segments)[h.segment[given]]
        median, met = groups.transform("median"), groups.transform("count").div(size, axis=0)
        own = median["0"].to_numpy()
        shifted = np.zeros(len(given), dtype=np.bool_)
        for shift in (str(each) for each in _SHIFTS if each):
            shifted |= (met[shift].to_numpy() > 0.5) & (median[shift].to_numpy() < own)
        for kept, out in ((own <= limit_mm, close), (~shifted, best)):
            good = np.zeros(len(label), dtype=np.bool_)
            good[given] = kept
            out.append(good)
    return close, best


def _share_met(values: ArrayF) -> float:
    return float(np.mean(np.isfinite(values))) if len(values) else 0.0


def _median(values: ArrayF) -> float:
    met = values[np.isfinite(values)]
    return float(np.median(met)) if len(met) else float("nan")


def _straightest(h: Hypotheses, found: Labels) -> ArrayB:
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
    for shift in _IMAGE_SHIFTS:
        j = [label[at] + shift for at in (left, middle, right)]
        inside = (np.min(j, axis=0) >= 0) & (np.max(j, axis=0) < L)
        depth = [
            h.xyd_mm[at, np.clip(k, 0, L - 1), 2] for at, k in zip((left, middle, right), j, strict=True)
        ]
        bend[shift] = np.where(inside, np.abs(depth[0] - 2 * depth[1] + depth[2]), np.nan)
    groups = bend.groupby("segment")
    median = groups.median()
    others = median[[shift for shift in _IMAGE_SHIFTS if shift]].min(axis=1)
    clear = (others > _BEND_RATIO * median[0]) & (others - median[0] > _LEAST_BEND_MM)
    good = clear & (groups.size() >= max(8, 30 // h.detections.row_step))
    out = np.zeros(h.n_segments, dtype=np.bool_)
    out[good.index[good.to_numpy()].to_numpy(dtype=np.int64)] = True
    return out[h.segment]


def _all_lines_seen(h: Hypotheses, found: Labels) -> ArrayB:
    """Whether all lines have a detection in most rows of a segment, (n,)."""
    rows, at = np.unique(h.detections.row, return_inverse=True)
    count = np.zeros(len(rows))
    np.add.at(count, at, found.label >= 0)
    full = count[at] == h.possible.shape[1]
    size = np.maximum(np.bincount(h.segment, minlength=h.n_segments), 1)
    seen = np.bincount(h.segment, weights=full.astype(np.float64), minlength=h.n_segments)
    return np.asarray((seen / size >= _FULL_SHARE)[h.segment])
