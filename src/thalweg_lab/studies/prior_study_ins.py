"""What wrong presumptions of the errors do to the trajectory by INS and GNSS, and to the lidar's own noise.

The lidar of the digital twin records a reach once a seed; INS and receiver then err in each variant of
`thalweg_lab.studies.prior_study_navigation` as that says. The trajectory is made with the sigmas as
stated (``presumed``) and with those that overlapping points of the lidar show (``estimated``, see
`thalweg.lidar.overlap`). The judge is the normalised square of the pose's error against the truth.

Of the lidar's noise, variants state too small and too large values; their normalised square is the true
variance over the predicted one.
"""

import logging
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF
from thalweg.ingest.anpp.reader import read_anpp
from thalweg.ingest.tracks.rtklib_pos import read_pos
from thalweg.ingest.velodyne.reader import LidarClock, LidarOptions, scan_lidar
from thalweg.lidar.mount import Mount
from thalweg.lidar.overlap import error_model_of_log
from thalweg.navigation.ins_gnss.error_model import ErrorModel
from thalweg.navigation.ins_gnss.trajectory import build_trajectory
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.instruments.gnss import simulate_gnss
from thalweg_lab.instruments.ins import simulate_ins
from thalweg_lab.studies.outage import pose_errors, unit_errors
from thalweg_lab.studies.prior_study_navigation import (
    MODELS,
    QUANTITIES,
    STEP_S,
    STUDENT,
    VARIANTS,
    Processed,
    Variant,
    judged,
    slow_heading_rad,
)
from thalweg_lab.studies.survey import Logs, log_settings, record, survey_settings
from thalweg_lab.voyage.motion import Motion
from thalweg_lab.voyage.voyage import Voyage

SURVEY: Final[dict[str, Any]] = {
    "size": "tiny", "duration_s": 60.0, "boat": {"speed_mps": 1.5, "turn_rate_degps": 20.0},
    "ins": {"attitude_time_s": 20.0}, "gnss": {"correlation_time_s": 10.0},
}  # fmt: skip
"""Section ``twin`` of the surveys: plants, stones, a building, mirror images; errors last as in T 2.2.1."""

BEAMS: Final[Mapping[str, Mapping[str, float]]] = MappingProxyType({
    "component_150": {"sigma_component_m": 1 / 1.5}, "component_67": {"sigma_component_m": 1.5},
    "divergence_half": {"divergence_mrad": 2.0}, "divergence_double": {"divergence_mrad": 0.5},
})  # fmt: skip
"""Variants of the lidar's noise: factors on the stated values; ``component_150``: truly 1.5 times stated."""


def run(seed: int, folder: Path, variants: tuple[str, ...] = (*VARIANTS, *BEAMS)) -> pd.DataFrame:
    """All variants of one survey.

    Parameters
    ----------
    seed : of the survey.
    folder : for its logs, which are deleted again.
    variants : names of `VARIANTS` and `BEAMS`.

    Returns
    -------
    Rows as of `thalweg_lab.studies.prior_study_navigation.run`, chains ``ins`` and ``lidar_noise``.
    """
    logging.getLogger("thalweg").setLevel(logging.ERROR)
    settings = survey_settings(SURVEY, seed=seed)
    logs = record(settings, folder / f"prior_{seed}")
    clock = scan_lidar([logs.pcap], LidarOptions(**settings["lidar"])).clock
    motion = Voyage(logs.twin, seed)
    rows = []
    for name in variants:
        about = {"chain": "ins" if name in VARIANTS else "lidar_noise", "variant": name, "seed": seed}
        if name in VARIANTS:
            stated, epochs = _trajectory(logs, VARIANTS[name], seed, motion)
            model = _error_model(logs, clock, stated, epochs, {})
            for kind, trajectory in zip(MODELS, (stated, model.apply(stated, _lever(logs))), strict=True):
                found = _against_truth(trajectory, motion)
                rows += [
                    {**about, "model": kind, "quantity": quantity, **judged(found, part)}
                    for quantity, part in QUANTITIES.items()
                ]
        else:
            stated, epochs = _trajectory(logs, VARIANTS["base"], seed, motion)
            model = _error_model(logs, clock, stated, epochs, BEAMS[name])
            ((key, factor),) = BEAMS[name].items()
            part = "component" if key == "sigma_component_m" else "footprint"
            for kind, taken in zip(MODELS, (1.0, model.estimates[part].predictive), strict=True):
                rows.append({
                    **about, "model": kind, "quantity": part, "nees": (factor * taken) ** -2, "n": 1,
                    "coverage_95": np.nan,
                })  # fmt: skip
    logs.remove()
    return pd.DataFrame(rows)


def _lever(logs: Logs) -> ArrayF:
    return np.asarray(logs.settings["mounts"]["antenna"]["lever_ics_m"], dtype=np.float64)


def _trajectory(logs: Logs, variant: Variant, seed: int, motion: Motion) -> tuple[Trajectory, ArrayF]:
    """Trajectory of instruments that err as the variant says, with the usual stated sigmas; its epochs."""
    twin, spec = logs.settings["twin"], variant.spec(SURVEY["duration_s"]).twin
    rates = {key: {"rate_hz": twin[key]["rate_hz"]} for key in ("ins", "gnss")}
    config = TwinConfig(**{**twin, **{k: {**twin[k], **spec[k], **rates[k]} for k in ("ins", "gnss")}})
    anpp, pos = logs.folder / "variant.anpp", logs.folder / "variant.pos"
    simulate_ins(config, seed, logs.frame, anpp, motion=motion)
    simulate_gnss(
        config, seed, logs.frame, logs.folder / "variant.sbp", pos, scene=logs.scene, motion=motion,
        lever_ics_antenna_m=logs.true_mounts["antenna"]["lever_ics_m"],
    )  # fmt: skip
    states, positions = read_anpp([anpp]).states.copy(), read_pos([pos]).positions.copy()
    for name in ("roll", "pitch", "heading"):
        states[f"sigma_{name}_rad"] /= variant.size
    sigmas = [f"sigma_{name}_m" for name in ("east", "north", "up")]
    positions[sigmas] /= variant.size * (np.sqrt(1 - variant.white_share) if variant.student else 1.0)
    if variant.student:
        noise = unit_errors(generator(seed, "heavy tails"), (len(positions), 3), STUDENT)
        place = logs.frame.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"])
        moved = place + np.sqrt(variant.white_share) * positions[sigmas].to_numpy() * noise
        lat, lon, height = logs.frame.to_geodetic(moved)
        positions = positions.assign(lat_deg=lat, lon_deg=lon, h_ell_m=height)
    if variant.heading:
        states["heading_rad"] += slow_heading_rad(variant.heading, seed, states["t_gps_s"].to_numpy())
    s = logs.settings
    keys = ("accept_fixes", "max_gap_s", "max_attitude_gap_s", "interpolation")
    trajectory, _ = build_trajectory(
        positions, states, logs.frame, lever_ics_antenna_m=_lever(logs),
        sigma_lever_m=s["mounts"]["antenna"]["sigma_lever_m"],
        sigma_attitude_rad=np.deg2rad([s["ins"][f"sigma_{a}_deg"] for a in ("roll", "pitch", "heading")]),
        **{key: s["orientation"][key] for key in keys},
    )  # fmt: skip
    return trajectory, positions["t_gps_s"].to_numpy()


def _error_model(
    logs: Logs, clock: LidarClock, stated: Trajectory, epochs_s: ArrayF, beam: Mapping[str, float]
) -> ErrorModel:
    """What the survey's lidar log says of the errors, with stated values of the beam times ``beam``."""
    s = logs.settings
    accuracy = {key: value * beam.get(key, 1.0) for key, value in s["lidar_accuracy"].items()}
    how = log_settings({**s, "lidar_accuracy": accuracy}, Mount.from_section(s["mounts"]["lidar"]))
    return error_model_of_log(
        [logs.pcap], LidarOptions(**s["lidar"]), clock, stated, how, positions_t_gps_s=epochs_s,
        lever_ics_antenna_m=_lever(logs), settings=s["orientation"]["error_model"],
    )  # fmt: skip


def _against_truth(trajectory: Trajectory, motion: Motion) -> Processed:
    first, last = trajectory.span()
    at = np.arange(first + 1.0, last - 1.0, STEP_S)
    position, R, inside = trajectory.at(at)
    return Processed(error=pose_errors(position, R, motion, at)[inside], cov=trajectory.cov_at(at)[inside])
