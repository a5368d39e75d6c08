"""Bands of normalised squares hold what they promise, and what one observation cannot see has a guard."""

import re

import numpy as np
import pytest

from tests.bands import band


@pytest.mark.parametrize("n", [1, 6, 40, 300])
def test_right_sigmas_stay_inside_as_often_as_promised(n, rng):
    squares = rng.chisquare(n, 20_000) / n
    for level in (0.95, 0.999):
        low, high = band(n, level=level)
        outside = np.mean((squares < low) | (squares > high))
        # binomial, five sigmas
        assert outside == pytest.approx(1 - level, abs=5 * np.sqrt(level * (1 - level) / len(squares)))


def test_estimated_variances_widen_a_band(rng):
    low, high = band(40, predicted_from=40, level=0.95)
    ratio = rng.chisquare(40, 20_000) / rng.chisquare(40, 20_000)
    assert np.mean((ratio > low) & (ratio < high)) == pytest.approx(0.95, abs=0.008)
    assert low < band(40, level=0.95)[0] < band(40, level=0.95)[1] < high
    np.testing.assert_allclose(band(40, predicted_from=1e7), band(40), rtol=1e-4)


def test_what_one_observation_cannot_see_has_a_guard(repository):
    """Each check that calls itself one observation of the twin names the study or the test of many."""
    studies = {path.stem for path in (repository / "config/studies").glob("*.yaml")}
    told = 0
    for path in sorted((repository / "tests").rglob("test_*.py")):
        text = re.sub(r"\s*\n\s*#?\s*", " ", path.read_text())
        for sentence in re.findall(r"The guards? (?:is|are) ([^;]*?)[.,;] ", text):
            named = re.findall(r"`(\w+)`", sentence)
            files = re.findall(r"tests/[\w/]+\.py", sentence)
            assert named or files, f"{path}: {sentence}"
            assert set(named) <= studies, f"{path}: {sentence}"
            assert all((repository / file).is_file() for file in files), f"{path}: {sentence}"
            told += 1
    assert told > 10
