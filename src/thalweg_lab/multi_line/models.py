"""Models of a laser that projects n lines, and where their light lies in water.

==================  =========  ===========================================================================
model               unknowns   what is assumed
==================  =========  ===========================================================================
individual          5 n        each line a plane of light of its own (T 4.2.1, first model). An exterior
                               orientation has 6 parameters, but a rotation of a fan in its own plane changes
                               nothing that can be seen, so that 5 are estimable: phi keeps its value
joint centre        3 + 2 n    planes that meet in one point, else free
regular             7          planes that meet in one point at equal angles (T 4.2.1, second model)
diode               11         a diffractive element: order j has the direction cosine ``v0 + g j + e j^2``
across
                               the lines (grating equation, Born & Wolf 1999, sec. 8.6), so that a line is
                               a cone; its origin drifts by ``s1 j`` across and ``s2 |j|`` along the axis
free cones          5 n + 1    each cone its own origin, direction cosine and rotation in the plane of the
element joint cones         4 + 2 n    the same from one origin hierarchical        11 + 5 n   the diode,
and for each line small deviations of the direction cosine, of its rotation and
                               of its origin, with priors whose variances are estimated
==================  =========  ===========================================================================

``j`` counts from the middle line. The unknowns are a plain vector; angles are those of ``R_x R_y R_z``.

For parallel plates the horizontal slowness ``q = n_air (dx, dy)`` of a unit direction ``d`` in air is
conserved by both refractions, so that a beam reaches the depth ``D`` below the outer glass face at::

    c = (x, y)_origin + q (h / sqrt(n_air^2 - q^2) + t / sqrt(n_glass^2 - q^2) + D / sqrt(n_water^2 - q^2))

with ``h`` the height of its origin above the glass of thickness ``t``. A measured image point whose object
point lies on a known level (a depth) gives two equations for the sub-beam ``a`` that met it and for the
error ``e`` of the image point along the direction in which it was measured::

    P - e m = c(a),      m = movement of the object point on its level for one pixel

All of this in the frame of the window: its normal is Z, which a tilted window turns out of lcs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from thalweg.core import ArrayB, ArrayF, ArrayI, GeometryError, rotation_opk
from thalweg.lightsheet.optics import LightSheet, Window

COMPONENTS: Final = 7
"""Origin (3), small rotation about the laser's own axes (3), direction cosine of the line."""

_STEPS: Final = 12
_CLOSE: Final = 1e-13

Kind = Literal["individual", "joint_centre", "regular", "diode", "free_cones", "joint_cones", "hierarchical"]
KINDS: Final[tuple[Kind, ...]] = (
    "individual",
    "joint_centre",
    "regular",
    "diode",
    "free_cones",
    "joint_cones",
    "hierarchical",
)

_POSE: Final = (
    "laser_x_mm",
    "laser_y_mm",
    "laser_z_mm",
    "laser_omega_rad",
    "laser_phi_rad",
    "laser_kappa_rad",
)
_STEP: Final = 1e-6
_HOUSING_MM: Final = 5.0
"""How well the place of a laser is known from its housing."""
_FAN_ENDS_RAD: Final = 0.02
"""How well the ends of the fans tell the middle of the fan."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lines:
    """Geometry of n lines.

    Parameters
    ----------
    labels : (n,) number of each line, ascending.
    origins_lcs_mm : (n, 3).
    R_lcs_las : (n, 3, 3).
    v : (n,) direction cosines along the laser's own y axis.
    half_angle_rad : of the fans.
    """

    labels: ArrayI
    origins_lcs_mm: ArrayF
    R_lcs_las: ArrayF
    v: ArrayF
    half_angle_rad: float

    def sheets(self) -> tuple[LightSheet, ...]:
        """The same lines for `thalweg.lightsheet.optics.intersection`."""
        return tuple(
            LightSheet(
                origin_lcs_mm=self.origins_lcs_mm[i],
                angles_rad=opk_angles(self.R_lcs_las[i]),
                half_angle_rad=self.half_angle_rad,
                v=float(self.v[i]),
                name=f"line {self.labels[i]}",
            )
            for i in range(len(self.labels))
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LineResiduals:
    """Misclosures of image points against their lines.

    Parameters
    ----------
    error_px : (n,) along the measuring direction, measured minus line; NaN where no beam meets the point.
    fan_angle_rad : (n,) of the sub-beam that met the point.
    error_by_geometry, angle_by_geometry : (n, 7) derivatives by `COMPONENTS` of the point's line.
    angle_by_move : (n, 2) derivatives of the angle by a movement of the object point (mm) on its level.
    """

    error_px: ArrayF
    fan_angle_rad: ArrayF
    error_by_geometry: ArrayF
    angle_by_geometry: ArrayF
    angle_by_move: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class NominalDiode:
    """What the data sheet and a first look say.

    Parameters
    ----------
    labels : (n,) numbers of the lines, ascending; 0 is the lowest that the element projects.
    middle : number of the line in the middle of the element (7 of 15).
    origin_lcs_mm, angles_rad : (3,) nominal pose of the laser.
    step_rad : nominal angle between neighbours.
    half_angle_rad : of the fans.
    """

    labels: ArrayI
    middle: float
    origin_lcs_mm: ArrayF
    angles_rad: ArrayF
    step_rad: float
    half_angle_rad: float

    @property
    def orders(self) -> ArrayF:
        """(n,) numbers counted from the middle."""
        return np.asarray(self.labels, dtype=np.float64) - self.middle

    @property
    def pose(self) -> ArrayF:
        """(6,)."""
        return np.r_[self.origin_lcs_mm, self.angles_rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class Prior:
    """Unknowns that are known beforehand: places (k,) among all, mean (k,), one sigma for all."""

    places: ArrayI
    mean: ArrayF
    sigma: float


_Made = tuple[tuple[str, ...], ArrayF, Callable[[ArrayF], Lines], dict[str, Prior]]


@dataclass(frozen=True, slots=True, kw_only=True)
class LineModel:
    """A model of the lines as a function of a vector of unknowns.

    Parameters
    ----------
    kind : its name.
    names : (u,) names of the unknowns.
    start : (u,) approximate values.
    function : unknowns to `Lines`.
    labels : (n,) lines that the model describes.
    priors : by name; those called ``line_...`` are deviations of single lines.
    """

    kind: Kind
    names: tuple[str, ...]
    start: ArrayF
    function: Callable[[ArrayF], Lines]
    labels: ArrayI
    priors: dict[str, Prior]

    def lines(self, x: ArrayF) -> Lines:
        """Geometry of the lines."""
        return self.function(x)

    def derivatives(self, x: ArrayF) -> ArrayF:
        """(n, 7, u) derivatives of origin, small rotation about the laser's axes and direction cosine.

        Central differences of a smooth closed form; good to 1e-9 of their size. Unknowns called
        ``line_<label>_...`` change their own line alone, so that one step takes those of all lines (Curtis,
        Powell and Reid 1974).
        """
        out = np.zeros((len(self.labels), COMPONENTS, len(x)))
        for places, lines in self._steps():
            h = np.zeros(len(x))
            h[places] = _STEP
            up, down = self.function(x + h), self.function(x - h)
            turn = np.swapaxes(down.R_lcs_las, 1, 2) @ up.R_lcs_las
            change = np.empty((len(self.labels), COMPONENTS))
            change[:, :3] = up.origins_lcs_mm - down.origins_lcs_mm
            change[:, 3] = (turn[:, 2, 1] - turn[:, 1, 2]) / 2
            change[:, 4] = (turn[:, 0, 2] - turn[:, 2, 0]) / 2
            change[:, 5] = (turn[:, 1, 0] - turn[:, 0, 1]) / 2
            change[:, 6] = up.v - down.v
            if lines is None:
                out[:, :, places[0]] = change
            else:
                out[lines, :, places] = change[lines]
        return out / (2 * _STEP)

    def _steps(self) -> list[tuple[list[int], list[int] | None]]:
        """Unknowns that are changed at once, and the line of each; None: one that changes all lines."""
        line = {str(label): k for k, label in enumerate(self.labels)}
        alone: dict[str, tuple[list[int], list[int] | None]] = {}
        for place, name in enumerate(self.names):
            kind, *rest = name.split("_", 2)
            if kind != "line":
                alone[name] = [place], None
                continue
            places, lines = alone.setdefault(rest[1], ([], []))
            places.append(place)
            if lines is not None:
                lines.append(line[rest[0]])
        return list(alone.values())


def opk_angles(R: ArrayF) -> ArrayF:
    """Angles (omega, phi, kappa) of ``R = R_x R_y R_z``."""
    return np.array(
        [np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(np.clip(R[0, 2], -1, 1)), np.arctan2(-R[0, 1], R[0, 0])]
    )


def rotation_rad(angles_rad: ArrayF) -> ArrayF:
    """``R_x R_y R_z`` of angles (..., 3), shape (..., 3, 3)."""
    a = np.asarray(angles_rad, dtype=np.float64)
    return rotation_opk(a[..., 0], a[..., 1], a[..., 2])


def water_curve(
    origins_mm: ArrayF, directions: ArrayF, depth_mm: ArrayF, window: Window
) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    """Places of beams at depths, all in the window's frame.

    Parameters
    ----------
    origins_mm : (n, 3) with Z above the inner glass face.
    directions : (n, 3) unit vectors in air.
    depth_mm : (n,) below the outer glass face.

    Returns
    -------
    Places (n, 2), their derivatives by depth (n, 2), by the height of the origin (n, 2), and by the
    horizontal part of the direction (n, 2, 2). NaN where a beam does not go down.
    """
    q = window.n_air * directions[:, :2]
    q2 = np.square(q).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        down = np.where(directions[:, 2] < 0, 1.0, np.nan)
        air, glass, water = (
            down / np.sqrt(np.where(n * n > q2, n * n - q2, np.nan))
            for n in (window.n_air, window.n_glass, window.n_water)
        )
        h = origins_mm[:, 2]
        sum_1 = h * air + window.thickness_mm * glass + depth_mm * water
        sum_3 = h * air**3 + window.thickness_mm * glass**3 + depth_mm * water**3
    places = origins_mm[:, :2] + q * sum_1[:, None]
    by_q = sum_1[:, None, None] * np.eye(2) + sum_3[:, None, None] * q[:, :, None] * q[:, None, :]
    return places, q * water[:, None], q * air[:, None], window.n_air * by_q


def line_residuals(
    lines: Lines, at: ArrayI, points_mm: ArrayF, move_mm: ArrayF, window: Window
) -> LineResiduals:
    """How far image points lie from their lines.

    Parameters
    ----------
    lines : geometry in lcs.
    at : (n,) index of each point's line in ``lines``.
    points_mm : (n, 3) object points (x, y, depth below the outer face) in the window's frame.
    move_mm : (n, 2) their horizontal movement for one pixel along the measuring direction.
    window : the plate.

    Raises
    ------
    GeometryError : an index of a line that does not exist.
    """
    if len(at) and (at.min() < 0 or at.max() >= len(lines.labels)):
        raise GeometryError("a point of a line that the model does not have", expected="labels of the model")
    R_window_lcs = window.R_lcs_window.T
    R = R_window_lcs @ lines.R_lcs_las[at]
    origins = (lines.origins_lcs_mm @ R_window_lcs.T)[at]
    v = lines.v[at]
    to_point = np.einsum("nji,nj->ni", R, points_mm * [1, 1, -1] - [0, 0, window.thickness_mm] - origins)
    a = 0.8 * np.arctan2(to_point[:, 0], -to_point[:, 2])
    e = np.zeros(len(at))
    for _ in range(_STEPS):
        _, by_a, places, _, by_d = _beams(R, origins, v, a, points_mm[:, 2], window)
        f = points_mm[:, :2] + e[:, None] * move_mm - places
        J = _system(by_a, by_d, move_mm)
        step = _solve_2x2(J, f[:, :, None])[:, :, 0]
        e, a = e - step[:, 0], a - np.clip(step[:, 1], -0.3, 0.3)
        if not np.nanmax(np.abs(step[:, 1]), initial=0.0) > _CLOSE:
            break
    beam, by_a, _, by_height, by_d = _beams(R, origins, v, a, points_mm[:, 2], window)
    J = _system(by_a, by_d, move_mm)
    by_geometry = _by_geometry(R, R_window_lcs, beam, v, a, by_height, by_d)
    solved = _solve_2x2(J, by_geometry)
    moved = _solve_2x2(J, np.broadcast_to(-np.eye(2), (len(at), 2, 2)))
    good = np.abs(a) < np.pi / 2
    return LineResiduals(
        error_px=np.where(good, -e, np.nan),
        fan_angle_rad=a,
        error_by_geometry=-solved[:, 0],
        angle_by_geometry=solved[:, 1],
        angle_by_move=moved[:, 1],
    )


def fan_directions(a_rad: ArrayF, v: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Directions (n, 3) in the laser's frame, and their derivatives by angle and by direction cosine."""
    s, c = np.sin(a_rad), np.cos(a_rad)
    inside: ArrayB = c * c > v * v
    z = np.sqrt(np.where(inside, c * c - v * v, np.nan))
    zero = np.zeros_like(s)
    return (
        np.stack([s, v, -z], axis=1),
        np.stack([c, zero, s * c / z], axis=1),
        np.stack([zero, zero + 1.0, v / z], axis=1),
    )


def line_model(kind: Kind, nominal: NominalDiode, *, fixed_fans: bool = True) -> LineModel:
    """A model of `KINDS`.

    Parameters
    ----------
    fixed_fans : whether `individual` keeps the rotation of a fan in its own plane. Without it the model has
        the 6 n parameters of the thesis, and an adjustment refuses it.

    Raises
    ------
    GeometryError : an unknown kind.
    """
    makers = {
        "individual": lambda: _individual(nominal, fixed_fans),
        "joint_centre": lambda: _joint_centre(nominal),
        "regular": lambda: _regular(nominal),
        "diode": lambda: _diode(nominal, False),
        "free_cones": lambda: _cones(nominal, True),
        "joint_cones": lambda: _cones(nominal, False),
        "hierarchical": lambda: _diode(nominal, True),
    }
    if kind not in makers:
        raise GeometryError(f"model of lines {kind!r}", expected=f"one of {', '.join(KINDS)}")
    names, start, function, priors = makers[kind]()
    return LineModel(
        kind=kind, names=names, start=start, function=function, labels=nominal.labels, priors=priors
    )


def _beams(
    R: ArrayF, origins: ArrayF, v: ArrayF, a: ArrayF, depth: ArrayF, window: Window
) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF, ArrayF]:
    local, local_by_a, _ = fan_directions(a, v)
    d, by_a = (np.einsum("nij,nj->ni", R, w) for w in (local, local_by_a))
    places, _, by_height, by_d = water_curve(origins, d, depth, window)
    return local, by_a, places, by_height, by_d


def _system(by_a: ArrayF, by_d: ArrayF, move: ArrayF) -> ArrayF:
    along = np.einsum("nij,nj->ni", by_d, by_a[:, :2])
    return np.stack([move, -along], axis=2)


def _solve_2x2(J: ArrayF, rhs: ArrayF) -> ArrayF:
    det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
    first = J[:, 1, 1, None] * rhs[:, 0] - J[:, 0, 1, None] * rhs[:, 1]
    second = J[:, 0, 0, None] * rhs[:, 1] - J[:, 1, 0, None] * rhs[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack([first, second], axis=1) / det[:, None, None]


def _by_geometry(
    R: ArrayF, R_window_lcs: ArrayF, local: ArrayF, v: ArrayF, a: ArrayF, by_height: ArrayF, by_d: ArrayF
) -> ArrayF:
    """Derivatives (n, 2, 7) of places by origin (lcs), small rotation about the laser's axes, and v."""
    out = np.empty((len(R), 2, COMPONENTS))
    by_origin = np.zeros((len(R), 2, 3))
    by_origin[:, 0, 0] = by_origin[:, 1, 1] = 1.0
    by_origin[:, :, 2] = by_height
    out[:, :, :3] = by_origin @ R_window_lcs
    turned = np.stack([np.cross(np.eye(3)[k], local) for k in range(3)], axis=2)
    out[:, :, 3:6] = by_d @ (R @ turned)[:, :2]
    _, _, local_by_v = fan_directions(a, v)
    out[:, :, 6] = np.einsum("nij,nj->ni", by_d, np.einsum("nij,nj->ni", R, local_by_v)[:, :2])
    return out


def _lines(nominal: NominalDiode, origins: ArrayF, R: ArrayF, v: ArrayF) -> Lines:
    n = len(nominal.labels)
    return Lines(
        labels=nominal.labels,
        origins_lcs_mm=np.broadcast_to(origins, (n, 3)),
        R_lcs_las=np.broadcast_to(R, (n, 3, 3)),
        v=np.broadcast_to(v, (n,)),
        half_angle_rad=nominal.half_angle_rad,
    )


def _turned(R: ArrayF, across_rad: ArrayF) -> ArrayF:
    """Rotations of planes that lean across the fan: about the laser's own x axis."""
    zero = np.zeros_like(across_rad)
    return R @ rotation_rad(np.stack([across_rad, zero, zero], axis=-1))


def _planes(nominal: NominalDiode) -> ArrayF:
    """(n, 3) angles of the planes of a regular diode."""
    R = _turned(rotation_rad(nominal.angles_rad), nominal.orders * nominal.step_rad)
    return np.stack([opk_angles(each) for each in R])


def _individual(nominal: NominalDiode, fixed_fans: bool) -> _Made:
    n = len(nominal.labels)
    angles = _planes(nominal)
    parts = [name for name in _POSE if not (fixed_fans and name == "laser_phi_rad")]
    names = tuple(f"line_{j}_{part.removeprefix('laser_')}" for j in nominal.labels for part in parts)
    free = [0, 2] if fixed_fans else [0, 1, 2]
    start = np.hstack([np.tile(nominal.origin_lcs_mm, (n, 1)), angles[:, free]]).ravel()

    def function(x: ArrayF) -> Lines:
        """Lines with a place and angles of their own."""
        p = x.reshape(n, -1)
        opk = angles.copy()
        opk[:, free] = p[:, 3:]
        return _lines(nominal, p[:, :3], rotation_rad(opk), np.zeros(n))

    # A plane fitted to an outer line, which is a cone, would fetch its laser from a metre away
    m = len(parts)
    origins = (np.arange(n)[:, None] * m + np.arange(3)).ravel()
    return names, start, function, {"housing": Prior(places=origins, mean=start[origins], sigma=_HOUSING_MM)}


def _joint_centre(nominal: NominalDiode) -> _Made:
    n = len(nominal.labels)
    angles = _planes(nominal)
    per_line = [f"line_{j}_{part}" for j in nominal.labels for part in ("omega_rad", "kappa_rad")]
    start = np.r_[nominal.origin_lcs_mm, angles[:, [0, 2]].ravel()]

    def function(x: ArrayF) -> Lines:
        """Lines with one place and angles of their own."""
        opk = angles.copy()
        opk[:, [0, 2]] = x[3:].reshape(n, 2)
        return _lines(nominal, x[:3], rotation_rad(opk), np.zeros(n))

    return (*_POSE[:3], *per_line), start, function, {}


def _regular(nominal: NominalDiode) -> _Made:
    def function(x: ArrayF) -> Lines:
        """Lines with one place, an attitude and equal angles between them."""
        R = _turned(rotation_rad(x[3:6]), nominal.orders * x[6])
        return _lines(nominal, x[:3], R, np.zeros(len(nominal.labels)))

    return (*_POSE, "step_rad"), np.r_[nominal.pose, nominal.step_rad], function, {}


def _diode(nominal: NominalDiode, hierarchical: bool) -> _Made:
    j, n = nominal.orders, len(nominal.labels)
    names: tuple[str, ...] = (
        *_POSE,
        "v0",
        "step_cosine",
        "quadratic_cosine",
        "drift_across_mm",
        "drift_axial_mm",
    )
    start = np.r_[nominal.pose, 0.0, np.sin(nominal.step_rad), 0.0, 0.0, 0.0]

    def zero(places: ArrayI, sigma: float) -> Prior:
        """Prior knowledge that parameters are zero."""
        return Prior(places=places, mean=np.zeros(len(places)), sigma=sigma)

    # The lines see phi only through their spread, v0 only through the curvature of the cones, and the drift
    # only through their spacing at two depths: without bounds from the ends of the fans and from optics
    # they wander off.
    phi = np.array([4])
    priors = {
        "fan_ends": Prior(places=phi, mean=start[phi], sigma=_FAN_ENDS_RAD),
        "v0": zero(np.array([6]), 0.05),
        "drift": zero(np.array([9, 10]), 0.5),
    }
    if hierarchical:
        parts = ("v", "kappa_rad", "x_mm", "y_mm", "z_mm")
        names = (*names, *(f"line_{label}_{part}" for part in parts for label in nominal.labels))
        start = np.r_[start, np.zeros(5 * n)]
        priors |= {
            "line_v": zero(11 + np.arange(n), 3e-4),
            "line_rotation": zero(11 + np.arange(n, 2 * n), 3e-4),
            "line_origin": zero(11 + np.arange(2 * n, 5 * n), 0.1),
        }

    def function(x: ArrayF) -> Lines:
        """Lines of a grating whose spacing and origins drift with the order."""
        R = rotation_rad(x[3:6])
        v = x[6] + x[7] * j + x[8] * j * j
        origins = x[:3] + np.outer(j, R[:, 1]) * x[9] + np.outer(np.abs(j), R[:, 2]) * x[10]
        if not hierarchical:
            return _lines(nominal, origins, R, v)
        dv, turn, *shift = x[11:].reshape(5, n)
        still = np.zeros(n)
        Rj = R @ rotation_rad(np.stack([still, still, turn], axis=-1))
        return _lines(nominal, origins + np.stack(shift, axis=-1) @ R.T, Rj, v + dv)

    return names, start, function, priors


def _cones(nominal: NominalDiode, free_origins: bool) -> _Made:
    n = len(nominal.labels)
    omega, phi, kappa = nominal.angles_rad
    places = [f"line_{j}_{part}" for j in nominal.labels for part in ("x_mm", "y_mm", "z_mm")]
    shapes = [f"line_{j}_{part}" for j in nominal.labels for part in ("v", "kappa_rad")]
    names = (*(places if free_origins else _POSE[:3]), "laser_phi_rad", *shapes)
    m = 3 * n if free_origins else 3
    shape = np.stack([np.sin(nominal.step_rad) * nominal.orders, np.zeros(n)], axis=1)
    origins = np.tile(nominal.origin_lcs_mm, n) if free_origins else nominal.origin_lcs_mm
    start = np.r_[origins, phi, shape.ravel()]

    def function(x: ArrayF) -> Lines:
        """Lines with one attitude, a spacing and a turn of their own."""
        v, turn = x[m + 1 :].reshape(n, 2).T
        zero = np.zeros(n)
        R = rotation_rad(np.array([omega, x[m], kappa]))
        Rj = R @ rotation_rad(np.stack([zero, zero, turn], axis=-1))
        return _lines(nominal, x[:m].reshape(-1, 3), Rj, v)

    # cones hardly change when they turn about their axis: the ends of the fans hold them, as in the diode
    return (
        names,
        start,
        function,
        {"fan_ends": Prior(places=np.array([m]), mean=start[[m]], sigma=_FAN_ENDS_RAD)},
    )
