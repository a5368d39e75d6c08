"""Surveys that several tests judge: 18 seeds through the whole chain, and a few processed wrongly."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from thalweg_lab.studies.trials import BANKS, MISTAKES, NONE, Trial, trial
from thalweg_lab.truth import PointErrors

SEEDS = 18
FEW = 6


@dataclass(frozen=True)
class Surveys:
    """Errors of the same points in three dimensions and from the mesh, and along the true normals."""

    trials: list[Trial]
    along_normals: list[PointErrors]


def surveyed(folder: Path, seeds: int, **how: Any) -> Surveys:
    """Surveys of bare banks."""
    along: list[PointErrors] = []
    trials = [trial(seed, folder, also=lambda s: along.append(s.errors()), **how) for seed in range(seeds)]
    return Surveys(trials, along)


@pytest.fixture(scope="session")
def right_surveys(tmp_path_factory: pytest.TempPathFactory) -> Surveys:
    """Processed rightly, and with the smallest of the mistakes."""
    return surveyed(tmp_path_factory.mktemp("surveys"), SEEDS, mistakes=(NONE, MISTAKES[0]))


@pytest.fixture(scope="session")
def surveys(right_surveys: Surveys) -> list[Trial]:
    """Their errors in three dimensions and from the mesh."""
    return right_surveys.trials


@pytest.fixture(scope="session")
def wrong_surveys(tmp_path_factory: pytest.TempPathFactory) -> list[Trial]:
    """A few surveys with the mistakes that are easily seen."""
    return surveyed(tmp_path_factory.mktemp("wrong"), FEW, mistakes=MISTAKES[1:]).trials


@pytest.fixture(scope="session")
def other_surveys(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., list[PointErrors]]:
    """Errors along the normals of surveys of another twin."""

    def errors(seeds: int, **twin: Any) -> list[PointErrors]:
        changed = {key: BANKS.get(key, {}) | value for key, value in twin.items()}
        folder = tmp_path_factory.mktemp("other")
        return surveyed(folder, seeds, twin=BANKS | changed, mesh=False).along_normals

    return errors
