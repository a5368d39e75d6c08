"""What a calibration of the light sheet says of itself: tables, a JSON report, the file of the sensor.

Published standard deviations of both prototypes stand beside its own (P3 Table 1, P4 6.4).
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import ArrayF, opk_of, rotation_opk, write_marked
from thalweg.core.calibration import Source
from thalweg.lightsheet.calibration.model import LINE, PAIRS, depth_sigmas
from thalweg.lightsheet.calibration.sheet_calibration import SheetCalibration
from thalweg.lightsheet.optics import CAMERA, LASER, PARAMETERS, Sensor, write_sensor

KIND: Final = "light sheet calibration"
VERSION: Final = 1
STRONG: Final = 0.9
"""Correlations worth a line in the report."""

WITHIN: Final = 1.5
"""Factor up or down within which a published figure counts as met."""

PAPER_3: Final = {
    "laser z": 0.856, "laser phi": 0.871, "dx": 2.334, "dy": 0.287, "dz": 2.463,
    "d omega": 0.710, "d phi": 0.911, "d kappa": 0.212,
}  # fmt: skip
"""Sigmas of P3 Table 1, mm and degrees: laser, and camera relative to it."""

PAPER_4: Final = {
    "laser_x_mm": 0.07,
    "laser_y_mm": 0.08,
    "laser_z_mm": 0.12,
    "laser_omega_rad": 0.02,
    "laser_phi_rad": 0.06,
    "laser_kappa_rad": 0.04,
}
"""Sigmas of P4 6.4, mm and degrees; that of phi has no observational basis (`rank`)."""

_DOWN: Final = np.diag([1.0, -1.0, -1.0])
"""From lcs to the frame of P3, which has Z downwards."""
_FAN_Y: Final = rotation_opk(0.0, 0.0, np.pi / 2)
"""P3's fan lies along the laser's y axis."""
_STEP: Final = 1e-5


def parameter_table(found: SheetCalibration) -> pd.DataFrame:
    """Unknowns and fixed parameters: name, unit, value, three sigmas, how it was treated.

    ``sigma_image`` comes from line points, pairs and what was known beforehand of the unknowns; ``sigma`` has
    the parameters that were held fixed as well. Angles are in degrees.
    """
    u = len(found.estimated)
    known = set(found.problem.known)
    rows = []
    for i, name in enumerate(found.names):
        angle = name.endswith("_rad")
        factor = float(np.rad2deg(1.0)) if angle else 1.0
        rows.append(
            {
                "name": name.replace("_rad", "_deg") if angle else name,
                "value": float(found.values[i]) * factor,
                "sigma": float(np.sqrt(found.cov[i, i])) * factor,
                "sigma_image": float(found.adjusted.sigmas[i]) * factor if i < u else np.nan,
                "treated": ("known beforehand, estimated" if name in known else "estimated")
                if i < u
                else "held fixed, considered",
            }
        )
    return pd.DataFrame(rows)


def residual_table(found: SheetCalibration) -> pd.DataFrame:
    """Line points: row of the input table, level, x_px, y_px, residual_px, standardised, used."""
    line, names = found.problem.line, [level.name for level in found.problem.grid.levels]
    return pd.DataFrame(
        {
            "row": found.correspondence.rows,
            "level": [names[k] for k in line.level],
            "x_px": line.xy_px[:, 0],
            "y_px": line.xy_px[:, 1],
            "residual_px": found.problem.residuals_px(found.adjusted.x),
            "standardised": found.adjusted.standardised[LINE],
            "used": found.adjusted.used[LINE],
        }
    )


def pair_table(found: SheetCalibration) -> pd.DataFrame:
    """Pairs of ends: places in the picture, fan angles apart, standardised, used."""
    pairs = found.problem.pairs
    return pd.DataFrame(
        {
            "upper_x_px": pairs.upper_px[:, 0],
            "upper_y_px": pairs.upper_px[:, 1],
            "lower_x_px": pairs.lower_px[:, 0],
            "lower_y_px": pairs.lower_px[:, 1],
            "side": pairs.side,
            "apart_deg": np.rad2deg(found.adjusted.residuals[PAIRS]),
            "standardised": found.adjusted.standardised[PAIRS],
            "used": found.adjusted.used[PAIRS],
        }
    )


def strong_correlations(found: SheetCalibration, limit: float = STRONG) -> list[tuple[str, str, float]]:
    """Pairs of parameters whose correlation exceeds a limit, the strongest first."""
    rho = found.correlation()
    i, j = np.nonzero(np.tril(np.abs(rho) > limit, k=-1))
    order = np.argsort(-np.abs(rho[i, j]), kind="stable")
    return [(found.names[j[k]], found.names[i[k]], float(rho[i[k], j[k]])) for k in order]


def calibration_report(found: SheetCalibration) -> dict[str, Any]:
    """Everything that a reader needs to judge a calibration, as plain values."""
    grid = found.problem.grid
    used, pairs = found.adjusted.used[LINE], found.adjusted.used[PAIRS]
    residual = found.problem.residuals_px(found.adjusted.x)
    levels = {}
    for k, level in enumerate(grid.levels):
        mine = (found.problem.line.level == k) & used
        levels[level.name] = {
            "depth_mm": level.depth_mm,
            "points": int(mine.sum()),
            "gaps": found.correspondence.gaps[k],
            "rms_px": float(np.sqrt(np.nanmean(np.square(residual[mine])))) if mine.any() else None,
            "bias_px": float(np.nanmean(residual[mine])) if mine.any() else None,
        }
    low, high = float(grid.depths_mm[0]), float(grid.depths_mm[-1])
    depths = sorted({max(low - 25.0, 5.0), low, 0.5 * (low + high), high, high + 50.0})
    return {
        "object": grid.name,
        "parameters": [_plain(row) for row in parameter_table(found).to_dict("records")],
        "correlations": [[a, b, round(rho, 4)] for a, b, rho in strong_correlations(found)],
        "line_points": {
            "used": int(used.sum()),
            "rejected": int((~used).sum()),
            "rms_px": found.misfit_px,
            "sigma0": found.sigma0[LINE],
            "neighbours_with_one_error": found.shared_points,
            **_factor(found, LINE),
        },
        "pairs": {
            "used": int(pairs.sum()),
            "rejected": int((~pairs).sum()),
            "sigma0": found.sigma0[PAIRS],
            **_factor(found, PAIRS),
        },
        "dropped": dict(found.correspondence.counts),
        "levels": levels,
        "sigma_of_depth": [_plain(row) for row in depth_sigmas(found.sensor, depths).to_dict("records")],
        "warnings": list(found.warnings),
    }


def write_calibrated(
    folder: Path, found: SheetCalibration, *, source: Source, name: str = "light_sheet"
) -> tuple[Path, Path]:
    """Write the sensor (YAML) and the report (JSON) beside it; returns both paths."""
    sensor, report = folder / f"{name}.yaml", folder / f"{name}.report.json"
    write_sensor(sensor, found.sensor, source=source)
    write_marked(report, kind=KIND, version=VERSION, content={"calibration": calibration_report(found)})
    return sensor, report


def verdicts(ours: dict[str, float], published: dict[str, float]) -> pd.DataFrame:
    """Quantity, our sigma, the published one, their ratio, and whether it is met.

    Parameters
    ----------
    ours : sigmas; NaN or missing where none can be had.
    published : sigmas.
    """
    rows = []
    for name, value in published.items():
        own = ours.get(name, np.nan)
        ratio = own / value
        if not np.isfinite(ratio) or own == 0.0:
            verdict = "not estimable"
        elif 1 / WITHIN <= ratio <= WITHIN:
            verdict = "met"
        else:
            verdict = "smaller" if ratio < 1 else "larger"
        rows.append({"quantity": name, "ours": own, "published": value, "ratio": ratio, "verdict": verdict})
    return pd.DataFrame(rows)


def sensor_sigmas(sensor: Sensor) -> dict[str, float]:
    """Sigmas of a sensor's parameters in mm and degrees, by name; NaN where there is none."""
    sigma = np.sqrt(np.maximum(np.diag(sensor.cov), 0.0))
    unit = np.array([np.rad2deg(1.0) if name.endswith("_rad") else 1.0 for name in PARAMETERS])
    return dict(zip(PARAMETERS, np.where(sigma > 0.0, sigma * unit, np.nan).tolist(), strict=True))


def paper_3_sigmas(x: ArrayF, cov: ArrayF) -> dict[str, float]:
    """Sigmas of the quantities of P3 Table 1.

    Parameters
    ----------
    x, cov : (26,) and (26, 26) of `PARAMETERS`.
    """
    J = np.zeros((len(PAPER_3), len(PARAMETERS)))
    for i in [*range(CAMERA.start, CAMERA.stop), *range(LASER.start, LASER.stop)]:
        step = np.zeros(len(PARAMETERS))
        step[i] = _STEP
        off = paper_3_table(x + step) - paper_3_table(x - step)
        off[[1, 5, 6, 7]] = (off[[1, 5, 6, 7]] + 180.0) % 360.0 - 180.0
        J[:, i] = off / (2 * _STEP)
    return dict(zip(PAPER_3, np.sqrt(np.diag(J @ cov @ J.T)).tolist(), strict=True))


def paper_3_table(x: ArrayF) -> ArrayF:
    """Values (8,) of P3 Table 1, mm and degrees: laser z and phi, camera minus laser, relative rotation.

    ``R_relative = R_camera R_laser^-1`` in the frame with Z downwards, the laser's beam along its +z and its
    fan along its y, the camera looking along its -z.
    """
    camera, laser = x[CAMERA], x[LASER]
    R_camera = _DOWN @ rotation_opk(*(float(v) for v in camera[3:]))
    R_laser = _DOWN @ rotation_opk(*(float(v) for v in laser[3:])) @ _FAN_Y.T @ _DOWN
    angles = np.rad2deg([*opk_of(R_laser), *opk_of(R_camera @ R_laser.T)])
    off = camera[:3] - laser[:3]
    return np.array([laser[2], angles[1], *off, *angles[3:]])


def _factor(found: SheetCalibration, kind: str) -> dict[str, float]:
    """Factor of the stated sigmas, and by what factor it may be wrong (2 if the picture says nothing)."""
    factor = found.sigma_factor[kind]
    return {"sigma_factor": factor.value, "sigma_factor_within": float(np.exp(factor.width))}


def _plain(row: dict[Any, Any]) -> dict[str, Any]:
    """A row without NaN, which JSON does not know."""
    return {
        str(key): None if isinstance(value, float) and not np.isfinite(value) else value
        for key, value in row.items()
    }
