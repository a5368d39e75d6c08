"""What the camera-lidar calibration reads: cones of the field, static scans, and what their errors share."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.calibration import FORM_SIGMA_M, ConeReference, Position, mark_name
from thalweg.calibration.camera_lidar.model import FieldErrors
from thalweg.calibration.field import FieldDescription, FieldNetwork, FieldPoints
from thalweg.core import AnyArray, ArrayF, InputError, Rigid, parse_json
from thalweg.ingest import LidarReader
from thalweg.ingest.photos import list_images, natural_key
from thalweg.settings.sections import LidarAccuracy

CAPTURES: Final = (".pcap", ".pcapng", ".cap", ".bin", ".vel")
"""Suffixes of lidar recordings in a folder."""

KIND: Final = "thalweg static positions"
VERSION: Final = 1
_SINGULAR_M: Final = 1e-6
"""Added to each coordinate, as in the bundle: a free network has no error along its datum."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statics:
    """Poses of pictures and points of the field from one adjustment.

    Parameters
    ----------
    images : (n,) names of the pictures.
    poses : (n,) ``T_pcs_ccs`` with their own covariance.
    points : the field as adjusted; (m) saddles.
    cov : (6n + 3m, 6n + 3m) joint covariance: shift and rotation vector in pcs of each pose, then the
        coordinates of each point.
    lost : pictures that were asked for and have no pose, with the reason.
    """

    images: tuple[str, ...]
    poses: tuple[Rigid, ...]
    points: FieldPoints
    cov: ArrayF
    lost: Mapping[str, str]

    def errors(self, field: FieldDescription, images: Sequence[str]) -> FieldErrors:
        """Joint errors of some poses and of the marks on the cones, as `calibrate_camera_lidar` takes them.

        Parameters
        ----------
        field : description with the cones.
        images : pictures of the static positions, in their order.
        """
        at = [_of_cone(self.points, cone.markers) for cone in field.cones]
        poses = [6 * self.images.index(image) + np.arange(6) for image in images]
        rows = np.concatenate([*poses, 6 * len(self.images) + _triples(np.concatenate(at))])
        counts = {c.name: len(k) for c, k in zip(field.cones, at, strict=True)}
        return FieldErrors(cov=self.cov[np.ix_(rows, rows)], points=counts)


# ---------------------------------------------------------------- input


def cone_references(
    field: FieldDescription, points: FieldPoints, *, form_sigma_m: float = FORM_SIGMA_M
) -> list[ConeReference]:
    """Cones of a field with their measured marks; a cone without a mark has no points.

    Parameters
    ----------
    field, points : description and measured marks.
    form_sigma_m : how far the cones are from perfect ones, one sigma.

    Raises
    ------
    InputError : the field has no cones.
    """
    if not field.cones:
        raise InputError(
            "the description of the field names no cones",
            expected="a list `cones` with names, markers, half_angle_deg, length_m",
            cure="Add the cones, or calibrate with a board",
        )
    out = []
    for cone in field.cones:
        at = _of_cone(points, cone.markers)
        out.append(
            ConeReference(
                name=cone.name,
                points_m=points.points_pcs[at],
                cov=points.cov_of(at),
                half_angle_rad=cone.half_angle_rad,
                length_m=cone.length_m,
                labels=tuple(mark_name(*points.points[i]) for i in at),
                form_sigma_m=form_sigma_m,
            )
        )
    return out


def read_position(name: str, T_pcs_ccs: Rigid, reader: LidarReader, beam_errors: LidarAccuracy) -> Position:
    """A static position from its lidar recording.

    Parameters
    ----------
    name : of the position.
    T_pcs_ccs : exterior orientation of the camera.
    reader : recording of the position.
    beam_errors : accuracy of the scanner.

    Raises
    ------
    InputError : no points in the recording.
    """
    points, reflectivity, _ = read_scan(reader)
    return Position.measured(name, T_pcs_ccs, points, beam_errors, reflectivity)


def read_scan(reader: LidarReader) -> tuple[ArrayF, ArrayF, AnyArray]:
    """All points (n, 3) of a recording in scs, their reflectivities (n,) and rings (n,).

    A static scan needs no GPS time; a recording without a locked clock does as well.
    """
    blocks = list(reader.points())
    if not blocks:
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64)
    names = ("xyz_scs_m", "intensity", "ring")
    xyz, reflectivity, ring = (np.concatenate([getattr(b, name) for b in blocks]) for name in names)
    return xyz.astype(np.float64), reflectivity.astype(np.float64), ring


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairs:
    """Capture file and picture of each static position, by its name; and what has no counterpart and why."""

    pairs: dict[str, tuple[Path, str]]
    left_out: dict[str, str]


def static_positions(scans: Sequence[Path], images: Sequence[str]) -> Pairs:
    """Capture files and pictures that belong together.

    They do if their names are the same but for the suffix; if no names are, and there are as many of one as
    of the other, in their order. A picture without a recording takes no part, and is named.

    Parameters
    ----------
    scans : capture files, or folders of them.
    images : names of the pictures that were taken at static positions, in order.

    Raises
    ------
    InputError : no scans, two of one name, or a scan without a picture.
    """
    files = [f for path in scans for f in (_in_order(path) if path.is_dir() else [path])]
    files = [f for f in files if f.suffix.lower() in CAPTURES]
    if not files:
        raise InputError(
            f"no capture files in {', '.join(map(str, scans)) or 'an empty list'}",
            expected=f"one lidar recording a static position ({', '.join(CAPTURES)})",
            cure="Set logs.calibration.position_scans",
        )
    _require_names([f.name for f in files], "lidar recordings", "position_scans")
    _require_names(images, "pictures", "position_images")
    by_stem = {Path(image).stem: image for image in images}
    if not any(f.stem in by_stem for f in files):
        if len(files) != len(images):
            raise InputError(
                f"{len(files)} lidar recordings ({', '.join(f.name for f in files)}) and {len(images)} "
                f"pictures ({', '.join(images) or 'none'}) of static positions, none of one name",
                expected="the same name for recording and picture, or as many of one as of the other",
                cure="Give each picture the name of its recording, or leave out what has no counterpart in "
                "logs.calibration.position_scans and position_images",
            )
        by_stem = {f.stem: image for f, image in zip(files, images, strict=True)}
    missing = [f.name for f in files if f.stem not in by_stem]
    if missing:
        raise InputError(
            f"no picture for {', '.join(missing)} among {', '.join(images) or 'none'}",
            expected="a picture of the same name for each lidar recording, or as many of one as of the other",
            cure="Set logs.calibration.position_images, or leave these recordings out",
        )
    pairs = {f.stem: (f, by_stem[f.stem]) for f in files}
    have = {image for _, image in pairs.values()}
    alone = {image: "no lidar recording has its name" for image in images if image not in have}
    return Pairs(pairs=pairs, left_out=alone)


def oriented(pairs: Pairs, statics: Statics) -> tuple[dict[str, tuple[Path, str]], dict[str, str]]:
    """Positions whose picture has a pose, and everything that takes no part with the reason.

    Raises
    ------
    InputError : no position is left.
    """
    good = {name: pair for name, pair in pairs.pairs.items() if pair[1] in statics.images}
    left_out = dict(pairs.left_out)
    for name, (file, image) in pairs.pairs.items():
        if name not in good:
            why = statics.lost.get(image, "it was not among the pictures that were oriented")
            left_out[image] = f"it has no pose, and {file.name} takes no part: {why}"
    if not good:
        told = "; ".join(f"{image}: {why}" for image, why in left_out.items())
        raise InputError(
            f"none of {len(pairs.pairs)} static positions can be used ({told})",
            expected="a picture with a pose for one lidar recording or more",
            cure="Record the positions again so that the camera sees more markers of the field",
        )
    return good, left_out


def static_images(images: Sequence[Path]) -> list[str]:
    """Names of the pictures of static positions, in their order.

    Parameters
    ----------
    images : files, or folders of them.

    Raises
    ------
    InputError : a file or folder does not exist, or a folder is without pictures.
    """
    return [path.name for path in dict.fromkeys(list_images(images))]


def nominal_orientation(mounts: Mapping[str, Any]) -> Rigid:
    """``T_ccs_scs`` by the sections ``mounts.camera`` and ``mounts.lidar``, without covariance."""

    def mount(section: Mapping[str, Any]) -> Rigid:
        """``T_ics_sensor`` of one section."""
        angles = np.deg2rad([float(section[f"{a}_deg"]) for a in ("omega", "phi", "kappa")])
        return Rigid.from_opk(angles, section["lever_ics_m"])

    return mount(mounts["camera"]).inverse() @ mount(mounts["lidar"])


def _require_names(names: Sequence[str], what: str, setting: str) -> None:
    """Refuse two files of one name: which of them belongs to the other kind cannot be told."""
    stems = Counter(Path(name).stem for name in names)
    twice = [name for name in names if stems[Path(name).stem] > 1]
    if twice:
        raise InputError(
            f"{what} of static positions with the same name: {', '.join(twice)}",
            expected="a name of its own for each position",
            cure=f"Rename them, or leave all but one out of logs.calibration.{setting}",
        )


def _in_order(folder: Path) -> list[Path]:
    """Entries of a folder as people count, like the pictures that may be matched with them by order."""
    return sorted(folder.iterdir(), key=lambda path: natural_key(path.name))


def _of_cone(points: FieldPoints, markers: Sequence[int]) -> AnyArray:
    return np.array([i for i, (m, _) in enumerate(points.points) if m in markers], dtype=np.int64)


# ---------------------------------------------------------------- poses of static positions and points of the
# field out of one bundle
#
# The pictures of the static positions help to calibrate the boat's camera and to refine the points of the
# field, and the poses come from the same marks. Taken as independent, these marks would be used twice, and
# the sigmas of what follows come out too small. So the camera-lidar adjustment starts from a block of one
# solution: the adjusted poses and points of `thalweg.calibration.camera.orient_on_field`, with
# all that they share.
#
# Points ``u`` of the field that no picture of the boat's camera shows are not in that bundle, but they hang
# together with those that are (``s``). With ``C`` the covariance of the field before, ``x`` and ``Q`` the
# bundle's values and covariance after::
#
#     x_u = x_u0 + G (x_s - x_s0),   G = C_us C_ss^-1
#     Q_u = C_uu - G C_su + G Q_s G^T,   Q_(u, pose) = G Q_(s, pose)
#
# That is what the bundle would give with these points among its unknowns.


def statics_of(network: FieldNetwork, field: FieldPoints, images: Sequence[str]) -> Statics:
    """Poses and points of an adjusted bundle of the boat's camera.

    Parameters
    ----------
    network : as `thalweg.calibration.camera.orient_on_field` gives it.
    field : the points that it started from.
    images : pictures of the static positions; those without a pose are listed with the reason.
    """
    names, cov = tuple(network.poses), network.adjusted.cov
    oriented = tuple(image for image in images if image in network.poses)
    reasons = {str(r.name): str(r.reason) for r in network.rejected.itertuples() if r.what == "image"}
    lost = {
        i: reasons.get(i, "no markers of the field were found in it") for i in images if i not in oriented
    }
    index = field.index
    old = np.array([index[point] for point in network.points], np.int64)
    new = np.array(sorted(set(range(len(field.points))) - set(old.tolist())), np.int64)
    poses = [np.arange(6) + network.layout.pose(names.index(i)).start for i in oriented]
    known = np.concatenate([*poses, network.layout.points + np.arange(3 * len(old))]).astype(np.int64)
    Q = cov[np.ix_(known, known)]
    s, u = _triples(old), _triples(new)
    before = field.cov[np.ix_(s, s)] + np.eye(len(s)) * _SINGULAR_M**2
    G = np.linalg.solve(before, field.cov[np.ix_(s, u)]).T
    n = 6 * len(oriented)
    # [poses, s, u] from [poses, s], then into the order of the field
    B = np.zeros((n + len(s) + len(u), len(known)))
    B[: len(known)] = np.eye(len(known))
    B[len(known) :, n:] = G
    whole = B @ Q @ B.T
    whole[len(known) :, len(known) :] += field.cov[np.ix_(u, u)] - G @ field.cov[np.ix_(s, u)]
    place = np.concatenate([np.arange(n), n + s, n + u])
    joint = np.empty_like(whole)
    joint[np.ix_(place, place)] = (whole + whole.T) / 2
    xyz = field.points_pcs.copy()
    change = (network.points_pcs - field.points_pcs[old]).ravel()
    xyz[old] = network.points_pcs
    xyz[new] += (G @ change).reshape(-1, 3)
    return Statics(
        images=oriented,
        poses=tuple(network.poses[i] for i in oriented),
        points=FieldPoints(points=field.points, points_pcs=xyz, cov=joint[n:, n:]),
        cov=joint,
        lost=lost,
    )


def write_statics(path: Path, statics: Statics) -> None:
    """Write what `read_statics` reads (NumPy archive)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    matrices = [T.matrix for T in statics.poses]
    with path.open("wb") as file:
        np.savez(
            file,
            kind=np.array(f"{KIND} {VERSION}"),
            images=np.array(json.dumps(list(statics.images))),
            lost=np.array(json.dumps(dict(statics.lost))),
            poses=np.array(matrices).reshape(-1, 4, 4),
            points=np.array(statics.points.points, np.int64).reshape(-1, 2),
            points_pcs=statics.points.points_pcs,
            cov=statics.cov,
        )


def read_statics(path: Path) -> Statics:
    """Read what `write_statics` wrote.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    expected = f"{KIND}, version {VERSION}, as the orientation of the boat's camera writes it"
    if not path.is_file():
        raise InputError("file not found", expected=expected, where=path)
    try:
        with np.load(path, allow_pickle=False) as stored:
            part = {name: stored[name] for name in stored.files}
        kind, images, lost = (str(part[name]) for name in ("kind", "images", "lost"))
        names, reasons, cov = tuple(parse_json(images, path)), parse_json(lost, path), part["cov"]
        points = tuple((int(m), int(c)) for m, c in part["points"])
        n = 6 * len(names)
        poses = tuple(
            Rigid.from_matrix(T, cov[6 * k : 6 * k + 6, 6 * k : 6 * k + 6])
            for k, T in enumerate(part["poses"])
        )
        known = FieldPoints(points=points, points_pcs=part["points_pcs"], cov=cov[n:, n:])
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise InputError(f"no static positions ({error!r})", expected=expected, where=path) from error
    size = n + 3 * len(points)
    if kind != f"{KIND} {VERSION}" or cov.shape != (size, size) or len(poses) != len(names):
        raise InputError(
            f"'{kind}' with {len(names)} pictures and a covariance of {cov.shape}",
            expected=expected,
            where=path,
        )
    return Statics(images=names, poses=poses, points=known, cov=cov, lost=reasons)


def _triples(at: AnyArray) -> AnyArray:
    """Places of the coordinates of points."""
    return (3 * np.asarray(at, np.int64).ravel()[:, None] + np.arange(3)).ravel()
