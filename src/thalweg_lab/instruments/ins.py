"""The INS: attitudes with slowly varying errors, a single-frequency position, and its ANPP log.

The sigmas that the log states (packets 20 and 26) are those of the settings, the published ones by default: a
real unit does not know of the fields of the motors or of its drift either. The velocities of packet 20 have
errors that vary slowly, too; no packet of this log states their sigma.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.signal import lfilter

from thalweg.core import R_ENU_NED, ArrayF, LocalFrame, roll_pitch_heading, root_mean_square
from thalweg_lab import writers
from thalweg_lab.instruments.effects import damage_file
from thalweg_lab.instruments.misstated import as_it_errs, factors
from thalweg_lab.random_numbers import gauss_markov, generator
from thalweg_lab.settings import TwinConfig, TwinIns
from thalweg_lab.voyage import LEAD_S, Motion, epochs, motion_of, write_effects
from thalweg_lab.writers import moment, unix_us

_CHUNK: Final = 5000
_GRAVITY_MPS2: Final = 9.81
_STATUS_READY: Final = 0b0010_0000_0111 | 2 << 4
"""Orientation, INS and heading initialised, 3D fix, internal GNSS on."""
_STATUS_UTC: Final = 0b1000
_GYRO_NOISE_RADPS: Final = np.deg2rad(0.05)
_ACCEL_NOISE_MPS2: Final = 0.01
_MAGNETIC_NOISE_MG: Final = 0.5

EARTH_NED_MG: Final[ArrayF] = np.array([199.0, 15.0, 453.0])
"""Earth's field in Saxony in 2021 (IGRF): north, east, down; declination 4.3, inclination 66.2 degrees."""


# ---------------------------------------------------------------- INS


def simulate_ins(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    out_anpp: Path,
    *,
    motion: Motion | None = None,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Record the motion with the INS and write its ANPP log.

    Attitudes refer to the vertical and the north at the boat, positions to the ics origin. Packets: 20 at
    the rate of the settings, each with 26 and 28; 21 and 22 once a second; 3 at the beginning.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : the world frame.
    out_anpp : target.
    motion : of the boat; None: what the configuration asks for, see `motion_of`.
    out_effects : where to write what was done to the log (JSON), beside the truth.

    Returns
    -------
    facts : number of states, drift, fields of the boat, the heading error that no sigma
        states (RMS and extremes), and the defects of the log.

    Raises
    ------
    ConfigError : a leap second falls into the recording.
    """
    ins = config.ins
    motion = motion_of(config, seed) if motion is None else motion
    t = epochs(config, ins.rate_hz)
    boat_field = boat_field_mg(ins, _thrust(config, motion, t))
    unstated = unstated_heading_errors_rad(config, motion, t, boat_field)
    attitude = attitude_errors_rad(config, seed, t, motion.start_gps_s)
    attitude[:, 2] += unstated
    rng, true_m = generator(seed, "ins position"), as_it_errs(config, seed).ins.sigma_position_m
    position_error = np.stack(
        [gauss_markov(rng, len(t), 1.0 / ins.rate_hz, s, ins.position_time_s) for s in true_m], axis=1
    )
    velocity_error = velocity_errors_mps(config, seed, len(t))
    noise = generator(seed, "ins raw")
    out_anpp.parent.mkdir(parents=True, exist_ok=True)
    with out_anpp.open("wb") as file:
        file.write(writers.anpp_device_information(4400, 1000, (20, 21, 512)))
        for first in range(0, len(t), _CHUNK):
            part = slice(first, first + _CHUNK)
            rows = _rows(
                motion,
                frame,
                t[part],
                attitude[part],
                position_error[part],
                velocity_error[part],
                boat_field[part],
                noise,
            )
            for row in rows:
                file.write(_packets(config, row))
    facts = {
        "states": len(t),
        "utc_known_after_s": config.effects.ins_clock_late_s,
        "heading_drift_degpmin": ins.heading_drift_degpmin,
        "hard_iron_mg": list(ins.hard_iron_mg),
        "motor_field_mg": [list(field) for field in ins.motor_field_mg],
        "boat_field_max_mg": float(np.linalg.norm(boat_field, axis=1).max(initial=0.0)),
        "unstated_heading_error_deg": _extent_deg(unstated),
        "error_factors": factors(config, seed),
        **damage_file(out_anpp, "ins", config.effects, generator(seed, "ins effects")),
    }
    write_effects(out_effects, "ins", facts)
    return facts


def velocity_errors_mps(config: TwinConfig, seed: int, n: int) -> ArrayF:
    """Errors (n, 3) of the velocity north, east, down: Gauss-Markov processes."""
    ins = as_it_errs(config, seed).ins
    rng = generator(seed, "ins velocity")
    axes = [
        gauss_markov(rng, n, 1.0 / ins.rate_hz, ins.sigma_velocity_mps, ins.velocity_time_s) for _ in range(3)
    ]
    return np.stack(axes, axis=1)


def _thrust(config: TwinConfig, motion: Motion, t: ArrayF) -> ArrayF:
    """Thrust (n, 2) of the motors, where their field asks for it."""
    return motion.thrust(t) if np.any(config.ins.motor_field_mg) else np.zeros((len(t), 2))


def _extent_deg(errors_rad: ArrayF) -> dict[str, float]:
    """RMS, least and greatest of errors, degrees."""
    degrees = np.rad2deg(errors_rad)
    return {"rms": root_mean_square(degrees), "min": float(degrees.min()), "max": float(degrees.max())}


def _rows(
    motion: Motion,
    frame: LocalFrame,
    t: ArrayF,
    attitude_error: ArrayF,
    position_error: ArrayF,
    velocity_error: ArrayF,
    boat_field_mg: ArrayF,
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """What the INS reports at its epochs, as plain lists."""
    lat, lon, height = frame.to_geodetic(motion.position_wcs_m(t) + position_error)
    R_wcs_ics = motion.R_wcs_ics(t)
    R_wcs_enu = frame.R_wcs_enu(lat, lon)
    R_enu_ics = np.swapaxes(R_wcs_enu, 1, 2) @ R_wcs_ics
    angles = np.stack(roll_pitch_heading(R_enu_ics), axis=1) + attitude_error
    angles[:, 2] = np.mod(angles[:, 2], 2 * np.pi)
    to_enu = np.swapaxes(R_wcs_enu, 1, 2)
    velocity_ned = np.einsum("nij,nj->ni", to_enu, motion.velocity_wcs_mps(t)) @ R_ENU_NED.T
    acceleration = np.einsum("nij,nj->ni", to_enu, motion.velocity_wcs_mps(t, 2))
    to_body = np.swapaxes(R_enu_ics, 1, 2)
    body = np.einsum("nij,nj->ni", to_body, acceleration)
    force = np.einsum("nij,nj->ni", to_body, acceleration + np.array([0.0, 0.0, _GRAVITY_MPS2]))
    rates = motion.rates_ics_radps(t)
    magnetic = np.einsum("nij,j->ni", to_body, R_ENU_NED @ EARTH_NED_MG) + boat_field_mg
    n = len(t)
    columns: dict[str, Any] = {
        "since_start": t - motion.start_gps_s,
        "unix_us": unix_us(motion.config, t),
        "place": np.stack([np.deg2rad(lat), np.deg2rad(lon), height], axis=1),
        "velocity": velocity_ned + velocity_error,
        "acceleration": body,
        "g": np.linalg.norm(force, axis=1) / 9.80665,
        "angles": angles,
        "rates": rates + rng.normal(0, _GYRO_NOISE_RADPS / 5, (n, 3)),
        "accel_raw": force + rng.normal(0, _ACCEL_NOISE_MPS2, (n, 3)),
        "gyro_raw": rates + rng.normal(0, _GYRO_NOISE_RADPS, (n, 3)),
        "magnetic": magnetic + rng.normal(0, _MAGNETIC_NOISE_MG, (n, 3)),
    }
    plain = {name: value.tolist() for name, value in columns.items()}
    return [dict(zip(plain, values, strict=True)) for values in zip(*plain.values(), strict=True)]


def _packets(config: TwinConfig, row: dict[str, Any]) -> bytes:
    ins = config.ins
    running_s = row["since_start"] + LEAD_S + 1.0
    synchronised = row["since_start"] >= config.effects.ins_clock_late_s or (
        config.effects.ins_clock_late_s == 0
    )
    unix_us = row["unix_us"] if synchronised else round(running_s * 1e6)
    status = _STATUS_READY | (_STATUS_UTC if synchronised else 0)
    east, north, up = ins.sigma_position_m
    out = writers.anpp_system_state(
        0,
        status,
        unix_us,
        row["place"],
        row["velocity"],
        row["acceleration"],
        row["g"],
        row["angles"],
        row["rates"],
        (north, east, up),
    )
    sigmas = np.deg2rad([ins.sigma_roll_deg, ins.sigma_pitch_deg, ins.sigma_heading_deg]).tolist()
    out += writers.anpp_orientation_sigma(sigmas)
    out += writers.anpp_raw_sensors(row["accel_raw"], row["gyro_raw"], row["magnetic"], 31.0, 98_100.0, 29.5)
    if unix_us % 1_000_000 < 1_000_000 / ins.rate_hz:
        when = moment(unix_us)
        day = when.timetuple().tm_yday - 1
        out += writers.anpp_unix_time(unix_us)
        out += writers.anpp_formatted_time(
            when.microsecond, when.year, day, when.month - 1, when.day, (when.hour, when.minute, when.second)
        )
    return out


# ---------------------------------------------------------------- errors of the attitude


def attitude_errors_rad(config: TwinConfig, seed: int, t_gps_s: ArrayF, start_gps_s: float) -> ArrayF:
    """Errors (n, 3) of roll, pitch and heading: Gauss-Markov processes, and the heading's drift."""
    ins = as_it_errs(config, seed).ins
    rng = generator(seed, "ins attitude")
    sigmas = np.deg2rad([ins.sigma_roll_deg, ins.sigma_pitch_deg, ins.sigma_heading_deg])
    errors = [
        gauss_markov(rng, len(t_gps_s), 1.0 / ins.rate_hz, sigma, ins.attitude_time_s) for sigma in sigmas
    ]
    out = np.stack(errors, axis=1)
    out[:, 2] += np.deg2rad(ins.heading_drift_degpmin) / 60.0 * (t_gps_s - start_gps_s)
    return np.asarray(out)


def unstated_heading_errors_rad(
    config: TwinConfig, motion: Motion, t_gps_s: ArrayF, boat_field_ics_mg: ArrayF
) -> ArrayF:
    """Heading errors (n,) that no sigma states, from the fields of the boat; 0 where off."""
    if not np.any(boat_field_ics_mg):
        return np.zeros(len(t_gps_s))
    return magnetic_heading_error_rad(config.ins, *motion.angles_rad(t_gps_s), boat_field_ics_mg)


# ---------------------------------------------------------------- magnetometer
#
# T 2.2.1 names the magnetometer among the INS's sensors; the abstracts of T and P2 name errors of the
# orientation from the electromagnetic fields of the boat's rotors. A lead with the current I and its return
# at a distance d make a field of about ``mu_0 I d / (2 pi r^2)`` at the distance r (Biot-Savart): 4.4 mG
# for 10 A, 2 cm and 0.3 m, against 200 mG of the Earth's horizontal field, so 1.3 degrees.


def boat_field_mg(ins: TwinIns, thrust: ArrayF) -> ArrayF:
    """Field (n, 3) of the boat itself at the INS, body frame: hard iron and the currents of the motors.

    Parameters
    ----------
    ins : section ``twin.ins``.
    thrust : (n, 2) thrust of the left and the right motor as a share of the full one; the current is taken as
        proportional to it.
    """
    return np.asarray(np.asarray(thrust) @ np.asarray(ins.motor_field_mg) + np.asarray(ins.hard_iron_mg))


def levelled_error_rad(
    roll_rad: ArrayF, pitch_rad: ArrayF, heading_rad: ArrayF, boat_field_ics_mg: ArrayF
) -> ArrayF:
    """Heading error (n,) of a magnetic compass that levels its field with the true roll and pitch.

    The compass takes the horizontal field for magnetic north, ``atan2(-h_right, h_forward)``; its error is
    the angle between the disturbed and the undisturbed horizontal field. In the level frame that looks along
    the heading the undisturbed field is ``H (cos(heading - declination), -sin(heading - declination))``.
    """
    north, east, _ = EARTH_NED_MG
    forward = north * np.cos(heading_rad) + east * np.sin(heading_rad)
    right = east * np.cos(heading_rad) - north * np.sin(heading_rad)
    x, y, z = np.asarray(boat_field_ics_mg, dtype=np.float64).T
    sr, cr = np.sin(roll_rad), np.cos(roll_rad)
    # R_y(pitch) R_x(roll) of the body vector, its horizontal part.
    turned = sr * y + cr * z
    b_forward = np.cos(pitch_rad) * x + np.sin(pitch_rad) * turned
    b_right = cr * y - sr * z
    disturbed = np.arctan2(-(right + b_right), forward + b_forward)
    error = disturbed - np.arctan2(-right, forward)
    return np.asarray(np.mod(error + np.pi, 2 * np.pi) - np.pi)


def low_pass(values: ArrayF, step_s: float, time_s: float) -> ArrayF:
    """First-order low pass (n,), settled on the first value: ``y' = (x - y) / time``, exact for steps."""
    if not len(values):
        return np.asarray(values)
    a = float(np.exp(-step_s / time_s))
    out, _ = lfilter([1.0 - a], [1.0, -a], values, zi=[a * float(values[0])])
    return np.asarray(out)


def magnetic_heading_error_rad(
    ins: TwinIns, roll_rad: ArrayF, pitch_rad: ArrayF, heading_rad: ArrayF, boat_field_ics_mg: ArrayF
) -> ArrayF:
    """Heading error (n,) of the INS at its epochs.

    Gyroscopes carry the heading over short times and the magnetometer draws it with its time constant: the
    error of the filter's heading is the low-passed error of the compass, times ``magnetic_weight``.
    """
    compass = levelled_error_rad(roll_rad, pitch_rad, heading_rad, boat_field_ics_mg)
    return ins.magnetic_weight * low_pass(np.unwrap(compass), 1.0 / ins.rate_hz, ins.magnetic_time_s)
