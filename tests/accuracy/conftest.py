"""Surveys that several tests judge: forty seeds through the whole chain, and a few processed wrongly."""

import pytest

from thalweg_lab.studies.trials import MISTAKES, NONE, Trial, trials

SEEDS = 40
FEW = 6


@pytest.fixture(scope="session")
def surveys(tmp_path_factory: pytest.TempPathFactory) -> list[Trial]:
    """Bare banks; processed rightly, and with the smallest of the mistakes."""
    return trials(range(SEEDS), tmp_path_factory.mktemp("surveys"), mistakes=(NONE, MISTAKES[0]))


@pytest.fixture(scope="session")
def wrong_surveys(tmp_path_factory: pytest.TempPathFactory) -> list[Trial]:
    """A few surveys with the mistakes that are easily seen."""
    return trials(range(FEW), tmp_path_factory.mktemp("wrong"), mistakes=MISTAKES[1:])
