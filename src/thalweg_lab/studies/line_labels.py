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
from typing import Any

import numpy as np
import pandas as pd

from thalweg.core.types import ArrayI
from thalweg.lightsheet.multi_line.adjustment import calibrate_lines
from thalweg.lightsheet.multi_line.detections import Hypotheses, LabelSettings, hypotheses, line_order
from thalweg.lightsheet.multi_line.models import NominalDiode, line_model
from thalweg.lightsheet.multi_line.scan_labels import Flag, ScanLabels, label_scan
from thalweg.lightsheet.multi_line.sheet_curves import Lines
from thalweg.lightsheet.multi_line.single_image import label_single_image
from thalweg.lightsheet.multi_line.surface_map import MapSettings, Pose
from thalweg_lab.base.random import generator
from thalweg_lab.studies.calibrated_sensor import SensorPair, calibrated_sensor
from thalweg_lab.studies.line_label_scenes import Field, Scene, SceneDetections, make_scene, observe
from thalweg_lab.tank.grating import Grating, GratingErrors, calibration_points, make_grating

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
