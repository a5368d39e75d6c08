"""A camera that stays: its pose in each picture from control points, and its history."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.calibration.camera_files import LENS_SIGMA, best_nominal, free_of_lens, require_told
from thalweg.calibration.field import (
    LEAST_MARKS,
    FieldPoints,
    Resected,
    resect,
    resect_together,
    start_misfit_px,
)
from thalweg.core import ArrayF, Camera, GeometryError, InputError
from thalweg.settings.sections import FixedCamera

_AXES: Final = ("x", "y", "z")
_EXACT_M: Final = 1e-6
"""A control point without error, so that a covariance is that of the marks alone."""
_SHARES: Final = np.geomspace(0.4, 4.0, 20).tolist()
"""Focal lengths over the longer side that are tried for an unknown lens: 14 to 144 mm on full frame."""
_CENTRE_SHARE: Final = 0.01
"""Sigma of a principal point about the middle of the picture, over its longer side."""
_SEARCHED: Final = 5
"""Pictures, those with the most points, by which a focal length is looked for."""


def resect_series(
    camera: Camera,
    marks: pd.DataFrame,
    points: pd.DataFrame,
    *,
    sigma_px: float = 1.0,
    sigma_point_m: float = 0.01,
    largest_sigma_m: float = FixedCamera().largest_sigma_m,
    free: Sequence[str] = (),
) -> tuple[pd.DataFrame, pd.DataFrame, Camera]:
    """Poses of pictures of known points, each for itself, or together with the lens that they share.

    Errors of the control points and of the lens are common to all pictures of a camera that stays: they move
    all poses alike. What one pose differs from another by is the error of the marks, ``sigma_change``.

    Parameters
    ----------
    camera : interior orientation with its covariance, which each pose carries; see `starting_lens`.
    marks : ``image, point, x_px, y_px``, a row an image point; pixels count from the upper left corner;
        ``sigma_px`` where it is known (else NaN).
    points : ``point, x, y, z``, coordinates in metres of any Cartesian frame; ``sigma_x_m, sigma_y_m,
        sigma_z_m`` and ``check`` (true: takes no part and judges the pose) where known.
    sigma_px, sigma_point_m : standard deviations of a coordinate of an image point, and of a control point,
        where the tables state none.
    largest_sigma_m : a place that is known worse is refused.
    free : what to estimate of the lens, see `free_of_lens`; the rest stays as it is.

    Returns
    -------
    poses : a row a picture: ``image, x_m, y_m, z_m`` of the projection centre, ``sigma_x_m, sigma_y_m,
        sigma_z_m``, ``sigma_change_x_m ...`` of the marks alone, quaternion ``qx, qy, qz, qw`` from the
        camera to the points' frame, ``sigma_rotation_deg`` (largest about any axis), ``points`` that were
        used, ``rms_px`` of all residuals, ``sigma0`` and ``redundancy`` of the adjustment, ``check_rms_px``
        of check points, and ``refused``: why there is no pose, else empty.
    residuals : ``image, point, vx_px, vy_px, used``; those of check points are observed minus predicted.
    camera : with the covariance of what was estimated.

    Raises
    ------
    InputError : no mark shows a control point.
    GeometryError : the points do not tell what is ``free``; names it.
    """
    known = _Known.of(marks, points, sigma_px, sigma_point_m)
    field, tables = known.field, known.tables
    exact = replace(field, cov=np.diag(np.full(field.points_pcs.size, _EXACT_M**2)))
    found: dict[str, Resected] = {}
    refused: dict[str, str] = {}
    if free:
        unknown = free_of_lens(camera, free)
        camera, found, refused = resect_together(
            camera, tables, field, unknown, largest_sigma_m=largest_sigma_m
        )
        require_told(camera, unknown)
    else:
        for image, table in tables.items():
            try:
                found[image] = resect(
                    camera, table, field, where=image, explain=False, largest_sigma_m=largest_sigma_m
                )
            except GeometryError as error:
                refused[image] = error.found
    perfect = replace(camera, cov=np.zeros_like(camera.cov))
    rows, residuals = [], []
    for image, table in tables.items():
        if image not in refused:
            try:
                change = resect(
                    perfect, table, exact, where=image, explain=False, largest_sigma_m=largest_sigma_m
                )
            except GeometryError as error:
                refused[image] = error.found
        if image in refused:
            rows.append({"image": image, "points": len(table), "refused": refused[image]})
            continue
        one = found[image]
        T, v = one.T_pcs_ccs, one.residuals
        judged = known.judged[known.judged["image"] == image]
        ccs = (judged[list(_AXES)].to_numpy(np.float64) - known.centre_m - T.shift_m) @ T.R
        off = judged[["x_px", "y_px"]].to_numpy(np.float64) - camera.project(ccs).reshape(-1, 2)
        rows.append(
            {
                "image": image,
                **_columns(T.R, T.shift_m + known.centre_m, T.cov),
                **{
                    f"sigma_change_{axis}_m": float(s)
                    for axis, s in zip(_AXES, np.sqrt(np.diag(change.T_pcs_ccs.cov)[:3]), strict=True)
                },
                "points": int(one.used.sum()),
                "rms_px": float(np.sqrt(np.mean(v["vx_px"] ** 2 + v["vy_px"] ** 2))),
                "sigma0": one.sigma0,
                "redundancy": one.redundancy,
                "check_rms_px": float(np.sqrt(np.mean(np.sum(off**2, axis=1)))) if len(off) else np.nan,
                "refused": "",
            }
        )
        residuals.append(v.assign(image=image, point=[known.labels[m] for m in v["marker"]]))
        if len(off):
            columns = {"point": judged["point"], "vx_px": off[:, 0], "vy_px": off[:, 1]}
            residuals.append(pd.DataFrame({**columns, "image": image, "used": False}))
    names = ["image", "point", "vx_px", "vy_px", "used"]
    left = pd.concat(residuals)[names] if residuals else pd.DataFrame(columns=names)
    return pd.DataFrame(rows), left, camera


def starting_lens(
    marks: pd.DataFrame,
    points: pd.DataFrame,
    size_px: tuple[int, int],
    *,
    free: Sequence[str],
    focal_px: float | None = None,
    sigma_px: float = 1.0,
    sigma_point_m: float = 0.01,
) -> Camera:
    """A lens of which nothing is known, to begin with: the focal length by which control points fit best.

    What is not to be estimated freely has the sigma of what lenses have: the principal point 1 % of the
    longer side about the middle, distortion `LENS_SIGMA` about zero. Held without one, 28 points over a
    hillside gave focal lengths that were seven times their sigmas off.

    Parameters
    ----------
    marks, points, sigma_px, sigma_point_m : as of `resect_series`.
    size_px : of the pictures.
    free : what is to be estimated, see `free_of_lens`.
    focal_px : as EXIF states it, tried beside 0.4 to 4 times the longer side: of a picture that was made
        smaller EXIF often states that of the original.

    Raises
    ------
    InputError : no mark shows a control point, or marks outside of the picture.
    GeometryError : no picture fits with any focal length.
    """
    xy = marks[["x_px", "y_px"]].to_numpy(np.float64)
    beyond = ~((xy >= 0) & (xy <= size_px)).all(axis=1)
    if beyond.any():
        row = marks[beyond].iloc[0]
        raise InputError(
            f"the mark of {row['point']} at ({row['x_px']:g}, {row['y_px']:g}) in {row['image']}",
            expected=f"pixels inside of {size_px[0]} x {size_px[1]}",
            cure="State the size of the pictures in which the points were measured",
        )
    known = _Known.of(marks, points, sigma_px, sigma_point_m)
    shown = sorted(known.tables.values(), key=len, reverse=True)
    # others than the first count if a pose can be had of them at all
    shown = [table for k, table in enumerate(shown[:_SEARCHED]) if k == 0 or len(table) >= LEAST_MARKS]

    def misfit(camera: Camera) -> float:
        """Mean over the pictures with the most points."""
        return float(np.mean([start_misfit_px(camera, table, known.field) for table in shown]))

    stated = [] if focal_px is None else [focal_px / max(size_px)]
    start = best_nominal("camera", "perspective", size_px, misfit, [*stated, *_SHARES])
    centre = _CENTRE_SHARE * max(size_px)
    sigma = {"cx": centre, "cy": centre, **LENS_SIGMA}
    for change in free_of_lens(start, free).values():
        sigma |= dict.fromkeys(np.array(start.parameter_names)[change != 0].tolist(), 0.0)
    own = [sigma.get(name, 0.0) for name in start.parameter_names]
    return replace(start, cov=np.diag(np.square(own)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Known:
    """Control points as a field about their middle, the marks of each picture, and those of check points."""

    field: FieldPoints
    centre_m: ArrayF
    labels: list[str]
    tables: dict[str, pd.DataFrame]
    judged: pd.DataFrame

    @classmethod
    def of(cls, marks: pd.DataFrame, points: pd.DataFrame, sigma_px: float, sigma_point_m: float) -> Self:
        """From the tables of `resect_series`."""
        check = points["check"].astype(bool) if "check" in points else np.zeros(len(points), np.bool_)
        fixed = points[~check]
        labels = fixed["point"].tolist()
        number = {label: i for i, label in enumerate(labels)}
        if not marks["point"].isin(labels).any():
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
        tables = {}
        for image, part in marks.groupby("image", sort=False):
            seen = part[part["point"].isin(labels)]
            own = seen["sigma_px"].fillna(sigma_px) if "sigma_px" in seen else sigma_px
            tables[str(image)] = seen.assign(
                marker=[number[p] for p in seen["point"]], corner=0, sigma_px=own
            )
        return cls(
            field=FieldPoints(
                points=tuple((i, 0) for i in range(len(labels))),
                points_pcs=xyz - centre,
                cov=np.diag(sigma.ravel() ** 2),
            ),
            centre_m=centre,
            labels=labels,
            tables=tables,
            judged=marks.merge(points.loc[check, ["point", *_AXES]], on="point"),
        )


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
