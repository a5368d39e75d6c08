"""Images put together to a block: COLMAP's incremental or global mapper, and its pieces as image blocks.

The frame of each piece is its own: any origin, attitude and scale.
"""

import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.images.model.block import ImageBlock
from thalweg.images.sfm.camera import from_colmap
from thalweg.images.sfm.colmap import SEED, colmap
from thalweg.images.sfm.database import fill_database
from thalweg.images.sfm.matching import Matches

# ---------------------------------------------------------------- marks of points in images: doubled ones
# left out, and how well each is measured


_CLASSES: Final = 8
_LEAST_IN_CLASS: Final = 50
_MAD: Final = 1.4826


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """Marks (m,): image, point, pixels (m, 2) and scale of the feature in pixels."""

    image: ArrayI
    point: ArrayI
    xy_px: ArrayF
    scale_px: ArrayF


def cleaned(
    block: ImageBlock, scale_px: ArrayF, limit_px: float
) -> tuple[ImageBlock, ArrayF, dict[str, Any]]:
    """The block without marks that count twice, and without points that then have fewer than two images.

    SIFT gives a place with two main directions as two features. Both are matched, make two points of one
    place, and would weigh twice: of such points that of fewer marks loses its mark. Of two marks of one point
    in one image the one that fits better stays.

    Parameters
    ----------
    block : piece as the mapper left it.
    scale_px : (m,) scale of the features.
    limit_px : residual above which a mark is dropped.

    Returns
    -------
    block, scale_px : cleaned; points in the order of their first mark, marks by point and image.
    facts : what was left out.
    """
    off = np.linalg.norm(block.residuals_px(), axis=1)
    fits = np.isfinite(off) & (off <= limit_px)
    length = np.bincount(block.mark_point, minlength=len(block.points_block_m))
    # the better mark of a point in an image first
    once = _first(np.lexsort((off, block.mark_image, block.mark_point)), block.mark_point, block.mark_image)
    # at one place of an image the longer track first
    x, y = block.mark_px.T
    order = np.lexsort((block.mark_point, -length[block.mark_point], y, x, block.mark_image))
    alone = _first(order, block.mark_image, x, y)
    keep = fits & once & alone
    seen = np.bincount(block.mark_point[keep], minlength=len(block.points_block_m))
    keep &= seen[block.mark_point] >= 2
    rows = np.flatnonzero(keep)
    rows = rows[np.lexsort((block.mark_image[rows], block.mark_point[rows]))]
    points, mark_point = np.unique(block.mark_point[rows], return_inverse=True)
    out = replace(
        block,
        points_block_m=block.points_block_m[points],
        mark_image=block.mark_image[rows],
        mark_point=mark_point.astype(np.int64).reshape(-1),
        mark_px=block.mark_px[rows],
        sigma_px=block.sigma_px[rows],
    )
    facts = {
        "marks_left_out": {
            "residual_too_large": int((~fits).sum()),
            "second_of_a_point_in_an_image": int((fits & ~once).sum()),
            "same_place_as_a_longer_track": int((fits & once & ~alone).sum()),
            "of_points_with_one_image": int(len(off) - len(rows) - (~(fits & once & alone)).sum()),
        },
    }
    return out, scale_px[rows], facts


def firm_parts(block: ImageBlock, least: int) -> list[ArrayI]:
    """Images of the parts of a block within which images share at least so many points, the largest first.

    A single image that shares fewer with every other is a part, too.
    """
    n = len(block.images)
    if n < 2 or not len(block.mark_image):
        return [np.arange(n)]
    ones = np.ones(len(block.mark_image), np.int64)
    sees = csr_matrix((ones, (block.mark_image, block.mark_point)), shape=(n, len(block.points_block_m)))
    shared = csr_matrix(sees @ sees.T)
    shared.data = np.where(shared.data >= least, shared.data, 0)
    shared.eliminate_zeros()
    _, label = connected_components(shared, directed=False)
    parts = [np.flatnonzero(label == k) for k in range(int(label.max()) + 1)]
    return sorted(parts, key=lambda part: (-len(part), int(part[0])))


def part_of_block(block: ImageBlock, images: ArrayI) -> tuple[ImageBlock, ArrayI]:
    """The block of some of its images and of the points that two of them see, and its rows of marks."""
    place = np.full(len(block.images), -1)
    place[images] = np.arange(len(images))
    mine = place[block.mark_image] >= 0
    seen = np.bincount(block.mark_point[mine], minlength=len(block.points_block_m))
    rows = np.flatnonzero(mine & (seen[block.mark_point] >= 2))
    points, mark_point = np.unique(block.mark_point[rows], return_inverse=True)
    used, camera = np.unique(block.camera[images], return_inverse=True)
    out = ImageBlock(
        cameras=tuple(block.cameras[k] for k in used),
        images=tuple(block.images[k] for k in images),
        camera=camera.astype(np.int64).reshape(-1),
        R_block_ccs=block.R_block_ccs[images],
        centre_block_m=block.centre_block_m[images],
        points_block_m=block.points_block_m[points],
        mark_image=place[block.mark_image[rows]],
        mark_point=mark_point.astype(np.int64).reshape(-1),
        mark_px=block.mark_px[rows],
        sigma_px=block.sigma_px[rows],
    )
    return out, rows


def sigma_of_marks(
    block: ImageBlock, scale_px: ArrayF, facts: dict[str, Any], sigma_px: float
) -> tuple[ImageBlock, dict[str, Any]]:
    """Standard deviations of the marks: large features are placed less well than small ones.

    The residuals of classes of equal scale give the ratios; ``sigma_px`` is that of the middle class. What
    residuals cannot show, errors that a track shares, is left to the adjustment.

    Returns
    -------
    block : with ``sigma_px``.
    facts : with the classes added.
    """
    if not len(scale_px):
        return block, {**facts, "sigma_classes": []}
    off = block.residuals_px()
    edges = np.unique(np.quantile(scale_px, np.linspace(0, 1, _CLASSES + 1)[1:-1]))
    group = np.searchsorted(edges, scale_px, side="right")
    classes = []
    for g in range(len(edges) + 1):
        rows = group == g
        if rows.sum() >= _LEAST_IN_CLASS:
            spread = _MAD * float(np.median(np.abs(off[rows])))
            classes.append((float(np.median(scale_px[rows])), spread, int(rows.sum())))
    factor = np.ones(len(scale_px))
    if len(classes) > 1 and classes[0][1] > 0:
        at = np.array([c[0] for c in classes])
        spread_px = np.maximum.accumulate([c[1] for c in classes])
        ratio = spread_px / np.median(spread_px)
        factor = np.interp(scale_px, at, ratio)
    told = [{"scale_px": round(s, 3), "spread_px": round(v, 4), "marks": n} for s, v, n in classes]
    return replace(block, sigma_px=sigma_px * factor), {**facts, "sigma_classes": told}


def _first(order: ArrayI, *keys: ArrayF | ArrayI) -> ArrayB:
    """Whether a row is the first of those with the same keys, in an order in which these stand together."""
    new = np.zeros(len(order), bool)
    if len(order):
        new[0] = True
        for key in keys:
            new[1:] |= key[order[1:]] != key[order[:-1]]
    out = np.zeros(len(order), bool)
    out[order] = new
    return out


def rms_of(block: ImageBlock) -> float:
    """Residuals of both coordinates together, as COLMAP and Metashape state it."""
    squares = np.sum(block.residuals_px() ** 2, axis=1)
    return float(np.sqrt(squares.mean())) if len(squares) else float("nan")


# ---------------------------------------------------------------- mapping


INTERIORS: Final = ("auto", "estimated", "fixed")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSettings:
    """Settings of the mapping; names, units and defaults as in section ``images.mapping``."""

    method: str = "incremental"
    interior: str = "auto"
    min_inliers: int = 15
    smallest_piece: int = 3
    max_error_px: float = 2.0
    sigma_px: float = 0.4
    repeatable: bool = True

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From the section ``images.mapping`` of a campaign file."""
        return cls(**{name: section[name] for name in cls.__dataclass_fields__})


@dataclass(frozen=True, slots=True, kw_only=True)
class Mapped:
    """What the mapper made of the matches.

    Parameters
    ----------
    pieces : blocks in frames of their own, that of most images first; an image may be in several.
    facts : JSON-able facts of each piece and notes.
    """

    pieces: tuple[ImageBlock, ...]
    facts: dict[str, Any]


def map_images(matches: Matches, *, settings: MapSettings | None = None, threads: int = 1) -> Mapped:
    """Put images together.

    With one thread, or with ``repeatable``, the same matches give the same block bit by bit. With several
    threads the sums of the adjustments change their order from run to run; that may even let the mapper begin
    with other images, and then frame, points and marks differ.

    Parameters
    ----------
    matches : of all images.
    settings : see `MapSettings`.
    threads : of the adjustments within the mapper, unless it is to be repeatable.

    Returns
    -------
    mapped : without pieces if no two images could be oriented to each other.
    """
    use = settings or MapSettings()
    if use.method not in ("incremental", "global") or use.interior not in INTERIORS:
        raise GeometryError(f"method {use.method}, interior {use.interior}", expected="see images.mapping")
    if not (matches.n_common > 0).any():
        return Mapped(pieces=(), facts={"notes": [], "pieces": []})
    with tempfile.TemporaryDirectory(prefix="thalweg-block-") as temporary:
        folder = Path(temporary)
        notes = fill_database(folder / "block.db", matches)
        run = _incremental if use.method == "incremental" else _global
        models = run(folder, matches, use, 1 if use.repeatable else max(1, threads))
        found = [piece for model in models for piece in _pieces(model, matches, use, notes)]
    good = [(block, facts) for block, facts in found if len(block.images) >= min(2, use.smallest_piece)]
    good.sort(key=lambda item: (-len(item[0].images), -len(item[0].points_block_m), item[0].images))
    main = set(good[0][0].images) if good else set()
    kept = [
        (block, facts)
        for i, (block, facts) in enumerate(good)
        if i == 0 or (len(block.images) >= use.smallest_piece and not set(block.images) <= main)
    ]
    return Mapped(
        pieces=tuple(block for block, _ in kept),
        facts={"notes": list(dict.fromkeys(notes)), "pieces": [facts for _, facts in kept]},
    )


def main_block(
    mapped: Mapped, reasons: Mapping[str, str], causes: Mapping[str, str] | None = None
) -> ImageBlock:
    """The block of most images.

    Parameters
    ----------
    reasons, causes : why each image is in no block, in words and by kind, by name.

    Raises
    ------
    InputError : there is none; the message counts the reasons.
    """
    if mapped.pieces:
        return mapped.pieces[0]
    kinds = Counter((causes or {}).get(name, "") for name in reasons)
    counted = ", ".join(f"{n} {kind}" for kind, n in kinds.most_common() if kind)
    # of each kind one image
    first = {(causes or {}).get(name, name): name for name in reversed(list(reasons)) if reasons[name]}
    told = "; ".join(f"{name}: {reasons[name]}" for name in sorted(first.values())[:3])
    raise InputError(
        f"no two of {len(reasons)} images could be oriented to each other"
        + (f", {counted}" if counted else "")
        + (f" ({told})" if told else ""),
        expected="images that overlap, with texture outside their masks",
        cure="Look at the images and their masks, which are black where nothing is to be used; compare more "
        "pairs (images.mapping.pairs: exhaustive)",
    )


def is_estimated(matches: Matches, use: MapSettings) -> bool:
    """Whether an interior orientation is an unknown."""
    if use.interior == "auto":
        return any(start.source != "given" for start in matches.starts)
    return use.interior == "estimated"


def held_cameras(matches: Matches, use: MapSettings) -> set[int]:
    """COLMAP's numbers of given cameras that stay as they are while others are estimated."""
    if use.interior != "auto" or not is_estimated(matches, use):
        return set()
    return {key for key, start in enumerate(matches.starts, start=1) if start.source == "given"}


def _incremental(folder: Path, matches: Matches, use: MapSettings, threads: int) -> list[Any]:
    pc = colmap()
    estimated = is_estimated(matches, use)
    scale = matches.scale()
    o = pc.IncrementalPipelineOptions()
    o.random_seed = SEED
    o.num_threads = threads
    o.extract_colors = False
    o.min_num_matches = use.min_inliers
    o.min_model_size = use.smallest_piece
    o.ba_refine_focal_length = o.ba_refine_extra_params = estimated
    o.ba_refine_principal_point = False
    # pairs of images have a base of their own only if two-view points count
    o.triangulation.ignore_two_view_tracks = len(matches.order) > 2
    o.mapper.random_seed = o.triangulation.random_seed = SEED
    o.mapper.num_threads = threads
    o.constant_cameras = o.mapper.constant_cameras = held_cameras(matches, use)
    o.mapper.abs_pose_refine_focal_length = o.mapper.abs_pose_refine_extra_params = estimated
    o.mapper.abs_pose_min_num_inliers = max(use.min_inliers, 12)
    o.mapper.filter_max_reproj_error = use.max_error_px * scale
    o.mapper.init_max_error = use.max_error_px * scale
    o.mapper.abs_pose_max_error = 3 * use.max_error_px * scale
    o.triangulation.merge_max_reproj_error = o.triangulation.complete_max_reproj_error = (
        use.max_error_px * scale
    )
    (folder / "models").mkdir()
    made = pc.incremental_mapping(folder / "block.db", folder, folder / "models", o)
    return [made[key] for key in sorted(made)]


def _global(folder: Path, matches: Matches, use: MapSettings, threads: int) -> list[Any]:
    pc = colmap()
    o = pc.GlobalPipelineOptions()
    o.random_seed = o.mapper.random_seed = SEED
    o.num_threads = o.mapper.num_threads = threads
    o.min_num_matches = use.min_inliers
    o.min_model_size = use.smallest_piece
    o.mapper.rotation_averaging.random_seed = o.mapper.global_positioning.random_seed = SEED
    o.mapper.retriangulation.random_seed = SEED
    o.mapper.global_positioning.use_gpu = o.mapper.bundle_adjustment.ceres.use_gpu = False
    adjustment = o.mapper.bundle_adjustment
    adjustment.refine_focal_length = adjustment.refine_extra_params = is_estimated(matches, use)
    adjustment.refine_principal_point = False
    adjustment.ceres.solver_options.num_threads = threads
    (folder / "models").mkdir()
    made = pc.global_mapping(folder / "block.db", folder, folder / "models", o)
    return [made[key] for key in sorted(made)]


def _pieces(
    model: Any, matches: Matches, use: MapSettings, notes: list[str]
) -> list[tuple[ImageBlock, dict[str, Any]]]:
    """A model of COLMAP as blocks: images by name, points in the order of their first mark.

    The mappers may leave parts in one model that next to nothing holds together; such parts stand at wrong
    places without a residual that tells it, so they become pieces of their own.
    """
    keys = sorted((int(k) for k in model.reg_image_ids()), key=lambda k: matches.pictures[k - 1].name)
    place_of = {key: i for i, key in enumerate(keys)}
    cameras: list[Camera] = []
    camera_of: dict[int, int] = {}
    for c in sorted({int(model.image(k).camera_id) for k in keys}):
        camera, error_px = from_colmap(model.camera(c), matches.starts[c - 1].camera.name)
        if error_px > 0.05:
            notes.append(
                f"the estimated lens of {camera.name!r} differs from Brown's by up to {error_px:.2f} px"
            )
        camera_of[c] = len(cameras)
        cameras.append(camera)
    R = np.empty((len(keys), 3, 3))
    centre = np.empty((len(keys), 3))
    for i, key in enumerate(keys):
        pose = model.image(key).cam_from_world()
        R[i] = pose.rotation.matrix().T
        centre[i] = -R[i] @ pose.translation
    points, marks = _marks(model, matches, place_of)
    block = ImageBlock(
        cameras=tuple(cameras),
        images=tuple(matches.pictures[k - 1].name for k in keys),
        camera=np.array([camera_of[int(model.image(k).camera_id)] for k in keys], np.int64),
        R_block_ccs=R,
        centre_block_m=centre,
        points_block_m=points,
        mark_image=marks.image,
        mark_point=marks.point,
        mark_px=marks.xy_px,
        sigma_px=np.ones(len(marks.image)),
    )
    block, scale_px, facts = cleaned(block, marks.scale_px, 2 * use.max_error_px * matches.scale())
    parts = firm_parts(block, use.min_inliers)
    if sum(len(part) > 1 for part in parts) > 1:
        sizes = ", ".join(str(len(part)) for part in parts if len(part) > 1)
        notes.append(
            f"the mapper joined parts of {sizes} images by fewer than {use.min_inliers} common points: "
            "they are taken apart"
        )
    out = []
    for part in parts:
        piece, rows = part_of_block(block, part)
        told = {**facts, "images": len(part), "points": len(piece.points_block_m), "marks": len(rows)}
        told["rms_px"] = rms_of(piece)
        out.append(sigma_of_marks(piece, scale_px[rows], told, use.sigma_px * matches.scale()))
    return out


def _marks(model: Any, matches: Matches, place_of: Mapping[int, int]) -> tuple[ArrayF, Marks]:
    ids = sorted(int(p) for p in model.point3D_ids())
    points = np.array([model.point3D(p).xyz for p in ids]).reshape(-1, 3)
    image: list[int] = []
    feature: list[int] = []
    point: list[int] = []
    for i, p in enumerate(ids):
        for element in model.point3D(p).track.elements:
            image.append(int(element.image_id))
            feature.append(int(element.point2D_idx))
            point.append(i)
    rows: ArrayI = np.array(feature, np.int64) + matches.start[np.array(image, np.int64) - 1]
    place = matches.place[rows].astype(np.float64).reshape(-1, 3)
    return points, Marks(
        image=np.array([place_of[k] for k in image], np.int64),
        point=np.array(point, np.int64),
        xy_px=place[:, :2],
        scale_px=place[:, 2],
    )
