"""Photographs that another program has oriented, without a boat: their poses, judged by check points."""

import json
import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration import collinear, interior_calibration, read_camera, same_size
from thalweg.core import ArrayF, Camera, InputError, LocalFrame
from thalweg.core.calibration import Source, write_calibration
from thalweg.images.bundle import CONTROL_COLUMNS, statistics_of
from thalweg.images.control import frame_about, matched_marks, read_all_control_points, read_all_marks
from thalweg.images.imports import import_orientations
from thalweg.images.masks import size_of
from thalweg.images.model import ControlMarks, ControlPoints, ImagePoses, nearest_to_rays, unknown_poses
from thalweg.images.photographs import pose_table
from thalweg.ingest.photos import find_images, named_images
from thalweg.settings.sections import LOCAL, ControlSettings, FinishedOrientations

log = logging.getLogger("thalweg")
_AXES: Final = ("east", "north", "up")
_ITERATIONS: Final = 8
_SUSPECT: Final = 16.27
"""Chi-square of three degrees of freedom that one of 1000 exceeds."""
_SHARED: Final = 3.0
"""Independent values of check points: no file says how alike its poses err, so all may share one shift."""


def intersect_point(
    camera: Camera, poses: ImagePoses, rows: Sequence[int], xy_px: ArrayF, sigma_px: ArrayF
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """A point from its marks in images of known pose, by least squares.

    Poses of different images count as independent: an error that all of them share is in no covariance.

    Parameters
    ----------
    camera : interior orientation; its covariance is not carried.
    poses : of all images, with their covariances.
    rows : images that show the point, two or more.
    xy_px, sigma_px : (n, 2) and (n,) marks and their standard deviations.

    Returns
    -------
    point_wcs_m, cov_m2, residual_px : (3,), (3, 3), (n, 2) observed minus predicted.

    Raises
    ------
    InputError : rays that are parallel.
    """
    at = np.asarray(rows)
    R, C, first = poses.R_wcs_ccs[at], poses.centre_wcs_m[at], np.zeros(len(at), np.int64)
    point = nearest_to_rays(C, np.einsum("nij,nj->ni", R, camera.rays(xy_px)))
    if not np.isfinite(point).all():
        raise InputError("rays that do not meet", expected="images from different places")
    seen = collinear([camera], first, R, C, np.tile(point, (len(at), 1)))
    cov = seen.by_pose @ poses.cov_pose_wcs[at] @ np.swapaxes(seen.by_pose, 1, 2)
    W = np.linalg.inv(cov + np.square(sigma_px)[:, None, None] * np.eye(2))
    for _ in range(_ITERATIONS):
        J = seen.by_point
        N = np.einsum("nji,njk,nkl->il", J, W, J)
        step = np.linalg.solve(N, np.einsum("nji,njk,nk->i", J, W, xy_px - seen.xy_px))
        point = point + step
        seen = collinear([camera], first, R, C, np.tile(point, (len(at), 1)))
        if np.linalg.norm(step) < 1e-6:
            break
    return point, np.asarray(np.linalg.inv(N)), xy_px - seen.xy_px


def judge_points(
    camera: Camera, poses: ImagePoses, control: ControlPoints, marks: ControlMarks
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Surveyed points beside where finished orientations put them: all of them are check points.

    Parameters
    ----------
    camera, poses : of the images, in the order of ``marks.image``.
    control, marks : surveyed points and their marks.

    Returns
    -------
    table : as `thalweg.images.bundle.job.control_table`, differences in ``without_*`` and ``off_*``.
    facts : as its ``check_points``; empty without a point that two images show.
    """
    rows: list[dict[str, Any]] = []
    tests, offs, covs = [], [], []
    for k, name in enumerate(control.names):
        seen = np.flatnonzero((marks.point == k) & poses.oriented[marks.image])
        row: dict[str, Any] = {"point": name, "role": "check", "images": len(seen), "reason": ""}
        rows.append(row)
        row |= {"suspect": False}
        if len(seen) < 2:
            row |= {"role": "left out", "reason": f"a check point needs two images, it has {len(seen)}"}
            continue
        try:
            point, cov, residual = intersect_point(
                camera, poses, marks.image[seen].tolist(), marks.xy_px[seen], marks.sigma_px[seen]
            )
        except InputError as error:
            row |= {"role": "left out", "reason": error.found}
            continue
        off = point - control.points_wcs_m[k]
        cov = cov + control.cov_wcs_m2[k]
        test = float(off @ np.linalg.solve(cov, off))
        tests.append(test)
        offs.append(off)
        covs.append(cov)
        row |= {
            "rms_px": float(np.sqrt(np.mean(np.sum(residual**2, axis=1)))),
            "normalised": test / 3,
            "suspect": test > _SUSPECT,
        }
        for axis, value, variance in zip(_AXES, off, np.diag(cov), strict=True):
            row |= {f"{w}_{axis}_mm": 1e3 * value for w in ("off", "without")}
            row |= {f"sigma_{w}_{axis}_mm": 1e3 * math.sqrt(variance) for w in ("off", "without")}
    table = pd.DataFrame(rows, columns=CONTROL_COLUMNS)
    if not tests:
        return table, {}
    return table, statistics_of(np.array(offs), np.array(covs), np.array(tests), _SHARED)


def place_files(
    *,
    images: list[Path],
    control_points: list[Path],
    marks: list[Path],
    interior: list[Path],
    orientations: list[Path],
    folder: Path,
    campaign: dict[str, Any],
    finished: FinishedOrientations,
    control: ControlSettings,
) -> None:
    """Finished orientations of a campaign without a boat -> poses, lens and judged points in a folder.

    Written are ``finished.csv``, ``finished.parquet``, ``finished_camera.yaml``, ``finished_points.csv``,
    ``finished.json``.

    Parameters
    ----------
    images, control_points, marks, interior, orientations : files of ``logs.time_lapse``.
    campaign : ``id``, ``crs`` and ``origin``.
    finished, control : sections of ``images``.

    Raises
    ------
    InputError : files that cannot be read, no place on the earth for a map grid, or photographs of another
        size than the lens.
    GeometryError : photographs of another shape than the pictures of the lens.
    """
    crs = campaign["crs"]
    frame = _frame(campaign, control_points)
    files = named_images(find_images(images).files)
    names = tuple(files)
    settings = finished.model_dump(mode="json")
    if crs == LOCAL and settings["crs"] is None:
        settings["crs"] = "world"
    found = import_orientations(orientations, unknown_poses(frame, names), settings, crs=crs)
    lens = found.camera or (read_camera(interior[0]) if interior else None)
    if lens is not None and (sizes := sorted({size for path in files.values() if (size := size_of(path))})):
        # marks are measured in the photographs; a program may have worked with smaller or undistorted ones
        lens = lens.scaled(sizes[0])
        same_size(lens, sizes[-1])
    points = read_all_control_points(
        control_points, frame, crs=crs, sigma_m=control.sigma_m, height_offset_m=control.height_offset_m
    )
    observed, dropped = ControlMarks.none(), dict[str, int]()
    if marks and lens is not None:
        observed, dropped = matched_marks(
            read_all_marks(marks),
            points,
            names,
            [lens.size_px] * len(names),
            names,
            sigma_px=control.sigma_px,
            where=marks[0],
        )
    table, check = pd.DataFrame(columns=CONTROL_COLUMNS), dict[str, Any]()
    if lens is not None:
        table, check = judge_points(lens, found.poses, points, observed)
    folder.mkdir(parents=True, exist_ok=True)
    found.poses.write(folder / "finished.parquet")
    pose_table(found.poses, crs).to_csv(folder / "finished.csv", index=False, float_format="%.9g")
    table.to_csv(folder / "finished_points.csv", index=False, float_format="%.6g")
    if lens is None:
        (folder / "finished_camera.yaml").write_text("# No interior orientation: no file states one.\n")
    else:
        source = Source(run=str(campaign["id"]), method="imported with the poses, or from logs.time_lapse")
        write_calibration(folder / "finished_camera.yaml", interior_calibration(lens, source))
    facts = {**found.facts, "crs": crs, "check_points": check, "dropped_marks": dropped}
    sigma = np.sqrt(np.diagonal(found.poses.cov_pose_wcs[found.poses.oriented], axis1=1, axis2=2))
    typical = 1e3 * np.median(sigma[:, :3], axis=0)
    facts["sigma_position_mm"] = dict(zip(_AXES, typical.tolist(), strict=True))
    (folder / "finished.json").write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    for note in found.facts["notes"]:
        log.warning(note)


def _frame(campaign: Mapping[str, Any], control_points: Sequence[Path]) -> LocalFrame:
    if campaign["origin"] is not None:
        return LocalFrame(**campaign["origin"])
    return frame_about(control_points, crs=campaign["crs"])
