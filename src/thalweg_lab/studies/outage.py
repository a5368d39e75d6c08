"""How the position errs while GNSS is gone: INS, camera and fused trajectory against the truth of the twin.

Each seed is a voyage of its own. INS and antenna err as the twin's instruments do
(`thalweg_lab.instruments.ins`, `thalweg_lab.instruments.gnss`); poses of images have correlated
errors of a stated covariance, a common clock offset, jitter and a mount that is a little off. In memory,
without logs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import (
    R_ENU_NED,
    ArrayB,
    ArrayF,
    LocalFrame,
    Rigid,
    exp_rotation,
    roll_pitch_heading,
    root_mean_square,
)
from thalweg.images.model import ImagePoses
from thalweg.navigation.fusion import Fused, FusionSettings, fuse_trajectory
from thalweg_lab.instruments import (
    Solution,
    antenna_errors_m,
    attitude_errors_rad,
    boat_field_mg,
    inside,
    multipath_errors_m,
    stated_sigmas_m,
    unstated_heading_errors_rad,
    velocity_errors_mps,
)
from thalweg_lab.random_numbers import generator, lasting
from thalweg_lab.settings import TwinConfig
from thalweg_lab.studies.study import Study, normalised_squares
from thalweg_lab.voyage import Motion, Voyage, epochs

FRAME: Final = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
LEVER_ANTENNA_M: Final = np.array([0.10, 0.0, -0.45])
CAMERA: Final = Rigid.from_opk(np.deg2rad([90.0, 0.0, 0.0]), [-0.25, -0.10, -0.18])
"""``T_ics_ccs`` as calibrated; the true one is off by its sigmas."""

LENGTHS_S: Final = (1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0)
CHAINS: Final = ("ins_model", "ins_velocity", "camera", "fused")
DIMMED: Final = 0.6
"""Share of the satellites that leaves dim under trees, see `thalweg_lab.instruments.gnss`."""

_LEAD_S: Final = 15.0
"""GNSS between two outages, seconds: longer than its errors are correlated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VoyageSpec:
    """What a simulated survey is like.

    Parameters
    ----------
    duration_s : of the survey.
    twin : changes of the section ``twin``, for instance ``{"ins": {"motor_field_mg": ...}}``.
    image_interval_s : between images.
    sigma_image_m, sigma_image_deg : (3,) of the images' poses, east, north, up.
    image_time_s : correlation time of their errors.
    sigma_clock_s, jitter_s : common offset and scatter of the images' times.
    sigma_mount_m, sigma_mount_deg : of the camera's mount in each coordinate.
    shade_s : begin after the start and length of the times under trees.
    student : degrees of freedom of Student's distribution that image poses and times are drawn from, with the
        same variance; 0: normal.
    """

    duration_s: float = 120.0
    twin: Mapping[str, Any] = field(default_factory=dict)
    image_interval_s: float = 1.0
    sigma_image_m: tuple[float, float, float] = (0.010, 0.010, 0.010)
    sigma_image_deg: tuple[float, float, float] = (0.03, 0.03, 0.03)
    image_time_s: float = 4.0
    sigma_clock_s: float = 0.01
    jitter_s: float = 0.016
    sigma_mount_m: float = 0.001
    sigma_mount_deg: float = 0.02
    shade_s: tuple[tuple[float, float], ...] = ()
    student: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """A simulated survey: what is known of it, and the truth.

    ``states`` (table kind ``ins_state``), ``positions`` (``gnss_position``), ``images``, ``T_ccs_ics`` with
    covariance; ``motion``, ``clock_s`` (the true offset of the images' times) and ``true_T_ics_ccs``.
    """

    states: pd.DataFrame
    positions: pd.DataFrame
    images: ImagePoses
    T_ccs_ics: Rigid
    motion: Motion
    clock_s: float
    true_T_ics_ccs: Rigid


def make_survey(seed: int, spec: VoyageSpec | None = None) -> Recorded:
    """Simulate a survey."""
    spec = VoyageSpec() if spec is None else spec
    config = TwinConfig.of_size("demo", duration_s=spec.duration_s, **spec.twin)
    motion = Voyage(config, seed)
    images, T_ccs_ics, clock, true_mount = _images(seed, spec, motion)
    return Recorded(
        states=_states(config, seed, motion),
        positions=_positions(config, seed, motion, spec.shade_s),
        images=images,
        T_ccs_ics=T_ccs_ics,
        motion=motion,
        clock_s=clock,
        true_T_ics_ccs=true_mount,
    )


def fuse(
    survey: Recorded,
    settings: FusionSettings,
    *,
    keep_positions: ArrayB | None = None,
    with_positions: bool = True,
    with_images: bool = True,
) -> Fused:
    """The trajectory of a survey, of some of its inputs."""
    positions = survey.positions if keep_positions is None else survey.positions[keep_positions]
    return fuse_trajectory(
        survey.states,
        FRAME,
        settings,
        positions=positions if with_positions else None,
        lever_ics_antenna_m=LEVER_ANTENNA_M,
        images=survey.images if with_images else None,
        T_ccs_ics=survey.T_ccs_ics,
        sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
        max_attitude_gap_s=0.1,
    )


def errors_at(fused: Fused, motion: Motion, t_gps_s: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Errors (k, 6) that move the poses to the true ones, and their covariances (k, 6, 6)."""
    position, R, cov = fused.poses(t_gps_s)
    return pose_errors(position, R, motion, t_gps_s), cov


def pose_errors(position_wcs_m: ArrayF, R_wcs_ics: ArrayF, motion: Motion, t_gps_s: ArrayF) -> ArrayF:
    """Errors (k, 6), shift and small rotation vector in wcs, that move poses to the true ones."""
    turn = motion.R_wcs_ics(t_gps_s) @ np.swapaxes(R_wcs_ics, 1, 2)
    odd = np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    return np.concatenate([motion.position_wcs_m(t_gps_s) - position_wcs_m, odd / 2], axis=1)


def outages(positions_t_s: ArrayF, length_s: float, shift: float = 0.0) -> list[tuple[float, float]]:
    """Begin and end of outages of a length, all that fit with GNSS before and behind each.

    ``shift``, 0 to 1, moves them all by this share of the time that is left over.
    """
    first, last = float(positions_t_s[0]) + _LEAD_S, float(positions_t_s[-1]) - _LEAD_S
    begins = np.arange(first, last - length_s + 1e-9, length_s + _LEAD_S)
    if len(begins):
        begins += shift * (last - length_s - begins[-1])
    return [(float(b), float(b) + length_s) for b in begins]


def outage_trial(
    seed: int, spec: VoyageSpec | None = None, lengths_s: Sequence[float] = LENGTHS_S
) -> pd.DataFrame:
    """One line for each outage of a survey.

    Columns ``seed, length_s, chain, rms_m`` (three-dimensional, over the outage), ``max_m``, ``sigma_m`` (as
    predicted, root mean square) and ``normalised`` (mean normalised square of the position's error).
    """
    survey = make_survey(seed, spec)
    t = survey.positions["t_gps_s"].to_numpy()
    shift = float(generator(seed, "outages").uniform())
    steered = FusionSettings()
    own = FusionSettings(use_ins_velocity=False)
    alone = fuse(survey, steered, with_positions=False)
    rows = []
    for length in lengths_s:
        spans = outages(t, length, shift)
        keep = np.ones(len(t), dtype=np.bool_)
        for begin, end in spans:
            keep &= (t < begin) | (t > end)
        chains = {
            "ins_model": fuse(survey, own, keep_positions=keep, with_images=False),
            "ins_velocity": fuse(survey, steered, keep_positions=keep, with_images=False),
            "camera": alone,
            "fused": fuse(survey, steered, keep_positions=keep),
        }
        for begin, end in spans:
            at = np.arange(begin, end, 0.1)
            rows += [
                {"seed": seed, "length_s": length, "chain": name, **_judged(found, survey.motion, at)}
                for name, found in chains.items()
            ]
    return pd.DataFrame(rows)


def summarised(found: pd.DataFrame) -> pd.DataFrame:
    """By length and chain, as a figure shows it.

    Columns ``length_s, chain, outages, rms_m, max_m`` (greatest error), ``sigma_m`` (predicted) and
    ``normalised``.
    """
    rows = []
    for (length, chain), part in found.groupby(["length_s", "chain"], sort=True):
        rows.append(
            {
                "length_s": length,
                "chain": chain,
                "outages": len(part),
                "rms_m": root_mean_square(part["rms_m"]),
                "max_m": float(part["max_m"].max()),
                "sigma_m": root_mean_square(part["sigma_m"]),
                "normalised": float(part["normalised"].mean()),
            }
        )
    return pd.DataFrame(rows)


def _judged(found: Fused, motion: Motion, at: ArrayF) -> dict[str, float]:
    error, cov = errors_at(found, motion, at)
    e, C = error[:, :3], cov[:, :3, :3]
    size = np.linalg.norm(e, axis=1)
    return {
        "rms_m": root_mean_square(size),
        "max_m": float(size.max()),
        "sigma_m": float(np.sqrt(np.mean(np.trace(C, axis1=1, axis2=2)))),
        "normalised": float((normalised_squares(e, C) / 3).mean()),
    }


def _states(config: TwinConfig, seed: int, motion: Motion) -> pd.DataFrame:
    """What the INS reports."""
    ins = config.ins
    t = epochs(config, ins.rate_hz)
    thrust = motion.thrust(t) if np.any(ins.motor_field_mg) else np.zeros((len(t), 2))
    wrong = attitude_errors_rad(config, seed, t, motion.start_gps_s)
    wrong[:, 2] += unstated_heading_errors_rad(config, motion, t, boat_field_mg(ins, thrust))
    lat, lon, height = FRAME.to_geodetic(motion.position_wcs_m(t))
    to_enu = np.swapaxes(FRAME.R_wcs_enu(lat, lon), 1, 2)
    angles = np.stack(roll_pitch_heading(to_enu @ motion.R_wcs_ics(t)), axis=1) + wrong
    ned = np.einsum("nij,nj->ni", to_enu, motion.velocity_wcs_mps(t)) @ R_ENU_NED.T
    ned = ned + velocity_errors_mps(config, seed, len(t))
    sigmas = np.deg2rad([ins.sigma_roll_deg, ins.sigma_pitch_deg, ins.sigma_heading_deg])
    columns = {"t_gps_s": t, "lat_deg": lat, "lon_deg": lon, "h_ell_m": height}
    columns |= {f"v_{name}_mps": ned[:, i] for i, name in enumerate(("north", "east", "down"))}
    for i, name in enumerate(("roll", "pitch", "heading")):
        columns |= {f"{name}_rad": angles[:, i], f"sigma_{name}_rad": np.full(len(t), sigmas[i])}
    columns |= {f"sigma_{name}_m": np.ones(len(t)) for name in ("north", "east", "up")}
    return pd.DataFrame(columns).assign(filter_status=np.uint16(0b1111))


def _positions(
    config: TwinConfig, seed: int, motion: Motion, shade_s: tuple[tuple[float, float], ...]
) -> pd.DataFrame:
    """The post-processed antenna track, without its outages; under trees leaves disturb it."""
    t = epochs(config, config.gnss.rate_hz)
    since = t - motion.start_gps_s
    floats = inside(since, config.effects.gnss_floats)
    kinds = np.where(floats, int(Solution.FLOAT), int(Solution.FIXED))
    sigmas = stated_sigmas_m(config.gnss, kinds)
    place = motion.sensor_wcs_m(t, LEVER_ANTENNA_M) + antenna_errors_m(config, seed, "ppk", kinds, sigmas)
    place += multipath_errors_m(config, seed, np.where(inside(since, shade_s), DIMMED, 0.0))
    lat, lon, height = FRAME.to_geodetic(place)
    columns = {"t_gps_s": t, "lat_deg": lat, "lon_deg": lon, "h_ell_m": height}
    columns |= {f"sigma_{name}_m": sigmas[:, i] for i, name in enumerate(("east", "north", "up"))}
    columns |= {f"cov_{name}_m2": np.full(len(t), np.nan) for name in ("en", "eu", "nu")}
    table = pd.DataFrame(columns).assign(fix=np.where(floats, "float", "fixed"))
    return table[~inside(since, config.effects.gnss_outages)].reset_index(drop=True)


def unit_errors(rng: np.random.Generator, shape: int | tuple[int, ...], student: float = 0.0) -> ArrayF:
    """Errors of variance 1, normal or, above 2 degrees of freedom, of Student's distribution."""
    if not student:
        return np.asarray(rng.standard_normal(shape))
    return np.asarray(rng.standard_t(student, shape) * np.sqrt((student - 2) / student))


def drawn_poses(
    frame: LocalFrame,
    t_gps_s: ArrayF,
    sigma_t_s: float,
    centre_wcs_m: ArrayF,
    R_wcs_ccs: ArrayF,
    cov: ArrayF,
    cov_next: ArrayF,
) -> ImagePoses:
    """Poses of images (n) that were drawn, not rendered; what they say of marks, no trajectory uses."""
    n = len(t_gps_s)
    return ImagePoses(
        frame=frame,
        images=tuple(f"{k:05d}.jpg" for k in range(n)),
        t_gps_s=t_gps_s,
        sigma_t_s=np.full(n, sigma_t_s),
        oriented=np.ones(n, dtype=np.bool_),
        reasons=("",) * n,
        centre_wcs_m=centre_wcs_m,
        R_wcs_ccs=R_wcs_ccs,
        cov_pose_wcs=cov,
        cov_next=cov_next,
        n_marks=np.full(n, 300.0),
        rms_px=np.full(n, 0.5),
    )


def _images(seed: int, spec: VoyageSpec, motion: Motion) -> tuple[ImagePoses, Rigid, float, Rigid]:
    """Poses of images with the errors of an image block, the mount as calibrated, the clock's offset, and the
    true mount.
    """
    rng = generator(seed, "image poses")
    angle = np.deg2rad(spec.sigma_mount_deg)
    sigma_mount = np.repeat([spec.sigma_mount_m, angle], 3)
    T_ccs_ics = CAMERA.inverse().with_cov(np.diag(sigma_mount**2))
    true_mount = T_ccs_ics.moved(sigma_mount * rng.standard_normal(6)).inverse()
    clock = float(spec.sigma_clock_s * rng.standard_normal())
    stamp = motion.start_gps_s + np.arange(0.5, spec.duration_s - 0.5, spec.image_interval_s)
    n = len(stamp)
    exposed = stamp + clock + spec.jitter_s * unit_errors(rng, n, spec.student)
    R = motion.R_wcs_ics(exposed)
    sigma = np.concatenate([spec.sigma_image_m, np.deg2rad(spec.sigma_image_deg)])
    keep = float(np.exp(-spec.image_interval_s / spec.image_time_s))
    error = sigma * lasting(unit_errors(rng, (n, 6), spec.student), spec.image_interval_s, spec.image_time_s)
    C = np.diag(sigma**2)
    # an error moves the estimate to the truth
    poses = drawn_poses(
        FRAME,
        stamp,
        spec.jitter_s,
        motion.position_wcs_m(exposed) + R @ true_mount.shift_m - error[:, :3],
        exp_rotation(-error[:, 3:]) @ R @ true_mount.R,
        np.tile(C, (n, 1, 1)),
        np.concatenate([np.tile(keep * C, (n - 1, 1, 1)), np.zeros((1, 6, 6))]),
    )
    return poses, T_ccs_ics, clock, true_mount


STUDY: Final = Study(
    rows=lambda seed: {"outages": outage_trial(seed.number)},
    results=lambda tables, files: {"table": summarised(tables["outages"])},
)
