"""The boat's camera on the field: interior orientation and poses of all its pictures in one adjustment.

The field's points enter with their joint covariance, so that the poses carry it, too, and share it. Interior
orientation is calibrated from the same pictures, or held at given values and their covariance.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.field.bundle import Control, Problem, reduced, solve, start_state
from thalweg.calibration.field.bundle_cleaning import clean
from thalweg.calibration.field.network import FieldNetwork, network_of
from thalweg.calibration.field.points import FieldPoints
from thalweg.calibration.markers.mark_block import Block, block_of
from thalweg.calibration.markers.nominal_camera import starting_camera_by
from thalweg.calibration.markers.ray_resection import pose_from_rays
from thalweg.core.camera.model import PARAMETERS, Camera, Model
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid

_CAP_RAD: Final = 0.03
"""Directions by a nominal interior orientation."""
_LEAST_MARKS: Final = 6
_LEAST_SHARE: Final = 0.6
_SMALLEST_SIGMA_M: Final = 1e-6
"""Added to each coordinate: a free network has no error along its datum, its covariance is singular."""
_FEW_IMAGES: Final = 3


def start_poses(block: Block, points: FieldPoints) -> tuple[dict[int, Rigid], dict[str, str], float]:
    """Poses of pictures by nominal directions; pictures without one and why; median angle [rad]."""
    index = points.index
    X = np.array([points.points_pcs[index[p]] for p in block.points]).reshape(-1, 3)
    poses: dict[int, Rigid] = {}
    left: dict[str, str] = {}
    angles_of: list[float] = []
    for i, image in enumerate(block.images):
        mine = np.flatnonzero((block.image == i) & np.isfinite(block.rays).all(axis=1))
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
    marks: pd.DataFrame,
    camera: Camera,
    points: FieldPoints,
    *,
    free: Sequence[str] | None = None,
    weighted: bool = False,
) -> FieldNetwork:
    """Adjust all pictures of the boat's camera on the field.

    Parameters
    ----------
    marks : image, camera, marker, corner, x_px, y_px, sigma_px.
    camera : nominal interior orientation, or a known one with covariance.
    points : of the field, without the boat's own markers.
    free : parameters to estimate; all if None.
    weighted : the camera's covariance is an observation of its parameters: an earlier calibration.

    Raises
    ------
    GeometryError : no picture can be oriented; the pictures do not determine the interior orientation.
    """
    block = block_of(known_marks(marks, points), dict.fromkeys(set(marks["camera"]), camera))
    poses, left, _ = start_poses(block, points)
    rejected = [("image", image, reason) for image, reason in left.items()]
    estimated = tuple(PARAMETERS[camera.model]) if free is None else tuple(free)
    if weighted:
        # what is stated without sigma is known and no observation
        sigma = dict(zip(camera.parameter_names, np.diag(camera.cov), strict=True))
        estimated = tuple(name for name in estimated if sigma[name] > 0)
        weighted = bool(estimated)
    if not poses or (len(poses) < _FEW_IMAGES and estimated and not weighted):
        told = "; ".join(f"{image}: {reason}" for image, reason in list(left.items())[:3])
        raise GeometryError(
            f"{len(poses)} of {len(block.images)} pictures of the boat's camera can be oriented"
            + (f" ({told})" if told else ""),
            expected=f"at least {_FEW_IMAGES} to calibrate the camera, one with a known interior orientation",
            cure="Record the positions again so that the camera sees more markers of the field",
        )
    index = points.index
    at = np.array([index[p] for p in block.points])
    rows = (3 * at[:, None] + np.arange(3)).ravel()
    cov = points.cov[np.ix_(rows, rows)] + np.eye(len(rows)) * _SMALLEST_SIGMA_M**2
    control = Control(np.arange(len(at)), points.points_pcs[at], cov)
    problem = Problem(
        block,
        np.zeros(len(block.images), np.int64),
        np.ones(len(block.image), bool),
        (estimated,),
        control=control,
        weighted=weighted,
    )
    identity = Rigid(R=np.eye(3), shift_m=np.zeros(3))
    x = start_state(
        block.images,
        (camera,),
        {i: poses.get(i, identity) for i in range(len(block.images))},
        points.points_pcs[at],
    )
    oriented = np.array([i in poses for i in range(len(block.images))])
    problem, x = reduced(problem, x, np.ones(len(block.points), bool), oriented)
    problem, adjusted, layout, lost = clean(problem, x)
    adjusted, layout = solve(problem, adjusted.x)
    return network_of(problem, adjusted, layout, rejected + lost, None)
