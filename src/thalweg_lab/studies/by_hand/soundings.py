"""Soundings that disagree: left-out days, errors by slope of the bed, and the mean of days of a made-up lake.

    python -m thalweg_lab.studies.by_hand.soundings days FOLDER_OF_SUM_FILES EVERY
    python -m thalweg_lab.studies.by_hand.soundings slopes FOLDER_OF_RECORDINGS
    python -m thalweg_lab.studies.by_hand.soundings mean FIRST_SEED SEEDS

Days: ``.sum`` files of a RiverSurveyor M9 (``github.com/duckmanager/Bathymetric-map-Lake-Caputh``,
``data/sonar_data``), every so many soundings. Each prints rows of a table.
"""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
import pandas as pd

from thalweg.bathymetry import BedOfTable, TableOfSoundings, agreement, bed_of_table, read_soundings, water_of
from thalweg.core import ArrayB
from thalweg.settings.sections import Bathymetry

_SIGMA_M: Final = 0.05
_LAKE_M: Final = 55.0
"""Radius of the made-up lake; noise of its soundings:"""
_NOISE_M: Final = 0.03
_SCATTER_M: Final = ((0.3, 0.0), (0.0, 0.15), (0.2, 0.1))
"""Of days and of runs."""
_TABLES: Final = (
    ("soundings_uprm", "today/soundings_uprm/Feb-15-2023.csv", ()),
    ("csb_lon_lat_depth", "today/csb_lon_lat_depth/ofm_singlefile.xyz", ()),
    (
        "deeper_csv",
        "today/deeper_csv/depth_map_data_20240727_0717_stripped.csv",
        ("--columns", "lat,lon,depth,-,time"),
    ),
    ("arduino_depth_logger", "today/arduino_depth_logger/grohn26082021.csv", ()),
    ("Lujan", "river_bottom_interpolator/Lujan/elevation_points.geojson", ("--crs", "EPSG:22175")),
)
"""Name, file, options of ``thalweg bed``."""


def days(folder: Path, every: int) -> None:
    """NEES of soundings of each day by the bed of the others: with their steps, and by the map alone."""
    settings = Bathymetry(cell_m=5.0)
    with TemporaryDirectory() as scratch:
        path = Path(scratch) / "soundings.csv"
        _sum_files(folder).iloc[::every].to_csv(path, index=False)
        everything = read_soundings(
            path, None, column="depth_m", depth=True, level_m=None, line_column=None, sigma_m=_SIGMA_M
        )
    whole = _bed(everything, settings)
    for note in whole.notes:
        print(f"note {note}")
    _print_classes("all days", whole.validation["classes"])
    assert everything.day is not None
    rows = []
    for k, name in enumerate(everything.days):
        left_out = everything.day == k
        found = _bed(_part(everything, ~left_out), settings)
        bed, agreed = found.bed, found.validation["agreement"]
        row, column = bed.grid.at(everything.places_m[left_out])
        at = (row * bed.grid.columns + column)[row >= 0]
        error = everything.height_m[left_out][row >= 0] - bed.up_m[at]
        of_map = bed.sigma_m[at] ** 2 + bed.sigma_common_m[at] ** 2
        steps = sum(agreed.get(f"sigma_{of}_m", 0.0) ** 2 for of in ("day", "run", "line"))
        whole_variance = of_map + _SIGMA_M**2 + bed.model.covariance.micro_m2 + steps
        told = np.isfinite(error)
        z = [(error / np.sqrt(v))[told] for v in (whole_variance, of_map)]
        rows.append([int(told.sum()), *(f(u) for u in z for f in (_nees, _outside))])
        print(
            f"{name}: n {rows[-1][0]}, NEES {rows[-1][1]:.2f}, outside 95 % {rows[-1][2]:.1%}; "
            f"by the map alone {rows[-1][3]:.2f}, {rows[-1][4]:.1%}",
            flush=True,
        )
    mean = np.mean(rows, axis=0)
    print(
        f"mean: NEES {mean[1]:.2f}, outside 95 % {mean[2]:.1%}; by the map alone {mean[3]:.2f}, {mean[4]:.1%}"
    )


def slopes(folder: Path) -> None:
    """NEES of left-out lines by slope, of beds with the defaults of ``thalweg bed``."""
    for name, path, options in _TABLES:
        with TemporaryDirectory() as scratch:
            command = [sys.executable, "-m", "thalweg", "bed", str(folder / path), *options]
            subprocess.run([*command, "--out", scratch], check=True, stdout=subprocess.DEVNULL)
            _print_classes(name, json.loads((Path(scratch) / "validation.json").read_text())["classes"])


def mean(first: int, seeds: int) -> None:
    """How often the mean of three days of three runs is within its sigma; the truth is known."""
    x, y = (np.arange(-_LAKE_M, _LAKE_M, step) for step in (24.0, 12.0))
    along = np.arange(-_LAKE_M, _LAKE_M, 3.0)
    legs = [np.column_stack([along, np.full(len(along), at)]) for at in y]
    legs += [np.column_stack([np.full(len(along), at), along]) for at in x]
    lines = [leg[np.hypot(*leg.T) < _LAKE_M] for leg in legs]
    lines = [leg for leg in lines if len(leg) > 3]
    across = sum(np.ptp(leg[:, 1]) == 0 for leg in lines)
    part = np.array_split(np.arange(across), 6) + np.array_split(np.arange(across, len(lines)), 3)
    run_of = np.repeat(np.arange(9), [len(each) for each in part])
    number = np.repeat(np.arange(len(lines)), [len(each) for each in lines])
    places, run = np.concatenate(lines), run_of[number]
    depth = 5.0 - 4.0 * np.sum(places**2, axis=1) / _LAKE_M**2 + np.sin(places[:, 0] / 14.0)
    for of_days, of_runs in _SCATTER_M:
        inside = 0
        for seed in range(first, first + seeds):
            rng = np.random.default_rng(seed)
            step = np.repeat(rng.normal(0.0, of_days, 3), 3) + rng.normal(0.0, of_runs, 9)
            height = step[run] - depth + _NOISE_M * rng.standard_normal(len(places))
            found = agreement(places, height, np.full(len(places), _NOISE_M), number, run, run // 3)
            inside += abs(np.mean(found.shift_m - step)) < np.mean(found.sigma_common_m)
        print(
            f"days {of_days} m, runs {of_runs} m: within one sigma {inside / seeds:.2f} of {seeds}",
            flush=True,
        )


def _print_classes(name: str, classes: dict[str, dict[str, float]]) -> None:
    of = {key: value for key, value in classes.items() if "slope" in key}
    words = [f"{key} {each['normalised_square']:.2f} (n {each['n']})" for key, each in of.items()]
    print(f"{name}: {', '.join(words)}", flush=True)


def _sum_files(folder: Path) -> pd.DataFrame:
    """Time, latitude, longitude and depth of the vertical beam; rows without a place or a depth left out."""
    tables = []
    for path in sorted(folder.glob("*.sum")):
        of = pd.read_csv(path, encoding="latin-1", index_col=False)
        time = pd.to_datetime(of["Date/Time"], format="%m/%d/%Y %I:%M:%S %p")
        tables.append(
            pd.DataFrame(
                {
                    "time": time.dt.strftime("%Y-%m-%dT%H:%M:%SZ"),
                    "lat": _degrees(of["Latitude (deg)"]),
                    "lon": _degrees(of["Longitude (deg)"]),
                    "depth_m": of["VB Depth (m)"],
                }
            )
        )
    table = pd.concat(tables, ignore_index=True)
    return table[(table["lat"] > 40) & (table["depth_m"] > 0)]


def _degrees(text: "pd.Series[str]") -> "pd.Series[float]":
    parts = text.astype(str).str.extract(r"(-?\d+)\D+?(\d+)'\s*([\d.]+)").astype(float)
    return parts[0] + parts[1] / 60 + parts[2] / 3600


def _part(of: TableOfSoundings, keep: ArrayB) -> TableOfSoundings:
    """Those soundings alone, days and runs numbered anew."""
    assert of.day is not None
    assert of.run is not None
    day, day_of = np.unique(of.day[keep], return_inverse=True)
    run, run_of = np.unique(of.run[keep], return_inverse=True)
    return replace(
        of,
        places_m=of.places_m[keep],
        height_m=of.height_m[keep],
        sigma_m=of.sigma_m[keep],
        line=pd.factorize(of.line[keep])[0].astype(np.int64),
        day=day_of.astype(np.int64),
        days=tuple(of.days[k] for k in day),
        run=run_of.astype(np.int64),
        runs=tuple(of.runs[k] for k in run),
        t_s=None if of.t_s is None else of.t_s[keep],
    )


def _bed(of: TableOfSoundings, settings: Bathymetry) -> BedOfTable:
    water = water_of(of, of.crs, settings, depths=True, coordinates="map")
    return bed_of_table(of, of.crs, settings, water)


def _nees(z: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> float:
    return float(np.mean(z**2))


def _outside(z: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> float:
    return float(np.mean(np.abs(z) > 1.959964))


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["days", folder, every]:
            days(Path(folder), int(every))
        case ["slopes", folder]:
            slopes(Path(folder))
        case ["mean", first, seeds]:
            mean(int(first), int(seeds))
        case _:
            sys.exit(__doc__)
