"""Sources of the camera's clock in a campaign file."""

import pytest

from tests.settings.conftest import in_order
from thalweg.settings.load import CampaignError, load_campaign

RUN = """
logs.calibration.field: [raw/field.yaml]
logs.calibration.reference_images: [raw/shot.csv]
logs.calibration.run_images: [raw/seen.csv]
"""
JITTER = "calibration.clock.jitter_s: 0.02\n"
TIES = "logs.calibration.clock_ties: [raw/ties.csv]\n"


@pytest.fixture(autouse=True)
def _tables(survey):
    for name in ("ties", "more", "pulses", "photo", "shot", "seen"):
        (survey / f"raw/{name}.csv").write_text("t_gps_s\n1\n")
    (survey / "raw/field.yaml").write_text("thalweg_field: 1\n")


def test_ties_with_a_jitter_are_a_clock(write):
    assert len(load_campaign(write(RUN + TIES + JITTER)).log_files("clock_ties")) == 1
    assert load_campaign(write(RUN + TIES + "logs.calibration.display: [raw/photo.csv]")).log_files("display")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (RUN + TIES, "calibration.clock.jitter_s ... missing"),
        (
            RUN + JITTER + "logs.calibration.clock_ties: [raw/ties.csv, raw/more.csv]",
            "clock_ties ... 2 files",
        ),
        (
            RUN + "logs.calibration.trigger_pulses: [raw/pulses.csv, raw/more.csv]",
            "trigger_pulses ... 2 files",
        ),
        (
            RUN + TIES + JITTER + "logs.calibration.trigger_pulses: [raw/pulses.csv]",
            "clock_ties ... both clock_ties and trigger_pulses",
        ),
        # times of no images would be left unused
        (JITTER + TIES, "run_images ... missing ... clock_ties tells ... would not"),
        (
            JITTER + "logs.calibration.trigger_pulses: [raw/ties.csv]",
            "run_images ... missing ... trigger_pulses tells ... would not",
        ),
    ],
)
def test_a_clock_has_one_source_that_says_all_and_images(write, changes, words):
    with pytest.raises(CampaignError, match=in_order(words)):
        load_campaign(write(changes))


def test_a_run_needs_no_camera(write):
    field = RUN.replace("logs.calibration.run_images: [raw/seen.csv]\n", "")
    assert load_campaign(write(field)).log_files("field")
    # without lidar and INS of a run, nothing is left to calibrate; half of the static positions is none
    for more in ("logs.ins: []", "logs.calibration.position_images: [raw/photo.csv]"):
        with pytest.raises(CampaignError, match=r"position_scans.*missing"):
            load_campaign(write(field + more))
