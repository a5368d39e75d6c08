"""Light-sheet sensors with one line and with fifteen: labels, depths and distances of planes.

Everything that a user has is simulated: a grating that no calibration model describes is calibrated with the
hierarchical model from three levels, with a camera that is itself calibrated; lines are detected with noise,
drop-outs and spurious places; poses err. The sensor is that of P4, built with the tolerances of its making.
The bundle in air that gives the lens takes a minute, so that its result is drawn here: the true lens with
errors of the published sigmas (P4 6.2), which are its covariance. Glass and water are drawn likewise, and the
laser is known from the drawing. The frame of the calibrated sensor is turned a little about the window's
normal against the true one, because nothing can tell the heading.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from thalweg.calibration.field import read_points
from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8, njit, rotation_z
from thalweg.lightsheet.calibration import orient_camera, read_camera_marks
from thalweg.lightsheet.lines import LinePoints, LineSettings, detect_lines
from thalweg.lightsheet.optics import Sensor, paper_4, read_sensor
from thalweg_lab.multi_line import (
    KINDS,
    Detections,
    Flag,
    Hypotheses,
    Lines,
    MapSettings,
    NominalDiode,
    Pose,
    ScanLabels,
    calibrate_lines,
    compare_models,
    hypotheses,
    label_scan,
    label_single_image,
    line_model,
    line_table,
    nested_tests,
)
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import SheetImage, TwinConfig, TwinLightSheet
from thalweg_lab.studies import Result, Seed, Study, Tables
from thalweg_lab.tank import (
    WINDOW_MARKERS,
    Basin,
    Grating,
    GratingErrors,
    Posed,
    calibration_plan,
    calibration_points,
    line_on,
    lines_of,
    make_grating,
    panel_plan,
    record_camera_station,
    render_sheet_image,
    scan_plan,
    seen_points,
    sized,
    sub_beams,
    wreck,
)

Size = Literal["tiny", "demo", "full"]
_NAMES: Final = ("design.yaml", "marks.csv", "points.csv")

MAP = MapSettings(low_mm=(-130.0, -290.0), high_mm=(130.0, 90.0))
"""Room for the scenes."""
Scene = Literal["wreck", "spars", "steps"]
SCENES: Final[tuple[Scene, ...]] = ("wreck", "spars", "steps")
_X_MM: Final = (-130.0, 130.0)
_Y_MM: Final = (-270.0, 70.0)
"""Extent of the surfaces."""
_CELL_MM: Final = 0.3
_AHEAD_MM: Final = -100.0
"""Where the object lies along the way of the sensor: the sensor passes over it with y from +95 to -75 mm."""


PAIRED: Final = (4, 5, 6, 7, 8, 9)
"""Lines that both levels of the calibration show."""
SHARED: Final = ("regular", "diode", "hierarchical")
"""Models whose lines share parameters: they describe lines that one level alone shows, too."""
LEVELS_MM: Final = (75.0, 140.0)
PLANES_MM: Final = (60.0, 100.0, 120.0)
N_LINES: Final = 15
STEP_DEG: Final = 1.7

OBJECTS: Final = ("calibration", "plane", "wreck")
IMAGE_LEVELS_MM: Final = (60.0, 150.0)
"""Of the grid and of the plate below it."""
PLANE_MM: Final = 120.0
WRECK_MM: Final = 165.0
"""Depth of the ground on which the wreck lies."""
_TOLERANCE_MM: Final = 1.5
"""A label off shifts a depth by 2 mm and more on these levels."""
_NEAR_PX: Final = 3.0
_BEAMS: Final = 6001


_SIGMA_PX: Final = 0.2
_DROPOUT: Final = 0.02
_SPURIOUS: Final = 0.02
_MELT_PX: Final = 4.0
"""How a detector errs: across the line; shares of places that are missed and that are none; lines that are
nearer give one place."""
_ROW_STEP: Final = 4
_SAMPLES: Final = 800
"""Every how manyth row is searched; sub-beams along each line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneDetections:
    """Detections with their truth: ``label`` (n,) is -1 for spurious ones, ``depth_mm`` (n,) then NaN."""

    detections: Detections
    label: ArrayI
    depth_mm: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """Depths (nx, ny) below the window on a grid, bilinear; ``corner_mm`` (2,) is its first node."""

    depth_mm: ArrayF
    corner_mm: ArrayF
    cell_mm: float


def make_scene(kind: Scene, seed: int) -> Field:
    """A surface; another seed gives another object of the same kind."""
    x, y = np.arange(*_X_MM, _CELL_MM), np.arange(*_Y_MM, _CELL_MM)
    depth = _raster(_parameters(kind, seed), x, y)
    return Field(depth_mm=depth, corner_mm=np.array([x[0], y[0]]), cell_mm=_CELL_MM)


def _parameters(kind: Scene, seed: int) -> ArrayF:
    """What makes a surface, (32,)."""
    rng = generator(seed, f"line_label_scene_{kind}")
    s = np.zeros(32)
    s[0] = 1 + SCENES.index(kind)
    s[1] = rng.uniform(140.0, 165.0)
    s[2:5] = rng.uniform(0.0, 2 * np.pi, 3)
    s[5], s[6] = rng.uniform(-25.0, 25.0), rng.uniform(-20.0, 20.0) + _AHEAD_MM
    s[7] = rng.uniform(-0.35, 0.35)
    s[8], s[9], s[10] = rng.uniform(100.0, 135.0), rng.uniform(30.0, 40.0), rng.uniform(30.0, 48.0)
    s[11], s[12], s[13] = rng.uniform(8.0, 22.0), rng.uniform(5.0, 15.0), rng.uniform(5.0, 18.0)
    s[14:17] = rng.uniform(6.0, 14.0, 3)
    s[19], s[20] = 0.15, 1.0
    for i in range(3):
        s[21 + 2 * i] = rng.uniform(-90.0, 90.0)
        s[22 + 2 * i] = s[6] + rng.choice([-1.0, 1.0]) * rng.uniform(42.0, 70.0)
    return s


def observe(sensor: Sensor, grating: Grating, scene: Field, shift_y_mm: float, seed: int) -> SceneDetections:
    """What a detector finds in the image that is taken with the sensor at ``(0, shift_y_mm)``."""
    n = len(grating.cosine_offsets)
    fan = np.linspace(-grating.half_angle_rad, grating.half_angle_rad, _SAMPLES)
    line = np.repeat(np.arange(n), _SAMPLES)
    beams = sub_beams(*grating.beams(line, np.tile(fan, n)), sensor.window)
    ground = (scene.depth_mm, scene.corner_mm, scene.cell_mm, float(scene.depth_mm.min()) - 1.0)
    depth = _first_hit(*ground, beams.start_mm, beams.slope, shift_y_mm)
    image = seen_points(sensor, beams.at_depth(depth, sensor.window))
    xy = image.xy_px
    # the camera's ray through the point, back to the window
    start = beams.start_mm + (beams.slope - image.slope) * depth[:, None]
    seen = _visible(*ground, start, image.slope, depth, shift_y_mm) & image.inside
    xy[~seen] = np.nan
    found = _crossings(xy, depth, line, _ROW_STEP, sensor.camera.size_px[1])
    row, x, label, true_depth = found[:, 0], found[:, 1], found[:, 2], found[:, 3]
    rng = generator(seed, f"line_label_noise_{shift_y_mm:.3f}")
    x = x + _SIGMA_PX * rng.standard_normal(len(x))
    kept = rng.random(len(x)) >= _DROPOUT
    row, x, label, true_depth = row[kept], x[kept], label[kept], true_depth[kept]
    m = int(rng.binomial(len(x), _SPURIOUS)) if len(x) else 0
    beside = rng.integers(0, max(len(x), 1), m)
    row = np.concatenate([row, row[beside]])
    x = np.concatenate([x, x[beside] + rng.uniform(-60.0, 60.0, m)])
    label = np.concatenate([label, np.full(m, -1.0)])
    true_depth = np.concatenate([true_depth, np.full(m, np.nan)])
    order = np.lexsort((x, row))
    row, x, label, true_depth = row[order], x[order], label[order], true_depth[order]
    apart = np.ones(len(x), dtype=np.bool_)
    apart[1:] = (np.diff(row) > 0) | (np.diff(x) >= _MELT_PX)
    return SceneDetections(
        detections=Detections(row=row[apart].astype(np.int64), x_px=x[apart], row_step=_ROW_STEP),
        label=label[apart].astype(np.int64),
        depth_mm=true_depth[apart],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _raster(s: ArrayF, x: ArrayF, y: ArrayF) -> ArrayF:
    out = np.empty((len(x), len(y)))
    for i in range(len(x)):
        for j in range(len(y)):
            out[i, j] = surface_depth(s, x[i], y[j])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _at(grid: ArrayF, corner: ArrayF, cell: float, x: float, y: float) -> float:
    """Depth by bilinear interpolation; outside of the grid that of its edge."""
    u = min(max((x - corner[0]) / cell, 0.0), grid.shape[0] - 1.001)
    v = min(max((y - corner[1]) / cell, 0.0), grid.shape[1] - 1.001)
    i, j = int(u), int(v)
    u, v = u - i, v - j
    low = grid[i, j] * (1 - v) + grid[i, j + 1] * v
    return low * (1 - u) + (grid[i + 1, j] * (1 - v) + grid[i + 1, j + 1] * v) * u


@njit(cache=True, nogil=True, error_model="numpy")
def surface_depth(s: ArrayF, x: float, y: float) -> float:
    """Depth of the surface below the window at a place of the world."""
    ripples = 1.5 * np.sin(x * 0.045 + s[2]) + 1.2 * np.sin(y * 0.06 + s[3])
    depth = s[1] + s[20] * (ripples + 0.5 * np.sin(x * 0.21 + y * 0.17 + s[4]))
    rough = np.sin(x * 1.3 + s[2]) * np.sin(y * 1.7 + s[3])
    rough = s[19] * (rough + 0.6 * np.sin(x * 2.9 + 1.0 + s[4]) * np.sin(y * 2.3))
    c, w = np.cos(s[7]), np.sin(s[7])
    u, v = c * (x - s[5]) + w * (y - s[6]), -w * (x - s[5]) + c * (y - s[6])
    if s[0] < 3:
        along, half = s[8], s[9]
        t = abs(u) / along
        if t < 1:
            width = half * (1 - t**3)
            if abs(v) < width:
                h = s[10] * (0.35 + 0.65 * np.sqrt(max(0.0, 1 - (v / width) ** 2)))
                if abs(u - 0.25 * along) < 0.18 * along and abs(v) < 0.45 * half:
                    h = max(h, s[10] + s[11])
                if abs(u + 0.35 * along) < 0.12 * along and abs(v + 0.1 * half) < 0.4 * half:
                    h = max(h, s[10] + s[12])
                if abs(u + 0.05 * along) < 0.07 * along and abs(v - 0.1 * half) < 0.3 * half:
                    h = 0.3 * s[10]
                if (u - 0.6 * along) ** 2 + (v + 0.2 * half) ** 2 < (0.26 * half) ** 2:
                    h = 0.25 * s[10]
                depth = s[1] - h
        if (u - 0.02 * along) ** 2 + (v + 0.3 * half) ** 2 < 2.5**2:
            depth = min(depth, s[1] - s[10] - s[13])
        if s[0] == 2 and abs(v - 0.15 * half) < 1.5 and abs(u + 0.1 * along) < 0.8 * along:
            depth = min(depth, s[1] - s[10] - 12.0)
    for i in range(3):
        r2 = s[14 + i] ** 2 - (x - s[21 + 2 * i]) ** 2 - (y - s[22 + 2 * i]) ** 2
        if r2 > 0:
            depth = min(depth, s[1] - 0.8 * np.sqrt(r2))
    if s[0] == 3 and abs(y - s[6]) < 32 and abs(x - s[5]) < 150:
        step = 0.0 if x - s[5] < -50 else (20.0 if x - s[5] < 50 else 40.0)
        depth = s[1] - step - 5
    return depth + rough


@njit(cache=True, nogil=True, error_model="numpy")
def _first_hit(
    grid: ArrayF, corner: ArrayF, cell: float, top: float, A: ArrayF, B: ArrayF, shift: float
) -> ArrayF:
    """Depths at which rays ``A + B D`` first meet the surface below ``top``; NaN if they do not."""
    out = np.full(len(A), np.nan)
    for i in range(len(A)):
        if np.isnan(A[i, 0]):
            continue
        d = top
        while d < 260.0:
            e = d + 0.4
            if e >= _at(grid, corner, cell, A[i, 0] + B[i, 0] * e, A[i, 1] + B[i, 1] * e + shift):
                low, high = d, e
                for _ in range(30):
                    m = 0.5 * (low + high)
                    if m >= _at(grid, corner, cell, A[i, 0] + B[i, 0] * m, A[i, 1] + B[i, 1] * m + shift):
                        high = m
                    else:
                        low = m
                out[i] = high
                break
            d = e
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _visible(
    grid: ArrayF, corner: ArrayF, cell: float, top: float, A: ArrayF, B: ArrayF, depth: ArrayF, shift: float
) -> ArrayB:
    """Whether nothing lies between points and the camera."""
    out = np.zeros(len(A), dtype=np.bool_)
    for i in range(len(A)):
        if np.isnan(A[i, 0]) or np.isnan(depth[i]):
            continue
        out[i] = True
        d = depth[i] - 0.05
        while d > top:
            if d - _at(grid, corner, cell, A[i, 0] + B[i, 0] * d, A[i, 1] + B[i, 1] * d + shift) >= 0.02:
                out[i] = False
                break
            d -= 0.4
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _crossings(xy: ArrayF, depth: ArrayF, line: ArrayI, row_step: int, rows: int) -> ArrayF:
    """Where the polygon of each line crosses the middles of rows: row, x, line, depth."""
    out = np.empty((15 * rows, 4))
    n = 0
    for i in range(len(xy) - 1):
        if line[i] != line[i + 1] or not (xy[i, 1] == xy[i, 1] and xy[i + 1, 1] == xy[i + 1, 1]):
            continue
        y0, y1 = xy[i, 1], xy[i + 1, 1]
        # the two ends of a jump are no line
        if (
            abs(y1 - y0) > 8
            or abs(xy[i + 1, 0] - xy[i, 0]) > 6
            or abs(depth[i + 1] - depth[i]) > 2.0
            or y0 == y1
        ):
            continue
        first = int(np.ceil((min(y0, y1) - 0.5) / row_step)) * row_step
        row = first
        while row + 0.5 < max(y0, y1) and row < rows:
            if row >= 0 and n < len(out):
                w = (row + 0.5 - y0) / (y1 - y0)
                out[n, 0], out[n, 1] = row, xy[i, 0] + w * (xy[i + 1, 0] - xy[i, 0])
                out[n, 2], out[n, 3] = line[i], depth[i] + w * (depth[i + 1] - depth[i])
                n += 1
            row += row_step
    return out[:n].copy()


def means(found: pd.DataFrame, by: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    """Means over the seeds of a study.

    Parameters
    ----------
    found : one row a seed and group.
    by : columns that name a group.
    columns : what is averaged, in any unit; NaN does not count.

    Returns
    -------
    One row a group in the order of appearance: ``by``, ``seeds``, and for each column its mean and
    ``std_<column>``, the scatter of a single seed (NaN with one).
    """
    groups = found.groupby(list(by), sort=False)
    table = groups[list(columns)].mean()
    table.insert(0, "seeds", groups.size())
    for column in columns:
        table[f"std_{column}"] = groups[column].std(ddof=1)
    return table.reset_index()


# ---------------------------------------------------------------- a sensor as a calibration left it


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPair:
    """A sensor and what its calibration makes of it.

    Parameters
    ----------
    true : what observations are made with.
    known : what they are processed with: camera, window and water with their covariance.
    R_true_known : (3, 3) from the frame of the sensor as calibrated to the true one, a turn about the normal
        of the window; both have their origin below the camera.
    """

    true: Sensor
    known: Sensor
    R_true_known: ArrayF


def calibrated_sensor(seed: int, *, size: Size = "full") -> SensorPair:
    """A sensor and its calibration.

    Parameters
    ----------
    seed : of its making and of all errors of the calibration, as of a campaign in the basin.
    size : of the images, see `thalweg_lab.tank.forward.SIZES`.
    """
    twin = TwinConfig(light_sheet=TwinLightSheet(size=size))
    with TemporaryDirectory() as folder:
        design, marks, points = (Path(folder) / name for name in _NAMES)
        record_camera_station(twin, seed, out_sensor=design, out_marks=marks, out_points=points)
        nominal = read_sensor(design)
        found = orient_camera(nominal, read_camera_marks(marks), read_points(points), WINDOW_MARKERS)
    true, known = Basin.of(twin, seed).true, found.applied(nominal)
    M = true.R_lcs_ccs @ known.R_lcs_ccs.T
    turn = float(np.arctan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1]))
    return SensorPair(true=true, known=known, R_true_known=rotation_z(turn))


# ---------------------------------------------------------------- which line is which
#
# Everything that a user has is simulated: a grating that no calibration model describes is calibrated with
# the hierarchical model from three levels, with a camera that is itself calibrated; its lines are detected
# with noise, drop-outs and spurious places; poses err; the depth of the ground at the start is known to a
# millimetre or two. `spacing_table` condenses the result to what a buyer asks.


_STEP_MM: Final = 3.0
_SIGMA_POSE_MM: Final = 0.05
"""From image to image, and of its pose in each direction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """A kind of scan.

    Parameters
    ----------
    irregular : designed irregularity of the spacing.
    kind : of scene.
    start_mm, end_mm : way of the sensor.
    sigma_ground_mm : error of the known depth of the ground at the start.
    ground_error_mm : a mistake in it: one label is 5 to 7 mm.
    """

    irregular: float = 0.0
    kind: Scene = "wreck"
    start_mm: float = 95.0
    end_mm: float = -75.0
    sigma_ground_mm: float = 1.0
    ground_error_mm: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """A simulated scan: what was seen, with its truth, and what a user knows."""

    seen: tuple[SceneDetections, ...]
    images: tuple[Hypotheses, ...]
    poses: tuple[Pose, ...]
    ground_depth_mm: float

    @property
    def truth(self) -> ArrayI:
        """(n,) labels of all detections of all images, -1 for spurious ones."""
        return np.concatenate([each.label for each in self.seen])


def calibrated_lines(pair: SensorPair, irregular: float, seed: int) -> tuple[Grating, Lines]:
    """A grating of the true sensor, and its lines as calibrated from three levels with the known one."""
    sensor, grating = pair.known, make_grating(pair.true, seed, errors=GratingErrors(irregular=irregular))
    n = len(grating.cosine_offsets)
    nominal = NominalDiode(
        labels=np.arange(n),
        middle=(n - 1) / 2,
        origin_lcs_mm=sensor.sheet.origin_lcs_mm,
        angles_rad=sensor.sheet.angles_rad,
        step_rad=float(np.deg2rad(1.7)),
        half_angle_rad=grating.half_angle_rad,
    )
    points = calibration_points(pair.true, grating, (60.0, 110.0, 160.0), seed)
    return grating, calibrate_lines(sensor, points, line_model("hierarchical", nominal)).lines


def simulate_scan(pair: SensorPair, grating: Grating, lines: Lines, setting: Setting, seed: int) -> Scan:
    """A scan of one scene."""
    scene: Field = make_scene(setting.kind, seed)
    rng = generator(seed, "line_label_poses")
    seen, images, poses = [], [], []
    for y in np.arange(setting.start_mm, setting.end_mm, -_STEP_MM):
        seen.append(observe(pair.true, grating, scene, float(y), seed))
        images.append(hypotheses(pair.known, lines, seen[-1].detections))
        place = np.array([0.0, y, 0.0]) + _SIGMA_POSE_MM * rng.standard_normal(3)
        poses.append(Pose(t_mm=place, R=pair.R_true_known))
    ground = float(np.nanmedian(seen[0].depth_mm))
    error = setting.ground_error_mm + setting.sigma_ground_mm * float(
        generator(seed, "line_label_ground").standard_normal()
    )
    return Scan(seen=tuple(seen), images=tuple(images), poses=tuple(poses), ground_depth_mm=ground + error)


def label_counts(labels: Iterable[ArrayI], truth: ArrayI) -> dict[str, float]:
    """Precision, share of the true points that are labelled, and share that is shifted by one."""
    given = np.concatenate(list(labels))
    has, real = given >= 0, truth >= 0
    right = has & (given == truth)
    beside = has & real & (np.abs(given - truth) == 1)
    return {
        "precision": float(right.sum() / has.sum()) if has.any() else float("nan"),
        "share": float((has & real).sum() / real.sum()),
        "wrong_by_one": float(beside.sum() / has.sum()) if has.any() else float("nan"),
    }


def study_scene(
    pair: SensorPair, grating: Grating, lines: Lines, setting: Setting, seed: int
) -> dict[str, Any]:
    """One scene: single images, every sixth, and the whole scan."""
    scan = simulate_scan(pair, grating, lines, setting, seed)
    found: ScanLabels = label_scan(
        scan.images, scan.poses, MAP, ground_depth_mm=scan.ground_depth_mm, sigma_ground_mm=2.0
    )
    some = range(0, len(scan.images), 6)
    single = [label_single_image(scan.images[k], lines) for k in some]
    truth = np.concatenate([scan.seen[k].label for k in some])
    counts = found.counts()
    total = sum(counts.values())
    forced = label_counts((each.best for each in found.labels), scan.truth)
    medians = dict(zip(found.shift_test["shift"], found.shift_test["median_mm"], strict=True))
    alone = label_counts((each.label for each in single), truth)
    return (
        {
            "irregular": setting.irregular,
            "kind": setting.kind,
            "step_mm": _STEP_MM,
            "seed": seed,
            "ground_error_mm": setting.ground_error_mm,
            "images": len(scan.images),
            "n": total,
        }
        | label_counts((each.label for each in found.labels), scan.truth)
        | {"forced_precision": forced["precision"], "resolved": found.resolved}
        | {"single_precision": alone["precision"], "single_share": alone["share"]}
        | {"disagreement_mm": medians[0], "disagreement_shifted_mm": min(medians[-1], medians[1])}
        | {f"flag_{flag.name.lower()}": counts[flag.name] / total for flag in Flag}
    )


def study(seed: int, laser_seed: int) -> pd.DataFrame:
    """A row for each of `STUDIED` with the scene of a seed; the sensor has the seed of the laser."""
    pair = calibrated_sensor(laser_seed)
    lasers = {s.irregular: calibrated_lines(pair, s.irregular, laser_seed) for s in STUDIED}
    return pd.DataFrame([study_scene(pair, *lasers[s.irregular], s, seed) for s in STUDIED])


def spacing_table(result: pd.DataFrame) -> pd.DataFrame:
    """For each spacing, kind and step: precision over all points and of the worst scene, and shares.

    Scenes that are flagged as a whole count with no labels.
    """
    keys = ["irregular", "kind", "step_mm", "ground_error_mm"]
    weighed = result.assign(
        right=(result["precision"] * result["flag_given"] * result["n"]).fillna(0.0),
        given=result["flag_given"] * result["n"],
    )
    groups = weighed.groupby(keys)
    table = groups.agg(
        scenes=("seed", "size"),
        resolved=("resolved", "sum"),
        worst_precision=("precision", "min"),
        share=("share", "mean"),
        least_share=("share", "min"),
        forced_precision=("forced_precision", "mean"),
        single_precision=("single_precision", "mean"),
        single_share=("single_share", "mean"),
    )
    table.insert(2, "precision", groups["right"].sum() / groups["given"].sum())
    return table.reset_index()


STUDIED: Final = tuple(
    Setting(irregular=irregular, kind=kind)
    for irregular in (0.0, 0.3)
    for kind in ("wreck", "spars", "steps")
)


def _label_results(tables: Tables, files: Sequence[Path]) -> Mapping[str, Result]:
    number = {(s.irregular, s.kind): k for k, s in enumerate(STUDIED)}
    scenes = tables["scenes"]
    order = [number[key] for key in zip(scenes["irregular"], scenes["kind"], strict=True)]
    scenes = scenes.iloc[np.argsort(order, kind="stable")].reset_index(drop=True)
    return {"scenes": scenes, "spacings": spacing_table(scenes)}


LABEL_STUDY: Final = Study(
    rows=lambda seed: {"scenes": study(seed.number, int(seed.sizes["laser_seed"]))}, results=_label_results
)


# ---------------------------------------------------------------- fifteen lines against one
#
# The laser is a tilted grating with random spacing and origins, which none of the models describes exactly.
# Six lines are seen on both levels of the calibration, all on one; planes on other levels are measured with
# each model. Each laser has a sensor of its own, which the processing knows from its calibration only.


def nominal_diode(sensor: Sensor, labels: Iterable[int] = range(N_LINES)) -> NominalDiode:
    """What the maker states: 15 lines, 1.7 degrees apart, 28.2 degrees wide (T 4.2)."""
    return NominalDiode(
        labels=np.array(list(labels)),
        middle=(N_LINES - 1) / 2,
        origin_lcs_mm=sensor.sheet.origin_lcs_mm,
        angles_rad=sensor.sheet.angles_rad,
        step_rad=float(np.deg2rad(STEP_DEG)),
        half_angle_rad=float(np.deg2rad(14.1)),
    )


def laser_models(seed: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Compare the models on one laser.

    Returns
    -------
    models : a row for each model, see `compare_models`.
    tests : whether there is a joint centre and an equal spacing.
    """
    pair = calibrated_sensor(seed)
    sensor, nominal = pair.known, nominal_diode(pair.known)
    grating = make_grating(pair.true, seed, errors=GratingErrors())
    points = calibration_points(pair.true, grating, LEVELS_MM, seed, paired_lines=PAIRED)
    planes = calibration_points(
        pair.true, grating, PLANES_MM, seed, pairs_per_line=0, sigma_px=0.2, name="plane"
    )
    six = nominal_diode(sensor, PAIRED)
    seen = points.of(np.isin(points.line, PAIRED))
    models = [
        compare_models(sensor, seen, six, KINDS, planes=planes).assign(seed=seed),
        compare_models(sensor, points, nominal, SHARED, planes=planes).assign(seed=seed),
    ]
    return pd.concat(models, ignore_index=True), nested_tests(sensor, points, nominal).assign(seed=seed)


def nominal_lines() -> pd.DataFrame:
    """Where the lines of the nominal laser meet planes, see `line_table` (T Fig. 4.3)."""
    design = paper_4()
    regular = line_model("regular", nominal_diode(design))
    return line_table(design, regular.lines(regular.start), (60.0, 100.0, 160.0))


def _study_rows(seed: Seed) -> Tables:
    models, tests = laser_models(seed.number)
    return {"models": models, "tests": tests}


def _study_results(tables: Tables, files: Sequence[Path]) -> Mapping[str, Result]:
    models = tables["models"]
    columns = ["posterior_sigma_px", "plane_rmse_mm", "plane_bias_mm"]
    return {
        "models": models,
        "summary": means(models, ["model", "n_lines"], columns),
        "tests": tables["tests"],
        "lines": nominal_lines(),
    }


MULTI_LINE_STUDY: Final = Study(rows=_study_rows, results=_study_results)


# ---------------------------------------------------------------- fifteen lines in rendered images
#
# On grid and plane the depths are known, and they tell which line a point belongs to. On an object of free
# form one image alone does not (T 4.2.1): points get the label that `label_single_image` vouches for, and
# ``best_line`` holds its guess for the others.


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiLineImage:
    """An image with what was found in it.

    Parameters
    ----------
    name : one of `OBJECTS`.
    image : (h, w) mosaic.
    points : ``line`` (-1 without label), ``best_line``, ``true_line`` (-1: nothing was there), ``x_px, y_px,
        sigma_px``, and ``x_mm, y_mm, z_mm`` in lcs by the label, NaN without.
    vertices_lcs_mm, faces : (n, 3), (m, 3) of the object under the sensor.
    """

    name: str
    image: ArrayU8
    points: pd.DataFrame
    vertices_lcs_mm: ArrayF
    faces: ArrayI


def multi_line_images(seed: int, *, size: Size = "demo") -> Iterator[MultiLineImage]:
    """Render, measure and label one image of each object, in the order of `OBJECTS`.

    Parameters
    ----------
    seed : of the laser, of the wreck and of all noise.
    size : of the images, see `thalweg_lab.tank.forward.SIZES`.
    """
    pair = calibrated_sensor(seed, size=size)
    sensor, settings = pair.true, sized(paper_4(), SheetImage(), size)[1]
    grating, lines = calibrated_lines(pair, 0.0, seed)
    fans = lines_of(grating)
    plans = (
        calibration_plan(sensor, seed, positions=1, depths_mm=IMAGE_LEVELS_MM, fans=fans),
        panel_plan(sensor, depths_mm=(PLANE_MM,), fans=fans),
        scan_plan(
            sensor, seed, wreck(seed, step_mm=1.2), lines=5, step_mm=10.0, depth_mm=WRECK_MM, fans=fans
        ),
    )
    for name, plan, depths in zip(OBJECTS, plans, (IMAGE_LEVELS_MM, (PLANE_MM,), ()), strict=True):
        scene = plan.scene(len(plan) // 2)
        image = render_sheet_image(
            sensor, scene, settings, generator(seed, f"multi line image {name}"), fans=fans
        )
        found = detect_lines(image, LineSettings(lines=len(fans), across="rows"))
        points = labelled_points(pair.known, lines, found, depths)
        points["true_line"] = true_lines(sensor, scene, grating, points)
        yield MultiLineImage(
            name=name,
            image=image,
            points=points,
            vertices_lcs_mm=scene.to_lcs(scene.surface.vertices_mm),
            faces=scene.surface.faces,
        )


def labelled_points(
    sensor: Sensor, lines: Lines, found: LinePoints, depths_mm: tuple[float, ...]
) -> pd.DataFrame:
    """Measured points with labels: by the known depths, or by the image alone if there are none."""
    order = np.lexsort((found.x_px, found.y_px))
    x, y = found.x_px[order], found.y_px[order]
    h = hypotheses(sensor, lines, Detections(row=np.floor(y).astype(np.int64), x_px=x))
    if depths_mm:
        label = best = by_depth(h, depths_mm)
    else:
        labels = label_single_image(h, lines)
        label, best = labels.label, labels.best
    xyd = np.full((len(x), 3), np.nan)
    has = np.flatnonzero(label >= 0)
    xyd[has] = h.xyd_mm[has, label[has]]
    window = sensor.window
    xyz = xyd * [1.0, 1.0, -1.0] - [0.0, 0.0, window.thickness_mm]
    xyz = xyz @ window.R_lcs_window.T
    return pd.DataFrame(
        {
            "line": label,
            "best_line": best,
            "x_px": x,
            "y_px": y,
            "sigma_px": found.sigma_px[order],
            "x_mm": xyz[:, 0],
            "y_mm": xyz[:, 1],
            "z_mm": xyz[:, 2],
        }
    )


def by_depth(h: Hypotheses, depths_mm: tuple[float, ...]) -> ArrayI:
    """Labels (n,) by which points lie on one of the levels; -1 if none or two do so."""
    off = np.abs(h.xyd_mm[:, :, 2, None] - np.asarray(depths_mm)).min(axis=2)
    off = np.where(np.isfinite(off), off, np.inf)
    ranked = np.sort(off, axis=1)
    sure = (ranked[:, 0] < _TOLERANCE_MM) & (ranked[:, 1] > _TOLERANCE_MM)
    return np.where(sure, np.argmin(off, axis=1), -1)


def true_lines(sensor: Sensor, scene: Posed, grating: Grating, points: pd.DataFrame) -> ArrayI:
    """Numbers (n,) of the lines that are really seen at points, -1 where there is none."""
    xy, number = [], []
    a = np.linspace(-grating.half_angle_rad, grating.half_angle_rad, _BEAMS)
    for fan in lines_of(grating):
        met = line_on(sensor, scene, fan, a)
        xy.append(met.xy_px[met.visible])
        number.append(np.full(int(met.visible.sum()), fan.number))
    away, nearest = cKDTree(np.concatenate(xy)).query(points[["x_px", "y_px"]].to_numpy())
    return np.where(np.asarray(away) < _NEAR_PX, np.concatenate(number)[nearest], -1)


def write_images(images: Sequence[MultiLineImage], npz: Path, table: Path) -> None:
    """Write pictures and meshes as NPZ (``image_<name>``, ``vertices_<name>``, ``faces_<name>``) and all
    points as CSV with the column ``object``.
    """
    arrays: dict[str, AnyArray] = {}
    for one in images:
        arrays[f"image_{one.name}"] = one.image
        # a tenth of a micrometre is enough for a drawing
        arrays[f"vertices_{one.name}"] = one.vertices_lcs_mm.astype(np.float32)
        arrays[f"faces_{one.name}"] = one.faces.astype(np.int32)
    np.savez_compressed(npz, allow_pickle=False, **arrays)
    points = pd.concat([one.points.assign(object=one.name) for one in images], ignore_index=True)
    points.to_csv(table, index=False, float_format="%.6g")
