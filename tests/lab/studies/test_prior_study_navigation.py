"""Wrong presumptions of the navigation's errors: surveys that err as asked, and what estimates make of it."""

import numpy as np
import pandas as pd
import pytest

from tests.bands import band
from thalweg_lab.studies import prior_study as study
from thalweg_lab.studies.outage import FRAME, LEVER_ANTENNA_M


def antenna_errors_m(variant, seed=1):
    """Errors (n, 3) of the positions of a survey of a minute, and the stated sigmas (n, 3)."""
    survey = study.survey_of(study.VARIANTS[variant], seed, 60.0)
    table = survey.positions
    place = FRAME.from_geodetic(table["lat_deg"], table["lon_deg"], table["h_ell_m"])
    true = survey.motion.sensor_wcs_m(table["t_gps_s"].to_numpy(), LEVER_ANTENNA_M)
    return place - true, table[[f"sigma_{a}_m" for a in ("east", "north", "up")]].to_numpy()


def test_stated_sigmas_are_those_that_the_processing_is_used_to():
    for variant in ("base", "stated_half", "stated_double", "heavy_tails"):
        assert np.allclose(antenna_errors_m(variant)[1], [0.02, 0.02, 0.03])
    images = {v: study.survey_of(study.VARIANTS[v], 1, 20.0).images for v in ("base", "stated_half")}
    assert images["base"].cov_pose_wcs == pytest.approx(images["stated_half"].cov_pose_wcs)
    assert images["base"].sigma_t_s == pytest.approx(images["stated_half"].sigma_t_s)


def test_errors_are_as_the_variant_says():
    """Steps from one position to the next are white noise but for a little: variance ``2 w sigma^2``."""
    steps = {v: np.diff(antenna_errors_m(v)[0][:, 0]) for v in study.VARIANTS}
    white = {v: float(np.mean(np.square(d)) / (2 * 0.02**2)) for v, d in steps.items()}
    assert white["base"] == pytest.approx(0.25 + 0.75 * 0.02, rel=0.15)
    assert white["white_0"] == pytest.approx(0.02, rel=0.3)
    assert white["white_60"] == pytest.approx(0.6, rel=0.15)
    assert white["stated_half"] == pytest.approx(4 * white["base"])
    assert white["times_fivefold"] < white["base"] < white["times_fifth"]
    tail = {v: float(np.mean(d**4) / np.mean(d**2) ** 2) for v, d in steps.items()}
    assert tail["base"] < 4 < tail["heavy_tails"]


def test_sigmas_stated_too_small_fail_as_presumed_and_hold_as_estimated():
    """One observation: 40 s hold some four errors, which last 10 s, of each of six numbers of the pose.

    Only what is four times off shows. The guard is `prior_study`, of six voyages of two minutes.
    """
    rows = study.run_navigation("stated_half", 2, duration_s=40.0)
    found = rows[rows["quantity"] == "pose"].set_index(["chain", "model"])["nees"]
    for chain in ("fused", "camera"):
        assert found[chain, "presumed"] > 2.2
        assert found[chain, "estimated"] < 0.6 * found[chain, "presumed"]
        low, high = band(6 * 4)
        assert low < found[chain, "estimated"] < high
    assert set(rows["chain"]) == set(study.CHAINS)
    assert (rows["n"] > 90).all()


def test_a_table_pools_seeds_and_says_what_is_right():
    rows = pd.DataFrame(
        [
            {
                "chain": "fused",
                "variant": "base",
                "model": model,
                "seed": seed,
                "quantity": "pose",
                "nees": nees,
                "n": 100,
                "coverage_95": 0.9,
            }
            for model, values in (("presumed", (3.0, 4.0, 5.0)), ("estimated", (0.9, 1.0, 1.1)))
            for seed, nees in enumerate(values)
        ]
    )
    table = study.table(rows).set_index("model")
    assert table["nees"].to_dict() == pytest.approx({"presumed": 4.0, "estimated": 1.0})
    assert table["right"].to_dict() == {"presumed": False, "estimated": True}
    # t of 0.975 with two degrees is 4.303; the mean's sigma is 0.1 / sqrt(3)
    assert table["high"]["estimated"] == pytest.approx(np.exp(4.303 * 0.1 / np.sqrt(3)), rel=1e-3)
    assert table["low"]["estimated"] == pytest.approx(1 / table["high"]["estimated"])
    assert table["seeds"].tolist() == [3, 3]
    assert np.isnan(study.table(rows[rows["seed"] == 0])["low"]).all()
