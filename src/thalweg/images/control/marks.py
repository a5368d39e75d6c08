"""Automatic measurement of control points: 2 by 2 checker boards found where the poses predict them.

A board is upright and looks toward the river. Its picture is predicted from the pose of each image; a window
as large as the prediction may err is searched by normalised cross-correlation with checkers of several
breadths. What several images agree on in space is taken; the block is then moved onto these points, searched
again in narrow windows, and the crossings are fitted to sub-pixels (`thalweg.calibration.markers.saddles`).
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
import pandas as pd

from thalweg.calibration.markers.saddles import fit_saddles
from thalweg.core.errors import GeometryError
from thalweg.core.types import AnyArray, ArrayF, ArrayU8
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.control_points import ControlPoints
from thalweg.images.model.start import Similarity, nearest_to_rays, robust_similarity

Loader = Callable[[str], "ArrayU8 | None"]
"""Grey values (h, w) of an image by its name; None if there are none."""

COLUMNS: Final = ("image", "point", "x_px", "y_px", "sigma_px", "score", "used", "reason")
_BREADTHS: Final = (1.0, 0.75, 0.5)
"""Breadths of the templates: a board turned by 0, 41 and 60 degrees about its vertical."""
_REACH_MODULES: Final = 0.85
_CANDIDATES: Final = 3
_AGREE_MODULES: Final = 0.35
"""How far a candidate may be from where the others put the point, modules."""
_AGREE_PX: Final = 1.5
_NARROW_MODULES: Final = 0.7
_NARROW_PX: Final = 3.0
_DIFFER_MODULES: Final = 0.8
_CLEAR: Final = 0.05
"""Correlation by which the best place is better than the next."""
_FLOOR_PX: Final = 0.1
"""What the fit cannot see of a board of 8 to 30 pixels, to begin with: the adjustment estimates the size of
these errors from the block where its marks have enough redundancy (``control_scale`` of
`thalweg.images.bundle.adjustment`). A cautious value for a few marks in moving pictures: photographs of a
standing board made as small have 0.024 px (`tests/calibration/test_saddles.py`), three rendered blocks 0.05
to 0.06."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Boards:
    """What the boards look like and how well their pictures are predicted.

    ``size_m`` side; ``rim_share`` of it, white; ``upper_left``: ``black``, ``white`` or ``either``;
    ``search_m``: one sigma of the place of the block in the world; ``least_px``: least height of a board;
    ``least_score``: least correlation; ``least_images``: that must agree on a point.
    """

    size_m: float
    rim_share: float = 0.06
    upper_left: str = "either"
    search_m: float = 0.5
    least_px: float = 8.0
    least_score: float = 0.7
    least_images: int = 3

    @property
    def module_m(self) -> float:
        """Side of a black quarter."""
        return self.size_m * (1 - 2 * self.rim_share) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Marks as a table with the columns of `COLUMNS`, and what was found: counts by reason, notes."""

    table: pd.DataFrame
    counts: dict[str, int]
    notes: list[str] = field(default_factory=list)


@dataclass(slots=True)
class _Sight:
    """A board in an image: indices, prediction (2,), pixels by module (2, 2), window, candidates, outcome."""

    image: int
    point: int
    xy: ArrayF
    by_module: ArrayF
    reach_px: float
    found: list[tuple[float, ArrayF, int]]
    reason: str = ""
    score: float = float("nan")
    fitted: ArrayF | None = None
    sigma_px: float = float("nan")


def measure_boards(
    block: ImageBlock, control: ControlPoints, boards: Boards, grey: Loader, mask: Loader
) -> Measured:
    """Measure all boards in all images of a block that lies roughly in the world frame.

    Parameters
    ----------
    grey, mask : grey values, and 0 where nothing may be measured, by the name of the image.

    Raises
    ------
    GeometryError : no control points.
    """
    if not len(control.names):
        raise GeometryError("no control points to look for", expected="a table of their coordinates")
    notes: list[str] = []
    wide = _sights(block, control, boards, boards.search_m, mask)
    _search(block, wide, boards, grey)
    points = _agreed(block, wide, len(control.names), boards)
    moved = _moved(points, control, notes)
    if moved is not None:
        block = block.transformed(moved.R, moved.shift_m, moved.scale)
    known = np.isfinite(points[:, 0])
    # the board's own place as the images see it, where they do: the survey may be off
    place = control.points_wcs_m.copy()
    if moved is not None:
        place[known] = moved.apply(points[known])
    elif known.any():
        place[known] = points[known]
    narrow = _sights(block, control, boards, 0.0, mask, place)
    for sight in narrow:
        # boards that no images agreed on keep their wide window, but now in a block that fits better
        if not known[sight.point]:
            sight.reach_px = _reach_px(block, sight, boards, 0.3 * boards.search_m)
    _search(block, narrow, boards, grey, fit=True)
    _consistent(block, narrow, len(control.names), boards)
    return _table(block, control, narrow, notes)


def _sights(
    block: ImageBlock,
    control: ControlPoints,
    boards: Boards,
    search_m: float,
    mask: Loader,
    place: ArrayF | None = None,
) -> list[_Sight]:
    """Where each board should be in each image; boards outside of an image are left out without a word."""
    place = control.points_wcs_m if place is None else place
    out = []
    masks: dict[int, AnyArray | None] = {}
    for k, centre in enumerate(place):
        toward = block.centre_block_m.mean(axis=0) - centre
        near = np.argsort(np.linalg.norm(block.centre_block_m - centre, axis=1))[:10]
        toward = block.centre_block_m[near].mean(axis=0) - centre
        right = np.cross([0.0, 0.0, 1.0], toward)
        if np.linalg.norm(right) < 1e-6:
            continue
        # seen from the river, its right is to the left of the direction toward the river
        axes = np.stack([right / np.linalg.norm(right), [0.0, 0.0, -1.0]], axis=1) * boards.module_m
        seen = np.einsum("ij,ijk->ik", centre - block.centre_block_m, block.R_block_ccs)
        for i in range(len(block.images)):
            camera = block.cameras[block.camera[i]]
            if camera.model == "perspective" and seen[i, 2] <= 0:
                continue
            xy, by_seen, _ = camera.project_with_derivatives(seen[i : i + 1])
            if not np.isfinite(xy).all() or not camera.inside(xy, 3.0)[0]:
                continue
            by_module = by_seen[0] @ block.R_block_ccs[i].T @ axes
            sight = _Sight(i, k, xy[0], by_module, 0.0, [])
            sight.reach_px = _reach_px(block, sight, boards, search_m)
            height = 2.0 * float(np.linalg.norm(by_module[:, 1]))
            if height < boards.least_px:
                sight.reason = f"too small: {height:.0f} px"
            if i not in masks:
                masks[i] = mask(block.images[i])
            veil = masks[i]
            if veil is not None and search_m == 0.0 and not sight.reason:
                y, x = (int(v) for v in np.clip(xy[0][::-1], 0, np.array(veil.shape) - 1))
                if veil[y, x] == 0:
                    sight.reason = "masked"
            out.append(sight)
    return out


def _reach_px(block: ImageBlock, sight: _Sight, boards: Boards, search_m: float) -> float:
    """Half width of the window: three sigmas of the place, and a part of the board."""
    module = float(np.linalg.norm(sight.by_module[:, 1]))
    return max(_NARROW_PX, _NARROW_MODULES * module) + 3.0 * search_m * module / boards.module_m


def _search(
    block: ImageBlock, sights: Sequence[_Sight], boards: Boards, grey: Loader, *, fit: bool = False
) -> None:
    """Candidates of each sight, best first; with ``fit`` also the fitted crossing of the best."""
    for image in sorted({s.image for s in sights if not s.reason}):
        own = [s for s in sights if s.image == image and not s.reason]
        picture = grey(block.images[image])
        if picture is None:
            for sight in own:
                sight.reason = "no picture"
            continue
        for sight in own:
            _correlate(picture, sight, boards)
        found = [s for s in own if s.found]
        if fit and found:
            start = np.array([s.found[0][1] for s in found])
            sign = np.array([float(s.found[0][2]) for s in found])
            crossing = fit_saddles(picture, start, np.array([s.by_module for s in found]), sign)
            for k, sight in enumerate(found):
                if crossing.good[k]:
                    sight.fitted, sight.sigma_px = (
                        crossing.xy_px[k],
                        float(np.hypot(crossing.sigma_px[k], _FLOOR_PX)),
                    )
                else:
                    sight.reason = "no clean crossing"


def _correlate(picture: ArrayU8, sight: _Sight, boards: Boards) -> None:
    """Fill in the candidates of a sight: score, place, sign (+1: lower right and upper left white)."""
    half = np.ceil(np.abs(sight.by_module).sum(axis=1) * _REACH_MODULES).astype(int) + 1
    low = np.floor(sight.xy - sight.reach_px).astype(int) - half
    high = np.ceil(sight.xy + sight.reach_px).astype(int) + half + 1
    h, w = picture.shape
    low, high = np.maximum(low, 0), np.minimum(high, [w, h])
    window = picture[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    best: AnyArray | None = None
    for breadth in _BREADTHS:
        shape = _template(sight.by_module * np.array([breadth, 1.0]))
        if window.shape[0] < shape.shape[0] or window.shape[1] < shape.shape[1]:
            continue
        score = cv2.matchTemplate(window, shape, cv2.TM_CCOEFF_NORMED)
        # the middle of the template in the picture; smaller templates begin nearer to the edge
        full = np.zeros(window.shape, np.float32)
        y, x = shape.shape[0] // 2, shape.shape[1] // 2
        full[y : y + score.shape[0], x : x + score.shape[1]] = score
        best = full if best is None else np.where(np.abs(full) > np.abs(best), full, best)
    sight.found = []
    if best is None:
        sight.reason = "at the edge of the image"
        return
    rank = {"white": best, "black": -best}.get(boards.upper_left, np.abs(best))
    yy, xx = np.mgrid[: best.shape[0], : best.shape[1]]
    away = np.hypot(xx + low[0] + 0.5 - sight.xy[0], yy + low[1] + 0.5 - sight.xy[1])
    rank = np.where(away <= sight.reach_px, rank, 0.0)
    apart = max(2.0, _DIFFER_MODULES * float(np.linalg.norm(sight.by_module[:, 1])))
    for _ in range(_CANDIDATES):
        y, x = (int(v) for v in np.unravel_index(int(np.argmax(rank)), rank.shape))
        if rank[y, x] < boards.least_score:
            break
        sight.found.append(
            (float(rank[y, x]), np.array([x + low[0] + 0.5, y + low[1] + 0.5]), 1 if best[y, x] > 0 else -1)
        )
        rank[np.hypot(xx - x, yy - y) < apart] = 0.0
    if sight.found:
        sight.score = sight.found[0][0]
    else:
        sight.score = float(rank.max())
        sight.reason = "no crossing found"


def _template(by_module: ArrayF) -> AnyArray:
    """Grey values of a checker, white where both sheet coordinates grow or both fall; odd sides."""
    half = np.maximum(np.ceil(np.abs(by_module).sum(axis=1) * _REACH_MODULES).astype(int), 2)
    x, y = np.meshgrid(np.arange(-half[0], half[0] + 1), np.arange(-half[1], half[1] + 1))
    u, v = np.einsum("ij,jhw->ihw", np.linalg.inv(by_module), np.stack([x, y]).astype(np.float64))
    soft = 0.7 / np.linalg.norm(by_module, axis=0)
    inside = (np.abs(u) < 1.0) & (np.abs(v) < 1.0)
    return (np.tanh(u / soft[0]) * np.tanh(v / soft[1]) * inside).astype(np.float32)


def _agreed(block: ImageBlock, sights: Sequence[_Sight], n_points: int, boards: Boards) -> ArrayF:
    """(k, 3) places on which most images agree, each by one of its candidates; NaN if too few do."""
    out = np.full((n_points, 3), np.nan)
    for k in range(n_points):
        own = [s for s in sights if s.point == k and s.found]
        if len({s.image for s in own}) < boards.least_images:
            continue
        options = [(s, xy) for s in own for _, xy, _ in s.found]
        rays, centres = _rays(block, options)
        best, agree = np.full(3, np.nan), 0.0
        order = np.argsort([-s.score for s, _ in options], kind="stable")[:12]
        for a in order:
            for b in order:
                if options[a][0].image >= options[b][0].image:
                    continue
                point = nearest_to_rays(centres[[a, b]], rays[[a, b]])
                if not np.isfinite(point).all():
                    continue
                good = _near(block, options, point)
                votes = sum(max((s.score for s, _ in group), default=0.0) for group in _by_image(good))
                if votes > agree:
                    chosen = [o for o in options if any(o[0] is g[0] and o[1] is g[1] for g in good)]
                    r, c = _rays(block, chosen)
                    best, agree = nearest_to_rays(c, r), votes
        good = _near(block, options, best) if np.isfinite(best).all() else []
        if len({s.image for s, _ in good}) >= boards.least_images:
            out[k] = best
    return out


def _near(
    block: ImageBlock, options: Sequence[tuple[_Sight, ArrayF]], point: ArrayF
) -> list[tuple[_Sight, ArrayF]]:
    near = []
    for sight, xy in options:
        seen = (point - block.centre_block_m[sight.image]) @ block.R_block_ccs[sight.image]
        at = block.cameras[block.camera[sight.image]].project(seen)[0]
        limit = max(_AGREE_PX, _AGREE_MODULES * float(np.linalg.norm(sight.by_module[:, 1])))
        if np.linalg.norm(at - xy) < limit:
            near.append((sight, xy))
    return near


def _by_image(options: Sequence[tuple[_Sight, ArrayF]]) -> list[list[tuple[_Sight, ArrayF]]]:
    return [[o for o in options if o[0].image == i] for i in {o[0].image for o in options}]


def _rays(block: ImageBlock, options: Sequence[tuple[_Sight, ArrayF]]) -> tuple[ArrayF, ArrayF]:
    rays = [
        block.R_block_ccs[s.image] @ block.cameras[block.camera[s.image]].rays(xy[None])[0]
        for s, xy in options
    ]
    return np.array(rays).reshape(-1, 3), block.centre_block_m[[s.image for s, _ in options]].reshape(-1, 3)


def _moved(points: ArrayF, control: ControlPoints, notes: list[str]) -> Similarity | None:
    """Similarity that moves the block onto the survey of the boards found; None for too few of them."""
    rows = np.flatnonzero(np.isfinite(points[:, 0]))
    if len(rows) < 3:
        notes.append(f"Only {len(rows)} boards were found in the first search; the block stays where it was")
        return None
    try:
        found = robust_similarity(
            points[rows], control.points_wcs_m[rows], [control.names[i] for i in rows], what="boards"
        )
    except GeometryError as error:
        notes.append(f"The block stays where it was: {error.found}")
        return None
    notes += found.notes
    return found


def _consistent(block: ImageBlock, sights: Sequence[_Sight], n_points: int, boards: Boards) -> None:
    """Crossings that the other images of a board contradict are marked."""
    for k in range(n_points):
        own = [s for s in sights if s.point == k and s.fitted is not None]
        options = [(s, s.fitted) for s in own if s.fitted is not None]
        if len(options) < 2:
            for sight in own:
                sight.reason = "in one image only"
            continue
        rays, centres = _rays(block, options)
        point = nearest_to_rays(centres, rays)
        good = {id(s) for s, _ in _near(block, options, point)} if np.isfinite(point).all() else set()
        for sight in own:
            second = sight.found[1][0] if len(sight.found) > 1 else 0.0
            if id(sight) not in good:
                sight.reason = "not where the other images put it"
            elif second > sight.score - _CLEAR:
                sight.reason = "ambiguous"


def _table(block: ImageBlock, control: ControlPoints, sights: Sequence[_Sight], notes: list[str]) -> Measured:
    rows = []
    for s in sorted(sights, key=lambda s: (s.point, s.image)):
        xy = s.xy if s.fitted is None else s.fitted
        used = s.fitted is not None and not s.reason
        rows.append((block.images[s.image], control.names[s.point], *xy, s.sigma_px, s.score, used, s.reason))
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    # the part of a reason before its number
    causes = Counter(str(row[7]).partition(":")[0] for row in rows if not row[6])
    counts = {"used": sum(bool(row[6]) for row in rows), **dict(causes.most_common())}
    for k, name in enumerate(control.names):
        n = int(table.loc[table["point"] == name, "used"].sum())
        if n < 2:
            why = "no image shows its place" if not any(s.point == k for s in sights) else f"{n} marks"
            notes.append(f"{name} was not measured: {why}")
    return Measured(table=table, counts=counts, notes=notes)
