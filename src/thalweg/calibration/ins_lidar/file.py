"""What goes into the calibration of a run, and its result as files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.calibration import FORM_SIGMA_M, fit_reference, parameter_cov, read_poses
from thalweg.calibration.camera_lidar import Statics, cone_references
from thalweg.calibration.field import FieldDescription, FieldPoints
from thalweg.calibration.ins_lidar.adjustment import InsLidar
from thalweg.calibration.ins_lidar.antenna import AntennaLever, antenna_lever, check_nominal, phase_centre
from thalweg.calibration.ins_lidar.run_points import FieldCones
from thalweg.core import ArrayF, GeometryError, InputError, Rigid, read_marked, write_marked
from thalweg.core.calibration import Calibration, Source, pose_block, read_calibration, write_calibration

KIND: Final = "thalweg lidar mount"
VERSION: Final = 1

BLIND: Final = (
    "marker %d of the antenna is not used: it needs logs.calibration.position_images and position_scans; the "
    "place of the lidar relative to the antenna comes from GNSS alone"
)
"""Warning about an antenna's marker without a camera."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MountResult:
    """What a run found, as `read_mount_result` returns it.

    ``T_ics_scs`` with consistent covariance; ``by_antenna`` (6, 3); ``antenna`` as it entered, or None;
    ``lever_ics_antenna_m`` (3,) that defines ics; ``facts``: numbers for people.
    """

    T_ics_scs: Rigid
    by_antenna: ArrayF
    antenna: AntennaLever | None
    lever_ics_antenna_m: ArrayF
    facts: Mapping[str, Any]


def field_cones(
    field: FieldDescription, points: FieldPoints, *, form_sigma_m: float = FORM_SIGMA_M
) -> tuple[FieldCones, dict[str, str]]:
    """The cones of a field as fitted to their marks, and those that could not be, with the reason.

    Their covariance is a joint one: marks of different cones were measured in the same pictures.

    Parameters
    ----------
    field, points : description and measured marks with their joint covariance.
    form_sigma_m : how far the cones are from perfect ones, one sigma.

    Raises
    ------
    InputError : no cone has enough marks.
    """
    names, cones, lengths, parts, refused = [], [], [], [], {}
    references = cone_references(field, points, form_sigma_m=form_sigma_m)
    marks = Statics(images=(), poses=(), points=points, cov=points.cov, lost={}).errors(field, ())
    for reference in references:
        try:
            fit = fit_reference(reference)
        except GeometryError as error:
            refused[reference.name] = str(error)
            continue
        names.append(reference.name)
        cones.append(fit.cone)
        lengths.append(reference.length_m)
        part = np.zeros((6, len(marks.cov)))
        part[:, marks.rows_of(0, reference.name, np.ones_like(fit.used))] = fit.by_points
        parts.append(part)
    if not cones:
        raise InputError(
            "no cone of the field has a reference: " + "; ".join(refused.values()),
            expected="cones with measured marks",
            cure="Take more pictures of the cones",
        )
    cov = parameter_cov(np.concatenate(parts), marks.cov, form_sigma_m)
    found = FieldCones(names=tuple(names), cones=tuple(cones), length_m=np.array(lengths), cov=cov)
    return found, refused


def field_antenna(
    field: FieldDescription, points: FieldPoints, poses: Mapping[str, Rigid], position: str, T_ccs_scs: Rigid
) -> AntennaLever | None:
    """The antenna seen from the sensors, by its marker in the bundle; None if the field describes none.

    The marker and the pose both come from the points of the field and share their errors. The table of poses
    does not hold how a pose depends on these points, so they count as independent. On a simulated field of
    six cones this states 1.13, 0.39, 0.48 mm for the antenna in scs instead of 1.07, 0.29, 0.40 mm with the
    covariance of both: too much rather than too little, and 1.0 mm is the phase centre's height alone.

    Parameters
    ----------
    field, points : with the antenna's marker, measured while the boat stood at a position.
    poses : ``T_pcs_ccs`` by picture.
    position : picture of that position, with or without its suffix.
    T_ccs_scs : relative orientation of the lidar.

    Raises
    ------
    InputError : the marker was not measured, or the picture has no pose.
    """
    if field.antenna is None:
        return None
    rows = [points.index.get((field.antenna.marker, corner)) for corner in range(4)]
    if any(row is None for row in rows):
        raise InputError(
            f"marker {field.antenna.marker} of the antenna was not measured",
            expected="all four saddles of it among the points of the field",
            cure=f"Photograph the boat at {position} from above, with the antenna and the field around it",
        )
    at = np.array(rows, dtype=np.int64)
    found = [T for name, T in poses.items() if Path(name).stem == Path(position).stem]
    if len(found) != 1:
        raise InputError(
            f"{len(found)} poses of a picture {position}",
            expected="the pose of the camera while the antenna was photographed",
            cure="Name the position at which the boat stood when its antenna was photographed",
        )
    mark = phase_centre(
        points.points_pcs[at],
        points.cov_of(at),
        offset_m=field.antenna.offset_m,
        sigma_offset_m=field.antenna.sigma_m,
    )
    return antenna_lever(mark, found[0], T_ccs_scs)


def seen_antenna(
    field: FieldDescription,
    points: FieldPoints,
    mounts: Mapping[str, Mapping[str, Any]],
    poses: Sequence[Path],
    camera_lidar: Sequence[Path],
    position: str,
) -> AntennaLever | None:
    """The antenna by its marker, checked against its lever arm.

    None if the field describes no such marker, or if the boat has no camera: nothing says then where the
    marker lies to the lidar, and the lever arm comes from GNSS alone.

    Parameters
    ----------
    field, points, position : see `field_antenna`.
    mounts : nominal places of ``lidar`` and ``antenna``.
    poses, camera_lidar : table of poses, and calibration with ``camera_lidar``; one file each or none.

    Raises
    ------
    InputError : see `field_antenna`.
    GeometryError : the marker lies elsewhere, see `thalweg.calibration.ins_lidar.antenna.check_nominal`.
    """
    if field.antenna is None or not poses or not camera_lidar:
        return None
    relative = read_calibration(camera_lidar[0]).pose("camera_lidar")
    seen = field_antenna(field, points, read_poses(poses[0])[1], position, relative)
    if seen is not None:
        check_nominal(seen, mounts["lidar"], mounts["antenna"], marker=field.antenna.marker)
    return seen


def write_mount_result(
    path: Path, found: InsLidar, antenna: AntennaLever | None, lever_ics_antenna_m: Sequence[float] | ArrayF
) -> None:
    """Write what `read_mount_result` reads, and the numbers that a report needs."""
    T = found.T_ics_scs
    errors = found.errors
    content = {
        "T_ics_scs": {"matrix": T.matrix.tolist(), "cov": T.cov.tolist()},
        "cov_formal": found.cov_formal.tolist(),
        "by_antenna": found.by_antenna.tolist(),
        "antenna": None
        if antenna is None
        else {name: np.asarray(getattr(antenna, name)).tolist() for name in AntennaLever.__slots__},
        "lever_ics_antenna_m": [float(value) for value in lever_ics_antenna_m],
        "facts": {
            "points": found.n_points,
            "redundancy": found.redundancy,
            "sigma0": found.sigma0,
            "dropped": found.dropped,
            "sigma_position_m": errors.sigma_position_m.tolist(),
            "sigma_attitude_deg": np.rad2deg(errors.sigma_attitude_rad).tolist(),
            "position_time_s": float(errors.position_time_s),
            "attitude_time_s": float(errors.attitude_time_s),
            "heading_time_s": float(errors.times_s[5]),
            "white_share": float(errors.white_share),
            "processes": {} if found.processes is None else found.processes.facts(),
            "sigma_along_m": found.noise.along_m,
            "sigma_across_m": found.noise.across_m,
            "parameters": found.summary().to_dict("records"),
        },
    }
    write_marked(path, kind=KIND, version=VERSION, content=content)


def write_calibrated(path: Path, found: InsLidar, run: str) -> None:
    """Write the mount of the lidar as a calibration file."""
    block, cov = pose_block("lidar", found.T_ics_scs)
    source = Source(
        run=run, method="cones from the moving boat", observations=found.n_points, sigma0=found.sigma0
    )
    write_calibration(path, Calibration(title="Lidar on the boat", blocks=(block,), cov=cov, source=source))


def write_tables(found: InsLidar, *, passes: Path, before: Path, after: Path) -> None:
    """Write the points used in each pass, and those near the cones before and after (T Fig. 3.1)."""
    found.passes.to_csv(passes, index=False, float_format="%.3f")
    found.cone_points("start").to_parquet(before, index=False)
    found.cone_points("calibrated").to_parquet(after, index=False)


def read_mount_result(path: Path) -> MountResult:
    """Read what `write_mount_result` wrote.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    document = read_marked(
        path, kind=KIND, version=VERSION, what="lidar mount", cure="Evaluate the run about the cones again"
    )
    try:
        place, given = document["T_ics_scs"], document["antenna"]
        return MountResult(
            T_ics_scs=Rigid.from_matrix(np.array(place["matrix"]), np.array(place["cov"])),
            by_antenna=np.array(document["by_antenna"]),
            antenna=None if given is None else AntennaLever(**{k: np.array(v) for k, v in given.items()}),
            lever_ics_antenna_m=np.array(document["lever_ics_antenna_m"]),
            facts=document["facts"],
        )
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"no lidar mount ({error!r})", expected=f"{KIND}, version {VERSION}", where=path
        ) from error
