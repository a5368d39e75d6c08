"""Frames, rotations and the local world frame.

Transforms are named ``T_target_source`` and act as ``x_target = T_target_source @ x_source``; all sign
conventions stand as equations in ``docs/conventions.md``. The world frame ``wcs`` is topocentric
east-north-up at the origin of the campaign: metric, Cartesian, and free of map scale and convergence.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import ProjError

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF

R_ENU_NED: Final[ArrayF] = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Axes of north-east-down expressed in east-north-up (its own inverse)."""


GRS80_SEMI_MAJOR_M: Final = 6_378_137.0
"""Semi-major axis of GRS80 and of WGS84."""

WGS84: Final = "+ellps=WGS84"
"""Ellipsoid of GNSS positions in the words of PROJ; GRS80 is the same to 0.1 mm."""

MAX_SCALE_ERROR: Final = 0.005
"""Scale error beyond which a projection is no survey grid: within its zone UTM stays below 0.1 %."""


def rotation_x(angle_rad: float) -> ArrayF:
    """Rotation about x: ``[[1, 0, 0], [0, c, -s], [0, s, c]]``."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle_rad: float) -> ArrayF:
    """Rotation about y: ``[[c, 0, s], [0, 1, 0], [-s, 0, c]]``."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_z(angle_rad: float) -> ArrayF:
    """Rotation about z: ``[[c, -s, 0], [s, c, 0], [0, 0, 1]]``."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_opk(omega_rad: ArrayLike, phi_rad: ArrayLike, kappa_rad: ArrayLike) -> ArrayF:
    """Rotation matrix ``R = R_x(omega) R_y(phi) R_z(kappa)``, the photogrammetric convention of the thesis.

    Parameters
    ----------
    omega_rad, phi_rad, kappa_rad : broadcastable arrays of shape (...,).

    Returns
    -------
    (..., 3, 3) array.

    Examples
    --------
    >>> rotation_opk(0.0, -np.pi / 2, 0.0).round(12) @ [0.0, 0.0, 1.0]
    array([-1.,  0.,  0.])
    """
    w, p, k = (np.asarray(a, dtype=np.float64) for a in (omega_rad, phi_rad, kappa_rad))
    (cw, cp, ck), (sw, sp, sk) = ((f(w), f(p), f(k)) for f in (np.cos, np.sin))
    R = np.empty((*np.broadcast_shapes(w.shape, p.shape, k.shape), 3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 0, 2] = cp * ck, -cp * sk, sp
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = cw * sk + sw * sp * ck, cw * ck - sw * sp * sk, -sw * cp
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = sw * sk - cw * sp * ck, sw * ck + cw * sp * sk, cw * cp
    return R


def opk_axes(omega_rad: ArrayLike, phi_rad: ArrayLike) -> ArrayF:
    """Axes (..., 3, 3), as columns, about which ``R_x(omega) R_y(phi) R_z(kappa)`` turns with each angle.

    A small change of the angles is the rotation vector ``axes @ (domega, dphi, dkappa)`` in the outer frame.

    Parameters
    ----------
    omega_rad, phi_rad : broadcastable arrays of shape (...,).
    """
    omega, phi = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (omega_rad, phi_rad)))
    axes = np.zeros((*omega.shape, 3, 3))
    axes[..., 0, 0] = 1.0
    axes[..., 1, 1], axes[..., 2, 1] = np.cos(omega), np.sin(omega)
    axes[..., 0, 2] = np.sin(phi)
    axes[..., 1, 2], axes[..., 2, 2] = -np.sin(omega) * np.cos(phi), np.cos(omega) * np.cos(phi)
    return axes


def rotation_enu_body(roll_rad: ArrayLike, pitch_rad: ArrayLike, heading_rad: ArrayLike) -> ArrayF:
    """Rotation ``R_wcs_ics`` of an INS body frame (x forward, y right, z down) in east-north-up.

    ``R_wcs_ics = R_ENU_NED R_z(heading) R_y(pitch) R_x(roll)``, the aerospace convention that ANPP states
    (roll right side down, pitch nose up, heading clockwise from true north).

    Parameters
    ----------
    roll_rad, pitch_rad, heading_rad : broadcastable arrays of shape (...,).

    Returns
    -------
    (..., 3, 3) array.
    """
    roll, pitch, heading = np.broadcast_arrays(
        *(np.asarray(a, dtype=np.float64) for a in (roll_rad, pitch_rad, heading_rad))
    )
    cr, sr = np.cos(roll), np.sin(roll)
    cp, sp = np.cos(pitch), np.sin(pitch)
    ch, sh = np.cos(heading), np.sin(heading)
    rotation = np.empty((*roll.shape, 3, 3))
    rotation[..., 0, 0] = sh * cp
    rotation[..., 0, 1] = sh * sp * sr + ch * cr
    rotation[..., 0, 2] = sh * sp * cr - ch * sr
    rotation[..., 1, 0] = ch * cp
    rotation[..., 1, 1] = ch * sp * sr - sh * cr
    rotation[..., 1, 2] = ch * sp * cr + sh * sr
    rotation[..., 2, 0] = sp
    rotation[..., 2, 1] = -cp * sr
    rotation[..., 2, 2] = -cp * cr
    return rotation


def roll_pitch_heading(R_wcs_ics: ArrayLike) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Roll, pitch and heading in radians from ``R_wcs_ics`` (the inverse of `rotation_enu_body`).

    Heading is in [0, 2 pi). At a pitch of exactly +-90 degrees roll and heading are not separable.
    """
    R = np.asarray(R_wcs_ics, dtype=np.float64)
    pitch = np.arcsin(np.clip(R[..., 2, 0], -1.0, 1.0))
    roll = np.arctan2(-R[..., 2, 1], -R[..., 2, 2])
    heading = np.mod(np.arctan2(R[..., 0, 0], R[..., 1, 0]), 2 * np.pi)
    return roll, pitch, heading


def transform(R_target_source: ArrayLike, lever_target_m: ArrayLike) -> ArrayF:
    """4x4 transform from a rotation and the source origin in the target frame."""
    T = np.eye(4)
    T[:3, :3] = R_target_source
    T[:3, 3] = lever_target_m
    return T


@dataclass(frozen=True, slots=False, kw_only=True)
class LocalFrame:
    """The world frame ``wcs``: east-north-up at a geodetic origin on the WGS84/GRS80 ellipsoid.

    Parameters
    ----------
    lat_deg, lon_deg : geodetic origin.
    h_ell_m : ellipsoidal height of the origin.
    ellipsoid : in the words of PROJ. Another one is for work within a national grid alone, without GNSS: all
        geodetic coordinates are then those of that grid's own datum, and none is transformed.

    Examples
    --------
    >>> frame = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
    >>> frame.from_geodetic(51.05, 13.25, 302.0).round(9)
    array([0., 0., 2.])
    """

    lat_deg: float
    lon_deg: float
    h_ell_m: float
    ellipsoid: str = WGS84

    @cached_property
    def _geodetic_to_enu(self) -> Transformer:
        return Transformer.from_pipeline(
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
            f"+step +proj=cart {self.ellipsoid} "
            # float(): PROJ takes the "np.float64(51.05)" of a NumPy number for 0
            f"+step +proj=topocentric {self.ellipsoid} +lat_0={float(self.lat_deg)!r} "
            f"+lon_0={float(self.lon_deg)!r} +h_0={float(self.h_ell_m)!r}"
        )

    def from_geodetic(self, lat_deg: ArrayLike, lon_deg: ArrayLike, h_ell_m: ArrayLike) -> ArrayF:
        """East, north, up in metres, shape (..., 3), of geodetic positions."""
        lon, lat, h = np.broadcast_arrays(
            *(np.asarray(a, dtype=np.float64) for a in (lon_deg, lat_deg, h_ell_m))
        )
        return np.stack(self._geodetic_to_enu.transform(lon, lat, h), axis=-1)

    def to_geodetic(self, points_wcs: ArrayLike) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Latitude and longitude in degrees and ellipsoidal height of (..., 3) local points."""
        p = np.asarray(points_wcs, dtype=np.float64)
        lon, lat, h = self._geodetic_to_enu.transform(p[..., 0], p[..., 1], p[..., 2], direction="INVERSE")
        return np.asarray(lat), np.asarray(lon), np.asarray(h)

    def from_ecef(self, xyz_ecef_m: ArrayLike) -> ArrayF:
        """Local east, north, up of (..., 3) earth-centred coordinates."""
        d = np.asarray(xyz_ecef_m, dtype=np.float64) - self.origin_ecef_m
        return np.asarray(d @ self.R_ecef_enu)

    def R_wcs_enu(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> ArrayF:
        """Rotations (..., 3, 3) from the local level at other positions into wcs.

        An INS refers roll, pitch and heading to the vertical and the north of where it is. 1.5 km away from
        the origin that vertical differs by 0.013 degrees.
        """
        return np.asarray(self.R_ecef_enu.T @ rotation_ecef_enu(lat_deg, lon_deg))

    @cached_property
    def origin_ecef_m(self) -> ArrayF:
        """Earth-centred coordinates of the origin, shape (3,)."""
        return ecef_of(self.lat_deg, self.lon_deg, self.h_ell_m)

    @cached_property
    def R_ecef_enu(self) -> ArrayF:
        """Rotation from local east-north-up to earth-centred axes."""
        return rotation_ecef_enu(self.lat_deg, self.lon_deg)

    def to_map(self, points_wcs: ArrayLike, crs: CRS) -> ArrayF:
        """Easting, northing in a projected CRS and **ellipsoidal** height, shape (..., 3); export only.

        Raises
        ------
        GeometryError : the CRS is not projected, a point lies far outside its area of use, or PROJ knows no
            exact operation to it.
        """
        projection = _map_projection(crs, self.ellipsoid)
        lat, lon, h = self.to_geodetic(points_wcs)
        _check_area_of_use(crs, lat, lon)
        scale = grid_factors(crs, self.lat_deg, self.lon_deg)[1]
        if abs(scale - 1.0) > MAX_SCALE_ERROR:
            raise GeometryError(
                f"'{crs.name}' stretches distances by {100 * (scale - 1):+.1f} % here",
                expected=f"a survey grid, within {100 * MAX_SCALE_ERROR:.1f} %",
                cure="Set campaign.crs to the national grid of the survey area",
            )
        try:
            east, north = projection.transform(lon, lat, errcheck=True)
        except ProjError as error:
            raise GeometryError(
                f"points cannot be expressed in '{crs.name}': {error}",
                expected="a grid whose area of use holds the survey",
                cure="Check campaign.crs and campaign.origin",
            ) from error
        return np.stack([east, north, h], axis=-1)

    def from_map(self, points_map: ArrayLike, crs: CRS) -> ArrayF:
        """Local points (..., 3) from easting, northing in a projected CRS, ellipsoidal height; import only.

        Raises
        ------
        GeometryError : the CRS is not projected, or the points lie far outside its area of use.
        """
        p = np.asarray(points_map, dtype=np.float64)
        lon, lat = _map_projection(crs, self.ellipsoid).transform(p[..., 0], p[..., 1], direction="INVERSE")
        if not np.all(np.isfinite(lon[np.isfinite(p[..., 0])])):
            raise GeometryError(
                f"coordinates outside of '{crs.name}'",
                expected="eastings and northings of that grid",
                cure="Check the CRS of the file, or campaign.crs",
            )
        _check_area_of_use(crs, np.asarray(lat), np.asarray(lon))
        return self.from_geodetic(lat, lon, p[..., 2])


def ellipsoid_of(crs: CRS) -> str:
    """Ellipsoid of a CRS in the words of PROJ; `WGS84` for all that cannot be told from it."""
    ellipsoid = crs.ellipsoid
    if ellipsoid is None or abs(ellipsoid.semi_major_metre - GRS80_SEMI_MAJOR_M) <= 0.5:
        return WGS84
    return f"+a={ellipsoid.semi_major_metre!r} +b={ellipsoid.semi_minor_metre!r}"


def _map_projection(crs: CRS, own: str) -> Transformer:
    """Longitude, latitude in degrees -> easting, northing of a projected CRS on the ellipsoid ``own``."""
    if not crs.is_projected:
        raise GeometryError(
            f"'{crs.name}' is not a projected CRS",
            expected="a map projection such as EPSG:25833",
            cure="Set campaign.crs to the national grid of the survey area",
        )
    horizontal = crs.sub_crs_list[0] if crs.is_compound else crs
    geodetic = horizontal.geodetic_crs
    if geodetic is None:
        raise GeometryError(f"'{crs.name}' has no geodetic base", expected="a projected CRS")
    if geodetic.ellipsoid is None or ellipsoid_of(geodetic) != own:
        # Without this check a Gauss-Krueger grid (Bessel ellipsoid) came out 180 m away, without a word.
        name = geodetic.ellipsoid.name if geodetic.ellipsoid else "unknown"
        raise GeometryError(
            f"'{crs.name}' is on the ellipsoid {name}, another datum than that of GNSS positions",
            expected="a grid on GRS80 or WGS84, such as ETRS89 / UTM",
            cure="Export to such a grid, and transform it with the grid files of the land survey afterwards",
        )
    # Positions are in the frame of the corrections (ETRS89, WGS84 ...): taken as the datum of the grid.
    return Transformer.from_crs(geodetic.to_2d(), horizontal.to_2d(), always_xy=True, allow_ballpark=False)


def _check_area_of_use(crs: CRS, lat_deg: ArrayF, lon_deg: ArrayF, margin_deg: float = 3.0) -> None:
    """Refuse points far outside a grid's area of use, where PROJ returns nonsense without a word.

    The margin is half a zone of UTM: surveys at the border of a zone are commonly kept in one grid.
    """
    area = crs.area_of_use
    if area is None:
        return
    span = area.east - area.west
    width = (span if span >= 0 else span + 360.0) + 2 * margin_deg
    east_of_west = (
        np.mod(lon_deg - (area.west - margin_deg), 360.0) if width < 360.0 else np.zeros_like(lon_deg)
    )
    outside = (
        (lat_deg < area.south - margin_deg) | (lat_deg > area.north + margin_deg) | (east_of_west > width)
    )
    if np.any(outside):
        first = int(np.argmax(np.ravel(outside)))
        raise GeometryError(
            f"{int(np.sum(outside))} of {np.size(outside)} points are outside the area of use of "
            f"'{crs.name}', the first at latitude {np.ravel(lat_deg)[first]:.4f}, longitude "
            f"{np.ravel(lon_deg)[first]:.4f}",
            expected=f"latitude {area.south} .. {area.north}, longitude {area.west} .. {area.east}",
            cure="Check campaign.crs and campaign.origin",
        )


@cache
def _geodetic_to_ecef() -> Transformer:
    return Transformer.from_crs(4979, 4978, always_xy=True, allow_ballpark=False)


def ecef_of(lat_deg: ArrayLike, lon_deg: ArrayLike, h_ell_m: ArrayLike) -> ArrayF:
    """Earth-centred coordinates (..., 3) of geodetic positions on WGS 84, metres."""
    return np.stack(_geodetic_to_ecef().transform(lon_deg, lat_deg, h_ell_m), axis=-1)


def geodetic_of(xyz_ecef_m: ArrayLike) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Latitude and longitude in degrees and ellipsoidal height of (..., 3) earth-centred coordinates."""
    p = np.asarray(xyz_ecef_m, dtype=np.float64)
    lon, lat, h = _geodetic_to_ecef().transform(p[..., 0], p[..., 1], p[..., 2], direction="INVERSE")
    return np.asarray(lat), np.asarray(lon), np.asarray(h)


def rotation_ecef_enu(lat_deg: ArrayLike, lon_deg: ArrayLike) -> ArrayF:
    """Rotations (..., 3, 3) from east-north-up at geodetic positions to earth-centred axes."""
    lat, lon = np.broadcast_arrays(*(np.deg2rad(np.asarray(a, dtype=np.float64)) for a in (lat_deg, lon_deg)))
    sl, cl, sb, cb = np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat)
    zero = np.zeros_like(sl)
    rows = [[-sl, -sb * cl, cb * cl], [cl, -sb * sl, cb * sl], [zero, cb, sb]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def grid_factors(crs: CRS, lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """Meridian convergence (radians, grid north minus true north sense of PROJ) and scale of a projection.

    A heading refers to true north, a map to grid north; at 50 m the scale 0.9996 of UTM is 2 cm.
    """
    factors = Proj(crs).get_factors(lon_deg, lat_deg)
    return float(np.deg2rad(factors.meridian_convergence)), float(factors.meridional_scale)


def attitude_axes(R_wcs_ics: ArrayF) -> ArrayF:
    """Axes in wcs about which roll, pitch and heading turn, shape (n, 3 angles, 3).

    Roll turns about body x, pitch about the horizontal axis to the right of the heading, heading about the
    vertical (clockwise, that is about down).
    """
    _, _, heading = roll_pitch_heading(R_wcs_ics)
    right_ned = np.stack([-np.sin(heading), np.cos(heading), np.zeros_like(heading)], axis=-1)
    down = np.broadcast_to(np.array([0.0, 0.0, -1.0]), right_ned.shape)
    return np.stack([R_wcs_ics[..., :, 0], right_ned @ R_ENU_NED.T, down], axis=-2)
