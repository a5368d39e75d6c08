"""The calibration field: where cones, sheets, scale bars and targets are (P1 Fig. 2, P2 Fig. 2 and 8).

The middle of the yard is near the origin of wcs, its ground at up = 0. Three lying cones stand to the west
and three to the east of the boat, which heads north or south; as seen from there they stand above each other,
from near and low to far and high. Two upright ones stand north and south, where an upright scanner does not
look.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core.errors import ConfigError
from thalweg.core.rigid import Rigid
from thalweg.core.types import AnyArray, ArrayF, ArrayI
from thalweg.settings.twin.field import CONES, TwinField
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.yard.cones import FieldCone, Plane
from thalweg_lab.yard.furniture import ANTENNA, Bar, Board, bars, boards, ground_sheets
from thalweg_lab.yard.sheets import Sheet, covers

When = Literal["reference", "boat"]
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
_SHIFT_M: Final = 3.4
"""A cone outside the lidar's view is moved north by this."""

_RINGS: Final = ((0.36, (-99, -33, 33, 99)), (0.66, (-66, 0, 66, 132)))
"""Slant distance of two rings of sheets and their azimuths from the side toward the boat, degrees."""

_EYE_WCS_M: Final = np.array([0.0, 0.0, 0.8])
_LEAST_FACING: Final = 0.2
"""Cosine of the angle between the normal of a sheet and the way to the boat's camera amid the yard."""

_SHEET_TOLERANCE_M: Final = 2e-3
"""Hits on a mesh lie a few micrometres off its surface; the back of a board lies a centimetre off."""


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

    def cone_of(self, points_wcs_m: ArrayF, *, tolerance_m: float = 1e-3) -> ArrayI:
        """Index (n,) of the cone whose surface points lie on, -1 where none."""
        out = np.full(len(points_wcs_m), -1, dtype=np.int64)
        for i, cone in enumerate(self.cones):
            centre, radius = cone.sphere
            near = np.flatnonzero((np.abs(points_wcs_m - centre) <= radius + tolerance_m).all(axis=1))
            out[near[cone.holds(points_wcs_m[near], tolerance_m)]] = i
        return out

    def sheet_uv(
        self, points_wcs_m: ArrayF, things: AnyArray, names: tuple[str, ...], extra: Iterable[Sheet] = ()
    ) -> tuple[ArrayI, ArrayF]:
        """Which sheet shows at points that rays have met.

        Parameters
        ----------
        points_wcs_m : (n, 3) places on the mesh of `field_scene`.
        things : (n,) numbers of the objects that were met, see `FieldScene.things`; -1 for none.
        names : names of the objects by number, `FieldScene.names`.
        extra : further sheets, such as that of `antenna_sheet`.

        Returns
        -------
        marker : (n,) printed id, -1 where there is none.
        modules : (n, 2) module coordinates, NaN where there is none.
        """
        marker = np.full(len(points_wcs_m), -1, dtype=np.int64)
        modules = np.full((len(points_wcs_m), 2), np.nan)
        order = np.argsort(things, kind="stable")
        first = np.searchsorted(np.asarray(things)[order], np.arange(len(names) + 1))
        number = {name: i for i, name in enumerate(names)}
        for sheet in (*self.sheets, *extra):
            i = number.get(sheet.thing)
            rows = order[first[i] : first[i + 1]] if i is not None else order[:0]
            if not len(rows):
                continue
            middle = sheet.to_wcs([[5.0, 5.0]])[0]
            near = np.abs(points_wcs_m[rows] - middle).max(axis=1) < 1.5 * sheet.half_side_m
            rows = rows[near]
            uv = sheet.to_modules(points_wcs_m[rows])
            # A sheet is on the front of its board only, and on a cone the other side unrolls elsewhere.
            back = np.linalg.norm(sheet.to_wcs(uv) - points_wcs_m[rows], axis=1) > _SHEET_TOLERANCE_M
            on = covers(uv) & ~back
            marker[rows[on]], modules[rows[on]] = sheet.marker, uv[on]
        return marker, modules


def build_field(config: TwinConfig, seed: int, *, when: When = "reference") -> Field:
    """The field of a campaign; the same seed gives the same field to the last bit.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    when : ``reference`` while the reference is photographed, ``boat`` while the boat is there.

    Raises
    ------
    ConfigError : the section ``twin.field`` is missing.
    """
    field = field_of(config)
    rng = generator(seed, "field cones")
    cones, sheets = [], []
    for number, name in enumerate(CONES):
        cone = _cone(field, name, number, rng)
        cones.append(cone)
        sheets += _sheets_on(field, cone, rng)
    all_bars, bar_boards, bar_sheets = bars(field, generator(seed, "field bars"))
    flat_boards, flat_sheets = boards(field, cones, bar_boards, generator(seed, "field boards"))
    sheets += bar_sheets + flat_sheets + ground_sheets(field, generator(seed, "field ground"))
    targets = tuple(Target(name=f"T{i + 1}", marker=64 + i) for i in range(field.n_targets))
    made = Field(
        config=field,
        cones=tuple(cones),
        sheets=tuple(_printed(field, sheets)),
        boards=(*bar_boards, *flat_boards),
        bars=tuple(all_bars),
        targets=targets,
    )
    return _changed(made) if when == "boat" else made


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


def antenna_sheet(config: TwinConfig, T_wcs_ics: Rigid, lever_ics_antenna_m: ArrayF) -> Sheet:
    """The antenna's marker on the boat: it looks up, and the upper side of the tag looks forward.

    Parameters
    ----------
    config : section ``twin``.
    T_wcs_ics : true pose of the boat.
    lever_ics_antenna_m : (3,) true phase centre in the body frame.
    """
    field = field_of(config)
    middle = np.asarray(lever_ics_antenna_m) + np.array([0.0, 0.0, field.antenna_offset_m])
    plane = Plane(
        origin_wcs_m=T_wcs_ics.apply(middle[None])[0],
        right_wcs=T_wcs_ics.R @ np.array([0.0, 1.0, 0.0]),
        down_wcs=T_wcs_ics.R @ np.array([-1.0, 0.0, 0.0]),
    )
    return Sheet(marker=ANTENNA, module_m=field.flat_module_m, thing="boat", surface=plane)


def _cone(field: TwinField, name: str, number: int, rng: np.random.Generator) -> FieldCone:
    """A cone near its planned place; the builder is a few centimetres and degrees off."""
    bearing, distance, height, off_line = _PLACES[name]
    shift, tilt, half = 0.04 * rng.standard_normal(3), rng.normal(0, 1.5, 2), rng.standard_normal()
    away = np.array([np.sin(np.deg2rad(bearing)), np.cos(np.deg2rad(bearing)), 0.0])
    middle = distance * away + np.array([0.0, 0.0, height]) + shift
    if field.effects.outside_view == name:
        middle[1] += _SHIFT_M
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
        apex_wcs_m=middle - (field.cone_tip_m + field.cone_length_m) / 2 * axis,
        axis_wcs=axis,
        zero_wcs=zero / np.linalg.norm(zero),
        half_angle_rad=float(np.deg2rad(field.half_angle_deg + field.sigma_half_angle_deg * half)),
        start_m=field.cone_tip_m,
        length_m=field.cone_length_m,
        markers=tuple(range(8 * number, 8 * number + 8)),
    )


def _sheets_on(field: TwinField, cone: FieldCone, rng: np.random.Generator) -> list[Sheet]:
    """Eight sheets in two rings, each turned by a multiple of 90 degrees and a little."""
    ids = iter(cone.markers)
    slant_m = field.cone_length_m / np.cos(cone.half_angle_rad)
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


def _printed(field: TwinField, sheets: list[Sheet]) -> list[Sheet]:
    """The sheets with the ids that are really printed on them."""
    other: dict[int, int] = {}
    for a, b in field.effects.swapped_ids:
        other |= {a: b, b: a}
    return [
        replace(s, marker=other.get(s.marker, s.marker), mirrored=s.marker in field.effects.mirrored_ids)
        for s in sheets
    ]


def _changed(field: Field) -> Field:
    """The field after something happened to it between the reference images and the boat."""
    effects = field.config.effects
    cones, sheets = list(field.cones), list(field.sheets)
    for i, cone in enumerate(cones):
        if cone.name != effects.toppled_cone:
            continue
        # It leans about a horizontal line through the lowest point under its base.
        foot = cone.base_wcs_m * [1, 1, 0]
        aside = np.cross(cone.axis_wcs, [0.0, 0.0, 1.0])
        aside = aside / np.linalg.norm(aside) if np.linalg.norm(aside) > 0.3 else np.array([1.0, 0.0, 0.0])
        lean = Rotation.from_rotvec(np.deg2rad(effects.toppled_by_deg) * aside).as_matrix()
        cones[i] = cone.moved(lean, foot)
        sheets = [replace(s, surface=cones[i]) if s.cone == cone.name else s for s in sheets]
    if effects.moved_marker is not None:
        _require_in_view(sheets, effects.moved_marker)
        sheets = [_shifted(s, effects.moved_by_m) if s.marker == effects.moved_marker else s for s in sheets]
    return replace(field, cones=tuple(cones), sheets=tuple(sheets))


def _require_in_view(sheets: list[Sheet], marker: int) -> None:
    """Refuse to move a marker where nobody would notice.

    Raises
    ------
    ConfigError : there is no such marker, or it looks away from the boat.
    """
    sheet = next((s for s in sheets if s.marker == marker), None)
    if sheet is None:
        found = f"marker {marker} is on no board, bar or cone and not on the ground"
    else:
        way = _EYE_WCS_M - sheet.centre_wcs_m()
        if float(way @ sheet.normal_wcs()) > _LEAST_FACING * float(np.linalg.norm(way)):
            return
        found = f"marker {marker} on {sheet.thing} looks away from the boat, which would not see it moved"
    raise ConfigError(
        found,
        expected="a marker that the boat's camera can see",
        where="twin.field.effects.moved_marker",
        cure="Take one of the boards, 70 to 79, or a marker on the inner side of a cone",
    )


def _shifted(sheet: Sheet, way_m: float) -> Sheet:
    if isinstance(sheet.surface, FieldCone):
        slant, azimuth = sheet.place
        return replace(sheet, place=(slant, azimuth + way_m / (slant * np.sin(sheet.surface.half_angle_rad))))
    return replace(sheet, place=(sheet.place[0] + way_m, sheet.place[1]))
