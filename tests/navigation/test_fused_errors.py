"""Sizes and times of the errors from a survey: found where it shows them, and what is not known of them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from thalweg.navigation.fusion import SPREAD, FusionErrors, FusionSettings, Prior
from thalweg.navigation.fusion.errors import applied
from thalweg.settings.sections import Fused as FusedSection
from thalweg_lab.studies import outage

SETTINGS = FusionSettings()


def model(**priors):
    """What is stated alone."""
    width = np.array([np.log(p.width) for p in priors.values()])
    return FusionErrors(priors=priors, h=np.array([p.at for p in priors.values()]), cov=np.diag(width**2))


@cache
def fused(seed, attitude_s, gnss_s, white=0.25):
    twin = {
        "ins": {"attitude_time_s": attitude_s, "rate_hz": 10.0},
        "gnss": {"correlation_time_s": gnss_s, "white_share": white, "rate_hz": 5.0},
    }
    survey = outage.make_survey(seed, outage.VoyageSpec(duration_s=60.0, twin=twin))
    return outage.fuse(survey, SETTINGS)


@cache
def short():
    return outage.make_survey(1, outage.VoyageSpec(duration_s=20.0))


@pytest.mark.parametrize(("attitude_s", "gnss_s"), [(1.0, 1.0), (20.0, 10.0), (3.0, 30.0)])
def test_times_are_found_whatever_they_are(attitude_s, gnss_s):
    """A survey holds the true times within its range of four sigmas, and short ones closely."""
    facts = fused(1, attitude_s, gnss_s).facts["errors"]
    for name, true in (("attitude_time_s", attitude_s), ("gnss_time_s", gnss_s)):
        sigma = np.log(facts[name]["high"] / facts[name]["low"]) / 3.92
        assert abs(np.log(facts[name]["estimated"] / true)) < 4 * sigma
        assert facts[name]["determined_by_survey"] or true > 5
        assert 1 / 1.8 < facts[name]["estimated"] / true < 1.8 or true > 5


@pytest.mark.parametrize("white", [0.05, 0.6])
def test_the_white_share_is_found(white):
    facts = fused(1, 20.0, 10.0, white).facts["errors"]["gnss_white_share"]
    assert facts["low"] < white < facts["high"]
    assert facts["determined_by_survey"]
    assert facts["stated"] == 0.25


def test_what_images_would_show_is_not_told_without_them_and_enlarges_the_sigmas():
    survey = short()
    found = outage.fuse(survey, SETTINGS, with_images=False)
    presumed = outage.fuse(survey, SETTINGS.replace(estimate_errors=False), with_images=False)
    assert {"roll_pitch", "heading", "attitude_time_s"} <= set(found.errors.untold())
    assert found.facts["errors"]["heading"]["estimated"] == pytest.approx(1.0, abs=0.1)
    assert presumed.facts["errors"] == {}
    assert any("does not show" in n and "roll_pitch 1 (2)" in n for n in found.facts["notes"])
    assert not any("does not show" in n for n in presumed.facts["notes"])
    at = survey.motion.start_gps_s + np.array([10.0])
    more = outage.errors_at(found, survey.motion, at)[1] / outage.errors_at(presumed, survey.motion, at)[1]
    # roll: E[f^2] of a factor of 2 is 2.6
    assert 1.8 < more[0, 3, 3] < 3.6


def test_fixed_values_stay_and_the_rest_is_estimated():
    found = outage.fuse(short(), SETTINGS.replace(fixed=("attitude_time_s", "gnss_white_share")))
    assert not {"attitude_time_s", "gnss_white"} & set(found.errors.priors)
    assert found.settings.attitude_time_s == 20.0
    assert found.solved.factors["gnss"] == found.solved.factors["gnss_white"]
    assert "gnss_time_s" in found.errors.priors
    assert {"velocity", "velocity_time_s", "acceleration"} - set(found.errors.priors) == {"acceleration"}


def test_points_have_the_mean_and_the_covariance():
    about = model(a=Prior(kind="size", centre=1.0, width=2.0), b=Prior(kind="time", centre=9.0, width=3.0))
    about = replace(about, cov=np.array([[0.4, 0.3], [0.3, 0.9]]))
    points = np.array(list(about.points()))
    assert len(points) == 16
    assert np.mean(points, axis=0) == pytest.approx(about.h)
    assert np.cov(points.T, bias=True) == pytest.approx(about.cov)


def test_the_mean_variance_of_an_unknown_size_is_that_of_a_logarithmic_normal():
    """``exp(2 s^2)``; points of eight values: to a tenth of it."""
    names = "abcdefgh"
    about = model(**{n: Prior(kind="size", centre=1.0, width=2.0) for n in names})
    squares = [[f**2 for f in about.values(h).values()] for h in about.points()]
    assert np.mean(squares) == pytest.approx(np.exp(2 * np.log(2.0) ** 2), rel=0.1)


def test_scales_of_priors_go_back():
    for kind, value in (("size", 0.7), ("time", 12.0), ("share", 0.25)):
        prior = Prior(kind=kind, centre=value, width=2.0)
        assert prior.value(prior.at) == pytest.approx(value)
    assert Prior(kind="share", centre=0.5, width=2.0).value(np.log(3.0)) == pytest.approx(0.75)


def test_slow_and_white_errors_of_positions_make_the_white_share():
    one = Prior(kind="size", centre=1.0, width=2.0)
    about = replace(model(gnss=one, gnss_white=one), h=np.log([2.0, 3.0]), white_share=0.25)
    share = about.facts()["gnss_white_share"]
    assert share["estimated"] == pytest.approx(0.25 * 9 / (0.75 * 4 + 0.25 * 9))
    assert share["stated"] == 0.25
    assert not share["determined_by_survey"]
    settings, factors = applied({"gnss": 2.0, "gnss_time_s": 3.0}, SETTINGS)
    assert settings.gnss_time_s == 3.0
    assert factors["gnss"] == factors["gnss_white"] == 2.0
    assert factors["velocity"] == 1.0


def test_a_campaign_file_says_auto_or_a_number_that_is_presumed():
    section = FusedSection.model_validate({"gnss_time_s": 3, "fixed": ["attitude_time_s"]})
    settings = FusionSettings.of(section)
    assert (settings.gnss_time_s, settings.attitude_time_s) == (3.0, 20.0)
    assert settings.fixed == ("attitude_time_s",)
    assert settings.spread == SPREAD
    with pytest.raises(ValueError, match="gnss_time_s"):
        FusedSection.model_validate({"gnss_time_s": "some time"})
    with pytest.raises(ValueError, match="fixed"):
        FusedSection.model_validate({"fixed": ["node_s"]})
