"""The calibration field: where cones, sheets, scale bars and targets are (P1 Fig. 2, P2 Fig. 2 and 8).

The middle of the yard is near the origin of wcs, its ground at up = 0. Three lying cones stand to the west
and three to the east of the boat, which heads north or south; as seen from there they stand above each other,
from near and low to far and high. Two upright ones stand north and south, where an upright scanner does not
look.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from thalweg.calibration import MARGIN_MODULES, SADDLES_MODULES, SHEET_MODULES
from thalweg.core import ArrayB, ArrayF, ArrayI, ConfigError, Rigid
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinConfig, TwinField

"""Reference images come first, then the boat; some effects change the field in between."""
_PLACES: Final = {
    # bearing from north and distance of the middle of the cone, its height, axis off the line to the middle
    "C1": (267.5, 3.9, 0.50, 45.0),
    "C2": (272.5, 5.2, 1.30, -40.0),
    "C3": (268.0, 6.9, 2.20, 55.0),
    "C4": (92.5, 3.8, 0.47, -50.0),
    "C5": (87.5, 5.1, 1.32, 38.0),
    "C6": (91.5, 6.8, 2.18, -45.0),
    "C7": (3.0, 5.4, 0.95, None),
    "C8": (182.0, 5.2, 1.00, None),
}
_RINGS: Final = ((0.36, (-99, -33, 33, 99)), (0.66, (-66, 0, 66, 132)))
"""Slant distance of two rings of sheets and their azimuths from the side toward the boat, degrees."""
_EYE_WCS_M: Final = np.array([0.0, 0.0, 0.8])

TARGETS: Final = tuple(range(64, 70))
BOARDS: Final = (*range(70, 80), *range(86, 98), *range(112, 126))
BARS: Final = ((80, 81), (82, 83), (84, 85))
GROUND: Final = tuple(range(99, 107))
ANTENNA: Final = 98
FLAT: Final = (64, 149)
"""Ids of the markers that are not on cones."""
_SIGMA_HALF_ANGLE_DEG: Final = 0.1
"""Scatter of the built half angles of the cones."""
CONE_M: Final = (0.05, 0.70)
"""From the apex along the axis: blunt tip and base of the cones."""
FLAT_MODULE_M: Final = 0.016
"""Side of a module of the markers that are not on cones."""
FENCE_M: Final = 12.0
"""Distance of the fence from the middle."""
BAR_M: Final = 1.5
"""Nominal length of the scale bars."""
ANTENNA_OFFSET_M: Final = -0.030
"""Phase centre above the antenna's marker along the normal of the print: the marker lies on top of it."""
ICS_HEIGHT_M: Final = 0.6
"""Height of the ics origin above the ground on the trolley."""
THICK_M: Final = 0.012
"""Of a board."""
_GAP_DEG: Final = 1.5
_TRIES: Final = 4000
_BAR_PLACES: Final = (
    # bearing, distance, height of the middle, angle of the bar from the horizontal
    (318.0, 5.0, 0.9, 4.0),
    (48.0, 4.8, 1.05, 68.0),
    (221.0, 5.2, 0.75, -25.0),
)

SIDES: Final = 480
"""Of a cone's mesh: at the base, 0.33 m from the axis, chords then lie less than 0.008 mm inside."""

_MIDDLE: Final = SHEET_MODULES / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """A plane with directions to the right and down on the print; right x down points into it."""

    origin_wcs_m: ArrayF
    right_wcs: ArrayF
    down_wcs: ArrayF

    @property
    def normal_wcs(self) -> ArrayF:
        """(3,) toward whoever looks at the print."""
        return np.asarray(-np.cross(self.right_wcs, self.down_wcs))

    def roll(self, flat_m: ArrayF, place: tuple[float, float]) -> ArrayF:
        """Points (n, 3) in wcs of a sheet: right and down (n, 2) from its middle at ``place``."""
        at = flat_m + np.asarray(place)
        return np.asarray(self.origin_wcs_m + at[:, :1] * self.right_wcs + at[:, 1:] * self.down_wcs)

    def unroll(self, points_wcs_m: ArrayF, place: tuple[float, float]) -> ArrayF:
        """Inverse of `roll`; points off the plane are projected onto it."""
        off = points_wcs_m - self.origin_wcs_m
        return np.stack([off @ self.right_wcs, off @ self.down_wcs], axis=1) - np.asarray(place)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldCone:
    """A cone as it really stands.

    Parameters
    ----------
    name : C1 to C8.
    apex_wcs_m : (3,) where its surface would come to a point.
    axis_wcs : (3,) unit vector from the apex into the cone.
    zero_wcs : (3,) unit vector across the axis at which the azimuth is zero.
    half_angle_rad : between axis and surface.
    start_m, length_m : blunt tip and base, from the apex along the axis.
    markers : ids of the sheets on it by the description of the field.
    """

    name: str
    apex_wcs_m: ArrayF
    axis_wcs: ArrayF
    zero_wcs: ArrayF
    half_angle_rad: float
    start_m: float
    length_m: float
    markers: tuple[int, ...] = ()

    @property
    def base_wcs_m(self) -> ArrayF:
        """(3,) middle of the base."""
        return np.asarray(self.apex_wcs_m + self.length_m * self.axis_wcs)

    @property
    def middle_wcs_m(self) -> ArrayF:
        """(3,) middle of the axis between blunt tip and base."""
        return np.asarray(self.apex_wcs_m + (self.start_m + self.length_m) / 2 * self.axis_wcs)

    @property
    def sphere(self) -> tuple[ArrayF, float]:
        """Centre (3,) in wcs and radius of the smallest sphere about it, metres."""
        near, far = self.start_m / np.cos(self.half_angle_rad), self.length_m / np.cos(self.half_angle_rad)
        along = (far**2 - near**2) / (2 * (self.length_m - self.start_m))
        wide = self.length_m * np.tan(self.half_angle_rad)
        return self.apex_wcs_m + along * self.axis_wcs, float(np.hypot(self.length_m - along, wide))

    @property
    def R_cocs_wcs(self) -> ArrayF:
        """(3, 3) rotation into the frame of the cone: z along the axis, x at the azimuth zero."""
        return np.stack([self.zero_wcs, np.cross(self.axis_wcs, self.zero_wcs), self.axis_wcs])

    def to_cocs(self, points_wcs_m: ArrayLike) -> ArrayF:
        """Points (n, 3) in the frame of the cone."""
        return np.asarray((np.asarray(points_wcs_m, dtype=np.float64) - self.apex_wcs_m) @ self.R_cocs_wcs.T)

    def distance_m(self, points_wcs_m: ArrayLike) -> ArrayF:
        """Distance (n,) of points from the endless surface, positive outside."""
        return self._off(self.to_cocs(points_wcs_m))

    def _off(self, points_cocs_m: ArrayF) -> ArrayF:
        across = np.hypot(points_cocs_m[:, 0], points_cocs_m[:, 1])
        along = points_cocs_m[:, 2]
        return np.asarray(across * np.cos(self.half_angle_rad) - along * np.sin(self.half_angle_rad))

    def holds(self, points_wcs_m: ArrayLike, tolerance_m: float) -> ArrayB:
        """Which points (n,) lie on the surface between tip and base, within a tolerance."""
        local = self.to_cocs(points_wcs_m)
        along, near = local[:, 2], np.abs(self._off(local)) <= tolerance_m
        return np.asarray(near & (along >= self.start_m) & (along <= self.length_m))

    def at(self, slant_m: ArrayLike, azimuth_rad: ArrayLike) -> ArrayF:
        """Points (n, 3) in wcs of the surface at slant distances and azimuths (n,)."""
        s, psi = np.asarray(slant_m, dtype=np.float64), np.asarray(azimuth_rad, dtype=np.float64)
        across = s * np.sin(self.half_angle_rad)
        local = np.stack(
            [across * np.cos(psi), across * np.sin(psi), s * np.cos(self.half_angle_rad)], axis=-1
        )
        return np.asarray(self.apex_wcs_m + local @ self.R_cocs_wcs)

    def roll(self, flat_m: ArrayF, place: tuple[float, float]) -> ArrayF:
        """Points of a sheet on the surface.

        Parameters
        ----------
        flat_m : (n, 2) to the right and down on the sheet, from its middle. Down is away from the apex.
        place : slant distance and azimuth of the middle.

        Returns
        -------
        (n, 3) in wcs.
        """
        slant, azimuth = place
        right, down = flat_m[:, 0], flat_m[:, 1] + slant
        # Seen from outside with the apex up, the azimuth grows to the left.
        turn = np.arctan2(right, down) / np.sin(self.half_angle_rad)
        return self.at(np.hypot(right, down), azimuth - turn)

    def unroll(self, points_wcs_m: ArrayF, place: tuple[float, float]) -> ArrayF:
        """Inverse of `roll`: (n, 2) right and down; points off the surface are projected onto it."""
        p = self.to_cocs(points_wcs_m)
        sine, cosine = np.sin(self.half_angle_rad), np.cos(self.half_angle_rad)
        slant = p[:, 2] * cosine + np.hypot(p[:, 0], p[:, 1]) * sine
        turn = place[1] - np.arctan2(p[:, 1], p[:, 0])
        turn = (np.mod(turn + np.pi, 2 * np.pi) - np.pi) * sine
        return np.stack([slant * np.sin(turn), slant * np.cos(turn) - place[0]], axis=1)

    def mesh(self) -> tuple[ArrayF, ArrayI]:
        """Vertices (2 SIDES + 2, 3) in wcs and triangles (4 SIDES, 3), outward, closed at tip and base."""
        turn = 2 * np.pi * np.arange(SIDES) / SIDES
        slants = np.array([self.start_m, self.length_m]) / np.cos(self.half_angle_rad)
        rings = [self.at(np.full(SIDES, s), turn) for s in slants]
        ends = [self.apex_wcs_m + z * self.axis_wcs for z in (self.start_m, self.length_m)]
        i = np.arange(SIDES)
        k, tip, base = (i + 1) % SIDES, np.full(SIDES, 2 * SIDES), np.full(SIDES, 2 * SIDES + 1)
        faces = [(i, i + SIDES, k + SIDES), (i, k + SIDES, k), (tip, i, k), (base, k + SIDES, i + SIDES)]
        # The azimuth turns about the axis into the cone, so outside lies to the left of this order.
        triangles = np.concatenate([np.stack(f, axis=1) for f in faces])[:, ::-1]
        return np.concatenate([*rings, np.stack(ends)]), triangles.astype(np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """One sheet on a surface.

    Parameters
    ----------
    marker : printed id.
    module_m : side of a module.
    thing : name of the object of the scene that it is glued on.
    surface : cone or plane.
    place : middle of the sheet on the surface: slant distance and azimuth, or metres right and down.
    turn_rad : by which the print is turned clockwise.
    """

    marker: int
    module_m: float
    thing: str
    surface: FieldCone | Plane
    place: tuple[float, float] = (0.0, 0.0)
    turn_rad: float = 0.0

    @property
    def cone(self) -> str | None:
        """Name of the cone that it is glued on, if it is one."""
        return self.surface.name if isinstance(self.surface, FieldCone) else None

    @property
    def half_side_m(self) -> float:
        """Half the side of the paper with its margin."""
        return (_MIDDLE + MARGIN_MODULES) * self.module_m

    def _turn(self) -> ArrayF:
        """(2, 2) from the print to right and down on the surface."""
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        return np.array([[cos, -sin], [sin, cos]])

    def to_wcs(self, modules: ArrayLike) -> ArrayF:
        """Points (n, 3) of module coordinates (n, 2)."""
        flat = (np.asarray(modules, dtype=np.float64) - _MIDDLE) * self.module_m
        return self.surface.roll(flat @ self._turn().T, self.place)

    def to_modules(self, points_wcs_m: ArrayLike) -> ArrayF:
        """Module coordinates (n, 2) of points (n, 3) on the surface."""
        flat = self.surface.unroll(np.asarray(points_wcs_m, dtype=np.float64), self.place)
        return np.asarray(flat @ self._turn() / self.module_m + _MIDDLE)

    def saddles_wcs_m(self) -> ArrayF:
        """(4, 3) the four saddles."""
        return self.to_wcs(SADDLES_MODULES)

    def centre_wcs_m(self) -> ArrayF:
        """(3,) mean of the saddles: what RTK measured of a target."""
        return np.asarray(self.saddles_wcs_m().mean(axis=0))

    def normal_wcs(self) -> ArrayF:
        """(3,) in the middle, toward whoever looks at the print."""
        middle, right, down = self.surface.roll(np.array([[0, 0], [1e-6, 0], [0, 1e-6]]), self.place)
        across = -np.cross(right - middle, down - middle)
        return np.asarray(across / np.linalg.norm(across))


# ---------------------------------------------------------------- layout


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A marker that RTK measured: name and marker."""

    name: str
    marker: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """The field as it truly stands.

    Parameters
    ----------
    cones : six lying ones, then two upright ones.
    sheets : all printed sheets but that of the antenna, which is on the boat.
    boards : what flat sheets are glued on.
    bars : scale bars with their true lengths.
    targets : markers that were measured with RTK.
    """

    config: TwinField
    cones: tuple[FieldCone, ...]
    sheets: tuple[Sheet, ...]
    boards: tuple[Board, ...]
    bars: tuple[Bar, ...]
    targets: tuple[Target, ...]

    def cone(self, name: str) -> FieldCone:
        """The cone of a name."""
        return next(c for c in self.cones if c.name == name)

    def sheet(self, marker: int) -> Sheet:
        """The sheet with a printed id."""
        return next(s for s in self.sheets if s.marker == marker)

    def saddles_wcs_m(self) -> dict[tuple[int, int], ArrayF]:
        """True place (3,) of each saddle by printed marker and corner."""
        return {(s.marker, i): p for s in self.sheets for i, p in enumerate(s.saddles_wcs_m())}

    def cone_of(self, points_wcs_m: ArrayF) -> ArrayI:
        """Index (n,) of the cone whose surface points lie on, -1 where none."""
        out = np.full(len(points_wcs_m), -1, dtype=np.int64)
        for i, cone in enumerate(self.cones):
            centre, radius = cone.sphere
            near = np.flatnonzero((np.abs(points_wcs_m - centre) <= radius + 1e-3).all(axis=1))
            out[near[cone.holds(points_wcs_m[near], 1e-3)]] = i
        return out


def build_field(config: TwinConfig, seed: int) -> Field:
    """The field of a campaign; the same seed gives the same field to the last bit.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.

    Raises
    ------
    ConfigError : the section ``twin.field`` is missing.
    """
    field = field_of(config)
    rng = generator(seed, "field cones")
    cones, sheets = [], []
    for number, name in enumerate(_PLACES):
        cone = _cone(field, name, number, rng)
        cones.append(cone)
        sheets += _sheets_on(field, cone, rng)
    all_bars, bar_boards, bar_sheets = bars(generator(seed, "field bars"))
    flat_boards, flat_sheets = boards(field, cones, bar_boards, generator(seed, "field boards"))
    sheets += bar_sheets + flat_sheets + ground_sheets(generator(seed, "field ground"))
    targets = tuple(Target(name=f"T{i + 1}", marker=64 + i) for i in range(field.n_targets))
    return Field(
        config=field,
        cones=tuple(cones),
        sheets=tuple(sheets),
        boards=(*bar_boards, *flat_boards),
        bars=tuple(all_bars),
        targets=targets,
    )


def field_of(config: TwinConfig) -> TwinField:
    """Section ``twin.field``.

    Raises
    ------
    ConfigError : the twin has none.
    """
    if config.field is None:
        raise ConfigError(
            "the twin is a river",
            expected="a calibration field",
            where="twin.field",
            cure="Set twin.size to field or field_tiny, or add a section twin.field",
        )
    return config.field


def antenna_sheet(T_wcs_ics: Rigid, lever_ics_antenna_m: ArrayF) -> Sheet:
    """The antenna's marker on the boat: it looks up, and the upper side of the tag looks forward.

    Parameters
    ----------
    T_wcs_ics : true pose of the boat.
    lever_ics_antenna_m : (3,) true phase centre in the body frame.
    """
    middle = np.asarray(lever_ics_antenna_m) + np.array([0.0, 0.0, ANTENNA_OFFSET_M])
    plane = Plane(
        origin_wcs_m=T_wcs_ics.apply(middle[None])[0],
        right_wcs=T_wcs_ics.R @ np.array([0.0, 1.0, 0.0]),
        down_wcs=T_wcs_ics.R @ np.array([-1.0, 0.0, 0.0]),
    )
    return Sheet(marker=ANTENNA, module_m=FLAT_MODULE_M, thing="boat", surface=plane)


def _cone(field: TwinField, name: str, number: int, rng: np.random.Generator) -> FieldCone:
    """A cone near its planned place; the builder is a few centimetres and degrees off."""
    bearing, distance, height, off_line = _PLACES[name]
    shift, tilt, half = 0.04 * rng.standard_normal(3), rng.normal(0, 1.5, 2), rng.standard_normal()
    away = np.array([np.sin(np.deg2rad(bearing)), np.cos(np.deg2rad(bearing)), 0.0])
    middle = distance * away + np.array([0.0, 0.0, height]) + shift
    axis, zero = np.array([0.0, 0.0, -1.0]), -away
    if off_line is not None:
        axis = Rotation.from_euler("z", off_line, degrees=True).apply(away)
        # Across the axis, and as far as possible toward the boat.
        zero = -away + (away @ axis) * axis
    R = Rotation.from_euler("zx", tilt, degrees=True).as_matrix()
    axis = R @ axis
    zero = R @ zero
    zero = zero - (zero @ axis) * axis
    return FieldCone(
        name=name,
        apex_wcs_m=middle - sum(CONE_M) / 2 * axis,
        axis_wcs=axis,
        zero_wcs=zero / np.linalg.norm(zero),
        half_angle_rad=float(np.deg2rad(field.half_angle_deg + _SIGMA_HALF_ANGLE_DEG * half)),
        start_m=CONE_M[0],
        length_m=CONE_M[1],
        markers=tuple(range(8 * number, 8 * number + 8)),
    )


def _sheets_on(field: TwinField, cone: FieldCone, rng: np.random.Generator) -> list[Sheet]:
    """Eight sheets in two rings, each turned by a multiple of 90 degrees and a little."""
    ids = iter(cone.markers)
    slant_m = CONE_M[1] / np.cos(cone.half_angle_rad)
    scale = slant_m / (0.70 / np.cos(np.deg2rad(25.0)))
    return [
        Sheet(
            marker=next(ids),
            module_m=field.module_m,
            thing=cone.name,
            surface=cone,
            place=(scale * slant, float(np.deg2rad(azimuth + rng.uniform(-1, 1)))),
            turn_rad=float(np.deg2rad(90 * rng.integers(4) + rng.uniform(-2, 2))),
        )
        for slant, azimuths in _RINGS
        for azimuth in azimuths
    ]


# ---------------------------------------------------------------- boards, scale bars and sheets on the ground


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


def bars(rng: np.random.Generator) -> tuple[list[Bar], list[Board], list[Sheet]]:
    """Three scale bars of a sheet at each end; their true lengths are some tenths of a millimetre off."""
    made, boards_, sheets = [], [], []
    for i, (pair, (bearing, distance, height, slope)) in enumerate(zip(BARS, _BAR_PLACES, strict=True)):
        length = BAR_M + rng.normal(0.0, 2e-4)
        middle = _place(bearing, distance, height)
        plane = facing(middle, np.deg2rad(slope), rng.normal(0.0, 4.0, 2))
        half = 0.5 * BAR_M + 6.5 * FLAT_MODULE_M
        name = f"bar S{i + 1}"
        boards_.append(Board(name=name, plane=plane, half_m=(half, 6.5 * FLAT_MODULE_M)))
        for marker, side in zip(pair, (-0.5, 0.5), strict=True):
            sheets.append(
                Sheet(
                    marker=marker,
                    module_m=FLAT_MODULE_M,
                    thing=name,
                    surface=plane,
                    place=(side * length, 0.0),
                )
            )
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
    ids = [*TARGETS[: field.n_targets], *BOARDS]
    half = 6.5 * FLAT_MODULE_M
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
            number, count = i - field.n_targets, len(BOARDS)
        middle = _free_place(number / count, half, seen, rng)
        seen.append(_seen(middle, 1.4 * half))
        plane = facing(middle, rng.uniform(-0.3, 0.3), rng.normal(0.0, 8.0, 2))
        name = f"board {marker}"
        made.append(Board(name=name, plane=plane, half_m=(half, half)))
        sheets.append(Sheet(marker=marker, module_m=FLAT_MODULE_M, thing=name, surface=plane))
    return made, sheets


def ground_sheets(rng: np.random.Generator) -> list[Sheet]:
    """Sheets that lie on the ground around the boat."""
    sheets = []
    for i, marker in enumerate(GROUND):
        bearing = 360.0 * (i + 0.5) / len(GROUND) + rng.uniform(-10, 10)
        turn = rng.uniform(0, 2 * np.pi)
        plane = Plane(
            origin_wcs_m=_place(bearing, rng.uniform(2.2, 3.3), 0.0),
            right_wcs=np.array([np.cos(turn), np.sin(turn), 0.0]),
            down_wcs=np.array([np.sin(turn), -np.cos(turn), 0.0]),
        )
        sheets.append(Sheet(marker=marker, module_m=FLAT_MODULE_M, thing="ground", surface=plane))
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
    share: float, half_m: float, seen: Sequence[tuple[ArrayF, float]], rng: np.random.Generator
) -> ArrayF:
    """A place near a share of the full turn from which no other thing is hidden."""
    directions = np.stack([d for d, _ in seen])
    radii = np.array([r for _, r in seen])
    for attempt in range(_TRIES):
        spread = 8.0 + 0.02 * attempt
        bearing = 360.0 * share + rng.uniform(-spread, spread)
        middle = _place(bearing, rng.uniform(4.3, 8.0), rng.uniform(0.3, 2.2))
        way, radius = _seen(middle, 1.4 * half_m)
        apart = np.arccos(np.clip(directions @ way, -1.0, 1.0))
        if np.all(apart > radii + radius + np.deg2rad(_GAP_DEG)):
            return middle
    raise ConfigError(
        f"no room for {len(BOARDS)} boards",
        expected="boards that hide neither cones nor each other",
        where="twin.field.n_targets",
        cure="Lower twin.field.n_targets",
    )


# ---------------------------------------------------------------- printed sheets
#
# Module coordinates are those of `thalweg.calibration.marker_sheets`: u to the right and v down from (0,
# 0) to (10, 10), half a module of white margin outside, saddles at (1, 1), (9, 1), (9, 9), (1, 9).


def covers(modules: ArrayF) -> ArrayF:
    """Whether module coordinates (n, 2) lie on the paper, its margin included."""
    low, high = -MARGIN_MODULES, SHEET_MODULES + MARGIN_MODULES
    return np.asarray(np.all((modules >= low) & (modules <= high), axis=1))
