"""Correlation times from a survey: found over seeds, used only if the campaign leaves them to it."""

import numpy as np
import pytest

from thalweg.config.fused import Fused as FusedSection
from thalweg.orientation.fused_settings import TIMES, FusionSettings
from thalweg.simulation.studies import outage

AUTO = FusionSettings(estimate_times=TIMES)


def times(seed: int, attitude_s: float, gnss_s: float, duration_s: float = 60.0) -> tuple[float, float]:
    twin = {
        "ins": {"attitude_time_s": attitude_s, "rate_hz": 10.0},
        "gnss": {"correlation_time_s": gnss_s},
    }
    survey = outage.make_survey(seed, outage.VoyageSpec(duration_s=duration_s, twin=twin))
    facts = outage.fuse(survey, AUTO).facts["correlation_times"]
    assert facts["estimated"] == list(TIMES)
    return facts["attitude_time_s"], facts["gnss_time_s"]


@pytest.mark.parametrize(("attitude_s", "gnss_s"), [(1.0, 1.0), (20.0, 10.0), (3.0, 30.0)])
def test_times_are_found_over_seeds(attitude_s: float, gnss_s: float) -> None:
    """The middle of three surveys of a minute; 20 and 30 s are known to half of themselves from those."""
    found = np.median([times(seed, attitude_s, gnss_s) for seed in (1, 2, 3)], axis=0)
    long = max(attitude_s, gnss_s) > 5
    assert 1 / (2.0 if long else 1.5) < found[0] / attitude_s < (2.0 if long else 1.7)
    assert 0.6 < found[1] / gnss_s < 1.6


def test_the_trajectory_is_that_of_the_times_if_they_were_stated() -> None:
    twin = {"ins": {"attitude_time_s": 1.0}, "gnss": {"correlation_time_s": 1.0}}
    survey = outage.make_survey(1, outage.VoyageSpec(duration_s=40.0, twin=twin))
    at = survey.motion.start_gps_s + np.arange(1.0, 38.0, 0.5)
    error = {}
    for name, settings in (
        ("auto", AUTO), ("wrong", FusionSettings()),
        ("right", FusionSettings(attitude_time_s=1.0, gnss_time_s=1.0)),
    ):  # fmt: skip
        e, _ = outage.errors_at(outage.fuse(survey, settings), survey.motion, at)
        error[name] = float(np.sqrt(np.mean(e[:, :3] ** 2)))
    # 10 %: what times of one short survey are off
    assert error["auto"] < 1.1 * error["right"]
    assert error["auto"] < error["wrong"]


def test_without_images_the_stated_times_hold_and_it_is_told() -> None:
    survey = outage.make_survey(1, outage.VoyageSpec(duration_s=20.0))
    facts = outage.fuse(survey, AUTO, with_images=False).facts["correlation_times"]
    assert facts == {
        "attitude_time_s": 20.0, "gnss_time_s": 10.0, "estimated": [], "asked_for": list(TIMES),
    }  # fmt: skip


def test_a_campaign_file_says_auto() -> None:
    section = FusedSection.model_validate({"gnss_time_s": "auto"})
    settings = FusionSettings.from_section(section.model_dump())
    assert settings.estimate_times == ("gnss_time_s",)
    assert (settings.attitude_time_s, settings.gnss_time_s) == (20.0, 10.0)
    with pytest.raises(ValueError, match="gnss_time_s"):
        FusedSection.model_validate({"gnss_time_s": "some time"})
