"""Surveys that several tests judge: 14 seeds through the whole chain, and a few processed wrongly."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from thalweg_lab.studies.trials import BANKS, MISTAKES, NONE, PlantedMistake, Trial, trial
from thalweg_lab.truth import PointErrors

SEEDS = 14
FEW = 6
CORRELATION_S = 0.25
"""Of the errors of poses, half that of the study: a survey tells twice as much, and 14 as much as 28."""
TWIN: dict[str, Any] = BANKS | {
    "ins": {"attitude_time_s": CORRELATION_S},
    "gnss": {"correlation_time_s": CORRELATION_S},
}


@dataclass(frozen=True)
class Surveys:
    """Errors of the same points in three dimensions and from the mesh, and along the true normals."""

    trials: list[Trial]
    along_normals: list[PointErrors]


def surveyed(
    folder: Path,
    seeds: int,
    mistakes: Callable[[int], Sequence[PlantedMistake]] = lambda seed: (NONE,),
    **how: Any,
) -> Surveys:
    """Surveys of bare banks, each seed processed with its mistakes."""
    along: list[PointErrors] = []
    trials = [
        trial(seed, folder, mistakes=mistakes(seed), also=lambda s: along.append(s.errors()), **how)
        for seed in range(seeds)
    ]
    return Surveys(trials, along)


@pytest.fixture(scope="session")
def right_surveys(tmp_path_factory: pytest.TempPathFactory) -> Surveys:
    """Processed rightly and with the smallest of the mistakes, the first few with the larger ones too."""

    def mistakes(seed: int) -> Sequence[PlantedMistake]:
        return (NONE, *MISTAKES) if seed < FEW else (NONE, MISTAKES[0])

    return surveyed(tmp_path_factory.mktemp("surveys"), SEEDS, mistakes, twin=TWIN)


@pytest.fixture(scope="session")
def surveys(right_surveys: Surveys) -> list[Trial]:
    """Their errors in three dimensions and from the mesh."""
    return right_surveys.trials


@pytest.fixture(scope="session")
def wrong_surveys(surveys: list[Trial]) -> list[Trial]:
    """The few with the mistakes that are easily seen."""
    return surveys[:FEW]


@pytest.fixture(scope="session")
def other_surveys(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., list[PointErrors]]:
    """Errors along the normals of surveys of another twin."""

    def errors(seeds: int, **twin: Any) -> list[PointErrors]:
        changed = {key: TWIN.get(key, {}) | value for key, value in twin.items()}
        folder = tmp_path_factory.mktemp("other")
        return surveyed(folder, seeds, twin=TWIN | changed, mesh=False).along_normals

    return errors
