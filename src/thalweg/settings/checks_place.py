"""What ``mounts.calibration`` names: is it there, is it a calibration, and does it place the sensors?"""

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thalweg.core import Key, Mistake, ThalwegError, read_yaml
from thalweg.settings.checks_files import no_path
from thalweg.settings.messages import anchor, missing_cure, mistake
from thalweg.settings.sections import GnssLogs, is_calibration_path

if TYPE_CHECKING:
    from pyproj import CRS
if TYPE_CHECKING:
    from thalweg.core.calibration import Calibration
    from thalweg.settings.campaign import Campaign


# ---------------------------------------------------------------- map projection, height, orbit files, base


MAX_BASELINE_KM = 200.0
"""Beyond it the base antenna is a typing mistake, not a base station."""

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


def check_crs(text: Any, origin: Any, path: tuple[Key, ...] = _CRS_PATH) -> Iterator[Mistake]:
    """The CRS parses, is projected and metric, and its area of use holds the origin.

    Parameters
    ----------
    text : ``campaign.crs`` as written, or another grid at ``path``.
    origin : ``campaign.origin`` as written.
    """
    if not isinstance(text, str):
        return
    place = geodetic_place(origin)
    crs = parse_crs(text.strip())
    proposal = f"Write for instance {utm_code(*place[:2])}, UTM at the origin" if place else ""
    if isinstance(crs, str):
        reason = "is unknown to PROJ" if "not found" in crs else "is no CRS"
        yield mistake(
            path,
            f"{text!r} {reason}",
            "an EPSG code like EPSG:25833, or a definition that PROJ understands",
            proposal or "Look the code up at epsg.org",
        )
        return
    if not crs.is_projected:
        yield mistake(
            path,
            f"{text!r} is not projected ({crs.name})",
            "a map projection in metres",
            proposal or "Write the national grid of the survey area, like EPSG:25833",
        )
        return
    units = {axis.unit_name for axis in crs.axis_info if abs(axis.unit_conversion_factor - 1) > 1e-9}
    if units:
        yield mistake(
            path,
            f"{text!r} is in {', '.join(sorted(units))} ({crs.name})",
            "a map projection in metres",
            proposal or "Write the metric variant of this grid",
        )
    if place:
        outside = list(_check_area(text, crs, place, path))
        yield from outside
        if not (outside or units):
            yield from _check_export(crs, place, path)


def _check_export(crs: "CRS", place: tuple[float, float, float], path: tuple[Key, ...]) -> Iterator[Mistake]:
    """Can points near the origin be written in this grid? The exports themselves are asked."""
    from thalweg.core import GeometryError, LocalFrame

    try:
        LocalFrame(lat_deg=place[0], lon_deg=place[1], h_ell_m=place[2]).to_map([[0.0, 0.0, 0.0]], crs)
    except GeometryError as error:
        cure = f"Write for instance {utm_code(*place[:2])}, UTM at the origin"
        yield mistake(path, error.found, error.expected, cure)


def _check_area(
    text: str, crs: "CRS", place: tuple[float, float, float], path: tuple[Key, ...]
) -> Iterator[Mistake]:
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
    yield mistake(
        ("campaign", "origin") if path == _CRS_PATH else path,
        f"lat_deg {lat:g}, lon_deg {lon:g} lies outside the area of use of {text}",
        f"lat {area.south:g} .. {area.north:g}, lon {area.west:g} .. {area.east:g} ({crs.name})",
        cure,
    )


def check_base(gnss: GnssLogs, origin: Any) -> Iterator[Mistake]:
    """The base antenna is given once at most, as coordinates on the earth, near the survey."""
    given = [key for key in ("base_ecef_m", "base_llh", "base_from") if getattr(gnss, key) is not None]
    path = ("logs", "gnss")
    if len(given) > 1:
        yield mistake(
            (*path, given[1]),
            f"the base antenna is given by {' and '.join(given)}",
            "exactly one of base_ecef_m, base_llh, base_from",
            f"Keep {given[0]} and remove the rest",
        )
    base: tuple[float, float, float] | None = None
    key = "base_ecef_m"
    if gnss.base_ecef_m is not None:
        base = gnss.base_ecef_m
        radius = math.hypot(*base)
        if not 6.3e6 < radius < 6.4e6:
            yield mistake(
                (*path, key),
                f"a point {radius / 1000:g} km from the centre of the earth",
                "about 6370 km: earth-centred x, y, z in metres",
                "This looks like kilometres: multiply by 1000"
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
        yield mistake(
            (*path, key),
            f"the base is {distance_km:.0f} km from campaign.origin",
            f"a base within {MAX_BASELINE_KM:g} km",
            "Check sign and order of the coordinates, and campaign.origin",
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
    from thalweg.core import LocalFrame

    x, y, z = LocalFrame(lat_deg=lat_deg, lon_deg=lon_deg, h_ell_m=h_m).origin_ecef_m.tolist()
    return x, y, z


# ---------------------------------------------------------------- mounts


SENSORS = ("lidar", "camera", "antenna", "echo_sounder")
"""What a boat's calibration places, as in `thalweg.core.calibration.model`."""

SETTING: tuple[Key, ...] = ("mounts", "calibration")

_NEEDED = ("lidar", "antenna")
"""Without their places there are no points."""

_MOST_LISTED = 3
"""Mistakes of a calibration file that are told with the setting; `thalweg describe` tells all."""


def check_mounts_calibration(mounts: Any, campaign_id: Any, folder: Path) -> Iterator[Mistake]:
    """Mistakes in ``mounts.calibration`` and in the file that it names.

    Whether a *campaign* of that name exists is seen where all campaigns are: `thalweg.settings.load`.

    Parameters
    ----------
    mounts : section ``mounts`` as written.
    campaign_id : ``campaign.id`` as written.
    folder : folder of the campaign file.
    """
    chosen = mounts.get("calibration") if isinstance(mounts, dict) else None
    if not isinstance(chosen, str) or not chosen:
        return
    if not is_calibration_path(chosen):
        yield from _given_twice(mounts, SENSORS, chosen)
        if chosen == campaign_id:
            yield mistake(
                SETTING,
                "the campaign names itself",
                "another campaign, or a calibration file",
                "Remove the line: a calibration campaign starts from the values of its section mounts",
            )
        return
    if (wrong := no_path(SETTING, chosen, folder)) is not None:
        yield wrong
        return
    path = anchor(chosen, folder)
    found = _file(chosen, path)
    if isinstance(found, Mistake):
        yield found
        return
    yield from _given_twice(mounts, [name for name in SENSORS if name in found], chosen)
    yield from _check_places(found, mounts, chosen)


def _given_twice(mounts: Mapping[str, Any], sensors: Iterable[str], chosen: str) -> Iterator[Mistake]:
    for name in sensors:
        if mounts.get(name) is not None:
            yield mistake(
                ("mounts", name),
                f"both mounts.calibration ({chosen}) and mounts.{name} are given",
                "one of them",
                f"Remove mounts.{name}: the calibration holds it; or remove mounts.calibration",
            )


def _file(chosen: str, path: Path) -> "Calibration | Mistake":
    """The calibration of a file, or what is wrong with it."""
    from thalweg.core.calibration import MARK, check_calibration

    if not path.is_file():
        folder = path.is_dir()
        return mistake(
            SETTING,
            f"{chosen}: {'this is a folder' if folder else 'no such file'}",
            f"a calibration file at {path}",
            "Name the file in it, boat.yaml" if folder else missing_cure(path),
        )
    document = read_yaml(path)
    if not document.mistakes and not (isinstance(document.data, dict) and MARK in document.data):
        return mistake(
            SETTING,
            f"{chosen} is no calibration file",
            f"a file that begins with {MARK}: 1, or the id of a calibration campaign",
            _other_file(document.data, path),
        )
    try:
        calibration, mistakes = check_calibration(path)
    except ThalwegError as error:
        calibration, mistakes = None, [Mistake(found=error.found, expected=error.expected)]
    if calibration is not None and not mistakes:
        return calibration
    n, told = len(mistakes), " ".join(str(mistake) for mistake in mistakes[:_MOST_LISTED])
    more = f" And {n - _MOST_LISTED} more" if n > _MOST_LISTED else ""
    return mistake(
        SETTING,
        f"{chosen} holds {n} mistake{'s' if n > 1 else ''}: {told}{more}".rstrip("."),
        "a calibration file without mistakes",
        f"Correct {path}, and look at it with `thalweg describe`",
    )


def _other_file(data: Any, path: Path) -> str:
    """What to do with a file that is something else."""
    keys = data if isinstance(data, dict) else {}
    if "campaign" in keys:
        return f"This is a campaign file: write its id, calibration: {path.stem}"
    if "thalweg_field" in keys:
        return "This describes a calibration field: name what came out of it, boat.yaml"
    if keys.get("kind") == "thalweg mounts":
        return "These are the mounts of a campaign: name the calibration that they come from, boat.yaml"
    return "Calibrations of other programs come in by `thalweg import-calibration`"


def _check_places(calibration: "Calibration", mounts: Mapping[str, Any], chosen: str) -> Iterator[Mistake]:
    """Lidar and antenna have a place, in the calibration or in the campaign file."""
    try:
        found = calibration.to_mounts()
    except ThalwegError as error:
        yield mistake(SETTING, f"{chosen}: {error.found}", error.expected, error.cure)
        return
    blocks = ", ".join(block.name for block in calibration.blocks)
    if not found:
        yield mistake(
            SETTING,
            f"{chosen} holds the blocks {blocks}, and none of them is a place on the boat",
            f"at least one of {', '.join(SENSORS)}",
            "Name the calibration of the boat, boat.yaml",
        )
        return
    for name in _NEEDED:
        if name not in found and not _stated(mounts.get(name)):
            yield mistake(
                SETTING,
                f"{chosen} holds the blocks {blocks}, and the campaign states no place of the {name}",
                f"the place of the {name} in the calibration, or mounts.{name}.lever_ics_m",
                "Name the calibration of the boat, boat.yaml, or add the section "
                f"`{name}: {{lever_ics_m: [x, y, z]}}`",
            )


def _stated(mount: Any) -> bool:
    """Whether a section places its sensor: zeros stand where nothing is known."""
    lever = mount.get("lever_ics_m") if isinstance(mount, dict) else None
    return isinstance(lever, list) and any(value != 0 for value in lever)


def mount_sources(campaign: "Campaign") -> dict[str, str]:
    """Where the place of each sensor comes from, in words; ``""`` where nothing is stated.

    Parameters
    ----------
    campaign : a valid one, whose ``mounts.calibration`` is an id or an absolute path.

    Raises
    ------
    ThalwegError : the calibration file cannot be read.
    """
    chosen, section = campaign.mounts.calibration, campaign.mounts
    sources = {
        name: "the campaign file" if "lever_ics_m" in getattr(section, name).model_fields_set else ""
        for name in SENSORS
    }
    if chosen is None:
        return sources
    if not is_calibration_path(chosen):
        return dict.fromkeys(SENSORS, f"the calibration campaign {chosen}")
    from thalweg.core.calibration import read_calibration

    calibration = read_calibration(Path(chosen))
    words = f"{Path(chosen).name}, run {calibration.source.run}"
    return sources | {name: words for name in SENSORS if name in calibration}
