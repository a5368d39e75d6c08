"""A camera that stays: its pose in each picture from control points, and its history."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, Self

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, f as fisher

from thalweg.calibration.camera_files import best_nominal, free_of_lens, guessed_lens, require_told
from thalweg.calibration.field import (
    LEAST_MARKS,
    FieldPoints,
    Resected,
    resect,
    resect_together,
    start_misfit_px,
)
from thalweg.core import ArrayF, Camera, GeometryError, InputError, global_test
from thalweg.settings.sections import FixedCamera

_AXES: Final = ("x", "y", "z")
_EXACT_M: Final = 1e-6
"""A control point without error, so that a covariance is that of the marks alone."""
_SHARES: Final = np.geomspace(0.4, 4.0, 20).tolist()
"""Focal lengths over the longer side that are tried for an unknown lens: 14 to 144 mm on full frame."""
_TOLD: Final = 0.5
"""Sigma of a combination of a lens's parameters over that of a guess, below which the marks tell it."""
_CONTRADICTS: Final = 0.001
"""Probability below which the marks contradict an interior orientation."""
_SEARCHED: Final = 5
"""Pictures, those with the most points, by which a focal length is looked for."""


Interior = Literal["auto", "free", "weighted", "fixed"]
"""What an interior orientation counts for, as of `resect_series`."""


def _refuse_beyond(marks: pd.DataFrame, size_px: tuple[int, int], cure: str) -> None:
    """Refuse marks outside of a picture."""
    xy = marks[["x_px", "y_px"]].to_numpy(np.float64)
    beyond = ~((xy >= 0) & (xy <= size_px)).all(axis=1)
    if beyond.any():
        row = marks[beyond].iloc[0]
        raise InputError(
            f"the mark of {row['point']} at ({row['x_px']:g}, {row['y_px']:g}) in {row['image']}",
            expected=f"pixels inside of {size_px[0]} x {size_px[1]}",
            cure=cure,
        )


def resect_series(
    camera: Camera,
    marks: pd.DataFrame,
    points: pd.DataFrame,
    *,
    sigma_px: float = 1.0,
    sigma_point_m: float = 0.01,
    largest_sigma_m: float = FixedCamera().largest_sigma_m,
    interior: Interior = "auto",
    free: Sequence[str] = (),
) -> tuple[pd.DataFrame, pd.DataFrame, Camera, list[str]]:
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
    interior : ``weighted``: the camera's covariance is an observation; ``fixed``: its values are exact;
        ``free``: they are a start, ``free`` (the focal length, if it is empty) is estimated, and the rest
        counts with what lenses have (`guessed_lens`); ``auto``: weighted if there is a covariance and the
        marks do not contradict it, else all parameters are estimated about the camera's values with what
        lenses have.
    free : what to estimate of the lens without any such knowledge, see `free_of_lens`.

    Returns
    -------
    poses : a row a picture: ``image, x_m, y_m, z_m`` of the projection centre, ``sigma_x_m, sigma_y_m,
        sigma_z_m``, ``sigma_change_x_m ...`` of the marks alone, quaternion ``qx, qy, qz, qw`` from the
        camera to the points' frame, ``sigma_rotation_deg`` (largest about any axis), ``points`` that were
        used, ``rms_px`` of all residuals, ``sigma0`` and ``redundancy`` of the adjustment, ``check_rms_px``
        of check points, and ``refused``: why there is no pose, else empty. Where the global test says that
        sigmas of marks and points are too small, those of the pose are multiplied by sigma0: that of all
        pictures together, or the picture's own.
    residuals : ``image, point, vx_px, vy_px, used``; those of check points are observed minus predicted.
    camera : with the covariance of what was estimated.
    notes : sentences about the interior orientation and the global test.

    Raises
    ------
    InputError : no mark shows a control point, one lies outside of the camera's picture, or a weighted
        interior orientation without a covariance.
    GeometryError : the points do not tell what is ``free``, which is named; or the marks contradict an
        interior orientation that is to be believed (``weighted``, ``fixed``).
    """
    known = _Known.of(marks, points, sigma_px, sigma_point_m)
    _refuse_beyond(
        marks,
        camera.size_px,
        "Give marks in pixels from the upper left corner, and the lens of these pictures",
    )
    field, tables = known.field, known.tables
    start, together, notes = _lens_to_begin_with(camera, known, interior, free)
    found: dict[str, Resected] = {}
    refused: dict[str, str] = {}
    if together:
        unknown = free_of_lens(start, free or (("focal",) if interior == "free" else ()))
        camera, found, refused = resect_together(
            start, tables, field, unknown, largest_sigma_m=largest_sigma_m
        )
        require_told(camera, unknown)
        tests = [global_test(one.sigma0, one.redundancy) for one in found.values()][:1]
    else:
        camera = start
        for image, table in tables.items():
            try:
                found[image] = resect(camera, table, field, where=image, largest_sigma_m=largest_sigma_m)
            except GeometryError as error:
                refused[image] = error.found
        spare = sum(one.redundancy for one in found.values())
        squares = sum(one.sigma0**2 * one.redundancy for one in found.values())
        tests = [global_test(float(np.sqrt(squares / spare)), spare)] if spare > 0 else []
    factor = max((test.factor for test in tests), default=1.0)
    notes += [note for test in tests if (note := test.note("image or control points"))]
    exact = replace(field, cov=np.diag(np.full(field.points_pcs.size, _EXACT_M**2)))
    perfect = replace(camera, cov=np.zeros_like(camera.cov))
    rows, residuals, worse = [], [], []
    for image, table in tables.items():
        if image not in refused:
            try:
                change = resect(perfect, table, exact, where=image, largest_sigma_m=largest_sigma_m)
            except GeometryError as error:
                refused[image] = error.found
        if image in refused:
            rows.append({"image": image, "points": len(table), "refused": refused[image]})
            continue
        one = found[image]
        T, v = one.T_pcs_ccs, one.residuals
        own = max(factor, global_test(one.sigma0, one.redundancy).factor)
        worse += [image] if own > factor else []
        of_lens = one.by_interior @ start.cov @ one.by_interior.T
        cov = of_lens + own**2 * (T.cov - of_lens)
        judged = known.judged[known.judged["image"] == image]
        ccs = (judged[list(_AXES)].to_numpy(np.float64) - known.centre_m - T.shift_m) @ T.R
        off = judged[["x_px", "y_px"]].to_numpy(np.float64) - camera.project(ccs).reshape(-1, 2)
        rows.append(
            {
                "image": image,
                **_columns(T.R, T.shift_m + known.centre_m, cov),
                **{
                    f"sigma_change_{axis}_m": own * float(s)
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
    if worse:
        notes.append(
            f"Global test failed in {len(worse)} of {len(found)} pictures ({', '.join(worse[:5])}): their "
            "marks err more than those of the others; standard deviations are multiplied by their own sigma0"
        )
    names = ["image", "point", "vx_px", "vy_px", "used"]
    left = pd.concat(residuals)[names] if residuals else pd.DataFrame(columns=names)
    return (
        pd.DataFrame(rows),
        left,
        replace(camera, cov=factor**2 * camera.cov if together else camera.cov),
        notes,
    )


def _lens_to_begin_with(
    camera: Camera, known: "_Known", interior: Interior, free: Sequence[str]
) -> tuple[Camera, bool, list[str]]:
    """The camera with the covariance that counts, whether all pictures are adjusted together, notes."""
    stated = bool((np.diag(camera.cov) > 0).any())
    if interior == "free":
        return guessed_lens(camera, free or ("focal",)), True, []
    if interior == "weighted" and not stated:
        raise InputError(
            f"the interior orientation of {camera.name} states no standard deviations",
            expected="a calibration with a covariance",
            cure="State them (thalweg import-camera), or estimate it with --interior free",
        )
    if interior == "auto" and not stated:
        told = (
            f"The interior orientation of {camera.name} states no standard deviations: it counts as a guess "
            "(focal length 2 %, principal point 1 % of the longer side, k1 and k2 0.1) and is estimated with "
            "the poses. Is it known better? State it by `thalweg import-camera`"
        )
        return guessed_lens(camera, free), True, [told]
    if interior == "fixed":
        camera = replace(camera, cov=np.zeros_like(camera.cov))
    if free:
        return camera, True, []
    doubt = _contradiction(camera, known)
    if doubt and interior == "auto":
        return guessed_lens(camera), True, [f"{doubt[0].upper()}{doubt[1:]}: estimated about it instead"]
    if doubt:
        raise GeometryError(
            doubt,
            expected="the calibration of this camera at this focus and zoom",
            cure="Estimate it with --interior free, or check points and marks",
        )
    return camera, False, []


def _contradiction(camera: Camera, known: "_Known") -> str:
    """What the marks say against an interior orientation, "" if they agree with it or tell nothing of it.

    The lens is estimated about the stated values ``p`` with the covariance ``W`` of a guess. With its
    covariance ``C`` and ``K = 1 - C W^-1`` (what the marks say of it) its change ``d`` has, if ``p`` errs
    as its covariance ``Q`` states, the covariance ``V = s0^2 (C - C W^-1 C) + K Q K^T``. In the k
    combinations that the marks tell, ``d^T V^-1 d`` is a chi-square with ``s0 = 1`` if this wide model passes
    the global test; else ``s0`` is the marks' own and the k-th part of it follows an F distribution, so that
    a sigma of marks that was stated too large hides nothing.
    """
    W = guessed_lens(camera).cov + camera.cov
    inverse = np.linalg.inv(W)
    scale = 1.0
    while True:
        tables = {k: t.assign(sigma_px=scale * t["sigma_px"]) for k, t in known.tables.items()}
        try:
            lens, poses, _ = resect_together(
                replace(camera, cov=W), tables, known.field, {}, largest_sigma_m=np.inf
            )
        except GeometryError:
            return ""
        if not poses:
            return ""
        K = np.eye(len(W)) - lens.cov @ inverse
        redundancy = max(next(iter(poses.values())).redundancy - float(np.trace(K)), 0.0)
        lengths = np.concatenate([one.residuals["standardised"][one.used] for one in poses.values()])
        squares = float(np.square(lengths).sum())
        test = global_test(float(np.sqrt(squares / max(redundancy, 1.0))), redundancy)
        if scale < 1.0 or test.sigma0 >= test.low:
            break
        scale = test.sigma0
    as_stated = scale == 1.0 and test.sigma0 <= test.high
    variance = 1.0 if as_stated else test.sigma0**2
    root = np.linalg.inv(np.linalg.cholesky(W))
    shares, axes = np.linalg.eigh(root @ lens.cov @ root.T)
    told = axes[:, shares < _TOLD**2].T @ root
    k = len(told)
    if k == 0:
        return ""
    d = lens.parameters - camera.parameters
    V = variance * (lens.cov - lens.cov @ inverse @ lens.cov) + K @ camera.cov @ K.T
    square = float(told @ d @ np.linalg.solve(told @ V @ told.T, told @ d))
    chance = chi2.sf(square, k) if as_stated else fisher.sf(square / k, k, redundancy)
    if chance >= _CONTRADICTS:
        return ""
    sigma = np.sqrt(variance * np.diag(lens.cov))
    changes = ", ".join(
        f"{name} {value:.6g} +- {s:.2g} (stated {value - off:.6g})"
        for name, value, s, off in zip(camera.parameter_names, lens.parameters, sigma, d, strict=True)
        if abs(off) > 2 * s and name != "fy"
    )
    return (
        f"the marks contradict the interior orientation of {camera.name} ({np.sqrt(square / k):.1f} times "
        f"what its sigmas and theirs allow): they want {changes or 'other parameters'}"
    )


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

    What is not to be estimated freely has the sigma of what lenses have (`guessed_lens`): held without one,
    28 points over a hillside gave focal lengths that were seven times their sigmas off.

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
    _refuse_beyond(marks, size_px, "State the size of the pictures in which the points were measured")
    known = _Known.of(marks, points, sigma_px, sigma_point_m)
    shown = sorted(known.tables.values(), key=len, reverse=True)
    # others than the first count if a pose can be had of them at all
    shown = [table for k, table in enumerate(shown[:_SEARCHED]) if k == 0 or len(table) >= LEAST_MARKS]

    def misfit(camera: Camera) -> float:
        """Mean over the pictures with the most points."""
        return float(np.mean([start_misfit_px(camera, table, known.field) for table in shown]))

    stated = [] if focal_px is None else [focal_px / max(size_px)]
    start = best_nominal("camera", "perspective", size_px, misfit, [*stated, *_SHARES])
    return guessed_lens(start, free)


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
