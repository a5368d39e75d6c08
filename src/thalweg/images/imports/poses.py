"""Finished orientations of other programs as poses of the campaign's images.

Each file is read in its own frame (`thalweg.images.imports.source`), its names are matched to the
images, its poses are put into wcs (`finished_frames`) and compared with the predicted ones
(`finished_checks`). Errors that the file does not state come from the settings; neighbours' errors are
correlated by a stated share, for which a file has no place::

    cov(k, k+1) = rho S_k S_{k+1},      S S = cov
"""

import re
import struct
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
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
    check_lens,
    robust_sigma,
)
from thalweg.core.values import FAR_M
from thalweg.images.imports.formats import read_angles_table, read_metashape
from thalweg.images.imports.source import Finished, Place, place_of, to_world
from thalweg.images.model import (
    LEAST_IMAGES,
    ImagePoses,
    align,
    angles_between,
    check_share,
    comparable,
    matched,
    predicted_sigmas,
    unknown_poses,
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
_POSE: Final = struct.Struct("<i7di")
_POINTS: Final = np.dtype([("xy", "<f8", 2), ("point", "<u8")])
_CAMERA: Final = struct.Struct("<iiQQ")
_MODELS: Final = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE",
)  # fmt: skip
"""Names of COLMAP's models by their number."""
_COUNTS: Final = {"FOV": 5, "THIN_PRISM_FISHEYE": 12, "RAD_TAN_THIN_PRISM_FISHEYE": 16}
"""Parameters of those that are not known here."""
_NOTHING: Final = 2**64 - 1
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
Pose = tuple[str, int, Sequence[float], int]
"""Name, number of the camera, quaternion (w, x, y, z) and translation, tie points."""
Lens = tuple[int, str, tuple[int, int], Sequence[float]]
"""Number, model, size in pixels, parameters."""

_SIGMAS: Final = 4.0
_GEOID_M: Final = (15.0, 110.0)
"""Heights of geoids above the ellipsoid are within +-107 m; below 15 m other causes are likelier."""
_ANGLE_RAD: Final = np.deg2rad(1.0)
"""Attitudes that are farther from their prediction on the whole are told."""
_LEVEL_M: Final = 3.0
_CHECK_PLACE: Final = (
    "Check images.finished.crs (`world` for the world frame, EPSG:4326 for degrees), order and unit of the "
    "columns, that they are projection centres, and that the file belongs to this survey"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Predicted:
    """Predictions of some images, (n, 3) and (n, 3, 3) in wcs, their sigmas, and the limits of belief."""

    frame: LocalFrame
    centre_wcs_m: ArrayF
    R_wcs_ccs: ArrayF
    sigma_m: float
    sigma_rad: float
    limit_m: float
    limit_rad: float


# ---------------------------------------------------------------- poses


@dataclass(frozen=True, slots=True, kw_only=True)
class Imported:
    """Poses of all images of the campaign; the camera that took most of them, None if the files have none."""

    poses: ImagePoses
    camera: Camera | None
    facts: dict[str, Any]


@dataclass(slots=True, kw_only=True)
class _Table:
    """Poses of the campaign's images as they are filled in, with what `ImagePoses` does not keep."""

    poses: ImagePoses
    common: ArrayF
    known_following: ArrayI
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
        poses=replace(
            unknown_poses(predictions.frame, predictions.images),
            t_gps_s=predictions.t_gps_s,
            sigma_t_s=predictions.sigma_t_s,
            cov_next=np.zeros((n, 6, 6)),
            n_marks=np.zeros(n),
        ),
        common=np.zeros((n, 6, 6)),
        known_following=np.full(n, -1, np.int64),
        reasons=[NOT_IN_FILE] * n,
        source=[""] * n,
        cameras=[None] * n,
    )
    facts = [
        _add(out, _read(path, predictions, settings, crs), predictions, settings) for path in _sources(files)
    ]
    oriented: ArrayB = np.asarray(np.isfinite(out.poses.centre_wcs_m).all(axis=1))
    filled = _covariances(out, oriented, settings)
    camera = _camera(out)
    told = {
        "images": n,
        "oriented": int(oriented.sum()),
        "without_pose": {predictions.images[k]: out.reasons[k] for k in np.flatnonzero(~oriented)},
        "files": facts,
        "sigmas_from_settings": filled,
        "notes": out.notes,
        "neighbour_correlation": settings["neighbour_correlation"],
    }
    poses = replace(
        out.poses,
        oriented=oriented,
        reasons=tuple("" if good else reason for good, reason in zip(oriented, out.reasons, strict=True)),
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


def _read(path: Path, predictions: ImagePoses, settings: Mapping[str, Any], crs: str | None) -> Finished:
    if path.is_dir():
        return read_model(path, settings["crs"])
    if path.suffix.lower() == ".parquet":
        return _read_own(path, predictions.frame)
    if path.suffix.lower() == ".xml":
        return read_metashape(path, settings["crs"])
    return read_angles_table(path, settings, crs)


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
    if source.place.kind == "free":
        centre, R, cov, aligned = _aligned(chosen, compared, predicted, settings)
        out.common[at] = _common(predictions)
        facts |= {"aligned": aligned}
        notes = [
            f"a free model put onto the predicted poses of {aligned['images']:.0f} images: scale "
            f"{aligned['scale']:.6g}, rms {aligned['rms_m']:.2f} m and {aligned['rms_deg']:.2f} degrees; it "
            "errs as a whole as the prediction does, and control points would do better"
        ]
    else:
        offset_m = 0.0 if source.following is not None else settings["height_offset_m"]  # our own have none
        try:
            centre, R, cov = to_world(
                chosen, predictions.frame, north=settings["north"], height_offset_m=offset_m
            )
        except GeometryError as error:
            raise InputError(
                error.found, expected=error.expected, where=source.where, cure=_CHECK_PLACE
            ) from error
        notes = [UNCHECKED]
        if compared is not None:
            notes, more = check_poses(compared, centre[known], R[known], predicted)
            facts |= more
        elif chosen.place.kind != "world" and np.median(np.linalg.norm(centre, axis=1)) > FAR_M:
            # of coordinates in the world frame nothing says where it begins
            raise InputError(
                f"positions a median of {_distance(centre)} away from campaign.origin",
                expected=f"coordinates in {chosen.place.text} within {FAR_M / 1000:g} km",
                where=source.where,
                cure=_CHECK_PLACE,
            )
    out.notes += [f"{Path(source.where).name}: {note}" for note in (*source.notes, *notes)]
    for k, camera in zip(at.tolist(), chosen.cameras, strict=True):
        if out.source[k]:
            raise InputError(
                f"{images[k]} has a pose in {Path(out.source[k]).name}, too",
                expected="each image in one file",
                where=source.where,
            )
        out.source[k], out.cameras[k] = source.where, camera
    poses = out.poses
    poses.centre_wcs_m[at], poses.R_wcs_ccs[at], poses.cov_pose_wcs[at] = centre, R, cov
    poses.n_marks[at], poses.rms_px[at] = chosen.n_marks, chosen.rms_px
    if chosen.following is not None:
        poses.cov_next[at] = chosen.following
        out.known_following[at] = np.append(every[1:], -1)[rows]
    return facts


def _predicted(predictions: ImagePoses, rows: ArrayI, settings: Mapping[str, Any]) -> Predicted:
    """Predictions of images ``rows``, with the limits of belief: no less than their own sigmas allow."""
    sigma_m, sigma_rad = predicted_sigmas(predictions)
    return Predicted(
        frame=predictions.frame,
        centre_wcs_m=predictions.centre_wcs_m[rows],
        R_wcs_ccs=predictions.R_wcs_ccs[rows],
        sigma_m=sigma_m,
        sigma_rad=sigma_rad,
        limit_m=max(settings["most_position_m"], _SIGMAS * sigma_m),
        limit_rad=max(float(np.deg2rad(settings["most_angle_deg"])), _SIGMAS * sigma_rad),
    )


def _aligned(
    chosen: Finished, compared: Finished | None, predicted: Predicted, settings: Mapping[str, Any]
) -> tuple[ArrayF, ArrayF, ArrayF, dict[str, float]]:
    """A model in a frame of its own on the predictions, or the refusal of it."""

    def refused(why: str) -> InputError:
        """The model has no place, and why it gets none."""
        return InputError(
            f"a model of {chosen.program} in a frame of its own, without scale and place; {why}",
            expected="poses in a CRS",
            where=chosen.where,
            cure=CURE_FREE,
        )

    if compared is None:
        raise refused("no image has a prediction")
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
        raise refused(f"it cannot be put onto the prediction, either: {error.found}") from error
    fitted = (
        f"rms of {fit.rms_m:.2f} m and {np.rad2deg(fit.rms_rad):.2f} degrees in {len(compared.names)} images"
    )
    if fit.rms_m > predicted.limit_m or fit.rms_rad > predicted.limit_rad:
        raise refused(
            f"a similarity leaves an {fitted} against the predicted poses: it is not the same track"
        )
    if settings["align"] != "predictions":
        raise refused(
            f"a similarity of the scale {fit.scale:.6g} puts it onto the predicted poses with an {fitted}"
        )
    centre = fit.scale * chosen.coordinates @ fit.R.T + fit.shift_m
    J = np.kron(np.diag([fit.scale, 1.0]), fit.R)
    cov = np.where(np.isfinite(chosen.cov), J @ np.nan_to_num(chosen.cov) @ J.T, np.nan)
    told = {
        "scale": fit.scale,
        "rms_m": fit.rms_m,
        "rms_deg": float(np.rad2deg(fit.rms_rad)),
        "images": float(len(compared.names)),
    }
    return centre, fit.R @ chosen.R_place_ccs, cov, told


def _common(predictions: ImagePoses) -> ArrayF:
    """Covariance (6, 6) of what an aligned model errs by as a whole: the mean of the predictions' own."""
    cov = predictions.cov_pose_wcs[comparable(predictions)]
    cov = cov[np.isfinite(cov).all(axis=(1, 2))]
    return np.asarray(cov.mean(axis=0)) if len(cov) else np.zeros((6, 6))


def _read_own(path: Path, frame: LocalFrame) -> Finished:
    """Poses that Thalweg wrote, maybe of a campaign with another origin."""
    own = ImagePoses.read(path)
    rows = np.flatnonzero(own.oriented)
    turn = frame.R_ecef_enu.T @ own.frame.R_ecef_enu
    J = np.kron(np.eye(2), turn)
    return Finished(
        program="Thalweg",
        where=str(path),
        place=Place(kind="world"),
        names=tuple(own.images[k] for k in rows),
        coordinates=frame.from_ecef(
            own.centre_wcs_m[rows] @ own.frame.R_ecef_enu.T + own.frame.origin_ecef_m
        ),
        R_place_ccs=turn @ own.R_wcs_ccs[rows],
        cov=J @ own.cov_pose_wcs[rows] @ J.T,
        following=J @ own.cov_next[rows] @ J.T,
        n_marks=own.n_marks[rows],
        rms_px=own.rms_px[rows],
        absent={own.images[k]: own.reasons[k] for k in np.flatnonzero(~own.oriented)},
    )


def _covariances(out: _Table, oriented: ArrayB, settings: Mapping[str, Any]) -> dict[str, int]:
    """Fill in what no file states, add what all images share, and the covariances of neighbours."""
    rows = np.flatnonzero(oriented)
    cov, following = out.poses.cov_pose_wcs, out.poses.cov_next
    parts = (("positions", slice(0, 3), settings["sigma_position_m"]),
             ("rotations", slice(3, 6), np.deg2rad(settings["sigma_angle_deg"])))  # fmt: skip
    filled = {}
    for name, part, sigma in parts:
        lost = rows[~np.isfinite(cov[rows, part, part]).all(axis=(1, 2))]
        cov[lost, part] = cov[lost, :, part] = 0.0
        cov[lost, part, part] = np.eye(3) * sigma**2
        filled[name] = len(lost)
    cov[rows] = np.nan_to_num(cov[rows])
    root = _roots(cov[rows])
    for k, (a, b) in enumerate(zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True)):
        if out.known_following[a] == b:
            continue
        own = out.known_following[a] >= 0 or out.source[a] != out.source[b]
        following[a] = 0.0 if own else settings["neighbour_correlation"] * root[k] @ root[k + 1]
        if out.source[a] == out.source[b]:
            following[a] += out.common[a]
    if len(rows):
        following[rows[-1]] = 0.0
    cov[rows] += out.common[rows]
    return filled


def _roots(cov: ArrayF) -> ArrayF:
    """Symmetric square roots (n, 6, 6), in units of the sigmas so that metres and radians do not mix."""
    sigma = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 1e-30))
    value, vector = np.linalg.eigh(cov / sigma[:, :, None] / sigma[:, None, :])
    half = (vector * np.sqrt(np.maximum(value, 0.0))[:, None, :]) @ np.swapaxes(vector, 1, 2)
    return np.asarray(sigma[:, :, None] * half)


def _camera(out: _Table) -> Camera | None:
    """The interior orientation of most images, and a note where there are others."""
    known = {id(camera): camera for camera in out.cameras if camera is not None}
    counts = Counter(id(camera) for camera in out.cameras if camera is not None).most_common()
    if not counts:
        return None
    best, n = counts[0]
    if len(counts) > 1:
        out.notes.append(
            f"{len(counts)} interior orientations; the one of most images ({n}) is taken: {known[best].name}"
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
    names, lenses, values, n_marks = zip(*poses, strict=True)
    q = np.array(values)
    size = np.linalg.norm(q[:, :4], axis=1)
    bad = ~(np.abs(size - 1) <= 1e-3) | ~np.isfinite(q).all(axis=1)
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError(
            f"the quaternion of {names[k]} has the length {size[k]:.4g}", expected="1", where=where
        )
    R = Rotation.from_quat(q[:, :4], scalar_first=True).inv().as_matrix()
    notes: list[str] = []
    cameras = _cameras(folder, notes)
    return Finished(
        program="COLMAP",
        where=str(where),
        place=Place(kind="free") if crs is None else place_of(crs, where),
        names=names,
        coordinates=-np.einsum("nij,nj->ni", R, q[:, 4:]),
        R_place_ccs=R,
        cov=np.full((len(names), 6, 6), np.nan),
        cameras=[cameras.get(key) for key in lenses],
        n_marks=np.array(n_marks, np.float64),
        notes=notes,
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
    at = 8
    try:
        for _ in range(_count(data, _POSE.size, path)):
            values = _POSE.unpack_from(data, at)
            end = data.index(b"\0", at + _POSE.size)
            (n,) = struct.unpack_from("<Q", data, end + 1)
            points = np.frombuffer(data, _POINTS, min(n, len(data)), end + 9)["point"]
            yield (
                data[at + _POSE.size : end].decode(),
                values[8],
                values[1:8],
                int((points != _NOTHING).sum()),
            )
            at = end + 9 + points.size * _POINTS.itemsize
    except (struct.error, ValueError) as error:  # a name that is no text is one of values
        raise _cut(path, at) from error
    if at != len(data):
        raise InputError(
            f"{len(data) - at} bytes behind the last image", expected="none", where=f"{path}:{at}"
        )


def _cameras(folder: Path, notes: list[str]) -> dict[int, Camera]:
    """Interior orientations by number; those that cannot be taken over leave a note."""
    binary, text = folder / "cameras.bin", folder / "cameras.txt"
    rows = _binary_cameras(binary) if binary.is_file() else _text_cameras(text) if text.is_file() else ()
    found: dict[int, Camera] = {}
    for key, model, (width, height), values in rows:
        if model not in COLMAP_MODELS:
            notes.append(
                f"The camera model {model} of camera {key} is not known here: no interior orientation"
            )
            continue
        n = len(COLMAP_MODELS[model][1])
        if len(values) != n:
            raise InputError(f"{len(values)} parameters of camera {key}", expected=f"{n}", where=folder)
        pc = colmap()
        of_model = getattr(pc.CameraModelId, model)
        made = pc.Camera(camera_id=key, model=of_model, width=width, height=height, params=values)
        try:
            found[key], off_px = from_colmap(made, f"camera_{key}")
            check_lens(found[key], folder)
        except ThalwegError as error:
            raise InputError(error.found, expected=error.expected, where=folder) from error
        if off_px > 0:
            notes.append(f"Camera {key}: {model} as the model of Brown, up to {off_px:.3f} px different")
    return found


def _text_cameras(path: Path) -> Iterator[Lens]:
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


def _binary_cameras(path: Path) -> Iterator[Lens]:
    data = path.read_bytes()
    at = 8
    for _ in range(_count(data, _CAMERA.size, path)):
        try:
            key, number, width, height = _CAMERA.unpack_from(data, at)
            if number not in range(len(_MODELS)):
                raise InputError(
                    f"camera model number {number}",
                    expected=f"one of COLMAP's up to {len(_MODELS) - 1}",
                    where=f"{path}:{at}",
                    cure="Export the model as text",
                )
            model = _MODELS[number]
            n = _COUNTS.get(model) or len(COLMAP_MODELS[model][1])
            yield key, model, (width, height), struct.unpack_from(f"<{n}d", data, at + _CAMERA.size)
        except struct.error as error:
            raise _cut(path, at) from error
        at += _CAMERA.size + 8 * n


def _cut(path: Path, at: int) -> InputError:
    return InputError(
        "the file ends inside a record",
        expected="a whole binary file of COLMAP",
        where=f"{path}:{at}",
        cure="Copy the model again",
    )


def _count(data: bytes, least_bytes: int, path: Path) -> int:
    """Number of records at the beginning of a binary file, which must have room for them."""
    count = int.from_bytes(data[:8], "little")
    if count * least_bytes > len(data) - 8:
        raise InputError(
            f"{len(data)} bytes that are no model", expected="a binary file of COLMAP", where=path
        )
    return count


def _text(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError("no UTF-8 text", expected="COLMAP's text files", where=path) from error


def _is_points(words: list[str]) -> bool:
    """Whether a line holds triples of numbers; the name of a pose stands among the first ten words."""
    return len(words) % 3 == 0 and all(_NUMBER.fullmatch(word) for word in words[:12])


# ---------------------------------------------------------------- can the poses be those of the campaign?
#
# Poses are compared with those that clock, INS and mount predict.


def check_poses(
    source: Finished, centre: ArrayF, R: ArrayF, predicted: Predicted
) -> tuple[list[str], dict[str, Any]]:
    """Compare poses in wcs with predicted ones: notes for people, and facts.

    Parameters
    ----------
    source : the same poses as the file has them.
    centre, R : (n, 3), (n, 3, 3) in wcs.

    Raises
    ------
    InputError : positions or attitudes are not those of the campaign.
    """
    if len(centre) < LEAST_IMAGES:
        return [f"{len(centre)} images with a prediction: the poses could not be checked against it"], {}
    off = centre - predicted.centre_wcs_m
    away, turn = np.linalg.norm(off, axis=1), angles_between(R, predicted.R_wcs_ccs)
    facts = {
        "images_compared": len(centre),
        "median_distance_m": float(np.median(away)),
        "median_height_difference_m": float(np.median(off[:, 2])),
        "median_angle_deg": float(np.rad2deg(np.median(turn))),
    }
    notes = check_heights(source, off, predicted)
    if np.median(away) > predicted.limit_m:
        raise InputError(
            f"positions a median of {_distance(off)} away from the predicted ones",
            expected=f"coordinates in {source.place.text}, at most {predicted.limit_m:.0f} m away",
            where=source.where,
            cure=f"{_CHECK_PLACE}, and the camera's clock, by which the prediction goes; "
            "images.finished.most_position_m is the limit",
        )
    if np.median(turn) > predicted.limit_rad:
        raise InputError(
            f"attitudes a median of {np.rad2deg(np.median(turn)):.1f} degrees away from the predicted ones",
            expected=f"at most {np.rad2deg(predicted.limit_rad):.0f} degrees",
            where=source.where,
            cure="Check what the rotations of the file mean (images.finished.angle_unit, rotation, "
            "direction, axes, north), the mount of the camera and its clock, by which the prediction "
            "goes; images.finished.most_angle_deg is the limit",
        )
    typical, sigma = float(np.median(turn)), predicted.sigma_rad
    if typical > max(_ANGLE_RAD, _SIGMAS * sigma):
        notes.append(
            f"attitudes a median of {np.rad2deg(typical):.1f} degrees away from the predicted ones, whose "
            f"standard deviation is {np.rad2deg(sigma):.1f}: check north, axes of the angles, and the mount"
        )
    for what, values, limit, unit in (
        ("m", away, predicted.limit_m, 1.0),
        ("degrees", turn, predicted.limit_rad, np.rad2deg(1.0)),
    ):
        far_off = np.flatnonzero(values > limit)
        if len(far_off):
            worst = int(np.argmax(values))
            notes.append(
                f"{len(far_off)} of {len(values)} images are more than {limit * unit:.0f} {what} away from "
                f"their prediction, most of all {source.names[worst]} with {values[worst] * unit:.1f} {what}"
            )
    return notes, facts


def check_heights(source: Finished, off: ArrayF, predicted: Predicted) -> list[str]:
    """A note where heights differ by a constant, with positions that fit.

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
        return []
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
    return [words + ": check whether they are above the ellipsoid"]


def _distance(off: ArrayF) -> str:
    metres = np.median(np.linalg.norm(off, axis=1))
    return f"{metres:.0f} m" if metres < 10_000 else f"{metres / 1000:.0f} km"
