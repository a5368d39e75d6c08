"""Finished orientations of other programs as poses of the campaign's images.

Each file is read in its own frame (`thalweg.images.imports.source`), its names are matched to the
images, its poses are put into wcs (`finished_frames`) and compared with the predicted ones
(`finished_checks`). Errors that the file does not state come from the settings; neighbours' errors are
correlated by a stated share, for which a file has no place::

    cov(k, k+1) = rho S_k S_{k+1},      S S = cov
"""

import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyproj import CRS
from scipy.spatial.transform import Rotation

from thalweg.core import (
    COLMAP_MODELS,
    ArrayB,
    ArrayF,
    ArrayI,
    Camera,
    GeometryError,
    InputError,
    LocalFrame,
    ThalwegError,
    robust_sigma,
)
from thalweg.images.imports.formats import read_angles_table, read_metashape
from thalweg.images.imports.source import (
    Finished,
    Place,
    between_frames,
    ccs_rotations,
    changes,
    conventions,
    orthogonal,
    place_of,
    to_world,
    world_axes,
    world_positions,
)
from thalweg.images.model import (
    LEAST_IMAGES,
    ImagePoses,
    align,
    angles_between,
    check_share,
    comparable,
    matched,
    mean_rotation,
    predicted_sigmas,
)
from thalweg.images.sfm import colmap, from_colmap

NOT_IN_FILE: Final = "not in the files of finished orientations"
UNCHECKED: Final = "No image has a prediction: the poses could not be checked against it"
CURE_FREE: Final = (
    "Put the model into the world with control points in its own program and name its CRS in "
    "images.finished.crs, "
    "or give images and control points to Thalweg's own adjustment, or accept the errors of the "
    "prediction with "
    "images.finished.align: predictions"
)
_NUMBERS: Final = {
    0: "SIMPLE_PINHOLE", 1: "PINHOLE", 2: "SIMPLE_RADIAL", 3: "RADIAL", 4: "OPENCV", 5: "OPENCV_FISHEYE",
    6: "FULL_OPENCV", 7: "FOV", 8: "SIMPLE_RADIAL_FISHEYE", 9: "RADIAL_FISHEYE", 10: "THIN_PRISM_FISHEYE",
    11: "RAD_TAN_THIN_PRISM_FISHEYE",
}  # fmt: skip
_COUNTS: Final = {"FOV": 5, "THIN_PRISM_FISHEYE": 12, "RAD_TAN_THIN_PRISM_FISHEYE": 16}
_POSE: Final = struct.Struct("<i7di")
_CAMERA: Final = struct.Struct("<iiQQ")
_POINT_BYTES: Final = 24
_NOTHING: Final = 2**64 - 1
_MOST: Final = 10_000_000
Pose = tuple[str, int, list[float], int]
"""Name, number of the camera, quaternion (w, x, y, z) and translation, tie points."""

_SIGMAS: Final = 4.0
_BETTER: Final = 0.25
"""A reading of the angles that leaves less than this share of the angle is the right one."""
_SUSPECT_RAD: Final = np.deg2rad(3.0)
"""Median angle below which no other reading is looked for."""
_GEOID_M: Final = (15.0, 110.0)
"""Heights of geoids above the ellipsoid are within +-107 m; below 15 m other causes are likelier."""
_LEVEL_M: Final = 3.0
_ALIKE_M: Final = 1.0
_NORTH: Final = ("grid", "true")
_UTM: Final = ((32601, 32660), (32701, 32760), (25828, 25838))
"""EPSG codes of zones of UTM that lie beside each other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Predicted:
    """Predictions of some images, (n, 3) and (n, 3, 3) in wcs, their sigmas, and the limits of belief."""

    frame: LocalFrame
    centre_wcs_m: ArrayF
    R_wcs_ccs: ArrayF
    sigma_m: float
    sigma_rad: float
    most_m: float
    most_rad: float

    @property
    def limit_m(self) -> float:
        """Median distance that is believed: no less than the predictions' own sigma allows."""
        return max(self.most_m, _SIGMAS * self.sigma_m)

    @property
    def limit_rad(self) -> float:
        """Median angle that is believed."""
        return max(self.most_rad, _SIGMAS * self.sigma_rad)


# ---------------------------------------------------------------- poses


@dataclass(frozen=True, slots=True, kw_only=True)
class Imported:
    """Poses of all images of the campaign; the camera that took most of them, None if the files have none."""

    poses: ImagePoses
    camera: Camera | None
    facts: dict[str, Any]


@dataclass(slots=True, kw_only=True)
class _Table:
    """Poses of the campaign's images as they are filled in."""

    centre: ArrayF
    R: ArrayF
    cov: ArrayF
    common: ArrayF
    following: ArrayF
    known_following: ArrayI
    n_marks: ArrayF
    rms_px: ArrayF
    reasons: list[str]
    source: list[str]
    cameras: list[Camera | None]
    notes: list[str] = field(default_factory=list)


def import_orientations(
    files: Sequence[Path], predictions: ImagePoses, settings: Mapping[str, Any], *, crs: str | None = None
) -> Imported:
    """Poses of the campaign's images from files of other programs.

    Parameters
    ----------
    files : models of COLMAP (folder, or its files), cameras XML of Metashape, tables of angles, own
        ``image_poses.parquet``; images of several files are joined.
    predictions : of all images of the campaign, in their order, with their times.
    settings : section ``images.finished``.
    crs : of the campaign, for tables that state none.

    Raises
    ------
    InputError : a file that cannot be read, names of other images, an image in two files, poses that cannot
        be those of the campaign, or a model in a frame of its own.
    """
    n = len(predictions.images)
    out = _Table(
        centre=np.full((n, 3), np.nan),
        R=np.full((n, 3, 3), np.nan),
        cov=np.full((n, 6, 6), np.nan),
        common=np.zeros((n, 6, 6)),
        following=np.zeros((n, 6, 6)),
        known_following=np.full(n, -1, np.int64),
        n_marks=np.zeros(n),
        rms_px=np.full(n, np.nan),
        reasons=[NOT_IN_FILE] * n,
        source=[""] * n,
        cameras=[None] * n,
    )
    facts: list[dict[str, Any]] = []
    for path in _sources(files):
        if path.suffix.lower() == ".parquet":
            facts.append(_add_own(out, path, predictions, settings))
        else:
            facts.append(_add(out, _read(path, settings, crs), predictions, settings))
    oriented: ArrayB = np.asarray(np.isfinite(out.centre).all(axis=1))
    filled = _covariances(out, oriented, settings)
    camera = _camera(out, oriented)
    without = {predictions.images[k]: out.reasons[k] for k in np.flatnonzero(~oriented)}
    told = {
        "images": n,
        "oriented": int(oriented.sum()),
        "without_pose": without,
        "files": facts,
        "sigmas_from_settings": filled,
        "notes": out.notes,
        "neighbour_correlation": settings["neighbour_correlation"],
    }
    poses = ImagePoses(
        frame=predictions.frame,
        images=predictions.images,
        t_gps_s=predictions.t_gps_s,
        sigma_t_s=predictions.sigma_t_s,
        oriented=oriented,
        reasons=tuple("" if good else reason for good, reason in zip(oriented, out.reasons, strict=True)),
        centre_wcs_m=out.centre,
        R_wcs_ccs=out.R,
        cov_pose_wcs=out.cov,
        cov_next=out.following,
        n_marks=out.n_marks,
        rms_px=out.rms_px,
        facts={"source": "finished orientations: " + ", ".join(sorted({f["program"] for f in facts}))},
    )
    return Imported(poses=poses, camera=camera, facts=told)


def _sources(files: Sequence[Path]) -> list[Path]:
    """Files and folders to read, each model of COLMAP once."""
    found: list[Path] = []
    for path in files:
        if not path.exists():
            raise InputError("file not found", expected="finished orientations", where=path)
        folder = model_folder(path)
        if folder is None and path.is_dir():
            raise InputError(
                "a folder without images.bin or images.txt",
                expected="a model of COLMAP",
                where=path,
                cure="Name the folder of the model, such as sparse/0",
            )
        found.append(path if folder is None else folder)
    if not found:
        raise InputError("no file", expected="one file with finished orientations at least")
    return list(dict.fromkeys(found))


def _read(path: Path, settings: Mapping[str, Any], crs: str | None) -> Finished:
    if path.is_dir():
        return read_model(path, settings["crs"])
    if path.suffix.lower() == ".xml":
        return read_metashape(path, settings["crs"])
    return read_angles_table(
        path,
        crs=settings["crs"],
        default_crs=crs,
        unit=settings["angle_unit"],
        rotation=settings["rotation"],
        direction=settings["direction"],
        axes=settings["axes"],
    )


def _add(
    out: _Table, source: Finished, predictions: ImagePoses, settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Put the poses of one file into the table."""
    images = predictions.images
    at = every = matched(source.names, images, source.where)
    check_share(every, source.names, images, settings["least_matched"], source.where)
    absent = matched(list(source.absent), images, source.where, once=False)
    for k, reason in zip(absent.tolist(), source.absent.values(), strict=True):
        if k >= 0 and not out.source[k]:
            out.reasons[k] = reason
    rows = np.flatnonzero(at >= 0)
    chosen, at = source.chosen(rows), at[rows]
    known = comparable(predictions)[at]
    predicted = _predicted(predictions, at[known], settings)
    compared = chosen.chosen(np.flatnonzero(known)) if known.any() else None
    facts: dict[str, Any] = {
        "program": source.program,
        "file": source.where,
        "poses": len(source.names),
        "matched": len(at),
        "not_of_the_campaign": [source.names[k] for k in range(len(source.names)) if every[k] < 0],
        "without_pose_in_file": len(source.absent),
        "place": source.place.text,
    }
    common = np.zeros((6, 6))
    if source.place.kind == "free":
        centre, R, cov, aligned = _aligned(chosen, compared, predicted, settings)
        common = _common(predictions)
        facts |= {"aligned": aligned}
        check = Check(notes=[_align_note(aligned)])
    else:
        try:
            centre, R, cov = to_world(
                chosen,
                predictions.frame,
                north=settings["north"],
                height_offset_m=settings["height_offset_m"],
            )
        except GeometryError as error:
            if compared is None:
                raise
            raise placed(compared, predicted, error) from error
        check = Check(notes=[UNCHECKED])
        if compared is not None:
            check = check_poses(compared, centre[known], R[known], predicted)
    out.notes += [f"{Path(source.where).name}: {note}" for note in (*source.notes, *check.notes)]
    _fill(out, at, source.where, images)
    out.centre[at], out.R[at], out.cov[at], out.common[at] = centre, R, cov, common
    out.n_marks[at] = chosen.n_marks
    for k, c in zip(at.tolist(), chosen.camera.tolist(), strict=True):
        out.cameras[k] = source.cameras[c] if c >= 0 else None
    return facts | check.facts


def _predicted(predictions: ImagePoses, rows: ArrayI, settings: Mapping[str, Any]) -> Predicted:
    """Predictions of images ``rows``, with the limits of belief."""
    sigma_m, sigma_rad = predicted_sigmas(predictions)
    return Predicted(
        frame=predictions.frame,
        centre_wcs_m=predictions.centre_wcs_m[rows],
        R_wcs_ccs=predictions.R_wcs_ccs[rows],
        sigma_m=sigma_m,
        sigma_rad=sigma_rad,
        most_m=settings["most_position_m"],
        most_rad=float(np.deg2rad(settings["most_angle_deg"])),
    )


def _fill(out: _Table, at: ArrayI, where: str, images: Sequence[str]) -> None:
    for k in at.tolist():
        if out.source[k]:
            raise InputError(
                f"{images[k]} has a pose in {Path(out.source[k]).name}, too",
                expected="each image in one file",
                where=where,
            )
        out.source[k] = where


def _aligned(
    chosen: Finished, compared: Finished | None, predicted: Predicted, settings: Mapping[str, Any]
) -> tuple[ArrayF, ArrayF, ArrayF, dict[str, float]]:
    """A model in a frame of its own on the predictions, or the refusal of it."""
    words = f"a model of {chosen.program} in a frame of its own, without scale and place"
    if compared is None:
        raise InputError(
            f"{words}; no image has a prediction",
            expected="poses in a CRS",
            where=chosen.where,
            cure=CURE_FREE,
        )
    try:
        fit = align(
            compared.coordinates,
            compared.R_place_ccs,
            predicted.centre_wcs_m,
            predicted.R_wcs_ccs,
            predicted.sigma_m,
            predicted.sigma_rad,
        )
    except GeometryError as error:
        raise InputError(
            f"{words}; it cannot be put onto the prediction, either: {error.found}",
            expected="poses in a CRS",
            where=chosen.where,
            cure=CURE_FREE,
        ) from error
    fitted = (
        f"rms of {fit.rms_m:.2f} m and {np.rad2deg(fit.rms_rad):.2f} degrees in {len(compared.names)} images"
    )
    if fit.rms_m > predicted.limit_m or fit.rms_rad > predicted.limit_rad:
        raise InputError(
            f"{words}; a similarity leaves an {fitted} against the predicted poses: it is not the same track",
            expected="poses in a CRS",
            where=chosen.where,
            cure=CURE_FREE,
        )
    if settings["align"] != "predictions":
        raise InputError(
            f"{words}; a similarity of the scale {fit.scale:.6g} puts it onto the predicted poses "
            f"with an {fitted}",
            expected="poses in a CRS",
            where=chosen.where,
            cure=CURE_FREE,
        )
    centre = fit.scale * chosen.coordinates @ fit.R.T + fit.shift_m
    J = np.zeros((6, 6))
    J[:3, :3], J[3:, 3:] = fit.scale * fit.R, fit.R
    cov = np.where(np.isfinite(chosen.cov), J @ np.nan_to_num(chosen.cov) @ J.T, np.nan)
    told = {
        "scale": fit.scale,
        "rms_m": fit.rms_m,
        "rms_deg": float(np.rad2deg(fit.rms_rad)),
        "images": float(len(compared.names)),
    }
    return centre, fit.R @ chosen.R_place_ccs, cov, told


def _align_note(told: Mapping[str, float]) -> str:
    return (
        f"a free model put onto the predicted poses of {told['images']:.0f} images: scale "
        f"{told['scale']:.6g}, rms {told['rms_m']:.2f} m and {told['rms_deg']:.2f} degrees; it errs as a "
        "whole as the prediction does, and control points would do better"
    )


def _common(predictions: ImagePoses) -> ArrayF:
    """Covariance (6, 6) of what an aligned model errs by as a whole: the mean of the predictions' own."""
    cov = predictions.cov_pose_wcs[comparable(predictions)]
    cov = cov[np.isfinite(cov).all(axis=(1, 2))]
    return np.asarray(cov.mean(axis=0)) if len(cov) else np.zeros((6, 6))


def _add_own(out: _Table, path: Path, predictions: ImagePoses, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Poses that Thalweg wrote, maybe of a campaign with another origin."""
    own = ImagePoses.read(path)
    rows = np.flatnonzero(own.oriented)
    if not len(rows):
        raise InputError("no image with a pose", expected="at least one", where=path)
    every = matched(own.images, predictions.images, str(path))
    check_share(
        every[rows], [own.images[k] for k in rows], predictions.images, settings["least_matched"], str(path)
    )
    for k in np.flatnonzero(~own.oriented & (every >= 0)).tolist():
        if not out.source[every[k]]:
            out.reasons[every[k]] = own.reasons[k]
    place = Place(kind="world")
    rank = np.full(len(own.images), -1, np.int64)
    rank[rows[:-1]] = rows[1:]
    rows = rows[every[rows] >= 0]
    at = every[rows]
    centre, R, cov, following = between_frames(
        own.frame,
        predictions.frame,
        own.centre_wcs_m[rows],
        own.R_wcs_ccs[rows],
        own.cov_pose_wcs[rows],
        own.cov_next[rows],
    )
    known = comparable(predictions)[at]
    source = Finished(
        program="Thalweg",
        where=str(path),
        place=place,
        names=tuple(own.images[k] for k in rows),
        coordinates=centre,
        R_place_ccs=R,
        cov=cov,
        camera=np.full(len(rows), -1, np.int64),
    )
    predicted = _predicted(predictions, at[known], settings)
    check = Check(notes=[UNCHECKED])
    if known.any():
        check = check_poses(source.chosen(np.flatnonzero(known)), centre[known], R[known], predicted)
    _fill(out, at, str(path), predictions.images)
    out.notes += [f"{path.name}: {note}" for note in check.notes]
    out.centre[at], out.R[at], out.cov[at] = centre, R, cov
    out.following[at] = following
    out.known_following[at] = np.where(rank[rows] >= 0, every[rank[rows]], -1)
    out.n_marks[at], out.rms_px[at] = own.n_marks[rows], own.rms_px[rows]
    return {
        "program": "Thalweg",
        "file": str(path),
        "poses": int(own.oriented.sum()),
        "matched": len(at),
        "not_of_the_campaign": [own.images[k] for k in np.flatnonzero(own.oriented & (every < 0))],
        "without_pose_in_file": int((~own.oriented).sum()),
        "place": place.text,
        **check.facts,
    }


def _covariances(out: _Table, oriented: ArrayB, settings: Mapping[str, Any]) -> dict[str, int]:
    """Fill in what no file states, add what all images share, and the covariances of neighbours."""
    rows = np.flatnonzero(oriented)
    parts = (("positions", slice(0, 3), settings["sigma_position_m"]),
             ("rotations", slice(3, 6), np.deg2rad(settings["sigma_angle_deg"])))  # fmt: skip
    filled = {}
    for name, part, sigma in parts:
        lost = rows[~np.isfinite(out.cov[rows, part, part]).all(axis=(1, 2))]
        cross = slice(3, 6) if part.start == 0 else slice(0, 3)
        out.cov[lost, part, part] = np.eye(3) * sigma**2
        out.cov[lost, part, cross] = out.cov[lost, cross, part] = 0.0
        filled[name] = len(lost)
    out.cov[rows] = np.nan_to_num(out.cov[rows])
    root = _roots(out.cov[rows])
    for k, (a, b) in enumerate(zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True)):
        if out.known_following[a] == b:
            continue
        own = out.known_following[a] >= 0 or out.source[a] != out.source[b]
        out.following[a] = 0.0 if own else settings["neighbour_correlation"] * root[k] @ root[k + 1]
        if out.source[a] == out.source[b]:
            out.following[a] += out.common[a]
    if len(rows):
        out.following[rows[-1]] = 0.0
    out.cov[rows] += out.common[rows]
    return filled


def _roots(cov: ArrayF) -> ArrayF:
    """Symmetric square roots (n, 6, 6), in units of the sigmas so that metres and radians do not mix."""
    sigma = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 1e-30))
    value, vector = np.linalg.eigh(cov / sigma[:, :, None] / sigma[:, None, :])
    half = (vector * np.sqrt(np.maximum(value, 0.0))[:, None, :]) @ np.swapaxes(vector, 1, 2)
    return np.asarray(sigma[:, :, None] * half)


def _camera(out: _Table, oriented: ArrayB) -> Camera | None:
    """The interior orientation of most images, and a note where there are others."""
    counts: dict[int, int] = {}
    known: dict[int, Camera] = {}
    for k in np.flatnonzero(oriented).tolist():
        camera = out.cameras[k]
        if camera is not None:
            counts[id(camera)] = counts.get(id(camera), 0) + 1
            known[id(camera)] = camera
    if not counts:
        return None
    best = max(counts, key=lambda key: counts[key])
    if len(counts) > 1:
        out.notes.append(
            f"{len(counts)} interior orientations; the one of most images ({counts[best]}) is taken: "
            f"{known[best].name}"
        )
    return known[best]


# ---------------------------------------------------------------- models of COLMAP: ``cameras`` and
# ``images``, as text or binary
#
# COLMAP stores world-to-camera transforms in ccs (x right, y down, z along the view), quaternions with the
# scalar first: ``x_ccs = R(q) x + t``, so that ``R_place_ccs = R(q)^T`` and the projection centre is
# ``-R(q)^T t``. Points are not needed. A model has a frame of its own unless somebody has put it into a CRS.


def model_folder(path: Path) -> Path | None:
    """Folder of the model that a path means."""
    folder = path if path.is_dir() else path.parent
    named = path.is_dir() or path.stem in ("images", "cameras", "points3D", "rigs", "frames")
    return folder if named and any((folder / f"images{s}").is_file() for s in (".bin", ".txt")) else None


def read_model(folder: Path, crs: str | None) -> Finished:
    """A model of COLMAP.

    Parameters
    ----------
    folder : with ``images.bin`` or ``images.txt``; of the cameras only the interior orientation is read.
    crs : what its coordinates refer to; None: a frame of its own.

    Raises
    ------
    InputError : a file is missing, cut off or not as COLMAP writes it.
    """
    binary = (folder / "images.bin").is_file()
    where = folder / ("images.bin" if binary else "images.txt")
    poses = list(_binary_images(where) if binary else _text_images(where))
    if not poses:
        raise InputError("no registered image", expected="at least one", where=where)
    names = tuple(pose[0] for pose in poses)
    values = np.array([pose[2] for pose in poses])
    size = np.linalg.norm(values[:, :4], axis=1)
    if not np.isfinite(values).all() or (np.abs(size - 1) > 1e-3).any():
        k = int(np.argmax(~(np.abs(size - 1) <= 1e-3) | ~np.isfinite(values).all(axis=1)))
        raise InputError(
            f"the quaternion of {names[k]} has the length {size[k]:.4g}", expected="1", where=where
        )
    R_ccs_place = Rotation.from_quat(values[:, [1, 2, 3, 0]]).as_matrix()
    R = orthogonal(np.swapaxes(R_ccs_place, 1, 2), str(where), names)
    notes: list[str] = []
    cameras = _cameras(folder, notes)
    index = {key: k for k, key in enumerate(cameras)}
    return Finished(
        program="COLMAP",
        where=str(where),
        place=Place(kind="free") if crs is None else place_of(crs, str(where)),
        names=names,
        coordinates=-np.einsum("nij,nj->ni", R, values[:, 4:]),
        R_place_ccs=R,
        cov=np.full((len(names), 6, 6), np.nan),
        camera=np.array([index.get(pose[1], -1) for pose in poses]),
        cameras=tuple(cameras.values()),
        n_marks=np.array([float(pose[3]) for pose in poses]),
        notes=tuple(notes),
    )


def _text_images(path: Path) -> Iterator[Pose]:
    """Lines ``id qw qx qy qz tx ty tz camera name``, each followed by a line of its points, maybe empty."""
    lines = _text(path)
    before = False
    for number, line in enumerate(lines, 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            before = False if not words else before
            continue
        if before and _is_points(words):
            before = False
            continue
        try:
            numbers = [float(w) for w in words[1:8]]
            camera, name = int(words[8]), line.split(maxsplit=9)[9].strip()
            int(words[0])
        except (ValueError, IndexError) as error:
            raise InputError(
                f"no pose: {line.strip()[:60]!r}",
                expected="id qw qx qy qz tx ty tz camera name",
                where=f"{path}:{number}",
            ) from error
        following = lines[number].split() if number < len(lines) else []
        points = following[2::3] if _is_points(following) else []
        before = True
        yield name, camera, numbers, len(points) - points.count("-1")


def _binary_images(path: Path) -> Iterator[Pose]:
    data = path.read_bytes()
    at, count = 8, _count(data, path)
    for _ in range(count):
        if at + _POSE.size > len(data):
            raise _cut(path, at)
        values = _POSE.unpack_from(data, at)
        at += _POSE.size
        end = data.find(b"\0", at)
        if end < 0 or end + 9 > len(data):
            raise _cut(path, at)
        try:
            name = data[at:end].decode()
        except UnicodeDecodeError as error:
            raise InputError("a name that is no text", expected="images.bin", where=f"{path}:{at}") from error
        n = int.from_bytes(data[end + 1 : end + 9], "little")
        at = end + 9
        if n > (len(data) - at) // _POINT_BYTES:
            raise _cut(path, at)
        points = np.frombuffer(data, np.dtype([("xy", "<f8", 2), ("point", "<u8")]), n, at)["point"]
        at += n * _POINT_BYTES
        yield name, int(values[8]), list(values[1:8]), int((points != _NOTHING).sum())
    if at != len(data):
        raise InputError(
            f"{len(data) - at} bytes behind the last image", expected="none", where=f"{path}:{at}"
        )


def _cameras(folder: Path, notes: list[str]) -> dict[int, Camera]:
    """Interior orientations by number; those that cannot be taken over leave a note."""
    binary, text = folder / "cameras.bin", folder / "cameras.txt"
    rows = (
        _binary_cameras(binary) if binary.is_file() else _text_cameras(text) if text.is_file() else iter(())
    )
    found: dict[int, Camera] = {}
    for key, model, size, values in rows:
        expected = len(COLMAP_MODELS[model][1]) if model in COLMAP_MODELS else None
        if expected is None:
            notes.append(
                f"The camera model {model} of camera {key} is not known here: no interior orientation"
            )
            continue
        if len(values) != expected:
            raise InputError(
                f"{len(values)} parameters of camera {key}", expected=f"{expected}", where=folder
            )
        pc = colmap()
        made = pc.Camera(
            camera_id=key,
            model=getattr(pc.CameraModelId, model),
            width=size[0],
            height=size[1],
            params=values,
        )
        try:
            camera, off_px = from_colmap(made, f"camera_{key}")
        except ThalwegError as error:
            raise InputError(error.found, expected=error.expected, where=folder) from error
        found[key] = camera
        if off_px > 0:
            notes.append(f"Camera {key}: {model} as the model of Brown, up to {off_px:.3f} px different")
    return found


def _text_cameras(path: Path) -> Iterator[tuple[int, str, tuple[int, int], list[float]]]:
    for number, line in enumerate(_text(path), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            yield int(words[0]), words[1], (int(words[2]), int(words[3])), [float(w) for w in words[4:]]
        except (ValueError, IndexError) as error:
            raise InputError(
                f"no camera: {line.strip()[:60]!r}",
                expected="id model width height parameters",
                where=f"{path}:{number}",
            ) from error


def _binary_cameras(path: Path) -> Iterator[tuple[int, str, tuple[int, int], list[float]]]:
    data = path.read_bytes()
    at = 8
    for _ in range(_count(data, path)):
        if at + _CAMERA.size > len(data):
            raise _cut(path, at)
        key, number, width, height = _CAMERA.unpack_from(data, at)
        model = _NUMBERS.get(number)
        if model is None:
            raise InputError(
                f"camera model number {number}",
                expected="one of COLMAP's up to 11",
                where=f"{path}:{at}",
                cure="Export the model as text",
            )
        n = _COUNTS.get(model) or len(COLMAP_MODELS[model][1])
        at += _CAMERA.size
        if at + 8 * n > len(data):
            raise _cut(path, at)
        values = list(struct.unpack_from(f"<{n}d", data, at))
        at += 8 * n
        yield key, model, (width, height), values


def _count(data: bytes, path: Path) -> int:
    count = int.from_bytes(data[:8], "little")
    if len(data) < 8 or count > _MOST:
        raise InputError(
            f"{len(data)} bytes that are no model", expected="a binary file of COLMAP", where=path
        )
    return count


def _cut(path: Path, at: int) -> InputError:
    return InputError(
        "the file ends inside a record",
        expected="a whole binary file of COLMAP",
        where=f"{path}:{at}",
        cure="Copy the model again",
    )


def _text(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError("no UTF-8 text", expected="COLMAP's text files", where=path) from error


def _is_points(words: list[str]) -> bool:
    """Whether a line holds triples of numbers; the name of a pose stands among the first ten words."""
    return len(words) % 3 == 0 and all(_is_number(word) for word in words[:12])


def _is_number(word: str) -> bool:
    return bool(re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", word))


# ---------------------------------------------------------------- can the poses be those of the campaign, and
# what would make them so?
#
# Poses are compared with those that clock, INS and mount predict. Where they are far away, the usual mistakes
# are tried one after the other on the numbers of the file: another CRS, columns in another order, heights
# above the geoid, another order of angles, another unit, other axes. The one that fits is named.


@dataclass(slots=True, kw_only=True)
class Check:
    """Notes for people and facts of a comparison."""

    notes: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)


def check_poses(source: Finished, centre: ArrayF, R: ArrayF, predicted: Predicted) -> Check:
    """Compare poses in wcs with predicted ones.

    Parameters
    ----------
    source : the same poses as the file has them, for other readings of its numbers.
    centre, R : (n, 3), (n, 3, 3) in wcs.

    Raises
    ------
    InputError : positions or attitudes are not those of the campaign; it says what would fit.
    """
    out = Check()
    if len(centre) < LEAST_IMAGES:
        out.notes.append(f"{len(centre)} images with a prediction: the poses could not be checked against it")
        return out
    off = centre - predicted.centre_wcs_m
    away, turn = np.linalg.norm(off, axis=1), angles_between(R, predicted.R_wcs_ccs)
    out.facts = {
        "images_compared": len(centre),
        "median_distance_m": float(np.median(away)),
        "median_height_difference_m": float(np.median(off[:, 2])),
        "median_angle_deg": float(np.rad2deg(np.median(turn))),
    }
    check_heights(source, off, predicted, out)
    if np.median(away) > predicted.limit_m:
        raise _misplaced(source, predicted, np.median(away))
    _check_attitudes(source, R, turn, predicted)
    out.notes += _north_note(source, R, turn, predicted)
    for what, values, limit, unit in (
        ("m", away, predicted.limit_m, 1.0),
        ("degrees", turn, predicted.limit_rad, np.rad2deg(1.0)),
    ):
        far = np.flatnonzero(values > limit)
        if len(far):
            worst = int(np.argmax(values))
            out.notes.append(
                f"{len(far)} of {len(values)} images are more than {limit * unit:.0f} {what} away from their "
                f"prediction, most of all {source.names[worst]} with {values[worst] * unit:.1f} {what}"
            )
    return out


def check_heights(source: Finished, off: ArrayF, predicted: Predicted, out: Check) -> None:
    """Name a constant difference of heights with positions that fit.

    Parameters
    ----------
    off : (n, 3) imported minus predicted positions in wcs.

    Raises
    ------
    InputError : the difference is that between geoid and ellipsoid.
    """
    height = float(np.median(off[:, 2]))
    scatter = robust_sigma(off[:, 2], height)
    level = max(_LEVEL_M, 3.0 * predicted.sigma_m)
    flat = float(np.median(np.linalg.norm(off[:, :2], axis=1)))
    if scatter > level or flat > predicted.limit_m or abs(height) <= level:
        return
    words = (
        f"heights {abs(height):.1f} m {'below' if height < 0 else 'above'} the predicted ones, all "
        f"alike (NMAD {scatter:.2f} m), with positions that fit to {flat:.1f} m"
    )
    if _GEOID_M[0] <= abs(height) <= _GEOID_M[1]:
        raise InputError(
            words,
            expected="heights above the ellipsoid",
            where=source.where,
            cure="Heights above the geoid differ so: raise images.finished.height_offset_m by the height of "
            f"the geoid there, about {-height:.0f} m, from the geoid model of the land survey",
        )
    out.notes.append(words + ": check whether they are above the ellipsoid")


def placed(source: Finished, predicted: Predicted, error: GeometryError) -> ThalwegError:
    """The error to raise where coordinates do not fit into their CRS, with what would fit."""
    for words, cure, median in _other_places(source, predicted):
        if median <= predicted.limit_m:
            return _wrong_place(source, f"{error.found}", words, cure)
    return InputError(error.found, expected=error.expected, where=source.where, cure=error.cure)


def _misplaced(source: Finished, predicted: Predicted, median_m: float) -> InputError:
    found = f"positions a median of {_distance(median_m)} away from the predicted ones"
    tried = [t for t in _other_places(source, predicted) if t[2] <= predicted.limit_m]
    if tried:
        # WGS 84 and ETRS89 fit alike: the first of them is nearest to what was stated
        least = min(t[2] for t in tried)
        words, cure, _ = next(t for t in tried if t[2] <= least + _ALIKE_M)
        return _wrong_place(source, found, words, cure)
    return InputError(
        found,
        expected=f"at most {predicted.limit_m:.0f} m",
        where=source.where,
        cure="Check images.finished.crs, that the file belongs to this survey, and the camera's "
        "clock, by which "
        "the prediction goes; images.finished.most_position_m is the limit",
    )


def _wrong_place(source: Finished, found: str, words: str, cure: str) -> InputError:
    return InputError(
        f"{found}; {words} would fit",
        expected=f"coordinates in {source.place.text}",
        where=source.where,
        cure=cure,
    )


def _other_places(source: Finished, predicted: Predicted) -> Iterator[tuple[str, str, float]]:
    """Other readings of the coordinates: words, cure, and the median distance that is left."""
    x = source.coordinates
    swapped = x[:, [1, 0, 2]]
    inside = -np.einsum("nij,nj->ni", source.R_place_ccs, x)
    world, degrees = Place(kind="world"), Place(kind="geographic", crs=CRS.from_epsg(4326))
    own = source.place
    swap, metres, centres = "Swap these columns of the file", "Export in metres", "Export projection centres"
    readings: list[tuple[str, str, ArrayF, Place]] = [
        ("east and north (or longitude and latitude) swapped", swap, swapped, own),
        ("world coordinates of the campaign", "Set images.finished.crs: world", x, world),
        ("the translations of world-to-camera transforms", centres, inside, own),
        ("feet", metres, x * 0.3048, own),
        ("millimetres", metres, x * 1e-3, own),
        ("longitude and latitude", "Set images.finished.crs: EPSG:4326", x, degrees),
        ("latitude and longitude", f"{swap}, and set images.finished.crs: EPSG:4326", swapped, degrees),
    ]
    readings += [
        (crs.name, f"Set images.finished.crs: EPSG:{crs.to_epsg()}", x, Place(kind="map", crs=crs))
        for crs in _grids(own, predicted.frame)
    ]
    for words, cure, values, place in readings:
        median = _median_distance(values, place, predicted)
        if np.isfinite(median):
            yield words, cure, median


def _grids(place: Place, frame: LocalFrame) -> list[CRS]:
    """Zones of UTM around the campaign and beside the stated one."""
    zone = int((frame.lon_deg + 180) // 6) + 1
    codes = [
        32600 + z if frame.lat_deg >= 0 else 32700 + z for z in (zone, zone - 1, zone + 1) if 1 <= z <= 60
    ]
    codes += [25800 + z for z in (zone, zone - 1, zone + 1) if 28 <= z <= 38]
    own = place.crs.to_epsg() if place.crs is not None else None
    if own is not None and any(low <= own <= high for low, high in _UTM):
        codes = [own - 1, own + 1, *codes]
    return [CRS.from_epsg(code) for code in dict.fromkeys(codes) if code != own]


def _median_distance(coordinates: ArrayF, place: Place, predicted: Predicted) -> float:
    try:
        centre = world_positions(coordinates, place, predicted.frame)
    except GeometryError:
        return float("inf")
    off = centre - predicted.centre_wcs_m
    # heights above the geoid are a mistake of their own
    return float(np.median(np.linalg.norm(off[:, :2], axis=1)))


def _check_attitudes(source: Finished, R: ArrayF, turn: ArrayF, predicted: Predicted) -> None:
    """Refuse attitudes far from the predicted ones, or much farther than another reading of the angles."""
    median = float(np.median(turn))
    far = median > predicted.limit_rad
    if not far and median <= max(_SUSPECT_RAD, _SIGMAS * predicted.sigma_rad):
        return
    found = f"attitudes a median of {np.rad2deg(median):.1f} degrees away from the predicted ones"
    limit = f"at most {np.rad2deg(predicted.limit_rad):.0f} degrees"
    expected = limit if far else "no other reading of the angles that fits much better"
    other = _other_angles(source, predicted)
    if other is not None and other[1] < _BETTER * median and other[1] <= predicted.limit_rad:
        raise InputError(
            f"{found}; with {' and '.join(other[0])} they would fit to {np.rad2deg(other[1]):.1f}",
            expected=expected,
            where=source.where,
            cure=f"Set {', '.join(f'images.finished.{change}' for change in other[0])}",
        )
    if not far:
        return
    raise InputError(
        f"{found}{_constant_turn(R, median, predicted)}",
        expected=expected,
        where=source.where,
        cure="Check what the rotations of the file mean, the mount of the camera and the camera's clock, by "
        "which the prediction goes; images.finished.most_angle_deg is the limit",
    )


def _north_note(source: Finished, R: ArrayF, turn: ArrayF, predicted: Predicted) -> list[str]:
    """Whether angles in a map grid fit much better with the other north."""
    if source.angles is None or source.place.kind != "map":
        return []
    frame, median = predicted.frame, float(np.median(turn))
    readings = {
        n: world_axes(source.coordinates, source.place, frame, n) @ source.R_place_ccs for n in _NORTH
    }
    other = max(_NORTH, key=lambda n: float(np.median(angles_between(readings[n], R))))
    left = float(np.median(angles_between(readings[other], predicted.R_wcs_ccs)))
    convergence = float(np.median(angles_between(readings["grid"], readings["true"])))
    if left > 0.5 * median or convergence < _SIGMAS * predicted.sigma_rad:
        return []
    return [
        f"attitudes fit to {np.rad2deg(median):.2f} degrees, and to {np.rad2deg(left):.2f} if they refer to "
        f"{other} north (convergence {np.rad2deg(convergence):.2f}): images.finished.north"
    ]


def _other_angles(source: Finished, predicted: Predicted) -> tuple[Sequence[str], float] | None:
    """The best other reading of a table's angles, and the median angle (rad) that it leaves."""
    if source.angles is None:
        return None
    axes = world_axes(source.coordinates, source.place, predicted.frame)
    best: tuple[Sequence[str], float] | None = None
    for other in conventions(source.angles):
        changed = changes(source.angles, other)
        if not changed:
            continue
        left = float(np.median(angles_between(axes @ ccs_rotations(other), predicted.R_wcs_ccs)))
        # of readings that fit alike the one that changes least, which comes first
        if best is None or left < best[1] - 1e-6:
            best = changed, left
    return best


def _constant_turn(R: ArrayF, median_rad: float, predicted: Predicted) -> str:
    """Whether one turn of the image axes or of the world's would make all attitudes fit."""
    at_image = np.swapaxes(R, 1, 2) @ predicted.R_wcs_ccs
    at_world = predicted.R_wcs_ccs @ np.swapaxes(R, 1, 2)
    inverse = predicted.R_wcs_ccs @ R
    for turns, words in (
        (at_image, "the axes of the images"),
        (at_world, "the axes of the world"),
        (inverse, "the rotations inverted, and the axes of the world"),
    ):
        mean = mean_rotation(turns)
        left = float(np.median(angles_between(turns, np.broadcast_to(mean, turns.shape))))
        if left < _BETTER * median_rad:
            angle = float(np.arccos(np.clip((np.trace(mean) - 1) / 2, -1, 1)))
            return (
                f"; with {words} turned by {np.rad2deg(angle):.1f} degrees they would fit to "
                f"{np.rad2deg(left):.1f}"
            )
    return ""


def _distance(metres: float) -> str:
    return f"{metres:.0f} m" if metres < 10_000 else f"{metres / 1000:.0f} km"
