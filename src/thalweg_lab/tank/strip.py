"""A strip of the bed under the sailing boat: images with pulses of the receiver, and the truth.

The boat is that of the survey, the sensor that of the basin in which it was calibrated; it sits on the boat
at its true mount. A river is deeper than the sensor sees where the twin's boat sails, so a shallow bed of its
own is laid under a piece of its way, as level as the way is.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core.calibration.model import Source
from thalweg.core.frames import LocalFrame, rotation_opk
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.geometry.mesh_ply import write_mesh
from thalweg.core.types import ArrayF
from thalweg.lidar.mount import Mount
from thalweg.lightsheet.optics.sensor_files import write_sensor
from thalweg.settings.twin.sections import TwinConfig
from thalweg.settings.twin.sheet_strip import TwinSheetStrip
from thalweg_lab.base.random import generator
from thalweg_lab.tank.files import image_name, trigger, write_image, write_pulses
from thalweg_lab.tank.glow import on_sheet
from thalweg_lab.tank.plan import Plan, boat_path, strip_plan
from thalweg_lab.tank.render import Darkroom, render_sheet_image
from thalweg_lab.tank.series import Basin
from thalweg_lab.tank.truth_files import write_poses
from thalweg_lab.voyage.motion import Motion, start_gps_s
from thalweg_lab.voyage.true_mounts import true_mounts
from thalweg_lab.voyage.voyage import Voyage

TURN_RADIUS_M: Final = 0.5
"""A turn of one radian a second counts as much as so many metres a second when a quiet piece is chosen."""

AHEAD_MM: Final = 100.0
"""Of bed before the first line."""


def record_strip(
    twin: TwinConfig,
    settings: TwinSheetStrip,
    seed: int,
    frame: LocalFrame,
    *,
    basin: Basin,
    mount: Mapping[str, Any],
    folder: Path,
    truth: Path,
) -> None:
    """Render and write the strip ::

        <folder>/images/sheet_*.png   images, named by the camera's own clock
        <folder>/trigger_pulses.csv   GPS times of the pulses
        <truth>/                      poses in the frame of the strip, sensor, mount, bed.ply in wcs

    Parameters
    ----------
    twin, settings, seed, frame : of the survey campaign.
    basin : of the campaign that calibrated the sensor.
    mount : section ``light_sheet.mount`` of the survey; the true one is drawn around it.
    folder, truth : of logs and truth.
    """
    true = true_mounts({"light_sheet": mount}, seed, on=twin.effects.mount_errors)["light_sheet"]
    motion, place = Voyage(twin, seed), Mount.from_section(true)
    planned = np.arange(settings.lines) / settings.rate_hz
    begin = quiet_begin_s(motion, twin, float(planned[-1])) if settings.begin_s is None else settings.begin_s
    shots = trigger(
        seed, planned, start_gps_s(twin) + begin, name="strip", rate_hz=settings.rate_hz, jitter_s=0.001
    )
    plan, R_strip, origin = _plan(motion, place, basin, settings, seed, shots.t_gps_s)
    names = [image_name(int(us), "png") for us in shots.stamp_us]
    room = Darkroom.of(basin.true, basin.image, generator(seed, "light sheet strip speckle tile"))
    for k, name in enumerate(names):
        rng = generator(seed, f"light sheet strip image {k}")
        image = render_sheet_image(basin.true, plan.scene(k), basin.image, rng, darkroom=room)
        write_image(folder / "images" / name, image)
    write_pulses(folder / "trigger_pulses.csv", shots.pulse_gps_s)
    truth.mkdir(parents=True, exist_ok=True)
    write_poses(truth / "poses.parquet", names, plan.seen, shots.t_gps_s, plan.path)
    source = Source(run="digital twin", method="truth", twin=True)
    write_sensor(truth / "sensor.yaml", basin.true, source=source)
    bed = next(iter(plan.surfaces.values()))
    vertices = 1e-3 * bed.vertices_mm @ R_strip.T + origin
    mesh = TriangleMesh(vertices_m=vertices, faces=bed.faces, sigma_m=np.zeros(len(vertices)))
    write_mesh(truth / "bed.ply", mesh, frame, {"object": "true bed of the strip", "note": "frame wcs"})
    speed = np.linalg.norm(motion.velocity_wcs_mps(shots.t_gps_s), axis=1)
    facts = {"begin_s": begin, "speed_mps": float(speed.mean()), "mount": true,
             "step_mm": float(1e3 * speed.mean() / settings.rate_hz)}  # fmt: skip
    (truth / "strip.json").write_text(json.dumps(facts, indent=2) + "\n")


def quiet_begin_s(motion: Motion, twin: TwinConfig, length_s: float) -> float:
    """Seconds after the start at which the boat is slowest and turns least for some time."""
    t = np.arange(2.0, max(twin.duration_s - length_s - 3.0, 2.1), 0.1)
    at = start_gps_s(twin) + t + length_s / 2
    speed = np.linalg.norm(motion.velocity_wcs_mps(at), axis=1)
    turn = np.linalg.norm(motion.rates_ics_radps(at), axis=1)
    return float(t[int(np.argmin(speed + TURN_RADIUS_M * turn))])


def _plan(
    motion: Motion, place: Mount, basin: Basin, settings: TwinSheetStrip, seed: int, t_gps_s: ArrayF
) -> tuple[Plan, ArrayF, ArrayF]:
    """The plan, and rotation (3, 3) and origin (3,) of the strip's frame in wcs."""
    R = motion.R_wcs_ics(t_gps_s) @ place.R_ics_sensor
    x = motion.sensor_wcs_m(t_gps_s, place.lever_ics_m)
    line = 1e-3 * on_sheet(basin.true, basin.true.sheet, 1e3 * settings.depth_m)[0]
    first, last = (R[k] @ line + x[k] for k in (0, -1))
    way = last - first
    kappa = float(np.arctan2(-way[0], way[1]))
    R_strip = rotation_opk(0.0, 0.0, kappa)
    origin = (first + last) / 2 - R_strip @ [0.0, float(np.hypot(way[0], way[1])) / 2 + 1e-3 * AHEAD_MM, 0.0]
    path = boat_path(R, x, t_gps_s, origin, kappa)
    return strip_plan(basin.true, seed, path=path, step_mm=settings.step_mm), R_strip, origin
