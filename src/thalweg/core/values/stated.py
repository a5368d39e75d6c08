"""What a file states of its coordinates: GeoKeys, units of all three axes, degrees; all brought to metres."""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyproj import CRS, Transformer
from pyproj.crs import CompoundCRS, GeographicCRS, ProjectedCRS
from pyproj.crs.coordinate_operation import UTMConversion
from pyproj.crs.coordinate_system import Ellipsoidal3DCS

from thalweg.core import ArrayF, ArrayI, InputError
from thalweg.core.values.units import METRE, Unit, unit_of_code, units_of_crs

_MODEL, _GEOGRAPHIC, _PROJECTED, _LINEAR_UNIT, _VERTICAL_UNIT = 1024, 2048, 3072, 3076, 4099
_USER_DEFINED: Final = 32767
_UNKNOWN: Final = frozenset({"", "unknown", "unnamed"})
_ROW: Final = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Stated:
    """A coordinate system in metres, and how the numbers of the file come into it.

    Attributes
    ----------
    crs : lengths in metres, heights named only where their datum is; None where none is stated.
    factors : metres in a unit of x, y and z; 1 for degrees.
    notes : a sentence for each unit that is converted or taken for granted.
    """

    crs: CRS | None
    factors: tuple[float, float, float]
    notes: tuple[str, ...]


_MATTERS: Final = re.compile(
    r"(?i)draught|draft|datum|geoid|dhhn|navd|ngvd|\begm|tide|gps time|time (?:zone|system)|local time|"
    r"daylight|offset|shift|speed of sound|sound (?:speed|velocity)|positive|origin|cent(?:re|er)\b|correct|"
    r"\bto (?:world|body|camera)|\b(?:ned|enu|mm|feet|ft|utm|utc|gmt|msl)\b|\+proj|coordinate system|"
    r"reference frame|epsg|scale factor|multipl"
)
_DOWNWARDS: Final = re.compile(
    r"(?i)positive[ -]*down|down(?:wards?)?[ -]*(?:is )?positive|\bz\b\W+(?:is )?(?:the )?(?:water )?depth"
)


def matters(remark: str) -> bool:
    """Whether a remark of a file may change what its numbers mean: one that is not read is quoted then."""
    return _MATTERS.search(remark) is not None


def says_downwards(remark: str) -> bool:
    """Whether a remark says that heights are depths.

    Examples
    --------
    >>> says_downwards("# z positive down"), says_downwards("z: depth below water"), says_downwards("z is up")
    (True, True, False)
    """
    return _DOWNWARDS.search(remark) is not None


def refuse_depths(crs: CRS | None, where: str | Path) -> None:
    """Refuse a coordinate system whose third axis counts downwards.

    Raises
    ------
    InputError : it does.
    """
    for part in () if crs is None else crs.sub_crs_list or [crs]:
        if any(axis.direction.lower() == "down" for axis in part.axis_info):
            raise InputError(
                f"depths, positive downwards, by the coordinate system {part.name}",
                where=where,
                expected="heights, positive upwards",
                cure="Change the sign of the third coordinate, and name a system of heights",
            )


def in_metres(crs: CRS | None, across: Unit | None = None, up: Unit | None = None) -> Stated:
    """The same coordinate system with all lengths in metres.

    Parameters
    ----------
    crs : as the file states it, put together or not, in any unit.
    across, up : units that the file states beside the CRS; they count more than its own.

    Examples
    --------
    >>> found = in_metres(CRS("EPSG:2263+6360"))  # feet of the US survey
    >>> found.factors[0] == found.factors[2] == 1200 / 3937, found.crs.axis_info[2].unit_name
    (True, 'metre')
    """
    notes: list[str] = []
    flat = crs.sub_crs_list[0] if crs is not None and crs.is_compound else crs
    if crs is not None and flat is not None and flat.is_engineering:  # so GDAL has maps of no known system
        if flat.name.lower() not in _UNKNOWN:
            notes.append(f"The file gives its coordinates a name and no system: {flat.name}.")
        beside = units_of_crs(crs)
        crs, across, up = None, across or beside[0], up or beside[1]
    own: tuple[Unit | None, Unit | None] = (None, None) if crs is None else units_of_crs(crs)
    # a projected system has its units in its parameters: those of a file beside it are of places without one
    units = (own[0] or across, up or own[1])
    degrees = crs is not None and crs.is_geographic
    notes += [
        f"{what} are stated in {unit.plural} ({unit.metres:.10g} m) and converted to metres."
        for what, unit in zip(("East and north", "Heights"), units, strict=True)
        if unit is not None and not unit.is_metre
    ]
    if units[1] is None:
        also = " although east and north are not" if any("East" in note for note in notes) else ""
        notes.append(f"The file states no unit of heights: metres{also}.")
    x, z = ((unit or METRE).metres for unit in units)
    if crs is not None:
        if any(unit is not None and not unit.is_metre for unit in own):
            crs = CRS.from_json_dict(_metric(crs.to_json_dict()))
        if crs.is_compound and str(crs.sub_crs_list[1].datum and crs.sub_crs_list[1].datum.name) in _UNKNOWN:
            crs = crs.sub_crs_list[0]
    return Stated(crs, (1.0 if degrees else x, 1.0 if degrees else x, z), tuple(notes))


def _metric(part: Any) -> Any:
    """A CRS in PROJJSON with metres on its own axes; parameters of its projection state their units."""
    if isinstance(part, list):
        return [_metric(each) for each in part]
    if not isinstance(part, dict):
        return part
    out = {key: value if key == "base_crs" else _metric(value) for key, value in part.items()}
    for axis in out.get("coordinate_system", {}).get("axis", ()):
        unit = axis["unit"]
        if unit not in ("degree", "metre") and not (isinstance(unit, dict) and unit["type"] == "AngularUnit"):
            axis["unit"] = "metre"
            out.pop("id", None)
            out["name"] = f"{part['name']} in metres"
    if "components" in out:
        out.pop("id", None)
        names = (each.get("source_crs", each)["name"] for each in out["components"])  # TOWGS84 has none
        out["name"] = " + ".join(names)
    return out


def _unit_of_key(keys: ArrayI, key: int, of: str, where: str | Path) -> Unit | None:
    """Unit of length that one of the GeoKeys (n, 4) states (3076 of the map, 4099 of heights).

    Raises
    ------
    InputError : a unit that no table knows.
    """
    code = next((int(value) for name, place, _, value in keys if name == key and place == 0), 0)
    unit = unit_of_code(code) if code else None
    if code and unit is None:
        raise InputError(
            f"GeoKey {key}: {of} in the unit {code}" + (" (user-defined)" if code == _USER_DEFINED else ""),
            expected="a unit of length of the EPSG database, such as 9001 (metre) or 9003 (US survey foot)",
            where=where,
            cure="Write the file again with its unit, or in metres",
        )
    return unit


def crs_of_geokeys(
    directory: Sequence[int],
    doubles: Sequence[float] = (),
    text: str = "",
    *,
    crs: CRS | None = None,
    up: Unit | None = None,
    where: str | Path = "",
) -> Stated:
    """The coordinate system of GeoKeys (OGC 19-008r4), as GDAL reads them of a GeoTIFF, in metres.

    Parameters
    ----------
    directory, doubles, text : tags 34735, 34736, 34737, which LAS has as records of the same numbers.
    crs : that the file states beside; of the keys only units count then.
    up : unit of heights that the file states elsewhere; a key counts more.
    where : file, for messages.

    Raises
    ------
    InputError : a unit that no table knows.
    """
    refuse_depths(crs, where)
    rows = np.asarray(directory[: len(directory) // 4 * 4], np.int64).reshape(-1, 4)[1:]
    across = _unit_of_key(rows, _LINEAR_UNIT, "the map", where)
    up = _unit_of_key(rows, _VERTICAL_UNIT, "heights", where) or up
    found = in_metres(crs, across, up)
    if found.crs is not None or not len(rows):
        return found
    from PIL import Image, TiffImagePlugin
    from rasterio import Env
    from rasterio.io import MemoryFile

    rows = rows[rows[:, 0] > 0]  # some writers leave an empty one, and count it
    if _MODEL not in rows[:, 0]:
        kind = 1 if _PROJECTED in rows[:, 0] else 2 if _GEOGRAPHIC in rows[:, 0] else 0
        rows = np.concatenate([rows, [[_MODEL, 0, 1, kind]]]) if kind else rows
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    directory = (1, 1, 0, len(rows), *rows.ravel().tolist())
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    values: Mapping[int, tuple[int, object]] = {
        33550: (12, (1.0, 1.0, 0.0)),
        33922: (12, _ROW),
        34735: (3, directory),
        34736: (12, tuple(float(value) for value in doubles)),
        34737: (2, text),
    }
    for tag, (kind, value) in values.items():
        if value:
            tags.tagtype[tag] = kind
            tags[tag] = value
    cell = io.BytesIO()
    Image.new("L", (1, 1)).save(cell, "TIFF", tiffinfo=tags)
    with Env(GTIFF_REPORT_COMPD_CS=True), MemoryFile(cell.getvalue()) as file, file.open() as raster:
        crs = CRS.from_wkt(raster.crs.to_wkt()) if raster.crs else None
    return in_metres(crs, across, up)


def onto_map(xyz: ArrayF, crs: CRS) -> tuple[ArrayF, CRS, str]:
    """Points in degrees, or from the centre of the earth, in the zone of UTM in their middle, same datum.

    Parameters
    ----------
    xyz : (n, 3) longitude, latitude (degrees), height; or geocentric, metres.

    Returns
    -------
    xyz_m : (n, 3) east, north, height; heights of a geographic system are as they were.
    crs : of them, with the system of heights that was stated.
    note : what was done.

    Raises
    ------
    InputError : beyond 84 N or 80 S, or no angles.
    """
    geodetic = crs.sub_crs_list[0] if crs.is_compound else crs
    if crs.is_geocentric:
        wkt = GeographicCRS(name=crs.name, datum=crs.datum, ellipsoidal_cs=Ellipsoidal3DCS()).to_wkt()
        geodetic = CRS.from_wkt(wkt)
        xyz = np.column_stack(Transformer.from_crs(crs, geodetic, always_xy=True).transform(*xyz.T))
    lon, lat = np.median(xyz[:, :2], axis=0)
    if not (abs(lon) <= 360 and -80 <= lat <= 84):
        raise InputError(
            f"coordinates about {lon:g}, {lat:g} in {crs.name}",
            expected="longitude and latitude in degrees, of a zone of UTM",
            cure="Look at their order, or transform the file to a map projection",
        )
    zone = int((lon + 180.0) % 360.0 // 6.0) + 1
    flat = geodetic.to_2d()
    plane: CRS = ProjectedCRS(
        UTMConversion(zone, hemisphere="N" if lat >= 0 else "S"),
        name=f"{flat.name} / UTM zone {zone}{'N' if lat >= 0 else 'S'}",
        geodetic_crs=flat,
    )
    code = plane.to_epsg()
    plane = CRS.from_wkt(plane.to_wkt()) if code is None else CRS.from_epsg(code)
    east, north = Transformer.from_crs(flat, plane, always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    note = f"Coordinates in {crs.name} are transformed to {plane.name}."
    if crs.is_compound:
        vertical = crs.sub_crs_list[1]
        plane = CompoundCRS(f"{plane.name} + {vertical.name}", [plane, vertical])
    elif len(geodetic.axis_info) == 3:
        plane = plane.to_3d()
    return np.column_stack([east, north, xyz[:, 2]]), plane, note


def horizontal_of(crs: CRS) -> CRS:
    """The horizontal part of a CRS, without the way to WGS 84 that WKT 1 may tie to it (TOWGS84).

    Examples
    --------
    >>> horizontal_of(CRS("EPSG:25833+7837")).name
    'ETRS89 / UTM zone 33N'
    """
    return _bare(crs.sub_crs_list[0] if crs.is_compound else crs).to_2d()


def _bare(crs: CRS) -> CRS:
    return crs.source_crs if crs.is_bound and crs.source_crs else crs


def vertical_of(frame: object) -> CRS | str | None:
    """The vertical part of a CRS; ``ellipsoidal`` of one with three axes; None of others, and of no CRS."""
    if not isinstance(frame, CRS):
        return None
    if frame.is_compound:
        return _bare(frame.sub_crs_list[1])
    return "ellipsoidal" if len(frame.axis_info) == 3 and not frame.is_engineering else None


def same_heights(a: object, b: object) -> bool:
    """Whether two frames may have the same heights: one states none, or both the same."""
    one, two = vertical_of(a), vertical_of(b)
    if one is None or two is None:
        return True
    return one == two if isinstance(one, str) or isinstance(two, str) else bool(one.equals(two))


def heights_in_words(frame: object) -> str:
    """Name of the system of heights, such as ``DHHN2016 height``; empty where none is stated."""
    found = vertical_of(frame)
    return found if isinstance(found, str) else "" if found is None else found.name
