"""Published standard deviations of both prototypes beside those of a calibration (P3 Table 1, P4 6.4)."""

from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.frames import rotation_opk
from thalweg.core.rigid import opk_of
from thalweg.core.types import ArrayF
from thalweg.lightsheet.optics.sensor import CAMERA, LASER, PARAMETERS, Sensor

WITHIN: Final = 1.5
"""Factor up or down within which a published figure counts as met."""

PAPER_3: Final = {
    "laser z": 0.856, "laser phi": 0.871, "dx": 2.334, "dy": 0.287, "dz": 2.463,
    "d omega": 0.710, "d phi": 0.911, "d kappa": 0.212,
}  # fmt: skip
"""Sigmas of P3 Table 1, mm and degrees: laser, and camera relative to it."""

PAPER_4: Final = {
    "laser_x_mm": 0.07, "laser_y_mm": 0.08, "laser_z_mm": 0.12,
    "laser_omega_rad": 0.02, "laser_phi_rad": 0.06, "laser_kappa_rad": 0.04,
}  # fmt: skip
"""Sigmas of P4 6.4, mm and degrees; that of phi has no observational basis (`rank`)."""

_DOWN: Final = np.diag([1.0, -1.0, -1.0])
"""From lcs to the frame of P3, which has Z downwards."""
_FAN_Y: Final = rotation_opk(0.0, 0.0, np.pi / 2)
"""P3's fan lies along the laser's y axis."""
_STEP: Final = 1e-5


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


def paper_4_sigmas(cov: ArrayF) -> dict[str, float]:
    """Sigmas of the laser in mm and degrees, of the covariance (26, 26) of a sensor."""
    sigma = np.sqrt(np.diag(cov))
    return {
        name: float(np.rad2deg(sigma[i]) if name.endswith("_rad") else sigma[i])
        for name in PAPER_4
        for i in [PARAMETERS.index(name)]
    }
