"""The block adjustment against a dense one, finite differences, and truth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.bands import band
from tests.images import block_scene
from thalweg.core import GeometryError, UnobservableError
from thalweg.images.bundle import AdjustedBlock
from thalweg.images.bundle.adjustment import _flat, adjust_block, adjusted_cameras, control_result, repeated
from thalweg.images.bundle.normals import Correlation, linearised, reduced_system, tracks_of, views
from thalweg.images.bundle.problem import Antenna, Layout, Problem, State, moved, start_state
from thalweg.images.model import ControlMarks, ControlPoints
from thalweg.settings.sections import BlockAdjustment

scene, normalised, pose_errors = block_scene.scene, block_scene.normalised, block_scene.pose_errors

PLAIN = BlockAdjustment(
    loss="none", correlated=False, reject_limit=100.0, interior_variance=1.0, least_angle_deg=0.0
)


def adjust_plain(problem: Problem) -> AdjustedBlock:
    """With sigmas that count as they are stated."""
    return adjust_block(problem, PLAIN, scale_by_sigma0=False)


def start_of(problem: Problem) -> tuple[Layout, State]:
    layout = Layout(problem)
    return layout, start_state(problem, layout)


def with_antenna(
    problem: Problem, truth, rng, *, shift: bool = True, lever: float = 0.02, clock_s: float = 0.0
) -> Problem:
    """RTK positions of an antenna that sits 1.2 m above the camera and errs by 10 mm, slowly."""
    n = len(truth.C)
    arm = np.array([0.1, -1.2, -0.3])
    t = np.arange(n) * 1.0
    rho = np.exp(-np.abs(t[:, None] - t) / 10.0)
    error = 0.01 * np.linalg.cholesky(rho) @ rng.standard_normal((n, 3))
    place = truth.C + truth.R @ arm + error + (np.array([0.3, -0.2, 0.5]) if shift else 0.0)
    antenna = Antenna(
        image=np.arange(n),
        t_s=t,
        position_wcs_m=place,
        sigma_m=np.full((n, 3), 0.01),
        lever_ccs_m=arm,
        sigma_lever_m=np.full(3, lever),
        correlation_time_s=10.0,
        shift=shift,
        velocity_wcs_m_s=np.gradient(truth.C, axis=0),
        sigma_jitter_s=np.full(n, 0.01),
        sigma_clock_s=clock_s,
    )
    return replace(problem, antenna=antenna)


@pytest.mark.parametrize("model", ["perspective", "fisheye"])
def test_derivatives_are_those_of_finite_differences(rng, model):
    problem, _ = scene(rng, images=6, points=60, model=model)
    layout, x = start_of(problem)
    b = problem.block
    at = b.mark_image, x.X[b.mark_point], b.mark_px
    here = linearised(problem, layout, x, *at)
    step = 1e-6
    for column in range(6):
        d = np.zeros(len(layout.names))
        d[column : layout.n_poses : 6] = step
        up, down = (linearised(problem, layout, moved(x, s * d, 0 * x.X, layout), *at) for s in (1, -1))
        # residuals are measured minus computed; central differences err by step^2 and rounding / step
        numeric = -(up.residual - down.residual) / (2 * step)
        np.testing.assert_allclose(numeric, here.by_pose[:, :, column], rtol=1e-5, atol=2e-4)
    for column in range(layout.n_interior):
        d = np.zeros(len(layout.names))
        d[layout.n_poses + column] = step
        up, down = (linearised(problem, layout, moved(x, s * d, 0 * x.X, layout), *at) for s in (1, -1))
        numeric = -(up.residual - down.residual) / (2 * step)
        np.testing.assert_allclose(numeric, here.by_rest[:, :, column], rtol=1e-5, atol=2e-4)
    for axis in range(3):
        d = np.zeros(3)
        d[axis] = step
        up, down = (linearised(problem, layout, x, at[0], at[1] + s * d, at[2]) for s in (1, -1))
        numeric = -(up.residual - down.residual) / (2 * step)
        np.testing.assert_allclose(numeric, here.by_point[:, :, axis], rtol=1e-5, atol=2e-4)


@pytest.mark.parametrize(
    "model",
    [
        Correlation(),
        Correlation(white=0.5, slow=1.2, reach_rad=0.2),
        Correlation(white=0.5, slow=1.2, reach_rad=0.2, power=1.5, white_across=0.6, slow_across=1.4),
    ],
)
def test_eliminating_points_changes_nothing(rng, model):
    problem, truth = scene(rng, images=8, points=60)
    problem = with_antenna(problem, truth, rng)
    layout, x = start_of(problem)
    b, u = problem.block, len(layout.names)
    view = views(x.X[b.mark_point], x.C[b.mark_image])
    angle = rng.uniform(0, np.pi, len(b.mark_image))
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    tracks = tracks_of(problem, np.ones(len(b.mark_image), np.bool_), b.sigma_px, view, along)
    found = reduced_system(problem, layout, x, tracks, model, problem.marks.sigma_px, 0.0)
    # the scene's marks are sorted by point, as those of tracks are
    np.testing.assert_array_equal(tracks.mark, np.arange(len(b.mark_image)))
    N, g = block_scene.dense(problem, layout, x, model, along)
    V = N[u:, u:]
    S = N[:u, :u] - N[:u, u:] @ np.linalg.solve(V, N[u:, :u])
    right = g[:u] - N[:u, u:] @ np.linalg.solve(V, g[u:])
    scale = np.sqrt(np.diag(S))
    # entries in units of their diagonal; both are sums of some 500 products in float64
    assert np.abs((found.N - S) / np.outer(scale, scale)).max() < 1e-8
    assert np.abs((found.g - right) / scale).max() < 1e-6 * np.abs(right / scale).max()


def test_antenna_derivatives(rng):
    """The gradient of the square sum by finite differences; shift, lever arm, clock, control points."""
    problem, truth = scene(rng, images=8, points=60)
    problem = with_antenna(problem, truth, rng, clock_s=0.1)
    layout, x = start_of(problem)
    x = replace(x, extras=rng.normal(0, 0.05, len(x.extras)))
    assert layout.names[layout.control - 1] == "antenna clock"
    none = tracks_of(
        problem,
        np.zeros(len(problem.block.mark_image), np.bool_),
        problem.block.sigma_px,
        np.zeros((len(problem.block.mark_image), 4)),
    )

    def cost(state: State) -> float:
        s = reduced_system(problem, layout, state, none, Correlation(), problem.marks.sigma_px, 0.0)
        return sum(s.cost.values())

    g = reduced_system(problem, layout, x, none, Correlation(), problem.marks.sigma_px, 0.0).g
    for column in rng.permutation(len(layout.names))[:40].tolist() + list(
        range(layout.extras, layout.control)
    ):
        d = np.zeros(len(layout.names))
        d[column] = 1e-6
        up, down = (cost(moved(x, s * d, 0 * x.X, layout)) for s in (1, -1))
        # the square sum is some 1e6, its rounding 1e-10, over 2e-6
        assert -(up - down) / 4e-6 == pytest.approx(g[column], rel=1e-4, abs=1e-2)


def test_truth_is_found_without_noise(rng):
    problem, truth = scene(rng, images=12, points=200, white_px=0.0)
    xy = block_scene.project(
        truth.camera, truth.R, truth.C, problem.marks.image, truth.G[problem.marks.point]
    )
    problem = replace(
        problem,
        marks=replace(problem.marks, xy_px=xy),
        control=replace(problem.control, points_wcs_m=truth.G),
    )
    found = adjust_plain(problem)
    # pixels are exact to 1e-13, a metre is 30 pixels, weak directions amplify by 1e4
    assert np.abs(pose_errors(found, truth)).max() < 1e-7
    np.testing.assert_allclose(found.x.cameras[0].parameters, truth.camera.parameters, atol=1e-5)
    assert found.sigma0 < 1e-6


def test_large_coordinates_lose_nothing():
    here, _ = scene(np.random.default_rng(1), images=10, points=150)
    far, _ = scene(np.random.default_rng(1), images=10, points=150, origin=np.array([4.5e5, 5.6e6, 300.0]))
    a, b = adjust_plain(here), adjust_plain(far)
    # float64 has 1e-9 m at 5,600 km
    assert np.abs(b.x.C + b.origin_m - np.array([4.5e5, 5.6e6, 300.0]) - (a.x.C + a.origin_m)).max() < 1e-6
    np.testing.assert_allclose(b.cov, a.cov, rtol=1e-4, atol=1e-12)


def test_a_block_without_datum_names_its_unknowns(rng):
    problem, _ = scene(rng, images=10, points=150)
    free = replace(problem, control=ControlPoints.none(), marks=ControlMarks.none())
    with pytest.raises(UnobservableError, match=r"do not determine .*\(7 combinations"):
        adjust_plain(free)
    held = np.zeros((10, 6), np.bool_)
    held[0] = True
    held[9, 0] = True
    fixed = adjust_plain(replace(free, held=held, free=((),)))
    assert fixed.redundancy > 0
    assert not fixed.cov[:6].any()


def test_blunders_are_left_out_and_counted(rng):
    clean, truth = scene(np.random.default_rng(5), points=500, outliers=0.0)
    dirty, _ = scene(np.random.default_rng(5), points=500, outliers=0.04)
    wrong = np.linalg.norm(dirty.block.mark_px - clean.block.mark_px, axis=1)
    found = adjust_block(dirty, block_scene.OPTIONS)
    gross = wrong > 5.0
    assert gross.sum() > 50
    # one along its ray's picture looks like another point; such a short track still counts little
    assert found.used[gross].mean() < 0.15
    assert found.weight[gross].mean() < 0.03
    assert found.used[wrong == 0].mean() > 0.98
    assert found.left_out["marks that do not fit"] > 0.85 * gross.sum()
    each, _ = normalised(found, truth)
    # without robust weights the same blunders move the poses by several sigmas of the clean block
    rms = np.sqrt(np.square(pose_errors(found, truth)[:, :3]).mean())
    bad = np.sqrt(np.square(pose_errors(adjust_plain(dirty), truth)[:, :3]).mean())
    assert bad > 2 * rms
    assert each.mean() < 3


def test_a_feature_found_twice_counts_once(rng):
    problem, _ = scene(rng, images=10, points=120)
    b = problem.block
    p = len(b.points_block_m)
    keep = b.mark_image % 2 == 0
    twice = replace(
        b,
        points_block_m=np.concatenate([b.points_block_m, b.points_block_m]),
        mark_image=np.concatenate([b.mark_image, b.mark_image[keep]]),
        mark_point=np.concatenate([b.mark_point, b.mark_point[keep] + p]),
        mark_px=np.concatenate([b.mark_px, b.mark_px[keep]]),
        sigma_px=np.concatenate([b.sigma_px, b.sigma_px[keep]]),
    )
    found = repeated(replace(problem, block=twice))
    assert found.sum() == keep.sum()
    assert found[len(b.mark_image) :].sum() + found[: len(b.mark_image)].sum() == keep.sum()
    once = adjust_plain(problem)
    again = adjust_plain(replace(problem, block=twice))
    # a track cut in two by equal length loses a little; sigmas of a block counted twice would fall by 0.82
    ratio = np.sqrt(np.diag(again.cov)[:60] / np.diag(once.cov)[:60])
    assert 0.99 < np.median(ratio) < 1.1


def test_antenna_positions_replace_control_points(rng):
    problem, truth = scene(rng, images=40, points=600, control=0, check=6)
    problem = with_antenna(problem, truth, rng, shift=False)
    found = adjust_block(problem, block_scene.OPTIONS)
    each, joint = normalised(found, truth)
    # One observation: poses of a block bend together, as if four of them erred by themselves. The guard is
    # tests/images/test_block_consistent.py, over 30 blocks.
    low, high = band(6 * 4)
    assert low < each.mean() < high
    low, high = band(6 * 40)
    assert low < joint < high
    off = found.x.G + found.origin_m - truth.G
    assert np.sqrt(np.square(off).mean()) < 0.05


def test_a_common_shift_of_the_antenna_is_found_with_control(rng):
    problem, truth = scene(rng, images=30, points=500)
    problem = with_antenna(problem, truth, rng, shift=True, lever=0.0)
    found = adjust_block(problem, block_scene.OPTIONS)
    layout = found.layout
    assert layout.names[layout.extras : layout.control] == tuple(f"antenna shift {a}" for a in "enu")
    sigma = np.sqrt(np.diag(found.cov)[layout.extras : layout.control])
    assert (np.abs(found.x.extras - [0.3, -0.2, 0.5]) < 4 * sigma).all()
    assert (sigma < 0.05).all()


def test_a_weighted_interior_stays_near_its_calibration(rng):
    problem, truth = scene(rng, images=20, points=300)
    sigma = np.array([0.3, 0.3, 0.3, 0.3, 1e-3, 1e-3, 1e-4, 1e-4, 0.0])
    known = truth.camera.with_parameters(truth.camera.parameters, np.diag(sigma**2))
    weighted = replace(problem, block=replace(problem.block, cameras=(known,)), weighted=(True,))
    free, tied = adjust_plain(problem), adjust_plain(weighted)
    before, after = (np.sqrt(np.diag(adjusted_cameras(a)[0].cov)) for a in (free, tied))
    assert (after[:8] <= np.minimum(before, sigma)[:8] * 1.0001).all()
    assert after[8] == 0
    off = (tied.x.cameras[0].parameters - truth.camera.parameters)[:8]
    assert (np.abs(off) < 4 * after[:8]).all()


def test_square_pixels_share_a_focal_length(rng):
    problem, _ = scene(rng, images=12, points=200)
    camera = problem.block.cameras[0]
    apart = camera.with_parameters(camera.parameters + np.eye(9)[0])
    uneven = replace(problem, block=replace(problem.block, cameras=(apart,)), square_pixels=True)
    one = adjust_plain(uneven)
    two = adjust_plain(problem)
    assert one.n_unknowns == two.n_unknowns - 1
    assert one.x.cameras[0].parameters[0] == one.x.cameras[0].parameters[1]
    cov = adjusted_cameras(one)[0].cov
    assert cov[0, 0] == cov[0, 1] == cov[1, 1] > 0


def test_covariance_is_that_of_the_dense_system():
    # a draw in which no control point is left out: their rows are zero here
    problem, _ = scene(np.random.default_rng(0), images=8, points=60)
    found = adjust_plain(problem)
    N, _ = block_scene.dense(found.problem, found.layout, found.x, found.correlation, found.tracks.along)
    u = len(found.layout.names)
    cov = np.linalg.inv(N)
    np.testing.assert_allclose(found.cov, cov[:u, :u], rtol=1e-4, atol=1e-12)


def test_no_marks_at_all_is_said(rng):
    problem, _ = scene(rng, images=6, points=60)
    b = problem.block
    empty = replace(
        b,
        mark_image=b.mark_image[:0],
        mark_point=b.mark_point[:0],
        mark_px=b.mark_px[:0],
        sigma_px=b.sigma_px[:0],
    )
    with pytest.raises(GeometryError, match="no marks are left"):
        adjust_plain(replace(problem, block=empty, marks=ControlMarks.none()))


def test_an_image_and_a_check_point_that_lose_their_marks_are_named(rng):
    problem, truth = scene(rng, images=20, points=300)
    b, marks = problem.block, problem.marks
    px = b.mark_px.copy()
    wrong = b.mark_image == 7
    px[wrong] += rng.uniform(-150, 150, (int(wrong.sum()), 2))
    check = np.flatnonzero(problem.control.check)[0]
    few = marks.chosen((marks.image != 7) & ((marks.point != check) | (np.cumsum(marks.point == check) <= 1)))
    found = adjust_block(replace(problem, block=replace(b, mark_px=px), marks=few), block_scene.OPTIONS)
    assert found.lost_images.tolist() == [k == 7 for k in range(20)]
    assert found.left_out["images that kept too few marks"] == 1
    assert not found.layout.free[found.layout.point(int(check))].any()
    sigma = np.sqrt(np.diag(found.cov)[: found.layout.n_poses]).reshape(-1, 6)
    others = np.arange(20) != 7
    # 114 errors, few of them independent
    assert np.abs(pose_errors(found, truth)[others] / sigma[others]).max() < 4.5


def test_the_weight_and_the_information_of_a_track_of_students_errors():
    """4 degrees of freedom, 6 of the track: weight (4 + 6) / (4 + 6), information (4 + 6) / (4 + 6 + 2)."""
    heavy, six = Correlation(freedom=4.0), np.array([6.0])
    assert heavy.weights(six, six) == pytest.approx(1.0)
    assert heavy.weights(np.array([16.0]), six) == pytest.approx(0.5)
    assert heavy.information(six) == pytest.approx(10 / 12)
    assert Correlation().information(six) == Correlation().weights(np.array([16.0]), six) == 1.0


def test_a_check_point_is_suspect_beyond_three_degrees_of_freedom():
    limit = 21.108  # upper 0.01 % of chi-square with 3 degrees of freedom
    problem, _ = scene(np.random.default_rng(1), images=8, points=120, control=4, check=6)
    adjusted = adjust_plain(problem)
    cov = control_result(adjusted).cov_m2
    known = adjusted.problem.control.check & np.isfinite(cov).all(axis=(1, 2))
    checks = np.flatnonzero(known)[:2]
    places = adjusted.problem.control.points_wcs_m.copy()
    for p, share in zip(checks, (0.99, 1.01), strict=True):
        places[p] += np.linalg.cholesky(cov[p]) @ np.array([0.0, 0.0, np.sqrt(share * limit)])
    moved_points = replace(adjusted.x, G=places)
    found = control_result(replace(adjusted, x=moved_points))
    np.testing.assert_allclose(found.test[checks], limit * np.array([0.99, 1.01]), rtol=1e-9)
    assert found.suspect[checks].tolist() == [False, True]


def test_points_whose_rays_are_next_to_parallel_are_flat():
    """Two or three cameras, rays 0.9 and 1.1 degrees apart, where 1 is wanted; one without marks."""
    degrees = np.array([-0.45, 0.45, -0.55, 0.55])
    C = 10.0 * np.column_stack([np.sin(np.radians(degrees)), np.cos(np.radians(degrees)), np.zeros(4)])
    block = SimpleNamespace(
        mark_point=np.array([0, 0, 1, 1, 3, 3, 3]),
        mark_image=np.array([0, 1, 2, 3, 2, 3, 3]),
        points_block_m=np.zeros((4, 3)),
    )
    flat = _flat(SimpleNamespace(block=block), SimpleNamespace(X=np.zeros((4, 3)), C=C), 1.0)
    assert flat.tolist() == [True, False, True, False]
