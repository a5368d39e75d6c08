"""From features to matches: order in time, approximate positions, interior orientations to begin with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from thalweg.core.camera.model import Camera
from thalweg.core.errors import InputError
from thalweg.core.tables import read_parquet
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF
from thalweg.images.model.cameras import cameras_of
from thalweg.images.model.files import Picture, named_once
from thalweg.images.sfm.assign import Interiors, assign_cameras
from thalweg.images.sfm.compare import compare_pairs, joined_parts, planned
from thalweg.images.sfm.features import Features
from thalweg.images.sfm.matching import Matches, MatchSettings
from thalweg.images.sfm.pairs import PairSettings, image_pairs, order_in_time
from thalweg.ingest.photos.files import Images


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What is known of images beforehand; all of it may be absent.

    Parameters
    ----------
    cameras : interior orientations, told apart by the size of their pictures.
    of_folder : interior orientations of the cameras of folders, by the folder's name.
    t_s : times by name, any scale.
    trajectory : of the boat on the scale of these times; its positions stand for those of the camera.
    """

    cameras: tuple[Camera, ...] = ()
    of_folder: Mapping[str, Camera] = field(default_factory=dict)
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
        table = read_parquet(path)
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


def plan_matches(
    features: Features,
    images: Images,
    *,
    known: Known | None = None,
    section: Mapping[str, Any] | None = None,
) -> Matches:
    """Choose the pairs of images, and the interior orientation that each image begins with.

    Parameters
    ----------
    features : of all images.
    images : by name or as files: EXIF tells cameras apart, and without a given one the focal length.
    known : interior orientations, times, trajectory.
    section : section ``images.mapping`` of a campaign file; None: its defaults.

    Raises
    ------
    InputError : fewer than two images can take part, or no image is of a given camera's size.
    GeometryError : pairs by position are wanted without positions.
    """
    given = known or Known()
    files = named_once(images)
    pairing = PairSettings.from_section(section) if section else PairSettings()
    interiors = Interiors(cameras=given.cameras, of_folder=given.of_folder)
    by = str(section["cameras"]) if section else "auto"
    found = assign_cameras(
        features.pictures,
        files,
        cameras_of(_of_block(files, features.pictures), by, tuple(given.of_folder)),
        interiors,
        lens=str(section["lens"]) if section else "auto",
        interior=str(section["interior"]) if section else "auto",
    )
    pictures = found.pictures
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
        "interior": [f"{s.source}, {s.lens}, {s.camera.parameters[0]:.1f} px" for s in found.starts],
        "notes": [*notes, *_notes(pictures), *found.notes],
    }
    return planned(
        replace(features, pictures=pictures),
        pairs,
        order=order,
        starts=found.starts,
        camera=found.camera,
        facts=facts,
    )


def match_images(
    features: Features,
    images: Images,
    *,
    known: Known | None = None,
    section: Mapping[str, Any] | None = None,
    threads: int = 1,
) -> Matches:
    """Choose the pairs of images and find what they have in common, all in one part.

    Parameters
    ----------
    features, images, known, section : as of `plan_matches`.
    threads : pairs that are worked on at the same time.

    Raises
    ------
    InputError, GeometryError : as of `plan_matches`.
    """
    plan = plan_matches(features, images, known=known, section=section)
    settings = MatchSettings.from_section(section) if section else MatchSettings()
    rows = np.arange(len(plan.pairs))
    return joined_parts(
        plan, [compare_pairs(plan, features.descriptor, rows, settings=settings, threads=threads)]
    )


def _of_block(files: Mapping[str, Path], pictures: Sequence[Picture]) -> dict[str, Path]:
    """Files of the images whose features are known; one that has been moved away is asked for nothing."""
    return {picture.name: files.get(picture.name, Path(picture.name)) for picture in pictures}


def _positions(t_s: ArrayF, trajectory: Trajectory | None) -> ArrayF | None:
    if trajectory is None or not np.isfinite(t_s).any():
        return None
    out = np.full((len(t_s), 3), np.nan)
    timed = np.flatnonzero(np.isfinite(t_s))
    position, _, valid = trajectory.at(t_s[timed])
    out[timed[valid]] = position[valid]
    return out


def _notes(pictures: Sequence[Picture]) -> list[str]:
    notes = []
    other = [picture.name for picture in pictures if picture.cause == "size"]
    if other:
        notes.append(f"{len(other)} images, such as {other[0]}, are not of the size of the given camera")
    doubles = [picture.name for picture in pictures if picture.cause == "double"]
    if doubles:
        notes.append(f"{len(doubles)} images, such as {doubles[0]}, are the same files as others: left out")
    return notes
