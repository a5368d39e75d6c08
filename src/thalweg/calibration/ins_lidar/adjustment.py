"""Mount of the lidar on the boat from a run past the cones of a calibration field (T 3.1.1).

Start: ``phi = -90 deg``, all else zero. The cones are found in the cloud (`motion_search`), and the six
parameters of ``T_ics_scs`` are adjusted so that the points lie on them (`ins_lidar_model`).

**Origin.** The trajectory is that of the antenna, moved by its lever arm in ics. Nothing in the run sees the
point that is called the origin of ics: with another lever arm of the antenna that of the lidar comes out
shifted by the same. The antenna's lever arm *defines* the origin; what is observed is the place of the lidar
relative to the antenna. The axes of ics are those of the attitudes that the INS states.

**Sigmas.** T's sigmas (0.004 to 0.018 deg, 0.1 to 0.5 mm) follow if points err independently. They do not:
the points of many seconds share the error of the pose, and a constant error of the attitude cannot be told
from a turned mount at all. For Gauss-Markov errors (sigma, tau) seen without noise over a run of length T no
estimate of their mean is better than

    sigma sqrt(2 tau / (T + 2 tau))

0.046 deg in roll and pitch and 0.09 deg in heading for 0.1 and 0.2 deg, 20 s and 150 s. Both are reported:
the *formal* sigmas as in T, and the consistent ones, which go on into the file.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, Self

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.stats import chi2, qmc

from thalweg.calibration import FORM_SIGMA_M
from thalweg.calibration.ins_lidar.model import (
    MOUNT,
    AntennaPoint,
    BeamNoise,
    Known,
    Linearised,
    State,
    Step,
    by_antenna,
    cone_shifts,
    estimate_noise,
    linearise,
    solve_step,
    truncated_variance,
)
from thalweg.calibration.ins_lidar.pose_errors import BorderedNormals, Knots, PoseErrors
from thalweg.calibration.ins_lidar.run_points import (
    FieldCones,
    MountRange,
    OnCones,
    RunPoints,
    find_mount,
    select,
)
from thalweg.core import ArrayB, ArrayF, ArrayI, CoverageError, GeometryError, Rigid, UnobservableError
from thalweg.settings.sections import InsLidarFit

START: Final = Rigid.from_opk(np.deg2rad([0.0, -90.0, 0.0]), np.zeros(3))
"""T 3.1.1: phi = -90 deg, omega = kappa = 0, lever arm 0."""
_MAX_STEPS: Final = 12
_NEARLY: Final = 0.05
_NOISE_NEARLY: Final = 0.02
# Steps of the mount in sigmas. Beams at the outlines of cones keep it moving by 0.03; a step of 0.05
# adds a quarter of a percent to the variance.
_CONVERGED: Final = 0.05
SIZE_SPREAD: Final = 2.0
"""Stated sizes may be wrong by this factor, as one sigma of the logarithm."""
TIME_SPREAD: Final = 3.0
"""Stated correlation times may be wrong by this factor, as one sigma of the logarithm."""
WHITE_SPREAD: Final = 5.0
"""The white share ``w``: its ``w / (1 - w)`` may be wrong by this factor, as one sigma of the logarithm."""
NAMES: Final = (
    "position_size",
    "tilt_size",
    "heading_size",
    "position_time",
    "tilt_time",
    "heading_time",
    "white_share",
)
"""Parameters of the processes; tilt is roll and pitch. Without a white part the last one is left out."""
DETERMINED: Final = 0.5
"""A parameter whose posterior is narrower than this share of its prior counts as determined by the run."""
_KINDS: Final = {
    "size": ("size", SIZE_SPREAD),
    "time": ("time", TIME_SPREAD),
    "share": ("share", WHITE_SPREAD),
}
_WIDER: Final = 1.5
_NOTHING: Final = 1e-4
_DRAWS: Final = 64
_STEP: Final = 0.25
_FARTHEST: Final = 4.0

PARAMETERS: Final = ("lever_x", "lever_y", "lever_z", "rotation_x", "rotation_y", "rotation_z")
"""Unknowns of the mount, in ics."""
UNLIKELY: Final = 1e-6
"""Probability below which a cone's disagreement with its reference is no chance."""
_MOST_OFF: Final = 0.7
"""Share of beams toward a cone that something else may return: the ground, passers-by."""
_BIN_DEG: Final = 5
_LEAST_SHARE: Final = 0.002
"""Of the points in a bin of headings, to count as seen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Processes:
    """What a run says of the errors of its poses.

    Parameters
    ----------
    stated, errors : as stated, and at the maximum of the posterior.
    z : (h,) that maximum, in widths of the prior.
    draws : (d, h) of the posterior with their weights (d,), sum 1.
    """

    stated: PoseErrors
    errors: PoseErrors
    z: ArrayF
    draws: ArrayF
    weights: ArrayF

    @property
    def names(self) -> tuple[str, ...]:
        """Names (h,) of the parameters."""
        return NAMES[: len(self.z)]

    @property
    def width(self) -> ArrayF:
        """Standard deviations (h,) of the posterior in widths of the prior: 1 where the run says nothing."""
        mean = self.weights @ self.draws
        return np.asarray(np.sqrt(self.weights @ np.square(self.draws - mean)))

    @property
    def effective(self) -> float:
        """Number of draws that their weights leave, ``1 / sum w^2``."""
        return float(1.0 / np.square(self.weights).sum())

    def undetermined(self) -> tuple[str, ...]:
        """Parameters for which the width of the prior counts, see `DETERMINED`."""
        return tuple(name for name, width in zip(self.names, self.width, strict=True) if width > DETERMINED)

    def facts(self) -> dict[str, dict[str, Any]]:
        """By name: stated value, its factor, estimate, range of 95 %, and whether the run told it.

        Sizes in metres and degrees (of the axis that errs most), times in seconds.
        """
        stated, found = _values(self.stated), _values(self.errors)
        out = {}
        for i, (name, width) in enumerate(zip(self.names, self.width, strict=True)):
            away = 1.96 * width * np.eye(len(self.z))[i]
            low, high = (_values(changed(self.stated, self.z + side * away))[name] for side in (-1, 1))
            kind, spread = _KINDS[name.rpartition("_")[2]]
            out[name] = {
                "kind": kind,
                "stated": stated[name],
                "stated_within_factor": spread,
                "estimated": found[name],
                "low": low,
                "high": high,
                "determined_by_survey": bool(width <= DETERMINED),
            }
        return out


@dataclass(frozen=True, slots=True, kw_only=True)
class RunGates:
    """What a run must have.

    Parameters
    ----------
    min_cones : cones with enough points.
    min_points_per_cone : points on a cone, to count.
    min_headings_deg : range of headings in which cones were seen.
    max_sigma_lever_m, max_sigma_rotation_deg : a parameter with a larger formal sigma is not determined.
    """

    min_cones: int = InsLidarFit().min_cones
    min_points_per_cone: int = 100
    min_headings_deg: float = InsLidarFit().min_headings_deg
    max_sigma_lever_m: float = 0.005
    max_sigma_rotation_deg: float = 0.1


# ---------------------------------------------------------------- adjustment


@dataclass(frozen=True, slots=True, kw_only=True)
class InsLidarSettings:
    """How a run is evaluated.

    Parameters
    ----------
    errors : how the trajectory errs.
    noise : of a single point, as stated; its size along and across the beam is estimated from the residuals.
    sigma_time_s : of the lidar's stamps against the trajectory, one offset for the whole run.
    search : how far from the start the mount may be.
    gates : what a run must have.
    gates_m : half widths of the layers about the cones in the first passes.
    reject_sigmas : afterwards, in sigmas of a point.
    end_margin_m, max_incidence_deg : see `motion_search.select`.
    max_points_per_cone : more are thinned evenly in time.
    estimate_errors : take sizes, correlation times and white share of the pose errors from the run too, with
        ``errors`` as prior knowledge, and let what the run leaves open enlarge the covariance.
    form_sigma_m : how far the cones are from perfect ones, for `ins_lidar_file.field_cones`.
    """

    errors: PoseErrors
    noise: BeamNoise = field(default_factory=BeamNoise)
    sigma_time_s: float = InsLidarFit().sigma_time_s
    search: MountRange = field(default_factory=MountRange)
    gates: RunGates = field(default_factory=RunGates)
    gates_m: tuple[float, ...] = (0.20, 0.10)
    reject_sigmas: float = 3.0
    end_margin_m: float = 0.06
    max_incidence_deg: float = 60.0
    max_points_per_cone: int = 20_000
    estimate_errors: bool = False
    form_sigma_m: float = FORM_SIGMA_M

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From a section of a campaign file; sections ``errors``, ``noise``, ``search``, ``gates`` inside."""
        values = dict(section)
        values["errors"] = PoseErrors.from_section(values["errors"])
        for name, kind in (("noise", BeamNoise), ("search", MountRange), ("gates", RunGates)):
            if name in values:
                values[name] = kind(**values[name])
        if "gates_m" in values:
            values["gates_m"] = tuple(values["gates_m"])
        return cls(**values)


@dataclass(frozen=True, slots=True, kw_only=True)
class InsLidar:
    """Calibrated mount of the lidar.

    Parameters
    ----------
    T_ics_scs : with its consistent covariance (shift; rotation vector in ics).
    cov_formal : (6, 6) as T: independent points, nothing else errs.
    without_antenna : mount with consistent covariance without the antenna seen from the scanner.
    by_antenna : (6, 3) derivative of the mount by that point in scs; zero without it.
    errors : of the poses, as used: stated, or estimated.
    processes : what the run says of them; None where it was not asked.
    noise : of a single point, estimated.
    sigma0 : how large all residuals are in units of what is stated.
    n_points, redundancy : points used; observations minus unknowns.
    passes : table of the points used and left out, for each pass and cone.
    points : table of the points in the last pass, before and after, in pcs.
    dropped : cones left out, with the reason.
    """

    T_ics_scs: Rigid
    cov_formal: ArrayF
    without_antenna: Rigid
    by_antenna: ArrayF
    errors: PoseErrors
    processes: Processes | None
    noise: BeamNoise
    sigma0: float
    n_points: int
    redundancy: int
    passes: pd.DataFrame
    points: pd.DataFrame
    dropped: dict[str, str] = field(default_factory=dict)

    def cone_points(self, which: Literal["start", "calibrated"]) -> pd.DataFrame:
        """Points near the cones in pcs, with the approximate or with the calibrated mount (T Fig. 3.1)."""
        t = self.points
        return pd.DataFrame(
            {
                "cone": t["cone"],
                "position": "run",
                "t_gps_s": t["t_gps_s"],
                **{f"{a}_m": t[f"{a}_{which}_m"] for a in "xyz"},
                "residual_m": t[f"distance_{which}_m"],
                "used": t["used"],
            }
        )

    def summary(self) -> pd.DataFrame:
        """A row for each parameter: value, consistent sigma, formal sigma, sigma without the antenna."""
        T, W = self.T_ics_scs, self.without_antenna
        unit = np.r_[np.full(3, 1e3), np.full(3, np.rad2deg(1.0))]
        return pd.DataFrame(
            {
                "parameter": ["x", "y", "z", "rotation_x", "rotation_y", "rotation_z"],
                "unit": ["mm"] * 3 + ["deg"] * 3,
                "from_start": T.error_from(START) * unit,
                "sigma": np.sqrt(np.diag(T.cov)) * unit,
                "sigma_formal": np.sqrt(np.diag(self.cov_formal)) * unit,
                "sigma_without_antenna": np.sqrt(np.diag(W.cov)) * unit,
                "without_antenna_minus_with": W.error_from(T) * unit,
            }
        )


def calibrate(
    points: RunPoints,
    cones: FieldCones,
    T_wcs_pcs: Rigid,
    settings: InsLidarSettings,
    *,
    lever_ics_antenna_m: ArrayF,
    antenna: AntennaPoint | None = None,
    start: Rigid = START,
) -> InsLidar:
    """Mount of the lidar from the points of a run.

    Parameters
    ----------
    points : of the run, with poses; points that are on no cone are welcome.
    cones, T_wcs_pcs : the field, and its place in the world.
    settings : how to go on.
    lever_ics_antenna_m : (3,) the lever arm by which the trajectory was made; it defines the origin of ics.
    antenna : the antenna seen from the scanner, see `thalweg.calibration.ins_lidar.antenna`.
    start : approximate mount.

    Raises
    ------
    CoverageError : no point near any cone.
    GeometryError : the mount does not converge, or the antenna's marker contradicts the run.
    UnobservableError : the motion or the cones leave parameters of the mount undetermined.
    """
    dropped: dict[str, str] = {}
    while True:
        known = Known(
            field=cones,
            T_wcs_pcs=T_wcs_pcs,
            lever_ics_antenna_m=np.asarray(lever_ics_antenna_m, np.float64),
            errors=settings.errors,
            noise=settings.noise,
            sigma_time_s=settings.sigma_time_s,
            antenna=antenna,
        )
        run = _Run.prepare(points, known, settings, start)
        converged = run.passes()
        bad = check_cones(run.selection, cones, settings.gates, dropped) or run.moved()
        if bad is None and converged:
            return run.result(start, dropped)
        if bad is None:
            raise GeometryError(
                f"the mount of the lidar has not converged after {_MAX_STEPS} passes",
                expected="points that lie on the cones",
                cure="Look at the table of the passes; check the cones' reference and the trajectory",
            )
        k, reason = bad
        dropped[cones.names[k]] = reason
        cones = cones.only([i for i in range(len(cones.names)) if i != k])


@dataclass(slots=True, kw_only=True)
class _Run:
    points: RunPoints
    cone: ArrayI
    near: ArrayI
    known: Known
    settings: InsLidarSettings
    knots: Knots
    state: State
    selection: OnCones
    rows: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def prepare(cls, points: RunPoints, known: Known, settings: InsLidarSettings, start: Rigid) -> Self:
        """Find the mount roughly, and the points near the cones."""
        mount = find_mount(points, known.field, known.T_wcs_pcs, start, settings.search)
        cone = known.field.near(points.in_wcs(mount), known.T_wcs_pcs, 0.3)
        near = np.bincount(cone[cone >= 0], minlength=len(known.field.names))
        keep = []
        for k, n in enumerate(near):
            at = np.flatnonzero(cone == k)
            keep.append(at[:: max(-(-int(n) // (3 * settings.max_points_per_cone)), 1)])
        rows = np.sort(np.concatenate(keep))
        points, cone = points.taken(rows), cone[rows]
        knots = Knots.over(float(points.t_gps_s[0]), float(points.t_gps_s[-1]), settings.errors)
        state = State(mount=mount, z=np.zeros(known.n_border - 6), e=np.zeros(knots.n))
        none = np.zeros(len(points), dtype=np.bool_)
        empty = OnCones(cone=cone, used=none, far=none, ends=none, grazing=none)
        return cls(
            points=points,
            cone=cone,
            near=near,
            known=known,
            settings=settings,
            knots=knots,
            state=state,
            selection=empty,
        )

    def passes(self) -> bool:
        """Adjust with layers that grow thinner; whether the mount came to rest."""
        band, _ = self.knots.prior(self.known.errors)
        for gate in self.settings.gates_m:
            self._pass(band, gate, steps=2)
        for _ in range(_MAX_STEPS):
            before = self.known.noise
            step = self._pass(band, None, steps=1)
            if step.length < _NEARLY and self.known.noise.change(before) < _NOISE_NEARLY:
                break
        # Points at the edge of the layer come and go; the last steps are made with those that are in it now.
        # So do beams at an outline, which meet now the near side of a cone and now far behind it.
        last: ArrayF | None = None
        for _ in range(_MAX_STEPS):
            linear = self._linear()
            steady = np.isfinite(linear.distance_m)
            if last is not None:
                steady &= np.abs(linear.distance_m - last) < np.sqrt(linear.variance_m2)
            last = linear.distance_m
            self.selection.used[~steady] = False
            step = self._solve(linear, band)
            self.state = step.state
            if step.length < _CONVERGED:
                return True
        return False

    def moved(self) -> tuple[int, str] | None:
        """A cone that does not stand where it was measured, see `ins_lidar_checks.moved_cone`.

        Where the errors of the poses are estimated a cone must be off by these as well, as found without it:
        poses worse than stated move all cones.
        """
        linear = self._linear()
        used = self.selection.used & np.isfinite(linear.distance_m)
        bad = self._moved(linear, used, self.known.errors)
        if bad is None or not self.settings.estimate_errors:
            return bad
        step = self._solve(linear, self.knots.prior(self.known.errors)[0], used & (self.cone != bad[0]))
        return self._moved(linear, used, estimate_processes(step, self.knots, self.known.errors).errors)

    def _moved(self, linear: Linearised, used: ArrayB, errors: PoseErrors) -> tuple[int, str] | None:
        shift, square = cone_shifts(
            self.points.taken(used),
            linear.taken(used),
            self.cone[used],
            self.known,
            self.state,
            self.knots,
            prior_band=self.knots.prior(errors)[0],
        )
        return moved_cone(shift, square, self.selection, self.known.field)

    def _pass(self, band: ArrayF, gate_m: float | None, *, steps: int) -> Step:
        s, field_ = self.settings, self.known.field
        linear = self._linear()
        gate = s.reject_sigmas * np.sqrt(linear.variance_m2) if gate_m is None else gate_m
        half = np.array([cone.half_angle_rad for cone in field_.cones])
        self.selection = select(
            self.cone,
            linear.distance_m,
            linear.slant_m,
            linear.cosine,
            ends_m=field_.length_m / np.cos(half),
            gate_m=gate,
            end_margin_m=s.end_margin_m,
            max_incidence_deg=s.max_incidence_deg,
        )
        self._thin()
        self._count(gate_m, linear)
        for i in range(steps):
            if i:
                linear = self._linear()
            step = self._solve(linear, band)
            self.state = step.state
        if gate_m is None:
            self._estimate_noise(linear, step)
        return step

    def _estimate_noise(self, linear: Linearised, step: Step) -> None:
        """Noise of the points by their own residuals."""
        used = self.selection.used & np.isfinite(linear.distance_m)
        share = step.share * truncated_variance(self.settings.reject_sigmas)
        noise = estimate_noise(step.residual_m, linear.cosine[used], share, self.settings.noise)
        self.known = replace(self.known, noise=noise)

    def _linear(self) -> Linearised:
        return linearise(self.points, self.cone, self.known, self.state, self.knots)

    def _solve(
        self, linear: Linearised, band: ArrayF, rows: ArrayB | None = None, *, with_antenna: bool = True
    ) -> Step:
        # a beam at the outline may miss the cone after the mount has moved
        used = self.selection.used & np.isfinite(linear.distance_m) if rows is None else rows
        return solve_step(
            self.points.taken(used),
            linear.taken(used),
            self.known,
            self.state,
            self.knots,
            prior_band=band,
            with_antenna=with_antenna,
        )

    def _thin(self) -> None:
        """Leave out used points of cones that have more than enough, evenly in time."""
        for k in range(len(self.known.field.names)):
            at = np.flatnonzero(self.selection.used & (self.cone == k))
            limit = self.settings.max_points_per_cone
            if at.size > limit:
                kept = at[np.linspace(0, at.size - 1, limit).astype(np.int64)]
                self.selection.used[at] = False
                self.selection.used[kept] = True

    def _count(self, gate_m: float | None, linear: Linearised) -> None:
        s = self.selection
        number = 1 + (self.rows[-1]["pass"] if self.rows else 0)
        for k, name in enumerate(self.known.field.names):
            mine = self.cone == k
            used = s.used & mine
            rms = float(np.sqrt(np.nanmean(linear.distance_m[used] ** 2))) if used.any() else np.nan
            self.rows.append(
                {
                    "pass": number,
                    "layer_mm": 1e3 * gate_m if gate_m is not None else np.nan,
                    "cone": name,
                    "near": int(self.near[k]),
                    "taken": int(mine.sum()),
                    "used": int(used.sum()),
                    "far_from_surface": int((s.far & mine).sum()),
                    "beyond_ends": int((s.ends & mine).sum()),
                    "grazing": int((s.grazing & mine).sum()),
                    "thinned": int((mine & ~s.used & ~s.far & ~s.ends & ~s.grazing).sum()),
                    "rms_mm": 1e3 * rms,
                }
            )

    def result(self, start: Rigid, dropped: dict[str, str]) -> InsLidar:
        """The last solution with covariances and tables, if the run determines it."""
        used = self.selection.used
        check_turns(self.points.heading_rad()[used], self.settings.gates)
        linear = self._linear()
        errors, processes = self.known.errors, None
        band, _ = self.knots.prior(errors)
        step = self._solve(linear, band)
        check_geometry(step.normals.border[MOUNT, MOUNT], self.settings.gates)
        if self.settings.estimate_errors:
            processes = estimate_processes(step, self.knots, errors)
            errors = processes.errors
            band, _ = self.knots.prior(errors)
            step = self._solve(linear, band)
        alone = self._solve(linear, band, with_antenna=False)
        mount, without = (self._mount(found, processes) for found in (step, alone))
        check_antenna(self.known, without)
        J = linear.border[used, MOUNT]
        formal = np.asarray(np.linalg.inv((J / linear.variance_m2[used, None]).T @ J))
        return InsLidar(
            T_ics_scs=mount,
            cov_formal=formal,
            without_antenna=without,
            # how the estimate follows the antenna, by the covariance with which it was made
            by_antenna=by_antenna(self.known, self._mount(step, None)),
            errors=errors,
            processes=processes,
            noise=self.known.noise,
            sigma0=float(np.sqrt(step.solution.omega / (step.normals.n - 6))),
            n_points=int(used.sum()),
            redundancy=step.normals.n - 6,
            passes=pd.DataFrame(self.rows),
            points=self._table(start, mount),
            dropped=dropped,
        )

    def _mount(self, step: Step, processes: Processes | None) -> Rigid:
        """The mount with its covariance, over all processes that the run leaves possible."""
        cov = step.solution.cov_border[MOUNT, MOUNT]
        if processes is not None:
            cov = total_covariance(step.normals, step.prior_border, self.knots, processes)
        return step.state.mount.with_cov(cov)

    def _table(self, start: Rigid, mount: Rigid) -> pd.DataFrame:
        """Points near the cones with the start's and with the calibrated mount (T Fig. 3.1)."""
        fixed = replace(self.state, z=np.zeros_like(self.state.z), e=np.zeros_like(self.state.e))
        before = linearise(self.points, self.cone, self.known, replace(fixed, mount=start), self.knots)
        after = linearise(self.points, self.cone, self.known, replace(fixed, mount=mount), self.knots)
        adjusted = linearise(self.points, self.cone, self.known, self.state, self.knots)
        out: dict[str, Any] = {
            "cone": np.asarray(self.known.field.names)[self.cone],
            "t_gps_s": self.points.t_gps_s,
            "used": self.selection.used,
        }
        to_pcs = self.known.T_wcs_pcs.inverse()
        for name, T in (("start", start), ("calibrated", mount)):
            xyz = to_pcs.apply(self.points.in_wcs(T))
            out |= {f"{axis}_{name}_m": xyz[:, i] for i, axis in enumerate("xyz")}
        out |= {
            "distance_start_m": before.distance_m,
            "distance_calibrated_m": after.distance_m,
            "distance_adjusted_m": adjusted.distance_m,
            "sigma_m": np.sqrt(adjusted.variance_m2),
        }
        return pd.DataFrame(out)


# ---------------------------------------------------------------- how large the errors of the poses were in a
# run: variance components, correlation times, white share
#
# The points on the cones show the errors of the poses but for a constant. Their likelihood with all unknowns
# integrated out (restricted maximum likelihood, Patterson and Thompson 1971; Koch 1999, sec. 3.6)::
#
#     -2 log L(z) = log|N + Q| + log|S| - log|Q| + Omega
#
# with the normal matrix ``N`` of the errors, their inverse prior covariance ``Q(z)``, the reduced normal
# matrix ``S`` of the border and the weighted squares ``Omega`` of all residuals. What is stated is prior
# knowledge with a width, and ``z`` counts its widths: sizes by a factor of `SIZE_SPREAD`, correlation times
# by `TIME_SPREAD`, the white share by `WHITE_SPREAD` on its logit. The posterior has the density ``p(z) ~
# exp(-c(z) / 2)`` with ``c = -2 log L + z^T z``.
#
# **What the run leaves open enlarges the covariance.** With the mount ``x(z)`` and its covariance ``C(z)``
# for given processes, the law of total covariance about the estimate ``x(z0)`` at the minimum ``z0`` of ``c``
# is::
#
#     Cov(x) = sum w_i (C(z_i) + d_i d_i^T),    d_i = x(z_i) - x(z0),    w_i ~ p(z_i) / q(z_i),    sum w_i = 1
#
# The ``z_i`` come from a normal proposal ``q`` about ``z0`` whose covariance is that of Laplace's
# approximation, ``2 (d^2c / dz^2)^-1``, times `_WIDER`: a fixed quasi-random sequence (Owen 1998), so that
# equal runs give equal results. Where a run cannot tell a parameter its posterior is the prior, and the
# prior's width counts.


def changed(stated: PoseErrors, z: ArrayF) -> PoseErrors:
    """Processes whose parameters lie ``z`` (h,) widths of the prior from what is stated.

    Examples
    --------
    >>> stated = PoseErrors(sigma_position_m=np.full(3, 0.02), sigma_attitude_rad=np.full(3, 1e-3))
    >>> other = changed(stated, np.array([1.0, 0, 0, -1.0, 0, 0, 0]))
    >>> float(other.sigma_position_m[0]), round(other.position_time_s, 3)
    (0.04, 3.333)
    """
    position, tilt, heading = SIZE_SPREAD ** z[:3]
    times = stated.times_s[[0, 3, 5]] * TIME_SPREAD ** z[3:6]
    share = stated.white_share
    if share > 0:
        share = 1.0 / (1.0 + (1.0 / share - 1.0) * WHITE_SPREAD ** -z[6])
    return replace(
        stated,
        sigma_position_m=stated.sigma_position_m * position,
        sigma_attitude_rad=stated.sigma_attitude_rad * np.array([tilt, tilt, heading]),
        position_time_s=float(times[0]),
        attitude_time_s=float(times[1]),
        heading_time_s=float(times[2]),
        white_share=float(share),
    )


def estimate_processes(step: Step, knots: Knots, stated: PoseErrors) -> Processes:
    """The errors of the poses that a run and what is stated leave possible.

    Parameters
    ----------
    step : normal equations and prior knowledge of the border.
    knots : where the errors are unknowns.
    stated : centre of the prior; a white share of 0 says that there is none and is kept.
    """

    def cost(z: ArrayF) -> float:
        """``-2 log L`` and the prior."""
        band, logdet = knots.prior(changed(stated, z))
        found = step.normals.solve(band, step.prior_border)
        return float(found.logdet - logdet + found.omega + z @ z)

    h = len(NAMES) if stated.white_share > 0 else len(NAMES) - 1
    found = minimize(
        cost,
        np.zeros(h),
        method="L-BFGS-B",
        bounds=[(-_FARTHEST, _FARTHEST)] * h,
        options={"eps": 1e-3, "ftol": 1e-7, "gtol": 1e-2},
    )
    z0 = np.asarray(found.x)
    root = _root_of_laplace(cost, z0, float(found.fun)) * np.sqrt(_WIDER)
    normal = qmc.MultivariateNormalQMC(np.zeros(h), rng=np.random.default_rng(h)).random(_DRAWS)
    draws = z0 + normal @ root.T
    logs = np.array([-0.5 * cost(z) for z in draws]) + 0.5 * np.sum(normal**2, axis=1)
    weights = np.exp(logs - logs.max())
    return Processes(
        stated=stated, errors=changed(stated, z0), z=z0, draws=draws, weights=weights / weights.sum()
    )


def _root_of_laplace(cost: Callable[[ArrayF], float], z: ArrayF, here: float) -> ArrayF:
    """Matrix ``L`` (h, h) with ``L L^T = 2 (d^2c / dz^2)^-1``, no wider than the prior.

    Differences over a quarter of a prior's width see the shape of the minimum, not its roughness.
    """
    h = len(z)
    unit = _STEP * np.eye(h)
    more, less = ([cost(z + sign * e) for e in unit] for sign in (1, -1))
    H = np.diag(np.array(more) + np.array(less) - 2 * here)
    for i in range(h):
        for j in range(i):
            both = cost(z + unit[i] + unit[j]) + cost(z - unit[i] - unit[j])
            H[i, j] = H[j, i] = 0.5 * (both - more[i] - more[j] - less[i] - less[j] + 2 * here)
    values, vectors = np.linalg.eigh(H / (2 * _STEP**2))
    return np.asarray(vectors / np.sqrt(np.maximum(values, 1.0)))


def total_covariance(
    normals: BorderedNormals, prior_border: ArrayF, knots: Knots, processes: Processes
) -> ArrayF:
    """Covariance (6, 6) of the mount over all processes that a run leaves possible.

    Parameters
    ----------
    normals, prior_border : of a `Step`.
    knots : where the errors are unknowns.
    processes : from `estimate_processes`.
    """

    def mount(errors: PoseErrors) -> tuple[ArrayF, ArrayF]:
        """Step (6,) of the mount and its covariance."""
        found = normals.solve(knots.prior(errors)[0], prior_border)
        return found.border[MOUNT], found.cov_border[MOUNT, MOUNT]

    at_best, _ = mount(processes.errors)
    total = np.zeros((6, 6))
    for weight, z in zip(processes.weights, processes.draws, strict=True):
        if weight < _NOTHING:
            continue
        x, cov = mount(changed(processes.stated, z))
        total += weight * (cov + np.outer(x - at_best, x - at_best))
    return total


def _values(errors: PoseErrors) -> dict[str, float]:
    """Parameters by name, in metres, degrees, seconds."""
    attitude = np.rad2deg(errors.sigma_attitude_rad)
    values: Sequence[float] = (
        errors.sigma_position_m.max(),
        attitude[:2].max(),
        attitude[2],
        *errors.times_s[[0, 3, 5]],
        errors.white_share,
    )
    return {name: float(value) for name, value in zip(NAMES, values, strict=True)}


# ---------------------------------------------------------------- what a run must have, and the words for
# what it lacks


def check_cones(
    selection: OnCones, cones: FieldCones, gates: RunGates, dropped: dict[str, str]
) -> tuple[int, str] | None:
    """A cone with too few points, if enough others are left: its number and the reason to leave it out.

    Raises
    ------
    CoverageError : too few cones are left; names those that are missing.
    """
    c = len(cones.names)
    on = selection.cone >= 0
    used = np.bincount(selection.cone[selection.used], minlength=c)
    near = np.bincount(selection.cone[on], minlength=c)
    few = [k for k in range(c) if used[k] < gates.min_points_per_cone]
    if c - len(few) < gates.min_cones:
        lost = {cones.names[k]: f"{used[k]} of {near[k]} points near it lie on it" for k in few} | dropped
        raise CoverageError(
            f"{c - len(few)} cones were seen by the lidar; not "
            + "; ".join(f"{name}: {why}" for name, why in lost.items()),
            expected=f"{gates.min_cones} cones with {gates.min_points_per_cone} points each",
            cure="Check that the cones stand as they were measured"
            + (
                "; as most of them are off, that heights and datum of the targets are those of the positions"
                if 2 * len(lost) > c + len(dropped)
                else ""
            )
            + ". Record the run again so that the scan planes sweep over them",
        )
    if not few:
        return None
    k = min(few, key=lambda i: int(used[i]))
    return k, f"{used[k]} of {near[k]} points near it lie on its surface"


def moved_cone(
    shift_m: ArrayF, square: ArrayF, selection: OnCones, cones: FieldCones
) -> tuple[int, str] | None:
    """The cone that does not stand where it was measured: moved, toppled or mistaken for another one.

    Parameters
    ----------
    shift_m : (c, 3) by which the run would move each cone if it alone were free.
    square : (c,) its squared size in units of its covariance.
    selection : points of the last pass.
    cones : of the field.
    """
    c = len(cones.names)
    used, far = (np.bincount(selection.cone[rows], minlength=c) for rows in (selection.used, selection.far))
    off = far / np.maximum(used + far, 1)
    cure = "it was moved, has toppled, or its reference is another cone's. Measure the field again"
    if off.max() > _MOST_OFF:
        k = int(np.argmax(off))
        return k, f"{far[k]} of {used[k] + far[k]} beams toward it end before or behind its surface: {cure}"
    k = int(np.argmax(square))
    if square[k] > chi2.isf(UNLIKELY, 3):
        return k, f"its points lie {1e3 * np.linalg.norm(shift_m[k]):.0f} mm beside its reference: {cure}"
    return None


def check_antenna(known: Known, mount: Rigid) -> None:
    """Refuse an antenna by its marker that contradicts the run.

    Parameters
    ----------
    known : with the antenna seen from the scanner; nothing is tested without.
    mount : ``T_ics_scs`` with covariance from the run without that antenna.

    Raises
    ------
    GeometryError : both are farther apart than their sigmas explain, but for a probability of `UNLIKELY`.
    """
    if known.antenna is None:
        return
    point = known.antenna.x_scs_m[None]
    off = mount.apply(point)[0] - known.lever_ics_antenna_m
    J = mount.by_error(point)[0]
    cov = J @ mount.cov @ J.T + mount.R @ known.antenna.cov_m2 @ mount.R.T
    if off @ np.linalg.solve(cov, off) > chi2.isf(UNLIKELY, 3):
        sigma = float(np.sqrt(np.trace(cov)))
        raise GeometryError(
            f"the antenna by its marker lies {1e3 * np.linalg.norm(off):.0f} mm from where the run has it",
            expected=f"agreement within some {1e3 * sigma:.0f} mm (one sigma)",
            cure="Check antenna.marker and antenna.offset_m of the field description (negative for a print "
            "on top of the antenna), that the marker lies on the antenna, and that heights and datum of the "
            "field's targets are those of the positions",
        )


def seen_headings_deg(heading_rad: ArrayF) -> float:
    """Range of headings: the circle without its largest gap, in bins of 5 degrees.

    Examples
    --------
    >>> seen_headings_deg(np.deg2rad([2.0, 8.0, 91.0, 358.0]))
    100.0
    """
    bins = 360 // _BIN_DEG
    number = np.floor(np.rad2deg(heading_rad) % 360.0 / _BIN_DEG).astype(np.int64) % bins
    counts = np.bincount(number, minlength=bins)
    seen = np.flatnonzero(counts >= max(1.0, _LEAST_SHARE * len(heading_rad)))
    gaps = np.diff(np.append(seen, seen[0] + bins)) - 1
    return float(_BIN_DEG * (bins - int(gaps.max())))


def check_turns(heading_rad: ArrayF, gates: RunGates) -> None:
    """Refuse a run in one heading: an offset of the positions or of the field is then a lever arm.

    Raises
    ------
    UnobservableError : the boat turned too little while it saw cones.
    """
    span = seen_headings_deg(heading_rad)
    if span < gates.min_headings_deg:
        raise UnobservableError(
            ["lever_x", "lever_y"],
            defects=2,
            cure=f"The missing motion is a turn: cones were seen in headings that span {span:.0f} deg, "
            f"needed are {gates.min_headings_deg:.0f}. Drive circles or a figure of eight between the cones",
        )


def check_geometry(normals: ArrayF, gates: RunGates) -> None:
    """Refuse cones that leave a parameter of the mount to noise even if all else were known.

    Parameters
    ----------
    normals : (6, 6) normal equations of the mount from the points alone.
    gates : limits of the formal sigmas.

    Raises
    ------
    UnobservableError : names the parameters.
    """
    limit = np.r_[np.full(3, gates.max_sigma_lever_m), np.full(3, np.deg2rad(gates.max_sigma_rotation_deg))]
    power, axes = np.linalg.eigh(normals * np.outer(limit, limit))
    free = power < 1.0
    if not free.any():
        return
    part = np.sqrt(np.square(axes[:, free]).sum(axis=1))
    order = np.argsort(-part)
    raise UnobservableError(
        [PARAMETERS[i] for i in order if part[i] > 0.3 * part[order[0]]],
        defects=int(free.sum()),
        cure="Use cones on both sides of the boat, in different heights and distances, and pass them all",
    )
