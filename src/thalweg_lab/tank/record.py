"""A series of images with everything beside it: pulses, notes of the operator, observations, the truth apart.

<folder>/images/sheet_*.png       images, named by the camera's own clock
<folder>/trigger_pulses.csv       GPS times of the pulses
<folder>/images.csv               what each image shows, as an operator notes it
<folder>/grid_<k>.yaml            calibration: the object with its measured depths, for the k-th image
<folder>/six_dof/*.csv            scans: marks of the panel in the images of the standing camera
<truth>/                          lines, poses, sensor, meshes
"""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.calibration.model import Source
from thalweg.core.frames import LocalFrame
from thalweg.core.types import AnyArray, ArrayF
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.lightsheet.optics.sensor_files import write_sensor
from thalweg.settings.twin.light_sheet import SheetImage
from thalweg_lab.base.random import generator
from thalweg_lab.tank.files import ImageFormat, image_name, trigger, write_image, write_pulses
from thalweg_lab.tank.objects import GridPattern
from thalweg_lab.tank.plan import Plan, describe
from thalweg_lab.tank.render import Darkroom, render_sheet_image
from thalweg_lab.tank.six_dof import SIGMA_MARK_MM, SIGMA_PX, build_panel, observe, set_up
from thalweg_lab.tank.truth_files import true_lines, write_lines, write_poses, write_surface

CALLIPER_MM: Final = 0.05
"""Standard deviation of the depth of a level (P3 3.1.1)."""

PANEL_MM: Final = 0.02
"""The same of the panel (P3 3.1.2: 0.01 to 0.03 mm)."""


def record(
    plan: Plan,
    sensor: Sensor,
    settings: SheetImage,
    seed: int,
    folder: Path,
    truth: Path,
    frame: LocalFrame,
    *,
    start_gps_s: float,
    ending: ImageFormat = "png",
    six_dof: bool = False,
    lost_pulses: int = 0,
    only: Sequence[int] | None = None,
) -> list[str]:
    """Render and write a series; gives the names of its images in order.

    Parameters
    ----------
    plan : what is seen from where.
    sensor, settings : the true sensor in its true water, and light and lens.
    seed : of the campaign. Image k has the stream ``light sheet <plan> image <k>``, so it depends on no
        other.
    folder, truth : see the module.
    frame : local frame for the meshes' files; the meshes are in the frame of their object.
    start_gps_s : adjusted standard GPS time of the first image, about.
    ending : format of the images.
    six_dof : with a panel and a standing camera.
    lost_pulses : pulses that were not recorded.
    only : numbers of the images to render, for jobs that share the work; None: all.
    """
    shots = trigger(seed, plan.path.t_s, start_gps_s, name=plan.name, lost=lost_pulses)
    names = [image_name(int(us), ending) for us in shots.stamp_us]
    room = Darkroom.of(sensor, settings, generator(seed, f"light sheet {plan.name} speckle tile"))
    wanted = range(len(plan)) if only is None else only
    for k in wanted:
        image = render_sheet_image(
            sensor, plan.scene(k), settings, generator(seed, f"light sheet {plan.name} image {k}"),
            fans=plan.fans or None, darkroom=room,
        )  # fmt: skip
        write_image(folder / "images" / names[k], image)
    write_pulses(folder / "trigger_pulses.csv", shots.pulse_gps_s)
    notes = pd.DataFrame({"file": names, "object": plan.seen})
    pattern = plan.facts.get("pattern")
    depths = plan.facts.get("depths_mm")
    if depths and pattern is None:
        errors = generator(seed, f"light sheet {plan.name} calliper").standard_normal(len(plan))
        notes["depth_mm"] = np.round(depths + PANEL_MM * errors, 3)
        notes["sigma_mm"] = PANEL_MM
    notes.to_csv(folder / "images.csv", index=False)
    if isinstance(pattern, GridPattern):
        _write_grids(plan, pattern, seed, folder)
    if six_dof:
        _write_six_dof(plan, seed, names, folder, truth)
    _write_truth(plan, sensor, settings, names, shots.t_gps_s, truth, frame)
    return names


def _write_grids(plan: Plan, pattern: GridPattern, seed: int, folder: Path) -> None:
    """Descriptions of the calibration object at each position, with depths as a calliper gives them."""
    noise = generator(seed, "light sheet calibration calliper").standard_normal((len(plan), 3))
    for k, depths in enumerate(plan.facts["depths_mm"]):
        measured = [d + CALLIPER_MM * e for d, e in zip(depths, noise[k], strict=False)]
        (folder / f"grid_{k + 1}.yaml").write_text(grid_text(pattern, measured))


def grid_text(pattern: GridPattern, depths_mm: Sequence[float]) -> str:
    """The calibration object as its YAML file: see `thalweg.lightsheet.calibration.grid`."""
    last = len(depths_mm) - 1
    levels = "".join(
        f"  - {{name: {'plate' if i == last else f'grid {i + 1}'}, "
        f"pattern: {'plate' if i == last else 'grid'}, depth_mm: {d:.3f}, sigma_mm: {CALLIPER_MM}}}\n"
        for i, d in enumerate(depths_mm)
    )
    along_x = (pattern.gaps_mm + pattern.half_size_mm[0]).round(4).tolist()
    middle = pattern.half_size_mm[1]
    along_y = [[middle - pattern.slot_half_mm, middle + pattern.slot_half_mm]]
    return (
        f"thalweg_grid: 1\nname: grid over a plate\nlevels:\n{levels}"
        f"grid:\n  thickness_mm: {pattern.thickness_mm}\n"
        f"  along_x: {{gaps_mm: {along_x}}}\n  along_y: {{gaps_mm: {along_y}}}\n"
    )


def _write_six_dof(plan: Plan, seed: int, names: Sequence[str], folder: Path, truth: Path) -> None:
    """Panel, camera and marks; the truth holds where the standing camera stood."""
    panel = build_panel(seed)
    tripod = set_up(plan.path, panel)
    seen = observe(seed, tripod, panel, plan.path, name=plan.name)
    out = folder / "six_dof"
    out.mkdir(parents=True, exist_ok=True)
    _table(out / "panel.csv", {"marker": panel.marker}, panel.measured_lcs_mm, SIGMA_MARK_MM)
    marks = pd.DataFrame({
        "file": [names[k] for k in seen.image], "marker": seen.marker,
        "x_px": seen.xy_px[:, 0].round(4), "y_px": seen.xy_px[:, 1].round(4), "sigma_px": SIGMA_PX,
    })  # fmt: skip
    marks.to_csv(out / "marks.csv", index=False)
    camera = tripod.camera
    values = dict(zip(camera.parameter_names, camera.parameters.tolist(), strict=True))
    (out / "camera.json").write_text(
        json.dumps({"model": camera.model, "size_px": list(camera.size_px), "parameters": values}, indent=2)
        + "\n"
    )
    place = {"R_ccs_obj": tripod.R_ccs_obj.tolist(), "shift_ccs_mm": tripod.shift_ccs_mm.tolist()}
    truth.mkdir(parents=True, exist_ok=True)
    (truth / "tripod.json").write_text(json.dumps(place, indent=2) + "\n")


def _table(path: Path, first: dict[str, AnyArray], xyz_mm: ArrayF, sigma_mm: float) -> None:
    places = {f"{a}_mm": xyz_mm[:, i].round(4) for i, a in enumerate("xyz")}
    pd.DataFrame({**first, **places, "sigma_mm": sigma_mm}).to_csv(path, index=False)


def _write_truth(
    plan: Plan,
    sensor: Sensor,
    settings: SheetImage,
    names: list[str],
    t_gps_s: ArrayF,
    folder: Path,
    frame: LocalFrame,
) -> None:
    tables = [true_lines(sensor, plan.scene(k), plan.fans, names[k]) for k in range(len(plan))]
    write_lines(folder / "lines.parquet", tables)
    write_poses(folder / "poses.parquet", names, plan.seen, t_gps_s, plan.path)
    write_sensor(folder / "sensor.yaml", sensor, source=Source(run="digital twin", method="truth", twin=True))
    for name, surface in plan.surfaces.items():
        write_surface(folder / f"{name.replace(' ', '_')}.ply", surface, frame)
    facts = describe(plan, sensor)
    if isinstance(facts.get("pattern"), GridPattern):
        facts["pattern"] = {
            key: value.tolist() if isinstance(value, np.ndarray) else value
            for key, value in asdict(facts["pattern"]).items()
        }
    facts["settings"] = settings.model_dump()
    (folder / "plan.json").write_text(json.dumps(facts, indent=2) + "\n")
