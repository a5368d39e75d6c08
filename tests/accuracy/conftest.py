"""Surveys that several tests judge: forty seeds through the whole chain, and a few processed wrongly."""

import pytest

from thalweg_lab.studies.trials import MISTAKES, NONE, Trial, trial

SEEDS = 40
FEW = 6


@pytest.fixture(scope="session")
def surveys(tmp_path_factory: pytest.TempPathFactory) -> list[Trial]:
    """Bare banks; processed rightly, and with the smallest of the mistakes."""
    folder = tmp_path_factory.mktemp("surveys")
    return [trial(seed, folder, mistakes=(NONE, MISTAKES[0])) for seed in range(SEEDS)]


@pytest.fixture(scope="session")
def wrong_surveys(tmp_path_factory: pytest.TempPathFactory) -> list[Trial]:
    """A few surveys with the mistakes that are easily seen."""
    folder = tmp_path_factory.mktemp("wrong")
    return [trial(seed, folder, mistakes=MISTAKES[1:]) for seed in range(FEW)]
