"""Riverbeds of many surveys against the twin's bed: are the sigmas consistent, and are mistakes noticed?

Each seed is a survey of its own: river, poses, mounts, direction of the beam, latency, temperature of the
water and every sounding err anew. Its raw logs (lidar, INS, receiver, echo sounder) become soundings, banks,
water level and a kriged bed by the functions of the rules, once as they should be and once with each mistake
of a list. Errors are taken in all cells of the bed and, for comparison, at the soundings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from pyproj import CRS

from thalweg.bathymetry import (
    SIDES,
    Banks,
    Bed,
    FlowLine,
    Observations,
    Transducer,
    choose_model,
    course,
    estimate_slow_errors,
    flow_of_survey,
    krige_bed,
    level_water,
    locate_soundings,
    methods,
    shore_points,
    validate_bed,
)
from thalweg.core import ArrayB, ArrayF
from thalweg.ingest.nmea import read_nmea
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Bathymetry, EchoSounder
from thalweg_lab.random_numbers import gauss_markov, generator
from thalweg_lab.reach import River as Reach
from thalweg_lab.settings import TwinConfig
from thalweg_lab.studies.study import Study
from thalweg_lab.studies.survey import BARE, MOUNTS, Logs, Survey, process, record, survey_settings
from thalweg_lab.truth import DISTANCES_M, ratio_of_surveys, true_bed_m

TWIN: Final[dict[str, Any]] = {
    "size": "tiny",
    "duration_s": 80.0,
    "scene": BARE | {"length_m": 90.0, "grid_m": 0.3, "water_fall_m_per_km": 0.5},
    "boat": {"speed_mps": 1.2, "bank_distance_m": 3.0, "turn_rate_degps": 30.0, "line_spacing_m": 8.0},
    "ins": {"attitude_time_s": 5.0},
    "gnss": {"correlation_time_s": 8.0, "sigma_m": (0.03, 0.03, 0.05)},
    "lidar": {"mirror_ghosts": False, "own_hull": False, "divergence_mrad": 0.0},
    "effects": {"lost_packets": 0.95},
    "echo": {"beam_deg": 5.0, "dead_zone_m": 0.2, "zeros": True, "second_echo_share": 0.01,
             "spike_share": 0.01, "no_bottom_share": 0.01, "turn_dropout_share": 0.2,
             "temperature_sentences": False},
}  # fmt: skip
"""Section ``twin``: 80 s on 75 m of a bare river 22 m wide. Errors of positions last 8 s, so that a survey
holds several; 19 of 20 packets of the lidar are lost to save time, the banks need no more."""

ECHO_SOUNDER: Final[dict[str, Any]] = {
    "set_sound_speed_mps": 1500.0,
    "water_temperature_c": 12.0,
    "latency_s": 0.3,
    "sigma_tilt_deg": 1.0,
    "sigma_latency_s": 0.05,
    "sigma_temperature_c": 1.0,
    "sigma_sound_speed": 0.002,
}
"""Section ``echo_sounder``: what the owner of the boat knows. The instrument differs by these sigmas."""

STATION_M: Final = 2.0
"""Length of a section of the river."""

PATTERNS: Final = ("zigzag", "sections")
"""Courses in turn, by seed."""

LEGS_M: Final = (7.5, 15.0, 30.0, 60.0)
"""River a leg of the zigzag, or from section to section (P1 4.2)."""
_REACH_M: Final = 180.0
_PING_M: Final = 0.3
_NOISE_M: Final = 0.02
_SLOW_M: Final = 0.03
_SLOW_S: Final = 8.0
"""Soundings of a pattern: every 0.3 m at a metre a second, with noise and with errors that last."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedMistake:
    """Something left out in the processing.

    Parameters
    ----------
    name : in tables.
    echo_sounder : keys of that section that are not as the owner knows them.
    independent : slow errors count as new in each ping.
    """

    name: str
    echo_sounder: Mapping[str, Any] = field(default_factory=dict)
    independent: bool = False


NONE: Final = PlantedMistake(name="none")
MISTAKES: Final = (
    PlantedMistake(name="speed of sound left out", echo_sounder={"set_sound_speed_mps": None}),
    PlantedMistake(name="lag left out", echo_sounder={"latency_s": 0.0}),
    PlantedMistake(name="slow errors as independent ones", independent=True),
)
"""Mistakes that a check of predicted against observed errors must notice."""


def campaign_of(seed: int) -> dict[str, Any]:
    """Settings of the survey of a seed: course in turn, and an instrument that differs from what is known."""
    rng = generator(seed, "bed study")
    known = EchoSounder(**ECHO_SOUNDER)
    tilt = rng.normal(0.0, known.sigma_tilt_deg, 2)
    latency, warmth, speed = rng.standard_normal(3).tolist()
    true = {
        "tilt_deg": tuple(tilt.tolist()),
        "latency_s": max(known.latency_s + known.sigma_latency_s * latency, 0.0),
        "water_temperature_c": ECHO_SOUNDER["water_temperature_c"] + known.sigma_temperature_c * warmth,
        "assumed_sound_speed_mps": ECHO_SOUNDER["set_sound_speed_mps"]
        / (1 + known.sigma_sound_speed * speed),
    }
    twin = dict(TWIN) | {
        "boat": TWIN["boat"] | {"pattern": PATTERNS[seed % len(PATTERNS)]},
        "echo": TWIN["echo"] | true,
    }
    mounts = MOUNTS | {"echo_sounder": {"lever_ics_m": (0.2, 0.0, 0.3)}}
    return survey_settings(twin, seed=seed, mounts=mounts, echo_sounder=ECHO_SOUNDER)


@dataclass(frozen=True, slots=True, kw_only=True)
class River:
    """What a survey knows before its soundings.

    Parameters
    ----------
    logs : raw logs.
    cloud : trajectory, and points of the banks.
    correlation : how errors of the poses last.
    """

    logs: Logs
    cloud: Survey
    correlation: PoseCorrelation


def river_of(logs: Logs) -> River:
    """Poses and points of the banks of raw logs, with the sigmas and correlation times of the instruments."""
    twin, settings = logs.twin, Bathymetry(**logs.settings["bathymetry"])
    correlation = PoseCorrelation(
        position_s=settings.position_time_s or twin.gnss.correlation_time_s,
        attitude_s=twin.ins.attitude_time_s,
        white_share=twin.gnss.white_share,
        receiver_s=1.0 / twin.gnss.rate_hz,
    )
    return River(logs=logs, cloud=process(logs), correlation=correlation)


def bed_of(
    river: River, mistake: PlantedMistake = NONE, *, strip: pd.DataFrame | None = None
) -> tuple[Bed, pd.DataFrame, Banks]:
    """Kriged bed, soundings and banks of a survey.

    Parameters
    ----------
    river : of the survey.
    mistake : what is left out.
    strip : points of the light sheet, kind ``bed_points``.
    """
    s, trajectory = river.logs.settings, river.cloud.trajectory
    echo = EchoSounder(**(s["echo_sounder"] | dict(mistake.echo_sounder)))
    settings, water_line = Bathymetry(**s["bathymetry"]), s["filters"]["water_line_ics_m"]
    if river.logs.nmea is None:
        raise ValueError("a survey without an echo sounder: record it with echo=True")
    log = read_nmea([river.logs.nmea])
    soundings, facts = locate_soundings(
        log.depths,
        trajectory,
        river.correlation,
        Transducer.of(s["mounts"]["echo_sounder"], None, echo),
        echo,
        settings,
        water_line_ics_m=water_line,
        logged_temperature_c=log.report.details.get("water_temperature_c"),
        sigma_time_s=log.report.details.get("sigma_depth_time_s", 0.0),
    )
    soundings, slow_time_s, _ = estimate_slow_errors(soundings, facts["position_time_s"])
    if mistake.independent:
        both = np.hypot(soundings["sigma_white_m"], soundings["sigma_slow_m"])
        soundings = soundings.assign(sigma_white_m=both, sigma_slow_m=0.0)
    track = trajectory.position_wcs_m[trajectory.valid]
    banks, level = flow_of_survey(
        track[:, :2],
        shore_points([river.cloud.points], float(np.median(track[:, 2])) - water_line),
        lambda axis: level_water(
            trajectory,
            river.correlation,
            lambda places: axis.to_flow(places)[0],
            water_line_ics_m=water_line,
            sigma_datum_m=settings.sigma_datum_m,
        ),
        settings,
    )
    bed = krige_bed(
        soundings,
        banks.line,
        banks,
        level,
        strip,
        frame=river.logs.frame,
        crs=CRS.from_user_input(s["campaign"]["crs"]),
        echo=echo,
        settings=settings,
        slow_time_s=slow_time_s,
        seed=river.logs.seed,
    )
    return bed, soundings, banks


# ---------------------------------------------------------------- errors


def known_cells(bed: Bed, river: River) -> tuple[ArrayB, ArrayF]:
    """Which cells (n,) of a bed are known, and their places (k, 2) in wcs."""
    known = np.isfinite(bed.up_m)
    frame, crs = river.logs.frame, CRS.from_user_input(river.logs.settings["campaign"]["crs"])
    places = np.column_stack([bed.grid.centres_m()[known], np.full(known.sum(), frame.h_ell_m)])
    return known, frame.from_map(places, crs)[:, :2]


def squares_of(bed: Bed, soundings: pd.DataFrame, river: River) -> pd.DataFrame:
    """Sums of squared errors and of predicted variances of a survey.

    Returns
    -------
    table : a row for the soundings, and one a class of distance to the nearest datum of the bed's cells;
        quantity, from_m, to_m, n, observed_m2, predicted_m2, normalised (sum), outside (95 %), error_m (sum).
    """
    used = soundings[soundings["used"]]
    parts = used[["sigma_white_m", "sigma_slow_m", "sigma_common_m"]].to_numpy(np.float64)
    error = used["up_m"].to_numpy() - true_bed_m(
        river.logs.scene, used[["east_m", "north_m"]].to_numpy(np.float64)
    )
    rows = [sums_of("soundings", 0.0, np.inf, error, np.linalg.norm(parts, axis=1))]
    known, places = known_cells(bed, river)
    error = bed.up_m[known] - true_bed_m(river.logs.scene, places)
    sigma = np.hypot(bed.sigma_m[known], bed.sigma_common_m[known])
    away = bed.distance_m[known]
    for low, high in pairwise(DISTANCES_M):
        of = (away >= low) & (away < high)
        rows.append(sums_of("bed", low, high, error[of], sigma[of]))
    return pd.DataFrame(rows)


def sums_of(quantity: str, low: float, high: float, error: ArrayF, sigma: ArrayF) -> dict[str, Any]:
    """A row of `squares_of`: sums over the errors and sigmas (n,) of a class."""
    there = np.isfinite(error)
    e, s = error[there], sigma[there]
    return {
        "quantity": quantity,
        "from_m": low,
        "to_m": high,
        "n": len(e),
        "observed_m2": float(np.sum(e**2)),
        "predicted_m2": float(np.sum(s**2)),
        "normalised": float(np.sum((e / s) ** 2)),
        "outside": int(np.sum(np.abs(e) > 1.96 * s)),
        "error_m": float(np.sum(e)),
    }


def sections_of(bed: Bed, banks: Banks, river: River) -> pd.DataFrame:
    """Width of the water and mean height of the bed below it along the river: s_m, width_m, mean_bed_m."""
    known, places = known_cells(bed, river)
    along = banks.line.to_flow(places)[0]
    shore = bed.data[bed.data["source"] == "bank"].sort_values("s_m")
    below = bed.up_m[known] - np.interp(along, shore["s_m"], shore["up_m"])
    mean = pd.Series(below).groupby(np.floor(along / STATION_M)).agg(["mean", "size"])
    middle = STATION_M * (mean.index.to_numpy(np.float64) + 0.5)
    width = np.sum(banks.half_widths_m(middle), axis=0)
    # first and last station are cut off by the end of the bed
    rows = pd.DataFrame({"s_m": middle, "width_m": width, "mean_bed_m": mean["mean"].to_numpy()})[1:-1]
    return rows[np.isfinite(rows["width_m"])]


def surveyed(seed: int, folder: Path, mistakes: Sequence[PlantedMistake]) -> pd.DataFrame:
    """Errors of one survey, processed with each of the mistakes: rows of `squares_of` with ``mistake``."""
    logs = record(campaign_of(seed), folder / f"seed_{seed}", echo=True)
    river = river_of(logs)
    rows = []
    for mistake in mistakes:
        bed, soundings, _ = bed_of(river, mistake)
        rows.append(squares_of(bed, soundings, river).assign(mistake=mistake.name))
    logs.remove()
    return pd.concat(rows, ignore_index=True).assign(seed=seed, pattern=logs.twin.boat.pattern)


def by_pattern(seed: int) -> pd.DataFrame:
    """Errors of one river's bed from soundings in patterns of several lengths of a leg.

    The river is the twin's; soundings are drawn on its true bed, without raw logs. Shorelines are data; drift
    and kind of covariance are stated to save time, its ranges are chosen.

    Returns
    -------
    table : pattern, leg_m, columns of `sums_of`, distance_m2: sum of squared errors of the same cells by
        elliptical inverse distance.
    """
    scene = TWIN["scene"] | {"length_m": _REACH_M + 40.0}
    river = Reach(TwinConfig.of_size("tiny", scene=scene).scene, seed)
    settings, ends = Bathymetry(model="matern32", drift="section_width"), (-_REACH_M / 2, _REACH_M / 2)
    shore_s, sign = (a.ravel() for a in np.meshgrid(np.arange(*ends, STATION_M), list(SIDES.values())))
    shore = pd.DataFrame({"s_m": shore_s, "n_m": sign * river.half_width(shore_s)})
    shore["side"] = np.repeat(list(SIDES), len(shore) // 2)
    axis = np.arange(ends[0] - 10, ends[1] + 10)
    banks = Banks(table=shore, line=FlowLine.through(river.to_wcs(axis, np.zeros(len(axis)))))
    inner = np.arange(ends[0] + 15, ends[1] - 15)
    s, q = (a.ravel() for a in np.meshgrid(inner, np.linspace(-0.95, 0.95, 20)))
    cells = np.column_stack([s, q * river.half_width(s)])
    true, off = river.height(*cells.T), TWIN["boat"]["bank_distance_m"]
    rows = []
    for pattern, leg in product(PATTERNS, LEGS_M):
        rng = generator(seed, f"pattern {pattern} {leg}")
        corners = course(banks, pattern, leg, off, (ends[0], float(shore_s.max())))
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
        way = np.arange(0.0, along[-1], _PING_M)
        track = np.column_stack([np.interp(way, along, corners[:, k]) for k in (0, 1)])
        slow = gauss_markov(rng, len(way), _PING_M, _SLOW_M, _SLOW_S)
        n, shores = len(way), len(shore)
        data = Observations(
            s_m=np.append(track[:, 0], shore["s_m"]),
            n_m=np.append(track[:, 1], shore["n_m"]),
            height_m=np.append(
                river.height(*track.T) + slow + _NOISE_M * rng.standard_normal(n), np.zeros(shores)
            ),
            sigma_white_m=np.append(np.full(n, _NOISE_M), np.full(shores, 0.03)),
            sigma_slow_m=np.append(np.full(n, _SLOW_M), np.zeros(shores)),
            t_s=np.append(way, np.full(shores, np.nan)),
            line=np.append(np.searchsorted(along, way, side="right") - 1, np.full(shores, -2)),
        )
        model = choose_model(data, banks.half_widths_m, settings, slow_time_s=_SLOW_S, seed=seed)
        height, sigma = model.predict(data, cells, neighbours=settings.neighbours)
        other = methods(model, settings)["inverse distance, elliptical"](data, cells)[0]
        rows.append(
            {"pattern": pattern, "leg_m": leg}
            | sums_of(pattern, leg, leg, height - true, sigma)
            | {"distance_m2": float(np.sum((other - true) ** 2))}
        )
    return pd.DataFrame(rows)


def asked(seed: int, folder: Path) -> dict[str, pd.DataFrame]:
    """What one survey says of P1's findings.

    Returns
    -------
    methods : left-out lines predicted by several interpolators: method, n, squares_m2.
    sections : see `sections_of`.
    patterns : see `by_pattern`.
    """
    logs = record(campaign_of(seed), folder / f"seed_{seed}", echo=True)
    river = river_of(logs)
    bed, _, banks = bed_of(river)
    settings = Bathymetry(**logs.settings["bathymetry"])
    found = validate_bed(bed.data, bed.model, banks.half_widths_m, settings)[2]
    found["squares_m2"] = found["n"] * found["rmse_m"] ** 2
    sections = sections_of(bed, banks, river)
    logs.remove()
    tables = {"methods": found[["method", "n", "squares_m2"]], "sections": sections}
    tables["patterns"] = by_pattern(seed)
    return {name: table.assign(seed=seed) for name, table in tables.items()}


def patterns(rows: pd.DataFrame) -> pd.DataFrame:
    """Errors by pattern and length of a leg over all rivers.

    Returns
    -------
    table : pattern, leg_m, rivers, columns of `verdict_of`, rmse_distance_m: by elliptical inverse distance.
    """
    return pd.DataFrame(
        {"pattern": pattern, "leg_m": leg, "rivers": of["seed"].nunique()}
        | verdict_of(of, 0.95)
        | {"rmse_distance_m": float(np.sqrt(of["distance_m2"].sum() / of["n"].sum()))}
        for (pattern, leg), of in rows.groupby(["pattern", "leg_m"], sort=False)
    )


def findings(methods: pd.DataFrame, sections: pd.DataFrame) -> pd.DataFrame:
    """What P1 found, asked of all surveys together.

    Returns
    -------
    table : finding, value, sigma (jackknife over surveys), surveys. RMSE of left-out lines by each method
        over that of kriging; correlation of the width of the water with the mean height of the bed.
    """

    def ratio(of: pd.DataFrame) -> float:
        """RMSE over that of kriging."""
        rms = of.groupby("method")[["squares_m2", "n"]].sum()
        mean = rms["squares_m2"] / rms["n"]
        return float(np.sqrt(mean[mean.index != "kriging"].iloc[0] / mean["kriging"]))

    def correlation(of: pd.DataFrame) -> float:
        """Over all sections."""
        return float(np.corrcoef(of["width_m"], of["mean_bed_m"])[0, 1])

    asked = {
        f"{name} over kriging": (ratio, methods[methods["method"].isin([name, "kriging"])])
        for name in methods["method"].unique()
        if name != "kriging"
    }
    asked["width with mean height of the bed"] = (correlation, sections)
    rows = []
    for name, (value, of) in asked.items():
        seeds = of["seed"].unique()
        without = np.array([value(of[of["seed"] != seed]) for seed in seeds])
        sigma = np.sqrt((len(seeds) - 1) * np.mean((without - without.mean()) ** 2))
        rows.append({"finding": name, "value": value(of), "sigma": float(sigma), "surveys": len(seeds)})
    return pd.DataFrame(rows)


def verdicts(rows: pd.DataFrame, *, level: float = 0.95) -> pd.DataFrame:
    """Predicted against observed errors over all surveys.

    Parameters
    ----------
    rows : of all surveys, see `surveyed`.
    level : of the band of each quantity, and of those of all classes of distance together (Bonferroni).

    Returns
    -------
    table : a row a mistake, quantity and class (all cells first): surveys (effective), n, rmse_observed_m,
        rmse_predicted_m, ratio with its band low, high, inside, normalised_square, outside_95 (share),
        bias_m, consistent: within 0.85 to 1.15 and inside its band.
    """
    out = []
    for mistake in rows["mistake"].unique():
        for quantity in rows["quantity"].unique():
            mine = rows[(rows["mistake"] == mistake) & (rows["quantity"] == quantity)]
            classes = sorted(set(zip(mine["from_m"], mine["to_m"], strict=True)))
            whole = [(0.0, np.inf, mine, level)]
            each = 1 - (1 - level) / len(classes)
            apart = [
                (low, high, mine[(mine["from_m"] == low) & (mine["to_m"] == high)], each)
                for low, high in classes
            ]
            out += [
                {"mistake": mistake, "quantity": quantity, "from_m": low, "to_m": high} | verdict_of(of, at)
                for low, high, of, at in whole + (apart if len(classes) > 1 else [])
                if of["n"].sum()
            ]
    return pd.DataFrame(out)


def verdict_of(rows: pd.DataFrame, level: float) -> dict[str, Any]:
    """Predicted against observed errors of one class over all surveys.

    Parameters
    ----------
    rows : of `sums_of`, with the ``seed`` of each survey.
    level : of the band.

    Returns
    -------
    columns : surveys to consistent of `verdicts`.
    """
    sums = rows.groupby("seed")[
        ["n", "observed_m2", "predicted_m2", "normalised", "outside", "error_m"]
    ].sum()
    o, p = sums["observed_m2"].to_numpy(np.float64), sums["predicted_m2"].to_numpy(np.float64)
    ratio, band_low, band_high, surveys = ratio_of_surveys(o, p, level=level)
    n = int(sums["n"].sum())
    inside = bool(band_low < ratio < band_high)
    return {
        "surveys": surveys,
        "n": n,
        "rmse_observed_m": float(np.sqrt(o.sum() / n)),
        "rmse_predicted_m": float(np.sqrt(p.sum() / n)),
        "ratio": ratio,
        "low": band_low,
        "high": band_high,
        "inside": inside,
        "normalised_square": float(sums["normalised"].sum() / n),
        "outside_95": float(sums["outside"].sum() / n),
        "bias_m": float(sums["error_m"].sum() / n),
        "consistent": inside and 0.85 <= ratio <= 1.15,
    }


STUDY: Final = Study(
    rows=lambda seed: {"squares": surveyed(seed.number, seed.folder, (NONE, *MISTAKES))},
    results=lambda tables, files: {"verdicts": verdicts(tables["squares"])},
)
FINDINGS: Final = Study(
    rows=lambda seed: asked(seed.number, seed.folder),
    results=lambda tables, files: {
        "findings": findings(tables["methods"], tables["sections"]),
        "patterns": patterns(tables["patterns"]),
    },
)
