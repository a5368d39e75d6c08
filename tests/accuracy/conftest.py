"""Surveys that several tests judge: forty seeds through the whole chain, and a few processed wrongly."""

from typing import Any

import pytest

from thalweg.simulation.survey import BARE
from thalweg.simulation.trials import MISTAKES, NONE, Trial, trials

SEEDS = 40
FEW = 6

# Attitude errors of 0.5 s give each second two independent ones. No mirror ghosts: those that the filters
# leave at the bank's toe are no points of a surface, and no sigma speaks of them (`offset_study` does).
TWIN: dict[str, Any] = {
    "size": "tiny",
    "duration_s": 4.0,
    "scene": BARE | {"length_m": 60.0, "grid_m": 0.25},
    "ins": {"attitude_time_s": 0.5},
    "gnss": {"correlation_time_s": 0.5},
    "lidar": {"mirror_ghosts": False},
    "tls": {"spacing_m": 0.1, "sigma_station_m": 0.005},
}

# The terrain of this scene has triangles of 25 cm.
REFERENCE = {"cell_m": 0.1}


@pytest.fixture(scope="session")
def surveys(tmp_path_factory: pytest.TempPathFactory) -> list[Trial]:
    """Bare banks; processed rightly, and with the smallest of the mistakes."""
    folder = tmp_path_factory.mktemp("surveys")
    return trials(range(SEEDS), folder, twin=TWIN, reference=REFERENCE, mistakes=(NONE, MISTAKES[0]))


@pytest.fixture(scope="session")
def wrong_surveys(tmp_path_factory: pytest.TempPathFactory) -> list[Trial]:
    """A few surveys with the mistakes that are easily seen."""
    folder = tmp_path_factory.mktemp("wrong")
    return trials(range(FEW), folder, twin=TWIN, reference=REFERENCE, mistakes=MISTAKES[1:])
