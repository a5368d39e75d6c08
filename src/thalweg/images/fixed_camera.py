"""Pictures of a camera that stays: from tables of marks and of control points to the history of its pose."""

import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pyproj import CRS

from thalweg.calibration import guessed_lens, nominal_camera, read_camera, resect_series, starting_lens
from thalweg.core import WGS84, Camera, InputError
from thalweg.images.control import frame_about, map_grid, read_all_control_points, read_all_marks
from thalweg.images.masks import size_of
from thalweg.images.sfm import focal_from_exif
from thalweg.ingest.photos import read_head
from thalweg.settings import natural_order
from thalweg.settings.sections import LOCAL, ControlSettings, FixedCamera

log = logging.getLogger("thalweg")
AXES = ("x", "y", "z")
_TOLD = 0.5
"""Sigma of a parameter over what it was before, below which the points tell it."""


def resect_pictures(
    marks: Sequence[Path],
    control_points: Sequence[Path],
    camera: Path | None,
    *,
    crs: str = LOCAL,
    control: ControlSettings | None = None,
    settings: FixedCamera | None = None,
    free: Sequence[str] = (),
    size_px: tuple[int, int] | None = None,
    photograph: Path | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame, dict[str, Any], Camera]:
    """Poses of pictures in which control points were measured, each for itself, or with the lens they share.

    Parameters
    ----------
    marks : tables as of `thalweg.images.read_marks`: one of all pictures, or one for each.
    control_points : tables as of `thalweg.images.read_control_points`.
    camera : calibration, COLMAP or OpenCV file of the interior orientation; None: what is ``free`` is
        estimated, see `starting_lens`.
    crs : of coordinates ``x, y, z``; `LOCAL` for a frame of the surveyor's own. Results are in it, too.
    control : section ``images.control``; None: its defaults.
    settings : section ``images.fixed_camera``; None: its defaults.
    free : what to estimate of the lens, as of `free_of_lens`.
    size_px, photograph : of a camera without a file: width and height, or a photograph that tells them and by
        EXIF the focal length to begin with; None: the pictures themselves, if they lie beside their marks.

    Returns
    -------
    poses, residuals, camera : see `resect_series`, pictures in natural order of their names.
    facts : see `history_facts`; of an estimated lens its ``lens`` (parameter: value and sigma), too.

    Raises
    ------
    InputError, GeometryError : tables that cannot be read, a CRS that is no map grid, marks without control
        points, no picture with a pose, no lens, or points that do not tell what is free of it.
    """
    if camera is None and not free:
        raise InputError(
            "no interior orientation",
            expected="a file of the camera, or what is to be estimated of it",
            cure="Name one with --camera, or estimate it from the points with --free focal or focal,k1",
        )
    section, settings = control or ControlSettings(), settings or FixedCamera()
    frame = frame_about(control_points, crs=crs)
    grid = None if crs == LOCAL else map_grid(crs, control_points[0])
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
    notes = []
    if camera is None:
        size, focal_px = _size_and_focal(marks[0].parent, [*order], size_px, photograph)
        start = starting_lens(table, known, size, free=free, focal_px=focal_px, sigma_px=section.sigma_px)
        stated = f" (EXIF states {focal_px:.0f} px)" if focal_px else ""
        notes.append(
            f"Lens: begun with a focal length of {start.parameters[0]:.0f} px, by which the points fit best"
            f"{stated}; what is not free counts with what lenses have (centre 1 % of the longer side, "
            "k1 and k2 0.1 about 0)"
        )
    else:
        start = read_camera(camera)
        shown = next((px for name in order if (px := size_of(marks[0].parent / name))), start.size_px)
        if shown != start.size_px:
            notes.append(
                f"Pictures beside the marks have {shown[0]} x {shown[1]} pixels, the lens is of "
                f"{start.size_px[0]} x {start.size_px[1]}: marks count as measured in pictures of that size"
            )
    poses, residuals, lens, told = resect_series(
        start,
        table,
        known,
        sigma_px=section.sigma_px,
        largest_sigma_m=settings.largest_sigma_m,
        interior=settings.interior,
        free=free,
    )
    notes += told
    if "x_m" not in poses:
        raise InputError(
            f"none of {len(poses)} pictures has a pose: {poses['refused'].iloc[0]}",
            expected="four control points in a picture, which are not near a line",
            cure=". ".join(
                [
                    *told,
                    "Measure more points; a larger images.fixed_camera.largest_sigma_m lets weak poses pass",
                ]
            ),
        )
    if grid is not None:
        rows = poses["x_m"].notna()
        columns = [f"{axis}_m" for axis in AXES]
        poses.loc[rows, columns] = frame.to_map(
            poses.loc[rows, columns].to_numpy(), CRS.from_user_input(grid)
        )
        if frame.ellipsoid != WGS84:
            notes.append(
                f"Points and results stay in the datum of {grid.name}: nothing is transformed to that of GNSS"
            )
    strange = int((~table["point"].isin(points.names)).sum())
    if strange:
        notes.append(f"{strange} marks show points without coordinates: left out")
    facts = {"crs": crs, "notes": notes, "lens": {}}
    if free or not np.array_equal(lens.parameters, start.parameters):
        guess, found = (np.sqrt(np.diag(c.cov)) for c in (guessed_lens(start, free), lens))
        facts["lens"] = {
            name: {"value": float(lens.parameters[k]), "sigma": float(found[k])}
            for k, name in enumerate(lens.parameter_names)
            if found[k] > 0 and (guess[k] == 0 or found[k] < _TOLD * guess[k])
        }
    return poses, residuals, facts | history_facts(poses), lens


def _size_and_focal(
    folder: Path, names: Sequence[str], size_px: tuple[int, int] | None, photograph: Path | None
) -> tuple[tuple[int, int], float | None]:
    """Size of the pictures and focal length by EXIF (None: not stated), as told or found beside the marks.

    Raises
    ------
    InputError : nothing tells the size, or a file is no photograph.
    GeometryError : the sides of the photograph have another ratio than the size stated.
    """
    if photograph is None and size_px is None:
        photograph = next((p for name in names if size_of(p := folder / name)), None)
    if photograph is None:
        if size_px is None:
            raise InputError(
                "a lens to be estimated for pictures of an unknown size",
                expected="their width and height",
                cure="State it, as --size 6000x4000 (in a campaign images.fixed_camera.size_px), or name "
                "one of the pictures with --photograph",
            )
        return size_px, None
    head, focal_px = read_head(photograph), focal_from_exif(photograph)
    size = (head.width, head.height)
    if size_px is None:
        return size, focal_px
    # points may have been measured in pictures of another size than this one
    scaled = nominal_camera(photograph.name, "perspective", size, focal_px or max(size)).scaled(size_px)
    return size_px, float(scaled.parameters[0]) if focal_px else None


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
    interior: list[Path],
    poses: Path,
    residuals: Path,
    facts: Path,
    campaign: dict[str, Any],
    control: ControlSettings,
    settings: FixedCamera,
) -> None:
    """The pictures of a fixed camera of a campaign -> tables of poses and residuals, and facts.

    Parameters
    ----------
    interior : file of the lens; none: the points tell what ``fixed_camera.free`` says.
    campaign : ``crs``.
    control, settings : sections ``images.control`` and ``images.fixed_camera``.
    """
    found, left, told, _ = resect_pictures(
        marks,
        control_points,
        next(iter(interior), None),
        crs=campaign["crs"],
        control=control,
        settings=settings,
        free=() if interior else settings.free,
        size_px=settings.size_px,
    )
    found.to_csv(poses, index=False)
    left.to_csv(residuals, index=False, float_format="%.3f")
    facts.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    for name, reason in told["refused"].items():
        log.warning("%s: no pose: %s", name, reason)
    for note in told["notes"]:
        log.warning(note)
