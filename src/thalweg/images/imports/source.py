"""Orientations as a file of another program has them: frames, angles, units.

The coordinates of a pose stand in the frame of the file (`Place`); its rotation leads from the camera frame
ccs (x right, y down, z along the view) into that frame: in a map grid east, north, up of the grid, in
geographic coordinates those of the place itself.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from pyproj import CRS
from scipy.spatial.transform import Rotation

from thalweg.core import GRS80_SEMI_MAJOR_M, AnyArray, ArrayF, Camera, InputError, LocalFrame, rows_of
from thalweg.core.values import FORMS, world_of
from thalweg.images import crs_of

Kind = Literal["world", "map", "geographic", "geocentric", "free"]
WORLD = "world"
"""Name of the campaign's world frame, where a CRS is asked for."""

_STEP_M: Final = 50.0
"""Half the chord of the grid's north line; curvature and rounding cost some 1e-10 rad each."""

UNITS: Final[Mapping[str, float]] = {"deg": math.pi / 180, "gon": math.pi / 200, "rad": 1.0}
"""Radians of one unit."""
ORDERS: Final[Mapping[str, str]] = {
    "omega_phi_kappa": "xyz",
    "phi_omega_kappa": "yxz",
    "kappa_phi_omega": "zyx",
}
AXES: Final[Mapping[str, tuple[tuple[int, int, int], ...]]] = {
    "right_up_back": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "right_down_forward": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "up_left_back": ((0, -1, 0), (-1, 0, 0), (0, 0, -1)),
    "left_down_back": ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    "down_right_back": ((0, 1, 0), (1, 0, 0), (0, 0, -1)),
}
"""Directions of the image axes x, y, z in ccs: the columns of ``R_ccs_image``."""
_PLACE: Final = {"x": 0, "y": 1, "z": 2}


# ---------------------------------------------------------------- source


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """What coordinates refer to.

    Parameters
    ----------
    kind : ``world`` wcs; ``map`` easting, northing, height; ``geographic`` longitude, latitude in degrees,
        height; ``geocentric``; ``free`` a frame with a scale and an attitude of its own.
    crs : of the coordinates; None in ``world`` and ``free``.
    """

    kind: Kind
    crs: CRS | None = None

    @property
    def text(self) -> str:
        """For people."""
        return (
            self.crs.name
            if self.crs is not None
            else {"world": "world frame", "free": "own frame"}[self.kind]
        )


@dataclass(frozen=True, slots=True)
class Angles:
    """Three angles of each pose as they stand in a table, (n, 3) in ``unit``, and how they were read."""

    values: ArrayF
    unit: str
    rotation: str
    direction: str
    axes: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """Poses of one file.

    Parameters
    ----------
    program : what wrote the file.
    where : the file.
    place : what the coordinates refer to.
    names : n names of images.
    coordinates : (n, 3) projection centres.
    R_place_ccs : (n, 3, 3).
    cov : (n, 6, 6) of (shift in metres; rotation vector) about the axes to which the rotations refer; NaN
        where the file states nothing.
    cameras : n interior orientations, None where the file has none; or no names at all.
    n_marks : (n,) tie points in each image, 0 if not known.
    rms_px : (n,) of their residuals; NaN if not known.
    following : (n, 6, 6) covariance of each pose with the next one of the file; None if it states none.
    absent : images of the file without pose, and why.
    angles : as they stand in a table; None for other files.
    notes : for people.
    """

    program: str
    where: str
    place: Place
    names: tuple[str, ...]
    coordinates: ArrayF
    R_place_ccs: ArrayF
    cov: ArrayF
    cameras: Sequence[Camera | None] = ()
    n_marks: ArrayF | float = 0.0
    rms_px: ArrayF | float = math.nan
    following: ArrayF | None = None
    absent: Mapping[str, str] = field(default_factory=dict)
    angles: Angles | None = None
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        for name in ("n_marks", "rms_px"):
            object.__setattr__(self, name, np.broadcast_to(getattr(self, name), len(self.names)))
        object.__setattr__(self, "cameras", tuple(self.cameras) or (None,) * len(self.names))
        if not len(self.names):
            raise InputError("no image with a pose", expected="at least one", where=self.where)
        twice = sorted(name for name, times in Counter(self.names).items() if times > 1)[:3]
        if twice:
            raise InputError(f"two poses of {', '.join(twice)}", expected="each image once", where=self.where)
        bad = ~np.isfinite(self.coordinates).all(axis=1)
        if bad.any():
            name = self.names[int(np.argmax(bad))]
            raise InputError(f"no finite coordinates of {name}", expected="three numbers", where=self.where)

    def chosen(self, rows: AnyArray) -> "Finished":
        """Some of the poses, by index."""
        return replace(
            rows_of(self, rows), angles=None if self.angles is None else rows_of(self.angles, rows)
        )


def place_of(text: str, path: Path) -> Place:
    """From the name of a CRS, or ``world``.

    Raises
    ------
    InputError : an unknown CRS, or one that is neither projected nor geographic nor geocentric.
    """
    if text.strip().lower() == WORLD:
        return Place(kind="world")
    crs = crs_of(text, path)
    kinds: tuple[tuple[Kind, bool], ...] = (
        ("map", crs.is_projected),
        ("geocentric", crs.is_geocentric),
        ("geographic", crs.is_geographic),
    )
    kind = next((kind for kind, holds in kinds if holds), None)
    if kind is None:
        raise InputError(
            f"the CRS '{crs.name}' has no place on the earth",
            expected="a grid, or geographic coordinates",
            where=path,
            cure="Name the CRS in images.finished.crs",
        )
    return Place(kind=kind, crs=crs)


def orthogonal(R: ArrayF, where: str, names: tuple[str, ...]) -> ArrayF:
    """The rotations (n, 3, 3) closest to matrices with few digits.

    Raises
    ------
    InputError : a matrix is more than 1e-3 away from any rotation.
    """
    R = np.where(np.isfinite(R).all(axis=(1, 2), keepdims=True), R, 0.0)
    U, s, Vt = np.linalg.svd(R)
    bad = (np.abs(s - 1) > 1e-3).any(axis=1) | (np.linalg.det(R) < 0)
    if bad.any():
        name = names[int(np.argmax(bad))]
        raise InputError(
            f"the rotation of {name} is none", expected="an orthogonal matrix, no reflection", where=where
        )
    return np.asarray(U @ Vt)


# ---------------------------------------------------------------- poses in the world frame
#
# A map grid is conformal but no world frame: its north differs from true north by the meridian convergence,
# and its metres are 0.9996 m in the middle of a UTM zone. So each projection centre is transformed by
# itself, and each rotation is turned by the axes of the grid at that place::
#
#     R_wcs_ccs = R_wcs_grid(E, N, h) R_grid_ccs
#
# with the tangent of the grid's north line as second column, the normal of the ellipsoid as third. For
# geographic coordinates the axes are east, north, up of the place itself (`LocalFrame.R_wcs_enu`).


def world_axes(coordinates: ArrayF, place: Place, frame: LocalFrame, north: str = "grid") -> ArrayF:
    """``R_wcs_place`` (n, 3, 3): the axes to which rotations refer at each place.

    Parameters
    ----------
    coordinates : (n, 3) as in the file.
    north : ``true`` if angles given in a map grid refer to true north all the same.
    """
    if place.kind in ("world", "free"):
        return np.tile(np.eye(3), (len(coordinates), 1, 1))
    crs = place.crs
    assert crs is not None
    if place.kind == "geocentric":
        return np.tile(frame.R_ecef_enu.T, (len(coordinates), 1, 1))
    if place.kind == "geographic":
        return frame.R_wcs_enu(coordinates[:, 1], coordinates[:, 0])
    lat, lon, _ = frame.to_geodetic(frame.from_map(coordinates, crs))
    level = frame.R_wcs_enu(lat, lon)
    if north == "true":
        return level
    step = np.array([0.0, _STEP_M, 0.0])
    along = frame.from_map(coordinates + step, crs) - frame.from_map(coordinates - step, crs)
    up = level[:, :, 2]
    along -= (along * up).sum(axis=1, keepdims=True) * up
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack([np.cross(along, up), along, up], axis=-1)


def world_positions(coordinates: ArrayF, place: Place, frame: LocalFrame) -> ArrayF:
    """Projection centres (n, 3) in wcs.

    Raises
    ------
    GeometryError : coordinates outside of the CRS, or a datum other than that of GNSS.
    """
    if place.kind in ("world", "free"):
        return coordinates
    if place.kind == "geocentric":
        return frame.from_ecef(coordinates)
    assert place.crs is not None
    if place.kind == "geographic":
        check_datum(place.crs, "images.finished.crs")
    return world_of(coordinates, FORMS[2], place.crs, frame)


def raised(coordinates: ArrayF, place: Place, offset_m: float, frame: LocalFrame) -> ArrayF:
    """Coordinates with an offset added to their heights."""
    if place.kind == "geocentric":
        lat, lon, _ = frame.to_geodetic(frame.from_ecef(coordinates))
        up = (frame.R_ecef_enu @ frame.R_wcs_enu(lat, lon))[:, :, 2]
        return np.asarray(coordinates + offset_m * up)
    return np.asarray(coordinates + np.array([0.0, 0.0, offset_m]))


def to_world(
    source: Finished,
    frame: LocalFrame,
    *,
    north: Literal["grid", "true"] = "grid",
    height_offset_m: float = 0.0,
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Projection centres (n, 3), ``R_wcs_ccs`` (n, 3, 3) and covariances (n, 6, 6) in wcs.

    Covariances keep the NaN of what the file does not state. The scale of a grid leaves them as they are.

    Raises
    ------
    GeometryError : coordinates outside of the CRS, or a datum other than that of GNSS.
    """
    coordinates = raised(source.coordinates, source.place, height_offset_m, frame)
    centre = world_positions(coordinates, source.place, frame)
    axes = world_axes(coordinates, source.place, frame, north if source.angles is not None else "grid")
    J = np.zeros((len(centre), 6, 6))
    J[:, :3, :3] = J[:, 3:, 3:] = axes
    # block by block: a missing rotation must not take the position with it
    cov = np.full_like(source.cov, np.nan)
    for part in (slice(0, 3), slice(3, 6)):
        cov[:, part, part] = axes @ source.cov[:, part, part] @ np.swapaxes(axes, 1, 2)
    whole = np.isfinite(source.cov).all(axis=(1, 2))
    cov[whole] = J[whole] @ source.cov[whole] @ np.swapaxes(J[whole], 1, 2)
    return centre, axes @ source.R_place_ccs, cov


def check_datum(crs: CRS, where: str | Path) -> None:
    """Refuse geographic and geocentric coordinates in a datum other than that of GNSS.

    Raises
    ------
    InputError : another ellipsoid; grids are checked by `LocalFrame.from_map`.
    """
    ellipsoid = crs.ellipsoid
    if ellipsoid is None or abs(ellipsoid.semi_major_metre - GRS80_SEMI_MAJOR_M) > 0.5:
        raise InputError(
            f"'{crs.name}' is on the ellipsoid {ellipsoid.name if ellipsoid else 'unknown'}, another datum "
            "than that of GNSS positions",
            expected="coordinates on GRS80 or WGS84",
            where=where,
            cure="Export in WGS84 or ETRS89",
        )


# ---------------------------------------------------------------- angles as rotations: orders, directions,
# image axes, units
#
# In aerial photogrammetry, in Metashape, Pix4D and DBAT (``omega_phi_kappa``, ``image_to_world``,
# ``right_up_back``) the image axes are x to the right, y up, z backwards, against the view, and::
#
#     R_world_image = R_x(omega) R_y(phi) R_z(kappa)
#     R_world_ccs = R_world_image diag(1, -1, -1)
#
# ``phi_omega_kappa`` is ``R_y(phi) R_x(omega) R_z(kappa)``, ``kappa_phi_omega`` is
# ``R_z(kappa) R_y(phi) R_x(omega)``; with ``world_to_image`` the product is the transposed matrix.


def image_rotations(angles: Angles, n: int = 3) -> ArrayF:
    """``R_place_image`` (n, 3, 3) in the file's own image axes, of all angles or the first ``n`` turns."""
    order = ORDERS[angles.rotation][:n]
    rad = angles.values[:, [_PLACE[axis] for axis in order]] * UNITS[angles.unit]
    R = Rotation.from_euler(order.upper(), rad)
    return np.asarray((R.inv() if angles.direction == "world_to_image" else R).as_matrix())


def ccs_rotations(angles: Angles) -> ArrayF:
    """``R_place_ccs`` (n, 3, 3) of the angles."""
    R_ccs_image = np.array(AXES[angles.axes], np.float64).T
    return np.asarray(image_rotations(angles) @ R_ccs_image.T)


def angle_covariance(angles: Angles, sigma: ArrayF) -> ArrayF:
    """Covariance (n, 3, 3) of the rotation vector in the file's frame, of sigmas (n, 3) of the angles."""
    axes = np.zeros((len(angles.values), 3, 3))
    forward = replace(angles, direction="image_to_world")
    for n, name in enumerate(ORDERS[angles.rotation]):
        k = _PLACE[name]
        axes[:, k, k] = 1.0
        if n:
            axes[:, :, k] = image_rotations(forward, n)[:, :, k]
    if angles.direction == "world_to_image":
        # d(M^T) = -[M^T v]x M^T
        axes = -image_rotations(angles) @ axes
    J = axes * (sigma * UNITS[angles.unit])[:, None, :]
    return np.asarray(J @ np.swapaxes(J, 1, 2))
