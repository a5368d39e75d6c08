"""Lines, covariances of a motion, merged points and levels of a scan, against formulas written out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from thalweg.core import GeometryError, InputError, Rigid, exp_rotation
from thalweg.lightsheet.lines import LineFlag
from thalweg.lightsheet.poses import SensorPoses
from thalweg.lightsheet.scanning import compare, distances as d, levels
from thalweg.lightsheet.scanning.profile import (
    NO_LINE,
    Profile,
    ScanCloud,
    independent_share,
    joined_counts,
    merge,
    scan_points,
    sigma_along,
)

MM = 1e-3
UP = np.array([0.0, 0.0, 1.0])


def poses_of(rng, n, k=1):
    root = rng.normal(0, 1e-4, (n, 6, 6))
    return SensorPoses(
        images=tuple(f"{i}.png" for i in range(n)),
        R_target_lcs=exp_rotation(rng.normal(0, 1, (n, 3))),
        shift_m=rng.normal(0, 0.1, (n, 3)),
        cov=root @ np.swapaxes(root, 1, 2),
        shared=rng.normal(0, 1e-4, (n, 6, k)),
        reasons=("",) * n,
        t_gps_s=10.0 + np.arange(n),
        target="a",
        source="hand",
    )


def cloud_of(rng, number, k=1, **changes):
    number = np.array(number)
    n = len(number)
    values = {
        "poses": poses_of(rng, number.max() + 1),
        "xyz_m": rng.normal(0, 0.1, (n, 3)),
        "own_m": rng.normal(0, 1e-4, (n, 3)),
        "shared_m": rng.normal(0, 1e-4, (n, 3, k)).astype(np.float32),
        "number": number,
        "line": np.zeros(n, int),
        "piece": np.zeros(n, int),
        "flags": np.zeros(n, int),
        "rows": np.ones(n, int),
        "peak_dn": np.full(n, 50.0),
        "width_px": np.ones(n),
        "xy_px": rng.normal(0, 9, (n, 2)),
        "counts": {"images": 3},
        "left_out": {"x.png": "lost"},
    }
    return ScanCloud(**values | changes)


def distances_of(n, rng, **changes):
    values = {
        "distance_mm": rng.normal(0, 0.1, n),
        "normal": np.tile(UP, (n, 1)),
        "sigma_own_mm": rng.uniform(0.1, 0.2, n),
        "sigma_pose_mm": rng.uniform(0.1, 0.2, n),
        "sigma_shared_mm": rng.uniform(0.1, 0.2, n),
        "sigma_reference_mm": rng.uniform(0.1, 0.2, n),
        "at_border": np.zeros(n, bool),
        "far": np.zeros(n, bool),
    }
    return d.MeshDistances(**values | changes)


def skew(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def test_variances_of_points_of_a_scan(rng):
    """Own errors, those of the pose at its arm, and those of all points, also after a motion."""
    cloud = cloud_of(rng, [0, 1, 1], k=2)
    n = rng.normal(0, 1, (3, 3))
    for one in (cloud, cloud.moved(Rigid(R=exp_rotation([0.3, -0.2, 1.0]), shift_m=np.ones(3)), "b")):
        total = []
        for i in range(3):
            P = np.hstack([np.eye(3), -skew(one.xyz_m[i] - one.poses.shift_m[one.number[i]])])
            parts = (
                np.outer(one.own_m[i], one.own_m[i]),
                P @ one.poses.cov[one.number[i]] @ P.T,
                one.shared_m[i] @ one.shared_m[i].T,
            )
            told = [v[i] for v in one.variances_along(n)]
            np.testing.assert_allclose(told, [n[i] @ C @ n[i] for C in parts], rtol=1e-6)
            total.append(sum(parts))
        np.testing.assert_allclose(one.cov_m2, total, rtol=1e-6)
    assert (one.poses.target, cloud.moved(Rigid(R=np.eye(3), shift_m=np.zeros(3))).poses.target) == ("b", "a")
    np.testing.assert_allclose(one.xyz_m, cloud.xyz_m @ exp_rotation([0.3, -0.2, 1.0]).T + 1)
    assert (cloud.n_images, cloud.t_gps_s.tolist()) == (2, [10, 11, 11])


def test_points_of_a_scan_as_a_table(rng):
    cloud = cloud_of(rng, [0, 1, 1], line=np.array([3, 4, 5]), flags=np.array([1, 2, 3]))
    table = scan_points(cloud)
    assert table["file"].tolist() == ["0.png", "1.png", "1.png"]
    assert table["t_gps_s"].tolist() == [10, 11, 11]
    C = cloud.cov_m2
    for i, a in enumerate("xyz"):
        np.testing.assert_allclose(table[f"{a}_m"], cloud.xyz_m[:, i])
        for j, b in list(enumerate("xyz"))[i:]:
            np.testing.assert_allclose(table[f"cov_{a}{b}_m2"], C[:, i, j])
    assert (table["line"].tolist(), table["flags"].tolist()) == ([3, 4, 5], [1, 2, 3])
    np.testing.assert_allclose(table[["x_px", "y_px"]], cloud.xy_px)
    assert table["peak_dn"].tolist() == [50.0] * 3


def profile_of(rng, image, n=2):
    return Profile(
        image=image,
        xyz_lcs_mm=rng.normal(0, 100, (n, 3)),
        own_mm=rng.normal(0, 0.1, (n, 3)),
        shared_mm=rng.normal(0, 0.1, (n, 3, 2)),
        xy_px=rng.normal(0, 1, (n, 2)),
        line=np.full(n, 7),
        piece=np.arange(n),
        flags=np.zeros(n, int),
        rows=np.full(n, 3),
        peak_dn=np.full(n, 9.0),
        width_px=np.full(n, 2.0),
        counts={"points": n, f"of_{image}": 1},
    )


def test_profiles_in_the_frame_of_their_poses(rng):
    """What was lost is counted: an image without a pose, one with a pose and no line."""
    poses = replace(poses_of(rng, 4), reasons=("", "hidden", "", ""))
    parts = [profile_of(rng, f"{k}.png", n) for k, n in ((2, 2), (1, 3), (0, 1))]
    cloud = merge(parts, poses)
    assert cloud.counts == {
        "images": 3, "images_without_pose": 1, "images_without_line": 1,
        "points_without_pose": 3, "points": 3,
    }  # fmt: skip
    assert cloud.left_out == {"1.png": "hidden", "3.png": NO_LINE}
    assert cloud.number.tolist() == [0, 0, 1]
    assert cloud.poses.images == ("2.png", "0.png")
    for row, (part, i, k) in enumerate(((0, 0, 2), (0, 1, 2), (2, 0, 0))):
        R, one = poses.R_target_lcs[k], parts[part]
        arm = R @ one.xyz_lcs_mm[i] * MM
        np.testing.assert_allclose(cloud.xyz_m[row], arm + poses.shift_m[k])
        np.testing.assert_allclose(cloud.own_m[row], R @ one.own_mm[i] * MM)
        both = np.hstack([R @ one.shared_mm[i] * MM, np.hstack([np.eye(3), -skew(arm)]) @ poses.shared[k]])
        np.testing.assert_allclose(cloud.shared_m[row], both, rtol=1e-6)
    assert (cloud.piece.tolist(), cloud.rows.tolist(), cloud.line.tolist()) == ([0, 1, 0], [3] * 3, [7] * 3)
    assert joined_counts(parts) == {"points": 6, "of_2.png": 1, "of_1.png": 1, "of_0.png": 1}
    C = parts[0].cov_mm2[1]
    own, shared = sigma_along(parts[0].own_mm, parts[0].shared_mm, UP)
    assert own[1] ** 2 + shared[1] ** 2 == pytest.approx(C[2, 2])
    assert own[1] == pytest.approx(abs(parts[0].own_mm[1, 2]))
    # of three points that share three rows one is independent; a piece of one point is one
    assert independent_share(np.array([3, 3, 3, 3]), np.array([5, 5, 5, 9])) == pytest.approx(0.5)
    assert independent_share(np.array([2, 2, 2, 0]), np.array([1, 1, 1, 1])) == pytest.approx(2.5 / 4)
    assert independent_share(np.array([], int), np.array([], int)) == 1.0
    # pieces of two images are not one
    two = cloud_of(rng, [0, 0, 1, 1], rows=np.full(4, 9), piece=np.array([0, 0, 0, 1]))
    assert two.independent_share == pytest.approx((2 / 2 + 2) / 4)


def test_mean_and_slope_of_a_line_with_its_pose(rng):
    """40 points of a line, one of them gross, against least squares written out."""
    n = 40
    x = np.linspace(-0.1, 0.1, n)
    cloud = cloud_of(rng, [0] * n, xyz_m=np.column_stack([x, 0.5 * x, 0 * x]))
    noise = 0.01 * rng.standard_normal(n)
    noise[7] = 5.0
    found = distances_of(n, rng, distance_mm=0.3 + 2.0 * x / 0.1 * 0.05 + noise)
    rates = cloud.pose_rates(found.normal) / MM
    told = compare._line(cloud, found, rates, np.arange(n))
    on = np.arange(n) != 7
    s = x[on] - x[on].mean()
    B = np.column_stack([np.ones(n - 1), s / np.abs(s).max()])
    back = np.linalg.inv(B.T @ B) @ B.T
    e = back @ found.distance_mm[on]
    arm = cloud.xyz_m - cloud.poses.shift_m[0]
    J = np.column_stack([found.normal, np.cross(arm, found.normal)])[on] / MM
    single = found.sigma_own_mm[on] ** 2 + found.sigma_reference_mm[on] ** 2
    cov = back @ (J @ cloud.poses.cov[0] @ J.T + np.diag(single)) @ back.T
    sign = np.sign(told["slope_mm"] * e[1])
    assert told["mean_mm"] == pytest.approx(e[0])
    assert abs(told["slope_mm"]) == pytest.approx(abs(e[1]))
    assert (told["sigma_mean_mm"], told["sigma_slope_mm"]) == pytest.approx(tuple(np.sqrt(np.diag(cov))))
    e[1], cov[0, 1], cov[1, 0] = sign * e[1], sign * cov[0, 1], sign * cov[1, 0]
    assert told["statistic"] == pytest.approx(e @ np.linalg.solve(cov, e))
    # points that scatter by more than predicted count with that, neighbours of rows as one
    few = replace(found, sigma_own_mm=np.full(n, 1e-4), sigma_reference_mm=np.full(n, 1e-4))
    cloud = replace(cloud, rows=np.full(n, 4))
    told = compare._line(cloud, few, rates, np.arange(n))
    rest = found.distance_mm[on] - B @ (back @ found.distance_mm[on])
    cov = back @ (J @ cloud.poses.cov[0] @ J.T + 4 * np.std(rest) ** 2 * np.eye(n - 1)) @ back.T
    assert told["sigma_mean_mm"] == pytest.approx(np.sqrt(cov[0, 0]))


def test_lines_that_lie_off(rng, monkeypatch):
    """Limits are those of one scan in a hundred, widened by the median of the statistics of three or more."""
    counts = [30, 29, 30, 30, 31]
    number = np.repeat(np.arange(5), counts)
    cloud = cloud_of(rng, number)
    far = np.zeros(len(number), bool)
    far[-1] = True
    found = distances_of(len(number), rng, far=far)
    values = {0: 1.0, 2: 4.0, 3: 2.0 * chi2.median(2), 4: 60.0}

    def line(cloud, found, rates, on):
        names = ("mean_mm", "sigma_mean_mm", "slope_mm", "sigma_slope_mm")
        value = values[int(cloud.number[on[0]])]
        return dict.fromkeys(names, 0.5) | {"statistic": value}

    monkeypatch.setattr(compare, "_line", line)
    check = compare.check_lines(cloud, found)
    table = check.table
    assert table["n"].tolist() == [30, 29, 30, 30, 30]
    assert table["reason"].tolist() == ["", "fewer than 30 points on the reference", "", "", ""]
    scale = np.median([1.0, 4.0, values[3], 60.0]) / chi2.median(2)
    assert check.scale == pytest.approx(scale)
    limit = scale * chi2.isf(0.01 / 4, 2)
    assert table["limit"].tolist() == pytest.approx([limit] * 5)
    assert table["bad"].tolist() == [False, False, False, False, True]
    assert check.images == ["4.png"]
    assert check.bad.tolist() == (number == 4).tolist()
    # two lines tell no scale; statistics below their expectation narrow nothing
    two = compare.check_lines(cloud.where(number > 2), distances_of(61, rng))
    assert two.scale == 1.0
    values.update({0: 0.1, 2: 0.1, 3: 0.1, 4: 0.2})
    assert compare.check_lines(cloud, found).scale == 1.0


def test_the_covariance_of_a_motion(rng):
    """K S K' with own errors, poses line by line, and what all points share."""
    cloud = cloud_of(rng, [0] * 6 + [1] * 6, k=2, rows=np.full(12, 4))
    normal = rng.normal(0, 1, (13, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    kept = np.arange(13) != 3
    found = distances_of(13, rng, normal=normal)
    shift = np.array([0.1, 0.2, -0.1])
    for step in (1, 2, 8):
        cov, by_shared = compare._covariances(cloud, found, kept, shift, step)
        n, sigma = normal[kept], found.sigma_mm[kept] * MM
        A = np.column_stack([n, np.cross(cloud.xyz_m - shift, n)])
        W = np.diag(1 / sigma**2)
        K = np.linalg.inv(A.T @ W @ A) @ A.T @ W
        own = max(4 / step, 1) * found.sigma_own_mm[kept] ** 2 + found.sigma_reference_mm[kept] ** 2
        S = np.diag(own) * MM**2
        for k in (0, 1):
            on = cloud.number == k
            P = np.column_stack([n, np.cross(cloud.xyz_m - cloud.poses.shift_m[k], n)])
            S[np.ix_(on, on)] += P[on] @ cloud.poses.cov[k] @ P[on].T
        np.testing.assert_allclose(cov, K @ S @ K.T, rtol=1e-6, atol=1e-16)
        shared = np.einsum("nik,ni->nk", cloud.shared_m.astype(float), n)
        np.testing.assert_allclose(by_shared, K @ shared, rtol=1e-5, atol=1e-12)


def test_one_step_of_an_alignment(rng):
    """Weighted least squares of distances from tangential planes, about the middle of the points."""
    cloud = cloud_of(rng, [0] * 30)
    normal = rng.normal(0, 1, (30, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    far = np.arange(30) == 4
    motion = 1e-4 * rng.normal(0, 1, 6)
    shift = np.array([0.3, -0.2, 0.1])
    A = np.column_stack([normal, np.cross(cloud.xyz_m - shift, normal)])
    found = distances_of(30, rng, normal=normal, far=far, distance_mm=-(A @ motion) / MM)
    dx, kept, _ = compare._step(cloud, found, shift)
    np.testing.assert_allclose(dx, motion, atol=1e-12)
    assert kept.tolist() == (~far).tolist()


def test_picked_pairs_that_are_no_motion_of_each_other():
    a = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0.02]])
    R = exp_rotation([0.3, 0.2, -0.5])
    T = compare.from_pairs(a, a @ R.T + [1, 2, 3])
    np.testing.assert_allclose(T.R, R, atol=1e-12)
    np.testing.assert_allclose(T.shift_m, [1, 2, 3])
    spread = np.linalg.svd(a - a.mean(axis=0))[1][0]
    for share, refused in ((0.19, False), (0.21, True)):
        # four corners moved in and out along the normal leave a rms of that size, and no motion
        off = share * spread / 2 * np.array([1, -1, -1, 1])
        flat = a * [1, 1, 0]
        spread_flat = np.linalg.svd(flat - flat.mean(axis=0))[1][0]
        off *= spread_flat / spread
        if refused:
            with pytest.raises(GeometryError, match=rf"differ by {1e3 * abs(off[0]):.1f} mm"):
                compare.from_pairs(flat, flat + off[:, None] * UP)
        else:
            compare.from_pairs(flat, flat + off[:, None] * UP)
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 0.1, 0]])
    for height, words in ((0.14, None), (0.07, "lie on a line")):
        line[3, 1] = height
        if words:
            with pytest.raises(GeometryError, match=words):
                compare.from_pairs(line, line)
        else:
            compare.from_pairs(line, line)


def compared(rng, n=60, **changes):
    number = np.repeat(np.arange(3), n // 3)
    cloud = cloud_of(rng, number)
    found = distances_of(n, rng, **changes)
    bad = number == 2
    table = pd.DataFrame({"image": cloud.poses.images, "bad": [False, False, True], "statistic": [1.0, 2, 3]})
    check = compare.LineCheck(table=table, scale=2.5, bad=bad)
    return compare.Compared(cloud=cloud, distances=found, check=check, facts={})


def test_facts_and_tables_of_a_comparison(rng):
    n = 60
    far, border = np.arange(n) < 5, np.isin(np.arange(n), [3, 8, 59])
    one = compared(rng, far=far, at_border=border)
    used = ~far & ~border & (one.cloud.number != 2)
    assert one.used.tolist() == used.tolist()
    facts = compare._shared_facts(one.cloud, one.distances, one.check, one.used, 1.25)
    assert facts["counts"] == {
        "images": 3, "points": n, "far": 5, "at_border": 2, "used": n - 7, "on_bad_lines": 19,
    }  # fmt: skip
    assert facts["images_left_out"] == {"x.png": "lost"}
    assert (facts["images_with_bad_pose"], facts["line_limit_scale"], facts["sigma0"]) == (
        ["2.png"],
        2.5,
        1.25,
    )
    assert facts["independent_share"] == 1.0
    assert facts["consistency"] == d.consistency(one.distances.distance_mm, one.distances.sigma_mm, used)
    assert facts["shape"] == d.normality(one.distances.distance_mm[used], 1.0)
    table = compare.distance_table(one)
    reason = np.where(
        far, "far", np.where(border, "at_border", np.where(one.cloud.number == 2, "bad_pose", ""))
    )
    assert table["reason"].tolist() == reason.tolist()
    assert table["used"].tolist() == used.tolist()
    assert table["file"].tolist() == [f"{k}.png" for k in one.cloud.number]
    for name in ("distance_mm", "sigma_mm", "sigma_own_mm", "sigma_pose_mm"):
        np.testing.assert_allclose(table[name], getattr(one.distances, name))
    np.testing.assert_allclose(table[["x_m", "y_m", "z_m"]], one.cloud.xyz_m)
    rows = compare.statistics(one, "wreck")
    assert rows["points"].tolist() == ["all lines"] * 3 + ["without bad poses"] * 3 + ["published"]
    assert rows["lines"].tolist() == [3, 3, 3, 2, 2, 2, 70]
    assert rows["rule"].tolist() == [*d.RULES, *d.RULES, "3 sigma"]
    assert rows["n"].tolist() == [n - 7] * 3 + [used.sum()] * 3 + [66666]
    assert rows["share_kept"].iloc[-1] == pytest.approx(65987 / 66666)
    sigmas = [one.distances.sigma_own_mm, one.distances.sigma_pose_mm, one.distances.sigma_shared_mm]
    whole = np.sqrt(sum(s**2 for s in sigmas) + one.distances.sigma_reference_mm**2)
    np.testing.assert_allclose(one.distances.sigma_mm, whole)


@pytest.mark.parametrize(("shift", "told"), [(0.0, False), (0.5, True), (-0.5, True)])
def test_bright_points_that_lie_aside_are_told(rng, shift, told):
    bright = np.arange(60) % 2 == 0
    off = 0.05 * rng.standard_normal(60) + shift * bright
    one = compared(rng, distance_mm=off)
    one = replace(one, check=replace(one.check, bad=np.zeros(60, bool)))
    for flags, what in ((bright * int(LineFlag.SATURATED), "over-exposed"), (0 * bright, "bright")):
        cloud = replace(one.cloud, flags=flags.astype(int), peak_dn=np.where(bright, 200.0, 20.0))
        facts, warning = compare._by_brightness(replace(one, cloud=cloud))
        found = off[bright].mean() - off[~bright].mean()
        assert facts["shift_mm"] == pytest.approx(found)
        variance = (off[bright].var(ddof=1) + off[~bright].var(ddof=1)) / 30
        assert facts["sigma_shift_mm"] == pytest.approx(np.sqrt(variance))
        assert facts["by_brightness"] == told
        # half a millimetre aside is more than the scatter of the two halves together
        nmad = 1.4826 * np.median(np.abs(off - np.median(off)))
        expected = told and abs(found) >= nmad
        assert bool(warning) == expected
        if expected:
            assert warning.startswith(f"{what} points lie {found:+.2f} mm from the others, which scatter by")
            assert f"scatter by {nmad:.2f} mm" in warning
    few = compared(rng, n=15)
    facts, warning = compare._by_brightness(few)
    assert (list(facts), warning) == (["words"], "")


def test_the_middle_image_of_a_scan():
    """Among those with at least half of the most points, in the order of the scan."""
    counts = {"d": 10, "a": 4, "b": 5, "c": 9, "e": 10, "f": 1}
    rows = [(name, k % 5 != 4 or name != "b") for name, n in counts.items() for k in range(n)]
    table = pd.DataFrame(rows, columns=["file", "used"])
    assert compare.middle_image(table) == "c"
    with_b = table.assign(used=True)
    assert compare.middle_image(with_b) == "c"
    assert compare.middle_image(with_b[with_b["file"] != "d"]) == "c"
    with pytest.raises(InputError, match="no point of the scan is used"):
        compare.middle_image(table.assign(used=False))


def test_the_middle_profile_of_an_object_without_levels(rng):
    n = 30
    mine = pd.DataFrame(
        {
            "file": "b",
            "used": np.arange(n) > 1,
            "distance_mm": rng.normal(0, 0.1, n),
            "peak_dn": 50.0 + np.arange(n),
        }
    )
    other = mine.assign(file="a", used=False)
    points = pd.DataFrame({"file": ["a", "b", "b"], "rows": [100, 2, 6]})
    rows, facts = compare.single_profile(None, points, pd.concat([other, mine]), "wreck")
    d_mm, peak = mine["distance_mm"][2:].to_numpy(), mine["peak_dn"][2:].to_numpy()
    assert facts["image"] == "b"
    assert facts["rms_mm"] == pytest.approx(np.sqrt(np.mean(d_mm**2)))
    assert facts["bimodality"] == d.bimodality(d_mm, peak, independent_share=0.25).words()
    assert rows["points"].tolist() == ["middle line"] * 3 + ["published"]
    assert rows["lines"].tolist() == [1] * 4
    assert rows["n"].tolist() == [n - 2] * 3 + [1105]
    _, facts = compare.single_profile(None, points, mine[:15], "wreck")
    assert facts["bimodality"] == "13 distances and 13 brightnesses"


def test_what_is_told_of_levels():
    found = SimpleNamespace(
        plane_n=np.array([10, 9, 50]),
        plane_height_mm=np.array([0.0, 10.5, 20.25]),
        plane_rms_mm=np.array([0.1, np.nan, 0.3]),
        used=np.arange(100) < 70,
    )
    told = compare.level_warnings(found, (0.0, 10.0, 20.0))
    assert told == [
        "hardly a point lies on the level at 10 mm: it was not scanned, or lies at another height"
    ]
    found.used = np.arange(100) < 69
    assert compare.level_warnings(found, (0.0, 10.0, 20.0))[1].startswith(
        "31 of 100 points on the object lie"
    )
    assert compare.level_facts(found, (0.0, 10.0, 20.0))[2] == {
        "height_mm": 20.0, "measured_mm": 20.25, "rms_own_plane_mm": 0.3, "n": 50,
    }  # fmt: skip


@pytest.fixture
def faked(monkeypatch, rng):
    """A scan whose merging and comparison are given."""
    cloud = cloud_of(rng, [0] * 10 + [1] * 10)
    monkeypatch.setattr(compare, "profiles", lambda sensor, points: ((sensor, points), {}))
    monkeypatch.setattr(compare, "merge", lambda profiles, poses: (cloud, profiles, poses))
    monkeypatch.setattr(compare, "_by_brightness", lambda found: ({"words": "w"}, "bright"))
    return compared(rng)


@pytest.mark.parametrize(("scale", "doubt"), [(24.9, False), (25.1, True)])
def test_a_scan_of_which_half_the_lines_lie_off(faked, monkeypatch, scale, doubt):
    one = replace(faked, check=replace(faked.check, scale=scale))
    asked = []
    monkeypatch.setattr(compare, "compare_with_mesh", lambda *words: asked.append(words) or one)
    found = compare.compare_scan("s", "p", "poses", "surface", "pairs")
    assert asked[0][0][1:] == (("s", "p"), "poses")
    assert asked[0][1:] == ("surface", "pairs")
    assert found.facts["brightness"] == {"words": "w"}
    assert len(found.facts["warnings"]) == 1 + doubt
    if doubt:
        assert "more than 5 times what their poses explain" in found.facts["warnings"][1]

    def refused(*words):
        raise GeometryError("bad", expected="good", where="" if doubt else "here", cure="do this")

    monkeypatch.setattr(compare, "compare_with_levels", refused)
    with pytest.raises(GeometryError, match=r"do this\. Check that images and poses") as told:
        compare.compare_scan("s", "p", "poses", "surface", "pairs", (0.0, 1.0))
    assert told.value.where == ("scan against its reference" if doubt else "here")


@pytest.mark.parametrize(("bad", "refused"), [(4, False), (5, True)])
def test_more_than_two_fifths_of_bad_lines_are_refused(rng, monkeypatch, bad, refused):
    cloud = cloud_of(rng, range(11))
    names = cloud.poses.images
    rounds = []

    def check_of(k):
        table = pd.DataFrame({"image": names, "bad": np.arange(11) < k, "statistic": [*range(10), np.nan]})
        return compare.LineCheck(table=table, scale=1.0, bad=np.arange(11) < k)

    seen = iter([bad, bad, 99])
    made = SimpleNamespace(cloud=cloud, distances=distances_of(11, rng), T_mesh_target="T")
    monkeypatch.setattr(compare, "check_lines", lambda cloud, found: check_of(next(seen)))
    monkeypatch.setattr(
        compare, "align", lambda cloud, *words, **how: rounds.append((len(cloud), words, how)) or made
    )
    monkeypatch.setattr(compare, "of_all", lambda good, cloud, surface: good)
    if refused:
        with pytest.raises(GeometryError, match="5 of 10 lines lie off by more than their poses explain"):
            compare.scan_against_mesh(cloud, "surface", "start")
        return
    found = compare.scan_against_mesh(cloud, "surface", "start")
    assert rounds == [(11, ("surface", "start"), {}), (7, ("surface", "T"), {"start_mm": d.MAX_DISTANCE_MM})]
    assert found.used.tolist() == [False] * 4 + [True] * 7
    assert found.distance_mm.tolist() == made.distances.distance_mm[4:].tolist()


def test_distances_of_a_mesh_and_their_parts(rng):
    cloud = cloud_of(rng, [0, 0, 1, 1])
    normal = np.array([UP, UP, [0, 0, 0], UP])
    away = np.array([0.0029, -0.0031, 0.001, 0.002])
    found = SimpleNamespace(
        distance_m=away,
        normal=normal,
        sigma_m=np.full(4, 2e-4),
        at_border=np.array([False, False, False, True]),
    )
    told = d.mesh_distances(cloud, SimpleNamespace(distances=lambda xyz: found))
    np.testing.assert_allclose(told.distance_mm, [2.9, -3.1, 1.0, 2.0])
    assert told.far.tolist() == [False, True, False, False]
    assert told.at_border.tolist() == [False, False, True, True]
    own, pose, shared = cloud.variances_along(normal)
    for name, values in (("own", own), ("pose", pose), ("shared", shared), ("reference", 4e-8)):
        np.testing.assert_allclose(getattr(told, f"sigma_{name}_mm"), np.sqrt(values) * 1e3 + np.zeros(4))


def test_planes_of_levels_by_hand():
    """Tilted by 0.02 and -0.01, 3 mm above the origin: heights, distances, axes."""
    rng = np.random.default_rng(1)
    xy = rng.uniform(-50, 50, (90, 2))
    h = np.repeat([0.0, 20.0, 40.0], 30)
    length = np.sqrt(1 + 0.02**2 + 0.01**2)
    z = 3.0 + 0.02 * xy[:, 0] - 0.01 * xy[:, 1] + h * length
    X = np.column_stack([xy, z])
    X[0, 2] += 2.9
    X[1, 2] += 3.1
    found = levels.fit_levels(X, UP, heights_mm=(0.0, 20.0, 40.0))
    normal = np.array([-0.02, 0.01, 1.0]) / length
    np.testing.assert_allclose(found.normal, normal, atol=1e-3)
    assert found.height_mm == pytest.approx(3.0 / length, abs=0.1)
    assert found.level.tolist() == [0, -1, *[0] * 28, *[1] * 30, *[2] * 30]
    assert np.isnan(found.distance_mm[1])
    assert found.distance_mm[0] == pytest.approx(2.9 / length, abs=0.1)
    assert found.plane_n.tolist() == [29, 30, 30]
    assert found.plane_height_mm[1:] == pytest.approx([20, 40], abs=0.05)
    assert found.plane_rms_mm[1:] == pytest.approx([0, 0], abs=1e-6)
    for up in (UP, np.array([1.0, 2, -3]), np.array([0, 5.0, 0])):
        axes = levels._axes(up)
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(axes[2], up / np.linalg.norm(up))
        assert np.linalg.det(axes) == pytest.approx(1.0)


def test_a_plane_of_its_own_has_three_unknowns():
    local = np.array([[0.0, 0, 1], [2, 0, -1], [0, 2, -1], [2, 2, 1], [9, 9, 9], [8, 8, 8]])
    rms, n, mean = levels._single_planes(local, np.array([1, 1, 1, 1, 0, -1]), local[:, 2] + 5, 2)
    assert n.tolist() == [1, 4]
    # four corners, 1 mm off their plane each: the sum of squares over one degree of freedom
    np.testing.assert_allclose(rms, [np.nan, 2.0])
    np.testing.assert_allclose(mean, [np.nan, 5.0])


@pytest.mark.parametrize(("tilt", "refused"), [(0.098, False), (0.102, True)])
def test_planes_tilted_by_a_tenth_are_refused(tilt, refused):
    rng = np.random.default_rng(2)
    xy = rng.uniform(-20, 20, (60, 2))
    X = np.column_stack([xy, tilt * (0.6 * xy[:, 0] + 0.8 * xy[:, 1])])
    if refused:
        with pytest.raises(GeometryError, match=r"planes tilted by 5\.8 degrees"):
            levels.fit_levels(X, UP, heights_mm=(0.0,))
    else:
        found = levels.fit_levels(X, UP, heights_mm=(0.0,), sigma_mm=np.full(60, 0.1))
        assert np.hypot(*found.adjusted.x[1:]) == pytest.approx(tilt, abs=1e-6)


def test_the_derivatives_of_tilted_planes(monkeypatch):
    """Residuals and weights of points and of the stated direction, by differences."""
    rng = np.random.default_rng(3)
    local = rng.uniform(-50, 50, (4, 3))
    groups = []

    def adjust(given, x, names, **how):
        groups.extend(given)
        return how

    h, sigma, x = np.array([0.0, 20, 0, 20]), np.array([0.1, 0.2, 0.3, 0.4]), np.array([1.0, 0.3, -0.2])
    monkeypatch.setattr(levels, "adjust", adjust)
    levels._adjusted(local, h, sigma, x, 0.02)
    points, tilts = (group.model(x) for group in groups)
    normal = np.array([-0.3, 0.2, 1.0])
    expected = (local @ normal - 1.0) / np.sqrt(1.13) - h
    np.testing.assert_allclose(points.residual, expected)
    np.testing.assert_allclose(points.cov, sigma**2)
    for i in range(3):
        step = 1e-6 * np.eye(3)[i]
        slope = (groups[0].model(x + step).residual - groups[0].model(x - step).residual) / 2e-6
        np.testing.assert_allclose(points.jacobian[:, i], slope, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(tilts.residual, [0.3, -0.2])
    np.testing.assert_allclose(tilts.jacobian, [[0, 1, 0], [0, 0, 1]])
    np.testing.assert_allclose(tilts.cov, [4e-4] * 2)
