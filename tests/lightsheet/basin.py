"""The recordings of a small basin, and the jobs of the workflow on them, in one process."""

import inspect
import runpy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.calibration import read_camera
from thalweg.core import Camera, LocalFrame
from thalweg.lightsheet.lines import LineSettings
from thalweg.lightsheet.optics import Sensor, read_sensor
from thalweg.settings.sections import LightSheet
from thalweg_lab.settings import TwinConfig
from thalweg_lab.tank import record_camera_field, record_camera_station, record_series

SCRIPTS = Path(__file__).parents[2] / "workflow" / "scripts"
FRAME = LocalFrame(lat_deg=51.028, lon_deg=13.721, h_ell_m=160.0)


def run(name: str, out: Path, **given: Any) -> None:
    """Run the ``main`` of an entry script; files that are not given are results below ``out``."""
    main = runpy.run_path(str(SCRIPTS / f"{name}.py"))["main"]
    wanted = inspect.signature(main).parameters.values()
    rest = {p.name: out / f"{name}.{p.name}" for p in wanted if p.name not in given and p.annotation is Path}
    main(**given, **rest)


@dataclass(frozen=True)
class Basin:
    """Folder of the recordings: sensor.yaml, camera_marks.csv, mark_points.csv, a folder a series, truth."""

    folder: Path

    def images(self, series: str) -> list[Path]:
        return sorted((self.folder / series / "images").iterdir())

    @property
    def truth(self) -> Sensor:
        return read_sensor(self.folder / "truth" / "calibration" / "sensor.yaml")


def recorded(
    folder: Path, seed: int, *, panels: bool = False, changes: dict[str, Any] | None = None
) -> Basin:
    """Record the camera station, the grid, and on request the panels."""
    twin = TwinConfig.of_size("basin_tiny", light_sheet=changes or {})
    record_camera_station(
        twin,
        seed,
        out_sensor=folder / "sensor.yaml",
        out_marks=folder / "camera_marks.csv",
        out_points=folder / "mark_points.csv",
    )
    record_camera_field(
        twin, seed, out_marks=folder / "camera_field_marks.csv", out_field=folder / "camera_field.yaml"
    )
    for series in ("calibration", "panels") if panels else ("calibration",):
        record_series(twin, seed, series, FRAME, folder / series, folder / "truth" / series)
    return Basin(folder)


@dataclass(frozen=True)
class Jobs:
    """The workflow's jobs; each file may be another one than the basin's."""

    out: Path
    settings: LightSheet = field(default_factory=LightSheet)

    def __post_init__(self) -> None:
        self.out.mkdir(parents=True, exist_ok=True)

    def calibrate_camera(self, basin: Basin, **other: Path) -> Camera:
        """Interior orientation from the pictures of the marker field."""
        files = {
            "design": basin.folder / "sensor.yaml",
            "marks": basin.folder / "camera_field_marks.csv",
            "field": basin.folder / "camera_field.yaml",
        }
        run(
            "calibrate_sheet_camera",
            self.out,
            **files | other,
            camera=self.out / "camera_interior.yaml",
            report=self.out / "camera_interior.json",
            run="x",
            frame=FRAME,
            twin=True,
        )
        return read_camera(self.out / "camera_interior.yaml")

    def orient(self, basin: Basin, *, interior: Path | None = None, **other: Path) -> Sensor:
        files = {
            "design": basin.folder / "sensor.yaml",
            "marks": basin.folder / "camera_marks.csv",
            "points": basin.folder / "mark_points.csv",
        }
        run(
            "orient_sheet_camera",
            self.out,
            **files | other,
            interior=interior,
            sensor=self.out / "camera.yaml",
            run="x",
            calibration=self.settings.calibration.model_dump(),
            twin=True,
        )
        return read_sensor(self.out / "camera.yaml")

    def detect(self, basin: Basin, series: str, images: list[Path] | None = None) -> pd.DataFrame:
        """Counts by image."""
        lines = self.settings.lines.model_dump()
        if series == "calibration":
            how = self.settings.calibration
            lines |= {"lines": how.levels, **how.pieces.model_dump()}
        run(
            "detect_sheet_lines",
            self.out,
            images=images or [basin.folder / series / "images"],
            sensor=basin.folder / "sensor.yaml",
            line_points=self.out / f"{series}.parquet",
            counts=self.out / f"{series}.csv",
            lines=LineSettings(**lines),
            threads=1,
        )
        return pd.read_csv(self.out / f"{series}.csv")

    def calibrate(self, basin: Basin, **other: Path) -> Sensor:
        files = {
            "camera": self.out / "camera.yaml",
            "line_points": self.out / "calibration.parquet",
            "grid": basin.folder / "calibration" / "grid_1.yaml",
        }
        run(
            "calibrate_light_sheet",
            self.out,
            **files | other,
            sensor=self.out / "sensor.yaml",
            report=self.out / "calibration.json",
            run="x",
            calibration=self.settings.calibration.model_dump(),
            water=self.settings.water.model_dump(),
            twin=True,
        )
        return read_sensor(self.out / "sensor.yaml")

    def measure(self, basin: Basin, **other: Path) -> pd.DataFrame:
        files = {
            "sensor": self.out / "sensor.yaml",
            "line_points": self.out / "panels.parquet",
            "counts": self.out / "panels.csv",
            "panels": basin.folder / "panels" / "images.csv",
        }
        run("measure_panels", self.out, **files | other, table=self.out / "depths.csv")
        return pd.read_csv(self.out / "depths.csv")
