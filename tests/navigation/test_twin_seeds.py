"""Are the sigmas of the trajectory consistent? Raw logs of 12 seeds, read back, against the twin's truth."""

import numpy as np
import pytest
from scipy.stats import chi2

from thalweg.core import LocalFrame
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.tracks import read_pos
from thalweg.navigation.ins_gnss import build_trajectory
from thalweg_lab.instruments import simulate_gnss, simulate_ins
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import Voyage, true_trajectory

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
LEVER = np.array([0.1, 0.0, -0.45])
SEEDS = 12


def normalised_errors(folder, seed, **changes):
    """Squared errors over predicted variances at two instants 10 s apart: position (2, 3), attitude (2, 3).

    At two instants only: with a correlation time of 0.5 s they are independent of each other.
    """
    settings = {"ins": {"attitude_time_s": 0.5}, "gnss": {"correlation_time_s": 0.5}}
    for key, value in changes.items():
        settings[key] = settings.get(key, {}) | value
    config = TwinConfig.of_size("tiny", duration_s=12.0, **settings)
    simulate_ins(config, seed, FRAME, folder / f"{seed}.anpp")
    simulate_gnss(
        config, seed, FRAME, folder / f"{seed}.sbp", folder / f"{seed}.pos", lever_ics_antenna_m=LEVER
    )
    trajectory, _ = build_trajectory(
        read_pos([folder / f"{seed}.pos"]).positions,
        read_anpp([folder / f"{seed}.anpp"]).states,
        FRAME,
        lever_ics_antenna_m=LEVER,
        sigma_lever_m=np.zeros(3),
        accept_fixes=["fixed"],
        max_gap_s=1.0,
        max_attitude_gap_s=0.1,
        sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
    )
    # At GNSS epochs: between them the spline of white noise is smoother than its nodes.
    nodes = np.searchsorted(trajectory.t_gps_s, trajectory.t_gps_s[0] + np.array([2.0, 12.0]) - 1e-6)
    position, R, inside = true_trajectory(Voyage(config, seed), FRAME).at(trajectory.t_gps_s[nodes])
    assert inside.all()
    error = trajectory.position_wcs_m[nodes] - position
    variance = trajectory.sigma_position_m[nodes] ** 2
    R_found = trajectory.at(trajectory.t_gps_s[nodes] + 1e-9)[1]
    small = np.einsum("nji,njk->nik", R, R_found)  # R_true^T R_found, near the identity: body-frame rotation
    angles = np.stack([small[:, 2, 1], small[:, 0, 2], small[:, 1, 0]], axis=1)
    return error**2 / variance, angles**2 / trajectory.sigma_roll_pitch_heading_rad()[nodes] ** 2


def study(folder, **changes):
    pairs = [normalised_errors(folder, seed, **changes) for seed in range(SEEDS)]
    return np.concatenate([p for p, _ in pairs]), np.concatenate([a for _, a in pairs])


def inside_band(squares, level=0.999):
    """Is the sum of n normalised squares of each column inside its chi-square band? Two-sided."""
    n = len(squares)
    low, high = chi2.ppf([(1 - level) / 2, (1 + level) / 2], n)
    total = squares.sum(axis=0)
    return (total > low) & (total < high)


@pytest.fixture(scope="module")
def consistent(tmp_path_factory):
    return study(tmp_path_factory.mktemp("consistent"))


def test_positions_are_as_good_as_they_say(consistent):
    assert inside_band(consistent[0]).all(), consistent[0].mean(axis=0)


def test_attitudes_are_as_good_as_they_say(consistent):
    # roll and pitch of the boat are below 2 deg, so that body axes and those of the sigmas coincide to 0.1 %
    assert inside_band(consistent[1]).all(), consistent[1].mean(axis=0)


def test_the_check_fails_for_an_effect_that_the_model_does_not_know(tmp_path):
    """A heading that drifts by 3 deg/min is no part of the stated sigma: the band must be left."""
    _, attitude = study(tmp_path, ins={"attitude_time_s": 0.5, "heading_drift_degpmin": 3.0})
    within = inside_band(attitude)
    assert within[:2].all()
    assert not within[2]
