"""Truth of a series of light-sheet images: lines, poses, the true sensor, the object's mesh."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.core.frames import LocalFrame
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.geometry.mesh_ply import write_mesh
from thalweg.core.tables import column, frame_of, table_kind, write_table
from thalweg.core.types import ArrayF
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg_lab.tank.fans import Fan
from thalweg_lab.tank.forward import in_picture
from thalweg_lab.tank.line import line_on
from thalweg_lab.tank.motion import SensorPath
from thalweg_lab.tank.surfaces import Posed, Surface

_F = pa.float64()

LINE_TRUTH: Final = table_kind(
    "twin_sheet_lines",
    1,
    [
        column("file", pa.string(), "1", "name of the image"),
        column("line", pa.int32(), "1", "number of the light sheet, from 0"),
        column("fan_angle_rad", _F, "rad", "fan angle of the sub-beam"),
        *(column(f"{a}_mm", _F, "mm", f"{a} of the lit point, lcs") for a in "xyz"),
        column("x_px", _F, "px", "its image, from the upper left corner to the right"),
        column("y_px", _F, "px", "its image, downwards"),
        column("visible", pa.bool_(), "1", "the camera sees the point, and it lies in the picture"),
        column("albedo", _F, "1", "albedo in green"),
    ],
)

POSE_TRUTH: Final = table_kind(
    "twin_sheet_poses",
    1,
    [
        column("file", pa.string(), "1", "name of the image"),
        column("surface", pa.string(), "1", "what was seen"),
        column("t_gps_s", _F, "s", "true middle of the exposure, adjusted standard GPS time"),
        *(column(f"{a}_mm", _F, "mm", f"{a} of the origin of lcs in the frame of the object") for a in "xyz"),
        *(column(f"q_{a}", _F, "1", f"quaternion of R_obj_lcs, {a}, scalar last") for a in "xyzw"),
    ],
)


def true_lines(
    sensor: Sensor, posed: Posed, fans: tuple[Fan, ...], file: str, *, beams: int | None = None
) -> pd.DataFrame:
    """The exact line of one image, sub-beams that meet the surface only; see `LINE_TRUTH`.

    Parameters
    ----------
    sensor, posed : what the image was rendered from.
    fans : lit sheets, empty for that of the sensor.
    file : name of the image.
    beams : sub-beams of each sheet, None: one a pixel of the larger side.
    """
    parts = []
    n = beams or max(sensor.camera.size_px)
    for number, fan in enumerate(fans or (sensor.sheet,)):
        a = fan.half_angle_rad * (2.0 * (np.arange(n) + 0.5) / n - 1.0)
        line = line_on(sensor, posed, fan, a)
        lit = line.lit
        xyz, xy = line.xyz_lcs_mm[lit], line.xy_px[lit]
        parts.append(frame_of(LINE_TRUTH, {
            "file": np.full(int(lit.sum()), file, dtype=object), "line": np.full(int(lit.sum()), number),
            "fan_angle_rad": a[lit], "x_mm": xyz[:, 0], "y_mm": xyz[:, 1], "z_mm": xyz[:, 2],
            "x_px": xy[:, 0], "y_px": xy[:, 1],
            "visible": line.visible[lit] & in_picture(sensor, xy, 0.0), "albedo": line.albedo[lit],
        }))  # fmt: skip
    return pd.concat(parts, ignore_index=True)


def write_lines(path: Path, tables: list[pd.DataFrame]) -> None:
    """Write the true lines of all images of a series."""
    write_table(path, pd.concat(tables, ignore_index=True), LINE_TRUTH, {"source": "digital twin, truth"})


def write_poses(
    path: Path, files: list[str], seen: tuple[str, ...], t_gps_s: ArrayF, poses: SensorPath
) -> None:
    """Write the true poses of the sensor in the frame of the object."""
    q = poses.quaternions()
    table = frame_of(POSE_TRUTH, {
        "file": files, "surface": list(seen), "t_gps_s": t_gps_s,
        **{f"{a}_mm": poses.shift_obj_mm[:, i] for i, a in enumerate("xyz")},
        **{f"q_{a}": q[:, i] for i, a in enumerate("xyzw")},
    })  # fmt: skip
    write_table(path, table, POSE_TRUTH, {"source": "digital twin, truth"})


def write_surface(path: Path, surface: Surface, frame: LocalFrame, *, sigma_mm: float = 0.0) -> None:
    """Write the mesh of an object in its own frame, metres, PLY."""
    vertices = surface.vertices_mm * 1e-3
    mesh = TriangleMesh(
        vertices_m=vertices, faces=surface.faces, sigma_m=np.full(len(vertices), sigma_mm * 1e-3)
    )
    write_mesh(path, mesh, frame, {"object": surface.name, "note": "frame of the object; digital twin"})
