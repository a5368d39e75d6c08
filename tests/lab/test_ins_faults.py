"""Faults of the INS: each has the size that its settings say, and leaves everything else alone."""

import json
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.lab.conftest import FRAME, SEED
from thalweg.ingest import PoseLog
from thalweg.ingest.anpp import find_packets, read_anpp
from thalweg_lab.instruments import attitude_errors_rad, simulate_ins
from thalweg_lab.instruments.ins import levelled_error_rad, low_pass, magnetic_heading_error_rad
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import Voyage, epochs

HORIZONTAL_MG = float(np.hypot(199.0, 15.0))
DECLINATION = float(np.arctan2(15.0, 199.0))
MOTORS = [[3.0, -4.0, 1.0], [3.0, 4.0, -1.0]]


SENSORS = {"accel": "mps2", "gyro": "radps", "mag": "mg"}


def twin(**ins):
    return TwinConfig.of_size("tiny", duration_s=8.0, ins=ins)


@dataclass(slots=True, kw_only=True)
class Log(PoseLog):
    """A log with its raw sensors (packets 28), which the reader leaves aside."""

    raw: pd.DataFrame


def raw_sensors(data):
    found = find_packets(np.frombuffer(data, np.uint8))
    values = found.payloads(np.flatnonzero(found.kind == 28), 48).view("<f4").astype(np.float64)
    axes = [f"{name}_{axis}_{unit}" for name, unit in SENSORS.items() for axis in "xyz"]
    return pd.DataFrame(values, columns=[*axes, "temperature", "pressure", "pressure_temperature"])


def record(folder, config):
    """The log as the reader sees it, what was done to it, and its bytes."""
    path = folder / "ins.anpp"
    facts = simulate_ins(config, SEED, FRAME, path, out_effects=folder / "ins.json")
    assert json.loads((folder / "ins.json").read_text()) == json.loads(json.dumps({"stream": "ins", **facts}))
    log, data = read_anpp([path]), path.read_bytes()
    return (
        Log(**{each.name: getattr(log, each.name) for each in fields(log)}, raw=raw_sensors(data)),
        facts,
        data,
    )


def magnetometer(log):
    return log.raw[["mag_x_mg", "mag_y_mg", "mag_z_mg"]].to_numpy()


def wrapped(angle):
    return np.mod(np.asarray(angle) + np.pi, 2 * np.pi) - np.pi


def assert_equal_but(first, second, *columns):
    """The tables differ in those columns only."""
    different = {name for name in first.columns if not first[name].equals(second[name])}
    assert different == set(columns)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return record(tmp_path_factory.mktemp("plain"), twin())


# ---------------------------------------------------------------- magnetic field


@pytest.mark.parametrize("heading_deg", [0.0, 4.31, 90.0, 200.0, 359.0])
@pytest.mark.parametrize("field", [(10.0, 0.0, 0.0), (0.0, 10.0, 0.0), (-7.0, 12.0, 30.0)])
def test_the_heading_error_has_its_closed_form(heading_deg, field):
    """A field d at the angle beta from magnetic north turns it by atan2(d sin b, H + d cos b)."""
    heading = np.deg2rad(heading_deg)
    d = np.hypot(field[0], field[1])
    beta = heading + np.arctan2(field[1], field[0]) - DECLINATION
    # North that seems to lie further east makes headings smaller.
    expected = -np.arctan2(d * np.sin(beta), HORIZONTAL_MG + d * np.cos(beta))
    zero = np.zeros(1)
    found = levelled_error_rad(zero, zero, np.array([heading]), np.array([field]))
    assert_allclose(found, expected, atol=1e-12)


def test_the_filter_follows_with_its_time_constant():
    step = np.concatenate([np.zeros(100), np.ones(400)])
    followed = low_pass(step, 0.02, 2.0)
    t = np.arange(1, 401) * 0.02
    assert_allclose(followed[100:], 1 - np.exp(-t / 2.0), atol=1e-12)
    assert (followed[:100] == 0).all()
    assert_array_equal(low_pass(np.full(5, 3.0), 0.02, 2.0), np.full(5, 3.0))
    assert low_pass(np.empty(0), 0.02, 2.0).size == 0
    ins = twin(magnetic_weight=0.25, magnetic_time_s=1e-6).ins
    zero = np.zeros(3)
    boat = np.full((3, 3), 5.0)
    whole = levelled_error_rad(zero, zero, zero, boat)
    assert_allclose(magnetic_heading_error_rad(ins, zero, zero, zero, boat), whole / 4, rtol=1e-12)


def test_motor_fields_move_heading_and_magnetometer_and_nothing_else(tmp_path, plain):
    config = twin(motor_field_mg=MOTORS, magnetic_time_s=3.0)
    log, facts, _ = record(tmp_path, config)
    before = plain[0]
    assert_equal_but(before.states, log.states, "heading_rad")
    assert_equal_but(before.raw, log.raw, "mag_x_mg", "mag_y_mg", "mag_z_mg")
    voyage, t = Voyage(config, SEED), epochs(config, 50.0)
    thrust = voyage.thrust(t)
    assert np.ptp(thrust[:, 0] - thrust[:, 1]) > 0.05, "a voyage with turns"
    field = thrust @ np.array(MOTORS)
    # float32 at 453 mG: steps of 3e-5.
    assert_allclose(magnetometer(log) - magnetometer(before), field, atol=7e-5)
    compass = levelled_error_rad(*voyage.angles_rad(t), field)
    expected = low_pass(compass, 0.02, 3.0)
    found = wrapped(log.states["heading_rad"] - before.states["heading_rad"])
    # float32 headings up to 2 pi: steps of 5e-7, in both logs.
    assert_allclose(found, expected, atol=1.1e-6)
    assert np.rad2deg(np.abs(found)).max() > 0.2, "an effect worth the name"
    assert facts["unstated_heading_error_deg"]["max"] == pytest.approx(np.rad2deg(found.max()), abs=1e-4)
    assert facts["boat_field_max_mg"] == pytest.approx(np.linalg.norm(field, axis=1).max(), rel=1e-9)
    # What the unit says of itself does not know of it.
    assert np.rad2deg(log.states["sigma_heading_rad"]).to_numpy() == pytest.approx(0.2, rel=1e-6)


# ---------------------------------------------------------------- the errors that the sigmas contain


def test_errors_are_correlated_over_their_time():
    """Autocorrelation exp(-lag / time) at half, one and two correlation times, in all three angles."""
    config = twin(attitude_time_s=2.0)
    t = np.arange(60_000) / 50.0
    errors = attitude_errors_rad(config, SEED, t, 0.0)
    for lag_s in (1.0, 2.0, 4.0):
        lag = round(lag_s * 50)
        found = np.mean(errors[lag:] * errors[:-lag], axis=0) / np.var(errors, axis=0)
        # 1200 s hold 600 correlation times: a coefficient is known to 0.04 (Bartlett).
        assert_allclose(found, np.exp(-lag_s / 2.0), atol=0.13)


def test_positions_and_velocities_have_their_sigmas_and_times_two_sided(tmp_path):
    """P1: 0.6 m in plan, 1 m in height; 0.05 m/s; here with a short correlation, so that one log shows it."""
    config = TwinConfig.of_size("tiny", duration_s=25.0, ins={"position_time_s": 0.2, "velocity_time_s": 0.2})
    simulate_ins(config, SEED, FRAME, tmp_path / "ins.anpp")
    states = read_anpp([tmp_path / "ins.anpp"]).states
    t, voyage = epochs(config, 50.0), Voyage(config, SEED)
    place = FRAME.from_geodetic(states["lat_deg"], states["lon_deg"], states["h_ell_m"])
    velocity = states[["v_east_mps", "v_north_mps", "v_down_mps"]] * [1, 1, -1]
    error = np.hstack([place - voyage.position_wcs_m(t), velocity - voyage.velocity_wcs_mps(t)])
    error /= [0.6, 0.6, 1.0, 0.05, 0.05, 0.05]
    # 29 s hold 73 independent values: a sigma is known to 8 %, a mean to 0.12.
    assert_allclose(error.std(axis=0), 1.0, rtol=0.3)
    assert_allclose(error.mean(axis=0), 0.0, atol=0.48)
    lagged = np.mean(error[10:] * error[:-10], axis=0) / np.var(error, axis=0)
    assert_allclose(lagged, np.exp(-1.0), atol=0.3)
    # Axes of their own.
    assert np.max(np.abs(np.corrcoef(error.T) - np.eye(6))) < 0.5
    stated = states[["sigma_east_m", "sigma_north_m", "sigma_up_m"]]
    assert_allclose(stated, np.tile([0.6, 0.6, 1.0], (len(states), 1)), rtol=1e-6)
