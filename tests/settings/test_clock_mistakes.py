"""Sources of the camera's clock in a campaign file."""

import pytest

from thalweg.settings.load import CampaignError, load_campaign

RUN = {
    "logs.calibration.field": ["raw/field.yaml"],
    "logs.calibration.reference_images": ["raw/shot.csv"],
    "logs.calibration.run_images": ["raw/seen.csv"],
}
TIES = RUN | {"logs.calibration.clock_ties": ["raw/ties.csv"]}
JITTER = {"calibration.clock.jitter_s": 0.02}


@pytest.fixture
def tables(survey):
    for name in ("ties", "more", "pulses", "photo", "shot", "seen"):
        (survey / f"raw/{name}.csv").write_text("t_gps_s\n1\n")
    (survey / "raw/field.yaml").write_text("thalweg_field: 1\n")
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
        (
            JITTER | RUN | {"logs.calibration.clock_ties": ["raw/ties.csv", "raw/more.csv"]},
            r"clock_ties.*2 files",
        ),
        (
            RUN | {"logs.calibration.trigger_pulses": ["raw/pulses.csv", "raw/more.csv"]},
            r"trigger_pulses.*2 files",
        ),
        (
            TIES | JITTER | {"logs.calibration.trigger_pulses": ["raw/pulses.csv"]},
            r"clock_ties.*both clock_ties and trigger_pulses",
        ),
    ],
)
def test_a_clock_has_one_source_that_says_all(write, changes, words):
    with pytest.raises(CampaignError, match=words):
        load_campaign(write(changes))


@pytest.mark.usefixtures("tables")
@pytest.mark.parametrize("name", ["clock_ties", "trigger_pulses"])
def test_times_of_no_images_are_told_instead_of_left_unused(write, name):
    changes = JITTER | {f"logs.calibration.{name}": ["raw/ties.csv"]}
    with pytest.raises(CampaignError, match=rf"run_images.*missing[\s\S]*{name} tells.*would not"):
        load_campaign(write(changes))


@pytest.mark.usefixtures("tables")
def test_a_run_needs_no_camera(write):
    field = {key: RUN[key] for key in ("logs.calibration.field", "logs.calibration.reference_images")}
    assert load_campaign(write(field)).log_files("field")
    # without lidar and INS of a run, nothing is left to calibrate; half of the static positions is none
    for changes in (
        field | {"logs.ins": []},
        field | {"logs.calibration.position_images": ["raw/photo.csv"]},
    ):
        with pytest.raises(CampaignError, match=r"position_scans.*missing"):
            load_campaign(write(field | changes))
