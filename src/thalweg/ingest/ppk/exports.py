"""A PPK solution as files for people: table, GeoJSON, KML, facts."""

import json
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import read_table, utc_text_from_gps, write_table
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.ppk.solution import PpkSolution

_COLUMNS: Final = (
    "t_gps_s",
    "lat_deg",
    "lon_deg",
    "h_ell_m",
    "fix",
    "sigma_east_m",
    "sigma_north_m",
    "sigma_up_m",
    "n_sats",
    "ratio",
)
_COLOURS: Final = {"fixed": "ff73a100", "float": "ff009fe6", "other": "ff5e5ed5"}
"""KML: alpha, blue, green, red; distinguishable by colour-blind people."""


def write_solution(solution: PpkSolution, folder: Path, *, name: str) -> list[Path]:
    """Write ``positions.csv``, ``.parquet``, ``.geojson``, ``.kml`` and ``ppk.json``.

    Parameters
    ----------
    solution : of `run_ppk`.
    folder : target; it is made.
    name : of the track, for map programs.

    Returns
    -------
    files : in this order.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"positions.{end}" for end in ("csv", "parquet", "geojson", "kml")]
    table = solution.positions
    text = table[list(_COLUMNS)].copy()
    text.insert(0, "time_utc", [utc_text_from_gps(t) for t in table["t_gps_s"].tolist()])
    decimals = {"lat_deg": 10, "lon_deg": 10, "t_gps_s": 3}
    for column in text.columns[text.dtypes == np.float64]:
        text[column] = text[column].round(decimals.get(str(column), 4))
    text.to_csv(files[0], index=False)
    write_table(files[1], table, GNSS_POSITION)
    _write_map(table, name, files[2], files[3])
    facts = folder / "ppk.json"
    report = solution.report
    facts.write_text(
        json.dumps({**report.details, "losses": report.losses, "notes": report.notes}, indent=2) + "\n",
        encoding="utf-8",
    )
    return [*files, facts]


def write_track(positions: Path, out_geojson: Path, out_kml: Path, *, name: str) -> None:
    """Positions of a campaign (table kind ``gnss_position``) for maps: runs of the same fix as lines."""
    _write_map(read_table(positions, GNSS_POSITION)[0], name, out_geojson, out_kml)


def _write_map(table: pd.DataFrame, name: str, geojson: Path, kml: Path) -> None:
    geojson.write_text(json.dumps(_geojson(table, name)) + "\n", encoding="utf-8")
    kml.write_text(_kml(table, name), encoding="utf-8")


def _pieces(table: pd.DataFrame) -> list[tuple[str, list[list[float]]]]:
    """Runs of the same fix as lines of longitude, latitude, height; each begins where the last one ended."""
    fix = table["fix"].where(table["fix"].isin(_COLOURS), "other").to_numpy()
    places = table[["lon_deg", "lat_deg", "h_ell_m"]].to_numpy(np.float64).round(9)
    starts = np.flatnonzero(np.append(True, fix[1:] != fix[:-1]))
    ends = np.append(starts[1:], len(fix))
    return [
        (str(fix[a]), places[max(a - 1, 0) : b].tolist()) for a, b in zip(starts, ends, strict=True) if b > 1
    ]


def _geojson(table: pd.DataFrame, name: str) -> dict[str, object]:
    return {
        "type": "FeatureCollection",
        "name": name,
        "features": [
            {
                "type": "Feature",
                "properties": {"fix": fix, "epochs": len(line)},
                "geometry": {"type": "LineString", "coordinates": line},
            }
            for fix, line in _pieces(table)
        ],
    }


def _kml(table: pd.DataFrame, name: str) -> str:
    from xml.sax.saxutils import escape

    styles = "".join(
        f'<Style id="{fix}"><LineStyle><color>{colour}</color><width>3</width></LineStyle></Style>\n'
        for fix, colour in _COLOURS.items()
    )
    # on the ground: heights of KML are above the geoid, those of the solution above the ellipsoid
    lines = "".join(
        f"<Placemark><name>{fix}</name><styleUrl>#{fix}</styleUrl><LineString><tessellate>1</tessellate>"
        f"<coordinates>{' '.join(f'{lon:.9f},{lat:.9f}' for lon, lat, _ in line)}</coordinates>"
        "</LineString></Placemark>\n"
        for fix, line in _pieces(table)
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n'
        f"<name>{escape(name)}</name>\n{styles}{lines}</Document></kml>\n"
    )
