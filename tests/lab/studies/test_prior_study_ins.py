"""The study of wrong presumptions for INS and lidar, on one short survey."""

import numpy as np

from thalweg_lab.studies import prior_study
from thalweg_lab.studies.trials import Sample, Trial, as_table, from_table


def test_sigmas_stated_at_half_are_seen_and_mended(tmp_path, monkeypatch):
    """Errors of twice the stated size: a mean square of 4 as presumed; estimated, much less.

    One observation. The guard is `prior_study`.
    """
    monkeypatch.setitem(prior_study.SURVEY, "duration_s", 8.0)
    monkeypatch.setitem(prior_study.SURVEY, "effects", {"lost_packets": 0.6})
    monkeypatch.setitem(prior_study.SURVEY, "ins", {"attitude_time_s": 2.0})
    rows = prior_study.run_ins(7, tmp_path, ("stated_half",))
    assert not list(tmp_path.iterdir()), "the logs are gone"
    square = rows.set_index(["model", "quantity"])["nees"]
    assert square["presumed", "pose"] > 1.25
    assert square["estimated", "pose"] < 0.6 * square["presumed", "pose"]


def test_a_survey_is_the_same_after_it_was_a_table():
    rng = np.random.default_rng(1)

    def sample():
        return Sample.of(*rng.random((4, 5)))

    trial = Trial(in_3d={"none": sample(), "estimated": sample()}, to_mesh={"none": sample()})
    again = from_table(as_table(trial))
    for name in ("in_3d", "to_mesh"):
        assert list(getattr(again, name)) == list(getattr(trial, name))
        for mistake, one in getattr(trial, name).items():
            np.testing.assert_array_equal(getattr(again, name)[mistake].squared_m2, one.squared_m2)
            np.testing.assert_array_equal(getattr(again, name)[mistake].range_m, one.range_m)
