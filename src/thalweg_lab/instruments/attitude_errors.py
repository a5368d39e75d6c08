"""Errors of the INS's attitude: those that its sigmas contain, and drifts and magnetic errors on top."""

import numpy as np

from thalweg.core.types import ArrayF
from thalweg.settings.twin.navigation import TwinIns
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import gauss_markov, generator
from thalweg_lab.instruments.magnetic import magnetic_heading_error_rad
from thalweg_lab.voyage.motion import Motion


def attitude_errors_rad(config: TwinConfig, seed: int, t_gps_s: ArrayF, start_gps_s: float) -> ArrayF:
    """Errors (n, 3) of roll, pitch and heading: Gauss-Markov processes, and the heading's drift."""
    ins = config.ins
    rng = generator(seed, "ins attitude")
    sigmas = np.deg2rad([ins.sigma_roll_deg, ins.sigma_pitch_deg, ins.sigma_heading_deg])
    errors = [
        gauss_markov(rng, len(t_gps_s), 1.0 / ins.rate_hz, sigma, ins.attitude_time_s) for sigma in sigmas
    ]
    out = np.stack(errors, axis=1)
    out[:, 2] += np.deg2rad(ins.heading_drift_degpmin) / 60.0 * (t_gps_s - start_gps_s)
    return np.asarray(out)


def standing_drift_rad(ins: TwinIns, speed_mps: ArrayF) -> ArrayF:
    """Heading drift (n,) of a boat that stands still (T 3.1.1), lost again on the way.

    ``e' = drift`` while the speed is below ``standing_speed_mps``, ``e' = -e / standing_recovery_s`` above:
    without motion nothing but the gyroscopes carries the heading.
    """
    step_s = 1.0 / ins.rate_hz
    grow = np.deg2rad(ins.standing_drift_degpmin) / 60.0 * step_s
    keep = float(np.exp(-step_s / ins.standing_recovery_s))
    out = np.zeros(len(speed_mps))
    error = 0.0
    for i, standing in enumerate((np.asarray(speed_mps) < ins.standing_speed_mps).tolist()):
        error = error + grow if standing else error * keep
        out[i] = error
    return out


def unstated_heading_errors_rad(
    config: TwinConfig, motion: Motion, t_gps_s: ArrayF, boat_field_ics_mg: ArrayF
) -> ArrayF:
    """Heading errors (n,) that no sigma states: standing drift and the fields of the boat; 0 where off."""
    out = np.zeros(len(t_gps_s))
    if config.ins.standing_drift_degpmin:
        velocity = motion.velocity_wcs_mps(t_gps_s)
        out += standing_drift_rad(config.ins, np.hypot(velocity[:, 0], velocity[:, 1]))
    if np.any(boat_field_ics_mg):
        out += magnetic_heading_error_rad(config.ins, *motion.angles_rad(t_gps_s), boat_field_ics_mg)
    return out
