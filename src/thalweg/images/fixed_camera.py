"""Pictures of a camera that stays: from tables of marks and of control points to the history of its pose."""

import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pyproj import CRS

from thalweg.calibration import read_camera, resect_series
from thalweg.core import InputError
from thalweg.images.control import crs_of, frame_about, read_all_control_points, read_all_marks
from thalweg.settings import natural_order
from thalweg.settings.sections import LOCAL, ControlSettings, FixedCamera

log = logging.getLogger("thalweg")
AXES = ("x", "y", "z")


def resect_pictures(
    marks: Sequence[Path],
    control_points: Sequence[Path],
    camera: Path,
    *,
    crs: str = LOCAL,
    control: ControlSettings | None = None,
    largest_sigma_m: float = FixedCamera().largest_sigma_m,
) -> tuple[pd.DataFrame, pd.DataFrame, dict[str, Any]]:
    """Poses of pictures in which control points were measured, each for itself.

    Parameters
    ----------
    marks : tables as of `thalweg.images.read_marks`: one of all pictures, or one for each.
    control_points : tables as of `thalweg.images.read_control_points`.
    camera : calibration, COLMAP or OpenCV file of the interior orientation.
    crs : of coordinates ``x, y, z``; `LOCAL` for a frame of the surveyor's own. Results are in it, too.
    control : section ``images.control``; None: its defaults.
    largest_sigma_m : a place that is known worse is refused.

    Returns
    -------
    poses, residuals : see `resect_series`, pictures in natural order of their names.
    facts : see `history_facts`.

    Raises
    ------
    InputError, GeometryError : tables that cannot be read, a CRS that is no map grid, marks without control
        points, or no picture with a pose.
    """
    section = control or ControlSettings()
    frame = frame_about(control_points, crs=crs)
    grid = None if crs == LOCAL else crs_of(crs, control_points[0])
    if grid is not None and not grid.is_projected:
        raise InputError(f"the CRS {crs}", expected=f"a projected one, or {LOCAL}", cure="Give a map grid")
    points = read_all_control_points(
        control_points, frame, crs=crs, sigma_m=section.sigma_m, height_offset_m=section.height_offset_m
    )
    measured = read_all_marks(marks)
    table = pd.DataFrame(
        {
            "image": measured.image,
            "point": measured.point,
            "x_px": measured.xy_px[:, 0],
            "y_px": measured.xy_px[:, 1],
            "sigma_px": measured.sigma_px,
        }
    )[measured.used]
    order = {n: k for k, n in enumerate(sorted(set(table["image"]), key=lambda n: natural_order(Path(n))))}
    table = table.sort_values("image", key=lambda names: names.map(order), kind="stable")
    sigma = np.sqrt(np.diagonal(points.cov_wcs_m2, axis1=1, axis2=2))
    known = pd.DataFrame({"point": points.names, "check": points.check})
    known[list(AXES)] = points.points_wcs_m
    known[[f"sigma_{axis}_m" for axis in AXES]] = sigma
    poses, residuals = resect_series(
        read_camera(camera), table, known, sigma_px=section.sigma_px, largest_sigma_m=largest_sigma_m
    )
    if "x_m" not in poses:
        raise InputError(
            f"none of {len(poses)} pictures has a pose: {poses['refused'].iloc[0]}",
            expected="four control points in a picture, which are not near a line",
            cure="Measure more points; a larger images.fixed_camera.largest_sigma_m lets weak poses pass",
        )
    if grid is not None:
        rows = poses["x_m"].notna()
        columns = [f"{axis}_m" for axis in AXES]
        poses.loc[rows, columns] = frame.to_map(
            poses.loc[rows, columns].to_numpy(), CRS.from_user_input(grid)
        )
    facts = {"crs": crs, "strange_marks": int((~table["point"].isin(points.names)).sum())}
    return poses, residuals, facts | history_facts(poses)


def history_facts(poses: pd.DataFrame) -> dict[str, Any]:
    """What a series of poses says of a camera that should stay.

    Parameters
    ----------
    poses : of `resect_series`.

    Returns
    -------
    ``pictures``, ``with_pose``, ``refused`` (picture: reason); mean place ``x_m ...`` weighted by the marks;
    ``spread_m`` about it by axis and ``predicted_m`` by ``sigma_change``; ``normalised``: mean square of
    deviations over their standard deviations and ``degrees`` of freedom; ``sigma_m``: median of the whole
    standard deviation of a place; ``rms_px``.
    """
    good = poses[poses["refused"] == ""]
    place = good[[f"{axis}_m" for axis in AXES]].to_numpy(np.float64)
    change = good[[f"sigma_change_{axis}_m" for axis in AXES]].to_numpy(np.float64)
    weight = 1.0 / change**2
    mean = (weight * place).sum(axis=0) / weight.sum(axis=0)
    degrees = 3 * (len(good) - 1)
    off = (place - mean) / change

    def named(values: Any) -> dict[str, float]:
        """Three values under the names of their axes."""
        return dict(zip(AXES, np.asarray(values, float).tolist(), strict=True))

    return {
        "pictures": len(poses),
        "with_pose": len(good),
        "refused": {r.image: r.refused for r in poses.itertuples() if r.refused},
        "place_m": named(mean),
        "spread_m": named(place.std(axis=0, ddof=1)) if len(good) > 1 else None,
        "predicted_m": named(np.sqrt((change**2).mean(axis=0))),
        "sigma_m": named(np.median(good[[f"sigma_{axis}_m" for axis in AXES]].to_numpy(np.float64), axis=0)),
        "degrees": degrees,
        "normalised": float(np.sum(off**2) / degrees) if degrees else None,
        "rms_px": float(np.sqrt(np.mean(good["rms_px"] ** 2))),
    }


def resect_files(
    *,
    marks: list[Path],
    control_points: list[Path],
    interior: Path,
    poses: Path,
    residuals: Path,
    facts: Path,
    campaign: dict[str, Any],
    control: ControlSettings,
    largest_sigma_m: float,
) -> None:
    """The pictures of a fixed camera of a campaign -> tables of poses and residuals, and facts.

    Parameters
    ----------
    campaign : ``crs``.
    control : section ``images.control``.
    """
    found, left, told = resect_pictures(
        marks, control_points, interior, crs=campaign["crs"], control=control, largest_sigma_m=largest_sigma_m
    )
    found.to_csv(poses, index=False)
    left.to_csv(residuals, index=False, float_format="%.3f")
    facts.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    for name, reason in told["refused"].items():
        log.warning("%s: no pose: %s", name, reason)
