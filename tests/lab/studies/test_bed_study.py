"""Riverbeds of many surveys: one survey in small, and what is judged consistent."""

import numpy as np
import pandas as pd
import pytest

from thalweg_lab.studies import bed_study
from thalweg_lab.studies.bed_study import MISTAKES, NONE, campaign_of, surveyed, verdicts

COLUMNS = ["n", "observed_m2", "predicted_m2", "normalised", "outside", "error_m"]


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """A survey of 30 s, processed rightly and with a wrong speed of sound."""
    twin = bed_study.TWIN | {"duration_s": 30.0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bed_study, "TWIN", twin)
        return surveyed(4, tmp_path_factory.mktemp("bed"), (NONE, MISTAKES[0]))


def test_a_survey_from_raw_logs(rows: pd.DataFrame) -> None:
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


def test_the_instrument_differs_from_what_is_known_and_the_course_changes() -> None:
    found = [campaign_of(seed)["twin"] for seed in range(1, 9)]
    assert {each["boat"]["pattern"] for each in found} == {"zigzag", "sections"}
    assert len({each["echo"]["latency_s"] for each in found}) == 8
    tilt = np.array([each["echo"]["tilt_deg"] for each in found])
    assert 0.5 < tilt.std() < 2.0  # 16 values of sigma 1


def _surveys(factor: float) -> pd.DataFrame:
    rng = np.random.default_rng(1)
    parts = []
    for seed in range(40):
        for low, high in ((0.0, 1.0), (1.0, np.inf)):
            e = 0.05 * (0.5 * rng.standard_normal() + rng.standard_normal(200))
            s = np.full(200, factor * 0.05 * np.sqrt(1.25))
            parts.append(bed_study.sums_of("bed", low, high, e, s) | {"seed": seed, "mistake": "none"})
    return pd.DataFrame(parts)


@pytest.mark.parametrize(("factor", "consistent"), [(1.0, True), (0.75, False), (1.3, False)])
def test_only_sigmas_that_fit_are_consistent(factor: float, consistent: bool) -> None:
    table = verdicts(_surveys(factor))
    assert table["from_m"].tolist() == [0.0, 0.0, 1.0]
    assert (table["consistent"] == consistent).all()
    assert table.loc[0, "n"] == 40 * 400
    assert table.loc[0, "normalised_square"] == pytest.approx(1 / factor**2, rel=0.15)
