"""Scans made in memory: exact lines of the twin with noise, marks of a panel, a fine reference."""

from dataclasses import dataclass, replace

import numba as nb
import numpy as np
import pandas as pd
import pytest

from tests.lightsheet.scanning.scan_files import pixel_table
from thalweg.calibration.field import FieldPoints
from thalweg.core import ArrayF, Rigid
from thalweg.lightsheet.lines import LinePoints
from thalweg.lightsheet.optics import Sensor, paper_4
from thalweg.lightsheet.poses import SensorPoses, panel_poses
from thalweg.lightsheet.scanning import ScanCloud, merge, profile
from thalweg.lightsheet.scanning.profile import Profile
from thalweg_lab.random_numbers import generator
from thalweg_lab.tank import (
    SIGMA_MARK_MM,
    SIGMA_PX,
    Plan,
    Posed,
    Surface,
    build_panel,
    line_on,
    observe,
    scan_plan,
    set_up,
)
from thalweg_lab.tank.motion import Panel, Tripod

NOISE_PX = 0.15


@pytest.fixture(autouse=True)
def one_thread():
    """Kernels in one thread: with few points, threads cost more than they gain."""
    before = nb.get_num_threads()
    nb.set_num_threads(1)
    yield
    nb.set_num_threads(before)


@pytest.fixture(scope="session")
def exact():
    """The prototype of P4 without any error of its parameters."""
    return replace(paper_4(), cov=np.zeros((0, 0)))


def line_points(
    xy_px: ArrayF, sigma_px: float = NOISE_PX, *, rows: int = 1, angle_rad: float = 0.0
) -> LinePoints:
    """Line points at pixels (n, 2), as a detector gives them."""
    table = pixel_table({"": xy_px}, sigma_px).assign(rows=rows, angle_rad=angle_rad)
    columns = {name: table[name].to_numpy() for name in table.columns.drop("file")}
    return LinePoints(**columns, counts={"points": len(xy_px)}, facts={})


@dataclass(frozen=True)
class Scan:
    """A simulated scan with its truth."""

    plan: Plan
    panel: Panel
    tripod: Tripod
    marks: pd.DataFrame
    profiles: list[Profile]
    poses: SensorPoses
    cloud: ScanCloud

    @property
    def T_obj_ccs(self) -> Rigid:
        """True motion from the frame of the scan to that of the object."""
        return Rigid(R=self.tripod.R_ccs_obj, shift_m=self.tripod.shift_ccs_mm * 1e-3).inverse()

    @property
    def images(self) -> list[str]:
        return [one.image for one in self.profiles]


def panel_points(panel: Panel) -> FieldPoints:
    """The panel as measured, metres."""
    n = len(panel.marker)
    return FieldPoints(
        points=tuple((int(m), 0) for m in panel.marker),
        points_pcs=panel.measured_lcs_mm * 1e-3,
        cov=np.eye(3 * n) * (SIGMA_MARK_MM * 1e-3) ** 2,
    )


def visible_line(sensor: Sensor, posed: Posed, beams: int) -> tuple[ArrayF, ArrayF]:
    """Pixels (n, 2) and places (n, 3) of sub-beams that the camera sees, without noise."""
    a = sensor.sheet.half_angle_rad * (2.0 * (np.arange(beams) + 0.5) / beams - 1.0)
    found = line_on(sensor, posed, sensor.sheet, a)
    keep = found.visible & np.isfinite(found.xy_px).all(axis=1)
    keep[keep] = sensor.camera.inside(found.xy_px[keep])
    return found.xy_px[keep], found.xyz_lcs_mm[keep]


def simulate(
    sensor: Sensor,
    surface: Surface,
    seed: int,
    *,
    lines: int = 8,
    step_mm: float = 4.0,
    beams: int = 160,
    noise_px: float = NOISE_PX,
    processing: Sensor | None = None,
) -> Scan:
    """A scan without images: places of the visible line with noise along the rows."""
    plan = scan_plan(sensor, seed, surface, lines=lines, step_mm=step_mm)
    rng = generator(seed, "test line noise")
    profiles = []
    for k in range(lines):
        xy, _ = visible_line(sensor, plan.scene(k), beams)
        xy = xy + noise_px * np.column_stack([rng.standard_normal(len(xy)), np.zeros(len(xy))])
        profiles.append(profile(processing or sensor, line_points(xy, noise_px), image=f"sheet_{k:03d}.png"))
    panel = build_panel(seed)
    tripod = set_up(plan.path, panel)
    seen = observe(seed, tripod, panel, plan.path, name=f"test {surface.name}")
    marks = pd.DataFrame(
        {
            "file": [f"sheet_{k:03d}.png" for k in seen.image],
            "marker": seen.marker,
            "corner": 0,
            "x_px": seen.xy_px[:, 0],
            "y_px": seen.xy_px[:, 1],
            "sigma_px": SIGMA_PX,
        }
    )
    poses = panel_poses(tripod.camera, panel_points(panel), marks, [p.image for p in profiles])
    return Scan(plan, panel, tripod, marks, profiles, poses, merge(profiles, poses))


@pytest.fixture(scope="session")
def simulated():
    """Makes scans, see `simulate`."""
    return simulate


@pytest.fixture(scope="session")
def points_at():
    """Makes line points, see `line_points`."""
    return line_points
