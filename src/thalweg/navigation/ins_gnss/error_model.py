"""How the poses of a survey err: what is stated, what the survey shows, and what that makes of sigmas.

An estimate is a lognormal value: its logarithm has a mean and a sigma. A stated sigma ``s`` whose factor
``f`` is only known so well predicts the variance

    E[f^2] s^2 = f^2 exp(2 sigma_log^2) s^2

so that not knowing makes the predicted sigma larger. Where the survey shows nothing, the width of the prior
knowledge is left and counts in full.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.core import (
    ArrayF,
    ErrorChain,
    Trajectory,
    attitude_axes,
    cross_matrix,
    even_time,
    read_chains,
    read_json,
    symmetric_roots,
)

NAMES: Final = ("position", "roll_pitch", "heading", "white", "position_time_s", "attitude_time_s")
"""Parameters: factors on the stated sigmas of the positions' slow part, of roll and pitch, of the heading and
of the positions' white noise; correlation times of positions and of attitudes, seconds."""

BEAM: Final = ("component", "footprint")
"""Factors on the stated sigmas of a single measurement of the lidar: of range and directions, and of the
echo's place in its footprint."""

BEAM_SPREAD: Final = 1.5
"""Stated sigmas of a single measurement may be wrong by this factor: they come from tests of the maker."""

INFORMED: Final = 0.8
"""The survey tells a parameter if its posterior sigma is below this share of the prior's."""

CHAIN_S: Final = 0.2
"""Interval of the nodes of chains of errors: short beside any correlation time."""

SIGNIFICANT: Final = 0.999
"""A heading is corrected only for a deviation that chance makes less often than one minus this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorErrors:
    """What is stated of the errors of the poses, and how far that may be wrong.

    Parameters
    ----------
    sigma_position_m : (3,) stated sigmas of the positions east, north, up; typical ones of the survey.
    sigma_attitude_rad : (3,) the same of roll, pitch, heading.
    white_share : share of the positions' variance that is new in each epoch.
    position_time_s, attitude_time_s : correlation times of what is not.
    spread, time_spread : sizes, and times, may be wrong by this factor (one sigma of its logarithm).
    """

    sigma_position_m: ArrayF
    sigma_attitude_rad: ArrayF
    white_share: float
    position_time_s: float
    attitude_time_s: float
    spread: float
    time_spread: float

    @classmethod
    def of_survey(
        cls, trajectory: Trajectory, lever_ics_antenna_m: ArrayF, stated: Mapping[str, Any]
    ) -> Self:
        """Prior of a survey: its typical sigmas, and what its campaign file states of the errors.

        Parameters
        ----------
        trajectory, lever_ics_antenna_m : as for `ErrorModel.apply`.
        stated : section ``orientation.error_model``.
        """
        position, attitude = typical_sigmas(trajectory, lever_ics_antenna_m)
        keys = ("white_share", "position_time_s", "attitude_time_s", "spread", "time_spread")
        return cls(
            sigma_position_m=position, sigma_attitude_rad=attitude, **{key: stated[key] for key in keys}
        )

    def sigmas(self) -> tuple[ArrayF, ArrayF]:
        """Sizes of the slow errors (6,), positions and attitudes, and of the white ones (3,)."""
        slow = self.sigma_position_m * np.sqrt(1.0 - self.white_share)
        return np.concatenate([slow, self.sigma_attitude_rad]), self.sigma_position_m * np.sqrt(
            self.white_share
        )

    def mean_and_spread(self) -> tuple[ArrayF, ArrayF]:
        """Mean and sigma (6,) of the logarithms of `NAMES`."""
        mean = np.log([1.0, 1.0, 1.0, 1.0, self.position_time_s, self.attitude_time_s])
        return mean, np.log([self.spread] * 4 + [self.time_spread] * 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A parameter: ``value`` (median), sigma of its logarithm, and both of the prior knowledge."""

    value: float
    sigma_log: float
    prior: float
    prior_sigma_log: float

    @property
    def informed(self) -> bool:
        """Whether the survey, and not the prior knowledge, tells the value."""
        return self.sigma_log < INFORMED * self.prior_sigma_log

    @property
    def predictive(self) -> float:
        """Root of the expected square, ``value exp(sigma_log^2)``: the factor of a predicted sigma."""
        return float(self.value * np.exp(self.sigma_log**2))


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorModel:
    """Errors of the poses of a survey as estimated.

    Parameters
    ----------
    estimates : by `NAMES`.
    white_share_stated : share of the white noise that ``white`` and ``position`` are factors on.
    deviation_rad : ``A, B`` of the heading's error ``A sin h + B cos h``.
    cov_deviation_rad2 : (2, 2) their covariance.
    windows, planes, observations : what the estimates rest on.
    notes : what could not be told, and why.
    """

    estimates: Mapping[str, Estimate]
    white_share_stated: float
    deviation_rad: tuple[float, float] = (0.0, 0.0)
    cov_deviation_rad2: list[list[float]] | None = None
    windows: int = 0
    planes: int = 0
    observations: int = 0
    notes: tuple[str, ...] = ()

    @classmethod
    def of_prior(cls, prior: PriorErrors, *, note: str) -> Self:
        """What is stated, with its width."""
        mean, spread = prior.mean_and_spread()
        return cls(
            estimates={
                name: Estimate(value=float(np.exp(m)), sigma_log=s, prior=float(np.exp(m)), prior_sigma_log=s)
                for name, m, s in zip(
                    NAMES + BEAM,
                    [*mean.tolist(), 0.0, 0.0],
                    [*spread.tolist(), *[float(np.log(BEAM_SPREAD))] * len(BEAM)],
                    strict=True,
                )
            },
            white_share_stated=prior.white_share,
            notes=(note,),
        )

    @classmethod
    def presumed(cls, prior: PriorErrors) -> Self:
        """What is stated, taken as certain."""
        mean, _ = prior.mean_and_spread()
        return cls(
            estimates={
                name: Estimate(
                    value=float(np.exp(m)), sigma_log=0.0, prior=float(np.exp(m)), prior_sigma_log=0
                )
                for name, m in zip(NAMES + BEAM, [*mean.tolist(), 0.0, 0.0], strict=True)
            },
            white_share_stated=prior.white_share,
            notes=("not estimated: what is stated is taken as certain",),
        )

    @property
    def position_factor(self) -> float:
        """Factor on the stated sigmas of positions: slow part and white noise together."""
        slow, white = self.estimates["position"].predictive, self.estimates["white"].predictive
        share = self.white_share_stated
        return float(np.sqrt((1 - share) * slow**2 + share * white**2))

    @property
    def white_share(self) -> float:
        """Share of the positions' variance that is new in each epoch."""
        slow, white = self.estimates["position"].value, self.estimates["white"].value
        share = self.white_share_stated
        return float(share * white**2 / ((1 - share) * slow**2 + share * white**2))

    @property
    def correlation_s(self) -> float:
        """Correlation time of the slowest error, seconds."""
        return max(self.estimates[name].value for name in ("position_time_s", "attitude_time_s"))

    @property
    def beam(self) -> dict[str, float]:
        """Factors on the stated sigmas of a single measurement of the lidar, by `BEAM`."""
        return {name: self.estimates[name].predictive for name in BEAM}

    @property
    def deviation_is_significant(self) -> bool:
        """Whether the heading depends on itself by more than chance makes (chi-square, two degrees)."""
        if self.cov_deviation_rad2 is None:
            return False
        d = np.asarray(self.deviation_rad)
        return bool(d @ np.linalg.solve(self.cov_deviation_rad2, d) > chi2.ppf(SIGNIFICANT, 2))

    def apply(self, trajectory: Trajectory, lever_ics_antenna_m: ArrayF) -> Trajectory:
        """The trajectory with the covariances of this model, and its heading without a significant deviation.

        Parameters
        ----------
        trajectory : poses with covariances as stated, see
        `thalweg.navigation.ins_gnss.trajectory.pose_covariance`.
        lever_ics_antenna_m : (3,) the point whose positions were measured, in ics.
        """
        lever = np.asarray(lever_ics_antenna_m, dtype=np.float64)
        rotation = Rotation.from_quat(trajectory.quaternion_wcs_ics)
        R = rotation.as_matrix()
        axes = np.swapaxes(attitude_axes(R), 1, 2)
        stated = trajectory.cov_pose_wcs
        # The part that the attitude makes through the lever arm is scaled with the attitude.
        turn = cross_matrix(R @ lever)
        measured = stated[:, :3, :3] - turn @ stated[:, 3:, 3:] @ np.swapaxes(turn, 1, 2)
        level, heading = self.estimates["roll_pitch"].predictive, self.estimates["heading"].predictive
        widen = axes * np.array([level, level, heading]) @ np.linalg.inv(axes)
        cov = np.empty_like(stated)
        cov[:, 3:, 3:] = widen @ stated[:, 3:, 3:] @ np.swapaxes(widen, 1, 2)
        position, corrected = trajectory.position_wcs_m, rotation
        if self.deviation_is_significant:
            sin_cos = R[:, :2, 0] / np.linalg.norm(R[:, :2, 0], axis=1, keepdims=True)
            angle = sin_cos @ np.asarray(self.deviation_rad)
            variance = np.einsum("ni,ij,nj->n", sin_cos, np.asarray(self.cov_deviation_rad2), sin_cos)
            about = axes[:, :, 2]
            corrected = Rotation.from_rotvec(-angle[:, None] * about) * rotation
            position = position + R @ lever - corrected.apply(lever)
            cov[:, 3:, 3:] += variance[:, None, None] * about[:, :, None] * about[:, None, :]
        cov[:, :3, 3:] = turn @ cov[:, 3:, 3:]
        cov[:, 3:, :3] = np.swapaxes(cov[:, :3, 3:], 1, 2)
        cov[:, :3, :3] = self.position_factor**2 * measured + cov[:, :3, 3:] @ np.swapaxes(turn, 1, 2)
        return replace(
            trajectory, position_wcs_m=position, quaternion_wcs_ics=corrected.as_quat(), cov_pose_wcs=cov
        )

    def report(self) -> dict[str, Any]:
        """For people and for later steps: each parameter with its sigma, and who tells it."""
        rows = {
            name: asdict(e) | {"predictive": e.predictive, "from": "survey" if e.informed else "prior"}
            for name, e in self.estimates.items()
        }
        deviation = np.rad2deg(self.deviation_rad).tolist()
        return {
            "estimates": rows,
            "white_share_stated": self.white_share_stated,
            "white_share": self.white_share,
            "position_factor": self.position_factor,
            "correlation_s": self.correlation_s,
            "heading_deviation_deg": deviation,
            "cov_heading_deviation_deg2": None
            if self.cov_deviation_rad2 is None
            else (np.asarray(self.cov_deviation_rad2) * np.rad2deg(1.0) ** 2).tolist(),
            "heading_corrected": self.deviation_is_significant,
            "windows": self.windows,
            "planes": self.planes,
            "observations": self.observations,
            "notes": list(self.notes),
        }

    def write(self, path: Path) -> None:
        """As JSON, see `report`."""
        path.write_text(json.dumps(self.report(), indent=2) + "\n")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseCorrelation:
    """How errors of poses last.

    Attributes
    ----------
    position_s, attitude_s : correlation times, seconds; of attitudes NaN where chains say all.
    white_share : share of the positions' variance that is new in each solution of the receiver.
    receiver_s : time between its solutions.
    even : (k,) GPS times, and the times (k,) in which errors of heights decay evenly; None: they do in GPS
        time.
    """

    position_s: float
    attitude_s: float
    white_share: float
    receiver_s: float
    even: tuple[ArrayF, ArrayF] | None = None

    @classmethod
    def of_survey(
        cls,
        errors: Path,
        *,
        receiver_s: float,
        position_time_s: float | None = None,
        attitude_time_s: float | None = None,
    ) -> Self:
        """As estimated from a survey, unless times are stated.

        Parameters
        ----------
        errors : ``error_model.json`` of INS and GNSS; or the chains of errors of a trajectory by camera or by
            all sensors (``.npz``), which leave no white part.
        receiver_s : time between solutions of the receiver.
        position_time_s, attitude_time_s : stated instead of the estimates.

        Raises
        ------
        InputError : a file of another kind.
        """
        if errors.suffix == ".npz":
            t_gps_s, even_s, found_s = even_time(read_chains(errors))
            return cls(
                position_s=position_time_s or found_s,
                attitude_s=np.nan,
                white_share=0.0,
                receiver_s=receiver_s,
                even=None if position_time_s else (t_gps_s, even_s),
            )
        facts = read_json(errors)
        found = {name: fact["value"] for name, fact in facts["estimates"].items()}
        return cls(
            position_s=position_time_s or found["position_time_s"],
            attitude_s=attitude_time_s or found["attitude_time_s"],
            white_share=float(facts["white_share"]),
            receiver_s=receiver_s,
        )

    def chains(self, trajectory: Trajectory, lever_ics_antenna_m: ArrayF) -> list[ErrorChain]:
        """Errors of the poses of INS and GNSS as independent parts: attitude, slow and white positions.

        Parameters
        ----------
        trajectory : with the covariances of the error model, see `ErrorModel.apply`.
        lever_ics_antenna_m : (3,) the point whose positions were measured, in ics.
        """
        R_all = Rotation.from_quat(trajectory.quaternion_wcs_ics).as_matrix()
        turn = cross_matrix(R_all @ lever_ics_antenna_m)
        cov = trajectory.cov_pose_wcs
        measured = cov[:, :3, :3] - turn @ cov[:, 3:, 3:] @ np.swapaxes(turn, 1, 2)
        measured = symmetric_roots(measured, np.broadcast_to(np.eye(3), measured.shape))
        turned = symmetric_roots(cov[:, 3:, 3:], R_all)
        root = np.zeros((3, len(cov), 6, 3))
        root[0, :, :3], root[0, :, 3:] = turn @ turned, turned
        root[1, :, :3] = np.sqrt(1 - self.white_share) * measured
        root[2, :, :3] = np.sqrt(self.white_share) * measured
        t = trajectory.t_gps_s
        out = []
        for name, part, step_s, time_s in zip(
            ("attitude", "position", "position, white"),
            root,
            (CHAIN_S, CHAIN_S, max(self.receiver_s, CHAIN_S)),
            (self.attitude_s, self.position_s, 0.0),
            strict=True,
        ):
            kept = np.unique(np.floor((t - t[0]) / step_s + 1e-6), return_index=True)[1]
            gap = np.diff(t[kept], prepend=-np.inf)
            like = np.exp(-gap / time_s) if time_s > 0 else np.zeros(len(kept))
            out.append(
                ErrorChain(name=name, t_gps_s=t[kept], root=part[kept], link=like[:, None, None] * np.eye(3))
            )
        return out

    def even_time_s(self, t_gps_s: ArrayF) -> ArrayF:
        """Times (n,) in which errors decay evenly; before the first and after the last node: theirs."""
        if self.even is None:
            return np.asarray(t_gps_s, dtype=np.float64)
        return np.asarray(np.interp(t_gps_s, *self.even))


def beam_factors(path: Path) -> dict[str, float]:
    """Factors on the sigmas of a single measurement of the lidar, of a file that `ErrorModel.write` wrote."""
    estimates = read_json(path)["estimates"]
    return {name: float(estimates[name]["predictive"]) for name in BEAM}


def typical_sigmas(trajectory: Trajectory, lever_ics_antenna_m: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Median stated sigmas (3,) of the measured positions, metres, and (3,) of roll, pitch, heading, radians.

    Parameters
    ----------
    trajectory, lever_ics_antenna_m : as for `ErrorModel.apply`.
    """
    use = trajectory.valid
    cov, R = trajectory.cov_pose_wcs[use], Rotation.from_quat(trajectory.quaternion_wcs_ics[use]).as_matrix()
    turn = cross_matrix(R @ lever_ics_antenna_m)
    measured = cov[:, :3, :3] - turn @ cov[:, 3:, 3:] @ np.swapaxes(turn, 1, 2)
    to_angles = np.linalg.inv(np.swapaxes(attitude_axes(R), 1, 2))
    angles = to_angles @ cov[:, 3:, 3:] @ np.swapaxes(to_angles, 1, 2)
    position, attitude = (
        np.sqrt(np.median(np.diagonal(c, axis1=1, axis2=2), axis=0)) for c in (measured, angles)
    )
    return position, attitude
