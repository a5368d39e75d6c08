"""A camera that stays: its pose in each picture from control points, and its history."""

from dataclasses import replace
from typing import Final

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.calibration.field import FieldPoints, resect
from thalweg.core import ArrayF, Camera, GeometryError, InputError
from thalweg.settings.sections import FixedCamera

_AXES: Final = ("x", "y", "z")
_EXACT_M: Final = 1e-6
"""A control point without error, so that a covariance is that of the marks alone."""


def resect_series(
    camera: Camera,
    marks: pd.DataFrame,
    points: pd.DataFrame,
    *,
    sigma_px: float = 1.0,
    sigma_point_m: float = 0.01,
    largest_sigma_m: float = FixedCamera().largest_sigma_m,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Poses of pictures of known points, each for itself.

    Errors of the control points and of the lens are common to all pictures of a camera that stays: they move
    all poses alike. What one pose differs from another by is the error of the marks, ``sigma_change``.

    Parameters
    ----------
    camera : interior orientation with its covariance, which each pose carries.
    marks : ``image, point, x_px, y_px``, a row an image point; pixels count from the upper left corner;
        ``sigma_px`` where it is known (else NaN).
    points : ``point, x, y, z``, coordinates in metres of any Cartesian frame; ``sigma_x_m, sigma_y_m,
        sigma_z_m`` and ``check`` (true: takes no part and judges the pose) where known.
    sigma_px, sigma_point_m : standard deviations of a coordinate of an image point, and of a control point,
        where the tables state none.
    largest_sigma_m : a place that is known worse is refused.

    Returns
    -------
    poses : a row a picture: ``image, x_m, y_m, z_m`` of the projection centre, ``sigma_x_m, sigma_y_m,
        sigma_z_m``, ``sigma_change_x_m ...`` of the marks alone, quaternion ``qx, qy, qz, qw`` from the
        camera to the points' frame, ``sigma_rotation_deg`` (largest about any axis), ``points`` that were
        used, ``rms_px`` of all residuals, ``sigma0``, ``check_rms_px`` of check points, and ``refused``: why
        there is no pose, else empty.
    residuals : ``image, point, vx_px, vy_px, used``; those of check points are observed minus predicted.

    Raises
    ------
    InputError : no mark shows a control point.
    """
    check = set(points.loc[points["check"].astype(bool), "point"]) if "check" in points else set()
    fixed = points[~points["point"].isin(check)]
    labels = fixed["point"].tolist()
    number = {label: i for i, label in enumerate(labels)}
    known = marks[marks["point"].isin(labels)]
    if known.empty:
        raise InputError(
            f"none of the image points ({', '.join(sorted(set(marks['point']))[:5])}) is a control point",
            expected=f"names such as {', '.join(labels[:5])}",
            cure="Compare the names of both tables",
        )
    xyz = fixed[list(_AXES)].to_numpy(np.float64)
    centre = xyz.mean(axis=0).round()
    stated = [f"sigma_{axis}_m" for axis in _AXES]
    sigma = np.full(xyz.shape, sigma_point_m)
    if set(stated) <= set(fixed.columns):
        sigma = fixed[stated].fillna(sigma_point_m).to_numpy(np.float64)
    numbers = tuple((i, 0) for i in range(len(labels)))
    field, exact = (
        FieldPoints(points=numbers, points_pcs=xyz - centre, cov=np.diag(variance))
        for variance in (sigma.ravel() ** 2, np.full(xyz.size, _EXACT_M**2))
    )
    perfect = replace(camera, cov=np.zeros_like(camera.cov))
    at_check = points[points["point"].isin(check)].set_index("point")[list(_AXES)]
    rows, residuals = [], []
    for image, part in marks.groupby("image", sort=False):
        seen = part[part["point"].isin(labels)]
        own = seen["sigma_px"].fillna(sigma_px) if "sigma_px" in seen else sigma_px
        table = seen.assign(marker=[number[p] for p in seen["point"]], corner=0, sigma_px=own)
        try:
            found = resect(
                camera, table, field, where=str(image), explain=False, largest_sigma_m=largest_sigma_m
            )
            change = resect(
                perfect, table, exact, where=str(image), explain=False, largest_sigma_m=largest_sigma_m
            )
        except GeometryError as error:
            rows.append({"image": image, "points": len(seen), "refused": error.found})
            continue
        T, v = found.T_pcs_ccs, found.residuals
        judged = part[part["point"].isin(check)]
        ccs = (at_check.loc[judged["point"]].to_numpy(np.float64) - centre - T.shift_m) @ T.R
        off = judged[["x_px", "y_px"]].to_numpy(np.float64) - camera.project(ccs).reshape(-1, 2)
        rows.append(
            {
                "image": image,
                **_columns(T.R, T.shift_m + centre, T.cov),
                **{
                    f"sigma_change_{axis}_m": float(s)
                    for axis, s in zip(_AXES, np.sqrt(np.diag(change.T_pcs_ccs.cov)[:3]), strict=True)
                },
                "points": int(found.used.sum()),
                "rms_px": float(np.sqrt(np.mean(v["vx_px"] ** 2 + v["vy_px"] ** 2))),
                "sigma0": found.sigma0,
                "check_rms_px": float(np.sqrt(np.mean(np.sum(off**2, axis=1)))) if len(off) else np.nan,
                "refused": "",
            }
        )
        residuals.append(v.assign(image=image, point=[labels[m] for m in v["marker"]]))
        if len(off):
            columns = {"point": judged["point"], "vx_px": off[:, 0], "vy_px": off[:, 1]}
            residuals.append(pd.DataFrame({**columns, "image": image, "used": False}))
    names = ["image", "point", "vx_px", "vy_px", "used"]
    return pd.DataFrame(rows), pd.concat(residuals)[names] if residuals else pd.DataFrame(columns=names)


def _columns(R: ArrayF, centre_m: ArrayF, cov: ArrayF) -> dict[str, float]:
    sigma = np.sqrt(np.diag(cov))
    return {
        **dict(zip(("x_m", "y_m", "z_m"), centre_m.tolist(), strict=True)),
        **dict(zip(("sigma_x_m", "sigma_y_m", "sigma_z_m"), sigma[:3].tolist(), strict=True)),
        **dict(
            zip(
                ("qx", "qy", "qz", "qw"),
                Rotation.from_matrix(R).as_quat(canonical=True).tolist(),
                strict=True,
            )
        ),
        "sigma_rotation_deg": float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(cov[3:, 3:]).max()))),
    }
