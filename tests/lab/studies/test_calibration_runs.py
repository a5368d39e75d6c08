"""Studies of calibrations over seeds: the verdict itself, and a few seeds of each."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import CoverageError
from thalweg_lab.studies import cone_runs as runs


@pytest.mark.parametrize(("scale", "inside"), [(1.0, True), (1.5, False), (0.7, False)])
def test_only_consistent_covariances_lie_in_the_band(scale: float, inside: bool) -> None:
    rng = np.random.default_rng(1)
    squares = np.square(scale * rng.standard_normal((60, 6))).mean(axis=1)
    found = pd.DataFrame({"seed": range(60), "failure": "", "consistent": squares})
    (row,) = runs.judged(found, {"consistent": 6}, level=0.01).to_dict("records")
    assert row["inside"] is inside
    assert row["band_low"] < 1 < row["band_high"]


def test_failures_are_counted_and_do_not_enter_the_mean() -> None:
    def trial(seed: int) -> dict[str, float]:
        if seed == 2:
            raise CoverageError("no soundings")
        return {"error_mm": 1.0, "consistent": 1.0, "ruler": 1.0, "formal": 50.0}

    found = runs.study(trial, range(1, 5))
    assert found["failure"].str.contains("no soundings").tolist() == [False, True, False, False]
    page = runs.as_markdown(found, runs.ECHO_SOUNDER, "Study")
    assert "| covariance as stated | 4 (1 failed) | 1.00 |" in page
    assert page.count("| inside |") == 2
    assert page.count("| outside |") == 1


@pytest.mark.parametrize(
    ("trial", "components"),
    [(runs.ins_lidar_trial, runs.INS_LIDAR), (runs.echo_sounder_trial, runs.ECHO_SOUNDER)],
)
def test_a_few_seeds(trial: runs.Trial, components: dict[str, int]) -> None:
    found = runs.study(trial, [1, 2])
    assert (found["failure"] == "").all()
    table = runs.judged(found, components, level=1e-4).set_index("covariance")
    # once in ten thousand for right covariances; the 50 seeds of the rules decide
    assert table.loc["consistent", "inside"]
    # independent points: sigmas many times too small
    assert table.loc["formal", "normalised"] > 20
    pd.testing.assert_frame_equal(runs.study(trial, [2]), found[1:].reset_index(drop=True))
