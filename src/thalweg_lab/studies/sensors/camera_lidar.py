"""Camera-lidar calibrations of the twin over many seeds: are the errors small, and are the sigmas consistent?

Each seed is a calibration of its own: field, mounts, beams and marks err anew. The lidar is that of the
recordings, in memory; marks are where the pictures would show them, with errors, so that thousands of
pictures need not be drawn. Everything after that is the campaign's: the bundle of the reference pictures,
that of the boat's camera with static pictures and run, and the errors that poses and cones share.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration import ConeReference, Position, orient_on_field
from thalweg.calibration.camera_lidar import (
    CameraLidar,
    CameraLidarSettings,
    FieldErrors,
    Statics,
    calibrate_camera_lidar,
    cone_references,
    nominal_orientation,
    statics_of,
)
from thalweg.calibration.field import FieldDescription, FieldPoints, measure_field, parse_field
from thalweg.core import Camera, GeometryError, LocalFrame, Rigid
from thalweg.settings.sections import LidarAccuracy
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinConfig
from thalweg_lab.studies import Result, Study, Tables, attempted, band_of_squares
from thalweg_lab.voyage import FieldRun, standing, true_mounts
from thalweg_lab.yard import Field, build_field, tour
from thalweg_lab.yard_images import mount_of, true_camera
from thalweg_lab.yard_records import description, static_scan

# ---------------------------------------------------------------- marks of the pictures of a calibration
# field without pictures: true places, projected, with errors
#
# For studies over many seeds. Everything after the detection is the campaign's: the bundle of the reference
# pictures, that of the boat's camera, and the joint covariance of static positions and cones that comes out
# of it. A sheet is seen if it faces the camera, lies in the picture and is large enough; nothing hides it.


FRAME: Final = LocalFrame(lat_deg=51.028, lon_deg=13.721, h_ell_m=160.0)
_FACING: Final = float(np.cos(np.deg2rad(68.0)))
_LEAST_SIDE_PX: Final = 18.0
"""Between two saddles of a sheet, 8 modules: below it the detection finds no marker."""
_BORDER_PX: Final = 15.0
_WRONG_PX: Final = (1.0, 50.0)
"""Wrong marks are off by this, evenly in the logarithm."""
_RUN_STEP_S: Final = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Pictures:
    """How the field is photographed.

    Parameters
    ----------
    sigma_px : of a mark in each coordinate, true and stated.
    run_images : number of pictures of the dynamic run; 0: the static ones alone calibrate the boat's camera.
    wrong_marks : share of marks that are off by more.
    """

    sigma_px: float = 0.05
    run_images: int = 30
    wrong_marks: float = 0.0


def photographed_field(
    config: TwinConfig, seed: int, T_ics_ccs: Rigid, positions: tuple[int, ...], how: Pictures
) -> tuple[FieldDescription, Statics]:
    """Description of a field, and its static positions and points as the campaign would measure them.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : of the field, its certificates and the errors of all marks.
    T_ics_ccs : true mount of the boat's camera.
    positions : numbers of the static positions, from 1; their pictures are ``position_1`` and so on.
    how : see there.
    """
    field = build_field(config, seed)
    known = parse_field(description(field, seed, FRAME))
    reference = true_camera(config.camera.reference, "reference")
    shots = {f"reference_{k}": T for k, T in enumerate(tour(field, config.camera.reference, seed))}
    marks = seen_marks(field, reference, shots, generator(seed, "study reference marks"), how)
    network = measure_field(marks, {"reference": reference}, known)
    points = FieldPoints(points=network.points, points_pcs=network.points_pcs, cov=network.cov_points)
    boat = true_camera(config.camera, "boat")
    static = {f"position_{n}": standing(config, n).T_wcs_ics @ T_ics_ccs for n in positions}
    poses = static | _run(config, seed, T_ics_ccs, how.run_images)
    marks = seen_marks(field, boat, poses, generator(seed, "study boat marks"), how)
    return known, statics_of(orient_on_field(marks, boat, points), points, list(static))


def seen_marks(
    field: Field, camera: Camera, poses: Mapping[str, Rigid], rng: np.random.Generator, how: Pictures
) -> pd.DataFrame:
    """Table of marks as the detection gives it: image, camera, marker, corner, x_px, y_px, sigma_px.

    Parameters
    ----------
    field : with its sheets.
    camera : true interior orientation.
    poses : ``T_wcs_ccs`` by the name of the picture.
    rng : for the errors.
    how : see there.
    """
    saddles = np.stack([s.saddles_wcs_m() for s in field.sheets])
    middle, normal = saddles.mean(axis=1), np.stack([s.normal_wcs() for s in field.sheets])
    printed = np.array([s.marker for s in field.sheets])
    parts = []
    for image, pose in poses.items():
        view = pose.shift_m - middle
        facing = np.einsum("ni,ni->n", view, normal) > _FACING * np.linalg.norm(view, axis=1)
        local = pose.inverse().apply(saddles.reshape(-1, 3))
        xy = camera.project(local).reshape(-1, 4, 2)
        inside = camera.inside(xy.reshape(-1, 2), _BORDER_PX).reshape(-1, 4).all(axis=1)
        side = np.linalg.norm(xy - np.roll(xy, 1, axis=1), axis=2).min(axis=1)
        seen = np.flatnonzero(facing & inside & np.isfinite(xy).all(axis=(1, 2)) & (side > _LEAST_SIDE_PX))
        n = 4 * len(seen)
        error = how.sigma_px * rng.standard_normal((n, 2))
        turn, wrong = rng.uniform(0, 2 * np.pi, n), rng.random(n) < how.wrong_marks
        way = np.exp(rng.uniform(np.log(_WRONG_PX[0]), np.log(_WRONG_PX[1]), n)) * wrong
        error += way[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        at = xy[seen].reshape(-1, 2) + error
        parts.append(
            pd.DataFrame(
                {
                    "image": image,
                    "camera": camera.name,
                    "marker": np.repeat(printed[seen], 4),
                    "corner": np.tile(np.arange(4), len(seen)),
                    "x_px": at[:, 0],
                    "y_px": at[:, 1],
                    "sigma_px": how.sigma_px,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def _run(config: TwinConfig, seed: int, T_ics_ccs: Rigid, images: int) -> dict[str, Rigid]:
    """Poses of the boat's camera on its run."""
    run = FieldRun(config, seed)
    t = np.asarray(run.start_gps_s + _RUN_STEP_S * np.arange(images), dtype=np.float64)
    at, R = run.position_wcs_m(t), run.R_wcs_ics(t)
    return {f"run_{k}": Rigid(R=R[k], shift_m=at[k]) @ T_ics_ccs for k in range(images)}


# ---------------------------------------------------------------- camera lidar


MOUNTS: Final[dict[str, Any]] = {
    name: {
        "omega_deg": omega,
        "phi_deg": phi,
        "kappa_deg": 0.0,
        "lever_ics_m": lever,
        "sigma_axes": "ics",
        **dict.fromkeys(("sigma_omega_deg", "sigma_phi_deg", "sigma_kappa_deg"), sigma_deg),
        "sigma_lever_m": [0.02, 0.02, 0.02],
    }
    for name, omega, phi, lever, sigma_deg in (
        ("lidar", 0.0, -90.0, [-0.350, 0.0, -0.250], 1.0),
        ("camera", 90.0, 0.0, [-0.250, -0.100, -0.180], 1.0),
    )
}
"""Nominal mounts with what a ruler and the eye are worth."""

BEAM: Final = LidarAccuracy(
    sigma_component_m=0.0173, divergence_mrad=3.0, footprint_share=0.177, sigma_weak_m=0.0, sigma_time_s=0.0
)
ERRORS: Final = (
    "lever_x_mm",
    "lever_y_mm",
    "lever_z_mm",
    "rotation_x_deg",
    "rotation_y_deg",
    "rotation_z_deg",
)
_UNITS: Final = np.array([1e3, 1e3, 1e3, *np.rad2deg([1.0, 1.0, 1.0])])


@dataclass(frozen=True, slots=True, kw_only=True)
class StudySettings:
    """What the calibrations of a study are like.

    Parameters
    ----------
    positions : numbers of the static positions, from 1.
    revolutions : of the lidar at each position; 10 a second.
    pictures : of the field, by the reflex camera and by that of the boat.
    effects : of the section ``twin.field.effects``, such as ``passers_by``.
    calibration : settings of the adjustment.
    """

    positions: tuple[int, ...] = (1, 2, 3)
    revolutions: int = 10
    pictures: Pictures = field(default_factory=Pictures)
    effects: Mapping[str, Any] = field(default_factory=dict)
    calibration: CameraLidarSettings = field(default_factory=CameraLidarSettings)


CASES: Final[dict[str, StudySettings]] = {
    "one revolution": StudySettings(revolutions=1),
    "five seconds": StudySettings(revolutions=50),
    "one position": StudySettings(revolutions=50, positions=(1,)),
    "static pictures alone": StudySettings(revolutions=50, pictures=Pictures(run_images=0)),
    "people, 5 % wrong marks": StudySettings(
        revolutions=50, pictures=Pictures(wrong_marks=0.05), effects={"passers_by": 3}
    ),
}
"""Calibrations of the study: three positions each, if not said otherwise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """Input of a calibration, and the truth."""

    references: list[ConeReference]
    positions: list[Position]
    errors: FieldErrors
    nominal: Rigid
    truth: Rigid


def all_cases(seed: int) -> pd.DataFrame:
    """`calibration_errors` of all `CASES`, with the column ``case``; they share the pictures of the seed."""
    return pd.DataFrame(
        [
            attempted(partial(calibration_errors, settings=settings), seed) | {"case": name}
            for name, settings in CASES.items()
        ]
    )


def by_case(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of many seeds in the order of `CASES`."""
    order = {name: k for k, name in enumerate(CASES)}
    return rows.sort_values(
        ["case", "seed"], key=lambda c: c.map(order) if c.name == "case" else c, ignore_index=True
    )


def calibration_errors(seed: int, settings: StudySettings) -> dict[str, Any]:
    """Errors and sigmas of the orientation of one seed, and its normalised square error.

    Raises
    ------
    ThalwegError : there is no calibration.
    """
    trial = simulated_trial(seed, settings)
    result = calibrate_camera_lidar(
        trial.references, trial.positions, trial.nominal, settings.calibration, errors=trial.errors
    )
    return judged(result, trial.truth)


def judged(result: CameraLidar, truth: Rigid) -> dict[str, Any]:
    """Errors of a result against the truth."""
    error = result.T_ccs_scs.error_from(truth)
    sigma = np.sqrt(np.diag(result.T_ccs_scs.cov))
    return {
        **dict(zip(ERRORS, (error * _UNITS).tolist(), strict=True)),
        **{f"sigma_{name}": s for name, s in zip(ERRORS, (sigma * _UNITS).tolist(), strict=True)},
        "error_lever_mm": 1e3 * float(np.linalg.norm(error[:3])),
        "error_rotation_deg": float(np.rad2deg(np.linalg.norm(error[3:]))),
        "normalised": float(error @ np.linalg.solve(result.T_ccs_scs.cov, error)) / 6.0,
        "sigma0": float(np.sqrt(result.adjusted.sigma0_squared)),
        "points": int(result.residuals["points"].sum()),
        "cones": len(result.cones),
        "left_out": int(np.sum(~result.detection["found"] & (result.detection["predicted"] > 0))),
    }


def summary(study: pd.DataFrame, level: float = 0.05) -> dict[str, float]:
    """Numbers of a study: medians of errors and sigmas, and the band of the mean normalised square error.

    ``normalised`` has the expectation 1; ``band_low`` and ``band_high`` hold its mean with ``1 - level`` if
    the covariances are right (chi-square with six degrees of freedom a seed).
    """
    good = study[study["failure"] == ""]
    low, high = band_of_squares(6 * len(good), level)
    return {
        "seeds": len(study),
        "failures": len(study) - len(good),
        "median_error_lever_mm": float(good["error_lever_mm"].median()),
        "median_error_rotation_deg": float(good["error_rotation_deg"].median()),
        **{f"median_sigma_{name}": float(good[f"sigma_{name}"].median()) for name in ERRORS},
        **{f"mean_error_{name}": float(good[name].mean()) for name in ERRORS},
        "normalised": float(good["normalised"].mean()),
        "band_low": low,
        "band_high": high,
    }


def summary_table(study: pd.DataFrame) -> pd.DataFrame:
    """`summary` of each case: one row a ``case``."""
    rows = [{"case": name, **summary(part)} for name, part in study.groupby("case", sort=False)]
    return pd.DataFrame(rows)


def simulated_trial(seed: int, settings: StudySettings) -> Trial:
    """Observations of one calibration.

    Raises
    ------
    GeometryError : the pictures do not give a field, or no pose of a position.
    """
    config = _twin(tuple(sorted(settings.effects.items())))
    mounts = true_mounts(MOUNTS, seed, on=True)
    lidar, camera = mount_of(mounts["lidar"]), mount_of(mounts["camera"])
    known, statics = _photographed(seed, tuple(sorted(settings.effects.items())), settings.pictures)
    images = [f"position_{number}" for number in settings.positions]
    lost = {image: statics.lost[image] for image in images if image in statics.lost}
    if lost:
        raise GeometryError(f"no pose of {lost}", expected="a pose of each position")
    positions = []
    for number, image in zip(settings.positions, images, strict=True):
        scan = static_scan(
            config,
            seed,
            number,
            R_ics_scs=lidar.R,
            lever_ics_scs_m=lidar.shift_m,
            revolutions=settings.revolutions,
        )
        pose = statics.poses[statics.images.index(image)]
        reflectivity = scan.reflectivity.astype(np.float64)
        positions.append(Position.measured(image, pose, scan.points_scs_m, BEAM, reflectivity))
    return Trial(
        references=cone_references(known, statics.points),
        positions=positions,
        errors=statics.errors(known, images),
        nominal=nominal_orientation(MOUNTS),
        truth=camera.inverse() @ lidar,
    )


def _twin(effects: tuple[tuple[str, Any], ...]) -> TwinConfig:
    return TwinConfig.model_validate({"size": "field", "field": {"effects": dict(effects)}})


@lru_cache(maxsize=2)
def _photographed(
    seed: int, effects: tuple[tuple[str, Any], ...], pictures: Pictures
) -> tuple[FieldDescription, Statics]:
    """What cases of one seed share."""
    camera = mount_of(true_mounts(MOUNTS, seed, on=True)["camera"])
    return photographed_field(_twin(effects), seed, camera, (1, 2, 3), pictures)


def _study_results(tables: Tables, files: Sequence[Path]) -> Mapping[str, Result]:
    found = by_case(tables["cases"])
    cases = partial(summary_table(found).to_csv, index=False, float_format="%.6g")
    return {"table": found, "cases": cases}


STUDY: Final = Study(
    rows=lambda seed: {"cases": all_cases(seed.number)}, results=_study_results, float_format=None
)
