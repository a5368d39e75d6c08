"""What the owner writes down has consistent errors and can be read; the truth is the truth."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tests.lab.conftest import FRAME
from thalweg.calibration.field import parse_field, read_field
from thalweg.core import read_table
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import standing
from thalweg_lab.yard import build_field
from thalweg_lab.yard_records import FIELD_POSES, description, simulate_field

SEED = 4


def written(folder, **field):
    config = TwinConfig.of_size("field_tiny", field=field)
    simulate_field(
        config,
        SEED,
        FRAME,
        out_field=folder / "logs/field.yaml",
        out_truth=folder / "truth/field.json",
        out_poses=folder / "truth/field_poses.parquet",
    )
    return config, folder


def test_the_description_can_be_read(tmp_path, field):
    _, folder = written(tmp_path)
    known = read_field(folder / "logs/field.yaml")
    assert [c.name for c in known.cones] == [c.name for c in field.cones]
    assert [c.markers for c in known.cones] == [c.markers for c in field.cones]
    assert {c.half_angle_rad for c in known.cones} == {np.deg2rad(25.0)}
    assert all(known.layout.module_of(s.marker) == s.module_m for s in field.sheets)
    assert len(known.scale_bars) == 3
    assert [t.marker for t in known.targets] == [64, 65, 66, 67, 68, 69]
    assert known.antenna.marker == 98
    assert known.antenna.offset_m == pytest.approx(-0.030, abs=0.004)  # sigma 1 mm


def test_stated_values_err_by_their_sigmas():
    config = TwinConfig.of_size("field_tiny")
    bars, targets, offsets = [], [], []
    for seed in range(60):
        field = build_field(config, seed)
        known = parse_field(description(field, seed, FRAME))
        bars += [
            (k.length_m - b.length_m) / k.sigma_m for k, b in zip(known.scale_bars, field.bars, strict=True)
        ]
        for t in known.targets:
            at = FRAME.from_geodetic(np.array([t.lat_deg]), np.array([t.lon_deg]), np.array([t.h_ell_m]))[0]
            targets.append((at - field.sheet(t.marker).centre_wcs_m()) / t.sigma_m)
        offsets.append((known.antenna.offset_m + 0.030) / known.antenna.sigma_m)
    # 180, 1080 and 60 normal numbers: their rms is known to 1 / sqrt(2 n) = 5, 2 and 9 %; three times that.
    for errors, band in ((bars, 0.16), (targets, 0.065), (offsets, 0.27)):
        assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=band)


def test_the_truth_is_that_of_the_field(tmp_path):
    config, folder = written(tmp_path)
    truth = json.loads((folder / "truth/field.json").read_text())
    assert truth["kind"] == "thalweg twin field"
    field = build_field(config, SEED)
    for cone, fact in zip(field.cones, truth["cones"], strict=True):
        assert_array_equal(cone.apex_wcs_m, fact["apex_wcs_m"])
        assert_array_equal(cone.axis_wcs, fact["axis_wcs"])
        assert cone.half_angle_rad == fact["half_angle_rad"]
    assert_array_equal(field.sheet(7).saddles_wcs_m()[2], truth["saddles_wcs_m"]["7/2"])
    assert_array_equal(field.sheet(66).centre_wcs_m(), truth["targets"][2]["centre_wcs_m"])
    table, _ = read_table(folder / "truth/field_poses.parquet", FIELD_POSES)
    for number, row in enumerate(table.itertuples(), start=1):
        pose = standing(config, number).T_wcs_ics
        assert_array_equal([row.east_m, row.north_m, row.up_m], pose.shift_m)
        R = Rotation.from_quat([row.q_x, row.q_y, row.q_z, row.q_w]).as_matrix()
        assert_allclose(R, pose.R, atol=1e-14)
        assert row.end_t_gps_s - row.begin_t_gps_s == config.field.position_s
