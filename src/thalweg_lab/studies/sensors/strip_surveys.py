"""Surveys of a bank by passes of a boat, whose lidar's points are drawn from planes: no rendering.

The bank is a wall, a wall of panels that look in all directions, or such panels among bushes. A boat passes
it and comes back, rolling and turning. Poses err by Gauss-Markov processes as those of INS and GNSS do, or
less, as those of all sensors together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.core import (
    ArrayF,
    ErrorChain,
    LocalFrame,
    Rigid,
    Trajectory,
    attitude_axes,
    cross_matrix,
    rotation_enu_body,
)
from thalweg.lidar import CELL_M, Adjusted, LogSample, adjust_strips, estimate_pose_errors, windows_of
from thalweg.navigation.ins_gnss import PoseCorrelation, PriorErrors
from thalweg.settings.sections import LidarAccuracy, Strips
from thalweg_lab.random_numbers import lasting
from thalweg_lab.studies import Result, Seed, Study, Tables, normalised_squares

LEVER: Final = np.array([0.1, 0.0, -0.45])
MOUNT: Final = Rigid(
    R=np.eye(3), shift_m=np.array([-0.35, 0.0, -0.25]), cov=np.diag([2e-3, 2e-3, 2e-3, 1e-3, 1e-3, 1e-3]) ** 2
)
BEAM: Final = LidarAccuracy(sigma_component_m=0.01, divergence_mrad=0.0, sigma_weak_m=0.0, sigma_time_s=0.0)
STEP_S: Final = 0.1
EPOCH_S: Final = 0.5
INS_M: Final = np.array([0.020, 0.020, 0.030])
INS_RAD: Final = np.deg2rad([0.1, 0.1, 0.2])
FUSED_SHARE: Final = 0.35
"""Errors of the fused trajectory in those of the INS."""
PANEL_M: Final = 2.0
SPOTS_A_S: Final = 500
A_SPOT: Final = 5
"""Points of neighbouring lasers and directions that hit one spot at about one time."""
BANK_M: Final = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """What a survey is like: ``size`` and ``time`` of the errors in those that are stated; faults in SI."""

    bank: Literal["wall", "panels", "bushes"] = "panels"
    chain: Literal["ins", "fused"] = "ins"
    length_m: float = 40.0
    passes: int = 2
    size: float = 1.0
    white: float = 0.25
    position_time_s: float = 10.0
    attitude_time_s: float = 20.0
    clock_s: float = 0.0
    mount_deg: float = 0.0
    sigma_mount_deg: float = 0.06
    boulder_m: float = 0.0
    wind_m: float = 0.0
    outage_s: float = 0.0
    ghosts: float = 0.0
    estimate: bool = True
    told_time: float = 1.0
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """A survey: its points as georeferenced and in truth, the trajectory."""

    sample: LogSample
    true_m: ArrayF
    normal: ArrayF
    still: ArrayF
    trajectory: Trajectory
    truth: Trajectory
    chains: Sequence[ErrorChain]
    lever: ArrayF


def _process(rng: np.random.Generator, n: int, sigma: ArrayF, time_s: float) -> ArrayF:
    return lasting(rng.standard_normal((n, len(sigma))), STEP_S, time_s) * sigma


def draw(seed: int, spec: Spec) -> Drawn:
    """A survey of a seed."""
    rng = np.random.default_rng([seed, 41])
    duration = spec.passes * spec.length_m
    t = np.arange(0.0, duration + STEP_S / 2, STEP_S)
    along = spec.length_m * (1 - np.abs(1 - (t / spec.length_m) % 2))
    offset = 3.0 * (t // spec.length_m % 2) + 2.0 * np.sin(t / 5)
    heading = np.deg2rad(np.where(t // spec.length_m % 2, 270.0, 90.0)) + np.deg2rad(25) * np.sin(t / 4)
    # a boat turns in seconds
    along, offset, heading = (
        np.convolve(np.pad(each, 20, mode="edge"), np.hanning(43)[1:-1] / 21, mode="valid")
        for each in (along, offset, heading)
    )
    boat = np.stack([along, offset, 0.05 * np.sin(t)], axis=1)
    R = rotation_enu_body(np.deg2rad(3) * np.sin(t * 1.3), np.deg2rad(2) * np.sin(t), heading)

    share = 1.0 if spec.chain == "ins" else FUSED_SHARE
    times = np.array([spec.position_time_s, spec.attitude_time_s]) * (1.0 if spec.chain == "ins" else 0.4)
    white = spec.white if spec.chain == "ins" else 0.0
    sigma_m, sigma_rad = INS_M * share * spec.size, INS_RAD * share * spec.size
    error = _process(rng, len(t), np.sqrt(1 - white) * sigma_m, times[0])
    epochs = np.arange(0.0, duration + 1, EPOCH_S)
    jumps = np.sqrt(white) * sigma_m * rng.standard_normal((len(epochs), 3))
    error += np.stack([np.interp(t, epochs, axis) for axis in jumps.T], axis=1)
    gone = np.abs(t - duration / 2) < spec.outage_s / 2
    grown = 1.0 + 9.0 * gone * np.sin(np.pi * np.clip((t - duration / 2) / max(spec.outage_s, 1) + 0.5, 0, 1))
    error *= grown[:, None]
    angles = _process(rng, len(t), sigma_rad, times[1])
    turn = np.einsum("nk,nki->ni", angles, attitude_axes(R))
    R_wrong = Rotation.from_rotvec(turn).as_matrix() @ R
    wrong = boat + R @ LEVER + error - R_wrong @ LEVER

    stated = sigma_m / spec.size
    cov = np.zeros((len(t), 6, 6))
    axes = np.swapaxes(attitude_axes(R_wrong), 1, 2)
    cov[:, 3:, 3:] = axes * (INS_RAD * share) ** 2 @ np.swapaxes(axes, 1, 2)
    arm = R_wrong @ LEVER
    K = cross_matrix(arm)
    cov[:, :3, 3:] = K @ cov[:, 3:, 3:]
    cov[:, 3:, :3] = np.swapaxes(cov[:, :3, 3:], 1, 2)
    cov[:, :3, :3] = np.diag(stated**2) * grown[:, None, None] ** 2 + cov[:, :3, 3:] @ np.swapaxes(K, 1, 2)
    frame = LocalFrame(lat_deg=51.0, lon_deg=13.0, h_ell_m=200.0)
    valid = np.ones(len(t), dtype=np.bool_)
    common: dict[str, Any] = {"frame": frame, "t_gps_s": t, "valid": valid, "cov_pose_wcs": cov}
    truth = Trajectory(position_wcs_m=boat, quaternion_wcs_ics=Rotation.from_matrix(R).as_quat(), **common)
    poses = Trajectory(
        position_wcs_m=wrong, quaternion_wcs_ics=Rotation.from_matrix(R_wrong).as_quat(), **common
    )

    true, normal, at, still = _points(rng, spec, truth)
    place, R_true, _ = truth.at(at)
    body = np.einsum("nji,nj->ni", R_true, true - place) - MOUNT.shift_m
    off = np.deg2rad(spec.mount_deg) * np.array([0.0, 0.0, 1.0])
    off = off + np.deg2rad(spec.sigma_mount_deg) * rng.standard_normal(3) * (spec.mount_deg == 0)
    lever = MOUNT.shift_m + rng.standard_normal(3) * MOUNT.sigma_shift_m
    seen = Rotation.from_rotvec(off).apply(body) + lever
    stamped = np.clip(at + spec.clock_s, 0, duration)
    position, turned, _ = poses.at(stamped)
    seen = np.einsum("nij,nj->ni", turned, seen) + position
    sample = LogSample(
        xyz_wcs_m=seen, t_gps_s=stamped, range_m=np.linalg.norm(body, axis=1),
        reflectivity=np.full(len(at), 30.0),
    )  # fmt: skip
    position_s, attitude_s = times * spec.told_time
    chains = PoseCorrelation(
        position_s=position_s, attitude_s=attitude_s, white_share=white, receiver_s=EPOCH_S
    ).chains(poses, LEVER)
    return Drawn(
        sample=sample, true_m=true, normal=normal, still=still, trajectory=poses, truth=truth,
        chains=chains, lever=lever,
    )  # fmt: skip


def _points(rng: np.random.Generator, spec: Spec, truth: Trajectory) -> tuple[ArrayF, ...]:
    """True points (n, 3) with noise, normals (n, 3), times (n,), and whether the place is a still plane."""
    nx, nz = int(spec.length_m / PANEL_M) + 10, 4
    ix, iz = np.meshgrid(np.arange(nx) - 5, np.arange(nz), indexing="ij")
    m = nx * nz
    centre = np.stack([PANEL_M * ix.ravel() + 0.5, np.full(m, BANK_M), PANEL_M * iz.ravel() + 0.5], axis=1)
    normal = np.tile([0.0, -1.0, 0.0], (m, 1))
    bush = np.zeros(m, dtype=np.bool_)
    if spec.bank != "wall":
        centre[:, 1] += rng.uniform(-1.0, 1.0, m)
        normal += 0.7 * rng.standard_normal((m, 3))
        normal[:, 1] = -np.abs(normal[:, 1])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    if spec.bank == "bushes":
        bush = rng.random(m) < 0.4
    n = int(SPOTS_A_S * truth.t_gps_s[-1])
    at = np.sort(rng.uniform(truth.t_gps_s[0], truth.t_gps_s[-1], n))
    panel = rng.integers(0, m, n)
    boat = truth.at(at)[0]
    ray = centre[panel] - boat
    range_m = np.linalg.norm(ray, axis=1)
    ok = (range_m < 30) & (np.einsum("ni,ni->n", ray, normal[panel]) < -0.25 * range_m)
    spread = np.repeat(rng.uniform(-PANEL_M / 2, PANEL_M / 2, (ok.sum(), 3)), A_SPOT, axis=0)
    at, panel = np.repeat(at[ok], A_SPOT), np.repeat(panel[ok], A_SPOT)
    spread += rng.uniform(-0.2, 0.2, spread.shape)
    spread -= np.einsum("ni,ni->n", spread, normal[panel])[:, None] * normal[panel]
    x = centre[panel] + spread
    depth = bush[panel] * 0.3 * rng.standard_normal(len(at))
    depth += bush[panel] * spec.wind_m * np.sin(at * 2 + panel)
    half = at > truth.t_gps_s[-1] / 2
    moved = (panel % 25 == 3) & (spec.boulder_m > 0)
    depth += np.where(moved & half, spec.boulder_m, 0.0)
    ghost = rng.random(len(at)) < spec.ghosts
    x = x + depth[:, None] * normal[panel]
    x[ghost, 2] *= -1
    x += BEAM.sigma_component_m * rng.standard_normal(x.shape)
    still = ~(bush[panel] | moved | ghost)
    return x, normal[panel], at, still


def solve(drawn: Drawn, spec: Spec) -> tuple[Adjusted, Trajectory, Sequence[ErrorChain]]:
    """The adjusted survey, the trajectory with the covariances that it began from, and its chains."""
    mount = replace(MOUNT, cov=np.diag([2e-3] * 3 + [np.deg2rad(spec.sigma_mount_deg)] * 3) ** 2)
    poses, chains = drawn.trajectory, drawn.chains
    if spec.chain == "ins" and spec.estimate:
        prior = PriorErrors(
            sigma_position_m=INS_M, sigma_attitude_rad=INS_RAD, white_share=0.25,
            position_time_s=10.0, attitude_time_s=20.0, spread=2.0, time_spread=3.0,
        )  # fmt: skip
        windows = windows_of(float(poses.t_gps_s[0]), float(poses.t_gps_s[-1]))
        s, parts = drawn.sample, []
        for start, length in windows:
            k = (s.t_gps_s >= start) & (s.t_gps_s < start + length)
            parts.append(replace(s, **{name: getattr(s, name)[k] for name in LogSample.__dataclass_fields__}))
        model = estimate_pose_errors(
            parts, windows, poses, mount, lever_ics_antenna_m=LEVER, prior=prior, beam=BEAM, epoch_s=EPOCH_S
        )
        poses = model.apply(poses, LEVER)
        chains = PoseCorrelation(
            position_s=model.estimates["position_time_s"].value,
            attitude_s=model.estimates["attitude_time_s"].value,
            white_share=model.white_share,
            receiver_s=EPOCH_S,
        ).chains(poses, LEVER)
    found = adjust_strips(drawn.sample, poses, mount, chains, Strips(**spec.settings))
    return found, poses, chains


def pose_errors(found: Trajectory, truth: Trajectory) -> ArrayF:
    """Errors (n, 6): shift, and rotation in wcs that turns truth into what was found."""
    turned = Rotation.from_quat(found.quaternion_wcs_ics) * Rotation.from_quat(truth.quaternion_wcs_ics).inv()
    return np.column_stack([found.position_wcs_m - truth.position_wcs_m, turned.as_rotvec()])


def replaced(drawn: Drawn, found: Adjusted) -> ArrayF:
    """The points (n, 3) with the adjusted poses and mount."""
    x, t = drawn.sample.xyz_wcs_m, drawn.sample.t_gps_s
    boat, R, _ = drawn.trajectory.at(t)
    scanner = np.einsum("nji,nj->ni", R, x - boat) - MOUNT.shift_m
    placed = scanner @ (found.mount.R @ MOUNT.R.T).T + found.mount.shift_m
    boat, R, _ = found.of_lidar.at(t)
    return np.asarray(np.einsum("nij,nj->ni", R, placed) + boat)


def cell_error_m(drawn: Drawn, x: ArrayF) -> float:
    """Root mean square of the errors along the normal of cells of the still planes, all points of each."""
    k = drawn.still.astype(bool)
    d = np.einsum("ni,ni->n", x[k] - drawn.true_m[k], drawn.normal[k])
    key = np.floor(drawn.true_m[k] / CELL_M).astype(np.int64)
    cell = np.unique(key, axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(cell)
    mean = np.bincount(cell, d) / count
    return float(np.sqrt(np.mean(mean[count >= 8] ** 2)))


def score(seed: int, spec: Spec) -> dict[str, float]:
    """Errors before and after, NEES of poses and of points along the normals."""
    drawn = draw(seed, spec)
    found, poses, _ = solve(drawn, spec)
    use = slice(5, -5, 5)
    row: dict[str, float] = {}
    for name, trajectory in (("before", poses), ("after", found.trajectory)):
        e = pose_errors(trajectory, drawn.truth)[use]
        cov = trajectory.cov_pose_wcs[use]
        row[f"nees_{name}"] = float(np.mean(normalised_squares(e, cov)) / 6)
        row[f"position_{name}_mm"] = 1e3 * float(np.sqrt(np.mean(e[:, :3] ** 2)))
        row[f"attitude_{name}_deg"] = float(np.rad2deg(np.sqrt(np.mean(e[:, 3:] ** 2))))
        row[f"sigma_position_{name}_mm"] = 1e3 * float(
            np.sqrt(np.mean(np.diagonal(cov, axis1=1, axis2=2)[:, :3]))
        )
    after = replaced(drawn, found)
    row["cell_before_mm"] = 1e3 * cell_error_m(drawn, drawn.sample.xyz_wcs_m)
    row["cell_after_mm"] = 1e3 * cell_error_m(drawn, after)
    row["ratio"] = row["cell_after_mm"] / row["cell_before_mm"]
    # points along the normals: the means of spots, whose noise is small beside what poses and mount do
    k = np.flatnonzero(drawn.still)[::50]
    t = drawn.sample.t_gps_s[k]
    n = drawn.normal[k]
    arm = after[k] - found.trajectory.at(t)[0]
    J = np.concatenate([n, np.cross(arm, n)], axis=1)
    var = np.einsum("ni,nij,nj->n", J, found.of_lidar.cov_at(t), J)
    d = np.einsum("ni,ni->n", after[k] - drawn.true_m[k], n)
    row["nees_points"] = float(np.mean(d**2 / var))
    row |= {f"told_{name.replace(' ', '_')}": share for name, share in found.facts["told"].items()}
    along = [np.median(each.sigma_position_m[:, 0]) for each in (found.trajectory, poses)]
    row["sigma_along_ratio"] = float(along[0] / along[1])
    correction = dict(zip(found.border["unknown"], found.border["correction"], strict=True))
    row["mount_z_deg"] = float(np.rad2deg(correction["mount rotation z [rad]"]))
    z = dict(zip(found.border["unknown"], found.border["z"], strict=True))
    not_asked = found.facts["not_asked"]
    for word, name in (("clock", "clock offset [s]"), ("range", "range offset [m]")):
        row[f"{word}_z"] = not_asked[name]["z"] if name in not_asked else z[name]
    clock = not_asked.get("clock offset [s]", {}).get("correction", np.nan)
    row["clock_ms"] = 1e3 * float(correction.get("clock offset [s]", clock))
    row["mount_z"] = max((z[name] for name in z if name.startswith("mount")), key=abs)
    row["stated_ratio"] = found.facts["corrections_over_stated"]
    row["told_unknowns"] = found.facts["told_unknowns"]
    named = {"clock": "if the clock", "range": "if the range", "mount": "if the mount", "poses": "poses are"}
    said = " ".join(found.facts["notes"])
    row |= {f"names_{what}": float(words in said) for what, words in named.items()}
    row["not_on_planes"] = float(found.facts["not_on_planes"] / found.facts["observations"])
    return row


# ---------------------------------------------------------------- the study

SURVEYS: Final[Mapping[str, Mapping[str, Any]]] = {
    f"{chain}_{bank}": {"chain": chain, "bank": bank}
    for chain in ("ins", "fused")
    for bank in ("panels", "wall", "bushes")
}
FAULTS: Final[Mapping[str, Mapping[str, Any]]] = {
    "boulder": {"boulder_m": 0.3},
    "wind": {"bank": "bushes", "wind_m": 0.2},
    "clock": {"clock_s": 0.005},
    "clock_asked": {"clock_s": 0.005, "settings": {"sigma_clock_s": 0.01}},
    "mount": {"mount_deg": 0.5},
    "mount_said": {"mount_deg": 0.5, "sigma_mount_deg": 0.5},
    "outage": {"outage_s": 30.0, "estimate": False},
    "ghosts": {"ghosts": 0.05},
    "time_short": {"told_time": 1 / 3, "estimate": False},
    "time_long": {"told_time": 3.0, "estimate": False},
}
"""A fault a kind; ``time_*``: correlation times are stated wrong by a factor of three and not estimated.

Of clock and mount twice: nobody knows of it, and it is asked for or stated."""
KINDS: Final = (*SURVEYS, *FAULTS)


def _rows(seed: Seed) -> Tables:
    """One survey: even seeds err for 10 s, odd ones for 20 s; who processes it is told 10 and 20 s.

    Each kind draws errors of its own: of the same ones all kinds would be too good or too bad together.
    """
    number = seed.number + 10_000 * KINDS.index(seed.kind)
    times = [(10.0, 20.0), (20.0, 10.0)][seed.number % 2]
    spec = Spec(
        length_m=float(seed.sizes["length_m"]),
        position_time_s=times[0],
        attitude_time_s=times[1],
        **{**SURVEYS, **FAULTS}[seed.kind],
    )
    return {"surveys": pd.DataFrame([{"kind": seed.kind, "seed": seed.number, **score(number, spec)}])}


def _results(tables: Tables, files: Sequence[Path]) -> Mapping[str, Result]:
    """Means by kind; errors of cells as root mean squares of all surveys of a kind."""
    rows = []
    for kind, part in tables["surveys"].groupby("kind", sort=False):
        before, after = (
            float(np.sqrt((part[f"cell_{when}_mm"] ** 2).mean())) for when in ("before", "after")
        )
        own = part.drop(columns=["kind", "seed", "ratio"]).mean().to_dict()
        for name in ("nees_before", "nees_after", "nees_points"):
            own[f"sigma_{name}"] = float(part[name].std() / np.sqrt(len(part)))
        own |= {"cell_before_mm": before, "cell_after_mm": after, "ratio": after / before}
        rows.append({"kind": kind, "surveys": len(part), **own})
    return {"table": pd.DataFrame(rows), "surveys": tables["surveys"]}


STUDY: Final = Study(rows=_rows, results=_results, float_format="%.4g")
