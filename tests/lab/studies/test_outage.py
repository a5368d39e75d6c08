"""The study of outages: shape of its tables, and that the fused trajectory wins."""

import numpy as np
import pandas as pd
import pytest

from tests.bands import band
from thalweg_lab.studies import outage


@pytest.fixture(scope="module")
def table():
    spec = outage.VoyageSpec(duration_s=50.0)
    found = [outage.outage_trial(seed, spec, (2.0, 18.0)) for seed in (1, 2)]
    return outage.summarised(pd.concat(found))


def test_the_fused_trajectory_is_at_least_as_good_as_each_chain_at_every_length(table):
    assert len(table) == 8
    by = table.pivot_table(index="length_s", columns="chain", values="rms_m")
    whole = np.sqrt((by**2).mean())
    # of 5 % over all lengths; two surveys have but some seven independent errors at each
    assert whole["fused"] <= 1.05 * whole[["ins_model", "ins_velocity", "camera"]].min()
    assert (by["fused"] <= 1.15 * by[["ins_model", "ins_velocity", "camera"]].min(axis=1)).all()
    # without camera the error grows with the outage; with it, it does not
    assert by["ins_velocity"].is_monotonic_increasing
    assert by.loc[18.0, "ins_velocity"] > 3 * by.loc[18.0, "fused"]
    assert by.loc[18.0, "fused"] < 1.5 * by.loc[2.0, "camera"]


def test_predicted_sigmas_follow_the_errors(table):
    """Some ten outages of few independent errors: a factor of 1.6 is their spread (99 %)."""
    known = table[table["chain"] != "ins_model"]
    ratio = known["rms_m"] / known["sigma_m"]
    assert ((ratio > 1 / 1.6) & (ratio < 1.6)).all()


def test_outages_leave_positions_on_both_sides_and_do_not_overlap():
    spans = outage.outages(np.arange(0.0, 100.0, 0.1), 20.0)
    assert spans == [(15.0, 35.0), (50.0, 70.0)]


def test_under_trees_positions_are_disturbed_there_only():
    effects = {"gnss_floats": ((2.0, 1.0),), "gnss_outages": ((5.0, 2.0),)}
    gnss = {"multipath_m": 0.05, "multipath_time_s": 0.01, "rate_hz": 50.0}
    spec = outage.VoyageSpec(duration_s=10.0, shade_s=((1.0, 3.0),), twin={"gnss": gnss, "effects": effects})
    free = outage.VoyageSpec(duration_s=10.0, twin={"gnss": gnss})
    shaded, free = outage.make_survey(1, spec), outage.make_survey(1, free)
    table = shaded.positions.merge(free.positions, on="t_gps_s", suffixes=("", "_free"))
    since = table["t_gps_s"].to_numpy() - free.motion.start_gps_s
    assert len(free.positions) - len(table) == 100
    assert not ((since > 5.0) & (since < 6.9)).any()
    off = np.abs(table["h_ell_m"] - table["h_ell_m_free"]).to_numpy()
    under, floats = (since >= 1.0) & (since < 4.0), (since >= 2.0) & (since < 3.0)
    assert (table["fix"] == "float").to_numpy().tolist() == floats.tolist()
    assert (off[~under] == 0).all()
    low, high = band(np.sum(under & ~floats))
    assert low < np.mean((off[under & ~floats] / (outage.DIMMED * 0.05)) ** 2) < high
