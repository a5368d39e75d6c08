"""Distances and outliers of a scan, poses and panels of the sensor, edges of brightness: by hand."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from thalweg.core import ClockError, GeometryError, InputError, Rigid, exp_rotation, rotation_z
from thalweg.lightsheet.calibration import report
from thalweg.lightsheet.calibration.model import LINE, PAIRS
from thalweg.lightsheet.lines import albedo
from thalweg.lightsheet.lines.settings import LineFlag
from thalweg.lightsheet.poses import panels, poses, sources
from thalweg.lightsheet.poses.series import image_covariance
from thalweg.lightsheet.scanning import distances, world

# ---------------------------------------------------------------- distances


def found(distance, **parts):
    n = len(distance)
    values = {name: np.zeros(n) for name in ("own", "pose", "shared", "reference")} | parts
    flags = {name: values.pop(name, np.zeros(n, bool)) for name in ("at_border", "far")}
    return distances.MeshDistances(
        distance_mm=np.array(distance),
        normal=np.tile([0.0, 0.0, 1.0], (n, 1)),
        **{f"sigma_{name}_mm": np.asarray(value, float) for name, value in values.items()},
        **{name: np.asarray(value) for name, value in flags.items()},
    )


def test_parts_counts_and_borders_of_distances():
    far, border = [False, False, False, False, True, True], [False, False, False, True, True, False]
    made = found(
        [0.1, -0.2, 0.4, 1.5, 9.0, 8.0], own=[3.0] * 6, pose=[4.0] * 6, shared=[12.0] * 6,
        reference=[84.0] * 6, at_border=border, far=far,
    )  # fmt: skip
    assert made.sigma_mm == pytest.approx([85.0] * 6)
    assert made.with_shared(np.zeros(6)).sigma_mm == pytest.approx([np.sqrt(25.0 + 84.0**2)] * 6)
    assert made.counts() == {"points": 6, "far": 2, "at_border": 1, "used": 3}
    words = distances.border_effect(made)
    assert (words["n_border"], words["n"], words["mean_border_mm"]) == (1.0, 3.0, 1.5)
    assert (words["mean_mm"], words["std_mm"]) == pytest.approx((0.1, 0.3))
    assert words["mean_with_border_mm"] == pytest.approx(0.45)
    assert words["std_with_border_mm"] == pytest.approx(np.std([0.1, -0.2, 0.4, 1.5], ddof=1))
    none = found([0.1, -0.2, 9.0], far=[False, False, True])
    assert np.isnan(distances.border_effect(none)["mean_border_mm"])
    with pytest.raises(GeometryError, match="1 points off the border"):
        distances.border_effect(found([0.1, 9.0], far=[False, True]))


def test_shape_of_distances_in_sigmas_of_free_points():
    d = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0])
    shape = distances.normality(d, 0.9)
    # mean 1, second moment 9, third 72, fourth 657
    assert (shape["mean_mm"], shape["std_mm"]) == pytest.approx((1.0, np.sqrt(10.0)))
    assert (shape["skewness"], shape["excess"]) == pytest.approx((72.0 / 27.0, 657.0 / 81.0 - 3.0))
    assert shape["skewness_sigmas"] == pytest.approx(72.0 / 27.0 / np.sqrt(6.0 / 9.0))
    assert shape["excess_sigmas"] == pytest.approx((657.0 / 81.0 - 3.0) / np.sqrt(24.0 / 9.0))
    assert distances.normality(d, 0.1)["skewness_sigmas"] == pytest.approx(72.0 / 27.0 / np.sqrt(6.0 / 8.0))
    told = distances.consistency(np.array([3.0, 4.0, 99.0]), np.array([1.0, 2.0, 1.0]), np.array([0, 1]))
    assert told == {
        "n": 2, "rms_mm": pytest.approx(np.sqrt(12.5)), "predicted_mm": pytest.approx(np.sqrt(2.5)),
        "rms_over_sigma": pytest.approx(np.sqrt(6.5)),
    }  # fmt: skip


def test_outlier_rules_on_both_sides_of_their_limits():
    """Twenty of +-1, one of 5 and one of 20: once the limit lies between, repeated it falls to both."""
    d = np.r_[np.tile([-1.0, 1.0], 10), 5.0, 20.0]
    once = distances.filtered(d, factor=3.0)
    assert (once.centre_mm, once.limit_mm) == pytest.approx((d.mean(), 3.0 * d.std(ddof=1)))
    assert once.kept.tolist() == [True] * 21 + [False]
    assert (once.n, once.n_kept, once.rule) == (22, 21, "3 sigma")
    assert once.mean_kept_mm == pytest.approx(5.0 / 21)
    assert once.std_kept_mm == pytest.approx(d[:21].std(ddof=1))
    again = distances.filtered(d, "3 sigma repeated")
    assert again.kept.tolist() == [True] * 20 + [False] * 2
    assert (again.centre_mm, again.limit_mm) == pytest.approx((0.0, 3.0 * np.sqrt(20.0 / 19.0)))
    assert (again.mean_mm, again.std_mm) == pytest.approx((d.mean(), d.std(ddof=1)))
    robust = distances.filtered(np.array([0.0, 1.0, 2.0, 3.0, 4.0, 8.0]), "robust", factor=2.0)
    assert (robust.centre_mm, robust.nmad_mm) == pytest.approx((2.5, 1.4826 * 1.5), rel=1e-4)
    assert robust.limit_mm == pytest.approx(2.0 * robust.nmad_mm)
    assert robust.kept.tolist() == [True] * 5 + [False]
    assert robust.row()["share_kept"] == pytest.approx(5 / 6)
    assert "kept" not in robust.row()
    with pytest.raises(GeometryError, match="3 distances, 1 of them"):
        distances.filtered(np.array([1.0, np.nan, 2.0]))
    with pytest.raises(GeometryError, match="2 distances, 0 of them"):
        distances.filtered(np.ones(2))


def test_two_classes_of_brightness_and_their_shift():
    threshold, above = distances.otsu(np.array([10.0, 12.0, 11.0, 200.0, 180.0]))
    assert threshold == pytest.approx(np.sqrt(12.0 * 180.0))
    assert above.tolist() == [False, False, False, True, True]
    assert not distances.otsu(np.array([7.0]))[1].any()
    d = np.array([0.1, 0.3, 0.2, 1.0, 1.4, 1.2, 1.6])
    bright = np.arange(7) > 2
    shift, sigma = distances._shift(d, bright, 0.5)
    assert shift == pytest.approx(1.1)
    assert sigma == pytest.approx(np.sqrt(d[3:].var(ddof=1) / 2 + d[:3].var(ddof=1) / 1.5))
    assert distances._shift(d, bright, 0.1)[1] == pytest.approx(
        np.sqrt(d[3:].var(ddof=1) + d[:3].var(ddof=1))
    )
    assert distances._shift(d, np.arange(7) > 4, 1.0)[1] == 0.0
    assert np.isnan(distances._shift(d, np.arange(7) > 0, 1.0)[0])


def test_two_modes_that_lie_far_apart_have_their_own_moments():
    """A quarter at 1 and three quarters at 0, each of +-0.1: nothing of one belongs to the other."""
    d = np.r_[np.tile([-0.1, 0.1], 30), np.tile([0.9, 1.1], 10)]
    peak = np.where(d > 0.5, 200.0, 20.0)
    two = distances.bimodality(d, peak, independent_share=0.5)
    assert two.modes_mm == pytest.approx((0.0, 1.0), abs=1e-6)
    assert two.shares == pytest.approx((0.75, 0.25))
    assert (two.sigma_mm, two.ashman, two.n) == (pytest.approx(0.1), pytest.approx(10.0), 80)
    one = -0.5 * np.log(2 * np.pi * d.var()) - 0.5
    normal = -0.5 - np.log(np.sqrt(2 * np.pi) * 0.1)
    level = 0.75 * np.log(0.75) + 0.25 * np.log(0.25) + normal
    assert two.bic_gain == pytest.approx(2.0 * 40.0 * (level - one) - 2.0 * np.log(40.0))
    assert two.bimodal
    assert (two.shift_mm, two.threshold_dn) == (pytest.approx(1.0), pytest.approx(np.sqrt(4000.0)))
    assert two.by_brightness
    # one at more than six robust sigmas of all from their median is left out
    median, nmad = 0.1, 1.4826 * 0.2
    for far, n in ((5.9, 81), (6.1, 80)):
        assert distances.bimodality(np.r_[d, median + far * nmad], np.r_[peak, 90.0]).n == n
    assert two.words().startswith(
        "two modes at +0.00 and +1.00 mm, 10.0 sigmas apart; bright points lie +1.000"
    )
    given = distances.bimodality(d, peak, bright=np.arange(80) % 2 == 0)
    assert np.isnan(given.threshold_dn)
    assert given.bic_gain == pytest.approx(2.0 * 80.0 * (level - one) - 2.0 * np.log(80.0))
    assert (given.shift_mm, given.by_brightness) == (pytest.approx(-0.2), False)
    assert given.words().endswith("from dark ones: not significant")
    with pytest.raises(GeometryError, match="19 distances and 19"):
        distances.bimodality(d[:19], peak[:19])


# ---------------------------------------------------------------- poses


def some_poses(**changes):
    rng = np.random.default_rng(4)
    root = rng.normal(0, 1e-3, (3, 6, 6))
    made = {
        "images": ("a", "b", "c"),
        "R_target_lcs": exp_rotation(rng.normal(0, 1, (3, 3))),
        "shift_m": rng.normal(0, 1, (3, 3)),
        "cov": root @ np.swapaxes(root, 1, 2),
        "shared": rng.normal(0, 1e-3, (3, 6, 2)),
        "reasons": ("", "dark", ""),
        "t_gps_s": np.array([1.0, 2.0, 3.0]),
        "target": "x",
        "source": "test",
    }
    return poses.SensorPoses(**(made | changes))


def test_poses_have_their_own_and_shared_errors():
    made = some_poses()
    assert (len(made), made.usable.tolist()) == (3, [True, False, True])
    total = made.cov[2] + made.shared[2] @ made.shared[2].T
    np.testing.assert_allclose(made.cov_total[2], total)
    np.testing.assert_allclose(made.pose(2).cov, total)
    np.testing.assert_array_equal(made.pose(2).shift_m, made.shift_m[2])
    with pytest.raises(GeometryError, match="no pose: dark"):
        made.pose(1)
    assert made.of(["c", "a"]).images == ("c", "a")
    assert made.where([True, False, True]).t_gps_s.tolist() == [1.0, 3.0]
    with pytest.raises(InputError, match="1 of 2 images have no entry among the poses, such as z"):
        made.of(["a", "z"])
    with pytest.raises(GeometryError, match="1 images have two poses, such as a"):
        some_poses(images=("a", "b", "a"))
    for name, value in (("t_gps_s", np.zeros(2)), ("reasons", ("",) * 4), ("shared", np.zeros((3, 5, 1)))):
        with pytest.raises(GeometryError, match=f"{name} of the shape"):
            some_poses(**{name: value})
    T = Rigid(R=rotation_z(0.7), shift_m=np.array([1.0, 2.0, 3.0]))
    moved = made.moved(T)
    big = np.kron(np.eye(2), T.R)
    np.testing.assert_allclose(moved.R_target_lcs, T.R @ made.R_target_lcs)
    np.testing.assert_allclose(moved.shift_m, made.shift_m @ T.R.T + T.shift_m)
    np.testing.assert_allclose(moved.cov, big @ made.cov @ big.T)
    np.testing.assert_allclose(moved.shared, big @ made.shared)
    assert (moved.target, made.moved(T, "y").target) == ("x", "y")
    errors = np.arange(18.0).reshape(3, 6) / 100
    off = made.disturbed(errors)
    np.testing.assert_allclose(off.shift_m, made.shift_m + errors[:, :3])
    np.testing.assert_allclose(off.R_target_lcs, exp_rotation(errors[:, 3:]) @ made.R_target_lcs)
    table = poses.pose_table(made)
    assert table["sigma_y_mm"][0] == pytest.approx(1e3 * np.sqrt(made.cov[0, 1, 1]))
    assert table["sigma_turn_z_deg"][2] == pytest.approx(np.rad2deg(np.sqrt(made.cov[2, 5, 5])))
    assert table["sigma_shared_x_mm"][1] == pytest.approx(1e3 * np.linalg.norm(made.shared[1, 0]))
    assert table["sigma_shared_turn_x_deg"][1] == pytest.approx(np.rad2deg(np.linalg.norm(made.shared[1, 3])))
    assert table["reason"].tolist() == ["", "dark", ""]
    assert table[["x_m", "y_m", "z_m"]].to_numpy() == pytest.approx(made.shift_m)


def test_roots_of_covariances_and_fewer_errors_with_the_same_effect():
    rng = np.random.default_rng(5)
    root = rng.normal(0, 1, (6, 2)) * np.array([1, 1, 1, 1e-4, 1e-4, 1e-4])[:, None]
    F = poses.factor(root @ root.T)
    assert F.shape == (6, 2)
    np.testing.assert_allclose(F @ F.T, root @ root.T, rtol=1e-6, atol=1e-16)
    assert poses.factor(np.zeros((3, 3))).shape == (3, 0)
    assert (poses.factor(np.array([[4.0, -4.0], [-4.0, 4.0]]))[:, 0] ** 2).tolist() == pytest.approx([4, 4])
    base = rng.normal(0, 1, (4, 6, 2))
    mixed = base @ rng.normal(0, 1, (2, 7))
    few = poses.compressed(mixed)
    assert few.shape == (4, 6, 2)
    flat, small = mixed.reshape(24, 7), few.reshape(24, 2)
    np.testing.assert_allclose(small @ small.T, flat @ flat.T, atol=1e-9)
    assert poses.compressed(mixed[:, :, :0]).shape == (4, 6, 0)
    # a turn counts as a shift at an arm of 0.3 m: one below a thousandth of the largest is left out
    two = np.zeros((1, 6, 2))
    two[0, 0, 0] = 1.0
    for turn, kept in ((0.0034, 2), (0.0033, 1)):
        two[0, 3, 1] = turn
        assert poses.compressed(two).shape[2] == kept
    arm = rng.normal(0, 1, (2, 3))
    d = np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])
    np.testing.assert_allclose(poses.by_pose(arm) @ d, d[:3] + np.cross(d[3:], arm))


def test_sigmas_at_a_place_of_the_panel():
    made = some_poses()
    point = np.array([10.0, -20.0, 300.0])
    place, turn = sources.sigmas_at(made, point)
    arm = made.R_target_lcs @ (point / 1e3)
    for k in range(3):
        J = poses.by_pose(arm)[k]
        assert place[k] == pytest.approx(1e3 * np.sqrt(np.diag(J @ made.cov[k] @ J.T)))
        assert turn[k] == pytest.approx(np.rad2deg(np.sqrt(np.diag(made.cov[k])[3:])))


def test_pictures_whose_marks_fit_no_pose():
    """Four times what the others have, and four at least; the factor is that of the good ones."""
    sigma0 = np.array([1.0, 1.5, 2.0, 6.1, np.nan])
    redundancy = np.array([10.0, 20.0, 30.0, 40.0, 0.0])
    reasons = ["", "", "", "", "dark"]
    factor = sources._refuse_misfits(sigma0, redundancy, reasons)
    assert reasons == ["", "", "", "", "dark"]
    sigma0[3] = 7.1
    factor = sources._refuse_misfits(sigma0, redundancy, reasons)
    assert reasons[3] == "the marks are 7 times their sigmas off any pose"
    assert reasons[:3] == [""] * 3
    assert factor == pytest.approx(np.sqrt((10 + 20 * 2.25 + 30 * 4) / 60))
    small = ["", "", ""]
    sources._refuse_misfits(np.array([0.1, 0.1, 3.9]), np.ones(3), small)
    assert small == ["", "", ""]
    sources._refuse_misfits(np.array([0.1, 0.1, 4.1]), np.ones(3), small)
    assert small[2].startswith("the marks are 4 times")
    assert sources._refuse_misfits(np.full(2, np.nan), np.zeros(2), ["", ""]) == 1.0


def test_tables_of_marks_panels_and_a_standing_camera(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("marker,x_mm,y_mm,z_mm,sigma_mm\n7,10,20,30,0.5\n8,-10,0,5,0.1\n")
    panel = sources.read_panel(path)
    assert panel.points == ((7, 0), (8, 0))
    np.testing.assert_allclose(panel.points_pcs, [[0.01, 0.02, 0.03], [-0.01, 0, 0.005]])
    np.testing.assert_allclose(np.diag(panel.cov), [2.5e-7] * 3 + [1e-8] * 3)
    path.write_text(path.read_text() + "7,1,2,3,1\n")
    with pytest.raises(InputError, match="marker 7 stands twice"):
        sources.read_panel(path)
    path.write_text("file,marker,x_px,y_px,sigma_px\na.png,3,1.5,2.5,0.1\n")
    row = sources.read_marks(path).iloc[0]
    assert row.tolist() == ["a.png", 3, 0, 1.5, 2.5, 0.1]
    camera = tmp_path / "cam.json"
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
    text = ", ".join(f'"{name}": {k}' for k, name in enumerate(names, 1))
    camera.write_text(f'{{"model": "perspective", "size_px": [640, 480], "parameters": {{{text}}}}}')
    read = sources.read_standing_camera(camera)
    by_name = dict(zip(read.parameter_names, read.parameters, strict=True))
    assert {name: by_name[name] for name in names} == {name: k for k, name in enumerate(names, 1)}
    assert (read.size_px, read.name) == ((640, 480), "cam")
    for old, new, words in (
        ('"k1": 5, ', "", "parameters missing: k1"),
        ("[640, 480]", "[640]", "a perspective camera of"),
        ("perspective", "fisheye", "a fisheye camera"),
        ("640", '"x"', "this cannot be read"),
    ):
        bad = tmp_path / "bad.json"
        bad.write_text(camera.read_text().replace(old, new))
        with pytest.raises(InputError, match=words):
            sources.read_standing_camera(bad)


# ---------------------------------------------------------------- panels at known depths


def test_depths_of_panels_against_those_measured(tmp_path):
    path = tmp_path / "depths.csv"
    path.write_text("file,depth_mm,sigma_mm\na,128.5,0.1\nb,100,0\nc,72.3,0.2\n")
    table = panels.read_panels(path)
    points = pd.DataFrame(
        {"file": ["a", "b", "a"], "depth_mm": [128.6, 99.0, 128.9], "sigma_depth_mm": [0.3, 0.2, 0.4]}
    )
    images = pd.DataFrame({"file": ["c", "a", "b"], "points": [4, 2, 3], "reason": [None, None, np.nan]})
    both, rows = panels.compare_panels(points, table, images)
    assert both["expected_depth_mm"].tolist() == [128.5, 100.0, 128.5]
    a, b, c = (row for _, row in rows.iterrows())
    assert (a.n, a.mean_mm, a.largest_mm) == (2, pytest.approx(0.25), pytest.approx(0.4))
    assert a.std_mm == pytest.approx(np.sqrt(0.045))
    assert (a.rms_mm, a.predicted_mm) == pytest.approx((np.sqrt(0.085), np.sqrt(0.125)))
    assert (a.published_mean_mm, a.published_std_mm, a.n_off_sheet) == (0.03, 0.21, 0)
    assert (b.n, b.mean_mm, b.largest_mm, b.n_off_sheet, b.reason) == (1, -1.0, 1.0, 2, "")
    assert np.isnan([b.std_mm, b.published_mean_mm]).all()
    assert (c.n, c.reason, c.published_mean_mm) == (0, "no line point lies on the light sheet", 0.07)
    assert np.isnan([c.mean_mm, c.rms_mm, c.predicted_mm, c.largest_mm]).all()
    with pytest.raises(InputError, match="1 images without a depth, such as d"):
        panels.compare_panels(points, table, images.assign(file=["c", "d", "b"]))
    with pytest.raises(InputError, match="1 depths without image, such as c"):
        panels.compare_panels(points, table, images[1:])
    for text, words in (
        ("a,0,0.1\n", "a depth of 0 mm with a sigma of 0.1 mm in row 1"),
        ("a,50,-0.1\n", "a depth of 50 mm with a sigma of -0.1 mm"),
        ("a,0.0999,0\nb,0.999,0\n", "no depth exceeds 0.999 mm"),
        ("a,50,0\na,60,0\n", "two depths for a"),
    ):
        path.write_text("file,depth_mm,sigma_mm\n" + text)
        with pytest.raises(InputError, match=words):
            panels.read_panels(path)
    path.write_text("file,depth_mm,sigma_mm\na,1,0\n")
    assert len(panels.read_panels(path)) == 1


def test_a_point_is_uncertain_across_its_line_alone():
    J = np.arange(12.0).reshape(2, 3, 2)
    C = image_covariance(J, np.array([0.5, 2.0]), np.array([0.0, np.pi / 2]))
    np.testing.assert_allclose(C[0], 0.25 * np.outer(J[0, :, 0], J[0, :, 0]))
    np.testing.assert_allclose(C[1], 4.0 * np.outer(J[1, :, 1], J[1, :, 1]))


# ---------------------------------------------------------------- edges of brightness


def test_the_shift_of_a_series_is_a_weighted_mean():
    one = {"width_shift": 0.2, "sigma_width_shift": 0.01, "width_shift_edges": 5}
    two = {"width_shift": 0.3, "sigma_width_shift": 0.02, "width_shift_edges": 7}
    none = {"width_shift": 9.0, "sigma_width_shift": np.nan, "width_shift_edges": 9}
    found = albedo.pooled_shift([one, none, two, {}])
    mean = (0.2e4 + 0.3 * 2500) / 12500
    chi2 = 1e4 * (0.2 - mean) ** 2 + 2500 * (0.3 - mean) ** 2
    assert (found.coefficient, found.edges) == (pytest.approx(mean), 12)
    assert found.sigma == pytest.approx(np.sqrt(chi2 / 12500))
    assert found.applied
    alone = albedo.pooled_shift([one | {"sigma_width_shift": 0.06}])
    assert (alone.sigma, alone.applied) == (pytest.approx(0.06), False)
    assert albedo.pooled_shift([none]).edges == 0


def test_wider_points_go_back_by_the_shift_of_the_series():
    """Along the row or column that they were measured in; a slanted one has its larger part."""
    angle = np.array([0.0, np.pi / 2, np.deg2rad(30.0), 0.0])
    saturated = np.array([True, True, True, False])
    points = line_points(angle, saturated)
    shift = albedo.WidthShift(0.1, 0.02, 9, True)
    moved = albedo.without_shift(points, shift)
    # 2 px wider than usual
    assert moved.x_px == pytest.approx([9.8, 10.0, 9.8, 10.0])
    assert moved.y_px == pytest.approx([20.0, 19.8, 20.0 - 0.2 * np.tan(np.deg2rad(30.0)), 20.0])
    assert moved.sigma_px == pytest.approx([0.05, 0.05, 0.05, 0.03])
    assert moved.facts["width_shift"] == 0.1
    assert moved.facts["width_shift_applied"] == 1.0
    assert albedo.without_shift(moved, shift) is moved
    assert albedo.without_shift(points, albedo.WidthShift(0.1, 0.02, 9, False)) is points


def line_points(angle, saturated):
    n = len(angle)
    zero = np.zeros(n, int)
    return albedo.LinePoints(
        line=zero, piece=zero, x_px=np.full(n, 10.0), y_px=np.full(n, 20.0), sigma_px=np.full(n, 0.03),
        angle_rad=angle, peak_dn=np.full(n, 90.0), width_px=np.full(n, 7.0), background_dn=np.zeros(n),
        rows=zero, flags=np.where(saturated, LineFlag.SATURATED, 0), counts={},
        facts={"width_unsaturated_px": 5.0},
    )  # fmt: skip


def test_a_jump_of_place_and_width_at_an_edge():
    """Two slanted pieces 0.4 px apart, 3 px wider behind the edge; rows beside it take no part."""
    i = np.arange(40.0)
    x = 0.25 * i + 0.4 * (i >= 20)
    width = 5.0 + 3.0 * (i >= 20)
    x[17:23] = 99.0
    width[17:23] = 99.0
    sigma = np.full(40, 0.1)
    piece = np.zeros(40, int)
    place, wider, spread = albedo._jump(x, width, sigma, piece, 20, 3)
    assert (place, wider) == (pytest.approx(0.4), 3.0)
    side, at = np.repeat([0.0, 1.0], 6), np.r_[11:17, 23:29] - 20.0
    A = np.column_stack([np.ones(12), side, at])
    assert spread == pytest.approx(0.1 * np.sqrt(np.linalg.inv(A.T @ A)[1, 1]))
    assert albedo._jump(x, width, 0 * sigma, piece, 20, 3)[2] == 1e-3
    assert albedo._jump(x, width, sigma, piece, 9, 3) is not None
    assert albedo._jump(x, width, sigma, piece, 8, 3) is None
    assert albedo._jump(x, width, sigma, piece, 31, 3) is not None
    assert albedo._jump(x, width, sigma, piece, 32, 3) is None
    piece[28] = 1
    assert albedo._jump(x, width, sigma, piece, 20, 3) is None
    assert albedo._gap(np.array([1, 3, 9, 1, 1]), 2) == 5
    assert albedo._gap(np.array([1, 3, 1]), 2) == 2


def test_the_slope_of_places_by_widths():
    """Four edges leave an offset, seven a drift along the line too; the scatter widens the sigma."""
    dw = np.array([1.0, -1.0, 2.0, -2.0])
    sigma = np.array([0.1, 0.1, 0.2, 0.2])
    k, s = albedo._slope(0.3 * dw + 0.05, dw, sigma, np.arange(4.0))
    A = np.column_stack([dw, np.ones(4)]) / sigma[:, None]
    assert (k, s) == pytest.approx((0.3, np.sqrt(np.linalg.inv(A.T @ A)[0, 0])))
    dw = np.array([1.0, -1.0, 2.0, -2.0, 1.0, -1.0, 3.0])
    at = np.array([3.0, 9, 20, 28, 35, 44, 51])
    drift = 0.4 * (at - at.mean()) / 48.0
    k, s = albedo._slope(0.3 * dw + 0.05 + drift, dw, np.full(7, 0.1), at)
    B = np.column_stack([dw, np.ones(7), (at - at.mean()) / 48.0]) / 0.1
    assert (k, s) == pytest.approx((0.3, np.sqrt(np.linalg.inv(B.T @ B)[0, 0])))
    off = np.array([1.0, -1, -1, 1, 0.5, -0.5, 0.25])
    k, s = albedo._slope(0.3 * dw + 0.1 * off, dw, np.full(7, 0.1), at)
    C = np.linalg.inv(B.T @ B)
    x = C @ B.T @ ((0.3 * dw + 0.1 * off) / 0.1)
    rest = (0.3 * dw + 0.1 * off) / 0.1 - B @ x
    # no residual exceeds twice the usual one: plain least squares
    assert k == pytest.approx(x[0])
    assert s == pytest.approx(np.sqrt(max(1.0, rest @ rest / 4) * C[0, 0]))


# ---------------------------------------------------------------- a calibration says of itself


def calibrated():
    rng = np.random.default_rng(8)
    root = rng.normal(0, 1, (3, 3))
    cov = root @ root.T
    cov[0, 1] = cov[1, 0] = 0.95 * np.sqrt(cov[0, 0] * cov[1, 1])
    cov[0, 2] = cov[2, 0] = -0.97 * np.sqrt(cov[0, 0] * cov[2, 2])
    cov[1, 2] = cov[2, 1] = 0.1
    sigma = np.sqrt(np.diag(cov))
    return SimpleNamespace(
        estimated=(0, 1), names=("laser.x_mm", "laser.omega_rad", "window.n"),
        values=np.array([1.0, 0.1, 1.5]), cov=cov,
        adjusted=SimpleNamespace(
            sigmas=np.array([0.2, 0.01]), x=None,
            residuals={PAIRS: np.array([0.01, -0.02])},
            standardised={LINE: np.array([1.0, 2.0, 9.0]), PAIRS: np.array([0.5, 0.6])},
            used={LINE: np.array([True, True, False]), PAIRS: np.array([True, False])},
        ),
        problem=SimpleNamespace(
            known={"laser.omega_rad": 1},
            line=SimpleNamespace(level=np.array([1, 0, 1]), xy_px=np.arange(6.0).reshape(3, 2)),
            grid=SimpleNamespace(
                name="grid", depths_mm=np.array([50.0, 90.0]),
                levels=[SimpleNamespace(name=n, depth_mm=d) for n, d in (("top", 50.0), ("low", 90.0))],
            ),
            pairs=SimpleNamespace(
                upper_px=np.array([[1.0, 2], [3, 4]]), lower_px=np.array([[5.0, 6], [7, 8]]),
                side=np.array([1, -1]),
            ),
            residuals_px=lambda x: np.array([0.3, -0.4, 5.0]),
        ),
        correspondence=SimpleNamespace(rows=np.array([4, 7, 9]), gaps=[0, 2], counts={"apart": 3}),
        correlation=lambda: cov / np.outer(sigma, sigma),
        misfit_px=0.35, sigma0={LINE: 1.1, PAIRS: 0.9}, shared_points=2.5,
        sigma_factor={
            LINE: SimpleNamespace(value=1.2, width=np.log(2.0)),
            PAIRS: SimpleNamespace(value=1.0, width=0.0),
        },
        sensor=None, warnings=("w",),
    )  # fmt: skip


def test_tables_and_report_of_a_calibration(monkeypatch):
    made = calibrated()
    table = report.parameter_table(made)
    assert table["name"].tolist() == ["laser.x_mm", "laser.omega_deg", "window.n"]
    assert table["treated"].tolist() == [
        "estimated", "known beforehand, estimated", "held fixed, considered",
    ]  # fmt: skip
    assert table["value"].tolist() == pytest.approx([1.0, np.rad2deg(0.1), 1.5])
    sigma = np.sqrt(np.diag(made.cov))
    assert table["sigma"].tolist() == pytest.approx([sigma[0], np.rad2deg(sigma[1]), sigma[2]])
    assert table["sigma_image"].tolist() == pytest.approx([0.2, np.rad2deg(0.01), np.nan], nan_ok=True)
    assert [pair[:2] for pair in report.strong_correlations(made)] == [
        ("laser.x_mm", "window.n"), ("laser.x_mm", "laser.omega_rad"),
    ]  # fmt: skip
    residuals = report.residual_table(made)
    assert residuals["level"].tolist() == ["low", "top", "low"]
    assert residuals["row"].tolist() == [4, 7, 9]
    assert residuals[["x_px", "y_px"]].to_numpy().tolist() == [[0, 1], [2, 3], [4, 5]]
    assert residuals["standardised"].tolist() == [1.0, 2.0, 9.0]
    pairs = report.pair_table(made)
    assert pairs.iloc[1].tolist() == [3, 4, 7, 8, -1, pytest.approx(np.rad2deg(-0.02)), 0.6, False]
    asked = []
    monkeypatch.setattr(
        report, "depth_sigmas",
        lambda sensor, depths: asked.append(depths) or pd.DataFrame({"depth_mm": [5.0], "s": [np.nan]}),
    )  # fmt: skip
    facts = report.calibration_report(made)
    assert asked == [[25.0, 50.0, 70.0, 90.0, 140.0]]
    assert facts["levels"] == {
        "top": {"depth_mm": 50.0, "points": 1, "gaps": 0, "rms_px": 0.4, "bias_px": -0.4},
        "low": {"depth_mm": 90.0, "points": 1, "gaps": 2, "rms_px": 0.3, "bias_px": 0.3},
    }
    assert facts["line_points"] == {
        "used": 2, "rejected": 1, "rms_px": 0.35, "sigma0": 1.1, "neighbours_with_one_error": 2.5,
        "sigma_factor": 1.2, "sigma_factor_within": pytest.approx(2.0),
    }  # fmt: skip
    assert (facts["pairs"]["used"], facts["pairs"]["rejected"]) == (1, 1)
    assert facts["correlations"][0] == ["laser.x_mm", "window.n", -0.97]
    assert facts["sigma_of_depth"] == [{"depth_mm": 5.0, "s": None}]
    assert facts["parameters"][2]["sigma_image"] is None
    assert (facts["dropped"], facts["warnings"], facts["object"]) == ({"apart": 3}, ["w"], "grid")
    made.adjusted.used[LINE][:] = False
    assert report.calibration_report(made)["levels"]["top"]["rms_px"] is None
    made.problem.grid.depths_mm = np.array([28.0, 90.0])
    report.calibration_report(made)
    assert asked[-1][0] == 5.0


# ---------------------------------------------------------------- in the world


def test_images_come_in_the_order_of_their_times():
    world.check_order("abc", np.array([1.0, np.nan, 2.0]))
    with pytest.raises(ClockError, match=r"1 images are out of order: c comes after a but is 0\.500 s older"):
        world.check_order("abcd", np.array([1.0, np.nan, 0.5, 4.0]))
    with pytest.raises(ClockError, match=r"2 images are out of order: b comes after a but is 0\.000 s"):
        world.check_order("abcd", np.array([1.0, 1.0, 0.5, 4.0]))


def test_columns_of_bed_points():
    rng = np.random.default_rng(9)
    root = rng.normal(0, 0.01, (2, 3, 3))
    C = root @ np.swapaxes(root, 1, 2)
    cloud = SimpleNamespace(
        cov_m2=C,
        poses=SimpleNamespace(images=("a", "b", "c"), shift_m=np.repeat([[0.0], [1.0], [2.0]], 3, axis=1)),
        number=np.array([2, 0]), t_gps_s=np.array([5.0, 3.0]), xyz_m=np.array([[2.0, 5, 6], [0, 0, -7]]),
        own_m=np.array([[0, 0, -0.5], [0, 0, 0.25]]), line=np.array([1, -1]),
        xy_px=np.array([[1.0, 2], [3, 4]]),
        peak_dn=np.array([300.0, 12.6]), flags=np.array([4, 0]),
    )  # fmt: skip
    table = world.bed_points(cloud)
    assert table["file"].tolist() == ["c", "a"]
    assert table[["east_m", "north_m", "up_m"]].to_numpy().tolist() == cloud.xyz_m.tolist()
    assert table["sigma_line_m"].tolist() == [0.5, 0.25]
    assert table[["x_px", "y_px"]].to_numpy().tolist() == [[1, 2], [3, 4]]
    for name, (i, j) in {"ee": (0, 0), "en": (0, 1), "eu": (0, 2), "nn": (1, 1), "nu": (1, 2)}.items():
        assert table[f"cov_{name}_m2"].tolist() == pytest.approx(C[:, i, j])
    columns = world.laz_columns(cloud)
    extra = columns["extra"]
    assert extra["range"].tolist() == [5.0, 7.0]
    assert (extra["image"].tolist(), extra["line"].tolist()) == ([2, 0], [1, -1])
    assert columns["intensity"].tolist() == [255, 12]
    assert columns["t_gps_s"].tolist() == [5.0, 3.0]
    sigma = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    named = [extra[name] for name in world.SIGMAS]
    np.testing.assert_allclose(np.stack(named, axis=1), sigma)
    rho = C / (sigma[:, :, None] * sigma[:, None, :])
    for name, (i, j) in zip(world.CORRELATIONS, ((0, 1), (0, 2), (1, 2)), strict=True):
        assert extra[name].tolist() == pytest.approx(rho[:, i, j])
    cloud.t_gps_s = np.array([5.0, np.nan])
    assert "t_gps_s" not in world.laz_columns(cloud)
