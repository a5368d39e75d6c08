"""Sources of the camera's clock in a campaign file."""

import pytest

from thalweg.config.load import CampaignError, load_campaign

TIES = {"logs.calibration.clock_ties": ["raw/ties.csv"]}
JITTER = {"calibration.clock.jitter_s": 0.02}


@pytest.fixture
def tables(survey):
    for name in ("ties", "more", "pulses", "photo"):
        (survey / f"raw/{name}.csv").write_text("t_gps_s\n1\n")
    return survey


@pytest.mark.usefixtures("tables")
def test_ties_with_a_jitter_are_a_clock(write):
    assert len(load_campaign(write(TIES | JITTER)).log_files("clock_ties")) == 1
    display = {"logs.calibration.display": ["raw/photo.csv"]}
    assert load_campaign(write(TIES | display)).log_files("display")


@pytest.mark.usefixtures("tables")
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (TIES, r"calibration\.clock\.jitter_s.*missing"),
        (JITTER | {"logs.calibration.clock_ties": ["raw/ties.csv", "raw/more.csv"]}, r"clock_ties.*2 files"),
        ({"logs.calibration.trigger_pulses": ["raw/pulses.csv", "raw/more.csv"]}, r"trigger_pulses.*2 files"),
        (
            TIES | JITTER | {"logs.calibration.trigger_pulses": ["raw/pulses.csv"]},
            r"clock_ties.*both clock_ties and trigger_pulses",
        ),
    ],
)
def test_a_clock_has_one_source_that_says_all(write, changes, words):
    with pytest.raises(CampaignError, match=words):
        load_campaign(write(changes))
