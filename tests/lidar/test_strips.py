"""Strips adjusted: a survey that is drawn from planes, so that the truth is known by construction."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyproj import CRS
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from tests.core.conftest import FRAME, trajectory_of
from tests.lidar.conftest import block_of
from thalweg.core import (
    CoverageError,
    ErrorChain,
    InputError,
    LazWriter,
    Rigid,
    Trajectory,
    covariance_of_means,
)
from thalweg.figures.survey import strips_page
from thalweg.lidar import CELL_M, LogSettings, read_stable, strips, thin_log
from thalweg.lidar.overlap import planes_seen_again
from thalweg.lidar.strips import (
    BORDER,
    GROUPS,
    LEAST_TOLD,
    ODD,
    ON_CORNER,
    adjust_strips,
    claims,
    knots_over,
    mounts_by_strips,
)
from thalweg.settings.sections import Filters, Strips
from thalweg_lab.studies import normalised_squares
from thalweg_lab.studies.sensors.strip_surveys import (
    BEAM,
    MOUNT,
    Spec,
    cell_error_m,
    draw,
    pose_errors,
    replaced,
    score,
    solve,
)

T0_S = 4.0e8


def nees(error, cov):
    return np.mean(normalised_squares(error, cov)) / error.shape[1]


BORDER_SIGMA = np.array([*[1e-3] * 3, *[2e-3] * 3, 1e-9, 1e-9])
SMALL = {"length_m": 20.0, "estimate": False}


def test_the_covariance_of_means_is_that_of_the_sums():
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
    assert_allclose(covariance_of_means([chain], np.arange(5.0)), expected, atol=1e-7)


def test_a_bank_in_all_directions_halves_the_errors_and_says_so():
    rows = [score(seed, Spec(**SMALL)) for seed in (901, 902)]
    mean = {name: np.mean([row[name] for row in rows]) for name in ("nees_after", "nees_points")}
    before, after = (np.hypot(*(row[f"cell_{when}_mm"] for row in rows)) for when in ("before", "after"))
    assert after < 0.8 * before
    assert 0.4 < mean["nees_after"] < 1.8
    assert mean["nees_points"] < 1.8
    assert not [name for row in rows for name in row if name.startswith("names_") and row[name]]


def test_along_a_wall_nothing_is_told(tmp_path):
    drawn = draw(903, Spec(bank="wall", **SMALL))
    poses = drawn.trajectory
    vague = replace(MOUNT, cov=np.diag([0.03] * 3 + [np.deg2rad(0.06)] * 3) ** 2)
    found = adjust_strips(drawn.sample, poses, vague, drawn.chains, Strips(max_planes=1500))
    assert found.facts["told"]["north"] > 0.45, "the wall looks south"
    assert found.facts["told"]["east"] < LEAST_TOLD
    assert "east" in found.facts["not_told"]
    east = np.median(found.trajectory.sigma_position_m[:, 0] / poses.sigma_position_m[:, 0])
    assert east > 0.85
    # heights of points err by the mount's too, of which a wall tells little
    more = found.of_lidar.cov_pose_wcs[:, 2, 2] - found.trajectory.cov_pose_wcs[:, 2, 2]
    assert 0.02 < np.sqrt(np.median(more)) < 0.03
    found.write(tmp_path)
    back = Trajectory.read(tmp_path / "trajectory_strips.parquet")
    assert_allclose(back.cov_pose_wcs, found.trajectory.cov_pose_wcs, rtol=1e-6, atol=1e-12)
    page = tmp_path / "strips.html"
    strips_page(found, title="A wall", twin=True, notes=["a note"]).write(page)
    assert "a note" in page.read_text()


@pytest.fixture(scope="module")
def wrong_scanner():
    """A mount that is turned, ranges that are long and a clock that is late, each an unknown."""
    spec = Spec(
        mount_deg=0.5, sigma_mount_deg=0.5, length_m=20.0, estimate=False, clock_s=0.02,
        settings={"knot_s": 1.0, "sigma_range_m": 0.2, "sigma_clock_s": 0.03, "max_planes": 300},
    )  # fmt: skip
    drawn = draw(904, spec)
    ray = drawn.sample.xyz_wcs_m - drawn.trajectory.at(drawn.sample.t_gps_s)[0]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    x, t = drawn.sample.xyz_wcs_m + 0.1 * ray, drawn.sample.t_gps_s + T0_S
    drawn = replace(
        drawn,
        sample=replace(drawn.sample, xyz_wcs_m=x, t_gps_s=t),
        trajectory=replace(drawn.trajectory, t_gps_s=drawn.trajectory.t_gps_s + T0_S),
        chains=[replace(chain, t_gps_s=chain.t_gps_s + T0_S) for chain in drawn.chains],
    )
    found, poses, chains = solve(drawn, spec)
    mount = replace(MOUNT, cov=np.diag([2e-3] * 3 + [np.deg2rad(0.5)] * 3) ** 2)
    return poses, found, mount, chains


def test_mount_ranges_and_clock_that_are_off_show_there(wrong_scanner):
    """Their signs are those of the drawing; the bounds three sigmas."""
    found, mount = wrong_scanner[1:3]
    border = found.border.set_index("unknown")
    for name, correction in (
        ("mount rotation z [rad]", -np.deg2rad(0.5)),
        ("range offset [m]", -0.1),
        ("clock offset [s]", -0.02),
    ):
        row = border.loc[name]
        assert row["correction"] == pytest.approx(correction, abs=3 * row["sigma"]), name
        assert row["told"] > 0.5, name
        # of a prior that is wider where the distances doubt what is stated
        widened = (row["sigma"] / row["sigma_before"]) ** 2 / (1 - row["told"])
        assert widened == pytest.approx(1.0) if abs(row["z"]) <= 1 else 1.0 < widened < 1.1
    before = [*np.repeat([np.deg2rad(0.5), 2e-3], 3), 0.2, 0.03]
    assert_allclose(found.border["sigma_before"], before, rtol=1e-6)
    turned, moved = np.array(found.border["correction"])[:6].reshape(2, 3)
    assert_allclose(found.mount.R, Rotation.from_rotvec(turned).as_matrix() @ mount.R, atol=1e-12)
    assert_allclose(found.mount.shift_m, mount.shift_m + moved, atol=1e-12)
    assert_allclose(
        np.sqrt(np.diag(found.mount.cov)), found.border["sigma"].to_numpy()[[3, 4, 5, 0, 1, 2]], rtol=1e-9
    )


def test_tables_poses_and_facts_of_strips_are_of_one_mind(wrong_scanner):
    """Each column against the poses, the chains and the observations it comes from."""
    poses, found, _, chains = wrong_scanner
    knots, seen, facts = found.knots, found.observations, found.facts
    edges = T0_S + np.arange(41.0)
    assert_allclose(knots["t_gps_s"], edges[:-1] + 0.5)
    names = [("east", "m"), ("north", "m"), ("up", "m")]
    names += [(f"rotation_{axis}", "rad") for axis in ("east", "north", "up")]
    correction = np.stack([knots[f"{name}_{unit}"] for name, unit in names], axis=1)
    t = poses.t_gps_s
    of_time = np.stack([np.interp(t, knots["t_gps_s"], column) for column in correction.T], axis=1)
    assert_allclose(found.trajectory.position_wcs_m, poses.position_wcs_m + of_time[:, :3])
    turned = Rotation.from_rotvec(of_time[:, 3:]) * Rotation.from_quat(poses.quaternion_wcs_ics)
    off = (turned.inv() * Rotation.from_quat(found.trajectory.quaternion_wcs_ics)).magnitude()
    assert off.max() < 1e-9
    prior, grown = np.sqrt(np.diag(covariance_of_means(chains, edges))).reshape(-1, 6), []
    for i, (name, unit) in enumerate(names):
        sigma, before = knots[f"sigma_{name}_{unit}"], knots[f"sigma_{name}_before_{unit}"]
        assert_allclose(before, prior[:, i], rtol=1e-6)
        # of the prior that grew by what the corrections are over their statement
        grown.append((sigma / before) ** 2 / (1 - knots[f"told_{name}"]))
        assert facts["told"][name.replace("_", " ")] == pytest.approx(knots[f"told_{name}"].mean())
    assert 0.999 < np.min(grown) < 1.1
    assert_allclose(grown, np.min(grown), rtol=1e-6)
    # amid a span the pose errs as its mean does and by what is faster than the knots
    at = np.searchsorted(t, knots["t_gps_s"])
    assert_allclose(t[at], knots["t_gps_s"])
    faster = np.diagonal(poses.cov_pose_wcs[at], axis1=1, axis2=2) - prior**2
    own = np.stack([knots[f"sigma_{name}_{unit}"] for name, unit in names], axis=1) ** 2
    after = np.diagonal(found.trajectory.cov_pose_wcs[at], axis1=1, axis2=2)
    assert (after >= own * (1 - 1e-9)).all()
    assert_allclose(after[:, :3], own[:, :3] + faster[:, :3], rtol=0.05)
    count = np.histogram(seen["t_gps_s"], edges)[0]
    assert_array_equal(knots["observations"], count)
    used = seen["weight"] > 0.1
    assert facts["observations"] == len(seen) == count.sum()
    assert facts["not_on_planes"] == (~used).sum() > 0
    assert (facts["knots"], facts["knot_s"]) == (40, pytest.approx(1.0))
    assert facts["planes"] <= 300
    assert 40 < facts["told_unknowns"] < 6 * 40 + 8
    assert facts["redundancy"] == pytest.approx(len(seen) - 3 * facts["planes"] - facts["told_unknowns"])
    for when in ("before", "after"):
        rms = np.sqrt(np.mean(seen[f"{when}_m"][used] ** 2))
        assert facts[f"distance_{when}_m"] == pytest.approx(rms)
    assert facts["distance_after_m"] < 0.5 * facts["distance_before_m"]
    share = np.abs(seen["z"])[used]
    assert np.mean(share**2) == pytest.approx(1.0, abs=0.35)
    assert_allclose(seen["weight"], np.clip(1 - (seen["z"] / 4.685) ** 2, 0, None) ** 2, atol=1e-9)
    factor = seen["group"].map(facts["sigma_factors"])
    sigma = (seen["after_m"] / seen["z"] / factor).groupby(seen["group"]).median()
    assert sigma["smooth"] < sigma["middling"] < sigma["rough"]
    assert set(facts["sigma_factors"]) == set(GROUPS)
    untold = [name for name, share in facts["told"].items() if share < LEAST_TOLD]
    assert (
        facts["not_told"] == untold + found.border.loc[found.border["told"] < LEAST_TOLD, "unknown"].tolist()
    )


def test_the_lidar_s_mount_by_strips_is_exact_beside_its_own_poses(wrong_scanner):
    found = wrong_scanner[1]
    mounts = mounts_by_strips({"camera": "as it was", "lidar": "old"}, found)
    assert mounts["camera"] == "as it was"
    assert mounts["lidar"]["source"] == "overlapping strips of the survey"
    assert_allclose(mounts["lidar"]["lever_ics_m"], found.mount.shift_m)
    assert_array_equal([mounts["lidar"]["sigma_lever_m"], mounts["lidar"]["sigma_kappa_deg"] * np.ones(3)], 0)


@pytest.fixture(scope="module")
def inside():
    """A small adjustment: its task and observations, the covariance of all unknowns, and its result."""
    drawn = draw(12, Spec(length_m=10.0, estimate=False))
    vague = replace(MOUNT, cov=np.diag([0.02, 0.03, 0.04, 0.01, 0.02, 0.03]) ** 2)
    kept = {}
    made = strips._result

    def noted(task, seen, y, equations, L, *more):
        N = equations[0]
        kept["all"] = task, seen, L @ np.linalg.inv(np.eye(len(N)) + L.T @ N @ L) @ L.T
        return made(task, seen, y, equations, L, *more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(strips, "_result", noted)
        patch.setattr(strips, "claims", lambda *_: {})  # what is doubted has a test of its own
        found = adjust_strips(
            drawn.sample, drawn.trajectory, vague, drawn.chains, Strips(knot_s=1.0, max_planes=300)
        )
    return (*kept["all"], found)


def test_weights_are_those_of_the_scatter_and_of_roughness_in_common(inside):
    """Points of an observation and the scatter about its plane, from the cells made again."""
    task = inside[0]
    seen = task.observe(np.zeros(6 * task.n_spans + len(BORDER)))
    turned = task.x @ ON_CORNER.T
    planes = planes_seen_again(turned, task.t, 300, strips._place)
    k, of = planes.order, planes.owner
    off = np.einsum("ni,ni->n", turned[k] - planes.centre_m[of], planes.axes[of, :, 0])
    since = task.t[k] - task.edges[0]
    points = pd.DataFrame({"plane": of, "half_s": since // 0.5, "span": since // 1.0, "off": off})
    left = points["off"] - points.groupby(["plane", "half_s"])["off"].transform("mean")
    freedom = points.groupby("plane").size() - points.groupby("plane")["half_s"].nunique()
    variance = (left**2).groupby(points["plane"]).sum() / freedom
    n = points.groupby(["plane", "span"]).size()
    expected = np.sqrt([variance[plane] * (1 / count + 0.05) for (plane, _), count in n.items()])
    kept = np.isin(n.index.get_level_values("plane"), seen.owner)
    assert_allclose(seen.sigma, expected[kept], rtol=1e-3)
    assert_allclose(seen.root_weight(), 1 / seen.sigma)
    seen.robust, seen.factors = np.full(len(seen.sigma), 0.25), np.arange(1.0, 1.0 + len(strips.GROUPS))
    assert_allclose(seen.root_weight(), 0.5 / seen.sigma / (1 + seen.group))


def test_residuals_are_divided_by_what_their_plane_leaves_of_them(inside):
    """Against the hat matrix of each plane by itself."""
    task = inside[0]
    seen = task.observe(np.zeros(6 * task.n_spans + len(BORDER)))
    seen.weigh(np.zeros(seen.A.shape[1]), tukey=False)
    for plane in np.unique(seen.owner)[::7]:
        k = seen.owner == plane
        B = np.column_stack([np.ones(k.sum()), seen.uv[k]]) / seen.sigma[k, None]
        left = np.eye(k.sum()) - B @ np.linalg.pinv(B)
        z = left @ (seen.d[k] / seen.sigma[k]) / np.sqrt(np.clip(np.diag(left), 0.05, 1.0))
        assert_allclose(seen.z[k] * seen.factors[seen.group[k]], z, rtol=1e-4, atol=1e-4)


def test_points_move_with_mount_range_and_clock_as_their_equation_says(inside):
    """Differences of ``X(t) + R(t) (R_m x_s + l)`` itself; ranges are those from the scanner."""
    task = inside[0]
    rng = np.random.default_rng(4)
    n, l_m = rng.standard_normal((6, 3)), task.mount.shift_m
    R = Rotation.random(6, rng).as_matrix()
    x_s, v, omega = (rng.standard_normal((6, 3)) * size for size in (8.0, 1.0, 0.1))

    def placed(step):
        turned = Rotation.from_rotvec(step[:3]).apply(
            x_s * (1 + step[6] / np.linalg.norm(x_s, axis=1))[:, None]
        )
        arm = np.einsum("nij,nj->ni", R, turned + l_m + step[3:6])
        return arm + step[7] * (v + np.cross(omega, arm))

    arm = placed(np.zeros(8))
    rows = task.border_rows(n, arm, R, v + np.cross(omega, arm))
    for i, one in enumerate(1e-6 * np.eye(8)):
        slope = np.sum(n * (placed(one) - placed(-one)), axis=1) / 2e-6
        assert_allclose(rows[:, i], slope, rtol=1e-6, atol=1e-6, err_msg=BORDER[i])


def test_points_err_by_poses_and_mount_with_what_both_have_in_common(inside):
    """Variances along normals by the covariance of all unknowns, and by the poses of the lidar alone."""
    task, _, Q, found = inside
    rng = np.random.default_rng(5)
    u = 6 * task.n_spans
    at = np.searchsorted(found.trajectory.t_gps_s, task.centre - 1e-6)
    assert_allclose(found.trajectory.t_gps_s[at], task.centre)
    R_of = Rotation.from_quat(task.trajectory.quaternion_wcs_ics[at]).as_matrix()
    for k in range(2, task.n_spans, 5):
        n, x_s = rng.standard_normal(3), 10 * rng.standard_normal(3)
        R = R_of[k]
        arm, body = R @ (x_s + task.mount.shift_m), R.T @ n
        pose = np.concatenate([n, np.cross(arm, n)])
        mount = np.concatenate([np.cross(x_s, body), body])
        ours = slice(6 * k, 6 * k + 6)
        more = 2 * pose @ Q[ours, u : u + 6] @ mount + mount @ Q[u : u + 6, u : u + 6] @ mount
        both = found.of_lidar.cov_pose_wcs[at[k]] - found.trajectory.cov_pose_wcs[at[k]]
        assert pose @ both @ pose == pytest.approx(more, rel=1e-5)


def test_the_chains_hold_what_neighbouring_spans_have_in_common(inside):
    task, _, Q, found = inside
    for chains, is_sum in ((found.chains, False), (found.chains_of_lidar, True)):
        chain = next(each for each in chains if each.name == "adjusted strips")
        for k in range(1, task.n_spans, 4):
            common = chain.root[k - 1] @ chain.link[k].T @ chain.root[k].T
            expected = Q[6 * k - 6 : 6 * k, 6 * k : 6 * k + 6]
            size = np.sqrt(np.outer(*(np.diag(Q)[6 * j : 6 * j + 6] for j in (k - 1, k))))
            near = np.allclose(common / size, expected / size, atol=1e-4)
            assert near != is_sum


@pytest.fixture(scope="module")
def border_equations():
    """Curvature (8, 8) of an eight-dimensional border whose unknowns are told from each other badly."""
    A = (
        np.random.default_rng(8).standard_normal((9, 8))
        / np.r_[2e-3, 1e-3, 5e-3, 4e-3, 0.02, 1e-3, 1e-3, 1e-3]
    )
    return A.T @ A


def test_what_is_stated_of_mount_range_and_clock_is_tested_without_itself(border_equations):
    """Against the solution with one prior left out, and the mixture's mean and variance by sums."""
    C, P = border_equations, np.diag(BORDER_SIGMA**-2)
    g = C @ np.r_[0.0, 0.0, 0.02, np.zeros(5)]
    found = claims(C, g, BORDER_SIGMA**2)
    assert len(found) == 8
    first = next(iter(found))
    P[first, first] = 0.0
    Q = np.linalg.inv(C + P)
    claim, s = found[first], BORDER_SIGMA[first]
    assert claim.value == pytest.approx((Q @ g)[first], rel=1e-6)
    assert claim.sigma == pytest.approx(np.sqrt(Q[first, first]), rel=1e-6)
    assert claim.z == pytest.approx(claim.value / np.hypot(claim.sigma, s), rel=1e-6)
    # the most doubtful one comes first; nothing that is left has more without its own prior
    others = np.abs([found[i].z for i in found if i != first])
    assert abs(claim.z) > others.max()
    # two priors with odds of 19 to 1, the second with the variance that makes the value most probable
    x = np.linspace(-0.2, 0.2, 400_001)
    seen = np.exp(-(((x - claim.value) / claim.sigma) ** 2) / 2)
    wide = np.sqrt(claim.value**2 - claim.sigma**2)
    priors = [np.exp(-((x / each) ** 2) / 2) / each for each in (s, wide)]
    both = (0.95 * priors[0] + 0.05 * priors[1]) * seen
    stated = priors[0] * seen
    (mean, of_stated), (square, of_square) = (
        [np.sum(x**power * each) / each.sum() for each in (both, stated)] for power in (1, 2)
    )
    assert claim.shift == pytest.approx(mean - of_stated, rel=1e-3)
    assert claim.variance == pytest.approx(square - mean**2 - of_square + of_stated**2, rel=1e-3)


def test_what_is_stated_rightly_is_named_in_one_survey_of_twenty(border_equations):
    C, rng = border_equations, np.random.default_rng(20)
    root = np.linalg.cholesky(C + C @ np.diag(BORDER_SIGMA**2) @ C)
    most = [
        max(abs(claim.z) for claim in claims(C, root @ rng.standard_normal(8), BORDER_SIGMA**2).values())
        for _ in range(400)
    ]
    assert np.mean(np.array(most) > norm.isf(ODD / 2 / 8)) < 0.09, "three sigmas of 400 draws"
    assert np.mean(np.array(most) > norm.isf(ODD / 2 / 8)) > 0.01


def test_a_mount_off_by_more_than_stated_is_named_and_the_poses_are_not_too_bold():
    spec = Spec(mount_deg=1.0, chain="fused", settings={"knot_s": 1.0, "max_planes": 1500}, **SMALL)
    drawn = draw(908, spec)
    found, _, _ = solve(drawn, spec)
    (note,) = [note for note in found.facts["notes"] if "mount" in note]
    assert "mount rotation z were off by 1." in note or "mount rotation z were off by 0.9" in note
    row = found.border.set_index("unknown").loc["mount rotation z [rad]"]
    assert np.rad2deg(row["correction"]) == pytest.approx(-1.0, abs=3 * np.rad2deg(row["sigma"]))
    assert row["z"] < -5
    error = pose_errors(found.trajectory, drawn.truth)[5:-5:5]
    assert nees(error, found.trajectory.cov_pose_wcs[5:-5:5]) < 2.5


def test_stable_surfaces_tell_what_passes_have_in_common():
    """Heights of all poses alike are told, with a true sigma; surfaces that are shifted as a whole say so."""
    drawn = draw(12, Spec(**SMALL))
    rng = np.random.default_rng(12)
    k = rng.choice(np.flatnonzero(drawn.still), 20_000, replace=False)
    surfaces = drawn.true_m[k] + 0.005 * rng.standard_normal((len(k), 3))

    def adjusted(points, **more):
        settings = Strips(knot_s=1.0, max_planes=700, **more)
        return adjust_strips(drawn.sample, drawn.trajectory, MOUNT, drawn.chains, settings, points)

    alone, told = adjusted(None), adjusted(surfaces)
    assert alone.facts["stable_observations"] == 0 < 300 < told.facts["stable_observations"]
    bounds = {}
    for name, found in (("alone", alone), ("told", told)):
        error = pose_errors(found.trajectory, drawn.truth)[5:-5:5]
        bounds[name] = np.abs(error[:, :3].mean(axis=0))
        assert 0.3 < nees(error, found.trajectory.cov_pose_wcs[5:-5:5]) < 2.0, name
    assert (bounds["told"] < 0.007).all(), "three sigmas of the lever and of the surfaces"
    assert told.facts["told"]["up"] > 0.9 > alone.facts["told"]["up"]
    shift = np.array([0.1, -0.05, 0.08])
    moved = adjusted(surfaces + shift, sigma_stable_shift_m=0.3)
    border = moved.border.set_index("unknown")
    for axis, by in zip(("east", "north", "up"), shift, strict=True):
        row = border.loc[f"stable surfaces {axis} [m]"]
        assert row["correction"] == pytest.approx(-by, abs=3 * row["sigma"])
        assert 0.0015 < row["sigma"] < 0.03, "the poses' own"
    with pytest.raises(CoverageError, match=r"strips\.sigma_stable_shift_m"):
        adjusted(surfaces + np.array([0.0, 50.0, 0.0]))


def test_a_clock_that_is_off_is_named_and_where_it_is_asked_for_the_points_lie_better():
    spec = Spec(clock_s=0.005, chain="fused", **SMALL)
    drawn = draw(906, spec)
    found, _, _ = solve(drawn, spec)
    assert -6e-3 < found.facts["not_asked"]["clock offset [s]"]["correction"] < -2e-3, "at least"
    (note,) = [note for note in found.facts["notes"] if "clock" in note]
    assert "strips.sigma_clock_s" in note
    asked, _, _ = solve(drawn, replace(spec, settings={"sigma_clock_s": 0.01}))
    off = asked.border.set_index("unknown").loc["clock offset [s]"]
    assert off["correction"] == pytest.approx(-0.005, abs=max(5e-4, 4 * off["sigma"]))
    assert_allclose(asked.of_lidar.t_gps_s - asked.trajectory.t_gps_s, -off["correction"])
    assert not [note for note in asked.facts["notes"] if "clock" in note]
    better, worse = (cell_error_m(drawn, replaced(drawn, each)) for each in (asked, found))
    assert better < worse


def test_errors_of_twice_what_is_stated_are_named_and_sigmas_grow():
    spec = Spec(size=2.0, chain="fused", **SMALL)
    drawn = draw(907, spec)
    found, _, _ = solve(drawn, spec)
    assert np.sqrt(found.facts["corrections_over_stated"]) == pytest.approx(2.0, abs=0.3)
    assert "stated too small" in found.facts["notes"][0]
    error = pose_errors(found.trajectory, drawn.truth)[5:-5]
    assert 0.3 < nees(error, found.trajectory.cov_pose_wcs[5:-5]) < 2.5, "four times as much without"


def test_points_of_no_plane_are_refused():
    drawn = draw(905, Spec(**SMALL))
    leaves = np.random.default_rng(0).normal(0, 1, drawn.sample.xyz_wcs_m.shape)
    bush = replace(drawn.sample, xyz_wcs_m=drawn.sample.xyz_wcs_m + leaves)
    with pytest.raises(CoverageError, match="plane spots of the bank were seen again"):
        adjust_strips(bush, drawn.trajectory, MOUNT, drawn.chains, Strips())


def test_a_log_too_long_for_its_knots_is_refused():
    drawn = draw(905, Spec(**SMALL))
    assert len(knots_over(drawn.trajectory, Strips())) == 81
    with pytest.raises(CoverageError, match=r"strips\.max_knots"):
        knots_over(drawn.trajectory, Strips(max_knots=10))


def test_thinning_keeps_some_points_of_each_cell_and_half_second_above_the_water():
    """Twelve points of one cell at one time, two half a second later, one of the next cell, one too near."""
    t = 4.0e8 + np.repeat([0.1, 0.6, 0.1, 0.1], [12, 2, 1, 1])
    at = np.repeat(
        [[1.1, 3.1, 1.1], [1.1, 3.1, 1.1], [1.1 + CELL_M, 3.1, 1.1], [0.1, 0.2, 0.1]], [12, 2, 1, 1], axis=0
    )
    at += 0.01 * np.random.default_rng(5).random(at.shape)
    whole = block_of(t, at, intensity=np.arange(16, dtype=np.uint8))
    boat = trajectory_of(4.0e8 + np.array([-1.0, 2.0]), [10.0, 20.0, 3.0], cov=0.0)
    log = SimpleNamespace(points=lambda *_, **__: iter([whole]))
    mount = Rigid(R=np.eye(3), shift_m=np.zeros(3), cov=np.zeros((6, 6)))
    filters = Filters(below_water_m=None, mirror_ghosts=False, isolated_neighbours=0)
    how = LogSettings(mount=mount, beam=BEAM, filters=filters, min_range_m=0.8, max_range_m=9.0)
    thin = thin_log(log, None, boat, how)
    assert_array_equal(np.histogram(thin.t_gps_s - 4.0e8, [0, 0.5, 1.0])[0], [5, 2])
    kept = thin.reflectivity.astype(int)
    assert (len({*kept}), 14 in kept, 15 in kept) == (7, True, False)
    assert_allclose(thin.xyz_wcs_m, at[kept] + [10.0, 20.0, 3.0], atol=1e-6)
    assert_allclose(thin.range_m, np.linalg.norm(at[kept], axis=1), rtol=1e-6)
    assert_array_equal(thin.t_gps_s, t[kept])


def test_stable_surfaces_are_read_in_the_frame_of_the_trajectory_or_refused(tmp_path):
    xyz, utm = np.random.default_rng(3).uniform(-20.0, 20.0, (50, 3)), CRS.from_epsg(25833)
    local, on_map, bare = (tmp_path / f"{name}.laz" for name in ("local", "map", "bare"))
    for path, stated in ((local, FRAME), (on_map, utm), (bare, None)):
        with LazWriter(path, stated) as cloud:
            cloud.append(xyz if path == local else FRAME.to_map(xyz, utm))
    points, _ = read_stable([local, on_map], FRAME, None)
    assert_allclose(points, np.concatenate([xyz, xyz]), atol=2e-3)
    with pytest.raises(InputError, match="--crs"):
        read_stable([bare], FRAME, None)
    points, notes = read_stable([bare], FRAME, "EPSG:25833")
    assert_allclose(points, xyz, atol=2e-3)
    assert any("EPSG:25833" in note for note in notes)
    assert read_stable([], FRAME, None)[0].shape == (0, 3)
