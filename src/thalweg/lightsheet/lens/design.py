"""What the pictures of a marker field can tell about a camera: correlations, how they were taken."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy import sparse

from thalweg.calibration.field.bundle import (
    Layout,
    Problem,
    State,
    inner_constraints,
    marks_model,
    start_state,
)
from thalweg.calibration.field.bundle_cleaning import thinned
from thalweg.calibration.field.description import FieldDescription
from thalweg.calibration.field.network_start import misfit_px, start_network
from thalweg.calibration.field.picture_overview import with_overview
from thalweg.calibration.markers.mark_block import block_of
from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF

GOOD_MARK_PX: Final = 0.1
"""Standard deviation of a crossing of black and white in a sharp picture."""

ONE_DIRECTION: Final = float(np.deg2rad(30.0))
"""Largest angle between views that count as one direction."""

_POSE: Final = ("place along the rows", "place along the columns", "distance", "tilt about the rows",
                "tilt about the columns", "roll")  # fmt: skip
_TILTED: Final = float(np.deg2rad(5.0))
_ROLLED: Final = float(np.deg2rad(45.0))
_LEAST_EIGENVALUE: Final = 1e-15


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """State, layout, covariance, pictures of a bundle at approximate values; how badly these fit, pixels."""

    x: State
    layout: Layout
    cov: ArrayF
    images: tuple[str, ...]
    misfit_px: float


def predicted(marks: pd.DataFrame, camera: Camera, field: FieldDescription) -> Prediction:
    """What the free bundle would know, at approximate values.

    Marks count with `GOOD_MARK_PX` where their table states more: the bundle estimates their sigma anyway,
    and here only the geometry is judged.

    Raises
    ------
    GeometryError : no approximate values, with what the pictures show.
    """
    try:
        block = block_of(marks, {camera.name: camera})
        block = replace(block, sigma_px=np.minimum(block.sigma_px, GOOD_MARK_PX))
        start = start_network(block, field.layout)
        misfit = misfit_px(block, start, float(camera.parameters[0]))
        n = len(block.images)
        oriented = np.array([i in start.poses for i in range(n)])
        nowhere = Rigid(R=np.eye(3), shift_m=np.zeros(3))
        poses = {i: start.poses.get(i, nowhere) for i in range(n)}
        problem = Problem(
            block, np.zeros(n, np.int64), np.ones(len(block.image), np.bool_), (camera.parameter_names,)
        )
        x = start_state(block.images, (camera,), poses, start.points)
        problem, x, _ = thinned(
            problem, x, oriented, np.ones(len(block.points), np.bool_), set(), doubt=False
        )
    except GeometryError as error:
        raise with_overview(error, marks) from error
    layout = Layout(problem, x.cameras)
    rows = (
        sparse.diags_array(1.0 / np.repeat(problem.block.sigma_px, 2))
        @ marks_model(problem, layout, x).jacobian
    )
    N = np.asarray((rows.T @ rows).todense())
    scale = np.sqrt(np.maximum(np.diag(N), 1e-30))
    Q = np.linalg.qr((inner_constraints(x.X, layout, scale=True) / scale).T)[0]
    w, V = np.linalg.eigh(N / np.outer(scale, scale) + Q @ Q.T)
    # a free combination has next to no eigenvalue: its unknowns get sigmas that nobody takes for small
    cov = (V / np.maximum(w, _LEAST_EIGENVALUE)) @ V.T / np.outer(scale, scale)
    return Prediction(x=x, layout=layout, cov=cov, images=problem.block.images, misfit_px=misfit)


def lens_cov(layout: Layout, cov: ArrayF) -> ArrayF:
    """(9, 9) part of the first camera of a joint covariance; all its parameters are unknowns."""
    at = [layout.at_camera[0][k] for k in sorted(layout.at_camera[0])]
    return cov[np.ix_(at, at)]


def lens_correlations(x: State, layout: Layout, cov: ArrayF, images: Sequence[str]) -> pd.DataFrame:
    """What each parameter of the camera is most correlated with: another one, and an element of a pose.

    Parameters
    ----------
    x, layout, cov : of a bundle with one camera.
    images : names of its pictures, in order.

    Returns
    -------
    Columns parameter, with, correlation; two rows a parameter, the pose in the
    second. Poses are taken in the camera's own frame:
    places along rows and columns, distance along the view, tilts, roll.
    """
    lens = lens_cov(layout, cov)
    at = [layout.at_camera[0][k] for k in sorted(layout.at_camera[0])]
    names = x.cameras[0].parameter_names
    sigma = np.sqrt(np.maximum(np.diag(lens), 1e-300))
    own = lens / np.outer(sigma, sigma) - np.eye(len(names))
    poses = np.empty((len(names), len(images), 6))
    for i in range(len(images)):
        turn = np.kron(np.eye(2), x.R[i].T)
        pose = layout.pose(i)
        spread = np.sqrt(np.maximum(np.diag(turn @ cov[pose, pose] @ turn.T), 1e-300))
        poses[:, i] = cov[at, pose] @ turn.T / np.outer(sigma, spread)
    rows = []
    for k, name in enumerate(names):
        j = int(np.abs(own[k]).argmax())
        rows.append((name, names[j], float(own[k, j])))
        i, part = divmod(int(np.abs(poses[k]).argmax()), len(_POSE))
        rows.append((name, f"{_POSE[part]} of {images[i]}", float(poses[k, i, part])))
    return pd.DataFrame(rows, columns=["parameter", "with", "correlation"])


def view_facts(x: State) -> dict[str, Any]:
    """How the pictures were taken.

    Returns
    -------
    ``pictures``; ``largest_angle_deg`` between the views of any two; ``rolled``: those in which the field is
    turned by more than 45 degrees against most others. Where the views differ, only tilted ones count, and
    the turn is that of the field's upright; in one direction it is that of the picture over the field.
    """
    views = x.R[:, :, 2]
    angle = np.arccos(np.clip(views @ views.T, -1.0, 1.0)).max()
    if angle < ONE_DIRECTION:
        rows = x.R[:, :, 0] @ x.R[0][:, :2]
        way = np.arctan2(rows[:, 1], rows[:, 0])
    else:
        solved = x.X[np.isfinite(x.X).all(axis=1)]
        normal = np.linalg.svd(solved - solved.mean(axis=0), full_matrices=False)[2][2]
        upright = np.einsum("ikj,k->ij", x.R, normal)
        upright *= -np.sign(upright[:, 2:])
        tilted = np.hypot(upright[:, 0], upright[:, 1]) > np.sin(_TILTED)
        way = np.arctan2(upright[:, 0], upright[:, 1])[tilted]
    alike = (np.abs(np.angle(np.exp(1j * (way[:, None] - way)))) < _ROLLED).sum(axis=1)
    rolled = int(len(way) - alike.max()) if len(way) else 0
    return {"pictures": len(views), "largest_angle_deg": float(np.rad2deg(angle)), "rolled": rolled}
