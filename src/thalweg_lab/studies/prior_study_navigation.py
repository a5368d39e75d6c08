"""What wrong presumptions of the errors do to the trajectories: fused, and by the camera.

Surveys of the digital twin whose instruments do not err as the settings of the processing say: errors that
last a fifth or five times as long, positions with another share of white noise, sigmas stated at half or at
twice what they are, errors with heavy tails, a slow error of the heading that no sigma contains. Each survey
is processed with the defaults as they are (``presumed``) and with errors estimated from it (``estimated``).
The judge is the normalised square of the pose's error. Poses of images are drawn, not rendered, see
`thalweg_lab.studies.outage`; a survey is two minutes of zigzag on the river's whole reach.

Chains: ``fused`` of INS, positions and images; ``fused_no_images`` of INS and positions; ``camera`` of images
that the INS carries, at any time between them. The camera's mount is taken as it truly is in that chain: its
error is no part of the covariance, because it drops out of a cloud whose scanner is placed by the camera.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.core.types import ArrayF
from thalweg.navigation.camera.settings import CloudSettings
from thalweg.navigation.camera.trajectory import camera_trajectory
from thalweg.navigation.fusion.settings import FusionSettings
from thalweg_lab.base.random import generator
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
from thalweg_lab.truth.honesty import ratio_of_surveys

CHAINS: Final = ("fused", "fused_no_images", "camera")
MODELS: Final = ("presumed", "estimated")
QUANTITIES: Final[Mapping[str, slice]] = MappingProxyType({
    "position": slice(0, 3), "attitude": slice(3, 6), "pose": slice(0, 6),
})  # fmt: skip

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
            "rate_hz": 10.0, "attitude_time_s": 20.0 * self.times, "velocity_time_s": 10.0 * self.times,
            "sigma_velocity_mps": 0.05 * self.size,
            **{f"sigma_{a}_deg": s * self.size for a, s in (("roll", 0.1), ("pitch", 0.1), ("heading", 0.2))},
        }  # fmt: skip
        gnss = {
            "rate_hz": 5.0, "correlation_time_s": 10.0 * self.times,
            "white_share": 0.0 if self.student else self.white_share,
            "sigma_m": tuple(float(s * self.size * slow) for s in (0.02, 0.02, 0.03)),
        }  # fmt: skip
        size = self.size
        return VoyageSpec(
            duration_s=duration_s, twin={"ins": ins, "gnss": gnss}, jitter_s=usual.jitter_s * size,
            sigma_image_m=tuple(s * size for s in usual.sigma_image_m),  # type: ignore[arg-type]
            sigma_image_deg=tuple(s * size for s in usual.sigma_image_deg),  # type: ignore[arg-type]
            student=STUDENT if self.student else 0.0,
        )  # fmt: skip


VARIANTS: Final[Mapping[str, Variant]] = MappingProxyType({
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
})  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Processed:
    """Poses of a chain against the truth.

    ``error`` (k, 6) and ``cov`` (k, 6, 6) in wcs; ``facts`` what was estimated of its errors.
    """

    error: ArrayF
    cov: ArrayF
    facts: dict[str, Any] = field(default_factory=dict)


def run(
    variant: str, seed: int, folder: Path | None = None, *, duration_s: float = DURATION_S
) -> pd.DataFrame:
    """Survey and process once.

    Parameters
    ----------
    variant : one of `VARIANTS`.
    seed : of the survey.
    folder : not needed, nothing is written; other chains of the study need one.
    duration_s : of the survey.

    Returns
    -------
    A row a chain, model and quantity: ``chain, variant, model, seed, quantity, nees`` (mean normalised square
    over its components, expected 1), ``n`` moments, ``coverage_95``.
    """
    # what neighbouring images differ by is no news here
    logging.getLogger("thalweg").setLevel(logging.ERROR)
    survey = survey_of(VARIANTS[variant], seed, duration_s)
    rows = []
    for model in MODELS:
        for chain, found in processed(survey, estimate=model == "estimated").items():
            about = {"chain": chain, "variant": variant, "model": model, "seed": seed}
            rows += [{**about, "quantity": name, **judged(found, part)} for name, part in QUANTITIES.items()]
    return pd.DataFrame(rows)


def survey_of(variant: Variant, seed: int, duration_s: float = DURATION_S) -> Recorded:
    """A survey whose logs state the sigmas that the processing is used to, whatever its errors are."""
    survey = make_survey(seed, variant.spec(duration_s))
    stated = 1.0 / variant.size
    states, positions, images = survey.states.copy(), survey.positions.copy(), survey.images
    for name in ("roll", "pitch", "heading"):
        states[f"sigma_{name}_rad"] *= stated
    sigmas = [f"sigma_{name}_m" for name in ("east", "north", "up")]
    positions[sigmas] *= stated / (np.sqrt(1 - variant.white_share) if variant.student else 1.0)
    if variant.student:
        noise = unit_errors(generator(seed, "heavy tails"), (len(positions), 3), STUDENT)
        place = FRAME.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"])
        moved = place + np.sqrt(variant.white_share) * positions[sigmas].to_numpy() * noise
        lat, lon, height = FRAME.to_geodetic(moved)
        positions = positions.assign(lat_deg=lat, lon_deg=lon, h_ell_m=height)
    images = replace(
        images, cov_pose_wcs=stated**2 * images.cov_pose_wcs, cov_next=stated**2 * images.cov_next
    ).with_times(images.t_gps_s, stated * images.sigma_t_s)
    if variant.heading:
        states["heading_rad"] += slow_heading_rad(variant.heading, seed, states["t_gps_s"].to_numpy())
    return replace(survey, states=states, positions=positions, images=images)


def processed(survey: Recorded, *, estimate: bool) -> dict[str, Processed]:
    """The survey by all chains, with the defaults of a campaign file."""
    at = survey.motion.start_gps_s + np.arange(2.0, survey.motion.config.duration_s - 2.0, STEP_S)
    settings = FusionSettings(estimate_errors=estimate)
    out = {}
    for name, with_images in (("fused", True), ("fused_no_images", False)):
        fused = fuse(survey, settings, with_images=with_images)
        error, cov = errors_at(fused, survey.motion, at)
        out[name] = Processed(error=error, cov=cov, facts=fused.facts["errors"])
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
        error=pose_errors(position, R, survey.motion, at)[inside],
        cov=by_camera.trajectory.cov_at(at[inside]),
        facts=by_camera.facts["errors"],
    )
    return out


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of many seeds by chain, variant, model and quantity.

    Columns ``chain, variant, model, quantity, seeds, nees, low, high`` (mean over the seeds and its band of
    95 %, by the spread between them), ``coverage_95``, ``right``, whether the mean lies within `GOAL`, and
    ``refused``, surveys whose processing refused a result and which are in no mean. With one seed there is
    no band.
    """
    out = []
    for keys, all_surveys in rows.groupby(["chain", "variant", "model", "quantity"], sort=False):
        part = all_surveys[all_surveys["nees"].notna()]
        n, nees = part["n"].to_numpy(np.float64), part["nees"].to_numpy(np.float64)
        mean = float(np.sum(n * nees) / n.sum()) if len(part) else np.nan
        low, high = np.nan, np.nan
        if len(part) > 1:
            _, below, above, _ = ratio_of_surveys(n * nees, n)
            low, high = mean * below**2, mean * above**2
        out.append({
            **dict(zip(("chain", "variant", "model", "quantity"), keys, strict=True)), "seeds": len(part),
            "nees": mean, "low": low, "high": high,
            "coverage_95": float(np.average(part["coverage_95"], weights=n)) if len(part) else np.nan,
            "right": GOAL[0] <= mean <= GOAL[1],
            "refused": len(all_surveys) - len(part),
        })  # fmt: skip
    return pd.DataFrame(out)


def judged(found: Processed, part: slice) -> dict[str, float]:
    """Mean normalised square of some components of the pose, number of poses, share inside 95 %."""
    e, C = found.error[:, part], found.cov[:, part, part]
    k = e.shape[1]
    square = np.einsum("ni,ni->n", e, np.linalg.solve(C, e[:, :, None])[:, :, 0])
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
