"""One form for a clock; ties before and after a run; pulses of a hardware trigger."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from thalweg.clocks import TIE_COLUMNS, ClockModel, clock_from_ties, read_number_columns, read_text_columns
from thalweg.clocks.ties import (
    _NAMED,
    _names,
    clock_from_pulses,
    image_times_words,
    match_pulses,
    trigger_clock,
)
from thalweg.core import ClockError, InputError

T0 = 3.0e8


def test_a_clock_and_its_sigma_at_any_time():
    clock = ClockModel(
        offset_s=-2.5, drift=20e-6, reference_s=T0, cov=np.array([[4e-6, 1e-9], [1e-9, 1e-12]]), jitter_s=0.02
    )
    t_gps, sigma = clock.to_gps([T0, T0 + 1000.0])
    # 5 ns: two roundings of a time of 3e8 s in float64 at 60 ns would be 1.2e-7
    assert_allclose(t_gps - T0, [-2.5, 1000.0 - 2.5 + 0.02], atol=1.2e-7)
    # 4e-6 + 2e-6 + 1e-6 of the clock, 4e-4 of the image
    assert_allclose(sigma, np.sqrt([4.04e-4, 4.07e-4]), rtol=1e-12)
    assert_allclose(clock.to_gps([T0, T0 + 1000.0], jitter=False)[1], np.sqrt([4e-6, 7e-6]), rtol=1e-12)


def test_what_is_said_of_a_clock_and_its_images():
    clock = ClockModel(offset_s=0.0, reference_s=T0, cov=np.diag([4e-6, 1e-12]))
    assert clock.sigma_offset_s == pytest.approx(0.002)
    known = {"t_gps_s": [1.0, 2.0, 3.0, np.nan], "sigma_s": [0.001, 0.003, 0.020, np.nan]}
    times = pd.DataFrame(known | {"matched": [True, True, False, False]})
    assert image_times_words(times) == (
        "Times of 4 images: 2 by their pulse (sigma up to 3.00 ms), 1 by the camera's own clock (sigma up to "
        "20.00 ms), 1 without a time."
    )
    assert image_times_words(times[3:]) == "Times of 1 images: 1 without a time."
    assert _names([]) == "none"
    assert _names(["a"] * _NAMED) == ", ".join(["a"] * _NAMED)
    assert _names(["a"] * (_NAMED + 2)).endswith("a and 2 more")


def test_a_clock_survives_its_file(tmp_path):
    told = {"offset_s": 1.25, "drift": -3e-6, "reference_s": T0, "jitter_s": 0.023, "source": "two ties"}
    told |= {"t_first_s": T0 - 5, "t_last_s": T0 + 5, "notes": ("a", "b")}
    clock = ClockModel(cov=np.array([[1e-6, 2e-13], [2e-13, 1e-14]]), **told)
    clock.write(tmp_path / "camera_clock.yaml")
    again = ClockModel.read(tmp_path / "camera_clock.yaml")
    assert np.array_equal(again.cov, clock.cov)
    assert {name: getattr(again, name) for name in told} == told
    assert np.isnan(again.sigma_jitter_s)
    assert any("1250.000 ms" in line for line in clock.lines())


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("[1, 2", "not valid YAML"),
        ("a: 1\n", "no clock file"),
        ("thalweg_clock: 1\noffset_s: 1\n", "missing, unknown"),
        ("thalweg_clock: 1\noffset_s: x\nreference_s: 0\ncov: [[1, 0], [0, 1]]\n", "no number"),
        ("thalweg_clock: 1\noffset_s: 1\nreference_s: 0\ncov: [[1, 0], [0, -1]]\n", "covariance"),
    ],
)
def test_files_that_are_no_clock(tmp_path, text, word):
    path = tmp_path / "clock.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=word):
        ClockModel.read(path)
    with pytest.raises(InputError, match="no such file"):
        ClockModel.read(tmp_path / "absent.yaml")


def test_two_ties_give_offset_and_drift_by_hand():
    """Sigmas of 3 and 4 ms an hour apart: those of the line between and behind them, by the law of errors."""
    gps = T0 + 2.3 + np.array([0.0, 3600.0 + 0.09])
    clock = clock_from_ties(T0 + np.array([0.0, 3600.0]), gps, np.array([0.003, 0.004]))
    found, sigma = clock.to_gps(T0 + np.array([0.0, 1800.0, 3600.0, 5400.0]))
    # float64 of times of 3e8 s: 6e-8 s
    assert_allclose(found - T0, [2.3, 1802.345, 3602.39, 5402.435], atol=2e-7)
    # weights 1 - u and u: 5 / 2 ms in the middle, and half as far behind again sqrt(1.5^2 + 6^2)
    assert_allclose(sigma, [0.003, 0.0025, 0.004, np.hypot(0.0015, 0.006)], rtol=1e-9)


def test_one_tie_gives_the_offset_only_and_says_so():
    clock = clock_from_ties([T0], [T0 + 2.0], 0.005, sigma_drift=50e-6)
    assert (clock.offset_s, clock.drift) == (2.0, 0.0)
    _, sigma = clock.to_gps([T0, T0 + 3600.0])
    assert_allclose(sigma, [0.005, np.hypot(0.005, 0.18)], rtol=1e-9)
    assert any("drift is not determined" in note and "180 ms" in note for note in clock.notes)


def test_a_clock_that_was_set_in_between_is_refused():
    with pytest.raises(ClockError, match=r"\+3600\.000 s .*a time zone.*was set in between"):
        clock_from_ties([T0, T0 + 7200.0], [T0 + 1.0, T0 + 7200.0 + 3601.0], 0.005)


def test_an_offset_of_whole_hours_is_named():
    clock = clock_from_ties([T0, T0 + 600.0], [T0 - 7200.0, T0 + 600.0 - 7200.0], 0.005)
    assert any("-2:00 h: a time zone" in note for note in clock.notes)
    assert clock.offset_s == -7200.0  # stated, not corrected


def test_ties_from_a_table(tmp_path):
    path = tmp_path / "ties.csv"
    path.write_text("t_device_s,t_gps_s,sigma_s\n1,2.5,0.01\n11,12.5,0.01\n")
    assert read_number_columns(path, TIE_COLUMNS)[1].tolist() == [2.5, 12.5]
    path.write_text("t_device_s,t_gps_s,sigma_s\n1,2.5,0.01\n11,x,0.01\n")
    with pytest.raises(InputError, match="row 2"):
        read_number_columns(path, TIE_COLUMNS)
    path.write_text("t_device_s,t_gps_s\n1,2\n")
    with pytest.raises(InputError, match="sigma_s"):
        read_number_columns(path, TIE_COLUMNS)
    path.write_text("")
    with pytest.raises(InputError, match="the file is empty"):
        read_number_columns(path, TIE_COLUMNS)
    path.write_text("file, text\na.jpg, 08:31:07.42\n")
    assert read_text_columns(path, ("file", "text")) == [["a.jpg"], ["08:31:07.42"]]
    with pytest.raises(ClockError, match="at least one tie"):
        clock_from_ties([1.0], [2.0], 0.0)


# ---------------------------------------------------------------- trigger


def pulses(rng, n=60):
    """Pulses every second, but for pauses that break the rhythm."""
    step = np.ones(n)
    step[[17, 31]] = (3.4, 2.7)
    return T0 + np.cumsum(step) + rng.uniform(0, 1)


def test_images_find_their_pulses_with_losses_on_both_sides(tmp_path):
    rng = np.random.default_rng(2)
    pulse = pulses(rng)
    taken = np.delete(np.arange(60), [0, 5, 40])  # three pulses made no image
    t = pulse[taken] - 712.25 + 0.002 * rng.standard_normal(taken.size)
    t = np.sort(np.append(t, t[20] + 0.5))  # one image was taken by hand
    match = match_pulses(t, pulse)
    assert (match.images_without_pulse, match.pulses_without_image) == (1, 3)
    assert np.flatnonzero(match.image < 0).tolist() == [0, 5, 40]
    assert match.pulse[21] == -1
    assert match.image[[0, 5, 40]].tolist() == [-1, -1, -1]
    clock = clock_from_pulses(t, pulse, match, delay_s=0.003)
    # 57 images with 2 ms each: 0.3 ms, five times that
    assert clock.offset_s == pytest.approx(712.25 + 0.003, abs=1.5e-3)
    assert clock.jitter_s == pytest.approx(0.002, rel=0.5)
    clock.write(tmp_path / "camera_clock.yaml")
    assert ClockModel.read(tmp_path / "camera_clock.yaml").sigma_jitter_s == clock.sigma_jitter_s


def test_a_perfect_rhythm_with_a_loss_at_an_end_is_refused():
    pulse = T0 + np.arange(30.0)
    with pytest.raises(ClockError, match=r"alignments .* fit alike"):
        match_pulses(pulse[1:] - 500.0, pulse)


def test_pulses_of_another_run_are_refused():
    rng = np.random.default_rng(3)
    with pytest.raises(ClockError, match="at best"):
        match_pulses(np.sort(rng.uniform(0, 60, 40)), np.sort(rng.uniform(0, 6000, 40)), tolerance_s=0.02)
    with pytest.raises(ClockError, match="at least three"):
        match_pulses([1.0, 2.0], [1.0, 2.0, 3.0])


def test_the_line_through_pulses_by_hand():
    """Six images, off by +1, -1, 0, 0, -1, +1 ms: no drift, 4 ms^2 over 4 degrees of freedom."""
    t = np.arange(6.0)
    pulse = t + 100.0 + 1e-3 * np.array([1.0, -1.0, 0.0, 0.0, -1.0, 1.0])
    match = match_pulses(t, pulse)
    # the median of 1, 1, 0, 0, 1, 1 ms is that of a normal error of 1.4826 ms
    assert (match.offset_s, match.misfit_s) == pytest.approx((100.0, 1.4826e-3), rel=1e-6)
    clock = clock_from_pulses(t, pulse, match, delay_s=0.0025)
    # 1e-9 s: a float64 of 100 s holds 1.4e-14, the sums lose some digits
    assert clock.offset_s == pytest.approx(100.0025, abs=1e-9)
    assert clock.drift == pytest.approx(0.0, abs=1e-9)
    assert clock.jitter_s == pytest.approx(1e-3, rel=1e-6)
    assert clock.sigma_jitter_s == pytest.approx(1e-3 / np.sqrt(8), rel=1e-6)
    # 1 ms^2 / 6; 1 ms^2 over 2 (0.5^2 + 1.5^2 + 2.5^2) s^2
    assert_allclose(clock.cov, np.diag([1e-6 / 6, 1e-6 / 17.5]), rtol=1e-6)
    assert (clock.reference_s, clock.t_first_s, clock.t_last_s) == (2.5, 0.0, 5.0)


@pytest.mark.parametrize(("square", "fits"), [(10.7, True), (10.95, False)])
def test_three_ties_have_one_degree_of_freedom(square, fits):
    """10.828 is exceeded by 0.1 % of chi-squares of one degree (Abramowitz and Stegun 1964, table 26.8).

    Off by +a, -2 a, +a the ties leave no slope and a sum of squares of 6 a^2.
    """
    gps = np.array([0.0, 100.0, 200.0]) + 0.01 * np.sqrt(square / 6) * np.array([1.0, -2.0, 1.0])
    if fits:
        assert "3 ties fit a straight line." in clock_from_ties([0.0, 100.0, 200.0], gps, 0.01).notes
    else:
        with pytest.raises(ClockError, match="not on a straight line"):
            clock_from_ties([0.0, 100.0, 200.0], gps, 0.01)


@pytest.mark.parametrize(("error", "words"), [(0.1, r"tie 2 is off by \+"), (-0.1, "tie 2 is off by -")])
def test_the_worst_tie_may_be_late_or_early(error, words):
    t = T0 + np.arange(5) * 600.0
    with pytest.raises(ClockError, match=words):
        clock_from_ties(t, t + error * np.eye(5)[1], 0.005)


@pytest.mark.parametrize(("missing", "found"), [(50, True), (51, False)])
def test_up_to_fifty_pulses_may_lie_before_the_first_image(missing, found):
    """200 pulses and 200 images, with intervals that grow by 10 ms each: no other alignment fits."""
    pulse = np.cumsum(1.0 + 0.01 * np.arange(260))
    images = pulse[missing : missing + 200] - 500.0
    if found:
        match = match_pulses(images, pulse[:200], tolerance_s=0.001)
        assert match.pulse[:3].tolist() == [50, 51, 52]
        assert match.pulses_without_image == 50
    else:
        with pytest.raises(ClockError, match="at best"):
            match_pulses(images, pulse[:200], tolerance_s=0.001)


def test_one_tie_without_sigma_is_refused():
    with pytest.raises(ClockError, match="a sigma above 0"):
        clock_from_ties([T0, T0 + 600.0], [T0, T0 + 600.0], [0.005, 0.0])


def test_pauses_do_not_widen_what_counts_as_near():
    """Pulses each second but for a pause of 100 s; one without image, and an image by hand 0.4 s after it."""
    pulse = np.r_[np.arange(20.0), 120.0 + np.arange(20.0)]
    image = pulse - 500.0
    image[5] += 0.4
    match = match_pulses(image, pulse)
    assert np.flatnonzero(match.pulse < 0).tolist() == [5]


def test_images_of_the_end_of_many_pulses_are_found():
    """Twenty images of pulses 75 to 94 of a hundred; more than fifty may be missing where there are more."""
    pulse = np.cumsum(1.0 + 0.01 * np.arange(100))
    match = match_pulses(pulse[75:95] - 500.0, pulse, tolerance_s=0.001)
    assert match.pulse.tolist() == list(range(75, 95))
    assert match.image.tolist() == [-1] * 75 + list(range(20)) + [-1] * 5
    assert (match.images_without_pulse, match.pulses_without_image) == (0, 80)


def test_a_trigger_is_without_error_but_for_its_stated_delay_and_jitter():
    clock, late = (
        trigger_clock(t_first_s=T0, t_last_s=T0 + 100, **more)
        for more in ({}, {"delay_s": 0.003, "jitter_s": 2e-4})
    )
    assert (clock.offset_s, clock.drift, clock.jitter_s) == (0.0, 0.0, 0.0)
    assert (clock.reference_s, clock.t_first_s, clock.t_last_s) == (T0 + 50, T0, T0 + 100)
    assert "delay" not in clock.source
    assert not clock.cov.any()
    assert not late.cov.any()
    assert (late.offset_s, late.jitter_s) == (0.003, 2e-4)
    assert late.source.endswith("with a delay of 3 ms")
    assert late.to_gps([T0])[1] == pytest.approx(2e-4)


def test_stamps_that_stand_still_once_are_refused_and_three_of_each_are_enough():
    good = np.array([0.0, 1.0, 2.5, 4.5, 7.0])
    once = np.array([0.0, 1.0, 1.0, 4.5, 7.0])
    for t, p in ((once, good), (good, once), (good[::-1], good), (good[:2], good), (good, good[:2])):
        with pytest.raises(ClockError, match="at least three of each, in order of time"):
            match_pulses(t, p)
    assert match_pulses(good[:3] - 50.0, good[:3]).pulse.tolist() == [0, 1, 2]
