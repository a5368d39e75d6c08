"""One small basin, recorded once for all tests of its images."""

import pytest

from tests.lightsheet.basin import Jobs, recorded

SEED = 42


@pytest.fixture(scope="session")
def basin(tmp_path_factory):
    """Recordings with panels."""
    return recorded(tmp_path_factory.mktemp("basin"), SEED, panels=True)


@pytest.fixture(scope="session")
def done(basin, tmp_path_factory):
    """The same, calibrated and measured."""
    jobs = Jobs(tmp_path_factory.mktemp("done"))
    jobs.orient(basin)
    jobs.detect(basin, "calibration")
    jobs.calibrate(basin)
    jobs.detect(basin, "panels")
    jobs.measure(basin)
    return jobs
