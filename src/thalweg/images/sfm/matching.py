"""What pairs of images have in common: which are compared, with what start, and the common points."""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from thalweg.calibration import read_camera
from thalweg.core import ArrayF, ArrayI, Camera, GeometryError, InputError, Trajectory, read_parquet
from thalweg.images.model import (
    ImageCamera,
    Picture,
    camera_note,
    camera_of_record,
    camera_record,
    cameras_of,
    named_once,
    read_arrays,
    with_problem,
    write_arrays,
)
from thalweg.images.sfm.colmap import (
    SEED,
    StartCamera,
    cameras_by_size,
    colmap,
    focal_from_exif,
    start_given,
    start_guessed,
    to_colmap,
    uses_gpu,
)
from thalweg.images.sfm.features import Features, join_features
from thalweg.ingest.photos import Images, named_images, natural_key
from thalweg.settings.sections import MappingSettings

_FORMAT: Final = 1
_EXHAUSTIVE_UP_TO: Final = 30
"""Images that are all compared with each other."""
GEOMETRY: Final = ("F", "E", "H", "pose")
"""Matrices of a pair of images, in this order."""

_UNLIKE: Final = 1.08
"""Ratio of calibrated and stated focal length beyond which a note says so; EXIF rounds to millimetres."""
_OTHER_LENS: Final = 1.25
"""Ratio of calibrated and stated focal length beyond which they are not of one lens."""


# ---------------------------------------------------------------- the input of the mapper


@dataclass(frozen=True, slots=True, kw_only=True)
class Matches:
    """Images, their features without descriptors, and what pairs of images have in common.

    Parameters
    ----------
    pictures : i images in natural order of their names, those with problems included.
    order : (o,) images that take part, in time.
    starts : interior orientations to begin with.
    camera : (i,) index into ``starts``; -1 for images that take no part.
    start, place : features as of `Features`.
    pairs : (m, 2) images that were compared.
    n_matches : (m,) matches before the geometry was asked.
    config : (m,) COLMAP's kind of the geometry, 0 for pairs without one.
    geometry : (m, 4, 3, 4) fundamental, essential matrix, homography (each in the first three columns) and
        pose of the second in the first camera; NaN where absent.
    pair_start : (m + 1,) common points of pair k are rows ``pair_start[k]`` to ``pair_start[k + 1]``.
    common : (c, 2) features in the first and in the second image, counted within each image.
    facts : JSON-able facts and notes.
    """

    pictures: tuple[Picture, ...]
    order: ArrayI
    starts: tuple[StartCamera, ...]
    camera: ArrayI
    start: ArrayI
    place: NDArray[np.float32]
    pairs: ArrayI
    n_matches: ArrayI
    config: ArrayI
    geometry: NDArray[np.float64]
    pair_start: ArrayI
    common: NDArray[np.uint32]
    facts: dict[str, Any]

    @property
    def n_common(self) -> ArrayI:
        """(m,) common points of each pair."""
        return np.diff(self.pair_start)

    def scale(self) -> float:
        """Pixels of the image for one of the picture in which features were looked for."""
        longest = max((max(self.pictures[k].size_px) for k in self.order), default=1)
        return max(1.0, longest / float(self.facts["max_size_px"]))

    def write(self, path: Path) -> None:
        """Write as ``.npz``; the same matches give the same bytes."""
        starts = [
            {**camera_record(s.camera), "lens": s.lens, "known": s.known, "source": s.source}
            for s in self.starts
        ]
        pictures = [asdict(picture) for picture in self.pictures]
        head = {"pictures": pictures, "starts": starts, "facts": self.facts}
        names = [n for n in self.__dataclass_fields__ if n not in head]
        write_arrays(path, "image_matches", _FORMAT, head, {name: getattr(self, name) for name in names})

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read matches written by `write`.

        Raises
        ------
        InputError : no such file, or of another kind or version.
        """
        head, arrays = read_arrays(path, "image_matches", _FORMAT)
        starts = tuple(
            StartCamera(camera=camera_of_record(s), lens=s["lens"], known=s["known"], source=s["source"])
            for s in head["starts"]
        )
        pictures = tuple(Picture(**{**p, "size_px": tuple(p["size_px"])}) for p in head["pictures"])
        return cls(pictures=pictures, starts=starts, facts=head["facts"], **arrays)


# ---------------------------------------------------------------- from a campaign's files to the plan that
# all parts share


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchInputs:
    """Files of a campaign: features in parts, images, and what is known beforehand, each possibly absent.

    ``interiors`` are those of the cameras of folders, by the folder's name.
    """

    features: Sequence[Path]
    images: Sequence[Path]
    camera: Sequence[Path] = ()
    interiors: Mapping[str, Path] = field(default_factory=dict)
    times: Sequence[Path] = ()
    trajectory: Sequence[Path] = ()


def plan_of(
    inputs: MatchInputs, section: MappingSettings, *, descriptors: bool = True
) -> tuple[Matches, NDArray[np.uint8]]:
    """Pairs of images to compare, and the descriptors (n, 128) of all features.

    Parameters
    ----------
    inputs : the files.
    section : section ``images.mapping``.
    descriptors : false: none are read, they take most of the memory.

    Raises
    ------
    InputError : a file that cannot be used; else as of `plan_matches`.
    """
    features = join_features([Features.read(path, descriptors=descriptors) for path in inputs.features])
    known = Known(
        cameras=tuple(read_camera(path) for path in inputs.camera),
        of_folder={folder: read_camera(path) for folder, path in inputs.interiors.items()},
        t_s=read_times(inputs.times[0]) if inputs.times else {},
        trajectory=Trajectory.read(inputs.trajectory[0]) if inputs.trajectory else None,
    )
    plan = plan_matches(features, named_images(list(inputs.images)), known=known, section=section)
    return plan, features.descriptor


# ---------------------------------------------------------------- plan


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
    features: Features, images: Images, *, known: Known | None = None, section: MappingSettings | None = None
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
    wanted = section or MappingSettings()
    found = assign_cameras(
        features.pictures,
        files,
        cameras_of(_of_block(files, features.pictures), wanted.cameras, tuple(given.of_folder)),
        given,
        lens=wanted.lens,
        interior=wanted.interior,
    )
    pictures = found.pictures
    names = [picture.name for picture in pictures]
    t_s = np.array([given.t_s.get(name, np.nan) for name in names])
    order, notes = order_in_time(names, t_s)
    order = order[np.array([not pictures[k].problem for k in order], bool)]
    position_m = _positions(t_s, given.trajectory)
    pairs, kind = image_pairs(order, wanted, position_m)
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
    section: MappingSettings | None = None,
    threads: int = 1,
    device: str = "auto",
) -> Matches:
    """Choose the pairs of images and find what they have in common, all in one part.

    Parameters
    ----------
    features, images, known, section : as of `plan_matches`.
    threads, device : as of `compare_pairs`.

    Raises
    ------
    InputError, GeometryError : as of `plan_matches`.
    """
    plan = plan_matches(features, images, known=known, section=section)
    settings = section or MappingSettings()
    rows = np.arange(len(plan.pairs))
    compared = compare_pairs(
        plan, features.descriptor, rows, settings=settings, threads=threads, device=device
    )
    return joined_parts(plan, [compared])


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


# ---------------------------------------------------------------- interior orientations to begin with, and
# which one each image has


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
    given: Known,
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
                f"and {stated:.0f} px by the EXIF of the images",
                where="" if path is None else path.name,
                expected="the calibration of this camera at this zoom",
                cure="Name the right calibration (logs.time_lapse.interior, mounts.calibration), or none: "
                "the interior orientation is then estimated",
            )
        del kept[key]
        notes.append(
            f"{groups[key[0]].name}: {len(groups[key[0]].images)} images with a focal length of "
            f"{stated:.0f} px by EXIF are not of the given interior orientation "
            f"({camera.parameters[0]:.0f} px): theirs is estimated"
        )
    return kept, notes


# ---------------------------------------------------------------- which images are compared with which:
# neighbours in time, neighbours in space, or all with all


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
    order: ArrayI, settings: MappingSettings, position_m: ArrayF | None = None
) -> tuple[ArrayI, str]:
    """Pairs of images to compare.

    Parameters
    ----------
    order : (n,) images in time; images that are not listed are in no pair.
    settings : see `MappingSettings`.
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
    if kind == "spatial" and not placed:
        raise GeometryError(
            "pairs by position, but no image has an approximate position",
            expected="positions of the images",
            where="images.mapping.pairs",
            cure="Choose sequential or exhaustive, or give the times of the images",
        )
    if kind == "auto":
        kind = "exhaustive" if n <= _EXHAUSTIVE_UP_TO else "spatial" if placed else "sequential"
    if kind == "exhaustive":
        return _sorted(order, np.column_stack(np.triu_indices(n, 1))), kind
    steps = list(range(1, settings.overlap + 1))
    if settings.quadratic:
        steps += [2**k for k in range(settings.overlap) if 2**k < n]
    found = [np.column_stack([np.arange(n - s), np.arange(s, n)]) for s in sorted(set(steps)) if s < n]
    if kind == "spatial" and position_m is not None:
        found.append(_near(position_m[order], settings))
    return _sorted(order, np.concatenate([np.zeros((0, 2), np.int64), *found])), kind


def _near(position_m: ArrayF, settings: MappingSettings) -> ArrayI:
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


# ---------------------------------------------------------------- common points of pairs of images
#
# The pairs may be dealt out to jobs. What two images have in common depends on these two alone: the samples
# of RANSAC begin with the same seed for each pair, and an image has the same number in each job's database.
# Any number of parts therefore gives the same matches, bit by bit.


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedPairs:
    """Some pairs of a block, compared; fields as of `Matches`."""

    pairs: ArrayI
    n_matches: ArrayI
    config: ArrayI
    geometry: NDArray[np.float64]
    pair_start: ArrayI
    common: NDArray[np.uint32]

    def write(self, path: Path) -> None:
        """Write as ``.npz``; the same pairs give the same bytes."""
        arrays = {name: getattr(self, name) for name in self.__dataclass_fields__}
        write_arrays(path, "compared_pairs", _FORMAT, {}, arrays)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read pairs written by `write`.

        Raises
        ------
        InputError : no such file, or of another kind or version.
        """
        return cls(**read_arrays(path, "compared_pairs", _FORMAT)[1])


def planned(
    features: Features,
    pairs: ArrayI,
    *,
    order: ArrayI,
    starts: Sequence[StartCamera],
    camera: ArrayI,
    facts: Mapping[str, Any] | None = None,
) -> Matches:
    """Pairs that are to be compared, without what they have in common.

    Parameters
    ----------
    features : of all images.
    pairs : (m, 2) images to compare, the smaller index first.
    order : (o,) images that take part, in time.
    starts, camera : interior orientations, and which one each image has (-1: takes no part).
    facts : what else is to be known of the pairs.

    Raises
    ------
    InputError : fewer than two images take part.
    """
    if len(order) < 2:
        problems = [f"{p.name}: {p.problem}" for p in features.pictures if p.problem]
        more = f" and {len(problems) - 3} more" if len(problems) > 3 else ""
        raise InputError(
            f"{len(order)} of {len(features.pictures)} images can take part"
            + (f" ({'; '.join(problems[:3])}{more})" if problems else ""),
            expected="at least two images with features",
            cure="Look at the images and their masks",
        )
    return Matches(
        pictures=features.pictures,
        order=np.asarray(order, np.int64),
        starts=tuple(starts),
        camera=np.asarray(camera, np.int64),
        start=features.start,
        place=features.place,
        pairs=np.asarray(pairs, np.int64).reshape(-1, 2),
        n_matches=np.zeros(len(pairs), np.int64),
        config=np.zeros(len(pairs), np.int64),
        geometry=np.full((len(pairs), len(GEOMETRY), 3, 4), np.nan),
        pair_start=np.zeros(len(pairs) + 1, np.int64),
        common=np.zeros((0, 2), np.uint32),
        facts={**(facts or {}), "max_size_px": features.settings.max_size_px},
    )


def part_of_pairs(plan: Matches, part: int, parts: int) -> ArrayI:
    """Rows of the pairs of part 0, 1 ... of ``parts``.

    Pairs stand in the order of their images, and a part is a run of them: it needs the descriptors of few
    images. A pair costs the product of its images' features; the parts cost about the same.

    Raises
    ------
    InputError : no such part.
    """
    if not 0 <= part < parts:
        raise InputError(f"part {part}", expected=f"0 to {parts - 1}")
    n = np.diff(plan.start)
    cost = n[plan.pairs[:, 0]] * n[plan.pairs[:, 1]]
    middle = np.cumsum(cost) - cost / 2
    place = np.floor(middle / max(int(cost.sum()), 1) * parts).astype(np.int64)
    return np.flatnonzero(np.minimum(place, parts - 1) == part)


def compare_pairs(
    plan: Matches,
    descriptor: NDArray[np.uint8],
    rows: ArrayI,
    *,
    settings: MappingSettings | None = None,
    threads: int = 1,
    device: str = "auto",
) -> ComparedPairs:
    """Compare some of the pairs; the number of threads changes the time alone.

    Parameters
    ----------
    plan : the block, as of `planned`.
    descriptor : (n, 128) of all features.
    rows : of the pairs to compare.
    settings : see `MappingSettings`.
    threads : pairs that are worked on at the same time.
    device : ``images.device``.

    Raises
    ------
    InputError : ``cuda`` without it.
    """
    pairs, on_gpu = plan.pairs[rows], uses_gpu(device)
    with tempfile.TemporaryDirectory(prefix="thalweg-matches-") as temporary:
        path = Path(temporary) / "block.db"
        fill_database(path, plan, descriptor=descriptor, images=np.unique(pairs).tolist())
        listed = Path(temporary) / "pairs.txt"
        listed.write_text("".join(f"{a} {b}\n" for a, b in pairs))
        if len(pairs):
            _run_matching(path, listed, settings or MappingSettings(), plan.scale(), threads, on_gpu)
        return _collected(path, pairs)


def joined_parts(plan: Matches, parts: Sequence[ComparedPairs]) -> Matches:
    """The block with what all parts found, pairs in the order of the plan.

    Raises
    ------
    InputError : the parts together are not the pairs of the plan, each once.
    """
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *(part.pairs for part in parts)])
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    wanted = np.lexsort((plan.pairs[:, 1], plan.pairs[:, 0]))
    if not np.array_equal(pairs[order], plan.pairs[wanted]):
        raise InputError(
            f"{len(pairs)} compared pairs of images in {len(parts)} parts",
            expected=f"the {len(plan.pairs)} pairs of the block, each once",
            cure="Compare all parts again with the same images and settings",
        )
    place = np.empty(len(order), np.int64)
    place[wanted] = order
    counts = np.concatenate([np.zeros(0, np.int64), *(np.diff(part.pair_start) for part in parts)])
    first = np.concatenate([[0], np.cumsum(counts)])
    common = np.concatenate([np.zeros((0, 2), np.uint32), *(part.common for part in parts)])
    rows = [np.zeros(0, np.int64), *(np.arange(first[k], first[k + 1]) for k in place)]
    return replace(
        plan,
        n_matches=np.concatenate([part.n_matches for part in parts])[place],
        config=np.concatenate([part.config for part in parts])[place],
        geometry=np.concatenate([part.geometry for part in parts])[place],
        pair_start=np.concatenate([[0], np.cumsum(counts[place])]).astype(np.int64),
        common=common[np.concatenate(rows)],
    )


def _run_matching(
    path: Path, listed: Path, settings: MappingSettings, scale: float, threads: int, on_gpu: bool
) -> None:
    pc = colmap()
    how = pc.FeatureMatchingOptions()
    how.use_gpu = on_gpu
    how.num_threads = max(1, threads)
    which = pc.ImportedPairingOptions()
    which.match_list_path = listed
    check = pc.TwoViewGeometryOptions()
    check.min_num_inliers = settings.min_inliers
    check.ransac.random_seed = SEED
    check.ransac.max_error = settings.max_error_px * scale
    # a second plane or a moving thing never makes a pair of images: what is not rigid is left out
    check.detect_watermark = False
    check.compute_relative_pose = True
    pc.match_image_pairs(path, how, which, check, pc.Device.cuda if on_gpu else pc.Device.cpu)


def _collected(path: Path, pairs: ArrayI) -> ComparedPairs:
    pc = colmap()
    n = len(pairs)
    n_matches, config = np.zeros(n, np.int64), np.zeros(n, np.int64)
    geometry = np.full((n, len(GEOMETRY), 3, 4), np.nan)
    common: list[NDArray[np.uint32]] = []
    with pc.Database.open(path) as database:
        for k, (a, b) in enumerate(pairs.tolist()):
            first, second = a + 1, b + 1
            if database.exists_matches(first, second):
                n_matches[k] = len(database.read_matches(first, second))
            found = (
                database.read_two_view_geometry(first, second)
                if database.exists_two_view_geometry(first, second)
                else None
            )
            inliers = np.zeros((0, 2), np.uint32)
            if found is not None and len(found.inlier_matches):
                inliers = np.asarray(found.inlier_matches, np.uint32)
                config[k] = int(found.config)
                for i, matrix in enumerate((found.F, found.E, found.H)):
                    if matrix is not None:
                        geometry[k, i, :, :3] = matrix
                if found.cam2_from_cam1 is not None:
                    geometry[k, 3] = found.cam2_from_cam1.matrix()
            common.append(inliers)
    return ComparedPairs(
        pairs=pairs,
        n_matches=n_matches,
        config=config,
        geometry=geometry,
        pair_start=np.concatenate([[0], np.cumsum([len(c) for c in common])]).astype(np.int64),
        common=np.concatenate([np.zeros((0, 2), np.uint32), *common]),
    )


# ---------------------------------------------------------------- COLMAP's database of a block
#
# Image k of a block has the number k + 1 and the name ``k``: names of files may hold blanks, which COLMAP's
# lists of pairs do not bear.


def fill_database(
    path: Path,
    block: Matches,
    *,
    descriptor: NDArray[np.uint8] | None = None,
    images: Iterable[int] | None = None,
) -> list[str]:
    """Write the images that take part, their features and, where they are known, the geometries of pairs.

    Parameters
    ----------
    path : of the database; must not exist.
    block : images, features and pairs.
    descriptor : (n, 128) of the features, if pairs are still to be compared.
    images : those that are written; None: all that take part.

    Returns
    -------
    notes : differences between a camera and its model in COLMAP above a hundredth of a pixel.
    """
    pc = colmap()
    notes = []
    with pc.Database.open(path) as database:
        for key, start in enumerate(block.starts, start=1):
            camera, error_px = to_colmap(start, key)
            if error_px > 0.01:
                notes.append(
                    f"camera {start.camera.name!r} as {start.lens} differs by up to {error_px:.2f} px"
                )
            database.write_camera(camera, use_camera_id=True)
            rig = pc.Rig(rig_id=key)
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
        for k in sorted(block.order.tolist() if images is None else images):
            _write_image(pc, database, block, k)
            rows = slice(int(block.start[k]), int(block.start[k + 1]))
            database.write_keypoints(k + 1, np.ascontiguousarray(block.place[rows, :2]))
            if descriptor is not None:
                kind = pc.FeatureExtractorType.SIFT
                database.write_descriptors(
                    k + 1, pc.FeatureDescriptors(kind, np.ascontiguousarray(descriptor[rows]))
                )
        for m in np.flatnonzero(block.n_common).tolist():
            a, b = block.pairs[m].tolist()
            database.write_two_view_geometry(a + 1, b + 1, _geometry(pc, block, m))
    return notes


def _write_image(pc: Any, database: Any, block: Matches, k: int) -> None:
    camera = int(block.camera[k]) + 1
    image = pc.Image(name=str(k), camera_id=camera, image_id=k + 1)
    frame = pc.Frame(frame_id=k + 1, rig_id=camera)
    frame.add_data_id(image.data_id)
    database.write_image(image, use_image_id=True)
    database.write_frame(frame, use_frame_id=True)


def _geometry(pc: Any, block: Matches, m: int) -> Any:
    made = pc.TwoViewGeometry()
    made.config = int(block.config[m])
    F, E, H, pose = block.geometry[m]
    for name, matrix in (("F", F), ("E", E), ("H", H)):
        if np.isfinite(matrix[:, :3]).all():
            setattr(made, name, matrix[:, :3])
    if np.isfinite(pose).all():
        made.cam2_from_cam1 = pc.Rigid3d(pose)
    made.inlier_matches = block.common[block.pair_start[m] : block.pair_start[m + 1]]
    return made
