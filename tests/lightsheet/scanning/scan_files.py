"""A simulated scan as the files that the workflow's jobs take, and these jobs in one process."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tests.lightsheet.basin import run
from thalweg.core import Camera, LocalFrame, frame_of, write_table
from thalweg.core.calibration import Source
from thalweg.core.geometry import TriangleMesh, write_mesh
from thalweg.lightsheet.optics import Sensor, write_sensor
from thalweg.lightsheet.poses import SERIES_POINTS, SensorPoses, write_poses
from thalweg_lab.tank import SIGMA_MARK_MM
from thalweg_lab.tank.motion import Panel, SensorPath
from thalweg_lab.tank.series import picked_pairs

FRAME = LocalFrame(lat_deg=51.028, lon_deg=13.721, h_ell_m=160.0)


def pixel_table(pixels: dict[str, np.ndarray], sigma_px: float) -> pd.DataFrame:
    """Line points of images at pixels (n, 2), as a detector gives them."""
    names = np.repeat(list(pixels), [len(xy) for xy in pixels.values()])
    xy = np.concatenate(list(pixels.values()))
    n = len(xy)
    return pd.DataFrame(
        {
            "file": names.astype(object),
            "line": np.zeros(n, np.int32),
            "piece": np.zeros(n, np.int32),
            "x_px": xy[:, 0],
            "y_px": xy[:, 1],
            "sigma_px": sigma_px,
            "angle_rad": 0.0,
            "peak_dn": 120.0,
            "width_px": 5.0,
            "background_dn": 0.0,
            "rows": np.ones(n, np.int32),
            "flags": np.zeros(n, np.uint8),
        }
    )


def true_poses(path: SensorPath, rows: Sequence[int]) -> SensorPoses:
    """Poses of the lines ``i0``, ``i1``... of a path without errors."""
    n = len(rows)
    return SensorPoses(
        images=tuple(f"i{k}" for k in rows),
        R_target_lcs=path.R_obj_lcs[rows],
        shift_m=path.shift_obj_mm[rows] * 1e-3,
        cov=np.zeros((n, 6, 6)),
        shared=np.zeros((n, 6, 0)),
        reasons=("",) * n,
        t_gps_s=path.t_s[rows],
        target="object",
        source="truth",
    )


def write_points(path: Path, table: pd.DataFrame) -> Path:
    write_table(path, frame_of(SERIES_POINTS, {n: table[n] for n in SERIES_POINTS.names}), SERIES_POINTS)
    return path


@dataclass(frozen=True)
class ScanFiles:
    """Folder with sensor.yaml, points.parquet, poses.npz, reference.ply and pairs.csv; jobs write to out."""

    folder: Path

    def change_sensor(self, sensor: Sensor) -> None:
        write_sensor(self.folder / "sensor.yaml", sensor, source=Source(run="t", method="t", twin=True))

    def change_poses(self, poses: SensorPoses) -> None:
        write_poses(self.folder / "poses.npz", poses)

    def change_points(self, table: pd.DataFrame) -> None:
        write_points(self.folder / "points.parquet", table)

    def merge(self, **other: Any) -> dict[str, Any]:
        """Counts of `merge_scan`."""
        f = self.folder
        files = {"sensor": f / "sensor.yaml", "line_points": f / "points.parquet", "poses": f / "poses.npz"}
        run("merge_scan", f, **files | other, points=f / "merged.parquet", counts=f / "merged.json")
        return json.loads((f / "merged.json").read_text())

    def compare(self, levels_mm: list[float] | None = None) -> dict[str, Any]:
        """Facts of `compare_scan`."""
        f = self.folder
        run(
            "compare_scan",
            f,
            sensor=f / "sensor.yaml",
            line_points=f / "points.parquet",
            poses=f / "poses.npz",
            reference=f / "reference.ply",
            pairs=f / "pairs.csv",
            distances=f / "distances.parquet",
            facts=f / "facts.json",
            scanned="other",
            levels_mm=levels_mm,
        )
        return json.loads((f / "facts.json").read_text())


def write_panel_files(folder: Path, panel: Panel, camera: Camera, marks: pd.DataFrame) -> None:
    """What the standing camera's recording consists of: panel.csv, marks.csv and camera.json."""
    places = {f"{a}_mm": panel.measured_lcs_mm[:, i] for i, a in enumerate("xyz")}
    table = pd.DataFrame({"marker": panel.marker, **places, "sigma_mm": SIGMA_MARK_MM})
    table.to_csv(folder / "panel.csv", index=False)
    marks.to_csv(folder / "marks.csv", index=False)
    values = dict(zip(camera.parameter_names, camera.parameters.tolist(), strict=True))
    told = {"model": "perspective", "size_px": list(camera.size_px), "parameters": values}
    (folder / "camera.json").write_text(json.dumps(told))


def scan_files(folder: Path, scan: Any, sensor: Sensor, mesh: TriangleMesh, *, sigma_px: float) -> ScanFiles:
    """Write a scan of the fixture `simulated`."""
    folder.mkdir(parents=True, exist_ok=True)
    found = ScanFiles(folder)
    found.change_sensor(sensor)
    found.change_poses(scan.poses)
    found.change_points(pixel_table({p.image: p.xy_px for p in scan.profiles}, sigma_px))
    write_mesh(folder / "reference.ply", mesh, FRAME, {"object": "test"})
    picked_pairs(mesh, scan.tripod, 4, "test").to_csv(folder / "pairs.csv", index=False)
    return found
