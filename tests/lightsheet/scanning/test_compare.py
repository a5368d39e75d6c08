"""A scan beside planes and meshes: what is compared, what is left out, and the tables (P4 Table 3)."""

from dataclasses import replace

import numpy as np
import pytest

from thalweg.core import GeometryError, InputError
from thalweg.lightsheet.scanning import compare, merge
from thalweg.lightsheet.scanning.distances import TABLE_3
from thalweg.lightsheet.scanning.levels import STEP_HEIGHTS_MM
from thalweg.surface import Surface
from thalweg_lab.tank import stepped_object
from thalweg_lab.tank.series import picked_pairs, reference_mesh

LINES = 7


@pytest.fixture(scope="module")
def scan(simulated, exact):
    return simulated(exact, stepped_object(), 4, lines=LINES, step_mm=6.0, beams=140)


@pytest.fixture(scope="module")
def mesh():
    return reference_mesh(stepped_object(), 1, resolution_mm=2.5, without=(1,))


@pytest.fixture(scope="module")
def surface(mesh):
    return Surface(mesh)


@pytest.fixture(scope="module")
def pairs(scan, mesh):
    table = picked_pairs(mesh, scan.tripod, 4, "test").to_numpy()
    return table[:, :3], table[:, 3:]


@pytest.fixture(scope="module")
def found(scan, surface, pairs):
    return compare.compare_with_levels(scan.cloud, surface, STEP_HEIGHTS_MM, pairs)


def test_points_lie_on_the_planes_as_predicted(found):
    facts = found.facts
    d = found.distances.distance_mm[found.used]
    nmad = 1.4826 * np.median(np.abs(d - np.median(d)))
    # 0.15 px and 6-DOF poses; points at the rounded rims of a level are no part of the centre
    assert nmad < 1.5 * facts["consistency"]["predicted_mm"]
    for row in facts["levels"]:
        # 40 independent poses would give 0.01; seven lines share what is left of theirs
        assert row["measured_mm"] == pytest.approx(row["height_mm"], abs=0.1)
        assert row["n"] > 50
    counts = facts["counts"]
    assert counts["far"] + counts["at_border"] + counts["used"] == counts["points"] == len(found.cloud)
    assert facts["images_with_bad_pose"] == []


def test_the_ground_beside_the_object_is_no_level(scan, surface, pairs, found):
    """It lies 4.9 mm below the lowest level: nearer than the next level, farther than a layer."""
    true = scan.T_obj_ccs.apply(scan.cloud.xyz_m)
    low = (np.abs(true[:, 2]) < 0.002) & (true[:, 0] < -0.06)
    down = scan.tripod.R_ccs_obj @ np.array([0.0, 0.0, -4.9e-3])
    sunk = replace(scan.cloud, xyz_m=scan.cloud.xyz_m + low[:, None] * down)
    with_ground = compare.compare_with_levels(sunk, surface, STEP_HEIGHTS_MM, pairs)
    assert low.sum() > 20
    assert with_ground.distances.far[low].all()
    assert with_ground.used.sum() == pytest.approx((found.used & ~low).sum(), abs=5)


def test_a_bad_pose_is_found_on_planes_too(scan, surface, pairs):
    errors = np.zeros((LINES, 6))
    errors[3, :3] = scan.tripod.R_ccs_obj @ [0.0, 0.0, 0.9e-3]
    cloud = merge(scan.profiles, scan.poses.disturbed(errors))
    found = compare.compare_with_levels(cloud, surface, STEP_HEIGHTS_MM, pairs)
    assert found.facts["images_with_bad_pose"] == ["sheet_003.png"]
    assert found.facts["counts"]["on_bad_lines"] == int((found.distances.used & found.check.bad).sum()) > 0
    table = compare.distance_table(found)
    assert set(table["reason"][table["file"] == "sheet_003.png"]) <= {"bad_pose", "far"}
    assert (table["used"] == (table["reason"] == "")).all()


def test_other_heights_are_refused(scan, surface, pairs):
    with pytest.raises(GeometryError, match="growing numbers"):
        compare.compare_with_levels(scan.cloud, surface, (40.135, 20.195, 0.006), pairs)
    # equal errors of all steps are a tilt, and each level then leaves a ramp
    with pytest.raises(GeometryError, match=r"off planes at 0, 25, 50 mm.*levels_mm"):
        compare.compare_with_levels(scan.cloud, surface, (0.0, 25.0, 50.0), pairs)
    # a level that is not there takes no points: the others stand, and the result says so
    other = compare.compare_with_levels(scan.cloud, surface, (0.0, 10.0, 40.0), pairs)
    empty, beside = other.facts["warnings"]
    assert "hardly a point lies on the level at 10 mm" in empty
    assert "points on the object lie on none of its levels" in beside
    right = compare.compare_with_levels(scan.cloud, surface, STEP_HEIGHTS_MM, pairs)
    assert right.facts["warnings"] == []


def test_tables_hold_all_rules_and_the_published_row(found):
    table = compare.statistics(found, "stepped")
    assert table["points"].unique().tolist() == ["all lines", "without bad poses", "published"]
    assert (table["n_kept"] <= table["n"]).all()
    published = table[table["points"] == "published"].iloc[0]
    known = TABLE_3[TABLE_3["object"] == "stepped_object"].iloc[0]
    assert published["n"] == known["n"]
    assert published["share_kept"] == pytest.approx(known["n_kept"] / known["n"])
    assert "published" not in set(compare.statistics(found, "anchor")["points"])


def test_distances_are_a_table_of_all_points(found, scan):
    table = compare.distance_table(found)
    assert len(table) == len(scan.cloud)
    assert table["used"].sum() == found.used.sum()
    assert set(table["reason"]) <= {"", "far", "at_border", "bad_pose"}
    assert (table["sigma_mm"] >= np.hypot(table["sigma_own_mm"], table["sigma_pose_mm"]) - 1e-6).all()


def test_the_motion_comes_back_from_facts(found, scan):
    T = compare.to_reference(found.facts)
    np.testing.assert_allclose(T.apply(scan.cloud.xyz_m), found.cloud.xyz_m, rtol=0, atol=1e-12)


def test_pairs_are_read_and_mistakes_named(tmp_path):
    path = tmp_path / "pairs.csv"
    path.write_text(",".join(compare.PAIR_COLUMNS) + "\n1,2,3,4,5,6\n7,8,9,1,2,3\n")
    scan_m, mesh_m = compare.read_pairs(path)
    assert scan_m.tolist() == [[1, 2, 3], [7, 8, 9]]
    assert mesh_m.tolist() == [[4, 5, 6], [1, 2, 3]]
    path.write_text("scan_x_m,scan_y_m\n1,2\n")
    with pytest.raises(InputError, match="columns missing: scan_z_m, mesh_x_m"):
        compare.read_pairs(path)
