"""How well a rig of two lenses is calibrated, and whether its covariance says so: many rigs in one room.

Each seed is another device (lenses, base, tilt), another survey of the room's marks and other poses. Marks
have the noise that is measured in rendered pictures; the pictures themselves are left out, so that many seeds
are affordable. Errors are judged from both sides: as sizes, and as squares in units of the joint covariance.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.calibration import LENSES, Rig, RigCalibration, calibrate_rig
from thalweg.core import ArrayF, Camera
from thalweg.settings.sections import Rig as RigSettings
from thalweg.settings.twin import TwinDualFisheye
from thalweg_lab.dual_fisheye import TrueRig, room_marks, room_points, true_rig
from thalweg_lab.studies import Result, Seed, Study, Tables

UNKNOWNS: Final = 22
"""Both interiors and the relative orientation."""
WIDEST_DEG: Final = 95.0
PANORAMA_PX: Final = 5376
"""Width of the panoramas of a Ricoh Theta V."""
BASE_MM: Final = 0.3
ANGLE_DEG: Final = 0.02
LENS_PX: Final = 0.1
SEAM_PX: Final = 1.0
SQUARES: Final = (0.7, 1.4)
"""Bounds of the figures, see `rig_table`."""


def rig_rows(seed: Seed) -> Tables:
    """Errors of one calibrated rig.

    Parameters
    ----------
    seed : sizes ``exposures`` and ``sigma_px``.
    """
    true = true_rig(TwinDualFisheye(), seed.number)
    marks, _ = room_marks(
        true, seed.number, int(seed.sizes["exposures"]), sigma_px=float(seed.sizes["sigma_px"])
    )
    points, _ = room_points(seed.number, true.settings.sigma_field_m)
    found = calibrate_rig(marks, points, RigSettings())
    return {"rigs": pd.DataFrame([{"seed": seed.number, **errors_of(found, true)}])}


def errors_of(found: RigCalibration, true: TrueRig) -> dict[str, float]:
    """Errors of a calibrated rig: sizes, and squares in units of the joint covariance."""
    rig = found.rig
    pose = rig.T_back_front.error_from(true.T_back_front)
    error = np.concatenate(
        [*(rig.cameras[name].parameters - true.cameras[name].parameters for name in LENSES), pose]
    )
    sigma = rig.T_back_front.sigma_shift_m
    return {
        "base_mm": 1e3 * (rig.base_m - float(np.linalg.norm(true.T_back_front.shift_m))),
        "sigma_base_mm": 1e3 * float(sigma[2]),
        "rotation_deg": float(np.rad2deg(np.linalg.norm(pose[3:]))),
        "squares": float(error @ np.linalg.solve(found.cov, error)) / UNKNOWNS,
        "pose_squares": float(pose @ np.linalg.solve(rig.T_back_front.cov, pose)) / 6,
        "lens_px": max(lens_error_px(rig.cameras[name], true.cameras[name]) for name in LENSES),
        # ranges of a cloud err by far less than a twentieth
        "seam_depth_px": max(seam_px(rig, true, range_m, 1.05 * range_m) for range_m in (2.0, 5.0, 10.0)),
        "seam_far_px": seam_px(rig, true, 2.0, np.inf),
        "sigma0": float(found.report["sigma0"]),
    }


def lens_error_px(found: Camera, true: Camera, widest_deg: float = WIDEST_DEG) -> float:
    """Largest distance of the pixels of two interiors, up to an angle from the axis."""
    t, a = np.meshgrid(np.deg2rad(np.linspace(0, widest_deg, 96)), np.linspace(0, 2 * np.pi, 73))
    rays = np.stack([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)], axis=-1).reshape(-1, 3)
    return float(np.linalg.norm(found.project(rays) - true.project(rays), axis=1).max())


def seam_px(rig: Rig, true: TrueRig, range_m: float, taken_m: float) -> float:
    """How far both lenses show things beside each other at the seam of a panorama, rms of all azimuths.

    Parameters
    ----------
    rig : as it was calibrated, which makes the panorama.
    true : what took the picture.
    range_m, taken_m : true range from the middle of the rig, and that of the panorama.

    Returns
    -------
    shift : of things at right angles to the axis, pixels of a panorama of `PANORAMA_PX`.
    """
    azimuth = np.arange(72) * 2 * np.pi / 72
    things = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(72)], axis=1) * range_m
    shown = []
    for name, place in true.T_front_lens.items():
        seen = true.cameras[name].project((things + true.centre_front_m - place.shift_m) @ place.R)
        T = rig.T_front_lens[name]
        rays = rig.cameras[name].rays(seen) @ T.R.T
        # where the ray meets the sphere of the range about the middle of the calibrated rig
        origin = (T.shift_m - rig.centre_front_m) / taken_m
        along = rays @ origin
        shown.append(origin + (np.sqrt(along**2 - origin @ origin + 1) - along)[:, None] * rays)
    shift = np.linalg.norm(shown[0] - shown[1], axis=1)
    return float(np.sqrt(np.mean(shift**2))) * PANORAMA_PX / (2 * np.pi)


def rig_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Figures over all seeds with their bounds: measure, value, low, high, seeds."""
    n = len(rows)

    def band(k: int) -> tuple[float, float]:
        """Of a mean square of that many numbers, at 99 %, and not wider than `SQUARES`."""
        low, high = (float(chi2.ppf(p, k * n)) / (k * n) for p in (0.005, 0.995))
        return max(low, SQUARES[0]), min(high, SQUARES[1])

    def size(values: ArrayF) -> float:
        """Root mean square."""
        return float(np.sqrt(np.mean(np.square(values))))

    base, turn = rows["base_mm"].to_numpy(), rows["rotation_deg"].to_numpy()
    figures: list[tuple[str, float, float, float]] = [
        ("base, rms error, mm", size(base), 0.0, BASE_MM),
        ("base, largest error, mm", float(np.abs(base).max()), 0.0, BASE_MM),
        ("base, mean of the stated sigmas, mm", float(rows["sigma_base_mm"].mean()), 0.0, BASE_MM),
        ("relative rotation, rms error, deg", size(turn), 0.0, ANGLE_DEG),
        ("relative rotation, largest error, deg", float(turn.max()), 0.0, ANGLE_DEG),
        ("interiors to 95 degrees, largest error, px", float(rows["lens_px"].max()), 0.0, LENS_PX),
        ("seam at 2 to 10 m, ranges 5 % wrong, largest rms, px", rows["seam_depth_px"].max(), 0.0, SEAM_PX),
        ("seam at 2 m, all taken to be far, mean rms, px", rows["seam_far_px"].mean(), 8.0, 8.6),
        ("NEES, all 22 unknowns", float(rows["squares"].mean()), *band(UNKNOWNS)),
        ("NEES, relative orientation", float(rows["pose_squares"].mean()), *band(6)),
    ]
    return pd.DataFrame(
        [(*figure, n) for figure in figures], columns=["measure", "value", "low", "high", "seeds"]
    )


def _results(tables: Tables, _: Sequence[Path]) -> Mapping[str, Result]:
    return {"table": rig_table(tables["rigs"]), "rigs": tables["rigs"]}


STUDY: Final = Study(rows=rig_rows, results=_results)
