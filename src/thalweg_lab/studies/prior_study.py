"""What wrong presumptions of the errors do to sigmas, and what estimates mend of that, for all chains."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.core import ArrayF, LocalFrame, Rigid, Trajectory
from thalweg.ingest import LidarClock, LidarOptions
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.registry import lidar_reader
from thalweg.ingest.tracks import read_pos
from thalweg.lidar import error_model_of_log
from thalweg.navigation.camera import CloudSettings, camera_trajectory
from thalweg.navigation.fusion import FusionSettings
from thalweg.navigation.ins_gnss import ErrorModel
from thalweg_lab.instruments import simulate_gnss, simulate_ins
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinConfig
from thalweg_lab.studies.outage import (
    FRAME,
    Recorded,
    VoyageSpec,
    errors_at,
    fuse,
    make_survey,
    pose_errors,
    unit_errors,
)
from thalweg_lab.studies.study import Seed, Study, Tables, normalised_squares
from thalweg_lab.studies.survey import Logs, ins_trajectory, log_settings, record, survey_settings
from thalweg_lab.truth import ratio_of_surveys
from thalweg_lab.voyage import Motion, Voyage

MODELS: Final = ("presumed", "estimated")

SURVEY: Final[dict[str, Any]] = {
    "size": "tiny",
    "duration_s": 60.0,
    "boat": {"speed_mps": 1.5, "turn_rate_degps": 20.0},
    "ins": {"attitude_time_s": 20.0},
    "gnss": {"correlation_time_s": 10.0},
}
"""Section ``twin`` of the surveys: plants, stones, a building, mirror images; errors last as in T 2.2.1."""

CHAINS: Final = ("fused", "camera")
QUANTITIES: Final[Mapping[str, slice]] = MappingProxyType(
    {"position": slice(0, 3), "attitude": slice(3, 6), "pose": slice(0, 6)}
)
DURATION_S: Final = 120.0
STEP_S: Final = 0.37
"""Between the moments that are judged: off the nodes too."""
GOAL: Final = (0.8, 1.25)
"""Mean normalised squares that count as right."""
SLOW_HEADING_DEG: Final = 0.3
SLOW_HEADING_TIME_S: Final = 300.0
STUDENT: Final = 3.0
WHITE: Final = 0.25
"""Share of white noise in the twin's positions, if nothing is said."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """How the instruments err otherwise than the processing presumes.

    Parameters
    ----------
    times : factor of the correlation times of attitude, velocity and positions.
    white_share : of the positions' variance.
    size : factor of all errors but mount and clock; the stated sigmas stay.
    student : positions' white noise, image poses and times have Student's distribution of 3 degrees.
    heading : ``constant``, ``slow`` (300 s) or no error that no sigma contains.
    """

    times: float = 1.0
    white_share: float = WHITE
    size: float = 1.0
    student: bool = False
    heading: str = ""

    def spec(self, duration_s: float) -> VoyageSpec:
        """The survey of the twin; with heavy tails white noise of the positions is not in it."""
        usual = VoyageSpec()
        slow = np.sqrt(1 - self.white_share) if self.student else 1.0
        ins = {
            "rate_hz": 10.0,
            "attitude_time_s": 20.0 * self.times,
            "velocity_time_s": 10.0 * self.times,
            "sigma_velocity_mps": 0.05 * self.size,
            **{f"sigma_{a}_deg": s * self.size for a, s in (("roll", 0.1), ("pitch", 0.1), ("heading", 0.2))},
        }
        gnss = {
            "rate_hz": 5.0,
            "correlation_time_s": 10.0 * self.times,
            "white_share": 0.0 if self.student else self.white_share,
            "sigma_m": tuple(float(s * self.size * slow) for s in (0.02, 0.02, 0.03)),
        }
        size = self.size
        return VoyageSpec(
            duration_s=duration_s,
            twin={"ins": ins, "gnss": gnss},
            jitter_s=usual.jitter_s * size,
            sigma_image_m=tuple(s * size for s in usual.sigma_image_m),  # type: ignore[arg-type]
            sigma_image_deg=tuple(s * size for s in usual.sigma_image_deg),  # type: ignore[arg-type]
            student=STUDENT if self.student else 0.0,
        )


VARIANTS: Final[Mapping[str, Variant]] = MappingProxyType(
    {
        "base": Variant(),
        "times_fifth": Variant(times=0.2),
        "times_fivefold": Variant(times=5.0),
        "white_0": Variant(white_share=0.0),
        "white_60": Variant(white_share=0.6),
        "stated_half": Variant(size=2.0),
        "stated_double": Variant(size=0.5),
        "heavy_tails": Variant(student=True),
        "heading_constant": Variant(heading="constant"),
        "heading_slow": Variant(heading="slow"),
    }
)


def run_ins(seed: int, folder: Path, variants: Sequence[str] = tuple(VARIANTS)) -> pd.DataFrame:
    """All variants of one survey.

    Parameters
    ----------
    seed : of the survey.
    folder : for its logs, which are deleted again.
    variants : names of `VARIANTS`.

    Returns
    -------
    Rows as of `thalweg_lab.studies.prior_study.run_navigation`, chain ``ins``.
    """
    settings = survey_settings(SURVEY, seed=seed)
    logs = record(settings, folder / f"prior_{seed}")
    clock = lidar_reader([logs.pcap], LidarOptions(**settings["lidar"])).scan().clock
    motion = Voyage(logs.twin, seed)
    rows = []
    for name in variants:
        stated, epochs = _trajectory(logs, VARIANTS[name], seed, motion)
        estimated = _error_model(logs, clock, stated, epochs).apply(stated, _lever(logs))
        for model, trajectory in zip(MODELS, (stated, estimated), strict=True):
            about = {"chain": "ins", "variant": name, "seed": seed, "model": model}
            rows += _rows(about, _against_truth(trajectory, motion))
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
        config,
        seed,
        logs.frame,
        logs.folder / "variant.sbp",
        pos,
        scene=logs.scene,
        motion=motion,
        lever_ics_antenna_m=logs.true_mounts["antenna"]["lever_ics_m"],
    )
    states, positions = _as_stated(
        variant, seed, read_anpp([anpp]).states, read_pos([pos]).positions, logs.frame
    )
    trajectory = ins_trajectory(logs, positions=positions, states=states)
    return trajectory, positions["t_gps_s"].to_numpy()


def _as_stated(
    variant: Variant, seed: int, states: pd.DataFrame, positions: pd.DataFrame, frame: LocalFrame
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """States and positions with the usual stated sigmas, heavy-tailed noise and an error of the heading."""
    states, positions = states.copy(), positions.copy()
    for name in ("roll", "pitch", "heading"):
        states[f"sigma_{name}_rad"] /= variant.size
    sigmas = [f"sigma_{name}_m" for name in ("east", "north", "up")]
    positions[sigmas] /= variant.size * (np.sqrt(1 - variant.white_share) if variant.student else 1.0)
    if variant.student:
        noise = unit_errors(generator(seed, "heavy tails"), (len(positions), 3), STUDENT)
        place = frame.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"])
        moved = place + np.sqrt(variant.white_share) * positions[sigmas].to_numpy() * noise
        lat, lon, height = frame.to_geodetic(moved)
        positions = positions.assign(lat_deg=lat, lon_deg=lon, h_ell_m=height)
    if variant.heading:
        states["heading_rad"] += slow_heading_rad(variant.heading, seed, states["t_gps_s"].to_numpy())
    return states, positions


def _error_model(logs: Logs, clock: LidarClock, stated: Trajectory, epochs_s: ArrayF) -> ErrorModel:
    """What the survey's lidar log says of the errors."""
    s = logs.settings
    how = log_settings(s, Rigid.from_mount(s["mounts"]["lidar"]))
    return error_model_of_log(
        lidar_reader([logs.pcap], LidarOptions(**s["lidar"])),
        clock,
        stated,
        how,
        positions_t_gps_s=epochs_s,
        lever_ics_antenna_m=_lever(logs),
        settings=s["orientation"]["error_model"],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Processed:
    """Poses of a chain against the truth.

    ``error`` (k, 6) and ``cov`` (k, 6, 6) in wcs.
    """

    error: ArrayF
    cov: ArrayF


def _against_truth(trajectory: Trajectory, motion: Motion) -> Processed:
    first, last = trajectory.span()
    at = np.arange(first + 1.0, last - 1.0, STEP_S)
    position, R, inside = trajectory.at(at)
    return Processed(error=pose_errors(position, R, motion, at)[inside], cov=trajectory.cov_at(at)[inside])


def run_navigation(variant: str, seed: int, *, duration_s: float = DURATION_S) -> pd.DataFrame:
    """Survey and process once.

    Parameters
    ----------
    variant : one of `VARIANTS`.
    seed : of the survey.
    duration_s : of the survey.

    Returns
    -------
    A row a chain, model and quantity: ``chain, variant, model, seed, quantity, nees`` (mean normalised square
    over its components, expected 1), ``n`` moments, ``coverage_95``.
    """
    # what neighbouring images differ by is no news here
    survey = survey_of(VARIANTS[variant], seed, duration_s)
    rows = []
    for model in MODELS:
        for chain, found in processed(survey, estimate=model == "estimated").items():
            rows += _rows({"chain": chain, "variant": variant, "model": model, "seed": seed}, found)
    return pd.DataFrame(rows)


def _rows(about: Mapping[str, Any], found: Processed) -> list[dict[str, Any]]:
    """A row for each quantity of a chain."""
    return [{**about, "quantity": name, **judged(found, part)} for name, part in QUANTITIES.items()]


def survey_of(variant: Variant, seed: int, duration_s: float = DURATION_S) -> Recorded:
    """A survey whose logs state the sigmas that the processing is used to, whatever its errors are."""
    survey = make_survey(seed, variant.spec(duration_s))
    stated, images = 1.0 / variant.size, survey.images
    states, positions = _as_stated(variant, seed, survey.states, survey.positions, FRAME)
    images = replace(
        images, cov_pose_wcs=stated**2 * images.cov_pose_wcs, cov_next=stated**2 * images.cov_next
    ).with_times(images.t_gps_s, stated * images.sigma_t_s)
    return replace(survey, states=states, positions=positions, images=images)


def processed(survey: Recorded, *, estimate: bool) -> dict[str, Processed]:
    """The survey by all chains, with the defaults of a campaign file."""
    at = survey.motion.start_gps_s + np.arange(2.0, survey.motion.config.duration_s - 2.0, STEP_S)
    settings = FusionSettings(estimate_errors=estimate)
    fused = fuse(survey, settings)
    error, cov = errors_at(fused, survey.motion, at)
    out = {"fused": Processed(error=error, cov=cov)}
    by_camera = camera_trajectory(
        survey.images,
        survey.true_T_ics_ccs.with_cov(survey.T_ccs_ics.cov),
        CloudSettings(frames="bridge", estimate_errors=estimate),
        states=survey.states,
        sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
        max_attitude_gap_s=0.1,
    )
    position, R, inside = by_camera.trajectory.at(at)
    out["camera"] = Processed(
        error=pose_errors(position, R, survey.motion, at)[inside], cov=by_camera.trajectory.cov_at(at[inside])
    )
    return out


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of many seeds by chain, variant, model and quantity.

    Columns ``chain, variant, model, quantity, seeds, nees, low, high`` (mean over the seeds and its band of
    95 %, by the spread between them; with one seed there is none), ``coverage_95``, and ``right``, whether
    the mean lies within `GOAL`.
    """
    out = []
    for keys, part in rows.groupby(["chain", "variant", "model", "quantity"], sort=False):
        n, nees = part["n"].to_numpy(np.float64), part["nees"].to_numpy(np.float64)
        mean = float(np.sum(n * nees) / n.sum())
        low, high = np.nan, np.nan
        if len(part) > 1:
            _, below, above, _ = ratio_of_surveys(n * nees, n)
            low, high = mean * below**2, mean * above**2
        out.append(
            {
                **dict(zip(("chain", "variant", "model", "quantity"), keys, strict=True)),
                "seeds": len(part),
                "nees": mean,
                "low": low,
                "high": high,
                "coverage_95": float(np.average(part["coverage_95"], weights=n)),
                "right": GOAL[0] <= mean <= GOAL[1],
            }
        )
    return pd.DataFrame(out)


def judged(found: Processed, part: slice) -> dict[str, float]:
    """Mean normalised square of some components of the pose, number of poses, share inside 95 %."""
    e, C = found.error[:, part], found.cov[:, part, part]
    k = e.shape[1]
    square = normalised_squares(e, C)
    return {
        "nees": float(np.mean(square) / k),
        "n": len(e),
        "coverage_95": float(np.mean(square <= chi2.ppf(0.95, k))),
    }


def slow_heading_rad(kind: str, seed: int, t_gps_s: ArrayF) -> ArrayF:
    """An error (n,) of the heading: constant with either sign, or a Gauss-Markov process of minutes."""
    rng = generator(seed, "slow heading")
    sigma = np.deg2rad(SLOW_HEADING_DEG)
    if kind == "constant":
        return np.full(len(t_gps_s), sigma * rng.choice([-1.0, 1.0]))
    keep = np.exp(-np.diff(t_gps_s, prepend=t_gps_s[0]) / SLOW_HEADING_TIME_S)
    unit = rng.standard_normal(len(t_gps_s))
    error = unit.copy()
    for k in range(1, len(error)):
        error[k] = keep[k] * error[k - 1] + np.sqrt(1 - keep[k] ** 2) * unit[k]
    return np.asarray(sigma * error)


# ---------------------------------------------------------------- the study


def _study_rows(seed: Seed) -> Tables:
    if seed.kind == "ins":
        return {seed.kind: run_ins(seed.number, seed.folder)}
    found = [run_navigation(name, seed.number) for name in VARIANTS]
    return {seed.kind: pd.concat(found, ignore_index=True)}


STUDY: Final = Study(
    rows=_study_rows,
    results=lambda tables, files: {"table": table(pd.concat(tables.values(), ignore_index=True))},
    float_format="%.4g",
)
