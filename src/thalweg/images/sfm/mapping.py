"""Images put together to a block by COLMAP: image by image, or all at once.

The frame of each piece is its own: any origin, attitude and scale.
"""

import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from thalweg.core import NMAD, ArrayB, ArrayF, ArrayI, Camera, InputError
from thalweg.images.model import ImageBlock
from thalweg.images.sfm.colmap import SEED, colmap, from_colmap, uses_gpu
from thalweg.images.sfm.matching import Matches, fill_database
from thalweg.settings.sections import LARGE_BLOCK, MappingSettings

_CLASSES: Final = 8
_LEAST_IN_CLASS: Final = 50

BLURRED: Final = 0.5
"""Sharpness of a blurred image, in units of the median of all images."""
_SMALLEST_PIECE: Final = 3
"""Images that a separate piece of the block must have to be kept."""
_NAMED: Final = 3


# ---------------------------------------------------------------- mapping


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


_LEAST_FOR_FOCAL: Final = 5
_LEAST_FOR_SHAPE: Final = 9
"""Images of a block that bear a focal length, and distortion."""
_SIGMAS: Final = 5.0
_STILL: Final = 1e-3
"""Share of the longer side by which points move at most in pictures of a camera that stood still."""
_WIDEST: Final = 1.0 / 3.0
"""Focal length over the longer side: a perspective lens of 112 degrees; wider ones are fisheyes."""
_SHARED: Final = 30
"""Images that a part of a larger block shares with the next one."""
_SEARCHED: Final = 2048
"""Features of an image by which a larger block is put together; points of the others follow."""
_DIRECT: Final = 20_000
"""Images up to which the equations of an adjustment are solved directly: a band of 6 unknowns an image."""
_GROWTH: Final = 1.4
"""A larger block is adjusted whole each time it has grown so many times; COLMAP has 1.1, which takes half as
long again (180 images: 151 s of the processor, 101 s), and moves poses by 0.14 of their sigmas."""


def map_images(
    matches: Matches, *, settings: MappingSettings | None = None, threads: int = 1, device: str = "auto"
) -> Mapped:
    """Put images together.

    With one thread, or with ``repeatable``, the same matches give the same block bit by bit. With several
    threads the sums of the adjustments change their order from run to run; that may even let the mapper begin
    with other images, and then frame, points and marks differ.

    Parameters
    ----------
    matches : of all images.
    settings : see `MappingSettings`.
    threads : of the adjustments within the mapper, unless it is to be repeatable.
    device : ``images.device``; the facts say which one it was.

    Returns
    -------
    mapped : without pieces if no two images could be oriented to each other.

    Raises
    ------
    InputError : ``cuda`` without it.
    """
    use, on_gpu = settings or MappingSettings(), uses_gpu(device)
    told = {"device": "cuda" if on_gpu else "cpu"}
    if not (matches.n_common > 0).any():
        return Mapped(pieces=(), facts={**told, "notes": [], "pieces": []})
    with tempfile.TemporaryDirectory(prefix="thalweg-block-") as temporary:
        folder = Path(temporary)
        large = use.method == "incremental" and len(matches.order) > LARGE_BLOCK
        searched = _of_most_pairs(matches) if large else matches
        notes = fill_database(folder / "block.db", searched)
        if on_gpu:
            notes.append(f"structure from motion on a graphics card (images.device: {device})")
        used = 1 if use.repeatable else max(1, threads)
        put_together = _global if use.method == "global" else _incremental
        models = _in_parts(folder, matches, use, threads, on_gpu, notes) if large else []
        models = models or put_together(folder, matches, use, used, on_gpu)
        if len(searched.common) < len(matches.common):
            models = _with_all_points(folder, models, matches, use, on_gpu)
        models = [_refined(model, matches, use, notes, on_gpu) for model in models]
        found = [piece for model in models for piece in _pieces(model, matches, use, notes)]
    good = []
    for block, facts in found:
        wrong = {camera.name: words for camera in block.cameras if (words := impossible_lens(camera))}
        for name, words in wrong.items():
            notes.append(f"a piece of {len(block.images)} images is left out: lens of {name!r} {words}")
        if not wrong and len(block.images) >= 2:
            good.append((block, facts))
    good.sort(key=lambda item: (-len(item[0].images), -len(item[0].points_block_m), item[0].images))
    main = set(good[0][0].images) if good else set()
    kept = [
        (block, facts)
        for i, (block, facts) in enumerate(good)
        if i == 0 or (len(block.images) >= _SMALLEST_PIECE and not set(block.images) <= main)
    ]
    return Mapped(
        pieces=tuple(block for block, _ in kept),
        facts={**told, "notes": list(dict.fromkeys(notes)), "pieces": [facts for _, facts in kept]},
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
    counted = ", ".join(f"{n} {kind.replace('_', ' ')}" for kind, n in kinds.most_common() if kind)
    # of each kind one image
    first = {(causes or {}).get(name, name): name for name in reversed(list(reasons)) if reasons[name]}
    told = "; ".join(f"{name}: {reasons[name]}" for name in sorted(first.values())[:3])
    raise InputError(
        f"no two of {len(reasons)} images could be oriented to each other"
        + (f", {counted}" if counted else "")
        + (f" ({told})" if told else "")
        + "".join(f"; {note}" for note in mapped.facts.get("notes", []) if "impossible" in note),
        expected="images that overlap, with texture outside their masks",
        cure="Look at the images and their masks, which are black where nothing is to be used; compare more "
        "pairs (images.mapping.pairs: exhaustive)",
    )


def held_cameras(matches: Matches, use: MappingSettings) -> set[int]:
    """COLMAP's numbers of given cameras that stay as they are while others are estimated from the first pair.

    One pair does not determine a lens: freed there, a good one is lost (of 16 images two were left).
    Where given ones are to be estimated, `_refined` does so once the block stands.
    """
    if not _estimates_guesses(matches, use):
        return set()
    return {key for key, start in enumerate(matches.starts, start=1) if start.source == "given"}


def _estimates_guesses(matches: Matches, use: MappingSettings) -> bool:
    """Whether lenses of which nothing is known are estimated image by image."""
    return use.interior != "fixed" and any(start.source != "given" for start in matches.starts)


def _refined(model: Any, matches: Matches, use: MappingSettings, notes: list[str], on_gpu: bool) -> Any:
    """A model whose given cameras were held, adjusted once more with their lenses free as far as it bears.

    The focal length from `_LEAST_FOR_FOCAL` images, distortion from `_LEAST_FOR_SHAPE`; a lens that becomes
    impossible stays as given.
    """
    given = [start.source == "given" for start in matches.starts]
    n = model.num_reg_images()
    if use.interior != "estimated" or not any(given) or n < _LEAST_FOR_FOCAL:
        return model
    pc = colmap()
    freed = pc.Reconstruction(model)
    pc.bundle_adjustment(freed, _adjustment(pc, True, n >= _LEAST_FOR_SHAPE, on_gpu))
    for key in {int(freed.image(k).camera_id) for k in freed.reg_image_ids()}:
        camera, _ = from_colmap(freed.camera(key), matches.starts[key - 1].camera.name)
        if words := impossible_lens(camera):
            notes.append(f"the lens of {camera.name!r} stays as given: estimated, it would be {words}")
            return model
        stated = matches.starts[key - 1].camera
        sigma = float(np.sqrt(stated.cov[0, 0])) if given[key - 1] else 0.0
        off = float(camera.parameters[0] - stated.parameters[0])
        if sigma > 0 and abs(off) > _SIGMAS * sigma:
            notes.append(
                f"the images put the focal length of {camera.name!r} {off:+.2f} px from the given one, "
                f"{abs(off) / sigma:.1f} of its standard deviations: another zoom or focus?"
            )
    return freed


def _adjustment(pc: Any, focal: bool, shape: bool, on_gpu: bool) -> Any:
    """Options of an adjustment by COLMAP with focal lengths, and distortion, free or not."""
    o = pc.BundleAdjustmentOptions()
    o.print_summary = False
    o.refine_focal_length, o.refine_extra_params, o.refine_principal_point = focal, shape, False
    o.ceres.use_gpu = on_gpu
    o.ceres.solver_options.num_threads = 1
    # beyond 1,000 images COLMAP iterates: 14 minutes were not enough for 1,025, directly 4 were
    o.ceres.max_num_images_direct_sparse_cpu_solver = _DIRECT
    return o


def impossible_lens(camera: Camera) -> str:
    """What is impossible about a perspective lens, in words; nothing if it is possible, or a fisheye.

    Impossible are a focal length below a third of the longer side, and distortion that folds the picture:
    directions farther from the axis that are imaged nearer to the centre.
    """
    if camera.model != "perspective":
        return ""
    f, side = float(camera.parameters[0]), max(camera.size_px)
    if f < _WIDEST * side:
        return f"impossible, f {f:.0f} px for pictures of {side} px"
    shape = dict(zip(camera.parameter_names, camera.parameters.tolist(), strict=True))
    k = [shape.get(name, 0.0) for name in ("k1", "k2", "k3")]
    corner = float(np.hypot(*camera.size_px)) / 2 / f
    r = np.linspace(0.0, 3.0 * corner, 600)
    imaged = r * (1 + k[0] * r**2 + k[1] * r**4 + k[2] * r**6)
    falls = np.flatnonzero(np.diff(imaged) <= 0)
    if len(falls) and imaged[: falls[0] + 1].max() < corner:
        return f"impossible, it folds the picture {f * imaged[falls[0]]:.0f} px from the centre"
    return ""


def _incremental(
    folder: Path, matches: Matches, use: MappingSettings, threads: int, on_gpu: bool
) -> list[Any]:
    pc = colmap()
    o = _options(pc, matches, use, threads, on_gpu)
    (folder / "models").mkdir()
    made = pc.incremental_mapping(folder / "block.db", folder, folder / "models", o)
    return [made[key] for key in sorted(made)]


def _in_parts(
    folder: Path, matches: Matches, use: MappingSettings, threads: int, on_gpu: bool, notes: list[str]
) -> list[Any]:
    """Overlapping parts of a large block, mapped beside each other, joined by common images, and adjusted.

    Each part has one thread, so that the number of threads changes nothing.
    No model if parts with common images could not be joined.
    """
    n = len(matches.order)
    pc = colmap()
    o = pc.HierarchicalPipelineOptions()
    o.incremental_options = _options(pc, matches, use, 1, on_gpu)
    o.num_threads = o.num_workers = max(1, threads)
    o.clustering_options.leaf_max_num_images, o.clustering_options.image_overlap = LARGE_BLOCK, _SHARED
    (folder / "parts").mkdir()
    made = pc.hierarchical_mapping(folder / "block.db", folder, folder / "parts", o)
    models: list[Any] = []
    for model in sorted(made.values(), key=lambda model: -model.num_reg_images()):
        images = set(model.reg_image_ids())
        shared = max((len(images & set(larger.reg_image_ids())) for larger in models), default=0)
        if shared < min(len(images), _SMALLEST_PIECE):
            models.append(model)
        elif shared < len(images):
            notes.append(f"{n} images were mapped in one: parts of them could not be joined")
            return []
    estimated = _estimates_guesses(matches, use)
    for model in models:  # joints have residuals, and each part has estimated lenses of its own
        taken = pc.BundleAdjustmentConfig()
        for image in model.reg_image_ids():
            taken.add_image(image)
        for camera in held_cameras(matches, use):
            taken.set_constant_cam_intrinsics(camera)
        taken.fix_gauge(pc.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        adjustment = _adjustment(pc, estimated, estimated, on_gpu)
        pc.create_default_bundle_adjuster(adjustment, taken, model).solve()
    notes.append(f"{n} images were mapped in overlapping parts of at most {LARGE_BLOCK}")
    return models


def _of_most_pairs(matches: Matches) -> Matches:
    """The matches of those features of each image that most others have too, the larger first."""
    rows = matches.start.astype(np.uint32)[matches.pairs].repeat(matches.n_common, axis=0)
    rows += matches.common
    pairs_of = np.bincount(rows.ravel(), minlength=len(matches.place))
    owner = np.repeat(np.arange(len(matches.pictures)), np.diff(matches.start))
    order = np.lexsort((-matches.place[:, 2], -pairs_of, owner))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order)) - matches.start[owner]
    both = (rank < _SEARCHED)[rows].all(axis=1)
    first = np.concatenate([[0], np.cumsum(both)])[matches.pair_start]
    return replace(matches, common=matches.common[both], pair_start=first)


def _with_all_points(
    folder: Path, models: Sequence[Any], matches: Matches, use: MappingSettings, on_gpu: bool
) -> list[Any]:
    """Models with the points of all matches, seen from the poses that they have."""
    pc = colmap()
    fill_database(folder / "all.db", matches)
    o = _options(pc, matches, use, 1, on_gpu)
    return [pc.triangulate_points(model, folder / "all.db", folder, folder, True, o) for model in models]


def _options(pc: Any, matches: Matches, use: MappingSettings, threads: int, on_gpu: bool) -> Any:
    estimated = _estimates_guesses(matches, use)
    scale = matches.scale()
    o = pc.IncrementalPipelineOptions()
    o.random_seed = SEED
    o.num_threads = threads
    o.extract_colors = False
    o.min_num_matches = use.min_inliers
    o.min_model_size = _SMALLEST_PIECE
    o.ba_refine_focal_length = o.ba_refine_extra_params = estimated
    o.ba_refine_principal_point = False
    o.ba_use_gpu = on_gpu
    # pairs of images have a base of their own only if two-view points count
    o.triangulation.ignore_two_view_tracks = len(matches.order) > 2
    o.mapper.random_seed = o.triangulation.random_seed = SEED
    o.mapper.num_threads = threads
    if len(matches.order) > LARGE_BLOCK:
        o.ba_global_frames_ratio = o.ba_global_points_ratio = _GROWTH
    o.constant_cameras = o.mapper.constant_cameras = held_cameras(matches, use)
    o.mapper.abs_pose_refine_focal_length = o.mapper.abs_pose_refine_extra_params = estimated
    o.mapper.abs_pose_min_num_inliers = max(use.min_inliers, 12)
    o.mapper.filter_max_reproj_error = use.max_error_px * scale
    o.mapper.init_max_error = use.max_error_px * scale
    o.mapper.abs_pose_max_error = 3 * use.max_error_px * scale
    o.triangulation.merge_max_reproj_error = o.triangulation.complete_max_reproj_error = (
        use.max_error_px * scale
    )
    return o


def _global(folder: Path, matches: Matches, use: MappingSettings, threads: int, on_gpu: bool) -> list[Any]:
    pc = colmap()
    o = pc.GlobalPipelineOptions()
    o.random_seed = o.mapper.random_seed = SEED
    o.num_threads = o.mapper.num_threads = threads
    o.min_num_matches = use.min_inliers
    o.min_model_size = _SMALLEST_PIECE
    o.mapper.rotation_averaging.random_seed = o.mapper.global_positioning.random_seed = SEED
    o.mapper.retriangulation.random_seed = SEED
    o.mapper.global_positioning.use_gpu = o.mapper.bundle_adjustment.ceres.use_gpu = on_gpu
    adjustment = o.mapper.bundle_adjustment
    adjustment.refine_focal_length = adjustment.refine_extra_params = _estimates_guesses(matches, use)
    adjustment.refine_principal_point = False
    adjustment.ceres.solver_options.num_threads = threads
    (folder / "models").mkdir()
    made = pc.global_mapping(folder / "block.db", folder, folder / "models", o)
    return [made[key] for key in sorted(made)]


def _pieces(
    model: Any, matches: Matches, use: MappingSettings, notes: list[str]
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
    points, mark_image, mark_point, place = _marks(model, matches, place_of)
    block = ImageBlock(
        cameras=tuple(cameras),
        images=tuple(matches.pictures[k - 1].name for k in keys),
        camera=np.array([camera_of[int(model.image(k).camera_id)] for k in keys], np.int64),
        R_block_ccs=R,
        centre_block_m=centre,
        points_block_m=points,
        mark_image=mark_image,
        mark_point=mark_point,
        mark_px=place[:, :2],
        sigma_px=np.ones(len(place)),
    )
    block, scale_px, facts = cleaned(block, place[:, 2], 2 * use.max_error_px * matches.scale())
    parts = firm_parts(block, use.min_inliers)
    if sum(len(part) > 1 for part in parts) > 1:
        sizes = ", ".join(str(len(part)) for part in parts if len(part) > 1)
        notes.append(
            f"parts of {sizes} images have fewer than {use.min_inliers} common points: they are taken apart"
        )
    out = []
    for part in parts:
        piece, rows = part_of_block(block, part)
        told = {**facts, "images": len(part), "points": len(piece.points_block_m), "marks": len(rows)}
        told["rms_px"] = rms_of(piece)
        out.append(sigma_of_marks(piece, scale_px[rows], told, use.sigma_px * matches.scale()))
    return out


def _marks(
    model: Any, matches: Matches, place_of: Mapping[int, int]
) -> tuple[ArrayF, ArrayI, ArrayI, ArrayF]:
    """Points (p, 3); image, point, and place of the feature (pixels, scale) of the m marks."""
    ids = sorted(int(p) for p in model.point3D_ids())
    rows = [
        (e.image_id, e.point2D_idx, i) for i, p in enumerate(ids) for e in model.point3D(p).track.elements
    ]
    key, feature, point = np.array(rows, np.int64).reshape(-1, 3).T
    place = matches.place[feature + matches.start[key - 1]].astype(np.float64).reshape(-1, 3)
    image = np.array([place_of[k] for k in key.tolist()], np.int64)
    return np.array([model.point3D(p).xyz for p in ids]).reshape(-1, 3), image, point, place


# ---------------------------------------------------------------- marks of points in images: doubled ones
# left out, and how well each is measured


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
        }
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
            spread = NMAD * float(np.median(np.abs(off[rows])))
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


# ---------------------------------------------------------------- what became of each image, and why some
# have no pose


def image_table(matches: Matches, mapped: Mapped) -> pd.DataFrame:
    """One row per image in natural order of names.

    Columns: ``image``; ``order`` (place in time, -1: takes no part); ``width_px``, ``height_px``;
    ``usable_share`` of the pixels; ``sharpness``; ``features``; ``pairs_compared``; ``pairs`` with enough in
    common; ``matches`` (common points of these pairs); ``registered`` in the main block; ``piece`` (0 main
    block, -1 none); ``component`` (groups of images joined by pairs, 0 the largest, -1 none); ``marks``;
    ``rms_px`` of both coordinates together; ``cause`` and ``reason`` if not in the main block.
    """
    n = len(matches.pictures)
    verified = matches.n_common > 0
    joined = matches.pairs[verified]
    order = np.full(n, -1)
    order[matches.order] = np.arange(len(matches.order))
    component = _components(n, joined)
    piece, marks, rms_px = _in_pieces(matches, mapped)
    causes, reasons = _reasons(matches, mapped, piece)
    points = np.zeros(n, np.int64)
    np.add.at(points, joined.ravel(), np.repeat(matches.n_common[verified], 2))
    return pd.DataFrame(
        {
            "image": [picture.name for picture in matches.pictures],
            "order": order,
            "width_px": [picture.size_px[0] for picture in matches.pictures],
            "height_px": [picture.size_px[1] for picture in matches.pictures],
            "usable_share": [round(picture.usable_share, 4) for picture in matches.pictures],
            "sharpness": [round(picture.sharpness, 4) for picture in matches.pictures],
            "features": np.diff(matches.start),
            "pairs_compared": np.bincount(matches.pairs.ravel(), minlength=n),
            "pairs": np.bincount(joined.ravel(), minlength=n),
            "matches": points,
            "registered": piece == 0,
            "piece": piece,
            "component": component,
            "marks": marks,
            "rms_px": np.round(rms_px, 4),
            "cause": causes,
            "reason": reasons,
        }
    )


def block_facts(matches: Matches, mapped: Mapped, table: pd.DataFrame) -> dict[str, Any]:
    """JSON-able facts of a whole block: counts, pieces with their images and gaps, notes in plain words."""
    pieces = [
        {**facts, "names": list(block.images)}
        for facts, block in zip(mapped.facts["pieces"], mapped.pieces, strict=True)
    ]
    left_out = Counter(cause for cause in table["cause"] if cause)
    registered = int(table["registered"].sum())
    gaps = _gaps(matches, table)
    notes = [*matches.facts["notes"], *mapped.facts["notes"]]
    if len(pieces) > 1:
        sizes = ", ".join(f"{len(block.images)} images ({_span(matches, block)})" for block in mapped.pieces)
        notes.append(f"the block falls into {len(pieces)} pieces: {sizes}")
        notes += [
            f"gap between {g['after']} and {g['before']}: {g['images_between']} images between them without "
            f"pose, {g['common_points']} common points across"
            for g in gaps[:_NAMED]
        ]
    if left_out:
        counts = ", ".join(f"{count} {cause}" for cause, count in sorted(left_out.items()))
        notes.append(f"{len(table) - registered} of {len(table)} images are not in the main block: {counts}")
    return {
        "images": len(table),
        "registered": registered,
        "left_out": dict(sorted(left_out.items())),
        "pairs": {
            "kind": matches.facts.get("pairs", "given"),
            "compared": len(matches.pairs),
            "joined": int((matches.n_common > 0).sum()),
            "matches": int(matches.n_matches.sum()),
            "common_points": int(matches.n_common.sum()),
        },
        "start": matches.facts.get("interior", []),
        "estimated": [
            dict(zip(c.parameter_names, np.round(c.parameters, 6).tolist(), strict=True))
            for c in (mapped.pieces[0].cameras if mapped.pieces else ())
        ],
        "device": mapped.facts.get("device", "cpu"),
        "pieces": pieces,
        "gaps": gaps,
        "notes": notes,
    }


def _components(n: int, joined: ArrayI) -> ArrayI:
    """Numbers of the groups of joined images, the largest first; -1 for single images."""
    graph = coo_matrix((np.ones(len(joined)), (joined[:, 0], joined[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    size = np.bincount(label, minlength=n)
    first = np.full(n, n)
    np.minimum.at(first, label, np.arange(n))
    rank = np.empty(n, np.int64)
    rank[np.lexsort((first, -size))] = np.arange(n)
    return np.where(size[label] > 1, rank[label], -1)


def _in_pieces(matches: Matches, mapped: Mapped) -> tuple[ArrayI, ArrayI, ArrayF]:
    at = {picture.name: k for k, picture in enumerate(matches.pictures)}
    piece = np.full(len(at), -1, np.int64)
    marks = np.zeros(len(at), np.int64)
    rms_px = np.full(len(at), np.nan)
    for i, block in enumerate(mapped.pieces):
        squares = np.sum(block.residuals_px() ** 2, axis=1)
        count = np.bincount(block.mark_image, minlength=len(block.images))
        total = np.bincount(block.mark_image, weights=squares, minlength=len(block.images))
        for j, name in enumerate(block.images):
            k = at[name]
            if piece[k] < 0:
                piece[k], marks[k] = i, count[j]
                rms_px[k] = np.sqrt(total[j] / count[j]) if count[j] else np.nan
    return piece, marks, rms_px


def _reasons(matches: Matches, mapped: Mapped, piece: ArrayI) -> tuple[list[str], list[str]]:
    sharp = [p.sharpness for p in matches.pictures if not p.problem]
    usual = float(np.median(sharp)) if sharp else 0.0
    out = []
    for k, picture in enumerate(matches.pictures):
        if piece[k] == 0:
            out.append(("", ""))
        elif picture.problem:
            out.append((picture.cause, picture.problem))
        elif piece[k] > 0:
            out.append(("other_piece", _elsewhere(matches, mapped, piece, int(piece[k]))))
        else:
            cause, reason = _alone(matches, piece, k)
            if picture.sharpness < BLURRED * usual:
                reason += f"; probably blurred (sharpness {picture.sharpness:.2f}, usual {usual:.2f})"
            if picture.usable_share < 0.1:
                reason += f"; {100 * picture.usable_share:.0f} % of it are usable"
            out.append((cause, reason))
    return [cause for cause, _ in out], [reason for _, reason in out]


def _elsewhere(matches: Matches, mapped: Mapped, piece: ArrayI, i: int) -> str:
    count = len(mapped.pieces[i].images)
    across = (piece[matches.pairs] == 0).any(axis=1) & (piece[matches.pairs] == i).any(axis=1)
    best = _best(matches, across)
    joint = f"closest pair across: {best}" if best else "no common points with the main block"
    return f"in piece {i} of {count} images, oriented apart from the main block; {joint}"


def _alone(matches: Matches, piece: ArrayI, k: int) -> tuple[str, str]:
    mine = (matches.pairs == k).any(axis=1)
    verified = mine & (matches.n_common > 0)
    if not mine.any():
        return "not_compared", "compared with no other image"
    if not verified.any():
        m = int(np.flatnonzero(mine)[np.argmax(matches.n_matches[mine])])
        other = matches.pictures[int(matches.pairs[m].sum()) - k].name
        return "no_overlap", (
            f"no overlap with the {mine.sum()} images it was compared with: at best {matches.n_matches[m]} "
            f"similar points, with {other}, that no geometry joins"
        )
    to_block = verified & (piece[matches.pairs] == 0).any(axis=1)
    if words := _stood_still(matches, np.flatnonzero(verified)):
        return "stood_still", words
    if not (piece == 0).any():
        return "apart", f"joined to {verified.sum()} images, but no block came of any"
    if not to_block.any():
        return "apart", f"joined to {verified.sum()} images only, none of which is in the block"
    return "weak", (
        f"too few points of the block to find its pose: {to_block.sum()} pairs, "
        f"at best {_best(matches, to_block)}"
    )


def _stood_still(matches: Matches, pairs: ArrayI) -> str:
    """Whether most of these pairs see their common points where they were: no base, and so no depth."""
    moved = []
    for m in pairs.tolist():
        common = matches.common[matches.pair_start[m] : matches.pair_start[m + 1]]
        a, b = (matches.place[matches.start[i] + common[:, k]] for k, i in enumerate(matches.pairs[m]))
        moved.append(float(np.median(np.linalg.norm(a - b, axis=1))))
    side = max(matches.starts[0].camera.size_px)
    if not np.median(moved) < _STILL * side:
        return ""
    return (
        f"the camera stood still: in {len(moved)} pairs common points lie where they were, within "
        f"{np.median(moved):.1f} px; from control points `thalweg resect` finds such poses"
    )


def _best(matches: Matches, rows: Any) -> str:
    some = np.flatnonzero(rows & (matches.n_common > 0))
    if not len(some):
        return ""
    m = int(some[np.argmax(matches.n_common[some])])
    a, b = (matches.pictures[int(k)].name for k in matches.pairs[m])
    return f"{a} with {b}, {matches.n_common[m]} points"


def _gaps(matches: Matches, table: pd.DataFrame) -> list[dict[str, Any]]:
    """Where, in time, the images of one piece end and those of another begin."""
    piece = table["piece"].to_numpy()
    placed = [int(k) for k in matches.order if piece[k] >= 0]
    place = table["order"].to_numpy()
    across = (piece[matches.pairs] >= 0).all(axis=1) & (
        piece[matches.pairs[:, 0]] != piece[matches.pairs[:, 1]]
    )
    out = []
    for a, b in pairwise(placed):
        if piece[a] != piece[b]:
            both = across & (np.sort(piece[matches.pairs], axis=1) == sorted((piece[a], piece[b]))).all(
                axis=1
            )
            out.append(
                {
                    "after": matches.pictures[a].name,
                    "before": matches.pictures[b].name,
                    "pieces": [int(piece[a]), int(piece[b])],
                    "images_between": int(place[b] - place[a] - 1),
                    "common_points": int(matches.n_common[both].sum()),
                }
            )
    return out


def _span(matches: Matches, block: ImageBlock) -> str:
    names: Sequence[str] = [matches.pictures[int(k)].name for k in matches.order]
    mine = [name for name in names if name in set(block.images)]
    return mine[0] if len(mine) == 1 else f"{mine[0]} to {mine[-1]}"
