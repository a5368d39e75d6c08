"""Tables that the figures of a calibration are drawn from: their columns, and how they are read.

Coordinates are those of one frame for all tables of a figure: the calibration field (pcs) or the world (wcs).
Tables of the field are in pcs; `placed` brings them into wcs, where x is east, y north and z up.

============ =========================================================================================
field points ``mark`` ("17/0"), ``x_m y_m z_m``, ``sigma_x_m sigma_y_m sigma_z_m``
cones        ``name``, ``apex_x_m apex_y_m apex_z_m``, ``axis_x axis_y axis_z`` (unit vector from the apex
             into the body), ``half_angle_deg``, ``length_m`` (along the axis)
poses        ``position``, ``sensor`` (camera or lidar), ``x_m y_m z_m``, ``qx qy qz qw``: rotation from the
             frame of the sensor, scalar last
cone points  ``cone``, ``position``, ``x_m y_m z_m``, ``residual_m`` (signed distance from the cone, positive
             outside), ``used`` (bool)
image marks  ``x_px y_px`` (from the upper left corner), ``residual_x_px residual_y_px``
             (observed minus computed), ``used`` (bool)
image fixes  ``t_gps_s``, ``east_m north_m up_m`` (antenna from the camera's pose), ``residual_along_m
             residual_across_m residual_up_m`` (track minus image, along the motion and across it to the
             left; NaN where the boat stands or the track has a gap), ``used`` (bool)
track        ``t_gps_s``, ``east_m north_m up_m`` of the antenna as GNSS has it
display      ``read_s`` (what the display shows; NaN if unreadable), ``readable`` (bool)
design study ``cones``, ``positions`` (numbers), ``quantity`` (rotation_x_deg ... z_m), ``unit`` (deg or m),
             ``sigma`` in that unit
lidar frame  ``x_m y_m z_m`` and ``ring`` (0 is the lowest)
============ =========================================================================================
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.calibration.field import read_facts, read_field
from thalweg.core import ArrayF, CoverageError, InputError, Rigid, read_parquet

XYZ: Final = ("x_m", "y_m", "z_m")
_APEX: Final = ("apex_x_m", "apex_y_m", "apex_z_m")
_AXIS: Final = ("axis_x", "axis_y", "axis_z")
_TURN: Final = ("qx", "qy", "qz", "qw")
PICTURES: Final = frozenset((".jpg", ".jpeg", ".png", ".tif", ".tiff"))


def read_figure_table(path: Path) -> pd.DataFrame:
    """A CSV or Parquet table."""
    return read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path)


def read_cones(path: Path, field: Path) -> pd.DataFrame:
    """Cones of a calibration in the columns of this module.

    Parameters
    ----------
    path : table with ``cone``, the apex, ``lambda_deg`` and ``theta_deg``, and ``half_angle_deg``.
    field : description of the field; it has the lengths of the cones.

    Raises
    ------
    InputError : a cone is missing in the field.
    """
    table = pd.read_csv(path).rename(columns={"cone": "name"})
    turn, tilt = np.deg2rad(table["lambda_deg"]), np.deg2rad(table["theta_deg"])
    axis = (np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt))
    lengths = {cone.name: cone.length_m for cone in read_field(field).cones}
    missing = sorted(set(table["name"]) - set(lengths))
    if missing:
        raise InputError(f"no cones {', '.join(missing)}", expected=", ".join(lengths), where=field)
    return table.assign(length_m=table["name"].map(lengths), **dict(zip(_AXIS, axis, strict=True)))


def read_image_marks(residuals: Path, measured: Path) -> pd.DataFrame:
    """Marks of all images in the columns of this module, and ``image``.

    Parameters
    ----------
    residuals : ``image, marker, corner, vx_px, vy_px, used`` of a bundle or a resection, observed minus
        computed.
    measured : where the marks were found: ``image, marker, corner, x_px, y_px``.
    """
    keys = ["image", "marker", "corner"]
    places = read_figure_table(measured)[[*keys, "x_px", "y_px"]]
    table = read_figure_table(residuals).merge(places, on=keys, validate="one_to_one")
    return table.rename(columns={"vx_px": "residual_x_px", "vy_px": "residual_y_px"})


def read_display(path: Path) -> pd.DataFrame:
    """Readings of a display in the columns of this module, and ``file``, ``text``; photos in their order."""
    table = pd.read_csv(path)
    read_s = table["t_display_s"].astype(np.float64)
    return table.assign(read_s=read_s, readable=np.isfinite(read_s))


def read_place(path: Path) -> Rigid | None:
    """``T_wcs_pcs`` of a field; None if it has none for want of targets.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    place = read_facts(path)["T_wcs_pcs"]
    return None if place is None else Rigid.from_matrix(place["matrix"])


def placed(table: pd.DataFrame, T_wcs_pcs: Rigid | None) -> pd.DataFrame:
    """Points, cones or poses in wcs instead of pcs; unchanged without a place of the field."""
    if T_wcs_pcs is None:
        return table
    out = table.copy()
    for columns, shift_m in ((XYZ, T_wcs_pcs.shift_m), (_APEX, T_wcs_pcs.shift_m), (_AXIS, 0.0)):
        if set(columns) <= set(table):
            out[list(columns)] = points_of(table, columns) @ T_wcs_pcs.R.T + shift_m
    if set(_TURN) <= set(table):
        turned = Rotation.from_matrix(T_wcs_pcs.R) * Rotation.from_quat(points_of(table, _TURN))
        out[list(_TURN)] = turned.as_quat()
    return out


def first_picture(paths: Sequence[Path], *, choice: Sequence[str] = ()) -> Path:
    """The first picture, as people count, of files or folders; of ``choice`` (names), if it is given.

    Raises
    ------
    CoverageError : there is none.
    """
    files = {
        file.name: file
        for path in paths
        for file in (sorted(path.iterdir()) if path.is_dir() else [path])
        if file.suffix.lower() in PICTURES and (not choice or file.name in set(choice))
    }
    if not files:
        raise CoverageError(
            f"no picture in {', '.join(str(path) for path in paths) or 'an empty list'}",
            expected=f"one of {', '.join(list(choice)[:3])} ..." if choice else "JPEG or PNG files",
        )
    return files[natural(list(files))[0]]


def points_of(table: pd.DataFrame, columns: Sequence[str] = XYZ) -> ArrayF:
    """(n, 3) coordinates of a table."""
    return table[list(columns)].to_numpy()


def natural(names: Sequence[str]) -> list[str]:
    """Names in the order in which people count: C2 before C10."""

    def key(name: str) -> tuple[str, int, str]:
        """Letters first, then the number that the digits make."""
        digits = "".join(c for c in name if c.isdigit())
        return "".join(c for c in name if not c.isdigit()), int(digits or 0), name

    return sorted({str(name) for name in names}, key=key)
