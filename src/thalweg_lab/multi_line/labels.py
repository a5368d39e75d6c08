"""Which line a detection belongs to: in one image, and along a scan against the growing map.

In a row the labels of the lines grow with the place, at least where nothing thin stands before the surface;
lines may be hidden and detections spurious. A dynamic programme over each row gives for every detection and
label the least cost of the whole row (min-marginals), and segments, which are nearly always of one line,
share these costs among their rows. What remains is a shift: where lines are hidden, all labels of a patch
may move by one with hardly any cost. So a label is given only where it is cheaper than the second best by a
margin, and along a scan the map decides (`SurfaceMap`).

**The map.** Each labelled point says two things. Its place is occupied; and the ways of the light from the
laser to it and from it to the camera are free. A detection is a camera ray with one place on it for each
line; places in free water, or behind a known surface, cannot be right, and places on a surface that another
line has seen in another image are likely.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from thalweg.core import ArrayB, ArrayF, ArrayI, ArrayU8, GeometryError, njit
from thalweg.lightsheet.optics import Sensor, intersect, project, refract_to_water
from thalweg_lab.multi_line.models import Lines

_CAP = 6.0

UNKNOWN: Final = 0
SUPPORTED: Final = 1
CONTRADICTED: Final = 2
IMPOSSIBLE: Final = 3

_SLOTS: Final = 8

DEPTHS_MM: Final = (40.0, 210.0)
"""Working range."""
_LINK_PX: Final = 1.5
"""How far a segment's next place may lie from where its slope leads."""
_GAP_ROWS: Final = 3
"""Steps without a detection that end a segment."""
_SKIP: Final = 2.0
_MISSING: Final = 0.6
"""Costs of a detection without line, and of a line without detection, in a row."""
_SMOOTH_PER_MM: Final = 0.12
_SMOOTH_CAP_MM: Final = 12.0
"""Cost of a change of depth from line to line."""
_ROUNDS: Final = 6
"""Of the exchange between rows and segments."""
_MIN_POINTS: Final = 8
"""Least length of a segment that gets a label of its own."""
_MARGIN: Final = 1.5
"""Least difference of the mean cost of a row to the second best label."""
_SUPPORT: Final = 0.7
"""Least share of a segment's points that lie on the map."""

_MAP_DEPTHS_MM: Final = (30.0, 220.0)
"""Extent of the map in depth; its cells and the voxels of free water have sides of one millimetre."""
_HIDDEN_MM: Final = 2.0
"""How far behind a surface a place must be to be hidden."""
_FREE_END_MM: Final = 1.5
"""Distance from a point at which its rays begin to count as free."""
_FREE_RAYS: Final = 2
"""Rays that must have passed through a voxel."""
_FREE_STEP_MM: Final = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class Detections:
    """Places where lines cross the rows of an image; the lines run along its columns.

    Parameters
    ----------
    row : (n,) rows, ascending.
    x_px : (n,) places in them, ascending within a row, corner origin.
    row_step : distance of the rows that were searched.

    Raises
    ------
    GeometryError : columns of different lengths or out of order, or numbers that are not finite.
    """

    row: ArrayI
    x_px: ArrayF
    row_step: int = 1

    def __post_init__(self) -> None:
        lost = int(np.sum(~np.isfinite(self.x_px)))
        if len(self.row) != len(self.x_px) or lost:
            raise GeometryError(
                f"{len(self.row)} rows, {len(self.x_px)} places, {lost} not finite",
                expected="one finite place for each row",
            )
        later = (np.diff(self.row) > 0) | ((np.diff(self.row) == 0) & (np.diff(self.x_px) >= 0))
        if not later.all():
            raise GeometryError(
                f"{np.sum(~later)} detections out of order",
                expected="detections sorted by row and place",
                where="detections of a multi-line image",
            )

    @property
    def xy_px(self) -> ArrayF:
        """(n, 2) pixels, corner origin."""
        return np.stack([self.x_px, self.row + 0.5], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hypotheses:
    """What each detection would be on each line.

    Parameters
    ----------
    detections : (n,).
    order : +1 if places in a row grow with the number of the line, else -1.
    xyd_mm : (n, L, 3) place and depth in the window's frame, NaN where the line is not met.
    slope : (n, 2) change of x and y of the camera ray for each millimetre of depth.
    laser_slope : (n, L, 2) the same of the sub-beams.
    possible : (n, L) whether the depth lies in the working range and the sub-beam in the fan.
    segment : (n,) number of the segment.
    """

    detections: Detections
    order: int
    xyd_mm: ArrayF
    slope: ArrayF
    laser_slope: ArrayF
    possible: ArrayB
    segment: ArrayI

    @property
    def n_segments(self) -> int:
        """Number of segments."""
        return int(self.segment.max(initial=-1)) + 1


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Pose of the sensor's window frame in the frame of the map: ``x_map = R x + t`` in millimetres."""

    t_mm: ArrayF
    R: ArrayF = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSettings:
    """Size and tolerances of the map.

    Parameters
    ----------
    low_mm, high_mm : (2,) extent in the plane.
    radius_mm : how far in the plane a point supports.
    tolerance_mm, growth : difference of depth that is allowed at no distance, and its growth per millimetre.
    free_length_mm : how far up the rays are followed.
    """

    low_mm: tuple[float, float]
    high_mm: tuple[float, float]
    radius_mm: float = 1.6
    tolerance_mm: float = 0.3
    growth: float = 0.35
    free_length_mm: float = 90.0


class SurfaceMap:
    """Cells with points and voxels of free water."""

    def __init__(self, settings: MapSettings) -> None:
        self.settings = settings
        self.corner = np.array([*settings.low_mm, _MAP_DEPTHS_MM[0]])
        extent = np.array([*settings.high_mm, _MAP_DEPTHS_MM[1]]) - self.corner
        nx, ny, depth = (int(np.ceil(side)) for side in extent)
        self.points = np.zeros((nx, ny, _SLOTS, 3))
        self.who: ArrayI = np.zeros((nx, ny, _SLOTS, 2), dtype=np.int64)
        self.count: ArrayU8 = np.zeros((nx, ny), dtype=np.uint8)
        self.free: ArrayU8 = np.zeros((nx, ny, depth), dtype=np.uint8)

    def add(
        self, xyd_mm: ArrayF, label: ArrayI, frame: int, camera_slope: ArrayF, laser_slope: ArrayF
    ) -> None:
        """Add labelled points (n, 3: x, y, depth) of an image, with the slopes (n, 2) of their rays."""
        add_points(self.points, self.who, self.count, self.corner, xyd_mm, label, frame)
        for slope in (camera_slope, laser_slope):
            carve(self.free, self.corner, xyd_mm, slope, self.settings.free_length_mm)

    def ask(self, xyd_mm: ArrayF, slope: ArrayF, possible: ArrayU8, frame: int) -> tuple[ArrayU8, ArrayF]:
        """State (n, L) of hypotheses (n, L, 3) on camera rays (n, 2), and depth of support minus theirs."""
        s = self.settings
        state = np.zeros(possible.shape, dtype=np.uint8)
        off = np.full(possible.shape, np.nan)
        limits = np.array([s.radius_mm, s.tolerance_mm, s.growth])
        known = (self.points, self.who, self.count, self.corner, self.free)
        look_up(*known, xyd_mm, slope, possible, limits, frame, state, off)
        return state, off


def line_order(sensor: Sensor, lines: Lines) -> int:
    """Whether image places in a row grow (+1) or shrink (-1) with the number of the line.

    Raises
    ------
    GeometryError : the lines do not run side by side along the columns of the image.
    """
    middle = []
    for sheet in lines.sheets():
        water = refract_to_water(sheet.origin_lcs_mm, sheet.beams(0.0), sensor.window)
        middle.append(project(sensor, water.at_depth(0.5 * sum(DEPTHS_MM)))[0, 0])
    steps = np.diff(middle)
    if not ((steps > 0).all() or (steps < 0).all()):
        raise GeometryError(
            f"lines at the places {np.round(middle).tolist()} px",
            expected="lines one beside the other along the columns of the image",
            cure="Turn the image, or check the calibration of the lines",
        )
    return 1 if steps[0] > 0 else -1


def hypotheses(sensor: Sensor, lines: Lines, detections: Detections) -> Hypotheses:
    """Intersect every detection with every line, and link detections to segments."""
    xy = detections.xy_px
    n, L = len(xy), len(lines.labels)
    xyd, laser_slope = np.full((n, L, 3), np.nan), np.full((n, L, 2), np.nan)
    R = sensor.window.R_lcs_window
    for j, sheet in enumerate(lines.sheets()):
        # the ends of a fan are blurred by a few milliradians
        wide = replace(sheet, half_angle_rad=1.003 * sheet.half_angle_rad)
        met = intersect(sensor.with_sheet(wide), xy)
        xyd[:, j, :2] = (met.xyz_lcs_mm @ R)[:, :2]
        xyd[:, j, 2] = met.depth_mm
        laser_slope[:, j] = refract_to_water(
            sheet.origin_lcs_mm, sheet.beams(met.fan_angle_rad), sensor.window
        ).B
    rays = sensor.camera.rays(xy) @ sensor.R_lcs_ccs.T
    slope = refract_to_water(sensor.camera_origin_lcs_mm, rays, sensor.window).B
    with np.errstate(invalid="ignore"):
        possible = (xyd[:, :, 2] > DEPTHS_MM[0]) & (xyd[:, :, 2] < DEPTHS_MM[1])
    return Hypotheses(
        detections=detections,
        order=line_order(sensor, lines),
        xyd_mm=xyd,
        slope=slope,
        laser_slope=laser_slope,
        possible=possible,
        segment=link_rows(detections.row, detections.x_px, detections.row_step, _LINK_PX, _GAP_ROWS),
    )


def label_image(h: Hypotheses, *, evidence: ArrayF | None = None, shape: float = 1.0) -> Labels:
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
    missing = np.full(L, shape * _MISSING)
    segment = h.segment
    size = np.bincount(segment, minlength=h.n_segments)
    shared = np.zeros((h.n_segments, L))
    for turn in range(_ROUNDS):
        weight = min(1.0, (turn + 1) / 3)
        cost = unary + weight * shared[segment]
        m = row_marginals(
            h.detections.row, cost, depth, missing, _SKIP, shape * _SMOOTH_PER_MM, _SMOOTH_CAP_MM
        )
        shared = _segment_costs(m, segment, size)
    best = shared.argmin(axis=1)
    two = np.partition(shared, 1, axis=1)[:, :2]
    margin = np.where(np.isfinite(two[:, 1] - two[:, 0]), two[:, 1] - two[:, 0], 0.0)
    sure = (margin >= _MARGIN) & (size >= _MIN_POINTS)
    best_label = columns[best][segment]
    possible = h.possible[np.arange(n), best_label]
    label = np.where(sure[segment] & possible, best_label, -1)
    label = _in_order(h, label, margin[segment])
    return Labels(label=label, best=np.where(possible, best_label, -1), margin=margin[segment])


def depth_evidence(h: Hypotheses, depth_mm: float, sigma_mm: float) -> ArrayF:
    """Costs (n, L) of labels where the depth of the ground is known, as at the start of a scan."""
    off = (h.xyd_mm[:, :, 2] - depth_mm) / sigma_mm
    return np.where(h.possible, np.minimum(0.5 * np.nan_to_num(off, nan=99.0) ** 2, _CAP), np.inf)


def map_evidence(h: Hypotheses, surface: SurfaceMap, pose: Pose, frame: int) -> tuple[ArrayF, ArrayU8]:
    """Costs (n, L) of labels from the map, and states (n, L) of the hypotheses.

    A point counts as likely as it is for a true and for a wrong label to be supported or contradicted;
    points of a segment count together.
    """
    xyd, slope = in_map(h, pose)
    state, _ = surface.ask(xyd, slope, h.possible.astype(np.uint8), frame)
    size = np.maximum(np.bincount(h.segment, minlength=h.n_segments), 1)[:, None]
    support = np.zeros((h.n_segments, h.possible.shape[1]))
    np.add.at(support, h.segment, (state == SUPPORTED).astype(np.float64))
    # at the rim of what is known a few points lie on the map by chance: they say nothing
    lies_on_map = (support / size >= _SUPPORT)[h.segment]
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
    slopes = _turned(h.slope[i], pose), _turned(h.laser_slope[i, j], pose)
    surface.add(_moved(h.xyd_mm[i, j], pose), j, frame, *slopes)


def in_map(h: Hypotheses, pose: Pose) -> tuple[ArrayF, ArrayF]:
    """Hypotheses (n, L, 3: x, y, depth) and slopes (n, 2) of the camera's rays, in the map's frame."""
    return _moved(h.xyd_mm.reshape(-1, 3), pose).reshape(h.xyd_mm.shape), _turned(h.slope, pose)


def _moved(xyd_mm: ArrayF, pose: Pose) -> ArrayF:
    return np.asarray((xyd_mm * [1.0, 1.0, -1.0] @ pose.R.T + pose.t_mm) * [1.0, 1.0, -1.0])


@njit(cache=True, nogil=True, error_model="numpy")
def link_rows(row: ArrayI, x: ArrayF, row_step: int, tolerance_px: float, gap_rows: int) -> ArrayI:
    """Number of the segment of each detection, linked from row to row.

    Detections (n,) are ordered by row. A segment goes on with the nearest detection to where its slope
    leads, if both are nearest to each other; it ends after ``gap_rows`` steps without one.
    """
    n = len(row)
    segment = np.full(n, -1, dtype=np.int64)
    last_row = np.empty(n, dtype=np.int64)
    last_x, slope = np.empty(n), np.empty(n)
    active = np.empty(n, dtype=np.int64)
    n_active, n_segments, i = 0, 0, 0
    while i < n:
        k = i
        while k < n and row[k] == row[i]:
            k += 1
        kept = 0
        for q in range(n_active):
            if row[i] - last_row[active[q]] <= gap_rows * row_step:
                active[kept] = active[q]
                kept += 1
        n_active = kept
        best_of = np.full(n_active, -1, dtype=np.int64)
        for q in range(n_active):
            s = active[q]
            steps = (row[i] - last_row[s]) / row_step
            limit = tolerance_px * (1.0 + 0.5 * (steps - 1.0))
            place = last_x[s] + slope[s] * (row[i] - last_row[s])
            nearest = limit
            for m in range(i, k):
                if abs(x[m] - place) < nearest:
                    nearest, best_of[q] = abs(x[m] - place), m
        for m in range(i, k):
            chosen, nearest = -1, np.inf
            for q in range(n_active):
                if best_of[q] == m:
                    s = active[q]
                    off = abs(x[m] - last_x[s] - slope[s] * (row[i] - last_row[s]))
                    if off < nearest:
                        nearest, chosen = off, s
            if chosen < 0:
                chosen = n_segments
                n_segments += 1
                slope[chosen] = 0.0
                active[n_active] = chosen
                n_active += 1
                best_of = np.append(best_of, -1)
            else:
                seen = (x[m] - last_x[chosen]) / (row[i] - last_row[chosen])
                slope[chosen] = 0.8 * slope[chosen] + 0.2 * min(max(seen, -1.0), 1.0)
            segment[m], last_row[chosen], last_x[chosen] = chosen, row[i], x[m]
        i = k
    return segment


@njit(cache=True, nogil=True, error_model="numpy")
def row_marginals(
    row: ArrayI, unary: ArrayF, depth: ArrayF, missing: ArrayF, skip: float, smooth: float, step_cap_mm: float
) -> ArrayF:
    """Smallest cost of a whole row if one detection has one label, (n, L); inf where it cannot have it.

    Detections are ordered by row and within a row in the order of the labels. Labels grow strictly along a
    row; a label without detection costs ``missing`` (L,), a detection without label ``skip``, a change of
    depth (n, L) between neighbours ``smooth`` for each millimetre and label, up to a cap.
    """
    n, L = unary.shape
    out = np.full((n, L), np.inf)
    before = np.zeros(L + 1)
    for j in range(L):
        before[j + 1] = before[j] + missing[j]
    i = 0
    while i < n:
        end = i
        while end < n and row[end] == row[i]:
            end += 1
        K = end - i
        F, B = np.full((K, L), np.inf), np.full((K, L), np.inf)
        for k in range(K):
            for j in range(L):
                if not unary[i + k, j] < np.inf:
                    continue
                best = skip * k + before[j]
                for p in range(max(0, k - 4), k):
                    for q in range(j):
                        if F[p, q] < np.inf:
                            change = abs(depth[i + k, j] - depth[i + p, q]) / (j - q)
                            cost = F[p, q] + skip * (k - p - 1) + before[j] - before[q + 1]
                            cost += smooth * min(change, step_cap_mm)
                            best = min(best, cost)
                F[k, j] = best + unary[i + k, j]
        for k in range(K - 1, -1, -1):
            for j in range(L):
                if not unary[i + k, j] < np.inf:
                    continue
                best = skip * (K - 1 - k) + before[L] - before[j + 1]
                for p in range(k + 1, min(K, k + 5)):
                    for q in range(j + 1, L):
                        if B[p, q] < np.inf:
                            change = abs(depth[i + k, j] - depth[i + p, q]) / (q - j)
                            cost = B[p, q] + unary[i + p, q] + skip * (p - k - 1) + before[q] - before[j + 1]
                            cost += smooth * min(change, step_cap_mm)
                            best = min(best, cost)
                B[k, j] = best
                out[i + k, j] = F[k, j] + best
        i = end
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def add_points(
    grid: ArrayF, who: ArrayI, count: ArrayU8, corner: ArrayF, points: ArrayF, label: ArrayI, frame: int
) -> None:
    """Put points (n, 3: x, y, depth) into cells (nx, ny, slots, 3).

    ``who`` (nx, ny, slots, 2) gets the label and the frame. A cell keeps one point of each label and frame,
    and when it is full its first ones: they were there before a mistake could be.
    """
    for i in range(len(points)):
        a = int(np.floor(points[i, 0] - corner[0]))
        b = int(np.floor(points[i, 1] - corner[1]))
        if a < 0 or b < 0 or a >= grid.shape[0] or b >= grid.shape[1]:
            continue
        c = count[a, b]
        known = False
        for k in range(c):
            if who[a, b, k, 0] == label[i] and who[a, b, k, 1] == frame:
                known = True
        if known or c >= grid.shape[2]:
            continue
        for k in range(3):
            grid[a, b, c, k] = points[i, k]
        who[a, b, c, 0], who[a, b, c, 1] = label[i], frame
        count[a, b] = c + 1


@njit(cache=True, nogil=True, error_model="numpy")
def carve(free: ArrayU8, corner: ArrayF, points: ArrayF, slopes: ArrayF, length_mm: float) -> None:
    """Mark voxels along rays above points (n, 3) as free, ``length_mm`` up.

    ``slopes`` (n, 2): change of x and y for each millimetre of depth.
    """
    steps = int(length_mm / _FREE_STEP_MM)
    for i in range(len(points)):
        for s in range(steps):
            up = _FREE_END_MM + s * _FREE_STEP_MM
            a = int(np.floor(points[i, 0] - slopes[i, 0] * up - corner[0]))
            b = int(np.floor(points[i, 1] - slopes[i, 1] * up - corner[1]))
            c = int(np.floor(points[i, 2] - up - corner[2]))
            inside = 0 <= a < free.shape[0] and 0 <= b < free.shape[1] and 0 <= c < free.shape[2]
            if inside and free[a, b, c] < 255:
                free[a, b, c] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def look_up(
    grid: ArrayF,
    who: ArrayI,
    count: ArrayU8,
    corner: ArrayF,
    free: ArrayU8,
    places: ArrayF,
    slope: ArrayF,
    possible: ArrayU8,
    limits: ArrayF,
    frame: int,
    state: ArrayU8,
    off_mm: ArrayF,
) -> None:
    """What the map says of hypotheses (n, L, 3: x, y, depth) on camera rays with slopes (n, 2).

    A point supports a hypothesis only if it comes from another line and another frame: what one line says
    twice would be wrong twice. ``state`` (n, L) becomes 0 unknown, 1 supported, 2 contradicted, 3
    impossible (``possible`` is 0). ``off_mm`` is the difference of depth to the nearest supporting point.
    ``limits``: radius, tolerance, and its growth per millimetre of distance.
    """
    radius, tolerance, growth = limits[0], limits[1], limits[2]
    reach = int(np.ceil(radius))
    n, L = possible.shape
    for i in range(n):
        for j in range(L):
            off_mm[i, j] = np.nan
            if possible[i, j] == 0:
                state[i, j] = 3
                continue
            x, y, d = places[i, j, 0], places[i, j, 1], places[i, j, 2]
            a = int(np.floor(x - corner[0]))
            b = int(np.floor(y - corner[1]))
            state[i, j] = 0
            best = np.inf
            for p in range(max(0, a - reach), min(grid.shape[0], a + reach + 1)):
                for q in range(max(0, b - reach), min(grid.shape[1], b + reach + 1)):
                    for c in range(count[p, q]):
                        if who[p, q, c, 0] == j or who[p, q, c, 1] == frame:
                            continue
                        dx, dy = grid[p, q, c, 0] - x, grid[p, q, c, 1] - y
                        r = np.sqrt(dx * dx + dy * dy)
                        if r > radius:
                            continue
                        dd = grid[p, q, c, 2] - d
                        share = abs(dd) / (tolerance + growth * r)
                        if share < 1.0 and share < best:
                            best = share
                            off_mm[i, j] = dd
                            state[i, j] = 1
            if state[i, j] == 1:
                continue
            u = int(np.floor(x - corner[0]))
            v = int(np.floor(y - corner[1]))
            w = int(np.floor(d - corner[2]))
            inside = 0 <= u < free.shape[0] and 0 <= v < free.shape[1] and 0 <= w < free.shape[2]
            if inside and free[u, v, w] >= _FREE_RAYS:
                state[i, j] = 2
                continue
            # a known surface in front of the hypothesis on the same camera ray hides it
            up = _HIDDEN_MM
            hits = 0
            while up < 60.0 and hits < 2:
                a = int(np.floor(x - slope[i, 0] * up - corner[0]))
                b = int(np.floor(y - slope[i, 1] * up - corner[1]))
                if 0 <= a < grid.shape[0] and 0 <= b < grid.shape[1]:
                    for c in range(count[a, b]):
                        if who[a, b, c, 1] != frame and abs(grid[a, b, c, 2] - (d - up)) < 0.8:
                            hits += 1
                            break
                up += 0.7
            if hits >= 2:
                state[i, j] = 2


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


def _turned(slope: ArrayF, pose: Pose) -> ArrayF:
    ray = np.concatenate([slope, np.full((*slope.shape[:-1], 1), -1.0)], axis=-1) @ pose.R.T
    return np.asarray(-ray[..., :2] / ray[..., 2:])
