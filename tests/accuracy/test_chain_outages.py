"""What chains are worth in the gaps that the fused trajectory had to bridge."""

import numpy as np
import pytest

from tests.accuracy.chain_samples import T0, frames_of_images, trajectory
from thalweg.accuracy import outage_table


def test_sigmas_and_shares_are_those_of_the_poses_inside():
    hole = np.ones(1001, bool)
    hole[400:500] = False
    chains = {
        "ins": trajectory(valid=hole),
        "camera": trajectory(valid=frames_of_images(), sigma_m=0.01),
        "fused": trajectory(sigma_m=0.03),
    }
    found = outage_table(
        [
            {"without": "positions", "begin_gps_s": T0 + 7.98, "end_gps_s": T0 + 10.0},
            {"without": "images", "begin_gps_s": T0 + 9.0, "end_gps_s": T0 + 11.0},
        ],
        chains,
    ).set_index("without")
    gone = found.loc["positions"]
    assert gone["length_s"] == pytest.approx(2.02)
    assert (gone["ins_share"], gone["fused_share"]) == (0.0, pytest.approx(1.0))
    assert np.isnan(gone["ins_sigma_m"])
    assert gone["fused_sigma_m"] == pytest.approx(3**0.5 * 0.03)
    # frames of 0.08 s about each second: three quarters of that at 8 s, all at 9 s, half at 10 s
    assert gone["camera_share"] == pytest.approx(0.18 / 2.02, rel=0.01)
    assert gone["camera_most_m"] == pytest.approx(3**0.5 * 0.01)
    assert found.loc["images", "ins_share"] == pytest.approx(0.5, abs=0.02)


def test_no_outage_gives_an_empty_table_with_its_columns():
    found = outage_table([], {"ins": trajectory(), "fused": trajectory()})
    assert list(found.columns) == [
        "without",
        "begin_gps_s",
        "length_s",
        "ins_share",
        "ins_sigma_m",
        "ins_most_m",
        "fused_share",
        "fused_sigma_m",
        "fused_most_m",
    ]
    assert found.empty
