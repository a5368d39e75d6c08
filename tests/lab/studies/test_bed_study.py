"""Riverbeds of many surveys: one survey in small, and what is judged consistent."""

import numpy as np
import pandas as pd
import pytest

from thalweg.figures import save
from thalweg_lab.figures.bed_patterns import draw_bed_patterns
from thalweg_lab.studies import bed_study
from thalweg_lab.studies.bed_study import MISTAKES, NONE, surveyed, verdicts


@pytest.fixture(autouse=True, scope="module")
def _short_search():
    """How well ranges are found is judged in tests/bathymetry."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("thalweg.bathymetry.variogram._STEPS", 12)
        yield


COLUMNS = ["n", "observed_m2", "predicted_m2", "normalised", "outside", "error_m"]


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """A survey of 30 s, processed rightly and with a wrong speed of sound."""
    twin = bed_study.TWIN | {"duration_s": 30.0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bed_study, "TWIN", twin)
        return surveyed(4, tmp_path_factory.mktemp("bed"), (NONE, MISTAKES[0]))


def test_a_survey_from_raw_logs(rows):
    none = rows[rows["mistake"] == "none"]
    sums = none.groupby("quantity")[COLUMNS].sum()
    assert sums.loc["bed", "n"] > 1000
    assert sums.loc["soundings", "n"] > 200
    # a single survey with common and slow errors: within a factor of 2.5 on both sides
    ratio = np.sqrt(sums["predicted_m2"] / sums["observed_m2"])
    assert ((ratio > 0.4) & (ratio < 2.5)).all()
    # 1500 instead of 1455 m/s: 3 % of 1.4 m deeper
    wrong = rows[rows["mistake"] != "none"].groupby("quantity")[COLUMNS].sum()
    lower = (wrong["error_m"] / wrong["n"] - sums["error_m"] / sums["n"]).loc["soundings"]
    assert lower == pytest.approx(-0.035, abs=0.012)


def test_a_survey_tells_methods_sections_and_patterns(tmp_path, monkeypatch):
    monkeypatch.setattr(bed_study, "TWIN", bed_study.TWIN | {"duration_s": 25.0})
    monkeypatch.setattr(bed_study, "LEGS_M", (15.0, 60.0))
    monkeypatch.setattr(bed_study, "_REACH_M", 130.0)
    tables = bed_study.asked(4, tmp_path)
    methods, sections = tables["methods"].set_index("method"), tables["sections"]
    assert methods.loc["kriging", "n"] > 150
    assert 0.01 < np.sqrt(methods.loc["kriging", "squares_m2"] / methods.loc["kriging", "n"]) < 0.5
    assert np.diff(sections["s_m"]) == pytest.approx(2.0)
    assert sections["width_m"].between(15, 30).all()
    assert sections["mean_bed_m"].between(-2.5, -0.3).all()
    twice = pd.concat([tables["patterns"], tables["patterns"].assign(seed=5)])  # a ratio needs two rivers
    found = bed_study.patterns(twice).set_index(["pattern", "leg_m"])
    assert (found["rivers"] == 2).all()
    # one river and one draw of errors that last
    assert found["ratio"].between(0.4, 2.5).all()
    for pattern in bed_study.PATTERNS:
        assert found.loc[(pattern, 15.0), "rmse_observed_m"] < found.loc[(pattern, 60.0), "rmse_observed_m"]
    # so much river a leg of a zigzag leaves more unseen than from section to section
    assert found.loc[("sections", 60.0), "rmse_observed_m"] < found.loc[("zigzag", 60.0), "rmse_observed_m"]
    image = tmp_path / "patterns.png"
    found.reset_index().to_csv(tmp_path / "patterns.csv")
    save(draw_bed_patterns(table=tmp_path / "patterns.csv"), image)
    assert image.stat().st_size > 20_000


def test_findings_of_many_surveys():
    """Errors of known size, and a depth that goes with the width by a correlation of -0.6."""
    rng = np.random.default_rng(2)
    sizes = {"kriging": 0.1, "triangles": 0.15}
    methods = pd.DataFrame(
        {"method": name, "n": 100, "squares_m2": np.sum(rng.normal(0, size, 100) ** 2), "seed": seed}
        for name, size in sizes.items()
        for seed in range(20)
    )
    x, y = rng.multivariate_normal([0, 0], [[1, 0.6], [0.6, 1]], 20 * 30).T
    seeds = np.repeat(range(20), 30)
    sections = pd.DataFrame({"width_m": 20 + x, "mean_bed_m": -1 + 0.1 * y, "seed": seeds})
    found = bed_study.findings(methods, sections).set_index("finding")
    for name, true in (("triangles over kriging", 1.5), ("width with mean height of the bed", 0.6)):
        assert found.loc[name, "sigma"] < 0.06
        assert abs(found.loc[name, "value"] - true) < 3 * found.loc[name, "sigma"]
        assert found.loc[name, "surveys"] == 20


def _surveys(factor):
    rng = np.random.default_rng(1)
    parts = []
    for seed in range(40):
        for low, high in ((0.0, 1.0), (1.0, np.inf)):
            e = 0.05 * (0.5 * rng.standard_normal() + rng.standard_normal(200))
            s = np.full(200, factor * 0.05 * np.sqrt(1.25))
            parts.append(bed_study.sums_of("bed", low, high, e, s) | {"seed": seed, "mistake": "none"})
    return pd.DataFrame(parts)


@pytest.mark.parametrize(("factor", "consistent"), [(1.0, True), (0.75, False), (1.3, False)])
def test_only_sigmas_that_fit_are_consistent(factor, consistent):
    table = verdicts(_surveys(factor))
    assert table["from_m"].tolist() == [0.0, 0.0, 1.0]
    assert (table["consistent"] == consistent).all()
    assert table.loc[0, "n"] == 40 * 400
    assert table.loc[0, "normalised_square"] == pytest.approx(1 / factor**2, rel=0.15)
