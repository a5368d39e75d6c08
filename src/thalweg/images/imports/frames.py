"""Poses of other programs in the world frame wcs.

A map grid is conformal but no world frame: its north differs from true north by the meridian convergence, and
its metres are 0.9996 m in the middle of a UTM zone. So each projection centre is transformed by itself, and
each rotation is turned by the axes of the grid at that place::

    R_wcs_ccs = R_wcs_grid(E, N, h) R_grid_ccs

with the tangent of the grid's north line as second column, the normal of the ellipsoid as third. For
geographic coordinates the axes are east, north, up of the place itself (`LocalFrame.R_wcs_enu`).
"""

from typing import Final, Literal

import numpy as np
from pyproj import CRS

from thalweg.core.errors import GeometryError
from thalweg.core.frames import GRS80_SEMI_MAJOR_M, LocalFrame
from thalweg.core.types import ArrayF
from thalweg.images.imports.source import Finished, Place

_STEP_M: Final = 50.0
"""Half the chord of the grid's north line; curvature and rounding cost some 1e-10 rad each."""


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
    crs = place.crs
    assert crs is not None
    if place.kind == "map":
        return frame.from_map(coordinates, crs)
    _check_datum(crs)
    if place.kind == "geocentric":
        return frame.from_ecef(coordinates)
    lon, lat = coordinates[:, 0], coordinates[:, 1]
    if not ((np.abs(lat) <= 90) & (np.abs(lon) <= 360)).all():
        k = int(np.argmax((np.abs(lat) > 90) | (np.abs(lon) > 360)))
        raise GeometryError(
            f"longitude {lon[k]:.3f}, latitude {lat[k]:.3f}", expected=f"degrees of '{crs.name}'",
            cure="Check images.finished.crs and the order of the columns: X is the longitude",
        )  # fmt: skip
    return frame.from_geodetic(lat, lon, coordinates[:, 2])


def raised(coordinates: ArrayF, place: Place, offset_m: float, frame: LocalFrame) -> ArrayF:
    """Coordinates with an offset added to their heights."""
    if not offset_m:
        return coordinates
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


def between_frames(
    source: LocalFrame, target: LocalFrame, centre: ArrayF, R: ArrayF, cov: ArrayF, following: ArrayF
) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    """Poses of one world frame in another one: the origins of two campaigns."""
    turn = target.R_ecef_enu.T @ source.R_ecef_enu
    ecef = centre @ source.R_ecef_enu.T + source.origin_ecef_m
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = turn
    return target.from_ecef(ecef), turn @ R, J @ cov @ J.T, J @ following @ J.T


def _check_datum(crs: CRS) -> None:
    """As `LocalFrame.from_map` does for grids."""
    ellipsoid = crs.ellipsoid
    if ellipsoid is None or abs(ellipsoid.semi_major_metre - GRS80_SEMI_MAJOR_M) > 0.5:
        raise GeometryError(
            f"'{crs.name}' is on the ellipsoid {ellipsoid.name if ellipsoid else 'unknown'}, another datum "
            "than that of GNSS positions",
            expected="coordinates on GRS80 or WGS84",
            cure="Export in WGS84 or ETRS89",
        )
