"""Measures of change, of points and of terrain against the truth, on a few rows written by hand."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from tests.lab.sheets import scene_of, sheet
from thalweg.core import ConfigError, CoverageError, GeometryError, Rigid, exp_rotation
from thalweg.core.geometry import TriangleMesh
from thalweg_lab.river import Material
from thalweg_lab.settings import TwinScene
from thalweg_lab.truth import change, points as of_points

UP = np.array([0.0, 0.0, 1.0])


# ---------------------------------------------------------------- change


def test_every_measure_of_changes(monkeypatch):
    """Ten places: two quiet ones, two eroded, one filled, one unseen, plants, a stone, none of the truth."""
    true = np.array([0.0, 0.004, -0.5, -0.08, 0.3, -0.02, 0.0, 0.2, np.nan, 0.0])
    kind = np.array(["unchanged"] * 2 + ["erosion"] * 2 + ["deposition", "erosion", "vegetation", "object",
                     "outside", "unchanged"])  # fmt: skip
    found = np.array([0.03, -0.02, -0.44, -0.05, 0.36, np.nan, 0.7, 0.1, 0.5, 0.5])
    sigma = np.array([0.01, 0.02, 0.03, 0.03, 0.04, np.nan, 0.1, 0.1, 0.1, 0.1])
    same = "no significant change"
    state = [
        "deposition",
        same,
        "erosion",
        same,
        "deposition",
        "erosion",
        "erosion",
        same,
        "erosion",
        "object",
    ]
    area = np.arange(1.0, 11.0)
    asked = []

    def truth(before, after, core, normal, *, radius_m, reach_m):
        asked.append((before, after, core, normal, radius_m, reach_m))
        return change.TrueChanges(distance_m=true, kind=kind, off_m=0 * true)

    monkeypatch.setattr(change, "true_changes", truth)
    table = pd.DataFrame({"core": np.arange(10), "distance_m": found, "sigma_m": sigma, "state": state})
    for i, a in enumerate(("east", "north", "up")):
        table[f"{a}_m"], table[f"normal_{a}"] = i + np.arange(10.0), UP[i]
    volumes = pd.DataFrame({"what": ["erosion", "net"], "sigma_m3": [9.0, 0.5]})
    measures, cores = change.judge_changes(
        table, pd.DataFrame({"area_m2": area}), volumes, "b", "a", radius_m=0.5, reach_m=2.0
    )
    assert asked[0][:2] + asked[0][4:] == ("b", "a", 0.5, 2.0)
    np.testing.assert_array_equal(asked[0][2][3], [3, 4, 5])
    np.testing.assert_array_equal(asked[0][3][3], UP)
    z = (found - true) / sigma
    of = [0, 1, 2, 3, 4, 7, 6]
    net = float(np.sum((area * (found - true))[of]))
    expected = {
        "normalised_square_unchanged": ((z[0] ** 2 + z[1] ** 2) / 2, 2),
        "false_alarm_95": (0.5, 2),
        "normalised_square_changed": (np.mean(z[2:5] ** 2), 3),
        "sensitivity_0.1_m": (1.0, 2),
        "specificity": (0.5, 2),
        # called and counted: 0, 2, 4 and the one of plants
        "false_discovery": (1 / 4, 4),
        "net_volume_error_m3": (net, 7),
        "net_volume_error_over_sigma": (net / 0.5, 7),
        "largest_retreat_true_m": (0.5, 3),
        "largest_retreat_measured_m": (0.44, 3),
        "unseen_called_change": (1.0, 1),
        "unseen_called_change_wrongly": (1.0, 1),
        "plants_called_change": (1.0, 1),
        "things_called_change": (0.0, 1),
    }
    assert measures["measure"].tolist() == list(expected)
    assert measures["value"].tolist() == pytest.approx([v for v, _ in expected.values()])
    assert measures["n"].tolist() == [n for _, n in expected.values()]
    assert cores["true_class"].tolist() == kind.tolist()
    assert cores["core"].tolist() == list(range(10))
    kind[:] = "outside"
    measures, _ = change.judge_changes(
        table, pd.DataFrame({"area_m2": area}), volumes, "b", "a", radius_m=0.5, reach_m=2.0
    )
    assert measures.set_index("measure").loc["sensitivity_0.1_m", "n"] == 0
    assert np.isnan(measures.set_index("measure").loc["specificity", "value"])


def test_starts_of_rays_fill_a_disc_across_the_normal():
    core = np.array([[1.0, 2, 3], [4, 5, 6]])
    normal = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, 1.0]])
    found = change._bundle(core, normal, 0.5, 400)
    off = found - core[:, None]
    np.testing.assert_allclose(np.einsum("nkj,nj->nk", off, normal), 0.0, atol=1e-12)
    r = np.linalg.norm(off, axis=2)
    np.testing.assert_allclose(r, np.tile(0.5 * np.sqrt((np.arange(400) + 0.5) / 400), (2, 1)))
    # evenly to all sides: no mean, and a quarter of the squared radius in each direction
    np.testing.assert_allclose(off.mean(axis=1), 0.0, atol=2e-3)
    tilt = np.linalg.eigvalsh(off[0].T @ off[0] / 400)
    np.testing.assert_allclose(tilt, [0, 0.25 / 4, 0.25 / 4], rtol=0.01, atol=1e-12)
    np.testing.assert_array_equal(change._bundle(core, normal, 0.5, 1)[:, 0], core)


def column(*surfaces):
    """Heights at which ground begins or ends, from above."""
    z = np.array([[z for z, _ in surfaces]], float)
    return z, np.array([[s for _, s in surfaces]], float)


@pytest.mark.parametrize(
    ("first", "second", "above", "went", "came"),
    [
        ([(2, 1)], [(3, 1)], -np.inf, 0.0, 1.0),
        ([(3, 1)], [(2, 1)], -np.inf, 1.0, 0.0),
        ([(3, 1)], [(1, 1)], 1.5, 1.5, 0.0),
        # a slab from 5 to 4 m that sinks by half a metre over ground at 1 m
        ([(5, 1), (4, -1), (1, 1)], [(4.5, 1), (3.5, -1), (1, 1)], -np.inf, 0.5, 0.5),
        ([(5, 1), (4, -1), (1, 1)], [(1, 1), (-np.inf, 0), (-np.inf, 0)], -np.inf, 1.0, 0.0),
        # a hollow below an overhang
        ([(5, 1)], [(5, 1), (4, -1), (2, 1)], -np.inf, 2.0, 0.0),
    ],
)
def test_ground_that_went_and_came_in_a_column(first, second, above, went, came):
    found = change._gone_and_new(column(*first), column(*second), np.array([True]), above)
    assert [float(v[0]) for v in found] == pytest.approx([went, came])


def test_columns_stand_in_the_middle_of_their_cells():
    outline = np.array([[0.0, 0], [1, 0], [1, 0.4], [0, 0.4]])
    found = change._columns("a", outline, 0.2)
    assert len(found) == 10
    np.testing.assert_allclose(found.min(axis=0), [0.1, 0.1])
    np.testing.assert_allclose(found.max(axis=0), [0.9, 0.3])
    with pytest.raises(
        GeometryError, match=r"outline thin is narrower than the columns; expected more than 3"
    ):
        change._columns("thin", outline, 3.0)


def test_places_of_true_change_are_seen_and_called():
    """Core points within one and a half spacings; the wrong sign is not called."""
    measured = pd.DataFrame(
        {
            "east_m": [0.0, 10.0, 20.0, 30.0], "north_m": 0.0, "up_m": 0.0,
            "distance_m": [-0.2, 0.3, np.nan, 0.2],
            "state": ["erosion", "deposition", "erosion", "no significant change"],
        }
    )  # fmt: skip
    truth = pd.DataFrame(
        {
            "east_m": [1.49, 10.0, 20.0, 30.0, 1.51, 0.0],
            "north_m": 0.0,
            "up_m": 0.0,
            "kind": ["erosion", "erosion", "erosion", "deposition", "erosion", "unchanged"],
            "distance_m": [-0.1, -0.3, -0.3, 0.2, -0.5, -0.5],
        }
    )
    found = change.judge_places(measured, truth, 1.0)
    assert found == [("true_changes_seen", 3 / 5, 5), ("true_changes_called", 1 / 3, 3)]
    small = truth.assign(distance_m=[-0.099] * 5 + [-0.5])
    assert change.judge_places(measured, small, 1.0) == []
    far = truth.assign(north_m=50.0)
    (_, seen, _), (_, called, n) = change.judge_places(measured, far, 1.0)
    assert (seen, n) == (0.0, 0)
    assert np.isnan(called)


@pytest.mark.parametrize(
    ("name", "side", "behind"),
    [
        ("niche", "right", (0.0, change.NICHE_REACH_M)),
        ("collapsed_niche", "right", (0.0, change.NICHE_REACH_M)),
        ("undercut_bank", "left", (-1.0, 0.75 + 3.0)),
        ("gravel_bar", "left", (-(change.BAR_PLACE + 0.055) * 20, -(change.BAR_PLACE - 0.055) * 20)),
        ("fallen_tree", "left", (-3.5, 3.0)),
        ("pool", "thalweg", (-2.0, 2.0)),
    ],
)
def test_where_a_change_lies(name, side, behind):
    found = change._behind(SimpleNamespace(width_m=20.0, retreat_m=0.75), name)
    assert found == (side, pytest.approx(behind))


def test_where_banks_retreat_and_boulders_lie(monkeypatch):
    monkeypatch.setattr(change, "retreat_reach_m", lambda scene: 4.0)
    monkeypatch.setattr(change, "slope_width", lambda scene: 7.0)
    of = SimpleNamespace(width_m=20.0)
    assert change._behind(of, "bank_retreat") == ("right", (-1.0, 5.0))
    for name in ("moved_boulders", "new_boulders"):
        assert change._behind(of, name) == ("right", (-1.9, 7.0))


def test_a_strip_along_a_river():
    """A straight river of 20 m that widens: from where to where behind its shore, and there and back."""
    river = SimpleNamespace(
        half_width=lambda s: 10.0 + 0.1 * s,
        thalweg_n=lambda s: 2.0 + 0 * s,
        to_wcs=lambda s, n: np.column_stack([s, n]),
    )
    where = change.Stretch(50.0, 8.0)
    s = np.linspace(42.0, 58.0, 33)
    for side, first, last in (
        ("right", -(10 + 0.1 * s) + 1.0, -(10 + 0.1 * s) - 3.0),
        ("left", 10 + 0.1 * s - 1.0, 10 + 0.1 * s + 3.0),
        ("thalweg", 1.0 + 0 * s, 5.0 + 0 * s),
    ):
        found = change._strip(river, where, side, (-1.0, 3.0))
        np.testing.assert_allclose(found[:33], np.column_stack([s, first]))
        np.testing.assert_allclose(found[33:], np.column_stack([s, last])[::-1])


def test_outlines_of_what_changed(monkeypatch):
    """Of both epochs; patches have one each, what grew has none; epochs of two rivers are refused."""
    strips = []
    monkeypatch.setattr(change, "River", lambda scene, seed: SimpleNamespace(bank_scale=lambda s, n: 2.0))
    monkeypatch.setattr(change, "_strip", lambda river, *words: strips.append(words) or words)
    patch = SimpleNamespace(name="p", middle_s_m=30.0, right_m=5.0, slope_rad=np.pi / 3)
    monkeypatch.setattr(change, "patches", lambda epoch: [patch])
    monkeypatch.setattr(change, "stretch", lambda epoch, name: name)
    before = TwinScene(changes=("niche",))
    after = TwinScene(changes=("change_patches", "collapsed_niche", "grown_vegetation"))
    found = change.change_outlines(before, after, 3)
    assert list(found) == ["niche", "p"]
    assert found["niche"][:2] == ("collapsed_niche", "right")
    where, side, behind = found["p"]
    half = (change.PATCH_M[0] + change.EDGE_M) / 2 / 2.0
    up = (change.PATCH_M[1] + change.EDGE_M) / 2 * 0.5
    assert (where.middle_m, where.half_m, side) == (30.0, pytest.approx(half), "right")
    assert behind == pytest.approx((5.0 - up, 5.0 + up))
    with pytest.raises(ConfigError, match="two scenes of different rivers"):
        change.change_outlines(before, after.model_copy(update={"width_m": after.width_m + 1}), 3)
    with pytest.raises(ConfigError, match="a river of seed 4; expected seed 3"):
        change.change_outlines(before, after.model_copy(update={"seed": 4}), 3)
    assert list(change.change_outlines(before, after.model_copy(update={"seed": 3}), 3)) == ["niche", "p"]


def test_kinds_of_polygons():
    plain = pd.DataFrame({"name": ["a", "b", "c", "fallen_tree"], "net_m3": [-1.0, 2.0, 0.0, 5.0]})
    scenes = [SimpleNamespace(water_level_m=level) for level in (0.5, 0.75)]
    square = np.array([[0.0, 0], [1, 0], [1, 1.2345]])
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(change, "true_volumes", lambda *words, above_m: plain.assign(above=above_m))
        found = change.true_polygons(*scenes, dict.fromkeys(plain["name"], square))
    assert found["kind"].tolist() == ["erosion", "deposition", "unchanged", "object"]
    assert found["above"].tolist() == [0.75] * 4
    assert found["outline"][0] == "0.000 0.000; 1.000 0.000; 1.000 1.234"


# ---------------------------------------------------------------- points


def test_errors_of_points_in_three_dimensions(monkeypatch, tmp_path):
    rng = np.random.default_rng(1)
    root = rng.normal(0, 0.1, (2, 3, 3))
    cov = root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(3)
    monkeypatch.setattr(of_points, "cloud_covariance", lambda cloud, where: cov)
    true = np.array([[1.0, 2, 3], [4, 5, 6]])
    error = rng.normal(0, 0.1, (2, 3))
    cloud = {
        "xyz_m": true + error,
        "t_gps_s": np.array([1.0, 2.0]),
        "range": np.array([9.0, 8.0], np.float32),
    }
    found = of_points.point_errors_3d(cloud, true, where=tmp_path)
    np.testing.assert_allclose(found.error_m, error)
    np.testing.assert_allclose(found.squared_m2, [e @ e for e in error])
    np.testing.assert_allclose(found.predicted_m2, [C[0, 0] + C[1, 1] + C[2, 2] for C in cov])
    expected = [e @ np.linalg.inv(C) @ e / 3 for e, C in zip(error, cov, strict=True)]
    np.testing.assert_allclose(found.normalised, expected)
    assert (found.t_gps_s.tolist(), found.range_m.tolist()) == ([1, 2], [9, 8])


class Still:
    """A boat that does not move."""

    def __init__(self, place, R, known):
        self.place, self.R, self.known = np.array(place, float), R, np.array(known)

    def at(self, t):
        n = len(t)
        return np.tile(self.place, (n, 1)), np.tile(self.R, (n, 1, 1)), self.known[:n]


def truth_over(*parts, boat, mount, divergence=0.003):
    scene = scene_of(*parts, level_m=-50.0)
    return of_points.Truth(
        trajectory=boat,
        mount=mount,
        surface=scene.caster(),
        bare_ground=np.isin(scene.material, [int(Material.SOIL), int(Material.BED)]),
        divergence_rad=divergence,
    )


def test_the_error_of_a_point_is_its_distance_from_the_true_surface():
    """A beam down at an angle from a boat that was truly elsewhere, onto ground that slopes by 1 in 5."""
    ground = sheet([0, 0, 0], [60, 0, 12.0], [0, 60, 0])
    mount = Rigid(R=exp_rotation([0.2, 0.1, 0.4]), shift_m=np.array([0.1, 0.2, 0.3]))
    true_mount = Rigid(R=exp_rotation([0.21, 0.1, 0.4]), shift_m=np.array([0.1, 0.25, 0.3]))
    R, R_true = exp_rotation([0.1, -0.2, 1.0]), exp_rotation([0.11, -0.2, 1.0])
    known = [True, True, False, True, True]
    estimated, boat = Still([1, 2, 20], R, known), Still([1.05, 2, 20.1], R_true, [True] * 4 + [False])
    truth = truth_over((ground, Material.SOIL), boat=boat, mount=true_mount)
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-9, 9, (5, 2)), np.zeros(5)])
    points[:, 2] = 0.2 * points[:, 0] + 0.05
    points[3] = [500.0, 0, 20]
    cov = np.tile(np.diag([0.01, 0.04, 0.09]), (5, 1, 1))
    offset = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    found = of_points.point_errors(
        points, np.arange(5.0), cov, offset, estimated=estimated, mount=mount, truth=truth
    )
    # the third and the last have no pose, the fourth beam meets nothing
    assert found.t_gps_s.tolist() == [0, 1]
    normal = np.array([-0.2, 0, 1]) / np.sqrt(1.04)
    for i in (0, 1):
        beam = mount.R.T @ (R.T @ (points[i] - estimated.place) - mount.shift_m) - [0, 0, offset[i]]
        assert found.range_m[i] == pytest.approx(np.linalg.norm(beam))
        start = boat.place + R_true @ (true_mount.shift_m + true_mount.R @ [0, 0, offset[i]])
        way = R_true @ true_mount.R @ beam
        hit = start - way * (normal @ start) / (normal @ way)
        assert found.error_m[i] == pytest.approx(normal @ (points[i] - hit), abs=5e-5)  # rays of float32
        assert found.sigma_m[i] == pytest.approx(np.sqrt(normal @ cov[i] @ normal), rel=1e-4)
    assert found.on_ground.tolist() == [True, True]
    some = of_points.point_errors(
        points, np.arange(5.0), cov, offset, estimated=estimated, mount=mount, truth=truth,
        from_ground=np.array([False, True, True, True, True]),
    )  # fmt: skip
    assert some.on_ground.tolist() == [False, True]


def test_the_surface_in_a_footprint():
    """Ground, its edge, a stone in the ring, nothing; and beams that graze."""
    none = Rigid(R=np.eye(3), shift_m=np.zeros(3))
    truth = truth_over(
        (sheet([0, 0, 0], [10, 0, 0], [0, 10, 0]), Material.SOIL),
        (sheet([5, 0, 0.2], [0.4, 0, 0], [0, 0.4, 0]), Material.STONE),
        boat=None,
        mount=none,
        divergence=0.02,
    )
    origin = np.array([[0.0, 0, 10], [9.99, 0, 10], [5.46, 0, 10], [30, 0, 10], [0, 0, 10]])
    way = np.tile([0.0, 0, -1], (5, 1))
    centre, normal, hit, ground = of_points._surface_in_footprint(origin, way, truth)
    assert hit.tolist() == [True, True, True, False, True]
    # rays of the ring 7 cm aside: of the second some miss, of the third some meet the stone
    assert ground.tolist() == [True, False, False, False, True]
    np.testing.assert_allclose(centre[[0, 1]], [[0, 0, 0], [9.99, 0, 0]], atol=1e-5)
    np.testing.assert_allclose(normal[[0, 1]], [UP, UP], atol=1e-6)
    # the mean of seven heights, two of them 20 cm high
    high = np.sum(5.46 + 0.0707 * np.cos(np.pi / 3 * np.arange(6)) < 5.4)
    assert abs(centre[2, 2] - 0.2 * high / 7) < 0.2 / 7 + 1e-3
    for cosine, taken in ((0.21, True), (0.19, False)):
        level = np.array([[np.sqrt(1 - cosine**2), 0.0, -cosine]])
        start = np.array([[-level[0, 0] * 5, 0.0, cosine * 5]])
        boat = Still(start[0], np.eye(3), [True])
        truth = truth_over((sheet([0, 0, 0], [40, 0, 0], [0, 40, 0]), Material.SOIL), boat=boat, mount=none)
        found = of_points.point_errors(
            start + 5 * level,
            np.zeros(1),
            np.eye(3)[None],
            np.zeros(1),
            estimated=boat,
            mount=none,
            truth=truth,
        )
        assert found.on_ground.tolist() == [taken]


def test_returns_in_the_order_of_time():
    shots = pd.DataFrame(
        {
            "t_gps_s": [3.0, 1.0, 1.0], "return_number": [1, 2, 1], "kind": [0, 1, 2], "material": [7, 8, 9],
            "east_m": [1.0, 2, 3], "north_m": [4.0, 5, 6], "up_m": [7.0, 8, 9],
        }
    )  # fmt: skip
    found = of_points.TrueReturns.from_table(shots, {0: "a"})
    assert found.t_gps_s.tolist() == [1, 1, 3]
    assert (found.return_number.tolist(), found.kind.tolist()) == ([1, 2, 1], [2, 1, 0])
    assert (found.material.tolist(), found.point_wcs_m[0].tolist()) == ([9, 8, 7], [3, 6, 9])


def test_bed_points_by_line():
    """Two lines over a level bed at -2 m; one point beside it."""
    corners = np.array([[-9.0, -9, -2], [9, -9, -2], [9, 9, -2], [-9, 9, -2]])
    bed = TriangleMesh(vertices_m=corners, faces=np.array([[0, 1, 2], [0, 2, 3]]), sigma_m=np.zeros(4))
    d = np.array([0.03, 0.01, -0.02, -0.04, -0.06])
    points = pd.DataFrame(
        {
            "file": ["a", "a", "b", "b", "b", "b"], "east_m": [0.0, 1, 0, 1, 2, 50], "north_m": 1.0,
            "up_m": [*(d - 2.0), 0.0], "cov_uu_m2": [1e-4, 4e-4, 1e-4, 4e-4, 1e-4, 9.0],
            "sigma_line_m": [0.001, 0.002, 0.003, 0.004, 0.005, 9.0],
        }
    )  # fmt: skip
    table, lines = of_points.compare_bed(points, bed)
    sigma = np.array([0.01, 0.02, 0.01, 0.02, 0.01])
    within = np.array([0.01, -0.01, 0.02, 0.0, -0.02])
    expected = {
        "points": 6, "off_bed": 1, "lines": 2, "mean_m": d.mean(), "std_m": d.std(ddof=1),
        "rms_m": np.sqrt(np.mean(d**2)), "predicted_sigma_m": np.sqrt(np.mean(sigma**2)),
        "ratio": np.sqrt(np.mean((d / sigma) ** 2)), "std_within_lines_m": within.std(ddof=1),
        "sigma_line_m": 0.003,
    }  # fmt: skip
    assert table.iloc[0].to_dict() == pytest.approx(expected, abs=1e-6)
    assert lines[["file", "n"]].values.tolist() == [["a", 2], ["b", 3]]
    assert lines["mean_m"].tolist() == pytest.approx([0.02, -0.04], abs=1e-6)
    assert lines["std_m"].tolist() == pytest.approx([np.sqrt(2e-4), 0.02], abs=1e-6)
    with pytest.raises(CoverageError, match="1 of 2 points lie over the true bed"):
        of_points.compare_bed(points[4:], bed)
    assert len(of_points.compare_bed(points[:2], bed)[1]) == 1
