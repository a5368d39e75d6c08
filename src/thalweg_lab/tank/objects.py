"""Test objects with known geometry: panel, stepped object and wreck of P4 7.1, two-level grid (P3 2.4), marks
on it.

Frames of the objects are in millimetres with Z up; X runs along the laser line, that of the wreck along its
keel, and its Z = 0 is the ground it lies on.

The marks on the calibration object serve the exterior orientation of the sensor's camera. P4 4.3 determines
it before water and housing are there; a picture through window and water serves as well. The marks' plane
coordinates come from a bundle adjustment, their depths from a calliper.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core import ArrayF, ArrayI, GeometryError
from thalweg.lightsheet.optics import Sensor
from thalweg_lab.random_numbers import generator
from thalweg_lab.tank.forward import see
from thalweg_lab.tank.surfaces import (
    Pieces,
    Spots,
    Surface,
    Texture,
    box,
    noise_relief,
    rectangle,
    relief,
    rod,
    sheet,
)

STEP_HEIGHTS_MM: Final = (0.006, 20.195, 40.135)
"""Levels of the stepped object from plane fits (P4 7.1)."""

STEP_SIZE_MM: Final = (300.0, 65.0, 45.0)
"""Length, width and height of the stepped object (P4 7.1)."""

BLACK: Final = (0.04, 0.04, 0.04)
WHITE: Final = (0.9, 0.9, 0.9)
GREY: Final = (0.45, 0.45, 0.45)
SAND: Final = (0.42, 0.36, 0.28)

LENGTH_MM: Final = 260.0
WIDTH_MM: Final = 75.0
HEIGHT_MM: Final = 80.0

_PALETTE: Final = np.array([[0.42, 0.36, 0.28], [0.34, 0.25, 0.17], [0.40, 0.33, 0.25], [0.30, 0.22, 0.15]])
"""Sand, hull, deck houses, spars."""

ROUGHNESS_MM: Final = 0.15
"""Standard deviation of the fine relief of hull and ground."""
SIGMA_MARK_MM: Final = 0.03
SIGMA_BAR_MM: Final = 0.01
SIGMA_PX: Final = 0.08


@dataclass(frozen=True, slots=True, kw_only=True)
class GridPattern:
    """Geometry of the calibration object with two or three levels, in its own frame.

    X runs along the line, Y across, Z up; Z = 0 is the top of the upper plate.

    Parameters
    ----------
    gaps_mm : (k, 2) begin and end of each gap of the upper plate along X, in order.
    levels_mm : heights of the levels, the upper first: (0, -90) or (0, -45, -90).
    slot_half_mm : the gaps reach from -this to +this in Y.
    half_size_mm : half length and half width of the upper plate.
    thickness_mm : of the upper plate; 0 for bevelled edges, which clip a beam at one place.
    """

    gaps_mm: ArrayF
    levels_mm: tuple[float, ...] = (0.0, -90.0)
    slot_half_mm: float = 22.0
    half_size_mm: tuple[float, float] = (95.0, 30.0)
    thickness_mm: float = 0.0

    def __post_init__(self) -> None:
        """Refuse gaps and levels that make no grid.

        Raises
        ------
        GeometryError : gaps overlap or leave the plate, or levels do not go downwards.
        """
        edges = np.asarray(self.gaps_mm, dtype=np.float64).ravel()
        if not (np.diff(edges) > 0).all() or np.abs(edges).max() >= self.half_size_mm[0]:
            raise GeometryError(
                f"gaps with the edges {edges.tolist()} mm",
                expected=f"growing numbers within {self.half_size_mm[0]:g} mm of the middle",
            )
        if (
            len(self.levels_mm) not in (2, 3)
            or self.levels_mm[0] != 0.0
            or not (np.diff(self.levels_mm) < 0).all()
        ):
            raise GeometryError(f"levels {self.levels_mm} mm", expected="two or three, from 0 downwards")

    @classmethod
    def regular(cls, *, levels_mm: tuple[float, ...] = (0.0, -90.0)) -> "GridPattern":
        """Equal gaps; the middle one is half as wide again, so that a shift by one gap shows."""
        centre = 10.0 * (np.arange(11) - 5.0)
        width = np.full(11, 3.5)
        width[5] *= 1.5
        gaps = np.stack([centre - width / 2, centre + width / 2], axis=1)
        return cls(gaps_mm=gaps, levels_mm=levels_mm)

    def bars_mm(self) -> ArrayF:
        """(k + 1, 2) begin and end of what is between the gaps, the ends of the plate included."""
        edges = np.concatenate([[-self.half_size_mm[0]], self.gaps_mm.ravel(), [self.half_size_mm[0]]])
        return edges.reshape(-1, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """Marks in lcs.

    ``marker`` (m,), true ``xyz_lcs_mm`` (m, 3), ``measured_lcs_mm`` (m, 3); ``bars`` (b, 2) markers at the
    ends of the scale bars, ``bar_mm`` (b,) their certified lengths.
    """

    marker: ArrayI
    xyz_lcs_mm: ArrayF
    measured_lcs_mm: ArrayF
    bars: ArrayI
    bar_mm: ArrayF


def panel(*, albedo: tuple[float, float, float] = GREY, markers: bool = False) -> Surface:
    """A plane panel about its origin, if wished with a grid of black round marks of 3 mm radius."""
    pieces = Pieces()
    half = 210.0
    pieces.add(rectangle((-half, half), (-half, half), 0.0), 0)
    spots = None
    if markers:
        at = np.arange(-half + 20.0, half, 40.0)
        X, Y = np.meshgrid(at, at)
        centre = np.stack([X.ravel(), Y.ravel(), np.zeros(X.size)], axis=1)
        spots = Spots(centre_mm=centre, radius_mm=np.full(len(centre), 3.0), albedo=BLACK)
    return pieces.surface(np.array([albedo]), "panel", spots=spots)


def stepped_markers_mm() -> ArrayF:
    """(n, 3) centres of the white marks on the three levels of the stepped object."""
    out = []
    for level, height in enumerate(STEP_HEIGHTS_MM):
        for x in -150.0 + 100.0 * level + np.array([14.0, 32.0, 50.0, 68.0, 86.0]):
            out += [(x, y, height) for y in (-22.0, -7.0, 8.0, 23.0)]
    return np.array(out)


def stepped_object(*, markers: bool = True) -> Surface:
    """The black stepped object on a sandy ground; its origin is the middle at height 0."""
    length, width, height = STEP_SIZE_MM
    ground = STEP_HEIGHTS_MM[-1] - height
    pieces = Pieces()
    for level, top in enumerate(STEP_HEIGHTS_MM):
        x = -length / 2 + level * length / 3
        low, high = np.array([x, -width / 2, ground]), np.array([x + length / 3, width / 2, top])
        pieces.add(box(low, high), 0)
    pieces.add(rectangle((-260.0, 260.0), (-260.0, 260.0), ground), 1)
    spots = None
    if markers:
        centres = stepped_markers_mm()
        spots = Spots(centre_mm=centres, radius_mm=np.full(len(centres), 4.0), albedo=WHITE)
    return pieces.surface(np.array([BLACK, SAND]), "stepped_object", spots=spots)


def grid_object(pattern: GridPattern) -> Surface:
    """The calibration object: a white plate with gaps above a white plate; a third level fills one half.

    The middle level lies below the half with X > 0 only, so that gaps there show the first and the second
    level and the others the first and the third.
    """
    pieces = Pieces()
    half_x, half_y = pattern.half_size_mm
    slot, t = pattern.slot_half_mm, pattern.thickness_mm
    parts = [((-half_x, half_x), (-half_y, -slot)), ((-half_x, half_x), (slot, half_y))]
    parts += [((float(a), float(b)), (-slot, slot)) for a, b in pattern.bars_mm()]
    for x, y in parts:
        if t > 0:
            pieces.add(box(np.array([x[0], y[0], -t]), np.array([x[1], y[1], 0.0])), 0)
        else:
            pieces.add(rectangle(x, y, 0.0), 0)
    if len(pattern.levels_mm) == 3:
        pieces.add(rectangle((0.0, 200.0), (-160.0, 160.0), pattern.levels_mm[1]), 1)
    pieces.add(rectangle((-260.0, 260.0), (-260.0, 260.0), pattern.levels_mm[-1]), 1)
    return pieces.surface(np.array([GREY, GREY]), "calibration_grid")


def wreck(seed: int, *, spars: bool = True, ground: bool = True, step_mm: float = 0.8) -> Surface:
    """A wreck; another seed gives another one of the same kind.

    Parameters
    ----------
    seed : of the campaign; the streams are ``light sheet wreck ...``.
    spars : with masts and a lying spar, thin parts that interrupt lines.
    ground : with the sandy ground around.
    step_mm : width of the mesh of hull and ground.
    """
    rng = generator(seed, "light sheet wreck shape")
    pieces = Pieces()
    hull_height = rng.uniform(40.0, 50.0)
    pieces.add(_hull(seed, rng, hull_height, step_mm), 1)
    for at, size in ((0.28, 0.16), (-0.36, 0.11)):
        x, y = at * LENGTH_MM, rng.uniform(-6.0, 6.0)
        half = np.array([size * LENGTH_MM / 2, rng.uniform(8.0, 15.0)])
        top = hull_height + rng.uniform(4.0, 16.0)
        pieces.add(
            box(np.array([x - half[0], y - half[1], 8.0]), np.array([x + half[0], y + half[1], top])), 2
        )
    # always drawn, so that a wreck with and without spars is the same otherwise
    masts, lean = rng.uniform(-0.3, 0.2, 2), rng.uniform(-6.0, 6.0, (2, 2))
    across = rng.uniform(-0.2, 0.2)
    if spars:
        for at, tilt in zip(masts, lean, strict=True):
            foot = np.array([at * LENGTH_MM, 0.0, 5.0])
            pieces.add(rod(foot, np.array([foot[0] + tilt[0], tilt[1], HEIGHT_MM]), 2.0), 3)
        z, aside = hull_height + 6.0, np.array([0.0, 40.0 * across, 0.0])
        start, end = (
            np.array([-0.42 * LENGTH_MM, -22.0, z - 4.0]),
            np.array([0.42 * LENGTH_MM, 22.0, z + 4.0]),
        )
        pieces.add(rod(start + aside, end + aside, 1.6), 3)
    if ground:
        pieces.add(_ground(seed, step_mm), 0)
    texture = Texture.draw(
        generator(seed, "light sheet wreck texture"), strength=0.12, lengths_mm=(3.0, 40.0)
    )
    return pieces.surface(_PALETTE, "wreck", texture=texture)


def build_board(sensor: Sensor, seed: int) -> Board:
    """Marks on two levels of the field of view: 6 x 5 on each; two bars lie on the lower one."""
    t = sensor.window.thickness_mm
    places = []
    for depth in (60.0, 150.0):
        reach = 40.0 + 0.35 * depth
        X, Y = np.meshgrid(np.linspace(-reach, reach, 6), np.linspace(-130.0, -40.0, 5))
        places.append(np.stack([X.ravel(), Y.ravel(), np.full(X.size, -t - depth)], axis=1))
    true = np.concatenate(places)
    marker = np.arange(1, len(true) + 1)
    error = generator(seed, "light sheet board marks").standard_normal(true.shape)
    lower = marker[30:].reshape(5, 6)
    bars = np.array([[lower[0, 0], lower[0, 5]], [lower[4, 0], lower[4, 5]]])
    length = np.linalg.norm(true[bars[:, 0] - 1] - true[bars[:, 1] - 1], axis=1)
    bar_error = generator(seed, "light sheet board bars").standard_normal(2)
    return Board(
        marker=marker,
        xyz_lcs_mm=true,
        measured_lcs_mm=true + SIGMA_MARK_MM * error,
        bars=bars,
        bar_mm=length + SIGMA_BAR_MM * bar_error,
    )


def dry(sensor: Sensor) -> Sensor:
    """The sensor without water and without its window."""
    n = sensor.window.n_air
    return replace(sensor, window=replace(sensor.window, thickness_mm=0.0, n_glass=n, n_water=n))


def observe_board(sensor: Sensor, board: Board, seed: int, *, name: str) -> tuple[ArrayI, ArrayF]:
    """Markers (n,) in the picture and their image coordinates (n, 2) with noise."""
    xy = see(sensor, board.xyz_lcs_mm).xy_px
    noise = generator(seed, f"light sheet {name} marks").standard_normal(xy.shape)
    inside = sensor.camera.inside(xy)
    return board.marker[inside], (xy + SIGMA_PX * noise)[inside]


def _hull(seed: int, rng: np.random.Generator, height_mm: float, step_mm: float) -> tuple[ArrayF, ArrayI]:
    """Half a barrel with pointed ends, planks, and holes that light passes."""
    n_along, n_around = int(LENGTH_MM / step_mm), int(2.2 * WIDTH_MM / step_mm)
    t = np.linspace(-1.0, 1.0, n_along)
    around = np.linspace(0.0, np.pi, n_around)
    slim = np.maximum(1.0 - np.abs(t) ** 3, 0.0) ** 0.7
    planks = 0.25 * np.sign(np.sin(18 * around)) * np.abs(np.sin(18 * around)) ** 0.3
    rough = noise_relief(
        t * LENGTH_MM / 2,
        around * WIDTH_MM / 2,
        generator(seed, "light sheet wreck roughness"),
        amplitude_mm=ROUGHNESS_MM,
        lengths_mm=(max(2.5, 2.5 * step_mm), 12.0),
    )
    size = 1.0 + (planks[:, None] + rough) / (WIDTH_MM / 2)
    y = (WIDTH_MM / 2) * np.cos(around)[:, None] * slim * size
    z = height_mm * np.sin(around)[:, None] ** 0.8 * (0.35 + 0.65 * slim) * size
    x = np.broadcast_to(t * LENGTH_MM / 2, y.shape)
    # rows turn about the hull from +y to -y: the order of columns is reversed to face outwards
    vertices, faces = sheet(np.stack([x, y, z], axis=2)[:, ::-1])
    middle = vertices[faces].mean(axis=1)
    keep = np.ones(len(faces), dtype=np.bool_)
    for _ in range(5):
        cx, cy = rng.uniform(-0.4, 0.4) * LENGTH_MM, rng.uniform(-0.35, 0.35) * WIDTH_MM
        rx, ry = rng.uniform(6.0, 16.0), rng.uniform(4.0, 8.0)
        keep &= ((middle[:, 0] - cx) / rx) ** 2 + ((middle[:, 1] - cy) / ry) ** 2 > 1.0
    return vertices, faces[keep]


def _ground(seed: int, step_mm: float) -> tuple[ArrayF, ArrayI]:
    x = np.arange(-200.0, 200.0 + step_mm / 2, step_mm)
    y = np.arange(-160.0, 160.0 + step_mm / 2, step_mm)
    rng = generator(seed, "light sheet wreck ground")
    z = noise_relief(x, y, rng, amplitude_mm=1.2, lengths_mm=(50.0, 250.0))
    z += noise_relief(x, y, rng, amplitude_mm=ROUGHNESS_MM, lengths_mm=(max(2.5, 2.5 * step_mm), 12.0))
    return relief(x, y, np.minimum(z, 3.0))
