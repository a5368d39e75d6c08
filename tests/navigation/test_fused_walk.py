"""How far a boat goes by itself in a gap: sigmas where neither the INS's velocity nor images help."""

import numpy as np
import pytest

from tests.bands import band
from thalweg.navigation.fusion import FusionSettings
from thalweg.navigation.fusion.model import MODEL
from thalweg_lab.random_numbers import generator
from thalweg_lab.studies import outage

SETTINGS = FusionSettings(use_ins_velocity=False)
SLOW = {"ins": {"rate_hz": 10.0}, "gnss": {"rate_hz": 1.0}}
"""Rates that keep many surveys short."""


def with_gap(seed, length_s):
    """A survey with one outage; boats of other seeds turn otherwise, and the outage begins elsewhere."""
    turns = float(generator(seed, "test turns").uniform(35.0, 60.0))
    twin = SLOW | {"boat": {"zigzag_deg": turns}}
    survey = outage.make_survey(seed, outage.VoyageSpec(duration_s=110.0, twin=twin))
    t = survey.positions["t_gps_s"].to_numpy()
    begin = float(t[0]) + 15.0 + (t[-1] - t[0] - 30.0 - length_s) * generator(seed, "test gap").uniform()
    keep = (t < begin) | (t > begin + length_s)
    return (
        outage.fuse(survey, SETTINGS, keep_positions=keep, with_images=False),
        survey,
        (float(t[t < begin][-1]), float(t[t > begin + length_s][0])),
    )


@pytest.mark.parametrize(("length_s", "variance"), [(10.0, 0.25), (60.0, 1.0)])
def test_normalised_errors_hold_over_the_length_of_the_gap(length_s, variance):
    """Middle of the gap, 8 seeds of three axes.

    Sigmas of short gaps are twice the errors: the walk of the steps, by heave, is more than a straight leg
    needs. With a walk of that size alone the mean at 60 s is 5 and more.
    """
    squares = []
    for seed in range(1, 9):
        found, survey, (begin, end) = with_gap(seed, length_s)
        e, C = outage.errors_at(found, survey.motion, np.array([(begin + end) / 2]))
        squares.append(e[0, :3] @ np.linalg.solve(C[0, :3, :3], e[0, :3]) / 3)
    low, high = variance * band(3 * len(squares))
    assert low < np.mean(squares) < high


def test_only_the_steps_of_the_gap_walk_more():
    found, _, (begin, end) = with_gap(1, 30.0)
    t, walk = found.nodes.t_gps_s, found.nodes.walk
    inside = (t > begin + 1e-6) & (t < end + 1e-6)
    assert (found.nodes.kind[1:] == MODEL).all()
    assert {"velocity", "velocity_time_s", "acceleration"} & set(found.errors.priors) == {"acceleration"}
    assert (walk[~inside & (t > t[0] + 5) & (t < t[-1] - 5)] == 1.0).all()
    # the boat turns in the plane, in height it stays on the water
    assert walk[inside, :2].max() > 2.0
    assert walk[inside, 2].max() == 1.0


def test_the_velocity_of_the_ins_and_regular_images_need_none_of_it():
    survey = outage.make_survey(1, outage.VoyageSpec(duration_s=30.0))
    assert (outage.fuse(survey, FusionSettings()).nodes.walk == 1.0).all()
    alone = outage.fuse(survey, SETTINGS, with_positions=False)
    assert (alone.nodes.walk == 1.0).all()
