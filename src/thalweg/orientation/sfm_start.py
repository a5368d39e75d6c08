"""From features to matches: order in time, approximate positions, interior orientations to begin with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from thalweg.core.camera import Camera
from thalweg.core.errors import InputError
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF, ArrayI
from thalweg.orientation.sfm_camera import (
    StartCamera,
    cameras_by_size,
    focal_from_exif,
    start_given,
    start_guessed,
)
from thalweg.orientation.sfm_features import Features
from thalweg.orientation.sfm_images import Picture, with_problem
from thalweg.orientation.sfm_matching import Matches, MatchSettings, match_pairs
from thalweg.orientation.sfm_pairs import PairSettings, image_pairs, order_in_time

_UNLIKE: Final = 1.08
"""Ratio of calibrated and stated focal length beyond which a note says so; EXIF rounds to millimetres."""
_OTHER_LENS: Final = 1.25
"""Ratio of calibrated and stated focal length beyond which they are not of one lens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What is known of images beforehand; all of it may be absent.

    Parameters
    ----------
    cameras : interior orientations, told apart by the size of their pictures.
    t_s : times by name, any scale.
    trajectory : of the boat on the scale of these times; its positions stand for those of the camera.
    """

    cameras: tuple[Camera, ...] = ()
    t_s: Mapping[str, float] = field(default_factory=dict)
    trajectory: Trajectory | None = None


def read_times(path: Path) -> dict[str, float]:
    """Times of images by name from a Parquet table: ``file`` or ``image``, ``t_gps_s`` or ``t_device_s``.

    Raises
    ------
    InputError : no such table.
    """
    if not path.is_file():
        raise InputError("file not found", expected="a table of times of images", where=path)
    try:
        table = pq.read_table(path).to_pandas()
    except pa.ArrowInvalid as error:
        raise InputError(f"not a Parquet file ({error})", expected="times of images", where=path) from error
    name = next((c for c in ("file", "image") if c in table), None)
    time = next((c for c in ("t_gps_s", "t_device_s") if c in table), None)
    if name is None or time is None:
        raise InputError(
            f"the columns {', '.join(table.columns)}",
            expected="file or image, and t_gps_s or t_device_s",
            where=path,
        )
    return dict(zip(table[name].astype(str), table[time].to_numpy(np.float64).tolist(), strict=True))


def match_images(
    features: Features,
    images: Sequence[Path],
    *,
    known: Known | None = None,
    section: Mapping[str, Any] | None = None,
    threads: int = 1,
) -> Matches:
    """Choose the pairs of images and find what they have in common.

    Parameters
    ----------
    features : of all images.
    images : their files: without a given camera the focal length is asked of their EXIF.
    known : interior orientation, times, trajectory.
    section : section ``images.mapping`` of a campaign file; None: its defaults.
    threads : pairs that are worked on at the same time.

    Raises
    ------
    InputError : fewer than two images can take part, or no image is of a given camera's size.
    GeometryError : pairs by position are wanted without positions.
    """
    given = known or Known()
    pairing = PairSettings.from_section(section) if section else PairSettings()
    matching = MatchSettings.from_section(section) if section else MatchSettings()
    lens = str(section["lens"]) if section else "auto"
    interior = str(section["interior"]) if section else "auto"
    starts, camera, pictures = _cameras(features.pictures, images, given.cameras, lens, interior)
    names = [picture.name for picture in pictures]
    t_s = np.array([given.t_s.get(name, np.nan) for name in names])
    order, notes = order_in_time(names, t_s)
    order = order[np.array([not pictures[k].problem for k in order], bool)]
    position_m = _positions(t_s, given.trajectory)
    pairs, kind = image_pairs(order, pairing, position_m)
    facts = {
        "pairs": kind,
        "images_with_time": int(np.isfinite(t_s).sum()),
        "images_with_position": 0 if position_m is None else int(np.isfinite(position_m).all(axis=1).sum()),
        "interior": [f"{s.source}, {s.lens}, {s.camera.parameters[0]:.1f} px" for s in starts],
        "notes": [
            *notes,
            *_notes(pictures, starts, given.cameras),
            *_check_focal(given.cameras, camera, pictures, images),
        ],
    }
    return match_pairs(
        replace(features, pictures=pictures),
        pairs,
        order=order,
        starts=starts,
        camera=camera,
        settings=matching,
        threads=threads,
        facts=facts,
    )


def _cameras(
    pictures: Sequence[Picture], images: Sequence[Path], given: Sequence[Camera], lens: str, interior: str
) -> tuple[list[StartCamera], ArrayI, tuple[Picture, ...]]:
    good = [k for k, picture in enumerate(pictures) if not picture.problem]
    out, camera = list(pictures), np.full(len(pictures), -1, np.int64)
    if given:
        found, reasons = cameras_by_size([pictures[k].size_px for k in good], given)
        for k, c, reason in zip(good, found, reasons, strict=True):
            camera[k] = c
            out[k] = with_problem(pictures[k], reason, "size") if reason else pictures[k]
        return [start_given(c, lens, fixed=interior != "estimated") for c in given], camera, tuple(out)
    if interior == "fixed":
        raise InputError(
            "the interior orientation shall stay as given, but none is given",
            expected="a calibrated camera",
            where="images.mapping.interior",
            cure="Give an interior orientation, or choose estimated",
        )
    path_of = {path.name: path for path in images}
    starts: list[StartCamera] = []
    index: dict[tuple[int, int], int] = {}
    for k in good:
        size = pictures[k].size_px
        if size not in index:
            index[size] = len(starts)
            start = start_guessed(path_of.get(pictures[k].name, Path(pictures[k].name)), size, lens)
            name = f"camera_{len(starts) + 1}" if starts else "camera"
            starts.append(replace(start, camera=replace(start.camera, name=name)))
        camera[k] = index[size]
    return starts, camera, tuple(out)


def _check_focal(
    given: Sequence[Camera], camera: ArrayI, pictures: Sequence[Picture], images: Sequence[Path]
) -> list[str]:
    """Compare given cameras with the focal length that the EXIF of one of their images states.

    Returns
    -------
    notes : differences that rounding in EXIF hardly explains.

    Raises
    ------
    InputError : another lens or zoom; EXIF rounds to whole millimetres, which explains some percent.
    """
    path_of = {path.name: path for path in images}
    notes = []
    for c, known in enumerate(given):
        rows = np.flatnonzero(camera == c)
        path = path_of.get(pictures[int(rows[0])].name) if len(rows) else None
        stated = None if path is None or known.model == "fisheye" else focal_from_exif(path)
        if path is None or stated is None:
            continue
        ratio = float(known.parameters[0] / stated)
        if not 1 / _UNLIKE < ratio < _UNLIKE:
            notes.append(
                f"the focal length of {known.name} is {known.parameters[0]:.0f} px, EXIF states {stated:.0f} "
                "px: is the calibration that of this camera and zoom?"
            )
        if not 1 / _OTHER_LENS < ratio < _OTHER_LENS:
            raise InputError(
                f"a focal length of {known.parameters[0]:.0f} px in the interior orientation {known.name}, "
                f"and {stated:.0f} px by the EXIF of the images", where=path.name,
                expected="the calibration of this camera at this zoom",
                cure="Name the right calibration (logs.time_lapse.interior, mounts.calibration), or none: "
                "the interior orientation is then estimated",
            )  # fmt: skip
    return notes


def _positions(t_s: ArrayF, trajectory: Trajectory | None) -> ArrayF | None:
    if trajectory is None or not np.isfinite(t_s).any():
        return None
    out = np.full((len(t_s), 3), np.nan)
    timed = np.flatnonzero(np.isfinite(t_s))
    position, _, valid = trajectory.at(t_s[timed])
    out[timed[valid]] = position[valid]
    return out


def _notes(pictures: Sequence[Picture], starts: Sequence[StartCamera], given: Sequence[Camera]) -> list[str]:
    notes = []
    other = [picture.name for picture in pictures if picture.cause == "size"]
    if other:
        notes.append(f"{len(other)} images, such as {other[0]}, are not of the size of the given camera")
    if len(starts) > 1 and not given:
        notes.append(f"images of {len(starts)} sizes: each size has an interior orientation of its own")
    doubles = [picture.name for picture in pictures if picture.cause == "double"]
    if doubles:
        notes.append(f"{len(doubles)} images, such as {doubles[0]}, are the same files as others: left out")
    return notes
