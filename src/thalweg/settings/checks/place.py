"""Does the map projection exist, does it hold the survey, and is the base station near it?"""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from thalweg.core.mistakes import Mistake
from thalweg.settings.sections.logs import GnssLogs

if TYPE_CHECKING:
    from pyproj import CRS

MAX_BASELINE_KM = 200.0
"""Beyond it the base antenna is a typing mistake, not a base station."""

_A_M, _E2 = 6_378_137.0, 6.694379990141e-3
"""WGS84 semi-major axis and squared eccentricity."""

_CRS_PATH = ("campaign", "crs")


@lru_cache(maxsize=8)
def parse_crs(text: str) -> "CRS | str":
    """The CRS, or what PROJ says against it. pyproj costs 0.15 s: it is imported only here."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(text)
    except CRSError as error:
        return str(error)


def check_crs(text: Any, origin: Any) -> Iterator[Mistake]:
    """The CRS parses, is projected and metric, and its area of use holds the origin.

    Parameters
    ----------
    text : ``campaign.crs`` as written.
    origin : ``campaign.origin`` as written.
    """
    if not isinstance(text, str):
        return
    place = geodetic_place(origin)
    crs = parse_crs(text.strip())
    proposal = f"Write for instance {utm_code(*place[:2])}, UTM at the origin" if place else ""
    if isinstance(crs, str):
        reason = "is unknown to PROJ" if "not found" in crs else "is no CRS"
        yield Mistake(
            path=_CRS_PATH,
            found=f"{text!r} {reason}",
            expected="an EPSG code like EPSG:25833, or a definition that PROJ understands",
            cure=proposal or "Look the code up at epsg.org",
        )
        return
    if not crs.is_projected:
        yield Mistake(
            path=_CRS_PATH,
            found=f"{text!r} is not projected ({crs.name})",
            expected="a map projection in metres",
            cure=proposal or "Write the national grid of the survey area, like EPSG:25833",
        )
        return
    units = {axis.unit_name for axis in crs.axis_info if abs(axis.unit_conversion_factor - 1) > 1e-9}
    if units:
        yield Mistake(
            path=_CRS_PATH,
            found=f"{text!r} is in {', '.join(sorted(units))} ({crs.name})",
            expected="a map projection in metres",
            cure=proposal or "Write the metric variant of this grid",
        )
    if place:
        yield from _check_area(text, crs, place)


def _check_area(text: str, crs: "CRS", place: tuple[float, float, float]) -> Iterator[Mistake]:
    area = crs.area_of_use or (crs.sub_crs_list[0].area_of_use if crs.is_compound else None)
    lat, lon, _ = place
    if area is None or _inside(area, lat, lon):
        return
    if _inside(area, lon, lat):
        cure = f"Latitude and longitude look swapped: write lat_deg: {lon:g}, lon_deg: {lat:g}"
    elif _inside(area, math.degrees(lat), math.degrees(lon)):
        cure = (
            f"The origin looks like radians: write lat_deg: {math.degrees(lat):.7f}, "
            f"lon_deg: {math.degrees(lon):.7f}"
        )
    elif _inside(area, lat, -lon):
        cure = f"East is positive: is lon_deg: {-lon:g} meant?"
    else:
        cure = f"Correct campaign.origin, or take a CRS of that place, for instance {utm_code(lat, lon)}"
    yield Mistake(
        path=("campaign", "origin"),
        found=f"lat_deg {lat:g}, lon_deg {lon:g} lies outside the area of use of {text}",
        expected=f"lat {area.south:g} .. {area.north:g}, lon {area.west:g} .. {area.east:g} ({crs.name})",
        cure=cure,
    )


def check_base(gnss: GnssLogs, origin: Any) -> Iterator[Mistake]:
    """The base antenna is given once at most, as coordinates on the earth, near the survey."""
    given = [key for key in ("base_ecef_m", "base_llh", "base_from") if getattr(gnss, key) is not None]
    path = ("logs", "gnss")
    if len(given) > 1:
        yield Mistake(
            path=(*path, given[1]),
            found=f"the base antenna is given by {' and '.join(given)}",
            expected="exactly one of base_ecef_m, base_llh, base_from",
            cure=f"Keep {given[0]} and remove the rest",
        )
    base: tuple[float, float, float] | None = None
    key = "base_ecef_m"
    if gnss.base_ecef_m is not None:
        base = gnss.base_ecef_m
        radius = math.hypot(*base)
        if not 6.3e6 < radius < 6.4e6:
            yield Mistake(
                path=(*path, key),
                found=f"a point {radius / 1000:g} km from the centre of the earth",
                expected="about 6370 km: earth-centred x, y, z in metres",
                cure="This looks like kilometres: multiply by 1000"
                if 6300 < radius < 6400
                else "Map or geodetic coordinates? Write those in base_llh, or convert to earth-centred ones",
            )
            return
    elif gnss.base_llh is not None:
        key = "base_llh"
        llh = gnss.base_llh
        base = _ecef(llh.lat_deg, llh.lon_deg, llh.h_ell_m)
    place = geodetic_place(origin)
    if base is None or place is None:
        return
    distance_km = math.dist(base, _ecef(*place)) / 1000
    if distance_km > MAX_BASELINE_KM:
        yield Mistake(
            path=(*path, key),
            found=f"the base is {distance_km:.0f} km from campaign.origin",
            expected=f"a base within {MAX_BASELINE_KM:g} km",
            cure="Check sign and order of the coordinates, and campaign.origin",
        )


def utm_code(lat_deg: float, lon_deg: float) -> str:
    """EPSG code of the WGS84 UTM zone of a position.

    Examples
    --------
    >>> utm_code(51.05, 13.25)
    'EPSG:32633'
    """
    zone = min(int((lon_deg + 180) // 6) + 1, 60)
    return f"EPSG:{(32600 if lat_deg >= 0 else 32700) + zone}"


def geodetic_place(origin: Any) -> tuple[float, float, float] | None:
    """Latitude, longitude and height if all are numbers in range."""
    if not isinstance(origin, dict):
        return None
    values = [origin.get(key) for key in ("lat_deg", "lon_deg", "h_ell_m")]
    if any(isinstance(v, bool) or not isinstance(v, int | float) or not math.isfinite(v) for v in values[:2]):
        return None
    lat, lon = float(values[0]), float(values[1])  # type: ignore[arg-type]
    height = float(values[2]) if isinstance(values[2], int | float) else 0.0
    return (lat, lon, height) if abs(lat) <= 90 and abs(lon) <= 180 else None


def _inside(area: Any, lat: float, lon: float) -> bool:
    if not area.south <= lat <= area.north:
        return False
    if area.west <= area.east:
        return bool(area.west <= lon <= area.east)
    return bool(lon >= area.west or lon <= area.east)


def _ecef(lat_deg: float, lon_deg: float, h_m: float) -> tuple[float, float, float]:
    """Earth-centred coordinates in closed form: no import of pyproj for a plausibility check."""
    lat, lon = math.radians(lat_deg), math.radians(lon_deg)
    n = _A_M / math.sqrt(1 - _E2 * math.sin(lat) ** 2)
    return (
        (n + h_m) * math.cos(lat) * math.cos(lon),
        (n + h_m) * math.cos(lat) * math.sin(lon),
        (n * (1 - _E2) + h_m) * math.sin(lat),
    )
