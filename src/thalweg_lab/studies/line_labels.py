"""How many labels of a multi-line laser are right, and how many are given, on scenes of the wreck kind.

Everything that a user has is simulated: a grating that no calibration model describes is calibrated with
the hierarchical model from three levels, with a camera that is itself calibrated; its lines are detected
with noise, drop-outs and spurious places; poses err; the depth of the ground at the start is known to a
millimetre or two. Long; for 20 scenes of each
kind::

    python -m thalweg_lab.studies.line_labels labels.csv --scenes 20

`spacing_table` condenses the result to what a buyer asks.
"""

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numba as nb
import numpy as np
import pandas as pd

from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.lightsheet.multi_line.adjustment import calibrate_lines
from thalweg.lightsheet.multi_line.detections import (
    Detections,
    Hypotheses,
    LabelSettings,
    hypotheses,
    line_order,
)
from thalweg.lightsheet.multi_line.models import NominalDiode, line_model
from thalweg.lightsheet.multi_line.scan_labels import Flag, ScanLabels, label_scan
from thalweg.lightsheet.multi_line.sheet_curves import Lines
from thalweg.lightsheet.multi_line.single_image import label_single_image
from thalweg.lightsheet.multi_line.surface_map import MapSettings, Pose
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg_lab.base.random import generator
from thalweg_lab.studies.calibrated_sensor import SensorPair, calibrated_sensor
from thalweg_lab.tank.fan_forward import seen_points, sub_beams
from thalweg_lab.tank.grating import Grating, GratingErrors, calibration_points, make_grating

# ---------------------------------------------------------------- scenes and detections for the study of line
# labels: height fields under a multi-line sensor, no images
#
# Detections are made at the level of what a line detector gives: a place in each image row, with noise,
# drop-outs, spurious places, and lines that melt together. Rays are followed through the height field with
# small steps, from the laser and back to the camera, so that both shadows and hidden places occur. The
# surface formulas are those of the feasibility study.


Scene = Literal["flat", "wreck", "spars", "steps"]
SCENES: Final[tuple[Scene, ...]] = ("flat", "wreck", "spars", "steps")

_X_MM: Final = (-130.0, 130.0)
_Y_MM: Final = (-270.0, 70.0)
"""Extent of the surfaces."""
_AHEAD_MM: Final = -100.0
"""Where the object lies along the way of the sensor: the sensor passes over it with y from +95 to -75 mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """How a detector errs.

    ``sigma_px`` across the line; ``dropout`` share of places that are missed; ``spurious`` share of places
    that are none; lines nearer than ``melt_px`` give one place.
    """

    sigma_px: float = 0.2
    dropout: float = 0.02
    spurious: float = 0.02
    melt_px: float = 4.0


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


def make_scene(kind: Scene, seed: int, *, cell_mm: float = 0.3) -> Field:
    """A surface; another seed gives another object of the same kind."""
    x = np.arange(_X_MM[0], _X_MM[1], cell_mm)
    y = np.arange(_Y_MM[0], _Y_MM[1], cell_mm)
    depth = _raster(_parameters(kind, seed), x, y)
    return Field(depth_mm=depth, corner_mm=np.array([x[0], y[0]]), cell_mm=cell_mm)


def _parameters(kind: Scene, seed: int) -> ArrayF:
    """What makes a surface, (32,)."""
    rng = generator(seed, f"line_label_scene_{kind}")
    s = np.zeros(32)
    s[0] = SCENES.index(kind)
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


def observe(
    sensor: Sensor,
    grating: Grating,
    scene: Field,
    shift_y_mm: float,
    seed: int,
    *,
    row_step: int = 4,
    samples: int = 800,
    noise: Noise | None = None,
) -> SceneDetections:
    """What a detector finds in the image that is taken with the sensor at ``(0, shift_y_mm)``.

    Parameters
    ----------
    scene : the surface.
    row_step : every how manyth row.
    samples : sub-beams along each line.
    """
    noise = Noise() if noise is None else noise
    n = len(grating.cosine_offsets)
    fan = np.linspace(-grating.half_angle_rad, grating.half_angle_rad, samples)
    line = np.repeat(np.arange(n), samples)
    beams = sub_beams(*grating.beams(line, np.tile(fan, n)), sensor.window)
    ground = (scene.depth_mm, scene.corner_mm, scene.cell_mm, float(scene.depth_mm.min()) - 1.0)
    depth = _first_hit(*ground, beams.start_mm, beams.slope, shift_y_mm)
    image = seen_points(sensor, beams.at_depth(depth, sensor.window))
    xy = image.xy_px
    # the camera's ray through the point, back to the window
    start = beams.start_mm + (beams.slope - image.slope) * depth[:, None]
    seen = _visible(*ground, start, image.slope, depth, shift_y_mm) & image.inside
    xy[~seen] = np.nan
    found = _crossings(xy, depth, line, row_step, sensor.camera.size_px[1])
    row, x, label, true_depth = found[:, 0], found[:, 1], found[:, 2], found[:, 3]
    rng = generator(seed, f"line_label_noise_{shift_y_mm:.3f}")
    x = x + noise.sigma_px * rng.standard_normal(len(x))
    kept = rng.random(len(x)) >= noise.dropout
    row, x, label, true_depth = row[kept], x[kept], label[kept], true_depth[kept]
    m = int(rng.binomial(len(x), noise.spurious)) if len(x) else 0
    beside = rng.integers(0, max(len(x), 1), m)
    row = np.concatenate([row, row[beside]])
    x = np.concatenate([x, x[beside] + rng.uniform(-60.0, 60.0, m)])
    label = np.concatenate([label, np.full(m, -1.0)])
    true_depth = np.concatenate([true_depth, np.full(m, np.nan)])
    order = np.lexsort((x, row))
    row, x, label, true_depth = row[order], x[order], label[order], true_depth[order]
    apart = np.ones(len(x), dtype=np.bool_)
    apart[1:] = (np.diff(row) > 0) | (np.diff(x) >= noise.melt_px)
    return SceneDetections(
        detections=Detections(row=row[apart].astype(np.int64), x_px=x[apart], row_step=row_step),
        label=label[apart].astype(np.int64),
        depth_mm=true_depth[apart],
    )


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _raster(s: ArrayF, x: ArrayF, y: ArrayF) -> ArrayF:
    out = np.empty((len(x), len(y)))
    for i in range(len(x)):
        for j in range(len(y)):
            out[i, j] = surface_depth(s, x[i], y[j])
    return out


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _at(grid: ArrayF, corner: ArrayF, cell: float, x: float, y: float) -> float:
    """Depth by bilinear interpolation; outside of the grid that of its edge."""
    u = min(max((x - corner[0]) / cell, 0.0), grid.shape[0] - 1.001)
    v = min(max((y - corner[1]) / cell, 0.0), grid.shape[1] - 1.001)
    i, j = int(u), int(v)
    u, v = u - i, v - j
    low = grid[i, j] * (1 - v) + grid[i, j + 1] * v
    return low * (1 - u) + (grid[i + 1, j] * (1 - v) + grid[i + 1, j + 1] * v) * u


@nb.njit(cache=True, nogil=True, error_model="numpy")
def surface_depth(s: ArrayF, x: float, y: float) -> float:
    """Depth of the surface below the window at a place of the world."""
    ripples = 1.5 * np.sin(x * 0.045 + s[2]) + 1.2 * np.sin(y * 0.06 + s[3])
    depth = s[1] + s[20] * (ripples + 0.5 * np.sin(x * 0.21 + y * 0.17 + s[4]))
    rough = np.sin(x * 1.3 + s[2]) * np.sin(y * 1.7 + s[3])
    rough = s[19] * (rough + 0.6 * np.sin(x * 2.9 + 1.0 + s[4]) * np.sin(y * 2.3))
    if s[0] >= 1:
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _visible(
    grid: ArrayF,
    corner: ArrayF,
    cell: float,
    top: float,
    A: ArrayF,
    B: ArrayF,
    depth: ArrayF,
    shift: float,
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
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


# ---------------------------------------------------------------- line labels


MAP = MapSettings(low_mm=(-130.0, -290.0), high_mm=(130.0, 90.0))
"""Room for the scenes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """A kind of scan.

    Parameters
    ----------
    irregular : designed irregularity of the spacing.
    kind : of scene.
    step_mm : from image to image.
    start_mm, end_mm : way of the sensor.
    sigma_pose_mm : in each direction.
    sigma_ground_mm : error of the known depth of the ground at the start.
    ground_error_mm : a mistake in it: one label is 5 to 7 mm.
    """

    irregular: float = 0.0
    kind: Scene = "wreck"
    step_mm: float = 3.0
    start_mm: float = 95.0
    end_mm: float = -75.0
    sigma_pose_mm: float = 0.05
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
    settings = LabelSettings()
    sensor = pair.known
    order = line_order(sensor, lines, 0.5 * (settings.min_depth_mm + settings.max_depth_mm))
    seen, images, poses = [], [], []
    for y in np.arange(setting.start_mm, setting.end_mm, -setting.step_mm):
        seen.append(observe(pair.true, grating, scene, float(y), seed))
        images.append(hypotheses(sensor, lines, seen[-1].detections, settings, order=order))
        place = np.array([0.0, y, 0.0]) + setting.sigma_pose_mm * rng.standard_normal(3)
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
    single = [label_single_image(scan.images[k], lines, LabelSettings()) for k in some]
    truth = np.concatenate([scan.seen[k].label for k in some])
    counts = found.counts()
    total = sum(counts.values())
    forced = label_counts((each.best for each in found.labels), scan.truth)
    medians = dict(zip(found.shift_test["shift"], found.shift_test["median_mm"], strict=True))
    alone = label_counts((each.label for each in single), truth)
    return (
        {
            "irregular": setting.irregular, "kind": setting.kind, "step_mm": setting.step_mm, "seed": seed,
            "ground_error_mm": setting.ground_error_mm, "images": len(scan.images), "n": total,
        }
        | label_counts((each.label for each in found.labels), scan.truth)
        | {"forced_precision": forced["precision"], "resolved": found.resolved}
        | {"single_precision": alone["precision"], "single_share": alone["share"]}
        | {"disagreement_mm": medians[0], "disagreement_shifted_mm": min(medians[-1], medians[1])}
        | {f"flag_{flag.name.lower()}": counts[flag.name] / total for flag in Flag}
    )  # fmt: skip


def study(settings: Sequence[Setting], seeds: Sequence[int], *, laser_seed: int = 1) -> pd.DataFrame:
    """A row for each setting and scene; the sensor has the seed of the laser."""
    pair = calibrated_sensor(laser_seed)
    lasers = {s.irregular: calibrated_lines(pair, s.irregular, laser_seed) for s in settings}
    return pd.DataFrame(
        [study_scene(pair, *lasers[s.irregular], s, seed) for s in settings for seed in seeds]
    )


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


def main() -> None:
    """Run the study from the command line."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("output", type=Path, help="CSV with a row for each scene")
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--step-mm", type=float, default=3.0)
    parser.add_argument("--spacings", nargs="+", type=float, default=[0.0, 0.3], help="irregularity")
    parser.add_argument("--kinds", nargs="+", default=["wreck", "spars", "steps"])
    asked = parser.parse_args()
    settings = [
        Setting(irregular=irregular, kind=kind, step_mm=asked.step_mm)
        for irregular in asked.spacings
        for kind in asked.kinds
    ]
    parts = []
    for setting in settings:
        for seed in range(1, asked.scenes + 1):
            parts.append(study([setting], [seed]))
            pd.concat(parts).to_csv(asked.output, index=False)
    print(spacing_table(pd.concat(parts)).to_string(index=False))


if __name__ == "__main__":
    main()
