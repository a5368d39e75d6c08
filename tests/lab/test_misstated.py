"""Instruments that err otherwise than they state: what is stated stays, what is drawn follows the factors."""

import numpy as np
import pytest

from thalweg_lab.instruments import Solution, antenna_errors_m, attitude_errors_rad, stated_sigmas_m
from thalweg_lab.instruments.ins import velocity_errors_mps
from thalweg_lab.instruments.misstated import QUANTITIES, as_it_errs, factors
from thalweg_lab.settings import TwinConfig

KNOWN = TwinConfig.of_size("tiny")
OTHER = TwinConfig.of_size("tiny", effects={"misstated": True})
SEED = 4


def test_each_quantity_has_its_factor_and_nothing_else_changes():
    found, by = as_it_errs(OTHER, SEED), factors(OTHER, SEED)
    assert found.ins.sigma_roll_deg == pytest.approx(by["level"] * OTHER.ins.sigma_roll_deg)
    assert found.ins.sigma_heading_deg == pytest.approx(by["heading"] * OTHER.ins.sigma_heading_deg)
    assert found.ins.attitude_time_s == pytest.approx(by["attitude_time"] * OTHER.ins.attitude_time_s)
    assert found.gnss.sigma_m == pytest.approx([by["gnss_position"] * s for s in OTHER.gnss.sigma_m])
    assert found.gnss.white_share == pytest.approx(by["white_share"] * OTHER.gnss.white_share)
    assert found.lidar.divergence_mrad == pytest.approx(by["divergence"] * OTHER.lidar.divergence_mrad)
    assert found.camera.jitter_s == pytest.approx(by["exposure_time"] * OTHER.camera.jitter_s)
    changed = {
        (section, key)
        for section in ("ins", "gnss", "lidar", "camera", "boat", "echo", "scene")
        for key, value in getattr(found, section)
        if value != getattr(getattr(OTHER, section), key)
    }
    assert changed == {(section, key) for section, keys in QUANTITIES.values() for key in keys}


def test_errors_have_the_true_sizes_and_logs_the_stated_ones():
    """Sizes of a long recording, to 10 %: as the factors say, beside the errors of a known twin."""
    by, n = factors(OTHER, SEED), 100_000
    t = np.arange(n) / OTHER.ins.rate_hz
    angles, known = (attitude_errors_rad(config, SEED, t, 0.0).std(axis=0) for config in (OTHER, KNOWN))
    assert angles / known == pytest.approx([by["level"], by["level"], by["heading"]], rel=0.1)
    fast, as_stated = (velocity_errors_mps(config, SEED, n).std() for config in (OTHER, KNOWN))
    assert fast / as_stated == pytest.approx(by["velocity"], rel=0.1)
    kinds = np.full(n, Solution.FIXED)
    stated = stated_sigmas_m(OTHER.gnss, kinds)
    np.testing.assert_array_equal(stated, stated_sigmas_m(KNOWN.gnss, kinds))
    errors = antenna_errors_m(OTHER, SEED, "ppk", kinds, stated)
    assert errors.std(axis=0) / stated[0] == pytest.approx([by["gnss_position"]] * 3, rel=0.1)
    # what is new in each epoch makes half of the squared differences of neighbours, but for the slow rest
    slow = 1 - np.exp(-1 / OTHER.gnss.rate_hz / (by["position_time"] * OTHER.gnss.correlation_time_s))
    share = by["white_share"] * OTHER.gnss.white_share
    half = np.mean(np.diff(errors[:, 0]) ** 2) / 2 / errors[:, 0].var()
    assert half == pytest.approx(share + (1 - share) * slow, rel=0.1)
