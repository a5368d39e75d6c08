"""A series of images with everything beside it: pulses, notes of the operator, observations, the truth apart.

<folder>/images/sheet_*.png       images, named by the camera's own clock
<folder>/trigger_pulses.csv       GPS times of the pulses
<folder>/images.csv               what each image shows, as an operator notes it
<folder>/grid_<k>.yaml            calibration: the object with its measured depths, for the k-th image
<folder>/six_dof/*.csv            scans: marks of the panel in the images of the standing camera
<truth>/                          lines, poses, sensor, meshes
"""

import datetime as dt
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.core import (
    AnyArray,
    ArrayF,
    ArrayI,
    ArrayU8,
    InputError,
    LocalFrame,
    column,
    frame_of,
    optional,
    table_kind,
    unix_from_gps,
    write_table,
)
from thalweg.core.calibration import Source
from thalweg.core.geometry import TriangleMesh, write_mesh
from thalweg.lightsheet.optics import Sensor, write_sensor
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import SheetImage
from thalweg_lab.tank.forward import in_picture
from thalweg_lab.tank.glow import Fan, line_on
from thalweg_lab.tank.motion import SIGMA_MARK_MM, SIGMA_PX, SensorPath, build_panel, observe, set_up
from thalweg_lab.tank.objects import GridPattern
from thalweg_lab.tank.plan import Plan, describe
from thalweg_lab.tank.render import Darkroom, render_sheet_image
from thalweg_lab.tank.surfaces import Posed, Surface

cv2 = optional("cv2")

CALLIPER_MM: Final = 0.05
"""Standard deviation of the depth of a level (P3 3.1.1)."""

PANEL_MM: Final = 0.02
"""The same of the panel (P3 3.1.2: 0.01 to 0.03 mm)."""

PNG_LEVEL: Final = 1
"""Noise does not compress: higher levels cost time only."""


LINE_TRUTH: Final = table_kind(
    "twin_sheet_lines",
    1,
    [
        column("file", "1", "name of the image", pa.string()),
        column("line", "1", "number of the light sheet, from 0", pa.int32()),
        column("fan_angle_rad", "rad", "fan angle of the sub-beam"),
        *(column(f"{a}_mm", "mm", f"{a} of the lit point, lcs") for a in "xyz"),
        column("x_px", "px", "its image, from the upper left corner to the right"),
        column("y_px", "px", "its image, downwards"),
        column("visible", "1", "the camera sees the point, and it lies in the picture", pa.bool_()),
        column("albedo", "1", "albedo in green"),
    ],
)

POSE_TRUTH: Final = table_kind(
    "twin_sheet_poses",
    1,
    [
        column("file", "1", "name of the image", pa.string()),
        column("surface", "1", "what was seen", pa.string()),
        column("t_gps_s", "s", "true middle of the exposure, adjusted standard GPS time"),
        *(column(f"{a}_mm", "mm", f"{a} of the origin of lcs in the frame of the object") for a in "xyz"),
        *(column(f"q_{a}", "1", f"quaternion of R_obj_lcs, {a}, scalar last") for a in "xyzw"),
    ],
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trigger:
    """Images that pulses on whole parts of the GPS second release.

    ``t_gps_s`` (n,) true middle of the exposure; ``pulse_gps_s`` (m,) all recorded pulses; ``stamp_us`` (n,)
    reading of the camera's own clock at each image, microseconds since 1970.
    """

    t_gps_s: ArrayF
    pulse_gps_s: ArrayF
    stamp_us: ArrayI


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
    six_dof: bool = False,
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
    six_dof : with a panel and a standing camera.
    """
    shots = trigger(seed, plan.path.t_s, start_gps_s, name=plan.name)
    names = [image_name(int(us)) for us in shots.stamp_us]
    room = Darkroom.of(sensor, settings, generator(seed, f"light sheet {plan.name} speckle tile"))
    for k in range(len(plan)):
        image = render_sheet_image(
            sensor,
            plan.scene(k),
            settings,
            generator(seed, f"light sheet {plan.name} image {k}"),
            fans=plan.fans or None,
            darkroom=room,
        )
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


def trigger(
    seed: int,
    t_s: ArrayF,
    start_gps_s: float,
    *,
    name: str,
    rate_hz: float = 10.0,
    jitter_s: float = 0.002,
    lost: int = 0,
) -> Trigger:
    """Pulses and stamps of a series.

    The planned times are moved to the grid of a divider of the receiver's PPS. After a third of the images
    the series rests for two and a half intervals: with perfectly regular pulses nothing would tell which
    pulse belongs to which image if one is lost at an end.

    Parameters
    ----------
    seed : of the campaign; the streams are ``light sheet <name> clock`` and ``... lost pulses``.
    t_s : (n,) planned times after the start, growing.
    start_gps_s : adjusted standard GPS time of the start.
    name : of the series.
    rate_hz : of the divider.
    jitter_s : standard deviation of its stamps.
    lost : number of pulses that were not recorded, never at an end.
    """
    n = len(t_s)
    rest = np.ceil(2.5 * np.median(np.diff(t_s)) * rate_hz) / rate_hz if n > 1 else 0.0
    planned = np.asarray(t_s) + np.where(np.arange(n) >= (n + 2) // 3, rest, 0.0)
    at = np.ceil(start_gps_s) + np.rint(planned * rate_hz) / rate_hz
    noise = generator(seed, f"light sheet {name} clock").standard_normal(n)
    shown = unix_from_gps(at) + 3.417 + jitter_s * noise
    kept = np.ones(n, dtype=np.bool_)
    if lost and n > lost + 2:
        rng = generator(seed, f"light sheet {name} lost pulses")
        kept[1 + rng.choice(n - 2, lost, replace=False)] = False
    stamp = np.rint(shown * 1e3).astype(np.int64) * 1000
    return Trigger(t_gps_s=at, pulse_gps_s=at[kept], stamp_us=stamp)


def image_name(stamp_us: int) -> str:
    """Name of an image by the camera's clock.

    Examples
    --------
    >>> image_name(1620808267_042000)
    'sheet_20210512_083107_042.png'
    """
    whole, micros = divmod(stamp_us, 1_000_000)
    moment = dt.datetime.fromtimestamp(whole, dt.UTC)
    return f"sheet_{moment:%Y%m%d_%H%M%S}_{micros // 1000:03d}.png"


def write_image(path: Path, image: ArrayU8) -> None:
    """Write (h, w) raw or grey, or (h, w, 3) red, green, blue, as PNG."""
    ordered = image if image.ndim == 2 else image[:, :, ::-1]
    done, data = cv2.imencode(".png", np.ascontiguousarray(ordered), [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    if not done:
        raise InputError("the image cannot be encoded", where=path, expected="uint8 pixels")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data.tobytes())


def write_pulses(path: Path, pulse_gps_s: ArrayF) -> None:
    """Table of the pulses, CSV with the column ``t_gps_s``, as `thalweg.clocks` reads it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("t_gps_s\n" + "".join(f"{t:.6f}\n" for t in pulse_gps_s))


def true_lines(sensor: Sensor, posed: Posed, fans: tuple[Fan, ...], file: str) -> pd.DataFrame:
    """The exact line of one image, sub-beams that meet the surface only; see `LINE_TRUTH`.

    Parameters
    ----------
    sensor, posed : what the image was rendered from.
    fans : lit sheets, empty for that of the sensor.
    file : name of the image.
    """
    parts = []
    n = max(sensor.camera.size_px)
    for number, fan in enumerate(fans or (sensor.sheet,)):
        a = fan.half_angle_rad * (2.0 * (np.arange(n) + 0.5) / n - 1.0)
        line = line_on(sensor, posed, fan, a)
        lit = line.lit
        xyz, xy = line.xyz_lcs_mm[lit], line.xy_px[lit]
        parts.append(
            frame_of(
                LINE_TRUTH,
                {
                    "file": np.full(int(lit.sum()), file, dtype=object),
                    "line": np.full(int(lit.sum()), number),
                    "fan_angle_rad": a[lit],
                    "x_mm": xyz[:, 0],
                    "y_mm": xyz[:, 1],
                    "z_mm": xyz[:, 2],
                    "x_px": xy[:, 0],
                    "y_px": xy[:, 1],
                    "visible": line.visible[lit] & in_picture(sensor, xy, 0.0),
                    "albedo": line.albedo[lit],
                },
            )
        )
    return pd.concat(parts, ignore_index=True)


def write_lines(path: Path, tables: list[pd.DataFrame]) -> None:
    """Write the true lines of all images of a series."""
    write_table(path, pd.concat(tables, ignore_index=True), LINE_TRUTH, {"source": "digital twin, truth"})


def write_poses(
    path: Path, files: list[str], seen: tuple[str, ...], t_gps_s: ArrayF, poses: SensorPath
) -> None:
    """Write the true poses of the sensor in the frame of the object."""
    q = poses.quaternions()
    table = frame_of(
        POSE_TRUTH,
        {
            "file": files,
            "surface": list(seen),
            "t_gps_s": t_gps_s,
            **{f"{a}_mm": poses.shift_obj_mm[:, i] for i, a in enumerate("xyz")},
            **{f"q_{a}": q[:, i] for i, a in enumerate("xyzw")},
        },
    )
    write_table(path, table, POSE_TRUTH, {"source": "digital twin, truth"})


def write_surface(path: Path, surface: Surface, frame: LocalFrame) -> None:
    """Write the mesh of an object in its own frame, metres, PLY."""
    vertices = surface.vertices_mm * 1e-3
    mesh = TriangleMesh(vertices_m=vertices, faces=surface.faces, sigma_m=np.zeros(len(vertices)))
    write_mesh(path, mesh, frame, {"object": surface.name, "note": "frame of the object; digital twin"})


def _write_grids(plan: Plan, pattern: GridPattern, seed: int, folder: Path) -> None:
    """Descriptions of the calibration object at each position, with depths as a calliper gives them."""
    noise = generator(seed, "light sheet calibration calliper").standard_normal((len(plan), 3))
    for k, depths in enumerate(plan.facts["depths_mm"]):
        measured = [d + CALLIPER_MM * e for d, e in zip(depths, noise[k], strict=False)]
        (folder / f"grid_{k + 1}.yaml").write_text(grid_text(pattern, measured))


def _write_six_dof(plan: Plan, seed: int, names: Sequence[str], folder: Path, truth: Path) -> None:
    """Panel, camera and marks; the truth holds where the standing camera stood."""
    panel = build_panel(seed)
    tripod = set_up(plan.path, panel)
    seen = observe(seed, tripod, panel, plan.path, name=plan.name)
    out = folder / "six_dof"
    out.mkdir(parents=True, exist_ok=True)
    _table(out / "panel.csv", {"marker": panel.marker}, panel.measured_lcs_mm, SIGMA_MARK_MM)
    marks = pd.DataFrame(
        {
            "file": [names[k] for k in seen.image],
            "marker": seen.marker,
            "x_px": seen.xy_px[:, 0].round(4),
            "y_px": seen.xy_px[:, 1].round(4),
            "sigma_px": SIGMA_PX,
        }
    )
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
