"""Poses of all pictures of a camera as one table, and what could not be oriented and why."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial.transform import Rotation

from thalweg.calibration.field.network import FieldNetwork
from thalweg.core.rigid import Rigid
from thalweg.core.tables import column, read_table, table_kind, write_table
from thalweg.core.types import ArrayF

_UPPER: Final = [(i, j) for i in range(6) for j in range(i, 6)]
COV_COLUMNS: Final = tuple(f"cov_{i}{j}" for i, j in _UPPER)

CAMERA_POSE: Final = table_kind(
    "camera_pose",
    1,
    [
        column("image", pa.string(), "1", "name of the picture's file"),
        column("file", pa.string(), "1", "path of the picture from the folder of the recordings"),
        column("camera", pa.string(), "1", "name of the camera"),
        column("t_device_s", pa.float64(), "s", "stamp of the camera's own clock; NaN if not read yet"),
        column("x_m", pa.float64(), "m", "projection centre in pcs"),
        column("y_m", pa.float64(), "m", "projection centre in pcs"),
        column("z_m", pa.float64(), "m", "projection centre in pcs"),
        column("qx", pa.float64(), "1", "quaternion of R_pcs_ccs, scalar last"),
        column("qy", pa.float64(), "1", "quaternion of R_pcs_ccs"),
        column("qz", pa.float64(), "1", "quaternion of R_pcs_ccs"),
        column("qw", pa.float64(), "1", "quaternion of R_pcs_ccs, its scalar"),
        *(
            column(name, pa.float64(), "m, rad", "covariance of (shift; small rotation vector), both in pcs")
            for name in COV_COLUMNS
        ),
        column("marks", pa.int64(), "1", "marks that took part"),
        column("marks_rejected", pa.int64(), "1", "known marks that did not fit"),
        column("sigma0", pa.float64(), "1", "root of the squared standardised residuals over the redundancy"),
    ],
)


def _pose_columns(T: Rigid) -> dict[str, float]:
    q = Rotation.from_matrix(T.R).as_quat(canonical=True)
    return {
        "t_device_s": np.nan,
        **dict(zip(("x_m", "y_m", "z_m"), T.shift_m.tolist(), strict=True)),
        **dict(zip(("qx", "qy", "qz", "qw"), q.tolist(), strict=True)),
        **dict(zip(COV_COLUMNS, [float(T.cov[i, j]) for i, j in _UPPER], strict=True)),
    }


def network_pose_table(network: FieldNetwork, marks: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Rows of `CAMERA_POSE` of an adjusted bundle, and facts of the whole table.

    Parameters
    ----------
    network : as `thalweg.calibration.camera.boat_camera.orient_on_field` gives it.
    marks : the table of marks that it was adjusted from, for the files.

    Returns
    -------
    The table without stamps, in the order of the pictures' names, and what was rejected.
    """
    first = marks.drop_duplicates("image").set_index("image")
    residuals = network.residuals.assign(squares=np.square(network.residuals["standardised"]))
    rows: list[dict[str, Any]] = []
    for image in sorted(network.poses):
        part = residuals[residuals["image"] == image]
        used = part["used"].to_numpy(np.bool_)
        spare = max(2 * int(used.sum()) - 6, 1)
        rows.append(
            {
                "image": image,
                "file": first.loc[image, "file"],
                "camera": first.loc[image, "camera"],
                **_pose_columns(network.poses[image]),
                "marks": int(used.sum()),
                "marks_rejected": int((~used).sum()),
                "sigma0": float(np.sqrt(part["squares"][used].sum() / spare)),
            }
        )
    return pd.DataFrame(rows, columns=CAMERA_POSE.names), {"rejected": network.rejected.to_dict("records")}


def write_poses(path: Path, table: pd.DataFrame, meta: Mapping[str, Any] | None = None) -> None:
    """Write a table of poses (kind ``camera_pose``)."""
    write_table(path, table, CAMERA_POSE, meta)


def read_poses(path: Path) -> tuple[pd.DataFrame, dict[str, Rigid]]:
    """Read a table of poses, and ``T_pcs_ccs`` with covariance by picture.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    table, _ = read_table(path, CAMERA_POSE)
    R = Rotation.from_quat(table[["qx", "qy", "qz", "qw"]].to_numpy(np.float64).reshape(-1, 4)).as_matrix()
    shift = table[["x_m", "y_m", "z_m"]].to_numpy(np.float64)
    cov = pose_covariances(table)
    poses = {image: Rigid(R=R[i], shift_m=shift[i], cov=cov[i]) for i, image in enumerate(table["image"])}
    return table, poses


def pose_covariances(table: pd.DataFrame) -> ArrayF:
    """(n, 6, 6) covariances of a table of poses."""
    cov = np.zeros((len(table), 6, 6))
    for name, (i, j) in zip(COV_COLUMNS, _UPPER, strict=True):
        cov[:, i, j] = cov[:, j, i] = table[name]
    return cov
