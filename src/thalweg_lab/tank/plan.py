"""What the sensor takes images of: the grid, panels, single profiles, scans, a strip of the river bed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from thalweg.core import ArrayF, rotation_opk
from thalweg.lightsheet.optics import Sensor
from thalweg_lab.random_numbers import generator
from thalweg_lab.tank.glow import Fan, on_sheet
from thalweg_lab.tank.motion import SensorPath, drift, rail
from thalweg_lab.tank.objects import GridPattern, grid_object, panel
from thalweg_lab.tank.surfaces import Pieces, Posed, Surface, Texture, noise_relief, pebble, relief

# ---------------------------------------------------------------- A strip of river bed: sand ripples,
# roughness, stones (millimetres, Z up, 0 at the mean height)


PALETTE: Final = np.array([[0.42, 0.36, 0.28], [0.33, 0.32, 0.30], [0.22, 0.20, 0.18], [0.55, 0.52, 0.47]])
"""Sand, grey, dark and pale stone."""


def ripples(x_mm: ArrayF, y_mm: ArrayF, *, length_mm: float, height_mm: float, phase: float) -> ArrayF:
    """Heights (len(y), len(x)) of ripples whose crests run about along x: flat upstream, steep downstream."""
    X, Y = np.meshgrid(x_mm, y_mm)
    winding = 6.0 * np.sin(X / 55.0 + phase) + 3.0 * np.sin(X / 23.0 + 2.1 * phase)
    angle = 2 * np.pi * (Y + winding) / length_mm
    return np.asarray(0.5 * height_mm * (np.sin(angle) + 0.25 * np.sin(2 * angle)))


def river_bed(seed: int, *, length_mm: float = 600.0, step_mm: float = 1.0, stones: int = 25) -> Surface:
    """A strip along y, from 0 to ``length_mm``, about x = 0.

    Parameters
    ----------
    seed : of the campaign; the streams are ``light sheet river bed ...``, one for each part of the relief.
    length_mm, step_mm : of the grid.
    stones : number of stones, 5 to 30 mm in radius, over ripples of 8 mm and a fine relief of 0.15 mm.
    """
    x = np.arange(-190.0, 190.0 + step_mm / 2, step_mm)
    y = np.arange(0.0, length_mm + step_mm / 2, step_mm)
    shape = generator(seed, "light sheet river bed ripples")
    rough = generator(seed, "light sheet river bed roughness")
    z = ripples(x, y, length_mm=shape.uniform(55, 75), height_mm=8.0, phase=shape.uniform(0, 6.28))
    z = z + noise_relief(x, y, shape, amplitude_mm=0.12 * 8.0, lengths_mm=(60.0, 300.0))
    z += noise_relief(x, y, rough, amplitude_mm=0.15, lengths_mm=(max(2.5, 2.5 * step_mm), 12.0))
    pieces = Pieces()
    pieces.add(relief(x, y, z), 0)
    rng = generator(seed, "light sheet river bed stones")
    for _ in range(stones):
        at = np.array([rng.uniform(x[0], x[-1]), rng.uniform(y[0], y[-1])])
        size = float(np.exp(rng.uniform(np.log(5.0), np.log(30.0))))
        radii = size * np.array([1.0, rng.uniform(0.6, 0.95), rng.uniform(0.4, 0.7)])
        ground = z[int(np.argmin(np.abs(y - at[1]))), int(np.argmin(np.abs(x - at[0])))]
        centre = np.array([*at, ground + radii[2] * rng.uniform(-0.1, 0.5)])
        pieces.add(pebble(centre, radii, rng), int(rng.integers(1, 4)))
    texture = Texture.draw(
        generator(seed, "light sheet river bed texture"), strength=0.25, lengths_mm=(2.0, 40.0)
    )
    return pieces.surface(PALETTE, "river bed", texture=texture)


# ---------------------------------------------------------------- plan


PANEL_DEPTHS_MM: Final = (128.9, 122.7, 83.1, 72.7)
"""Depths of the ground plate and of the panel in P3 3.1.2."""

SHORT_S: Final = 2.0
STRIP_HZ: Final = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A series of images.

    Parameters
    ----------
    name : of the series; its random streams begin with it.
    surfaces : what is seen, by name.
    seen : (n,) name of the surface of each image.
    path : poses of the sensor in the frame of the object, and times of the images.
    fans : lit sheets, empty for that of the sensor.
    facts : what an operator would note, for the files.
    """

    name: str
    surfaces: Mapping[str, Surface]
    seen: tuple[str, ...]
    path: SensorPath
    fans: tuple[Fan, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.seen)

    def scene(self, k: int) -> Posed:
        """What lies under the sensor at image k."""
        return self.path.posed(k, self.surfaces[self.seen[k]])


def describe(plan: Plan, sensor: Sensor) -> dict[str, Any]:
    """What a plan holds, without rendering anything."""
    steps = np.linalg.norm(np.diff(plan.path.shift_obj_mm, axis=0), axis=1)
    return {
        "name": plan.name,
        "images": len(plan),
        "size_px": list(sensor.camera.size_px),
        "sheets": max(len(plan.fans), 1),
        "surfaces": {name: len(surface.faces) for name, surface in plan.surfaces.items()},
        "seconds": float(plan.path.t_s[-1] - plan.path.t_s[0]) if len(plan) else 0.0,
        "median_step_mm": float(np.median(steps)) if len(steps) else 0.0,
        **plan.facts,
    }


def calibration_plan(
    sensor: Sensor,
    seed: int,
    *,
    positions: int = 3,
    depths_mm: Sequence[float] = (60.0, 150.0),
    fans: tuple[Fan, ...] = (),
) -> Plan:
    """The grid under the sensor at several places; the levels are parallel to the window.

    Parameters
    ----------
    sensor : the true one.
    seed : of the campaign; the stream is ``light sheet calibration places``.
    positions : number of images.
    depths_mm : of the levels at the first position, two or three.
    fans : lit sheets, empty for that of the sensor.
    """
    levels = tuple(float(depths_mm[0] - d) for d in depths_mm)
    used = GridPattern.regular(levels_mm=levels)
    rng = generator(seed, "light sheet calibration places")
    moves = rng.standard_normal((positions, 3))
    moves[0] = 0.0
    shift, depth = 6.0, 12.0
    poses = []
    for k in range(positions):
        d = float(depths_mm[0] + np.clip(depth * moves[k, 0], -0.3 * depths_mm[0], 2 * depth))
        at = _on_line(sensor, d)
        R = sensor.window.R_lcs_window @ rotation_opk(0.0, 0.0, _line_angle(sensor) + 0.02 * moves[k, 1])
        poses.append((R, at + R @ np.array([shift * moves[k, 2], 0.0, 0.0]), d))
    path = _path([p[:2] for p in poses])
    tops = [round(p[2], 4) for p in poses]
    facts = {
        "depths_mm": [[round(top - level, 4) for level in used.levels_mm] for top in tops],
        "pattern": used,
    }
    surface = grid_object(used)
    return Plan(
        name="calibration",
        surfaces={surface.name: surface},
        seen=(surface.name,) * positions,
        path=path,
        fans=fans,
        facts=facts,
    )


def panel_plan(
    sensor: Sensor, *, depths_mm: Sequence[float] = PANEL_DEPTHS_MM, fans: tuple[Fan, ...] = ()
) -> Plan:
    """A plane panel at several depths, parallel to the window."""
    R = sensor.window.R_lcs_window @ rotation_opk(0.0, 0.0, 0.0)
    path = _path([(R, _on_line(sensor, d)) for d in depths_mm])
    return Plan(
        name="panels",
        surfaces={"panel": panel()},
        seen=("panel",) * len(depths_mm),
        path=path,
        fans=fans,
        facts={"depths_mm": [float(d) for d in depths_mm]},
    )


def scan_plan(
    sensor: Sensor,
    seed: int,
    surface: Surface,
    *,
    lines: int,
    step_mm: float,
    depth_mm: float = 165.0,
    fans: tuple[Fan, ...] = (),
) -> Plan:
    """A scan on a rail: the line crosses the object from one side to the other.

    Parameters
    ----------
    sensor : the true one.
    seed : of the campaign; the streams begin with ``light sheet scan <surface>``.
    surface : the object; it is scanned about its origin.
    lines, step_mm : 7 to 70 lines, 2 to 5 mm apart (P4 7.3).
    depth_mm : of the object's origin.
    fans : lit sheets, empty for that of the sensor.
    """
    name = f"scan {surface.name}"
    path = rail(
        seed,
        lines=lines,
        step_mm=step_mm,
        middle_lcs_mm=_on_line(sensor, depth_mm - 20.0),
        middle_obj_mm=np.array([0.0, 0.0, 20.0]),
        name=name,
        kappa_rad=_line_angle(sensor),
    )
    surfaces = {surface.name: surface}
    return Plan(name=name, surfaces=surfaces, seen=(surface.name,) * lines, path=path, fans=fans)


def strip_plan(
    sensor: Sensor,
    seed: int,
    *,
    lines: int = 60,
    speed_mmps: float = 60.0,
    path: SensorPath | None = None,
    step_mm: float = 1.0,
) -> Plan:
    """A strip of the river bed under the drifting boat.

    Parameters
    ----------
    sensor : the true one.
    seed : of the campaign.
    lines, speed_mmps : number of images, speed along y, mean depth of the bed below the window.
    path : poses from elsewhere, such as a boat's trajectory in a frame whose origin lies on the bed; None: a
        drift of its own.
    step_mm : width of the mesh.
    """
    if path is None:
        path = drift(
            seed,
            lines=lines,
            rate_hz=STRIP_HZ,
            speed_mmps=speed_mmps,
            middle_lcs_mm=_on_line(sensor, 130.0),
            start_obj_mm=np.array([0.0, 60.0, 0.0]),
            name="strip",
            kappa_rad=_line_angle(sensor),
        )
    way = float(path.shift_obj_mm[-1, 1] - path.shift_obj_mm[0, 1])
    bed = river_bed(seed, length_mm=abs(way) + 200.0, step_mm=step_mm, stones=round(8 + 0.04 * abs(way)))
    return Plan(name="strip", surfaces={bed.name: bed}, seen=(bed.name,) * len(path), path=path)


def boat_path(
    R_wcs_lcs: ArrayF, x_wcs_lcs_m: ArrayF, t_gps_s: ArrayF, origin_wcs_m: ArrayF, kappa_rad: float
) -> SensorPath:
    """Poses of a real or simulated trajectory in the frame of a strip.

    Parameters
    ----------
    R_wcs_lcs, x_wcs_lcs_m : (n, 3, 3), (n, 3) poses of the sensor.
    t_gps_s : (n,) times.
    origin_wcs_m : (3,) origin of the strip on the bed.
    kappa_rad : azimuth of the strip's y axis, counted from north to the west.
    """
    R_obj_wcs = rotation_opk(0.0, 0.0, kappa_rad).T
    return SensorPath(
        R_obj_lcs=R_obj_wcs @ R_wcs_lcs,
        shift_obj_mm=1e3 * (x_wcs_lcs_m - origin_wcs_m) @ R_obj_wcs.T,
        t_s=np.asarray(t_gps_s - t_gps_s[0]),
    )


def _on_line(sensor: Sensor, depth_mm: float) -> ArrayF:
    """Point (3,) of the middle sub-beam at a depth, lcs."""
    return on_sheet(sensor, sensor.sheet, depth_mm)[0]


def _line_angle(sensor: Sensor) -> float:
    """Angle of the line on a level surface about Z, from the x axis."""
    along = sensor.sheet.R_lcs_las[:, 0]
    return float(np.arctan2(along[1], along[0]))


def _path(poses: Sequence[tuple[ArrayF, ArrayF]]) -> SensorPath:
    """Path of a sensor that sees objects at ``x_lcs = R x_obj + shift``."""
    R = np.stack([pose[0].T for pose in poses])
    shift = np.stack([-pose[0].T @ pose[1] for pose in poses])
    return SensorPath(
        R_obj_lcs=R, shift_obj_mm=shift, t_s=np.asarray(SHORT_S * np.arange(len(poses), dtype=np.float64))
    )
