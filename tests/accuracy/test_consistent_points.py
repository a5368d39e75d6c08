"""Do the points know how good they are? Raw logs of eight seeds through the whole chain, against the truth.

Each seed is a survey of its own: poses, mounts and every shot err anew. The reach is bare, so that the
question is about the sigmas and not about leaves; that of `tiny`, `demo` and `mulde` is not.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from tests.accuracy.conftest import CORRELATION_S, TWIN
from thalweg.accuracy import chi_square_band, independent_squares
from thalweg_lab.settings import TwinConfig
from thalweg_lab.studies.survey import BARE
from thalweg_lab.truth import PointErrors

DURATION_S = TWIN["duration_s"]
Others = Callable[..., list[PointErrors]]


def normalised(study_errors: list[PointErrors], near_m: float = 0.0, far_m: float = 200.0) -> np.ndarray:
    """Mean over the bare ground of squared error over predicted variance, one value a seed."""
    out = []
    for errors in study_errors:
        use = errors.bare_ground & (errors.range_m >= near_m) & (errors.range_m < far_m)
        out.append(np.mean((errors.error_m[use] / errors.sigma_m[use]) ** 2))
    return np.array(out)


def band(seeds: int) -> tuple[float, float]:
    """95 % band of the mean over the seeds if one error of that correlation time made all of it.

    Several independent errors add up in each point, so consistent sigmas stay inside more often than that.
    """
    times = np.linspace(0.0, DURATION_S, 1000)
    return chi_square_band(seeds * independent_squares(times, np.ones(times.size), CORRELATION_S))


@pytest.fixture(scope="module")
def consistent(right_surveys):
    return right_surveys.along_normals


def test_normalised_errors_are_inside_their_band(consistent):
    low, high = band(len(consistent))
    assert high - low < 0.63  # sigmas that are 15 % too small or too large would be seen
    values = normalised(consistent)
    assert low < values.mean() < high, values


@pytest.mark.parametrize(("near_m", "far_m"), [(0.0, 17.0), (17.0, 25.0), (25.0, 100.0)])
def test_near_and_far_alike(consistent, near_m, far_m):
    """Too small a sigma far away must not be made up for by too large a one near by."""
    low, high = band(len(consistent))
    assert low < normalised(consistent, near_m, far_m).mean() < high


def test_95_percent_of_the_points_are_within_1_96_sigma(consistent):
    shares = [np.mean(np.abs(e.error_m[e.bare_ground]) < 1.96 * e.sigma_m[e.bare_ground]) for e in consistent]
    # shares of seeds scatter with their few independent errors: the mean is known to std / sqrt(n)
    assert abs(np.mean(shares) - 0.95) < 3 * np.std(shares, ddof=1) / np.sqrt(len(consistent))
    assert abs(np.mean(shares) - 0.95) < 0.02


def test_errors_of_seeds_have_no_common_sign(consistent):
    """A bias shared by all seeds would be an error of the chain, not of the sensors."""
    means = np.array([np.mean((e.error_m / e.sigma_m)[e.bare_ground]) for e in consistent])
    assert abs(means.mean()) < 3 * means.std(ddof=1) / np.sqrt(len(consistent))


@pytest.mark.parametrize(
    "unknown",
    [
        # 40 mG across the boat turn a compass by 11 degrees where the earth has 200 mG; the INS follows late
        {"ins": {"motor_field_mg": ((0.0, 40.0, 0.0), (0.0, 40.0, 0.0)), "magnetic_time_s": 2.0}},
        {"ins": {"heading_drift_degpmin": 40.0}},
        {"lidar": {"sigma_range_m": 0.12}},
    ],
    ids=["motor fields", "heading drift", "range noise"],
)
def test_an_effect_that_the_model_does_not_know_is_seen(other_surveys, unknown):
    (errors,) = other_surveys(1, effects={"lost_packets": 0.75}, **unknown)
    assert normalised([errors])[0] > band(1)[1]


def test_sigmas_that_promise_too_little_are_seen(consistent):
    """Two-sided: claimed sigmas a quarter too large leave the band below."""
    modest = [dataclasses.replace(errors, sigma_m=1.25 * errors.sigma_m) for errors in consistent]
    assert normalised(modest).mean() < band(len(consistent))[0]


@pytest.mark.slow
def test_on_the_whole_river_too(other_surveys):
    """The reach of `tiny` with stones, cobbles, bushes, trees, grass, houses: the same band, a little wider.

    Spots that graze a bump or a stone are counted in, which no sigma of a beam foresees; on a bank with
    relief of centimetres they widen the mean square by some percent.
    """
    changed = {*BARE, "length_m", "grid_m"}
    whole = TwinConfig.of_size("tiny").scene.model_dump(include=changed)
    values = normalised(other_surveys(20, scene=whole))
    low, high = band(20)
    assert low < values.mean() < 1.1 * high, values
