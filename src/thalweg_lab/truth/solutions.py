"""Poses of each chain against the truth of the digital twin.

The error of a pose is the shift and the small rotation vector in wcs that move it to the true one. A chain
is judged at its own nodes, and once more at the times at which every chain has a pose.

The trajectory by the camera is that of a boat whose camera sits where its mount says: the error of this
mount is in none of its sigmas, because it drops out of the cloud; `thalweg.navigation.camera.trajectory`.
Its truth is therefore the true pose of the *camera*, carried back through the mount that was used.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.accuracy import (
    CHAINS,
    check_chains,
    chi_square_band,
    independent_squares,
    shared,
    valid_spans,
    within,
)
from thalweg.calibration import read_mounts
from thalweg.core import (
    ArrayB,
    ArrayF,
    CoverageError,
    Rigid,
    Trajectory,
    attitude_axes,
    read_marked,
    root_mean_square,
)
from thalweg.core.calibration import read_calibration
from thalweg.navigation.camera import lidar_mount_by_camera
from thalweg_lab.truth import rig as rig_truth
from thalweg_lab.voyage import longest_correlation_s, read_true_mounts

OWN_TIMES: Final = "own poses"
COMMON_TIMES: Final = "times with a pose by every chain"

_ANGLES: Final = ("roll", "pitch", "heading")
_AXES: Final = ("east", "north", "up")


def chains_truth_table(
    trajectories: Mapping[str, Trajectory],
    truth: Trajectory,
    *,
    correlation_s: float,
    carried: Mapping[str, Rigid] | None = None,
) -> pd.DataFrame:
    """Errors of the poses of all chains, one row a quantity.

    Parameters
    ----------
    trajectories : chain -> its poses.
    truth : the true poses.
    correlation_s : correlation time of the errors of the poses, for the bands.
    carried : chain -> ``T_ics_ics`` that moves the true body frame to the one its poses are of.

    Returns
    -------
    Columns ``times`` (`OWN_TIMES`, `COMMON_TIMES`), ``quantity, unit``, one a chain, ``words``.

    Raises
    ------
    InputError : no comparison, see `check_chains`.
    CoverageError : a chain has no pose within the truth.
    """
    check_chains(list(trajectories))
    names = [name for name in CHAINS if name in trajectories]
    common = valid_spans(truth)
    for name in names:
        common = shared(common, valid_spans(trajectories[name]))
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for name in names:
        trajectory = trajectories[name]
        at = trajectory.valid & within(valid_spans(truth), trajectory.t_gps_s)
        if not at.any():
            raise CoverageError(
                f"no pose by {name} lies within the truth", expected="logs and truth of the same voyage"
            )
        moved = (carried or {}).get(name)
        for times, use in ((OWN_TIMES, at), (COMMON_TIMES, at & within(common, trajectory.t_gps_s))):
            for quantity, value, unit, words in _judged(trajectory, truth, use, correlation_s, moved):
                row = rows.setdefault((times, quantity), {"unit": unit, "words": words})
                row[name] = value
    keys = sorted(rows, key=lambda key: key[0] != OWN_TIMES)
    return pd.DataFrame(
        [
            {"times": times, "quantity": quantity, "unit": rows[times, quantity]["unit"]}
            | {name: rows[times, quantity].get(name, np.nan) for name in names}
            | {"words": rows[times, quantity]["words"]}
            for times, quantity in keys
        ]
    )


def pose_errors(
    trajectory: Trajectory, truth: Trajectory, use: ArrayB, moved: Rigid | None = None
) -> tuple[ArrayF, ArrayF]:
    """Errors (n, 6), shift in metres and rotation vector in radians in wcs, and their covariances."""
    position, R, _ = truth.at(trajectory.t_gps_s[use])
    if moved is not None:
        position, R = position + R @ moved.shift_m, R @ moved.R
    estimated = Rotation.from_quat(trajectory.quaternion_wcs_ics[use])
    turn = (Rotation.from_matrix(R) * estimated.inv()).as_rotvec()
    error = np.concatenate([position - trajectory.position_wcs_m[use], turn], axis=1)
    return error, trajectory.cov_pose_wcs[use]


def carried_by_camera(true_T_ics_ccs: Rigid, used_T_ics_ccs: Rigid) -> Rigid:
    """``T_ics_ics`` from the body frame that the camera's poses are of to the true one.

    The poses are ``T_wcs_ccs used^-1``, the truth of which is ``T_wcs_ics true used^-1``.
    """
    exact = np.zeros((6, 6))
    return true_T_ics_ccs.with_cov(exact) @ used_T_ics_ccs.with_cov(exact).inverse()


def judge_chains(
    *,
    trajectories: list[Path],
    voyage: Path,
    true_mounts: Path,
    mounts: Path,
    boat: list[Path],
    rig: list[Path],
    table: Path,
    twin: dict[str, Any],
    position_source: str,
) -> None:
    """Errors of the poses by INS, camera and all sensors from files.

    Parameters
    ----------
    trajectories : in the order of `CHAINS`; strips are last, where they were adjusted.
    voyage, true_mounts : the truth.
    mounts, boat : places of the sensors as used, and the boat's calibration, if there is one.
    rig : truth of the rig, if it is the camera.
    table : target, CSV.
    twin : sections ``ins`` and ``gnss`` of the twin.
    position_source : of the campaign.
    """
    _, used, _ = lidar_mount_by_camera(read_mounts(mounts), read_calibration(boat[0]) if boat else None)
    true = read_marked(rig[0], "mount", **rig_truth.TRUTH) if rig else read_true_mounts(true_mounts)["camera"]
    camera = Rigid.from_mount(true)
    chains_truth_table(
        {name: Trajectory.read(path) for name, path in zip(CHAINS, trajectories, strict=False)},
        Trajectory.read(voyage),
        correlation_s=longest_correlation_s(twin, position_source),
        carried={"camera": carried_by_camera(camera, used)},
    ).to_csv(table, index=False, float_format="%.9g")


def _judged(
    trajectory: Trajectory, truth: Trajectory, use: ArrayB, correlation_s: float, moved: Rigid | None
) -> list[tuple[str, float, str, str]]:
    n = int(use.sum())
    if not n:
        return [("n", 0.0, "1", "poses")]
    error, cov = pose_errors(trajectory, truth, use, moved)
    axes = attitude_axes(Rotation.from_quat(trajectory.quaternion_wcs_ics[use]).as_matrix())
    to_angles = np.linalg.inv(np.swapaxes(axes, 1, 2))
    angles = np.rad2deg(np.einsum("nij,nj->ni", to_angles, error[:, 3:]))
    sigma_deg = np.rad2deg(trajectory.sigma_roll_pitch_heading_rad()[use])
    length = np.linalg.norm(error[:, :3], axis=1)
    rows = [
        ("n", float(n), "1", "poses"),
        ("rms_position", _rms(length), "m", "rms of the error of the place, three-dimensional"),
        (
            "sigma_position",
            float(np.sqrt(np.mean(np.trace(cov[:, :3, :3], axis1=1, axis2=2)))),
            "m",
            "predicted",
        ),
        ("max_position", float(length.max()), "m", "largest error of the place"),
        *(
            (f"mean_{a}", float(error[:, i].mean()), "m", f"mean error, {a}: true minus estimated")
            for i, a in enumerate(_AXES)
        ),
    ]
    for i, name in enumerate(_ANGLES):
        rows += [
            (f"rms_{name}", _rms(angles[:, i]), "deg", f"rms of the error of the {name}"),
            (f"sigma_{name}", _rms(sigma_deg[:, i]), "deg", "predicted"),
            (f"mean_{name}", float(angles[:, i].mean()), "deg", f"mean error of the {name}"),
        ]
    independent = independent_squares(trajectory.t_gps_s[use], np.ones(n), correlation_s)
    for what, part in (("position", slice(0, 3)), ("attitude", slice(3, 6)), ("pose", slice(0, 6))):
        size = part.stop - part.start
        square = _normalised(error[:, part], cov[:, part, part]) / size
        low, high = chi_square_band(independent * size)
        rows += [
            (f"normalised_{what}", float(square.mean()), "1", f"mean of e^T C^-1 e / {size} of the {what}"),
            (f"consistent_low95_{what}", low, "1", "its 95 % acceptance band, lower limit"),
            (f"consistent_high95_{what}", high, "1", "upper limit"),
        ]
    return [*rows, ("independent", independent, "1", "independent poses that the bands rest on")]


def _normalised(error: ArrayF, cov: ArrayF) -> ArrayF:
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(cov, error[:, :, None])[:, :, 0]))


def _rms(values: ArrayF) -> float:
    return root_mean_square(values)
