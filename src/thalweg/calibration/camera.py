"""The boat's camera on the field: interior orientation and poses of all its pictures in one adjustment.

The field's points enter with their joint covariance, so that the poses carry it, too, and share it. Interior
orientation is calibrated from the same pictures, or held at given values and their covariance.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial.transform import Rotation

from thalweg.calibration.camera_files import starting_camera_by
from thalweg.calibration.field import (
    Control,
    FieldNetwork,
    FieldPoints,
    Problem,
    clean,
    network_of,
    pose_from_rays,
    reduced,
    solve,
    start_state,
)
from thalweg.calibration.markers import Block, block_of
from thalweg.core import (
    PARAMETERS,
    ArrayF,
    Camera,
    GeometryError,
    Model,
    Rigid,
    column,
    read_table,
    table_kind,
    write_table,
)

_CAP_RAD: Final = 0.03
"""Directions by a nominal interior orientation."""
_LEAST_MARKS: Final = 6
_LEAST_SHARE: Final = 0.6
_SMALLEST_SIGMA_M: Final = 1e-6
"""Added to each coordinate: a free network has no error along its datum, its covariance is singular."""
_FEW_IMAGES: Final = 3

_UPPER: Final = [(i, j) for i in range(6) for j in range(i, 6)]
COV_COLUMNS: Final = tuple(f"cov_{i}{j}" for i, j in _UPPER)
CAMERA_POSE: Final = table_kind(
    "camera_pose",
    1,
    [
        column("image", "1", "name of the picture's file", pa.string()),
        column("file", "1", "path of the picture from the folder of the recordings", pa.string()),
        column("camera", "1", "name of the camera", pa.string()),
        column("t_device_s", "s", "stamp of the camera's own clock; NaN if not read yet"),
        column("x_m", "m", "projection centre in pcs"),
        column("y_m", "m", "projection centre in pcs"),
        column("z_m", "m", "projection centre in pcs"),
        column("qx", "1", "quaternion of R_pcs_ccs, scalar last"),
        column("qy", "1", "quaternion of R_pcs_ccs"),
        column("qz", "1", "quaternion of R_pcs_ccs"),
        column("qw", "1", "quaternion of R_pcs_ccs, its scalar"),
        *(
            column(name, "m, rad", "covariance of (shift; small rotation vector), both in pcs")
            for name in COV_COLUMNS
        ),
        column("marks", "1", "marks that took part", pa.int64()),
        column("marks_rejected", "1", "known marks that did not fit", pa.int64()),
        column("sigma0", "1", "root of the squared standardised residuals over the redundancy"),
    ],
)


# ---------------------------------------------------------------- adjustment


def start_poses(block: Block, points: FieldPoints) -> tuple[dict[int, Rigid], dict[str, str], float]:
    """Poses of pictures by nominal directions; pictures without one and why; median angle [rad]."""
    index = points.index
    X = np.array([points.points_pcs[index[p]] for p in block.points]).reshape(-1, 3)
    poses: dict[int, Rigid] = {}
    left: dict[str, str] = {}
    angles_of: list[float] = []
    for i, image in enumerate(block.images):
        mine = block.rows(i, np.ones(len(X), np.bool_))
        markers = set(block.marker[mine].tolist())
        if len(mine) < _LEAST_MARKS or len(markers) < 2:
            left[image] = (
                f"{len(mine)} known marks on {len(markers)} markers, at least {_LEAST_MARKS} on 2 are needed"
            )
            continue
        try:
            pose, angles = pose_from_rays(
                X[block.point[mine]], block.rays[mine], block.marker[mine], cap_rad=_CAP_RAD
            )
        except GeometryError as error:
            left[image] = error.found
            continue
        good = angles < _CAP_RAD
        if good.mean() < _LEAST_SHARE:
            left[image] = f"{(~good).sum()} of {len(good)} marks contradict the field"
            continue
        poses[i] = pose
        angles_of += angles[good].tolist()
    return poses, left, float(np.median(angles_of)) if angles_of else float("inf")


def known_marks(marks: pd.DataFrame, points: FieldPoints) -> pd.DataFrame:
    """Marks whose point was measured.

    Raises
    ------
    GeometryError : none was.
    """
    index = points.index
    keys = zip(marks["marker"].astype(int), marks["corner"].astype(int), strict=True)
    known = marks[[key in index for key in keys]]
    if len(known) == 0:
        raise GeometryError(
            f"none of the {marks['marker'].nunique()} markers in the boat's pictures belongs to the field",
            expected="the same field as in the reference pictures",
            cure="Check the dictionary and that field and boat pictures belong together",
        )
    return known


def starting_boat_camera(
    marks: pd.DataFrame,
    points: FieldPoints,
    name: str,
    size_px: tuple[int, int],
    *,
    model: Model = "perspective",
    focal_px: float | None = None,
) -> Camera:
    """Nominal interior orientation of the boat's camera; without a focal length several are tried."""
    known = known_marks(marks, points)

    def misfit(camera: Camera) -> float:
        """How badly the pictures fit the field by this camera, pixels."""
        block = block_of(known, dict.fromkeys(set(known["camera"]), camera))
        poses, left, angle = start_poses(block, points)
        return angle * float(camera.parameters[0]) * (len(left) / max(len(poses), 1) + 1.0) ** 2

    return starting_camera_by(misfit, name, model, size_px, focal_px)


def orient_on_field(
    marks: pd.DataFrame, camera: Camera | Mapping[str, Camera], points: FieldPoints, *, weighted: bool = False
) -> FieldNetwork:
    """Adjust all pictures of the boat's camera, or of several cameras, on the field.

    Parameters
    ----------
    marks : image, camera, marker, corner, x_px, y_px, sigma_px.
    camera : nominal interior orientation, or a known one with covariance; of several cameras by name.
    points : of the field, without the boat's own markers.
    weighted : the camera's covariance is an observation of its parameters: an earlier calibration.

    Raises
    ------
    GeometryError : no picture can be oriented; the pictures do not determine the interior orientation.
    """
    known = dict.fromkeys(set(marks["camera"]), camera) if isinstance(camera, Camera) else dict(camera)
    block = block_of(known_marks(marks, points), known)
    poses, left, _ = start_poses(block, points)
    rejected = [("image", image, reason) for image, reason in left.items()]
    cameras = (camera,) if isinstance(camera, Camera) else tuple(camera.values())
    number = {name: 0 if isinstance(camera, Camera) else k for k, name in enumerate(known)}
    estimated = [PARAMETERS[each.model] for each in cameras]
    if weighted:
        # what is stated without sigma is known and no observation
        for k, each in enumerate(cameras):
            sigma = dict(zip(each.parameter_names, np.diag(each.cov), strict=True))
            estimated[k] = tuple(name for name in estimated[k] if sigma[name] > 0)
        weighted = any(estimated)
    if not poses or (len(poses) < _FEW_IMAGES and any(estimated) and not weighted):
        told = "; ".join(f"{image}: {reason}" for image, reason in list(left.items())[:3])
        raise GeometryError(
            f"{len(poses)} of {len(block.images)} pictures of the boat's camera can be oriented"
            + (f" ({told})" if told else ""),
            expected=f"at least {_FEW_IMAGES} to calibrate the camera, one with a known interior orientation",
            cure="Record the positions again so that the camera sees more markers of the field",
        )
    index = points.index
    at = np.array([index[p] for p in block.points])
    cov = points.cov_of(at) + np.eye(3 * len(at)) * _SMALLEST_SIGMA_M**2
    control = Control(np.arange(len(at)), points.points_pcs[at], cov)
    problem = Problem(
        block,
        np.array([number[name] for name in block.camera_of], np.int64),
        np.ones(len(block.image), bool),
        tuple(estimated),
        control=control,
        weighted=weighted,
    )
    x = start_state(
        block.images,
        cameras,
        {i: poses.get(i, Rigid()) for i in range(len(block.images))},
        points.points_pcs[at],
    )
    oriented = np.array([i in poses for i in range(len(block.images))])
    problem, x = reduced(problem, x, np.ones(len(block.points), bool), oriented)
    problem, adjusted, layout, lost = clean(problem, x)
    adjusted, layout = solve(problem, adjusted.x)
    return network_of(problem, adjusted, layout, rejected + lost, None)


# ---------------------------------------------------------------- poses of all images as one table


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
    network : as `thalweg.calibration.camera.orient_on_field` gives it.
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
