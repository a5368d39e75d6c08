"""Features of images (SIFT), found in parts that may run anywhere and are put together afterwards.

What is found in an image depends on that image and its mask alone: any split into parts, any order and any
number of threads gives the same features, bit by bit.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

from thalweg.calibration import Rig, lens_view, read_rig_masks
from thalweg.core import ArrayB, ArrayI, InputError, steps
from thalweg.images.model import (
    ImageBlock,
    LensView,
    Picture,
    at_pixels,
    find_mask,
    inspect,
    named_once,
    read_arrays,
    with_problem,
    without_doubles,
    write_arrays,
)
from thalweg.images.sfm.colmap import colmap, uses_gpu
from thalweg.ingest.photos import Images, natural_key
from thalweg.settings.sections import FeatureSettings

_FORMAT: Final = 1
WIDEST_DEG: Final = 85.0
"""Angle from the axis up to which structure from motion uses a fisheye: COLMAP has no rays from 90 on."""
RIM_DEG: Final = 95.0
"""Angle up to which a block uses it."""
_PEAK_THRESHOLD: Final = 0.0067
"""Least contrast of a feature, share of the full range."""
_WINDOW_PX: Final = 3.0
"""Distance of a feature near the rim from where a point of the block is expected."""
_RATIO: Final = 0.8
"""Of the distances of a descriptor from the best and from the second-best point (Lowe 2004)."""
_CHANCE: Final = 0.01
"""Share of pairs of different things whose descriptors are as alike as those of one thing at the rim must be:
pictures are so bent there that a descriptor has little in common with that of the same thing elsewhere."""
_MOST_BUDGET: Final = 4
_BLANK: Final = 3.0
"""Contrast, steps of 8 bits, below which an image is called blank."""
_AT_ONCE: Final = 32
"""Images whose scaled pictures lie on disk and in memory at the same time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """Features of some images.

    Parameters
    ----------
    pictures : i images in natural order of their names, those with problems included.
    start : (i + 1,) features of image k are rows ``start[k]`` to ``start[k + 1]``.
    place : (n, 3) x, y and scale, pixels of the full image from its upper left corner.
    descriptor : (n, 128).
    settings : with which they were found.
    """

    pictures: tuple[Picture, ...]
    start: ArrayI
    place: NDArray[np.float32]
    descriptor: NDArray[np.uint8]
    settings: FeatureSettings

    def rows(self, k: int) -> slice:
        """Rows of image k."""
        return slice(int(self.start[k]), int(self.start[k + 1]))

    def within(self, rig: Rig, widest_deg: float) -> ArrayB:
        """(n,) whether features of views of a rig lie so near to the axis of their lens."""
        keep = np.ones(len(self.place), np.bool_)
        for k, picture in enumerate(self.pictures):
            own = self.rows(k)
            rays = rig.cameras[picture.name.split("/", 1)[0]].rays(self.place[own, :2].astype(np.float64))
            keep[own] = rays[:, 2] > np.cos(np.deg2rad(widest_deg))
        return keep

    def chosen(self, keep: ArrayB) -> "Features":
        """Some of the features (n,), of all pictures."""
        start = np.concatenate([[0], np.cumsum(keep)])[self.start]
        return replace(self, start=start, place=self.place[keep], descriptor=self.descriptor[keep])

    def write(self, path: Path) -> None:
        """Write as ``.npz``; the same features give the same bytes."""
        head = {
            "settings": self.settings.model_dump(exclude={"parts"}),
            "pictures": [asdict(picture) for picture in self.pictures],
        }
        arrays = {"start": self.start, "place": self.place, "descriptor": self.descriptor}
        write_arrays(path, "image_features", _FORMAT, head, arrays, compressed=False)

    @classmethod
    def read(cls, path: Path, *, descriptors: bool = True) -> Self:
        """Read features written by `write`.

        Parameters
        ----------
        path : the file.
        descriptors : false: left empty, they take most of the memory.

        Raises
        ------
        InputError : no such file, or of another kind or version.
        """
        head, arrays = read_arrays(path, "image_features", _FORMAT, () if descriptors else ("descriptor",))
        arrays.setdefault("descriptor", np.zeros((0, 128), np.uint8))
        pictures = tuple(Picture(**{**p, "size_px": tuple(p["size_px"])}) for p in head["pictures"])
        return cls(pictures=pictures, settings=FeatureSettings(**head["settings"]), **arrays)


def extract_features(
    images: Images,
    *,
    masks: Path | None = None,
    settings: FeatureSettings | None = None,
    threads: int = 1,
    rig: Rig | None = None,
    device: str = "auto",
) -> Features:
    """Find the features of images; images that cannot be used stay in the result with their problem.

    COLMAP spends its number of features before anything is masked. Here an image of which a quarter is usable
    may have four times as many, and the largest of those outside the mask are kept.

    Parameters
    ----------
    images : by name or as files, in any order.
    masks : folder of masks (`find_mask`); images without a mask are used as a whole.
    settings : see `FeatureSettings`.
    threads : images that are worked on at the same time; each needs its own memory.
    rig : images are its views, named ``front/NAME`` and ``back/NAME``, of files with both; those of a fisheye
        are used to `RIM_DEG`.
    device : ``images.device``.

    Raises
    ------
    InputError : an image that stands twice, a folder of masks that does not exist, ``cuda`` without it.
    """
    use, on_gpu = settings or FeatureSettings(), uses_gpu(device)
    ordered = list(named_once(images).items()) if images else []
    if masks is not None and not masks.is_dir():
        raise InputError("folder not found", expected="masks named <image>.png", where=masks)
    views = {} if rig is None else lens_views(rig)
    pictures: list[Picture] = []
    places: list[NDArray[np.float32]] = []
    descriptors: list[NDArray[np.uint8]] = []
    for first in steps(range(0, len(ordered), _AT_ONCE), f"features, {_AT_ONCE} images at a time:"):
        some = _extract_some(ordered[first : first + _AT_ONCE], masks, use, threads, views, on_gpu)
        for picture, place, descriptor in some:
            pictures.append(picture)
            places.append(place)
            descriptors.append(descriptor)
    return _joined(pictures, places, descriptors, use)


def lens_views(rig: Rig) -> dict[str, LensView]:
    """Views of the lenses of a rig, where they may be used: to `RIM_DEG`, and not behind their masks.

    Raises
    ------
    InputError : a mask cannot be read, or has another size than the view.
    """
    masks = read_rig_masks(rig)
    views = {}
    for name, camera in rig.cameras.items():
        width, height = camera.size_px
        y, x = np.mgrid[0:height, 0:width] + 0.5
        rays = camera.rays(np.column_stack([x.ravel(), y.ravel()]))[:, 2].reshape(height, width)
        usable = np.nan_to_num(rays, nan=-1.0) > np.cos(np.deg2rad(RIM_DEG))
        views[name] = LensView(
            lens=name,
            cut=partial(lens_view, lens=getattr(rig.settings, name)),
            usable=usable & masks.get(name, np.True_),
        )
    return views


def to_the_rim(block: ImageBlock, features: Features, rig: Rig) -> ImageBlock:
    """A block of views of a rig with marks from `WIDEST_DEG`, where structure from motion ends, to `RIM_DEG`.

    A feature near the rim is a mark of a point that is expected within a few pixels, if its descriptor is
    liker one of the point's own than chance would have it, and clearly liker than those of other such points.

    Parameters
    ----------
    block : of features within `WIDEST_DEG`; in any frame.
    features : all of them.
    """
    inner = features.within(rig, WIDEST_DEG)
    if inner.all() or not len(block.mark_image):
        return block
    number = {picture.name: k for k, picture in enumerate(features.pictures)}
    own = np.empty(len(block.mark_image), np.int64)
    for k, name in enumerate(block.images):
        rows, first = np.flatnonzero(block.mark_image == k), features.start[number[name]]
        places = features.place[features.rows(number[name]), :2]
        own[rows] = first + cKDTree(places).query(block.mark_px[rows])[1]
    order = np.argsort(block.mark_point, kind="stable")
    starts = np.searchsorted(block.mark_point[order], np.arange(len(block.points_block_m) + 1))
    descriptor = features.descriptor.astype(np.float32)
    along = [descriptor[own[order[a:b]]] for a, b in pairwise(starts)]
    # each with one of half the block away: of different things
    other = descriptor[np.roll(own, len(own) // 2)]
    most = float(np.quantile(np.linalg.norm(descriptor[own] - other, axis=1), _CHANCE))
    # features of one size are found equally well
    by_size = np.argsort(features.place[own, 2], kind="stable")
    sizes, sigmas = features.place[own[by_size], 2], block.sigma_px[by_size]
    found: list[tuple[int, int, int]] = []
    off: list[float] = []
    for k, name in enumerate(block.images):
        rows = np.arange(len(inner))[features.rows(number[name])]
        rows = rows[~inner[rows]]
        seen = (block.points_block_m - block.centre_block_m[k]) @ block.R_block_ccs[k]
        new = seen[:, 2] < np.cos(np.deg2rad(WIDEST_DEG - 1.0)) * np.linalg.norm(seen, axis=1)
        new[block.mark_point[block.mark_image == k]] = False
        points = np.flatnonzero(new)
        expected = block.cameras[block.camera[k]].project(seen[points])
        points, expected = (a[np.isfinite(expected).all(axis=1)] for a in (points, expected))
        if not len(points) or not len(rows):
            continue
        taken: dict[int, tuple[float, int]] = {}
        near = cKDTree(expected).query_ball_point(features.place[rows, :2].astype(np.float64), _WINDOW_PX)
        for row, some in zip(rows.tolist(), near, strict=True):
            away = sorted(
                (float(np.linalg.norm(along[p] - descriptor[row], axis=1).min(initial=np.inf)), p)
                for p in points[some].tolist()
            )
            if not away or away[0][0] > most or (len(away) > 1 and away[0][0] > _RATIO * away[1][0]):
                continue
            taken[away[0][1]] = min(taken.get(away[0][1], (np.inf, -1)), (away[0][0], row))
        found += [(k, point, row) for point, (_, row) in taken.items()]
        place = dict(zip(points.tolist(), expected, strict=True))
        off += [float(np.linalg.norm(features.place[r, :2] - place[p])) for p, (_, r) in taken.items()]
    if not found:
        return block
    image, point, row = np.array(found, np.int64).T
    sigma = sigmas[np.clip(np.searchsorted(sizes, features.place[row, 2]), 0, len(sizes) - 1)]
    # bent pictures are found less well: as much as they are farther from where the block has its points
    usual = np.nanmedian(np.linalg.norm(block.residuals_px(), axis=1) / block.sigma_px)
    sigma = sigma * max(1.0, float(np.median(np.array(off) / sigma) / usual))
    return replace(
        block,
        mark_image=np.concatenate([block.mark_image, image]),
        mark_point=np.concatenate([block.mark_point, point]),
        mark_px=np.concatenate([block.mark_px, features.place[row, :2].astype(np.float64)]),
        sigma_px=np.concatenate([block.sigma_px, sigma]),
    )


def part_of(images: Images, part: int, parts: int) -> dict[str, Path]:
    """Images of part 0, 1 ... of ``parts``: every ``parts``-th in natural order, so that all take alike long.

    Raises
    ------
    InputError : no such part.
    """
    if not 0 <= part < parts:
        raise InputError(f"part {part}", expected=f"0 to {parts - 1}")
    return dict(list(named_once(images).items())[part::parts])


def join_features(parts: Sequence[Features]) -> Features:
    """Features of several parts as one, images in natural order; files with the same bytes take part once.

    Raises
    ------
    InputError : no parts, parts found with different settings, or an image in two parts.
    """
    if not parts:
        raise InputError("no features", expected="at least one part")
    if any(part.settings != parts[0].settings for part in parts):
        raise InputError(
            "parts of the features were found with different settings",
            expected="the same settings for all images",
            cure="Find the features of all parts again",
        )
    found = sorted(
        ((picture, part, k) for part in parts for k, picture in enumerate(part.pictures)),
        key=lambda item: natural_key(item[0].name),
    )
    names = [picture.name for picture, _, _ in found]
    double = next((a for a, b in pairwise(names) if a == b), None)
    if double is not None:
        raise InputError(f"{double} stands in two parts of the features", expected="each image once")
    pictures = without_doubles([picture for picture, _, _ in found])
    rows = [
        part.rows(k) if not p.problem else slice(0, 0)
        for p, (_, part, k) in zip(pictures, found, strict=True)
    ]
    return _joined(
        pictures,
        [part.place[r] for r, (_, part, _) in zip(rows, found, strict=True)],
        [part.descriptor[r] for r, (_, part, _) in zip(rows, found, strict=True)],
        parts[0].settings,
    )


def _joined(
    pictures: Sequence[Picture],
    places: Sequence[NDArray[np.float32]],
    descriptors: Sequence[NDArray[np.uint8]],
    settings: FeatureSettings,
) -> Features:
    counts = np.array([len(place) for place in places], np.int64)
    return Features(
        pictures=tuple(pictures),
        start=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        place=np.concatenate([np.zeros((0, 3), np.float32), *places]),
        descriptor=np.concatenate([np.zeros((0, 128), np.uint8), *descriptors]),
        settings=settings,
    )


def _extract_some(
    images: Sequence[tuple[str, Path]],
    masks: Path | None,
    settings: FeatureSettings,
    threads: int,
    views: Mapping[str, LensView],
    on_gpu: bool,
) -> list[tuple[Picture, NDArray[np.float32], NDArray[np.uint8]]]:
    out = []
    with tempfile.TemporaryDirectory(prefix="thalweg-features-") as temporary:
        folder = Path(temporary)
        pictures: list[Picture] = []
        usables: list[ArrayB] = []
        scale: list[tuple[float, float]] = []
        by_budget: dict[int, list[int]] = {}
        for k, (name, path) in enumerate(images):
            view = views.get(name.split("/", 1)[0])
            mask = find_mask(name, masks)
            picture, grey, usable = inspect(path, mask, settings.max_size_px, name=name, view=view)
            pictures.append(picture)
            usables.append(usable)
            scale.append((1.0, 1.0))
            if not picture.problem:
                Image.fromarray(grey).save(folder / f"{k}.pgm")
                scale[k] = (picture.size_px[0] / grey.shape[1], picture.size_px[1] / grey.shape[0])
                budget = min(_MOST_BUDGET, round(1 / picture.usable_share))
                by_budget.setdefault(budget, []).append(k)
        for budget, some in sorted(by_budget.items()):
            _run_sift(folder, some, budget, settings, threads, on_gpu)
        for k, picture in enumerate(pictures):
            place, descriptor = _read_sift(folder / f"{k}.npz", scale[k])
            free = at_pixels(usables[k], place[:, 0], place[:, 1], picture.size_px if len(place) else (1, 1))
            kept = _largest(place, free, settings.max_features)
            few = "" if picture.problem else _few(picture, len(kept), settings)
            told = with_problem(picture, few, "featureless") if few else picture
            kept = kept[:0] if told.problem else kept
            out.append((told, place[kept], descriptor[kept]))
    return out


def _run_sift(
    folder: Path, images: Sequence[int], budget: int, settings: FeatureSettings, threads: int, on_gpu: bool
) -> None:
    """Features of the pictures ``<k>.pgm`` into files ``<k>.npz``."""
    pc = colmap()
    options = pc.FeatureExtractionOptions()
    options.use_gpu = on_gpu
    options.num_threads = max(1, min(threads, len(images)))
    options.max_image_size = settings.max_size_px
    options.sift.max_num_features = settings.max_features * budget
    options.sift.peak_threshold = _PEAK_THRESHOLD
    options.sift.first_octave = -1 if settings.double_size else 0
    path = folder / f"{budget}.db"
    pc.extract_features(
        path,
        folder,
        [f"{k}.pgm" for k in images],
        pc.CameraMode.PER_IMAGE,
        pc.ImageReaderOptions(),
        options,
        pc.Device.cuda if on_gpu else pc.Device.cpu,
    )
    with pc.Database.open(path) as database:
        for image in database.read_all_images():
            key = image.image_id
            place = np.asarray(database.read_keypoints(key), np.float32)
            size = np.zeros(len(place), np.float32)
            if len(place):  # affine keypoints: the scale is the root of the determinant
                size = np.sqrt(np.abs(place[:, 2] * place[:, 5] - place[:, 3] * place[:, 4]))
            np.savez(
                folder / f"{Path(image.name).stem}.npz",
                place=np.column_stack([place[:, :2], size]).astype(np.float32),
                descriptor=np.asarray(database.read_descriptors(key).data, np.uint8),
            )


def _read_sift(path: Path, scale: tuple[float, float]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    if not path.is_file():
        return np.zeros((0, 3), np.float32), np.zeros((0, 128), np.uint8)
    with np.load(path) as stored:
        place, descriptor = stored["place"].reshape(-1, 3), stored["descriptor"].reshape(-1, 128)
    factors = np.array([scale[0], scale[1], np.sqrt(scale[0] * scale[1])])
    return (place * factors).astype(np.float32), descriptor


def _largest(place: NDArray[np.float32], free: ArrayB, most: int) -> ArrayI:
    """Rows of the features outside the mask, those of the largest scale first if there are too many."""
    rows = np.flatnonzero(free)
    if len(rows) > most:
        rows = np.sort(rows[np.argsort(-place[rows, 2], kind="stable")[:most]])
    return rows


def _few(picture: Picture, n: int, settings: FeatureSettings) -> str:
    if n >= settings.min_features:
        return ""
    if picture.contrast < _BLANK:
        return f"{n} features: the usable part is blank (contrast {picture.contrast:.1f} of 255)"
    masked = f", {100 * (1 - picture.usable_share):.0f} % are masked" if picture.usable_share < 0.5 else ""
    return f"{n} features: too blurred or without texture{masked}"
