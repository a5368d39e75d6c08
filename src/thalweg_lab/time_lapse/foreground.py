"""What stands before the bank: control points on posts, and the own boat.

A board is an upright square that faces the river, divided into two white and two black quarters, with a white
rim. Its control point is the crossing in its middle. Seen from the river the upper left quarter is black.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from thalweg.core import ArrayB, ArrayF, ArrayF32, ArrayI, Camera, ConfigError, Rigid, optional
from thalweg.core.geometry import RayCaster
from thalweg_lab.random_numbers import generator
from thalweg_lab.reach import River
from thalweg_lab.river import BOX_FACES, boxes, tube_faces, tubes
from thalweg_lab.river_images import Sun
from thalweg_lab.settings import TwinTimeLapse
from thalweg_lab.yard import boat_mesh, sensor_mesh
from thalweg_lab.yard_images import LensRays

cv2 = optional("cv2")

RIM: Final = 0.06
"""Width of the white rim as a share of the board's side."""
_POSTS_BEHIND_M: Final = (0.7, 1.6, 2.8, 4.2, 6.0)
"""Distances of the posts behind the shore."""
_RAISED_M: Final = (0.15, 0.6, 1.2)
"""Heights of the lower edge above the ground."""
_STEP_M: Final = 1.0
_AROUND_M: Final = 12.0
_LEAST_COSINE: Final = 0.42
"""A board seen at more than 65 degrees from its normal does not count as seen."""
_LEAST_TARGET_PX: Final = 10.0
"""Least width of a target in an image that counts as seeing it."""
_MARGIN_PX: Final = 12.0
_POST_M: Final = 0.05
_BEHIND_BOARD_M: Final = 0.015

_AWAY_M: Final = 0.65
"""Distance of the float's axis from the camera."""
_TOP: Final = 0.72
"""Where the top of the float is seen, as a share of the way from the middle of the image down."""
_BOW: Final = 0.62
"""Where its bow is seen, as a share of the way from the middle of the image to the edge at the bow's side."""
_RADIUS_M: Final = 0.075
_STERN_BEHIND_M: Final = 1.1
_SIDES: Final = 24
_PARTS: Final = 4
_DISC_BELOW_M: Final = 0.06
_WHITE: Final = np.array([0.62, 0.60, 0.52])
_BAND: Final = np.array([0.55, 0.16, 0.05])


# ---------------------------------------------------------------- control points


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
        return Targets(
            names=(),
            centre_wcs_m=none,
            right_wcs=none,
            normal_wcs=none,
            check=np.zeros(0, dtype=bool),
            seen=np.zeros(0, dtype=np.int64),
            size_m=settings.target_size_m,
        )
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
            cure="Lower n_targets or least_images, raise target_size_m or rate_hz, or set "
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
    s, behind, raised = (a.ravel() for a in np.meshgrid(s, _POSTS_BEHIND_M, _RAISED_M, indexing="ij"))
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
        large = focal * settings.target_size_m * facing / range_m >= _LEAST_TARGET_PX
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


# ---------------------------------------------------------------- own boat
#
# The catamaran of `thalweg_lab.river.mesh` itself lies below the field of view of a camera on its mast. The
# float beside it keeps such a small boat upright, and it is what masks have to find. It moves with the
# camera, so its pixels are the same in all images; only its light changes.


class OwnBoat:
    """The boat's image in one camera.

    Parameters
    ----------
    share : (h, w) part of each pixel that the boat covers.
    albedo : (h, w, 3) mean colour of that part.
    normal_ics : (h, w, 3) mean normal, toward the camera.
    """

    def __init__(self, share: ArrayF32, albedo: ArrayF32, normal_ics: ArrayF32) -> None:
        self.share, self.albedo, self.normal_ics = share, albedo, normal_ics
        self.full: ArrayB = share >= 1.0
        """(h, w) pixels that show nothing else."""

    @classmethod
    def seen(cls, lens: LensRays, mounts: Mapping[str, Any], T_ics_ccs: Rigid, *, waterline_m: float) -> Self:
        """The boat in a camera.

        Parameters
        ----------
        lens : ray of each pixel.
        mounts : true mounts; with antenna and lidar the boat carries them.
        T_ics_ccs : mount of the camera.
        waterline_m : height of the ics origin above the water.
        """
        vertices, triangles, n_float, axis = _mesh(lens, mounts, T_ics_ccs, waterline_m)
        caster = RayCaster(vertices, triangles)
        h, w, _ = lens.rays_ccs.shape
        rough = caster.cast(T_ics_ccs.shift_m, _in_ics(lens.rays_ccs.reshape(-1, 3), T_ics_ccs))
        met = np.isfinite(rough.t_hit_m).reshape(h, w).astype(np.uint8)
        some = np.flatnonzero(cv2.dilate(met, np.ones((5, 5), np.uint8)).ravel())
        share = np.zeros(h * w, dtype=np.float32)
        albedo, normal = np.zeros((h * w, 3), dtype=np.float32), np.zeros((h * w, 3), dtype=np.float32)
        if len(some):
            share[some], albedo[some], normal[some] = _averaged(caster, lens, some, T_ics_ccs, n_float, axis)
        share[~np.isfinite(lens.rays_ccs[..., 0].ravel())] = 1.0
        return cls(share.reshape(h, w), albedo.reshape(h, w, 3), normal.reshape(h, w, 3))

    def over(self, light: ArrayF32, R_wcs_ics: ArrayF, sun: Sun, sky: ArrayF) -> ArrayF32:
        """An image (h, w, 3) with the boat before it, in the sun and under a sky of a mean light (3,)."""
        out = light.copy()
        some = np.flatnonzero(self.share.ravel() > 0)
        normal = self.normal_ics.reshape(-1, 3)[some] @ R_wcs_ics.T.astype(np.float32)
        facing = np.maximum(normal @ sun.direction_wcs.astype(np.float32), 0)[:, None]
        around = (0.55 + 0.45 * normal[:, 2:]) * sky.astype(np.float32)
        own = self.albedo.reshape(-1, 3)[some] * (facing * sun.colour.astype(np.float32) + around)
        share = self.share.ravel()[some][:, None]
        flat = out.reshape(-1, 3)
        flat[some] = flat[some] * (1 - share) + own * share
        return out


def _in_ics(rays_ccs: ArrayF32, T_ics_ccs: Rigid) -> ArrayF32:
    return np.asarray(rays_ccs @ T_ics_ccs.R.T.astype(np.float32))


def _mesh(
    lens: LensRays, mounts: Mapping[str, Any], T_ics_ccs: Rigid, waterline_m: float
) -> tuple[ArrayF, ArrayI, int, ArrayF]:
    """Boat in ics; the first triangles, whose number is given, are the float about an axis (k, 3)."""
    points, faces, axis = _float(lens, T_ics_ccs, waterline_m)
    parts = [(points, faces)]
    if "antenna" in mounts:
        antenna = np.asarray(mounts["antenna"]["lever_ics_m"], dtype=np.float64)
        parts.append(boat_mesh(antenna, disc_below_m=_DISC_BELOW_M, waterline_m=waterline_m))
        if "lidar" in mounts:
            lidar = np.asarray(mounts["lidar"]["lever_ics_m"], dtype=np.float64)
            parts.append(sensor_mesh(antenna, lidar, None, waterline_m=waterline_m))
    first = np.cumsum([0] + [len(p) for p, _ in parts])
    triangles = np.concatenate([f + k for (_, f), k in zip(parts, first[:-1], strict=True)])
    return np.concatenate([p for p, _ in parts]), triangles, len(faces), axis


def _float(lens: LensRays, T_ics_ccs: Rigid, waterline_m: float) -> tuple[ArrayF, ArrayI, ArrayF]:
    """A round float along x with two pointed ends, beside the boat where the camera looks; and its axis."""
    view = T_ics_ccs.R[:, 2]
    side = 1.0 if view[1] >= 0 else -1.0
    camera = lens.camera
    w, h = camera.size_px
    middle = camera.rays([[w / 2, h / 2]])[0]
    below = camera.rays([[w / 2, h / 2 + _TOP * h / 2]])[0]
    down = np.arccos(np.clip(np.dot(middle, below), -1.0, 1.0))
    # The bow lies to the right of a camera that looks to port, to the left of one that looks to starboard.
    ahead = np.sign(T_ics_ccs.R[0, 0]) or 1.0
    edge = camera.rays([[w / 2 + ahead * _BOW * w / 2, h / 2]])[0]
    across = np.arccos(np.clip(np.dot(middle, edge), -1.0, 1.0))
    x, y, z = T_ics_ccs.shift_m
    top = min(z + _AWAY_M * np.tan(min(down, 1.2)), waterline_m - 0.03)
    bow = x + _AWAY_M * np.tan(min(across, 1.2))
    at = np.array(
        [bow, bow - 0.03, bow - 0.12, bow - 0.28, bow - _STERN_BEHIND_M, bow - _STERN_BEHIND_M - 0.3]
    )
    girth = _RADIUS_M * np.array([0.05, 0.35, 0.78, 1.0, 1.0, 0.1])
    axis = np.stack([at, np.full(6, y + side * _AWAY_M), top + girth * 0 + _RADIUS_M], axis=1)
    # The bow is drawn up.
    axis[:3, 2] -= _RADIUS_M * np.array([0.55, 0.40, 0.12])
    return tubes(axis[None], girth[None], _SIDES)[0], tube_faces(_SIDES, 6), axis


def _averaged(
    caster: RayCaster, lens: LensRays, pixels: ArrayI, T_ics_ccs: Rigid, n_float: int, axis: ArrayF
) -> tuple[ArrayF32, ArrayF32, ArrayF32]:
    """Covered share (n,), mean colour (n, 3) and mean normal (n, 3) of pixels from 4 x 4 rays."""
    w = lens.rays_ccs.shape[1]
    y, x = np.divmod(pixels, w)
    off = (np.arange(_PARTS) + 0.5) / _PARTS
    a, b = (o.ravel() for o in np.meshgrid(off, off))
    xy = np.stack([(x[:, None] + a).ravel(), (y[:, None] + b).ravel()], axis=1)
    rays = lens.camera.rays(xy).astype(np.float32)
    hits = caster.cast(T_ics_ccs.shift_m, _in_ics(rays, T_ics_ccs))
    met = np.isfinite(hits.t_hit_m)
    point = T_ics_ccs.shift_m + np.where(met, hits.t_hit_m, 0.0)[:, None] * _in_ics(rays, T_ics_ccs)
    normal = np.where((hits.primitive < n_float)[:, None], _round(point, axis), hits.normal)
    normal[np.sum(normal * _in_ics(rays, T_ics_ccs), axis=1) > 0] *= -1.0
    # A band around the float, seams and stains: pattern that a search for features takes for a thing.
    phase = np.mod(point[:, 0], 0.30)
    colour = np.where((phase < 0.05)[:, None], _BAND, _WHITE)
    stain = np.sin(61.0 * point[:, 0] + 23.0 * point[:, 2]) * np.sin(47.0 * point[:, 1] - 39.0 * point[:, 0])
    colour = colour * (1.0 - 0.18 * np.clip(3.0 * stain - 1.5, 0.0, 1.0))[:, None]
    colour = np.where((hits.primitive < n_float)[:, None], colour, 0.35)
    weight = met.astype(np.float64).reshape(len(pixels), -1)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1.0)
    mean = [(weight[..., None] * v.reshape(len(pixels), -1, 3)).sum(axis=1) / total for v in (colour, normal)]
    mean[1] /= np.maximum(np.linalg.norm(mean[1], axis=1, keepdims=True), 1e-9)
    return weight.mean(axis=1).astype(np.float32), mean[0].astype(np.float32), mean[1].astype(np.float32)


def _round(point: ArrayF, axis: ArrayF) -> ArrayF:
    """Normals (n, 3) across the axis (k, 3): a tube without facets."""
    along = np.clip(point[:, 0], axis[-1, 0], axis[0, 0])
    y, z = (np.interp(along, axis[::-1, 0], axis[::-1, i]) for i in (1, 2))
    out = np.stack([np.zeros(len(point)), point[:, 1] - y, point[:, 2] - z], axis=1)
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9))
