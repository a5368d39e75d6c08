"""Echo sounder and light sheet on one boat: what the sheet adds to a small river (T 3.2, Fig. 3.5).

The river is ten metres wide and up to 2.5 m deep, as in T 3.2. Its cross-sections are real ones: four of the
29 surveyed sections of the set CDD of RiverBottomInterpolator, taken at low water and scaled. (T scales a
part of the Ohio River, whose data it does not give.) On a zigzag the echo sounder measures from 0.20 m of
water on, the light sheet from 0.05 to 0.20 m. Raw logs become soundings and a bed by the functions of the
rules, once with the points of the sheet and once without.

The points of the sheet are no rendered images (`thalweg_lab.tank` makes those): each is a place of the true
bed below the boat, within the width of the line that the sensor of P4 has at this depth, carried by the
estimated poses and with the noise of a line.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.bathymetry import Bed
from thalweg.core import cross_matrix, frame_of
from thalweg.figures import save
from thalweg.lightsheet.optics import depth_lines, paper_4
from thalweg.lightsheet.scanning import BED_POINTS
from thalweg_lab.figures import joint_river_figure
from thalweg_lab.random_numbers import generator
from thalweg_lab.reproduction import SMALL_RIVER_WIDTH_M
from thalweg_lab.studies.bed_study import (
    ECHO_SOUNDER,
    River,
    bed_of,
    known_cells,
    river_of,
    sums_of,
    verdict_of,
)
from thalweg_lab.studies.study import Result, Seed, Study, Tables
from thalweg_lab.studies.survey import BARE, MOUNTS, record, survey_settings
from thalweg_lab.truth import true_bed_m
from thalweg_lab.voyage import Voyage

SECTIONS: Final = (
    (0.0, 0.44, 0.72, 0.81, 0.14, 0.08, 0.69, 1.0, 0.85, 0.34, 0.26, 0.41, 0.0),
    (0.0, 0.10, 0.03, 0.09, 0.06, 0.16, 0.30, 0.55, 0.82, 0.91, 0.92, 1.0, 0.0),
    (0.0, 0.05, 0.10, 0.31, 0.36, 0.54, 0.56, 0.92, 0.93, 1.0, 0.85, 0.54, 0.0),
    (0.0, 0.68, 0.75, 0.83, 0.87, 1.0, 1.0, 0.97, 0.93, 0.74, 0.65, 0.23, 0.0),
)
"""Sections 22, 17, 24 and 29 of CDD below -0.50, -0.10, 0.00 and -0.25 m, at thirteen places from shore to
shore, as shares of their greatest depths."""

LASER_M: Final = (0.05, 0.2)
"""Depths of water in which the light sheet measures, by T 3.2."""
ECHO_LEVER_M: Final = (0.2, 0.0, 0.22)
"""Face of the transducer, 2 cm under water."""
DEAD_ZONE_M: Final = 0.18
"""Below it: soundings from 0.20 m of water on."""

TWIN: Final[dict[str, Any]] = {
    "size": "tiny",
    "duration_s": 110.0,
    "scene": BARE | {"length_m": 42.0, "width_m": SMALL_RIVER_WIDTH_M, "depth_m": 2.5, "sections": SECTIONS,
                     "grid_m": 0.15, "roughness_m": 0.02, "embankment_height_m": 2.0},
    "boat": {"speed_mps": 0.7, "bank_distance_m": 0.4, "turn_rate_degps": 30.0, "zigzag_deg": 75.0},
    "ins": {"attitude_time_s": 5.0},
    "gnss": {"correlation_time_s": 8.0},
    "lidar": {"mirror_ghosts": False, "own_hull": False, "divergence_mrad": 0.0},
    "effects": {"lost_packets": 0.95},
    "echo": {"beam_deg": 5.0, "dead_zone_m": DEAD_ZONE_M, "zeros": True},
}  # fmt: skip
"""Section ``twin``: a zigzag of legs four metres apart on 37 m of T's river."""

BATHYMETRY: Final[dict[str, Any]] = {"cell_m": 0.25, "bank_station_m": 1.0}

SHEET_LEVER_M: Final = np.array([0.3, 0.0, 0.22])
"""Middle of the sensor's window: 2 cm under water."""
WINDOW_M: Final = 0.02
SHEET_HZ: Final = 10.0
LINE_POINTS: Final = 40
SIGMA_LINE_M: Final = 0.001
"""Noise of a point within its line."""
CLASSES_M: Final = (0.0, *LASER_M, 0.5, 1.0, np.inf)
"""Limits of the classes of depth."""
NEAR_M: Final = 0.2
"""Cells so near to a datum count as measured."""
BANK_M: Final = 1.0
"""Cells so near to a bank may hold its wall, which no sounding shows."""
SUMS: Final = ("n", "observed_m2", "predicted_m2", "normalised", "outside")
SURVEYS: Final = ("echo sounder", "with light sheet")


def campaign_of(seed: int) -> dict[str, Any]:
    """Settings of the survey of a seed."""
    known = ECHO_SOUNDER | {
        "set_sound_speed_mps": None,
        "latency_s": 0.0,
        "sigma_latency_s": 0.02,
        "dead_zone_m": DEAD_ZONE_M,
    }
    mounts = MOUNTS | {"echo_sounder": {"lever_ics_m": ECHO_LEVER_M}}
    return survey_settings(TWIN, seed=seed, mounts=mounts, echo_sounder=known, bathymetry=BATHYMETRY)


def sheet_points(river: River) -> pd.DataFrame:
    """Points of the bed by the light sheet along a voyage, table of kind ``bed_points``.

    Parameters
    ----------
    river : of the survey, with its truth: where the bed is and how the boat truly moved.
    """
    logs, estimated = river.logs, river.cloud.trajectory
    voyage = Voyage(logs.twin, logs.seed)
    first, last = estimated.span()
    t = np.arange(first + 0.5, last - 0.5, 1.0 / SHEET_HZ)
    window, R = voyage.sensor_wcs_m(t, SHEET_LEVER_M), voyage.R_wcs_ics(t)
    level = voyage.water_level_m(t)
    depths = np.linspace(*LASER_M, 7)
    lines = depth_lines(paper_4(), (1e3 * (depths - WINDOW_M)).tolist())
    widths = [1e-3 * np.linalg.norm(np.ptp(line.xyz_lcs_mm[:, :2], axis=0)) for line in lines]
    below = level - true_bed_m(logs.scene, window[:, :2])
    width = np.interp(np.nan_to_num(below), depths, widths)
    aside = width[:, None] * np.linspace(-0.5, 0.5, LINE_POINTS)
    place = window[:, None, :2] + aside[..., None] * R[:, None, :2, 1]
    up = true_bed_m(logs.scene, place.reshape(-1, 2))
    image = np.repeat(np.arange(len(t)), LINE_POINTS)
    there = (level[image] - up >= LASER_M[0]) & (level[image] - up <= LASER_M[1])
    image = image[there]
    xyz = np.column_stack([place.reshape(-1, 2), up])[there]
    body = np.einsum("nji,nj->ni", R[image], xyz - voyage.position_wcs_m(t)[image])
    noise = SIGMA_LINE_M * generator(logs.seed, "joint study").standard_normal(len(xyz))
    at, turn, _ = estimated.at(t)
    arm = np.einsum("nij,nj->ni", turn[image], body)
    J = np.concatenate([np.broadcast_to(np.eye(3), (len(arm), 3, 3)), -cross_matrix(arm)], axis=2)
    cov = J @ estimated.cov_at(t)[image] @ np.swapaxes(J, 1, 2)
    cov[:, 2, 2] += SIGMA_LINE_M**2
    found = at[image] + arm
    names = np.array([f"line_{k:05d}" for k in range(len(t))], dtype=object)
    pairs = {"ee": (0, 0), "en": (0, 1), "eu": (0, 2), "nn": (1, 1), "nu": (1, 2), "uu": (2, 2)}
    n = len(found)
    return frame_of(
        BED_POINTS,
        {
            "file": names[image],
            "t_gps_s": t[image],
            "east_m": found[:, 0],
            "north_m": found[:, 1],
            "up_m": found[:, 2] + noise,
            **{f"cov_{ab}_m2": cov[:, i, j] for ab, (i, j) in pairs.items()},
            "sigma_line_m": np.full(n, SIGMA_LINE_M),
            "line": np.zeros(n, dtype=np.int32),
            "x_px": np.zeros(n),
            "y_px": np.zeros(n),
            "peak_dn": np.zeros(n),
            "flags": np.zeros(n, dtype=np.uint8),
        },
    )


def cells_of(bed: Bed, river: River) -> pd.DataFrame:
    """Known cells of a bed: east_m, north_m (wcs), up_m, error_m, sigma_m, distance_m, depth_m (true)."""
    known, at = known_cells(bed, river)
    true = true_bed_m(river.logs.scene, at)
    return pd.DataFrame(
        {
            "east_m": at[:, 0],
            "north_m": at[:, 1],
            "up_m": bed.up_m[known],
            "error_m": bed.up_m[known] - true,
            "sigma_m": np.hypot(bed.sigma_m[known], bed.sigma_common_m[known]),
            "distance_m": bed.distance_m[known],
            "depth_m": river.logs.twin.scene.water_level_m - true,
        }
    )


def surveyed(seed: int, folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """One survey with and without the light sheet.

    Returns
    -------
    squares : a row a survey and class of depth: columns of `thalweg_lab.studies.bed_study.sums_of`, measured
        (cells within `NEAR_M` of a datum), soundings, sheet; sums of cells farther than `BANK_M` from the
        banks alone, named ``off_...``.
    places : for the picture: what (cell, track, sounding, light sheet), east_m, north_m, up_m, depth_m,
        error_m.
    """
    river = river_of(record(campaign_of(seed), folder / f"seed_{seed}", echo=True))
    strip = sheet_points(river)
    rows, places = [], []
    for name, points in zip(SURVEYS, (None, strip), strict=True):
        bed, _, banks = bed_of(river, strip=points)
        cells = cells_of(bed, river)
        s, n, _ = banks.line.to_flow(cells[["east_m", "north_m"]].to_numpy())
        off = ~banks.outside(s, n + BANK_M * np.sign(n))
        level = river.logs.twin.scene.water_level_m
        below = {
            source: level - bed.data.loc[bed.data["source"] == source, "up_m"].to_numpy()
            for source in ("sounding", "light sheet")
        }
        for low, high in pairwise(CLASSES_M):
            of = (cells["depth_m"] >= low) & (cells["depth_m"] < high)
            mine, away = cells[of], cells[of & off]
            apart = sums_of(name, low, high, away["error_m"].to_numpy(), away["sigma_m"].to_numpy())
            counts = {k: int(((d >= low) & (d < high)).sum()) for k, d in below.items()}
            rows.append(
                sums_of(name, low, high, mine["error_m"].to_numpy(), mine["sigma_m"].to_numpy())
                | {f"off_{key}": apart[key] for key in SUMS}
                | {
                    "measured": int((mine["distance_m"] <= NEAR_M).sum()),
                    "soundings": counts["sounding"],
                    "sheet": counts["light sheet"],
                }
            )
        places.append(cells.assign(what=f"cell, {name}"))
        if points is not None:
            data = bed.data[bed.data["source"] != "bank"]
            places.append(data[["east_m", "north_m", "up_m"]].assign(what=data["source"]))
    t = river.cloud.trajectory
    track = pd.DataFrame(t.position_wcs_m[t.valid][::10], columns=["east_m", "north_m", "up_m"])
    places.append(track.assign(what="track"))
    river.logs.remove()
    return pd.DataFrame(rows).assign(seed=seed), pd.concat(places, ignore_index=True)


def by_depth(squares: pd.DataFrame, level: float = 0.95) -> pd.DataFrame:
    """Errors by class of depth over all surveys, with and without the light sheet.

    Returns
    -------
    table : survey, number (of surveys), from_m, to_m, measured (share of the cells), soundings, sheet
        (data of each kind in a survey), the columns of `thalweg_lab.studies.bed_study.verdict_of`, and
        n, ratio, normalised square and share outside of cells farther than `BANK_M` from the banks.
    """
    rows = []
    for name in SURVEYS:
        for low, high in [(0.0, np.inf), *pairwise(CLASSES_M)]:
            mine = squares[
                (squares["quantity"] == name) & (squares["from_m"] >= low) & (squares["to_m"] <= high)
            ]
            if not mine["n"].sum():
                continue
            head = {
                "survey": name,
                "number": mine["seed"].nunique(),
                "from_m": low,
                "to_m": high,
                "measured": float(mine["measured"].sum() / mine["n"].sum()),
                "soundings": float(mine["soundings"].sum() / mine["seed"].nunique()),
                "sheet": float(mine["sheet"].sum() / mine["seed"].nunique()),
            }
            n, observed, predicted, normalised, outside = mine[[f"off_{key}" for key in SUMS]].sum()
            apart: dict[str, float] = {"n_off_banks": int(n)}
            if n:
                apart |= {
                    "ratio_off_banks": float(np.sqrt(predicted / observed)),
                    "normalised_square_off_banks": float(normalised / n),
                    "outside_95_off_banks": float(outside / n),
                }
            rows.append(head | verdict_of(mine, level) | apart)
    return pd.DataFrame(rows)


def _rows(seed: Seed) -> Tables:
    squares, places = surveyed(seed.number, seed.folder)
    first = seed.number == int(seed.sizes["first_seed"])
    return {"squares": squares} | ({"places": places} if first else {})


def _results(tables: Tables, files: Sequence[Path]) -> Mapping[str, Result]:
    table = by_depth(tables["squares"])
    figure = joint_river_figure(tables["places"], table)
    return {"by_depth": table, "picture": lambda path: save(figure, path)}


STUDY: Final = Study(rows=_rows, results=_results)
