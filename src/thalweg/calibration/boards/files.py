"""Board calibrations from files: pictures with scans, or boards that another program has measured."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.boards.images import Checkerboard, board_view, find_corners, read_grey
from thalweg.calibration.boards.model import BoardCalibration, BoardPose
from thalweg.calibration.boards.poses import BoardPoses
from thalweg.calibration.camera_lidar.input import CAPTURES
from thalweg.core.calibration.model import Calibration, Source, pose_block
from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.rigid import Rigid
from thalweg.core.types import AnyArray, ArrayF
from thalweg.ingest.clouds.pcd import read_pcd
from thalweg.ingest.velodyne.reader import LidarOptions, iter_points

METHOD: Final = "relative orientation of camera and lidar from poses of a flat board"
COLUMNS: Final = tuple(
    f"{s}_{q}" for s in ("camera", "lidar") for q in ("x_m", "y_m", "z_m", "nx", "ny", "nz")
)
"""Of a table of measured boards: middle and normal, by the camera in ccs and by the lidar in scs."""


def read_scan(path: Path, options: LidarOptions) -> tuple[ArrayF, ArrayF, AnyArray | None]:
    """Points (n, 3) in scs, reflectivities (n,) and rings (n,) of a capture or of an ASCII PCD cloud.

    A cloud without ``ring`` gives None, without ``intensity`` 50 percent.
    """
    if path.suffix.lower() not in CAPTURES:
        cloud = read_pcd(path)
        brightness = cloud.fields.get("intensity", np.full(len(cloud.xyz_m), 50.0))
        ring = cloud.fields.get("ring")
        return cloud.xyz_m, brightness, None if ring is None else ring.astype(np.int64)
    blocks = list(iter_points([path], options))
    if not blocks:
        raise InputError("no points", expected="a lidar recording", where=path)
    xyz = np.concatenate([b.xyz_scs_m for b in blocks]).astype(np.float64)
    brightness = np.concatenate([b.intensity for b in blocks]).astype(np.float64)
    return xyz, brightness, np.concatenate([b.ring for b in blocks]).astype(np.int64)


def read_poses(
    images: Sequence[Path],
    scans: Sequence[Path],
    board: Checkerboard,
    camera: Camera,
    options: LidarOptions,
) -> tuple[list[BoardPose], pd.DataFrame]:
    """Poses of the board, and pictures in which it was not found, as (pose, reason).

    Parameters
    ----------
    images, scans : a picture and a lidar recording or cloud of each pose, in the same order.
    board, camera : the board and the interior orientation.
    options : how to read captures.

    Raises
    ------
    InputError : not as many pictures as scans, or a file cannot be read.
    """
    if len(images) != len(scans):
        raise InputError(
            f"{len(images)} pictures and {len(scans)} scans of a board",
            expected="one of each for each pose, in the same order",
        )
    poses, lost = [], []
    for image, scan in zip(images, scans, strict=True):
        try:
            corners = find_corners(read_grey(image), board, where=image.name)
            view = board_view(image.stem, corners, board, camera)
        except GeometryError as error:
            lost.append({"pose": image.stem, "used": False, "reason": str(error)})
            continue
        points, brightness, ring = read_scan(scan, options)
        poses.append(BoardPose(view=view, points_scs_m=points, reflectivity=brightness, ring=ring))
    return poses, pd.DataFrame(lost, columns=["pose", "used", "reason"])


def read_observations(path: Path) -> tuple[BoardPoses, BoardPoses]:
    """Boards that another program measured: a CSV table with the columns `COLUMNS`; camera's and lidar's.

    Raises
    ------
    InputError : the file is missing or lacks columns.
    """
    if not path.is_file():
        raise InputError("file not found", expected="a table of boards (CSV)", where=path)
    table = pd.read_csv(path)
    missing = [name for name in COLUMNS if name not in table]
    if missing:
        raise InputError(f"columns missing: {', '.join(missing)}", expected=", ".join(COLUMNS), where=path)
    values = table[list(COLUMNS)].to_numpy(np.float64)
    return BoardPoses.of(values[:, :3], values[:, 3:6]), BoardPoses.of(values[:, 6:9], values[:, 9:])


def board_calibration(
    T_ccs_scs: Rigid, run: str, *, observations: int, sigma0: float = float("nan")
) -> Calibration:
    """The relative orientation as a calibration with the pose block ``camera_lidar``."""
    block, cov = pose_block("camera_lidar", T_ccs_scs)
    source = Source(run=run, method=METHOD, observations=observations, sigma0=sigma0)
    return Calibration(title="Lidar relative to the camera", blocks=(block,), cov=cov, source=source)


def pose_table(result: BoardCalibration, lost: pd.DataFrame) -> pd.DataFrame:
    """One line a pose, with those whose board was not found in the picture."""
    return result.table if lost.empty else pd.concat([result.table, lost], ignore_index=True)
