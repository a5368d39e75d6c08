"""Boards, scale bars and sheets on the ground of the calibration field, placed so that they hide no cone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core.errors import ConfigError
from thalweg.core.types import ArrayF
from thalweg.settings.twin.field import TwinField
from thalweg_lab.yard.cones import FieldCone, Plane
from thalweg_lab.yard.sheets import Sheet

TARGETS: Final = tuple(range(64, 70))
BOARDS: Final = (*range(70, 80), *range(86, 98), *range(112, 130))
BARS: Final = ((80, 81), (82, 83), (84, 85))
GROUND: Final = tuple(range(99, 111))
ANTENNA: Final = 98
FLAT: Final = (64, 149)
"""Ids of the markers that are not on cones."""

THICK_M: Final = 0.012
"""Of a board."""

_EYE_WCS_M: Final = np.array([0.0, 0.0, 0.8])
_GAP_DEG: Final = 1.5
_TRIES: Final = 4000

_BAR_PLACES: Final = (
    # bearing, distance, height of the middle, angle of the bar from the horizontal
    (318.0, 5.0, 0.9, 4.0),
    (48.0, 4.8, 1.05, 68.0),
    (221.0, 5.2, 0.75, -25.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A flat board on a post.

    Parameters
    ----------
    name : of the object in the scene.
    plane : its front, with the origin in the middle.
    half_m : half its extent to the right and down.
    """

    name: str
    plane: Plane
    half_m: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """A scale bar between the first saddles of two sheets, with its true length."""

    name: str
    markers: tuple[int, int]
    length_m: float


def facing(middle_wcs_m: ArrayF, turn_rad: float, tilt_deg: ArrayF) -> Plane:
    """A plane that looks toward the middle of the yard, but for tilts about up and across."""
    normal = (_EYE_WCS_M - middle_wcs_m) * [1, 1, 0.5]
    normal /= np.linalg.norm(normal)
    # Seen from the front, right is to the right of whoever stands there: up x normal.
    right = np.cross([0.0, 0.0, 1.0], normal)
    right /= np.linalg.norm(right)
    down = np.cross(right, normal)
    axes = np.stack([right, down, -normal], axis=1) @ Rotation.from_rotvec([0, 0, turn_rad]).as_matrix()
    tilt = Rotation.from_euler("zx", np.asarray(tilt_deg), degrees=True).as_matrix()
    axes = tilt @ axes
    return Plane(origin_wcs_m=middle_wcs_m, right_wcs=axes[:, 0], down_wcs=axes[:, 1])


def bars(field: TwinField, rng: np.random.Generator) -> tuple[list[Bar], list[Board], list[Sheet]]:
    """Three scale bars of a sheet at each end; their true lengths are some tenths of a millimetre off."""
    made, boards_, sheets = [], [], []
    for i, (pair, (bearing, distance, height, slope)) in enumerate(zip(BARS, _BAR_PLACES, strict=True)):
        length = field.bar_length_m + rng.normal(0.0, 2e-4)
        middle = _place(bearing, distance, height)
        plane = facing(middle, np.deg2rad(slope), rng.normal(0.0, 4.0, 2))
        half = 0.5 * field.bar_length_m + 6.5 * field.flat_module_m
        name = f"bar S{i + 1}"
        boards_.append(Board(name=name, plane=plane, half_m=(half, 6.5 * field.flat_module_m)))
        for marker, side in zip(pair, (-0.5, 0.5), strict=True):
            sheets.append(
                Sheet(
                    marker=marker, module_m=field.flat_module_m, thing=name, surface=plane,
                    place=(side * length, 0.0),
                )
            )  # fmt: skip
        made.append(Bar(name=f"S{i + 1}", markers=pair, length_m=float(length)))
    return made, boards_, sheets


def boards(
    field: TwinField, cones: Sequence[FieldCone], taken: Sequence[Board], rng: np.random.Generator
) -> tuple[list[Board], list[Sheet]]:
    """Targets and other markers on boards, all round the yard, none in front of another thing.

    Raises
    ------
    ConfigError : there is no room for so many.
    """
    ids = [*TARGETS[: field.n_targets], *BOARDS[: field.n_boards]]
    half = 6.5 * field.flat_module_m
    seen = [_seen(c.middle_wcs_m, 0.45) for c in cones]
    seen += [
        _seen(b.plane.roll(np.array([[x * b.half_m[0], 0.0]]), (0.0, 0.0))[0], 0.25)
        for b in taken
        for x in (-0.9, -0.45, 0.0, 0.45, 0.9)
    ]
    made, sheets = [], []
    for i, marker in enumerate(ids):
        if i < field.n_targets:
            number, count = i, field.n_targets
        else:
            number, count = i - field.n_targets, max(field.n_boards, 1)
        middle = _free_place(field, number / count, half, seen, rng)
        seen.append(_seen(middle, 1.4 * half))
        plane = facing(middle, rng.uniform(-0.3, 0.3), rng.normal(0.0, 8.0, 2))
        name = f"board {marker}"
        made.append(Board(name=name, plane=plane, half_m=(half, half)))
        sheets.append(Sheet(marker=marker, module_m=field.flat_module_m, thing=name, surface=plane))
    return made, sheets


def ground_sheets(field: TwinField, rng: np.random.Generator) -> list[Sheet]:
    """Sheets that lie on the ground around the boat."""
    sheets = []
    for i, marker in enumerate(GROUND[: field.n_ground]):
        bearing = 360.0 * (i + 0.5) / field.n_ground + rng.uniform(-10, 10)
        turn = rng.uniform(0, 2 * np.pi)
        plane = Plane(
            origin_wcs_m=_place(bearing, rng.uniform(2.2, 3.3), 0.0),
            right_wcs=np.array([np.cos(turn), np.sin(turn), 0.0]),
            down_wcs=np.array([np.sin(turn), -np.cos(turn), 0.0]),
        )
        sheets.append(Sheet(marker=marker, module_m=field.flat_module_m, thing="ground", surface=plane))
    return sheets


def _place(bearing_deg: float, distance_m: float, height_m: float) -> ArrayF:
    a = np.deg2rad(bearing_deg)
    return np.array([distance_m * np.sin(a), distance_m * np.cos(a), height_m])


def _seen(place_wcs_m: ArrayF, radius_m: float) -> tuple[ArrayF, float]:
    """Direction (3,) of a thing from the middle of the yard and its angular radius."""
    way = place_wcs_m - _EYE_WCS_M
    distance = float(np.linalg.norm(way))
    return way / distance, float(np.arctan(radius_m / distance))


def _free_place(
    field: TwinField,
    share: float,
    half_m: float,
    seen: Sequence[tuple[ArrayF, float]],
    rng: np.random.Generator,
) -> ArrayF:
    """A place near a share of the full turn from which no other thing is hidden."""
    directions = np.stack([d for d, _ in seen])
    radii = np.array([r for _, r in seen])
    for attempt in range(_TRIES):
        spread = 8.0 + 0.02 * attempt
        bearing = 360.0 * share + rng.uniform(-spread, spread)
        middle = _place(bearing, rng.uniform(4.3, min(8.0, field.fence_m - 2.0)), rng.uniform(0.3, 2.2))
        way, radius = _seen(middle, 1.4 * half_m)
        apart = np.arccos(np.clip(directions @ way, -1.0, 1.0))
        if np.all(apart > radii + radius + np.deg2rad(_GAP_DEG)):
            return middle
    raise ConfigError(
        f"no room for {field.n_boards} boards",
        expected="boards that hide neither cones nor each other",
        where="twin.field.n_boards",
        cure="Lower twin.field.n_boards or twin.field.flat_module_m",
    )
