"""Common points of pairs of images: descriptors compared, then held against the geometry of two views."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from thalweg.core.camera import Camera
from thalweg.core.errors import InputError
from thalweg.core.types import ArrayI
from thalweg.orientation.colmap import SEED, colmap
from thalweg.orientation.sfm_camera import StartCamera
from thalweg.orientation.sfm_database import fill_database
from thalweg.orientation.sfm_features import Features, read_arrays
from thalweg.orientation.sfm_images import Picture

_FORMAT: Final = 1
_GEOMETRY: Final = ("F", "E", "H", "pose")


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchSettings:
    """Settings of the matching; names, units and defaults as in section ``images.mapping``."""

    min_inliers: int = 15
    max_ratio: float = 0.8
    max_error_px: float = 2.0

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From the section ``images.mapping`` of a campaign file."""
        return cls(**{name: section[name] for name in cls.__dataclass_fields__})


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
            {
                "model": s.camera.model,
                "size_px": list(s.camera.size_px),
                "parameters": s.camera.parameters.tolist(),
                "cov": s.camera.cov.tolist(),
                "name": s.camera.name,
                "lens": s.lens,
                "known": s.known,
                "source": s.source,
            }
            for s in self.starts
        ]
        head = {
            "kind": "image_matches",
            "version": _FORMAT,
            "pictures": [asdict(picture) for picture in self.pictures],
            "starts": starts,
            "facts": self.facts,
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        names = [n for n in self.__dataclass_fields__ if n not in ("pictures", "starts", "facts")]
        with path.open("wb") as file:
            np.savez_compressed(
                file, head=np.array(json.dumps(head)), **{name: getattr(self, name) for name in names}
            )

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read matches written by `write`.

        Raises
        ------
        InputError : no such file, or of another kind or version.
        """
        head, arrays = read_arrays(path, "image_matches", _FORMAT)
        starts = tuple(
            StartCamera(
                camera=Camera(
                    model=s["model"],
                    size_px=(s["size_px"][0], s["size_px"][1]),
                    parameters=np.array(s["parameters"], np.float64),
                    cov=np.array(s["cov"], np.float64),
                    name=s["name"],
                ),
                lens=s["lens"],
                known=s["known"],
                source=s["source"],
            )
            for s in head["starts"]
        )
        pictures = tuple(Picture(**{**p, "size_px": tuple(p["size_px"])}) for p in head["pictures"])
        return cls(pictures=pictures, starts=starts, facts=head["facts"], **arrays)


def match_pairs(
    features: Features,
    pairs: ArrayI,
    *,
    order: ArrayI,
    starts: Sequence[StartCamera],
    camera: ArrayI,
    settings: MatchSettings | None = None,
    threads: int = 1,
    facts: Mapping[str, Any] | None = None,
) -> Matches:
    """Compare pairs of images; the number of threads changes the time alone.

    Parameters
    ----------
    features : of all images.
    pairs : (m, 2) images to compare, the smaller index first.
    order : (o,) images that take part, in time.
    starts, camera : interior orientations, and which one each image has (-1: takes no part).
    settings : see `MatchSettings`.
    threads : pairs that are worked on at the same time.
    facts : what else is to be known of the pairs.

    Raises
    ------
    InputError : fewer than two images take part.
    """
    use = settings or MatchSettings()
    if len(order) < 2:
        problems = [f"{p.name}: {p.problem}" for p in features.pictures if p.problem]
        more = f" and {len(problems) - 3} more" if len(problems) > 3 else ""
        raise InputError(
            f"{len(order)} of {len(features.pictures)} images can take part"
            + (f" ({'; '.join(problems[:3])}{more})" if problems else ""),
            expected="at least two images with features",
            cure="Look at the images and their masks",
        )
    told = {**(facts or {}), "max_size_px": features.settings.max_size_px}
    empty = Matches(
        pictures=features.pictures,
        order=np.asarray(order, np.int64),
        starts=tuple(starts),
        camera=np.asarray(camera, np.int64),
        start=features.start,
        place=features.place,
        pairs=np.asarray(pairs, np.int64).reshape(-1, 2),
        n_matches=np.zeros(len(pairs), np.int64),
        config=np.zeros(len(pairs), np.int64),
        geometry=np.full((len(pairs), len(_GEOMETRY), 3, 4), np.nan),
        pair_start=np.zeros(len(pairs) + 1, np.int64),
        common=np.zeros((0, 2), np.uint32),
        facts=told,
    )
    with tempfile.TemporaryDirectory(prefix="thalweg-matches-") as temporary:
        path = Path(temporary) / "block.db"
        fill_database(path, empty, descriptor=features.descriptor)
        listed = Path(temporary) / "pairs.txt"
        listed.write_text("".join(f"{a} {b}\n" for a, b in empty.pairs))
        _run_matching(path, listed, use, empty.scale(), threads)
        return _collected(path, empty)


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


def _collected(path: Path, empty: Matches) -> Matches:
    pc = colmap()
    n = len(empty.pairs)
    n_matches, config, geometry = empty.n_matches.copy(), empty.config.copy(), empty.geometry.copy()
    common: list[NDArray[np.uint32]] = []
    with pc.Database.open(path) as database:
        for k, (a, b) in enumerate(empty.pairs.tolist()):
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
    start = np.concatenate([[0], np.cumsum([len(c) for c in common])]).astype(np.int64)
    joined = np.concatenate([np.zeros((0, 2), np.uint32), *common])
    assert len(start) == n + 1
    return replace(
        empty, n_matches=n_matches, config=config, geometry=geometry, pair_start=start, common=joined
    )
