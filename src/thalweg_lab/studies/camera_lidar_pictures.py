"""Marks of the pictures of a calibration field without pictures: true places, projected, with errors.

For studies over many seeds. Everything after the detection is the campaign's: the bundle of the reference
pictures, that of the boat's camera, and the joint covariance of static positions and cones that comes out of
it. A sheet is seen if it faces the camera, lies in the picture and is large enough; nothing hides it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.camera.boat_camera import orient_on_field
from thalweg.calibration.camera_lidar.statics import Statics, statics_of
from thalweg.calibration.field.description import FieldDescription, parse_field
from thalweg.calibration.field.network import measure_field
from thalweg.calibration.field.points import FieldPoints
from thalweg.core.camera.model import Camera
from thalweg.core.frames import LocalFrame
from thalweg.core.rigid import Rigid
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.voyage.yard_motion import FieldRun, standing
from thalweg_lab.yard.layout import Field, build_field
from thalweg_lab.yard.tour import tour
from thalweg_lab.yard_images.images import true_camera
from thalweg_lab.yard_records.records import description

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
    there = build_field(config, seed, when="boat")
    marks = seen_marks(there, boat, poses, generator(seed, "study boat marks"), how)
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
                    "image": image, "camera": camera.name, "marker": np.repeat(printed[seen], 4),
                    "corner": np.tile(np.arange(4), len(seen)), "x_px": at[:, 0], "y_px": at[:, 1],
                    "sigma_px": how.sigma_px,
                }
            )
        )  # fmt: skip
    return pd.concat(parts, ignore_index=True)


def _run(config: TwinConfig, seed: int, T_ics_ccs: Rigid, images: int) -> dict[str, Rigid]:
    """Poses of the boat's camera on its run."""
    run = FieldRun(config, seed)
    t = np.asarray(run.start_gps_s + _RUN_STEP_S * np.arange(images), dtype=np.float64)
    at, R = run.position_wcs_m(t), run.R_wcs_ics(t)
    return {f"run_{k}": Rigid(R=R[k], shift_m=at[k]) @ T_ics_ccs for k in range(images)}
