"""Control points: checker boards on posts along the bank, placed where the camera sees them free.

A board is an upright square that faces the river, divided into two white and two black quarters, with a white
rim. Its control point is the crossing in its middle. Seen from the river the upper left quarter is black.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.camera.model import Camera
from thalweg.core.errors import ConfigError
from thalweg.core.geometry.raycast import RayCaster
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.settings.twin.time_lapse import TwinTimeLapse
from thalweg_lab.base.random import generator
from thalweg_lab.base.river import River
from thalweg_lab.river.mesh import BOX_FACES, boxes

RIM: Final = 0.06
"""Width of the white rim as a share of the board's side."""

_BEHIND_M: Final = (0.7, 1.6, 2.8, 4.2, 6.0)
"""Distances of the posts behind the shore."""

_RAISED_M: Final = (0.15, 0.6, 1.2)
"""Heights of the lower edge above the ground."""

_STEP_M: Final = 1.0
_AROUND_M: Final = 12.0
_LEAST_COSINE: Final = 0.42
"""A board seen at more than 65 degrees from its normal does not count as seen."""

_MARGIN_PX: Final = 12.0
_POST_M: Final = 0.05
_BEHIND_BOARD_M: Final = 0.015


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """Boards on the bank.

    Parameters
    ----------
    names : n ids, ``T01`` and so on downstream.
    centre_wcs_m : (n, 3) true crossings.
    right_wcs : (n, 3) unit vectors to the right as seen from the river, horizontal.
    normal_wcs : (n, 3) unit normals toward the river, horizontal.
    check : (n,) whether it is a check point.
    seen : (n,) number of images that see it free and large enough.
    size_m : side of the boards.
    """

    names: tuple[str, ...]
    centre_wcs_m: ArrayF
    right_wcs: ArrayF
    normal_wcs: ArrayF
    check: ArrayB
    seen: ArrayI
    size_m: float

    def corners_wcs_m(self) -> ArrayF:
        """Corners (n, 4, 3): upper left, upper right, lower right, lower left as seen from the river."""
        return corners_of(self.centre_wcs_m, self.right_wcs, self.size_m)

    def mesh(self) -> tuple[ArrayF, ArrayI, ArrayI]:
        """Front faces, backs and posts.

        Returns
        -------
        vertices : (v, 3) in wcs.
        triangles : (m, 3) corners, counter-clockwise seen from outside.
        board : (m,) number of the board whose painted front the triangle is, -1 for backs and posts.
        """
        n = len(self.names)
        front = self.corners_wcs_m()
        back = front - _BEHIND_BOARD_M * self.normal_wcs[:, None]
        ground = self.centre_wcs_m[:, 2] - self.size_m / 2 - max(_RAISED_M) - 0.5
        foot = self.centre_wcs_m - (_BEHIND_BOARD_M + _POST_M / 2 + 0.002) * self.normal_wcs
        height = self.centre_wcs_m[:, 2] - ground
        foot[:, 2] = ground
        turn = np.arctan2(self.right_wcs[:, 1], self.right_wcs[:, 0])
        posts = boxes(foot, np.stack([np.full(n, _POST_M), np.full(n, _POST_M), height], axis=1), turn)
        faces_front, faces_back = np.array([[0, 2, 1], [0, 3, 2]]), np.array([[0, 1, 2], [0, 2, 3]])
        parts = [(front, faces_front), (back, faces_back), (posts, BOX_FACES)]
        vertices, triangles, board, first = [], [], [], 0
        for number, (points, faces) in enumerate(parts):
            k = points.shape[1]
            vertices.append(points.reshape(-1, 3))
            triangles.append((faces[None] + first + k * np.arange(n)[:, None, None]).reshape(-1, 3))
            painted = np.repeat(np.arange(n), len(faces))
            board.append(painted if number == 0 else np.full(len(painted), -1))
            first += k * n
        return np.concatenate(vertices), np.concatenate(triangles), np.concatenate(board)


def corners_of(centre_wcs_m: ArrayF, right_wcs: ArrayF, size_m: float) -> ArrayF:
    """Corners (n, 4, 3) of upright boards, see `Targets.corners_wcs_m`."""
    across = 0.5 * size_m * right_wcs[:, None]
    up = np.array([0.0, 0.0, 0.5 * size_m])
    signs = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]], dtype=np.float64)
    return np.asarray(centre_wcs_m[:, None] + signs[None, :, :1] * across + signs[None, :, 1:] * up)


def place_targets(
    river: River,
    caster: RayCaster,
    camera: Camera,
    poses: Sequence[Rigid],
    settings: TwinTimeLapse,
    seed: int,
) -> Targets:
    """Boards where most images see them, spread along the bank, at different heights.

    The stretch of the bank that the images see is divided into as many parts as there are boards; each part
    gets a board at the place, of those in a grid, that most images see free from corner to corner.

    Raises
    ------
    ConfigError : there are fewer places than boards.
    """
    n = settings.n_targets
    if n == 0:
        none = np.zeros((0, 3))
        return Targets(names=(), centre_wcs_m=none, right_wcs=none, normal_wcs=none,
                       check=np.zeros(0, dtype=bool), seen=np.zeros(0, dtype=np.int64),
                       size_m=settings.target_size_m)  # fmt: skip
    left = _on_left(river, poses, settings)
    s, centre, right, normal = _candidates(river, poses, left, settings, seed)
    seen = _times_seen(caster, camera, poses, centre, right, normal, settings)
    chosen = _spread(s, seen, n, settings.least_images)
    if len(chosen) < n:
        raise ConfigError(
            f"{len(chosen)} places on the {'left' if left else 'right'} bank are seen free in "
            f"{settings.least_images} images",
            expected=f"{n} places for n_targets",
            where="twin.time_lapse.n_targets",
            cure="Lower n_targets, least_images or least_target_px, raise target_size_m or rate_hz, or set "
            "side to the bank that the camera looks at",
        )
    return Targets(
        names=tuple(f"T{k + 1:02d}" for k in range(n)),
        centre_wcs_m=centre[chosen],
        right_wcs=right[chosen],
        normal_wcs=normal[chosen],
        check=np.arange(n) % 3 == 1,
        seen=seen[chosen],
        size_m=settings.target_size_m,
    )


def line_of_sight(
    caster: RayCaster, eye_wcs_m: ArrayF, centre_wcs_m: ArrayF, right_wcs: ArrayF, size_m: float
) -> ArrayB:
    """Whether boards (n,) are seen free from an eye: their middles and their corners."""
    places = np.concatenate(
        [centre_wcs_m[:, None], corners_of(centre_wcs_m, right_wcs, 0.98 * size_m)], axis=1
    )
    way = places.reshape(-1, 3) - eye_wcs_m
    length = np.linalg.norm(way, axis=1)
    free = caster.cast(eye_wcs_m, way / length[:, None]).t_hit_m > length - 0.02
    return np.asarray(free.reshape(-1, places.shape[1]).all(axis=1))


def _on_left(river: River, poses: Sequence[Rigid], settings: TwinTimeLapse) -> bool:
    if settings.side != "seen":
        return settings.side == "left"
    eye = np.stack([p.shift_m for p in poses])
    s, _ = river.to_flow(eye[:, 0], eye[:, 1])
    theta = river.angle(s)
    view = np.stack([p.R[:, 2] for p in poses])
    to_left = -np.sin(theta) * view[:, 0] + np.cos(theta) * view[:, 1]
    return float(np.mean(to_left)) > 0


def _candidates(
    river: River, poses: Sequence[Rigid], left: bool, settings: TwinTimeLapse, seed: int
) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    """Place along the river (n,), middle (n, 3), right (n, 3) and normal (n, 3) of possible boards."""
    eye = np.stack([p.shift_m for p in poses])
    along, _ = river.to_flow(eye[:, 0], eye[:, 1])
    half = river.config.length_m / 2 - 3.0
    low, high = max(along.min() - _AROUND_M, -half), min(along.max() + _AROUND_M, half)
    s = np.arange(low, high, _STEP_M)
    rng = generator(seed, "control points")
    s, behind, raised = (a.ravel() for a in np.meshgrid(s, _BEHIND_M, _RAISED_M, indexing="ij"))
    s = s + rng.uniform(-0.3, 0.3, len(s)) * _STEP_M
    behind = behind + rng.uniform(-0.25, 0.25, len(s))
    raised = raised + rng.uniform(-0.1, 0.1, len(s))
    shore_right, shore_left = river.shores(s)
    n = shore_left + behind if left else -shore_right - behind
    centre = np.empty((len(s), 3))
    centre[:, :2] = river.to_wcs(s, n)
    centre[:, 2] = river.height(s, n) + raised + settings.target_size_m / 2
    theta = river.angle(s) + rng.uniform(-0.15, 0.15, len(s))
    away = np.stack([-np.sin(theta), np.cos(theta), np.zeros(len(s))], axis=1) * (1.0 if left else -1.0)
    right = np.cross(away, [0.0, 0.0, 1.0])
    return s, centre, right, -away


def _times_seen(
    caster: RayCaster,
    camera: Camera,
    poses: Sequence[Rigid],
    centre: ArrayF,
    right: ArrayF,
    normal: ArrayF,
    settings: TwinTimeLapse,
) -> ArrayI:
    """In how many images (n,) a board would be seen free, inside, large enough and not too obliquely."""
    count = np.zeros(len(centre), dtype=np.int64)
    focal = float(camera.parameters[0])
    w, h = camera.size_px
    for pose in poses:
        way = pose.shift_m - centre
        range_m = np.linalg.norm(way, axis=1)
        facing = np.einsum("ij,ij->i", way, normal) / range_m
        large = focal * settings.target_size_m * facing / range_m >= settings.least_target_px
        some = np.flatnonzero(large & (facing > _LEAST_COSINE))
        if not len(some):
            continue
        at = camera.project(pose.inverse().apply(centre[some]))
        # Of the lower part of the image the own boat may cover something.
        inside = (at > _MARGIN_PX).all(axis=1) & (at[:, 0] < w - _MARGIN_PX) & (at[:, 1] < 0.8 * h)
        some = some[inside]
        free = line_of_sight(caster, pose.shift_m, centre[some], right[some], settings.target_size_m)
        count[some[free]] += 1
    return count


def _spread(s: ArrayF, seen: ArrayI, n: int, least: int) -> ArrayI:
    """Places (m,), in order downstream: the best of each part of the bank, else the best of the rest."""
    good = np.flatnonzero(seen >= least)
    if len(good) < n:
        return good[np.argsort(s[good])]
    parts = np.clip(((s[good] - s[good].min()) / max(np.ptp(s[good]), 1e-9) * n).astype(np.int64), 0, n - 1)
    least_m, heights = 0.5 * float(np.ptp(s[good])) / n, len(_RAISED_M)
    chosen: list[int] = []
    for part in range(n):
        here = good[parts == part]
        here = here[[_apart(s, chosen, place) > least_m for place in here.tolist()]]
        if len(here):
            # Neighbours stand at different heights; one height may cost a quarter of the images.
            wanted = here % heights == part % heights
            score = seen[here] * np.where(wanted, 1.0, 0.75)
            chosen.append(int(here[np.argmax(score)]))
    for place in good[np.argsort(-seen[good], kind="stable")].tolist():
        if len(chosen) == n:
            break
        if _apart(s, chosen, place) > least_m:
            chosen.append(place)
    order = np.argsort(s[chosen], kind="stable")
    return np.asarray(np.array(chosen, dtype=np.int64)[order])


def _apart(s: ArrayF, chosen: list[int], place: int) -> float:
    """Way along the river from a place to the nearest chosen one."""
    return float(np.min(np.abs(s[chosen] - s[place]), initial=np.inf))
