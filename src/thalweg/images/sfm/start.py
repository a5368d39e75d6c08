"""From features to matches: order in time, approximate positions, interior orientations to begin with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self

import numpy as np
import pyarrow as pa
from scipy.spatial import cKDTree

from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.tables import read_parquet
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF, ArrayI
from thalweg.images.model.cameras import ImageCamera, camera_note, cameras_of
from thalweg.images.model.files import Picture, named_once, with_problem
from thalweg.images.sfm.camera import (
    StartCamera,
    cameras_by_size,
    focal_from_exif,
    start_given,
    start_guessed,
)
from thalweg.images.sfm.compare import compare_pairs, joined_parts, planned
from thalweg.images.sfm.features import Features
from thalweg.images.sfm.matching import Matches, MatchSettings
from thalweg.ingest.photos.files import Images
from thalweg.ingest.photos.stamps import natural_key

# ---------------------------------------------------------------- interior orientations to begin with, and
# which one each image has


_UNLIKE: Final = 1.08
"""Ratio of calibrated and stated focal length beyond which a note says so; EXIF rounds to millimetres."""
_OTHER_LENS: Final = 1.25
"""Ratio of calibrated and stated focal length beyond which they are not of one lens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Interiors:
    """Given interior orientations: ``cameras`` told apart by the size of their pictures, and those
    ``of_folder`` for the images in a folder and below it. Either may be empty.
    """

    cameras: tuple[Camera, ...] = ()
    of_folder: Mapping[str, Camera] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Assigned:
    """Starts ``starts``, index ``camera`` (i,) of each image into them (-1: takes no part), ``pictures`` with
    the problems that came up, and ``notes``.
    """

    starts: tuple[StartCamera, ...]
    camera: ArrayI
    pictures: tuple[Picture, ...]
    notes: list[str]


def assign_cameras(
    pictures: Sequence[Picture],
    images: Mapping[str, Path],
    groups: Sequence[ImageCamera],
    given: Interiors,
    *,
    lens: str = "auto",
    interior: str = "auto",
) -> Assigned:
    """A start for each camera and each size of its pictures: as given, else by EXIF, else a guess.

    A camera whose focal length by EXIF contradicts the common interior orientation, while that of another
    camera does not, is another lens or zoom: its own focal length is the start.

    Parameters
    ----------
    pictures : of all images.
    images : their files by name.
    groups : which images one camera took.
    lens, interior : settings of the section ``images.mapping``.

    Raises
    ------
    InputError : no image is of a given camera's size; EXIF contradicts the given interior orientation; or it
        shall stay fixed, and none is given.
    """
    out, camera = list(pictures), np.full(len(pictures), -1, np.int64)
    at = {picture.name: k for k, picture in enumerate(pictures)}
    good = [(g, k) for g, group in enumerate(groups) for k in sorted(at[n] for n in group.images if n in at)]
    good = [(g, k) for g, k in good if not pictures[k].problem]
    size_of = {k: pictures[k].size_px for _, k in good}
    common = sorted(k for g, k in good if not groups[g].folder)
    by_size: dict[int, int] = {}
    if given.cameras and common:
        found, reasons = cameras_by_size([size_of[k] for k in common], given.cameras)
        by_size = dict(zip(common, found, strict=True))
        for k, reason in zip(common, reasons, strict=True):
            out[k] = with_problem(out[k], reason, "size") if reason else out[k]
    rows: dict[tuple[int, tuple[int, int]], list[int]] = {}
    for g, k in good:
        if not out[k].problem:
            rows.setdefault((g, size_of[k]), []).append(k)
    known: dict[tuple[int, tuple[int, int]], Camera] = {}
    for (g, size), some in rows.items():
        if groups[g].folder:
            own, reason = _scaled(given.of_folder[groups[g].folder], size)
            for k in some:
                out[k] = with_problem(out[k], reason, "size") if reason else out[k]
            if own is not None:
                known[g, size] = own
        elif given.cameras:
            known[g, size] = given.cameras[by_size[some[0]]]
    rows = {key: some for key, some in rows.items() if not out[some[0]].problem}
    paths = {key: images.get(out[some[0]].name) for key, some in rows.items()}
    known, notes = _agreeing(known, paths, groups)
    starts: list[StartCamera] = []
    for key in sorted(rows, key=lambda key: rows[key][0]):
        some, c = rows[key], len(starts)
        camera[some] = c
        if key in known:
            start = start_given(known[key], lens, fixed=interior != "estimated")
        elif interior == "fixed":
            raise InputError(
                f"the interior orientation shall stay as given, but none is given for {out[some[0]].name}",
                expected="a calibrated camera",
                where="images.mapping.interior",
                cure="Give an interior orientation, or choose estimated",
            )
        else:
            start = start_guessed(paths[key] or Path(out[some[0]].name), key[1], lens)
        starts.append(_named(start, key[0], groups, [s.camera.name for s in starts], given=key in known))
    sizes = {size for _, size in rows}
    if len(groups) == 1 and len(sizes) > 1 and not given.cameras:
        notes.append(f"images of {len(sizes)} sizes: each size has an interior orientation of its own")
    told = camera_note([group for g, group in enumerate(groups) if any(g == key[0] for key in rows)])
    return Assigned(
        starts=tuple(starts), camera=camera, pictures=tuple(out), notes=[*([told] if told else []), *notes]
    )


def _named(
    start: StartCamera, g: int, groups: Sequence[ImageCamera], taken: Sequence[str], *, given: bool
) -> StartCamera:
    """A start with a name of its own: that of the given camera, else of the group, with a number if taken."""
    base = start.camera.name if given and len(groups) == 1 else groups[g].name
    name, n = base, 1
    while name in taken:
        n += 1
        name = f"{base}_{n}"
    return replace(start, camera=replace(start.camera, name=name))


def _scaled(camera: Camera, size_px: tuple[int, int]) -> tuple[Camera | None, str]:
    if camera.size_px == size_px:
        return camera, ""
    try:
        return camera.scaled(size_px), ""
    except GeometryError:
        w, h = camera.size_px
        return None, f"{size_px[0]} x {size_px[1]} pixels, the camera has {w} x {h}"


def _agreeing(
    known: Mapping[tuple[int, tuple[int, int]], Camera],
    paths: Mapping[tuple[int, tuple[int, int]], Path | None],
    groups: Sequence[ImageCamera],
) -> tuple[dict[tuple[int, tuple[int, int]], Camera], list[str]]:
    """Given cameras whose focal length is about the one that the EXIF of one of their images states.

    EXIF rounds to whole millimetres, which explains some percent.

    Returns
    -------
    known : without those that are of another lens, where another camera is of the given one.
    notes : differences that rounding hardly explains.

    Raises
    ------
    InputError : another lens or zoom.
    """
    ratio: dict[tuple[int, tuple[int, int]], tuple[float, float]] = {}
    for key, camera in known.items():
        path = paths.get(key)
        stated = None if path is None or camera.model == "fisheye" else focal_from_exif(path)
        if stated is not None:
            ratio[key] = float(camera.parameters[0] / stated), stated
    kept, notes = dict(known), []
    for key, (off, stated) in ratio.items():
        camera = known[key]
        if 1 / _UNLIKE < off < _UNLIKE:
            continue
        if 1 / _OTHER_LENS < off < _OTHER_LENS:
            notes.append(
                f"the focal length of {camera.name} is {camera.parameters[0]:.0f} px, EXIF states "
                f"{stated:.0f} px: is the calibration that of this camera and zoom?"
            )
            continue
        fits = any(
            other is camera and k in ratio and 1 / _OTHER_LENS < ratio[k][0] < _OTHER_LENS
            for k, other in known.items()
        )
        if not fits:
            path = paths[key]
            raise InputError(
                f"a focal length of {camera.parameters[0]:.0f} px in the interior orientation {camera.name}, "
                f"and {stated:.0f} px by the EXIF of the images", where="" if path is None else path.name,
                expected="the calibration of this camera at this zoom",
                cure="Name the right calibration (logs.time_lapse.interior, mounts.calibration), or none: "
                "the interior orientation is then estimated",
            )  # fmt: skip
        del kept[key]
        notes.append(
            f"{groups[key[0]].name}: {len(groups[key[0]].images)} images with a focal length of "
            f"{stated:.0f} px by EXIF are not of the given interior orientation "
            f"({camera.parameters[0]:.0f} px): theirs is estimated"
        )
    return kept, notes


# ---------------------------------------------------------------- which images are compared with which:
# neighbours in time, neighbours in space, or all with all


KINDS: Final = ("auto", "sequential", "spatial", "exhaustive")


@dataclass(frozen=True, slots=True, kw_only=True)
class PairSettings:
    """Settings of the pairs; names, units and defaults as in section ``images.mapping``."""

    pairs: str = "auto"
    exhaustive_up_to: int = 30
    overlap: int = 10
    quadratic: bool = True
    max_distance_m: float = 15.0
    max_neighbours: int = 20

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From the section ``images.mapping`` of a campaign file."""
        return cls(**{name: section[name] for name in cls.__dataclass_fields__})


def order_in_time(names: Sequence[str], t_s: ArrayF | None = None) -> tuple[ArrayI, list[str]]:
    """Order of the images, and what is to be said about it.

    Images without time stand behind the one whose name precedes theirs; without any time the order is the
    natural one of the names.

    Parameters
    ----------
    names : n file names.
    t_s : (n,) times, NaN where unknown.

    Returns
    -------
    order : (n,) indices.
    notes : for the report.
    """
    by_name = np.array(sorted(range(len(names)), key=lambda k: natural_key(names[k])), np.int64)
    if t_s is None or not np.isfinite(t_s).any():
        return by_name, []
    t = np.asarray(t_s, np.float64)[by_name]
    notes = []
    unknown = ~np.isfinite(t)
    if unknown.any():
        first = names[by_name[np.flatnonzero(unknown)[0]]]
        notes.append(f"{unknown.sum()} images without time, such as {first}, are placed by their names")
        known = np.where(unknown, -1, np.arange(len(t)))
        before = np.maximum.accumulate(known)
        t = np.where(before >= 0, t[before], -np.inf)
    folder = np.array([str(PurePosixPath(names[k]).parent) for k in by_name], dtype=object)[~unknown]
    back = int(((np.diff(t[~unknown]) < 0) & (folder[1:] == folder[:-1])).sum())
    if back:
        notes.append(f"names do not follow time at {back} places: the order in time counts")
    return by_name[np.argsort(t, kind="stable")], notes


def image_pairs(
    order: ArrayI, settings: PairSettings, position_m: ArrayF | None = None
) -> tuple[ArrayI, str]:
    """Pairs of images to compare.

    Parameters
    ----------
    order : (n,) images in time; images that are not listed are in no pair.
    settings : see `PairSettings`.
    position_m : (all, 3) approximate positions of all images in any metric frame, NaN where unknown.

    Returns
    -------
    pairs : (m, 2) images, the smaller index first, sorted, each pair once.
    kind : exhaustive, sequential or spatial.

    Raises
    ------
    GeometryError : spatial pairs are wanted, but no position is known.
    """
    n = len(order)
    placed = position_m is not None and np.isfinite(position_m[order]).all(axis=1).any()
    kind = settings.pairs
    if kind not in KINDS:
        raise GeometryError(f"pairs: {kind}", expected=f"one of {', '.join(KINDS)}")
    if kind == "spatial" and not placed:
        raise GeometryError(
            "pairs by position, but no image has an approximate position",
            expected="positions of the images",
            where="images.mapping.pairs",
            cure="Choose sequential or exhaustive, or give the times of the images",
        )
    if kind == "auto":
        kind = "exhaustive" if n <= settings.exhaustive_up_to else "spatial" if placed else "sequential"
    if kind == "exhaustive":
        return _sorted(order, np.column_stack(np.triu_indices(n, 1))), kind
    steps = list(range(1, settings.overlap + 1))
    if settings.quadratic:
        steps += [2**k for k in range(settings.overlap) if 2**k < n]
    found = [np.column_stack([np.arange(n - s), np.arange(s, n)]) for s in sorted(set(steps)) if s < n]
    if kind == "spatial" and position_m is not None:
        found.append(_near(position_m[order], settings))
    return _sorted(order, np.concatenate([np.zeros((0, 2), np.int64), *found])), kind


def _near(position_m: ArrayF, settings: PairSettings) -> ArrayI:
    """Nearest images that are not neighbours in time anyhow."""
    known = np.flatnonzero(np.isfinite(position_m).all(axis=1))
    if len(known) < 2:
        return np.zeros((0, 2), np.int64)
    most = min(settings.max_neighbours + 2 * settings.overlap + 1, len(known))
    far, near = cKDTree(position_m[known]).query(
        position_m[known], k=most, distance_upper_bound=settings.max_distance_m
    )
    # a place without neighbour is marked by the number of all places
    a = np.broadcast_to(known[:, None], near.shape)
    b = np.append(known, -1)[near]
    good = np.isfinite(far) & (b >= 0) & (np.abs(a - b) > settings.overlap)
    good &= np.cumsum(good, axis=1) <= settings.max_neighbours
    return np.column_stack([a[good], b[good]])


def _sorted(order: ArrayI, places: ArrayI) -> ArrayI:
    if not len(places):
        return np.zeros((0, 2), np.int64)
    return np.asarray(np.unique(np.sort(order[places], axis=1), axis=0), np.int64)


# ---------------------------------------------------------------- start


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
