"""Models of COLMAP: ``cameras`` and ``images``, as text or binary.

COLMAP stores world-to-camera transforms in ccs (x right, y down, z along the view), quaternions with the
scalar first: ``x_ccs = R(q) x + t``, so that ``R_place_ccs = R(q)^T`` and the projection centre is
``-R(q)^T t``. Points are not needed. A model has a frame of its own unless somebody has put it into a CRS.
"""

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core.camera.files import COLMAP_MODELS
from thalweg.core.camera.model import Camera
from thalweg.core.errors import InputError, ThalwegError
from thalweg.images.imports.source import Finished, Place, orthogonal, place_of
from thalweg.images.sfm.camera import from_colmap
from thalweg.images.sfm.colmap import colmap

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


def is_model(path: Path) -> bool:
    """Whether a path is a folder with a model, or one of its files."""
    return model_folder(path) is not None


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
                f"no pose: {line.strip()[:60]!r}", expected="id qw qx qy qz tx ty tz camera name",
                where=f"{path}:{number}",
            ) from error  # fmt: skip
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
        made = pc.Camera(camera_id=key, model=getattr(pc.CameraModelId, model), width=size[0], height=size[1],
                         params=values)  # fmt: skip
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
                f"no camera: {line.strip()[:60]!r}", expected="id model width height parameters",
                where=f"{path}:{number}",
            ) from error  # fmt: skip


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
                f"camera model number {number}", expected="one of COLMAP's up to 11", where=f"{path}:{at}",
                cure="Export the model as text",
            )  # fmt: skip
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
    return InputError("the file ends inside a record", expected="a whole binary file of COLMAP",
                      where=f"{path}:{at}", cure="Copy the model again")  # fmt: skip


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
