"""A camera that stays: its pose in each picture from control points, and its history."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.calibration.field import FieldPoints, resect
from thalweg.core import ArrayF, Camera, GeometryError, InputError

IMAGE_POINTS: Final = ("image", "point", "x_px", "y_px")
CONTROL_POINTS: Final = ("point", "x", "y", "z")
_KEYS: Final = ("image", "point")


def read_named_columns(path: Path, columns: tuple[str, ...]) -> pd.DataFrame:
    """A CSV table with these columns: names as text, all others numbers.

    Raises
    ------
    InputError : no table, missing columns, values that are no numbers, or a row that is there twice.
    """
    keys = [name for name in columns if name in _KEYS]
    try:
        table = pd.read_csv(path, skipinitialspace=True, dtype=dict.fromkeys(keys, str))
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"no table: {error}", where=path, expected=", ".join(columns)) from error
    if missing := [name for name in columns if name not in table.columns]:
        raise InputError(f"no column {', '.join(missing)}", expected=", ".join(columns), where=path)
    table = table[list(columns)]
    try:
        table = table.astype({name: np.float64 for name in columns if name not in keys})
    except ValueError as error:
        raise InputError(str(error), expected="numbers", where=path) from error
    if table.isna().any(axis=None) or table.duplicated(keys).any():
        row = int(np.flatnonzero(table.isna().any(axis=1) | table.duplicated(keys))[0])
        raise InputError(
            f"row {row + 2} has an empty field, or stands there twice",
            expected="one complete row each",
            where=path,
        )
    return table


def resect_series(
    camera: Camera,
    marks: pd.DataFrame,
    points: pd.DataFrame,
    *,
    sigma_px: float = 1.0,
    sigma_point_m: float = 0.01,
    largest_sigma_m: float = 5.0,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Poses of pictures of known points, each for itself.

    Parameters
    ----------
    camera : interior orientation with its covariance, which each pose carries.
    marks : `IMAGE_POINTS`, a row an image point; pixels count from the upper left corner.
    points : `CONTROL_POINTS`, coordinates in metres of any Cartesian frame.
    sigma_px, sigma_point_m : standard deviations of a coordinate of an image point, and of a control point.
    largest_sigma_m : a place that is known worse is refused.

    Returns
    -------
    poses : a row a picture: ``image, x_m, y_m, z_m`` of the projection centre, ``sigma_x_m, sigma_y_m,
        sigma_z_m``, quaternion ``qx, qy, qz, qw`` from the camera to the points' frame,
        ``sigma_rotation_deg`` (largest about any axis), ``points`` that were used, ``rms_px`` of all
        residuals, ``sigma0``, and ``refused``: why there is no pose, else empty.
    residuals : ``image, point, vx_px, vy_px, used``.

    Raises
    ------
    InputError : no mark shows a control point.
    """
    labels = points["point"].tolist()
    number = {label: i for i, label in enumerate(labels)}
    known = marks[marks["point"].isin(labels)]
    if known.empty:
        raise InputError(
            f"none of the image points ({', '.join(sorted(set(marks['point']))[:5])}) is a control point",
            expected=f"names such as {', '.join(labels[:5])}",
            cure="Compare the names of both tables",
        )
    centre = points[["x", "y", "z"]].to_numpy(np.float64).mean(axis=0).round()
    field = FieldPoints(
        points=tuple((i, 0) for i in range(len(labels))),
        points_pcs=points[["x", "y", "z"]].to_numpy(np.float64) - centre,
        cov=sigma_point_m**2 * np.eye(3 * len(labels)),
    )
    rows, residuals = [], []
    for image, part in marks.groupby("image", sort=True):
        seen = part[part["point"].isin(labels)]
        table = seen.assign(marker=[number[p] for p in seen["point"]], corner=0, sigma_px=sigma_px)
        try:
            found = resect(
                camera, table, field, where=str(image), explain=False, largest_sigma_m=largest_sigma_m
            )
        except GeometryError as error:
            rows.append({"image": image, "points": len(seen), "refused": error.found})
            continue
        T, v = found.T_pcs_ccs, found.residuals
        rows.append(
            {
                "image": image,
                **_columns(T.R, T.shift_m + centre, T.cov),
                "points": int(found.used.sum()),
                "rms_px": float(np.sqrt(np.mean(v["vx_px"] ** 2 + v["vy_px"] ** 2))),
                "sigma0": found.sigma0,
                "refused": "",
            }
        )
        residuals.append(v.assign(image=image, point=[labels[m] for m in v["marker"]]))
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
