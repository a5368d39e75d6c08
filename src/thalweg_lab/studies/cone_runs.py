"""Calibration runs past cones at the level of observations: what the sensors of a moving boat say, no files.

For studies over many seeds. A boat turns and sways between cones; a VLP-16 meets the cones, the ground and,
on request, a passer-by; positions and attitudes err as processes in time. Beams are aimed near the cones,
because most beams of a real scanner meet none. The intersection of beam and cone is written out here, not
taken from the model that is tested.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from thalweg.calibration import Cone
from thalweg.calibration.ins_lidar import (
    AntennaPoint,
    FieldCones,
    InsLidarSettings,
    MountRange,
    PoseErrors,
    RunGates,
    RunPoints,
    calibrate,
)
from thalweg.core import (
    ArrayB,
    ArrayF,
    LocalFrame,
    Rigid,
    Trajectory,
    roll_pitch_heading,
    rotation_enu_body,
    rotation_opk,
)
from thalweg.settings.sections import RunErrors
from thalweg_lab.random_numbers import gauss_markov, generator
from thalweg_lab.studies.study import Study, attempted, band_of_squares

START_S: Final = 4.0e8
FRAME: Final = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
LEVER_ANTENNA_M: Final = np.array([0.100, 0.0, -0.450])
ELEVATIONS_RAD: Final = np.deg2rad(np.arange(-15.0, 16.0, 2.0))
TRUE_MOUNT: Final = Rigid.from_opk(np.deg2rad([0.0, -90.0, 0.0]), [-0.350, 0.0, -0.250]).moved(
    np.r_[0.004, -0.006, 0.003, np.deg2rad([0.8, -1.1, 0.6])]
)
SIGMA_CONE: Final = np.r_[np.full(3, 0.0003), np.full(2, np.deg2rad(0.03)), np.deg2rad(0.02)]
COV_FIELD: Final = np.diag(np.square(np.r_[0.004, 0.004, 0.006, np.deg2rad([0.03, 0.03, 0.03])]))
_INS_HZ: Final = 50.0
_GNSS_HZ: Final = 10.0

"""From a seed to the line of its calibration."""
NEAR: Final = Rigid.from_opk(np.deg2rad([0.0, -90.0, 0.0]), [-0.350, 0.0, -0.250])
"""The mount by a ruler, so that seeds need not search."""
INS_LIDAR: Final = {"consistent": 6, "without_antenna": 6, "formal": 6}
LEVEL: Final = 0.05
"""Share of studies that leave their band although the covariances are right; as in the other studies."""


# ---------------------------------------------------------------- runs around cones


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSpec:
    """What kind of run.

    Parameters
    ----------
    duration_s : of the run.
    points : beams that are aimed near cones.
    turning : whether the boat turns; else it keeps its heading.
    sigma_position_m, sigma_attitude_deg : of the trajectory.
    position_time_s, attitude_time_s, white_share : see `thalweg.calibration.ins_lidar.pose_errors`.
    reference_scale : sizes of the errors of field and cones, in units of the usual ones.
    noise_m, across_m : of a point along and in each direction across its beam; None: the same.
    wrong : share of points that lie anywhere near the cones.
    passer_by : a person stands in front of a cone for a sixth of the run.
    """

    duration_s: float = 60.0
    points: int = 12_000
    turning: bool = True
    sigma_position_m: tuple[float, float, float] = (0.020, 0.020, 0.030)
    sigma_attitude_deg: tuple[float, float, float] = (0.1, 0.1, 0.2)
    position_time_s: float = 10.0
    attitude_time_s: float = 20.0
    white_share: float = 0.25
    reference_scale: float = 1.0
    noise_m: float = 0.0173
    across_m: float | None = None
    wrong: float = 0.0
    passer_by: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ConeRun:
    """A run as its sensors report it, and what is true.

    ``xyz_scs_m`` (n, 3), ``t_gps_s`` (n,), ``trajectory``, ``cones`` and ``T_wcs_pcs`` as measured,
    ``antenna`` seen from the scanner as measured; ``true_mount``.
    """

    xyz_scs_m: ArrayF
    t_gps_s: ArrayF
    trajectory: Trajectory
    cones: FieldCones
    T_wcs_pcs: Rigid
    antenna: AntennaPoint
    true_mount: Rigid


def yard_cones() -> FieldCones:
    """Six cones in wcs on both sides of the middle, in different distances, heights and directions."""
    places = np.array([
        [3.2, 0.8, 0.5], [4.6, -1.5, 1.5], [6.2, 0.6, 2.1],
        [-3.4, -0.7, 0.8], [-5.0, 1.4, 1.9], [-6.5, -0.4, 0.4],
    ])  # fmt: skip
    azimuths = np.deg2rad([38.0, 150.0, 0.0, 225.0, 330.0, 312.0])
    cones = []
    for k, (place, azimuth) in enumerate(zip(places, azimuths, strict=True)):
        upright = k == 2
        axis = np.array([0.0, 0.0, -1.0]) if upright else np.array([np.sin(azimuth), np.cos(azimuth), 0.05])
        axis = axis / np.linalg.norm(axis)
        # axes lead away from the boat, 35 to 50 degrees off the line of sight: the surface is seen
        cones.append(Cone(apex_m=place - 0.35 * axis, axis=axis, half_angle_rad=np.deg2rad(25.0)))
    return FieldCones(
        names=tuple(f"C{k + 1}" for k in range(6)), cones=tuple(cones), length_m=np.full(6, 0.70)
    )


def make_run(seed: int, spec: RunSpec | None = None, *, move: dict[str, ArrayF] | None = None) -> ConeRun:
    """A run of a seed.

    Parameters
    ----------
    seed : of all random numbers.
    spec : kind of run.
    move : cones that were changed after they were measured, and by what: (6,) as `Cone.moved` takes it.
    """
    s = spec or RunSpec()
    t, true_R, true_position = _motion(s)
    measured = measured_trajectory(seed, s, t, true_R, true_position)
    in_wcs = yard_cones()
    rng = generator(seed, "field")
    T = Rigid(R=rotation_opk(0.02, -0.03, 0.7), shift_m=np.array([1.0, -2.0, 0.3]))
    true_pcs = replace(in_wcs, cones=tuple(cone.in_frame(T.inverse()) for cone in in_wcs.cones))
    sigma_cone, cov_field = SIGMA_CONE * s.reference_scale, COV_FIELD * s.reference_scale**2
    changes = rng.standard_normal((6, 6)) * sigma_cone
    stated = tuple(cone.moved(d) for cone, d in zip(true_pcs.cones, changes, strict=True))
    cones = FieldCones(
        names=true_pcs.names,
        cones=tuple(replace(cone, cov=np.diag(sigma_cone**2)) for cone in stated),
        length_m=true_pcs.length_m,
    )
    T_stated = T.moved(np.linalg.cholesky(cov_field) @ rng.standard_normal(6)).with_cov(cov_field)
    standing = list(true_pcs.cones)
    for name, change in (move or {}).items():
        k = true_pcs.names.index(name)
        standing[k] = standing[k].moved(change)
    xyz, at = _shots(seed, s, t, true_R, true_position, [c.in_frame(T) for c in standing], in_wcs.length_m)
    cov = np.diag(np.square([0.001, 0.001, 0.001]))
    seen = TRUE_MOUNT.inverse().apply(LEVER_ANTENNA_M[None])[0]
    antenna = AntennaPoint(x_scs_m=seen + 0.001 * generator(seed, "antenna").standard_normal(3), cov_m2=cov)
    return ConeRun(
        xyz_scs_m=xyz,
        t_gps_s=at,
        trajectory=measured,
        cones=cones,
        T_wcs_pcs=T_stated,
        antenna=antenna,
        true_mount=TRUE_MOUNT,
    )


def _motion(s: RunSpec) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Times (n,), attitudes (n, 3, 3) and positions (n, 3) of the ics origin."""
    n = int(s.duration_s * _INS_HZ) + 1
    since = np.arange(n) / _INS_HZ
    turn = 2 * np.pi * since / 40.0 if s.turning else np.zeros(n)
    heading = turn + 0.05 * np.sin(0.9 * since)
    R = rotation_enu_body(np.deg2rad(4) * np.sin(1.7 * since), np.deg2rad(3) * np.sin(1.3 * since), heading)
    out = 0.8 * np.sin(2 * np.pi * since / 31.0)
    position = np.column_stack(
        [
            out * np.cos(turn),
            0.9 * np.cos(2 * np.pi * since / 23.0) - out * np.sin(turn),
            0.6 + 0.05 * np.sin(2.1 * since),
        ]
    )
    return START_S + since, R, position


def measured_trajectory(seed: int, s: RunSpec, t: ArrayF, R: ArrayF, position: ArrayF) -> Trajectory:
    """What INS and GNSS say of the motion."""
    rng = generator(seed, "ins")
    errors = [
        gauss_markov(rng, len(t), 1 / _INS_HZ, np.deg2rad(sigma), s.attitude_time_s)
        for sigma in s.sigma_attitude_deg
    ]
    roll, pitch, heading = roll_pitch_heading(R)
    stated = rotation_enu_body(roll + errors[0], pitch + errors[1], heading + errors[2])
    rng = generator(seed, "gnss")
    epochs = np.arange(t[0] - 1.0, t[-1] + 1.05, 1 / _GNSS_HZ)
    error = np.column_stack(
        [
            sigma
            * (
                np.sqrt(1 - s.white_share)
                * gauss_markov(rng, len(epochs), 1 / _GNSS_HZ, 1.0, s.position_time_s)
                + np.sqrt(s.white_share) * rng.standard_normal(len(epochs))
            )
            for sigma in s.sigma_position_m
        ]
    )
    antenna = position + R @ LEVER_ANTENNA_M + CubicSpline(epochs, error)(t)
    return Trajectory(
        frame=FRAME,
        t_gps_s=t,
        position_wcs_m=antenna - stated @ LEVER_ANTENNA_M,
        quaternion_wcs_ics=Rotation.from_matrix(stated).as_quat(),
        cov_pose_wcs=np.zeros((len(t), 6, 6)),
        valid=np.ones(len(t), dtype=np.bool_),
    )


def _shots(
    seed: int, s: RunSpec, t: ArrayF, R: ArrayF, position: ArrayF, cones: list[Cone], length_m: ArrayF
) -> tuple[ArrayF, ArrayF]:
    """Points (n, 3) in scs and their times (n,)."""
    rng = generator(seed, "lidar")
    at = np.sort(rng.uniform(t[0], t[-1], s.points))
    right = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    u = ((at - t[right - 1]) / (t[right] - t[right - 1]))[:, None]
    place = position[right - 1] * (1 - u) + position[right] * u
    attitude = Rotation.from_matrix(R)
    step = (attitude[:-1].inv() * attitude[1:]).as_rotvec()[right - 1]
    turned = (attitude[right - 1] * Rotation.from_rotvec(step * u)).as_matrix()
    R_scs = turned @ TRUE_MOUNT.R
    origin = place + turned @ TRUE_MOUNT.shift_m
    middle = np.array([c.apex_m + 0.5 * h * c.axis for c, h in zip(cones, length_m, strict=True)])
    aim = middle[rng.integers(len(cones), size=len(at))] + rng.uniform(-0.55, 0.55, (len(at), 3))
    toward = np.einsum("nji,nj->ni", R_scs, aim - origin)
    elevation = np.arcsin(toward[:, 2] / np.linalg.norm(toward, axis=1))
    ring = np.clip(np.round((np.rad2deg(elevation) + 15) / 2), 0, 15).astype(int)
    there = np.abs(elevation - ELEVATIONS_RAD[ring]) < np.deg2rad(1.01)
    azimuth, w = np.arctan2(toward[:, 0], toward[:, 1]), ELEVATIONS_RAD[ring]
    beam_scs = np.column_stack([np.cos(w) * np.sin(azimuth), np.cos(w) * np.cos(azimuth), np.sin(w)])
    beam = np.einsum("nij,nj->ni", R_scs, beam_scs)
    first = np.cross(beam, np.eye(3)[np.argmin(np.abs(beam), axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    across_m = s.noise_m if s.across_m is None else s.across_m
    beside = rng.standard_normal((len(at), 2)) * across_m
    from_ = origin + beside[:, :1] * first + beside[:, 1:] * np.cross(beam, first)
    way = np.full(len(at), np.inf)
    for cone, h in zip(cones, length_m, strict=True):
        way = np.minimum(way, _meet(cone, float(h), from_, beam))
    with np.errstate(divide="ignore"):
        ground = np.where(beam[:, 2] < 0, -from_[:, 2] / beam[:, 2], np.inf)
    way = np.minimum(way, np.where(ground > 0, ground, np.inf))
    if s.passer_by:
        way = _blocked(at, t, from_, beam, way, middle[1])
    way = way + rng.standard_normal(len(at)) * s.noise_m
    wrong = rng.uniform(size=len(at)) < s.wrong
    stray = np.linalg.norm(aim - origin, axis=1) + rng.uniform(-0.5, 0.5, len(at))
    way = np.where(wrong, stray, way)
    there &= way < 30.0
    return (way[:, None] * beam_scs)[there], at[there]


def _meet(cone: Cone, length_m: float, origin: ArrayF, beam: ArrayF) -> ArrayF:
    """Way (n,) along beams to the shell of a cone: root of ``(d.u)^2 = cos^2 |d|^2``; infinite if missed."""
    d = origin - cone.apex_m
    c2 = np.cos(cone.half_angle_rad) ** 2
    bu, du = beam @ cone.axis, d @ cone.axis
    a, b = bu**2 - c2, bu * du - c2 * np.sum(beam * d, axis=1)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(b * b - a * (du**2 - c2 * np.sum(d * d, axis=1)))
    ways = np.stack([(-b - root) / a, (-b + root) / a])
    height = du + ways * bu
    # the closed base hides the inside: only entries count, and the base is no surface of the cone
    base = (length_m - du) / bu
    on_base = (
        np.sum(np.square(d + base[:, None] * beam - length_m * cone.axis), axis=1)
        < (length_m * np.tan(cone.half_angle_rad)) ** 2
    )
    good = (height > 0) & (height < length_m) & (ways > 0)
    way = np.min(np.where(good, ways, np.inf), axis=0)
    hidden: ArrayB = on_base & (base > 0) & (base < way)
    return np.asarray(np.where(hidden, base, way))


def _blocked(at: ArrayF, t: ArrayF, origin: ArrayF, beam: ArrayF, way: ArrayF, cone: ArrayF) -> ArrayF:
    """Way with an upright cylinder, a person, 0.4 m before a cone for a sixth of the run."""
    middle = cone[:2] * (1 - 0.45 / np.linalg.norm(cone[:2]))
    there = (at > t[0] + 0.3 * (t[-1] - t[0])) & (at < t[0] + 0.47 * (t[-1] - t[0]))
    d, b = origin[:, :2] - middle, beam[:, :2]
    bb, bd = np.sum(b * b, axis=1), np.sum(b * d, axis=1)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(bd**2 - bb * (np.sum(d * d, axis=1) - 0.22**2))
    hit = (-bd - root) / bb
    return np.where(there & (hit > 0) & (hit < way), hit, way)


# ---------------------------------------------------------------- studies of the mounts of lidar and echo
# sounder
#
# The normalised square ``e^T C^-1 e / k`` of an error ``e`` of k components has the expectation 1 if ``C``
# is right. Its mean over n seeds lies in the chi-square band of n k degrees of freedom. *Formal* covariances,
# which take points as independent, are judged beside: they are what publications state, and far too small.


RUN: Final = RunSpec(duration_s=30.0, points=30_000)


def ins_lidar_trial(seed: int) -> dict[str, Any]:
    """Mount of the lidar from a run of half a minute past six cones.

    The errors of the poses are presumed as the defaults of a campaign state them, whatever `RUN` draws: so
    short a run could not tell.
    """
    run = make_run(seed, RUN)
    how = InsLidarSettings(
        errors=PoseErrors.from_section(RunErrors().model_dump()),
        gates_m=(0.12,),
        search=MountRange(lever_m=0.0, angle_deg=0.0),
        gates=RunGates(min_points_per_cone=40),
    )
    found = calibrate(
        RunPoints.on(run.trajectory, run.xyz_scs_m, run.t_gps_s),
        run.cones,
        run.T_wcs_pcs,
        how,
        lever_ics_antenna_m=LEVER_ANTENNA_M,
        antenna=run.antenna,
        start=NEAR,
    )
    error = found.T_ics_scs.error_from(run.true_mount)
    alone = found.without_antenna.error_from(run.true_mount)
    return {
        "error_mm": 1e3 * float(np.linalg.norm(error[:3])),
        "error_deg": float(np.rad2deg(np.linalg.norm(error[3:]))),
        "consistent": _square(error, found.T_ics_scs.cov),
        "without_antenna": _square(alone, found.without_antenna.cov),
        "formal": _square(alone, found.cov_formal),
    }


def judged(found: pd.DataFrame, components: dict[str, int], level: float = LEVEL) -> pd.DataFrame:
    """Means of the normalised squares of a study, each with its chi-square band.

    Parameters
    ----------
    found : rows of `thalweg_lab.studies.study.attempted`.
    components : columns that are judged, with their numbers of components.
    level : share of studies that lie outside the band although their covariances are right.

    Returns
    -------
    Columns ``covariance``, ``seeds``, ``failures``, ``normalised``, ``band_low``, ``band_high``, ``inside``;
    ``median_error_mm`` and, where there are angles, ``median_error_deg``: of the estimate, alike in all rows.
    """
    good = found[found["failure"] == ""]
    rows = []
    for name, k in components.items():
        n = k * len(good)
        mean = float(good[name].mean()) if n else float("nan")
        low, high = band_of_squares(n, level)
        rows.append((name, len(found), len(found) - len(good), mean, low, high, bool(low <= mean <= high)))
    names = ("covariance", "seeds", "failures", "normalised", "band_low", "band_high", "inside")
    table = pd.DataFrame(rows, columns=list(names))
    medians = {f"median_{name}": good[name].median() for name in ("error_mm", "error_deg") if name in good}
    return table.assign(**medians)


def _square(error: ArrayF, cov: ArrayF) -> float:
    """Normalised square; 0 if the covariance is without bounds."""
    return float(error @ np.linalg.solve(cov, error)) / len(error) if np.isfinite(cov).all() else 0.0


INS_LIDAR_STUDY: Final = Study(
    rows=lambda seed: {"trials": pd.DataFrame([attempted(ins_lidar_trial, seed.number)])},
    results=lambda tables, files: {"table": judged(tables["trials"], INS_LIDAR)},
)
"""Lidar on the moving boat: errors and sigmas over many seeds."""
