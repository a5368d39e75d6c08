"""Strips adjusted: a survey that is drawn from planes, so that the truth is known by construction."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from thalweg.core import CoverageError, ErrorChain, Trajectory, covariance_of_means
from thalweg.figures.survey import strips_page
from thalweg.lidar.cloud import LogSample
from thalweg.lidar.strips import LEAST_TOLD, adjust_strips, knots_over
from thalweg.settings.sections import Strips
from thalweg_lab.studies.sensors.strip_surveys import (
    MOUNT,
    Spec,
    cell_error_m,
    draw,
    nees,
    pose_errors,
    replaced,
    score,
    solve,
)

SMALL = {"length_m": 20.0, "estimate": False}


def test_the_covariance_of_means_is_that_of_the_sums() -> None:
    """Against the covariance of all nodes, written out."""
    rng = np.random.default_rng(3)
    t = np.array([0.1, 0.4, 0.9, 1.2, 1.3, 3.6, 3.8])
    link = 0.6 * rng.standard_normal((7, 4, 4)) / 2
    chain = ErrorChain(name="any", t_gps_s=t, root=rng.standard_normal((7, 6, 4)), link=link)
    whole = np.zeros((7, 6, 7, 6))
    for i in range(7):
        through = np.eye(4)
        for k in range(i, -1, -1):
            whole[i, :, k] = chain.root[i] @ through @ chain.root[k].T
            whole[k, :, i] = whole[i, :, k].T
            through = through @ link[k]
    # means over time of what is linear between nodes, by fine sums
    fine = (np.arange(40_000) + 0.5) / 10_000
    hats = np.stack([np.interp(fine, t, node) for node in np.eye(7)])
    mean = hats.reshape(7, 4, -1).mean(axis=2).T
    expected = np.einsum("bi,iukv,ck->bucv", mean, whole, mean).reshape(24, 24)
    np.testing.assert_allclose(covariance_of_means([chain], np.arange(5.0)), expected, atol=1e-7)


def test_a_bank_in_all_directions_halves_the_errors_and_says_so() -> None:
    rows = [score(seed, Spec(**SMALL)) for seed in (901, 902)]
    mean = {name: np.mean([row[name] for row in rows]) for name in ("nees_after", "nees_points")}
    before, after = (np.hypot(*(row[f"cell_{when}_mm"] for row in rows)) for when in ("before", "after"))
    assert after < 0.8 * before
    assert 0.4 < mean["nees_after"] < 1.8
    assert mean["nees_points"] < 1.8
    assert not [name for row in rows for name in row if name.startswith("names_") and row[name]]


def test_along_a_wall_nothing_is_told(tmp_path: Path) -> None:
    drawn = draw(903, Spec(bank="wall", **SMALL))
    found, poses, _ = solve(drawn, Spec(bank="wall", **SMALL))
    assert found.facts["told"]["north"] > 0.5, "the wall looks south"
    assert found.facts["told"]["east"] < LEAST_TOLD
    assert "east" in found.facts["not_told"]
    east = np.median(found.trajectory.sigma_position_m[:, 0] / poses.sigma_position_m[:, 0])
    assert east > 0.85
    found.write(tmp_path)
    back = Trajectory.read(tmp_path / "trajectory_strips.parquet")
    np.testing.assert_allclose(back.cov_pose_wcs, found.trajectory.cov_pose_wcs, rtol=1e-6, atol=1e-12)
    page = tmp_path / "strips.html"
    strips_page(found, title="A wall", twin=True, notes=["a note"]).write(page)
    assert "a note" in page.read_text()


def test_a_mount_that_is_off_shows_in_the_mount() -> None:
    spec = Spec(mount_deg=0.5, sigma_mount_deg=0.5, length_m=20.0, estimate=False)
    found, _, _ = solve(draw(904, spec), spec)
    row = found.border.set_index("unknown").loc["mount rotation z [rad]"]
    assert np.rad2deg(row["correction"]) == pytest.approx(-0.5, abs=3 * np.rad2deg(row["sigma"]))
    assert row["told"] > 0.5


def test_a_clock_that_is_off_is_named_and_where_it_is_asked_for_the_points_lie_better() -> None:
    spec = Spec(clock_s=0.005, chain="fused", **SMALL)
    drawn = draw(906, spec)
    found, _, _ = solve(drawn, spec)
    assert -6e-3 < found.facts["not_asked"]["clock offset [s]"]["correction"] < -2e-3, "at least"
    (note,) = [note for note in found.facts["notes"] if "clock" in note]
    assert "strips.sigma_clock_s" in note
    asked, _, _ = solve(drawn, replace(spec, settings={"sigma_clock_s": 0.01}))
    off = asked.border.set_index("unknown").loc["clock offset [s]"]
    assert off["correction"] == pytest.approx(-0.005, abs=max(5e-4, 4 * off["sigma"]))
    np.testing.assert_allclose(asked.of_lidar.t_gps_s - asked.trajectory.t_gps_s, -off["correction"])
    assert not [note for note in asked.facts["notes"] if "clock" in note]
    better, worse = (cell_error_m(drawn, replaced(drawn, each)) for each in (asked, found))
    assert better < worse


def test_errors_of_twice_what_is_stated_are_named_and_sigmas_grow() -> None:
    spec = Spec(size=2.0, chain="fused", **SMALL)
    drawn = draw(907, spec)
    found, _, _ = solve(drawn, spec)
    assert np.sqrt(found.facts["corrections_over_stated"]) == pytest.approx(2.0, abs=0.3)
    assert "stated too small" in found.facts["notes"][0]
    error = pose_errors(found.trajectory, drawn.truth)[5:-5]
    assert 0.3 < nees(error, found.trajectory.cov_pose_wcs[5:-5]) < 2.5, "four times as much without"


def test_points_of_no_plane_are_refused() -> None:
    drawn = draw(905, Spec(**SMALL))
    rng = np.random.default_rng(0)
    s = drawn.sample
    bush = LogSample(
        xyz_wcs_m=s.xyz_wcs_m + rng.normal(0, 1, s.xyz_wcs_m.shape),
        t_gps_s=s.t_gps_s,
        range_m=s.range_m,
        reflectivity=s.reflectivity,
    )
    with pytest.raises(CoverageError, match="plane spots of the bank were seen again"):
        adjust_strips(bush, drawn.trajectory, MOUNT, drawn.chains, Strips())


def test_a_log_too_long_for_its_knots_is_refused() -> None:
    drawn = draw(905, Spec(**SMALL))
    assert len(knots_over(drawn.trajectory, Strips())) == 81
    with pytest.raises(CoverageError, match=r"strips\.max_knots"):
        knots_over(drawn.trajectory, Strips(max_knots=10))
