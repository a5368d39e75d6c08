"""Common points of pairs of images: descriptors compared, then held against the geometry of two views.

The pairs may be dealt out to jobs. What two images have in common depends on these two alone: the samples of
RANSAC begin with the same seed for each pair, and an image has the same number in each job's database. Any
number of parts therefore gives the same matches, bit by bit.
"""

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayI
from thalweg.images.sfm.camera import StartCamera
from thalweg.images.sfm.colmap import SEED, colmap
from thalweg.images.sfm.database import fill_database
from thalweg.images.sfm.features import Features, read_arrays
from thalweg.images.sfm.matching import GEOMETRY, Matches, MatchSettings

_FORMAT: Final = 1


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
        head = {"kind": "compared_pairs", "version": _FORMAT}
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            np.savez_compressed(
                file,
                head=np.array(json.dumps(head)),
                **{name: getattr(self, name) for name in self.__dataclass_fields__},
            )

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
    settings: MatchSettings | None = None,
    threads: int = 1,
) -> ComparedPairs:
    """Compare some of the pairs; the number of threads changes the time alone.

    Parameters
    ----------
    plan : the block, as of `planned`.
    descriptor : (n, 128) of all features.
    rows : of the pairs to compare.
    settings : see `MatchSettings`.
    threads : pairs that are worked on at the same time.
    """
    pairs = plan.pairs[rows]
    with tempfile.TemporaryDirectory(prefix="thalweg-matches-") as temporary:
        path = Path(temporary) / "block.db"
        fill_database(path, plan, descriptor=descriptor, images=np.unique(pairs).tolist())
        listed = Path(temporary) / "pairs.txt"
        listed.write_text("".join(f"{a} {b}\n" for a, b in pairs))
        if len(pairs):
            _run_matching(path, listed, settings or MatchSettings(), plan.scale(), threads)
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


def _run_matching(path: Path, listed: Path, settings: MatchSettings, scale: float, threads: int) -> None:
    pc = colmap()
    how = pc.FeatureMatchingOptions()
    how.use_gpu = False
    how.num_threads = max(1, threads)
    how.sift.max_ratio = settings.max_ratio
    which = pc.ImportedPairingOptions()
    which.match_list_path = listed
    check = pc.TwoViewGeometryOptions()
    check.min_num_inliers = settings.min_inliers
    check.ransac.random_seed = SEED
    check.ransac.max_error = settings.max_error_px * scale
    # a second plane or a moving thing never makes a pair of images: what is not rigid is left out
    check.detect_watermark = False
    check.compute_relative_pose = True
    pc.match_image_pairs(path, how, which, check, pc.Device.cpu)


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
