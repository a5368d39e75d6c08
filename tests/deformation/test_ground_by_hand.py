"""Motions on drawn ground, poses of moments, and registered distances, against formulas written out."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from pyproj import CRS
from scipy.stats import norm, t as student

from thalweg.core import CoverageError, Dsm, InputError, LocalFrame
from thalweg.deformation import changes, drawn_ground as ground, epochs
from thalweg.deformation.core_points import _along, _areas, _cells, _sight
from thalweg.deformation.coregistration import PARAMETERS, Network, Registration
from thalweg.deformation.field import COMMON, ErrorField, ErrorGroup
from thalweg.deformation.foreign import clouds, differences
from thalweg.deformation.foreign.epochs import STATED, UNKNOWN, _errors, _grid_of, notes_of_pair
from thalweg.settings.sections import Deformation, Epoch as Statement

UP = np.array([0.0, 0.0, 1.0])


def an_epoch(name="a", *, boat=False, raster=False, known=True, groups=(), heights="ellipsoidal", start=0.0):
    return SimpleNamespace(
        name=name, has_trajectory=boat, is_raster=raster, sigma_known=known, groups=groups, heights=heights,
        start_gps_s=start,
    )  # fmt: skip


def group(name, sigmas, rows=None, time_s=np.inf):
    """One error of all moments, or the field of one."""
    made = ErrorGroup.from_sigmas(name, np.zeros(1), np.array(sigmas, float), time_s)
    return made if rows is None else ErrorField((made,), (sp.csr_matrix(rows),))


# ---------------------------------------------------------------- drawn ground


@pytest.mark.parametrize(
    ("rasters", "asked", "kind"),
    [
        ((0, 0), None, "shift+heading"),
        ((0, 0), "rigid", "rigid"),
        ((1, 1), None, "height"),
        ((1, 1), "rigid", "height"),
        ((1, 0), None, "height"),
        ((1, 0), "shift", "shift"),
        ((1, 1), "none", "none"),
    ],
)
def test_rasters_alone_show_the_height_alone(rasters, asked, kind):
    made = [an_epoch(raster=bool(r)) for r in rasters]
    assert ground.motion_kind(made, Deformation(registration=asked)) == kind


def cores_of(places, normals=None):
    n = np.tile(UP, (len(places), 1)) if normals is None else normals
    columns = {f"{a}_m": places[:, i] for i, a in enumerate(("east", "north", "up"))}
    return pd.DataFrame(columns | {f"normal_{a}": n[:, i] for i, a in enumerate(("east", "north", "up"))})


def test_what_most_agrees_on_is_an_error_of_all_heights():
    """Of two epochs 20 cm apart: half of it each, the scatter of the places, and what is stated of one."""
    rng = np.random.default_rng(3)
    places = np.column_stack([rng.uniform(-9, 9, (40, 2)), np.zeros(40)])
    noise = 0.01 * rng.standard_normal(40)
    along = np.stack([np.zeros(40), 0.2 + noise])
    along[1, :3] = np.nan
    bare = np.arange(40) != 5
    stated = group("stated", [0.03, 0.04, 0.05])
    made = [an_epoch(raster=True, groups=(stated, stated)), an_epoch("b", raster=True, boat=True)]
    found = ground.moved_apart(cores_of(places), made, Deformation(), along, bare)
    seen = np.isfinite(along[1]) & bare
    facts = found.facts
    assert not found.parameters.any()
    assert not found.stable.any()
    assert (facts["model"], facts["areas"], facts["sigma"], facts["whole_stated"]) == (
        "none", "none are drawn", "stated", False,
    )  # fmt: skip
    guess = facts["would_be"][1]["up_m"]
    assert guess == pytest.approx(0.1, abs=0.003)
    assert facts["would_be"][0]["up_m"] == pytest.approx(-guess)
    # half of what a place lies off, times the root of two for both epochs
    scatter = 1.4826 * np.median(np.abs((0.2 + noise[seen]) / 2 - guess)) * np.sqrt(2.0)
    variance = [guess**2 + scatter**2 + 2 * 0.05**2, guess**2 + scatter**2]
    assert np.diag(found.cov)[[2, 8]] == pytest.approx(variance, rel=1e-6)
    assert found.cov[2, 8] == pytest.approx(-(guess**2))
    assert facts["sigma_as_a_whole_m"][0] == pytest.approx([0, 0, np.sqrt(variance[0])])
    whole = [replace_group(made[0], COMMON), made[1]]
    assert not ground.moved_apart(cores_of(places), whole, Deformation(), along, bare).cov.any()
    # fewer than ten places tell nothing
    few = np.where(np.arange(40) < 9, along, np.nan)
    assert ground.moved_apart(cores_of(places), made, Deformation(), few, bare).facts["would_be"][1][
        "up_m"
    ] == pytest.approx(0.0)
    none = ground.moved_apart(cores_of(places), made, Deformation(registration="none"), along, bare)
    assert none.facts == {"model": "none", "sigma": "stated"}
    assert none.stable.sum() == seen.sum()
    made[1].sigma_known = False
    assert ground.moved_apart(cores_of(places), made, Deformation(), along, bare).facts["sigma"] == "unknown"


def replace_group(epoch, name):
    return an_epoch(raster=epoch.is_raster, groups=(group(name, [0, 0, 0.01]),))


def test_places_off_the_others_of_their_area_are_drawn_in():
    """To three robust sigmas about the median of their area and epoch; unseen ones stay."""
    along = np.array([[0.0] * 8, [0.02, 0.04, 0.06, 0.08, 2.0, 1.0, 1.0, 9.0]])
    seen = np.ones((2, 8), bool)
    seen[1, 7] = seen[0, 7] = False
    area = np.array([0, 0, 0, 0, 0, 1, 1, 1])
    found = ground._drawn_in(along, seen, area)
    off = np.array([0.02, 0.04, 0.06, 0.08, 2.0]) / 2
    limit = 0.03 + 3 * 1.4826 * np.median(np.abs(off - 0.03))
    expected = along.copy()
    expected[1, 4] -= 1.0 - limit
    expected[0, 4] += 1.0 - limit
    np.testing.assert_allclose(found, expected)
    level = ground._off_level(along, seen)
    np.testing.assert_allclose(level[:, :2], [[-0.01, -0.02], [0.01, 0.02]])
    assert np.isnan(level[:, 7]).all()


def test_the_jackknife_over_areas_by_hand():
    """Heights of four areas with 1, 2, 3 and 4 places: means without each of them, widened for t of 3."""
    area = np.repeat([5, 6, 8, 9], [1, 2, 3, 4])
    heights = np.array([0.1, 0.2, 0.3, 0.0, 0.1, -0.1, 0.4, 0.5, 0.3, 0.4])
    along = np.stack([-heights / 2, heights / 2])
    H, seen = np.ones((10, 1)), np.ones((2, 10), bool)
    found = ground._between_areas(
        H, along, seen, area, np.array([[-heights.mean() / 2], [heights.mean() / 2]])
    )
    off = np.array([heights[area != a].mean() - heights.mean() for a in (5, 6, 8, 9)]) / 2
    wide = student.ppf(0.975, 3) / norm.ppf(0.975)
    expected = wide**2 * 3 / 4 * np.sum(off**2)
    np.testing.assert_allclose(found, expected * np.array([[1, -1], [-1, 1]]), rtol=1e-9)
    # of two areas for one parameter nothing is known, nor where one area alone has an epoch
    assert ground._between_areas(H, along, seen, np.minimum(area, 6), np.zeros((2, 1))) is None
    assert ground._between_areas(H, along, seen, np.minimum(area, 8), np.zeros((2, 1))) is not None
    alone = seen.copy()
    alone[1] = area == 9
    assert ground._between_areas(H, along, alone, area, np.zeros((2, 1))) is None


def test_small_places_are_means_of_cells_as_wide_as_points_lie_apart(monkeypatch):
    sparse = np.column_stack([np.arange(0.0, 8.0, 2.0) + 0.5, np.zeros(4), np.arange(4.0) / 9])
    dense = np.array([[0.1, 0.1, 0.0], [0.6, 0.1, 0.3]])
    places, radius = ground._places([sparse, dense], 1.0)
    assert radius == pytest.approx(2.0 / np.sqrt(2.0))
    np.testing.assert_allclose(
        places, [[0.4, 0.2 / 3, 0.1], [2.5, 0, 1 / 9], [4.5, 0, 2 / 9], [6.5, 0, 3 / 9]]
    )
    assert ground._places([sparse, dense[:1]], 3.0)[1] == pytest.approx(3.0 / np.sqrt(2.0))
    monkeypatch.setattr(ground, "_MOST", 2)
    places, radius = ground._places([sparse], 2.0)
    # 2 m, 2.8 and 3.92 m: two cells
    assert (len(places), radius) == (2, pytest.approx(2.0 * 1.4**2 / np.sqrt(2.0)))


def test_areas_that_touch_are_one():
    squares = [[(x, 0), (x + 1, 0), (x + 1, 1), (x, 1)] for x in (0, 1, 3)]
    areas = ground._apart(squares)
    assert sorted(area.area for area in areas) == [1.0, 2.0]
    xyz = np.array([[0.5, 0.5, 9.0], [1.5, 0.5, 0], [2.5, 0.5, 0], [3.5, 0.5, 0], [3.5, 1.5, 0]])
    assert ground._within(areas, xyz).tolist() == [True, True, False, True, False]


def test_the_length_over_which_residuals_are_alike():
    """Pairs of one area: a mean correlation of 0.2 at 2 m is one of exp(-2 / L)."""
    plan = np.array([[0.0, 0], [2.0, 0], [50.0, 0], [50.0, 2.0], [90.0, 0]])
    area = np.array([0, 0, 1, 1, 2])
    a, b = 1.0, 5.0 - np.sqrt(24.0)  # of unit variance, a b / ((a^2 + b^2) / 2) = 1/5
    rest = np.array([[a, b, -a, -b, np.nan]])
    assert ground._alike_over_m(rest, plan, area) == pytest.approx(2.0 / np.log(5.0), rel=1e-6)
    # opposed, or fully alike: a third of the shortest distance, or the longest
    plan[3, 1] = 6.0
    assert ground._alike_over_m(np.array([[a, -a, a, -a, np.nan]]), plan, area) == pytest.approx(2.0 / 3)
    assert ground._alike_over_m(np.array([[a, a, a, a, np.nan]]), plan, area) == 6.0
    assert ground._alike_over_m(rest[:, :1], plan[:1], area[:1]) == 0.0
    # one far off counts as three robust sigmas
    far = np.array([[1.0, -1.0, 1.0, 100.0, np.nan]])
    limit = 3 * 1.4826
    wanted = (limit - 1) / 2 / ((3 + limit**2) / 4)
    plan[3, 1] = 2.0
    assert ground._alike_over_m(far, plan, area) == pytest.approx(-2.0 / np.log(wanted), rel=1e-6)


def test_a_motion_that_is_known_apart_is_one_error_of_all_distances():
    rng = np.random.default_rng(4)
    root = rng.normal(0, 0.01, (6, 6))
    cov, design = root @ root.T, rng.normal(0, 1, (3, 6))
    own = group("position", [0.1, 0.2, 0.3], rng.normal(0, 1, (3, 3)))
    found = ground.with_motion(own, design, cov)
    assert found.groups[-1].name == ground.REGISTRATION
    assert found.variances() == pytest.approx(own.variances() + np.diag(design @ cov @ design.T))
    mean = np.full((1, 3), 1 / 3)
    row = design.mean(axis=0)
    added = found.combined(mean).variances() - own.combined(mean).variances()
    assert added == pytest.approx([row @ cov @ row])


def test_the_motion_between_two_has_both_covariances_and_their_cross_terms():
    rng = np.random.default_rng(5)
    root = rng.normal(0, 0.01, (12, 12))
    cov = root @ root.T
    parameters = rng.normal(0, 1, (2, 6))
    would = [dict(zip(PARAMETERS, row, strict=True)) for row in parameters.tolist()]
    facts = {"model": "none", "would_be": would, "sigma_as_a_whole_m": [[1.0] * 3] * 2}
    found, apart, told = ground.between_two(ground.Motions(parameters, cov, np.ones(1, bool), facts))
    A, B, X = cov[:6, :6], cov[6:, 6:], cov[:6, 6:]
    np.testing.assert_allclose(found, parameters[1] - parameters[0])
    np.testing.assert_allclose(apart, A + B - X - X.T)
    assert list(told["would_be"].values()) == pytest.approx(parameters[1] - parameters[0])
    assert told["sigma_as_a_whole_m"] == pytest.approx(np.sqrt(np.diag(A + B - X - X.T))[:3])
    assert facts["would_be"] is would
    plain = ground.between_two(ground.Motions(parameters, cov, np.ones(1, bool), {"model": "none"}))
    assert plain[2] == {"model": "none"}
    facts = {"model": "height", "resolution": [[1.0]]}
    told = ground.between_two(ground.Motions(parameters, cov, np.ones(1, bool), facts))[2]
    assert told["parameters"]["up_m"] == pytest.approx(parameters[1, 2] - parameters[0, 2])
    assert told["sigmas"]["up_m"] == pytest.approx(np.sqrt((A + B - X - X.T)[2, 2]))


def test_a_field_on_drawn_ground_has_no_common_error_and_what_the_ground_shows():
    places, normals = np.array([[0.0, 0, 0], [320.0, 0, 0]]), np.tile(UP, (2, 1))
    both = ErrorField(
        (group(COMMON, [0, 0, 0.5]), group("position", [0, 0, 0.1])),
        (sp.csr_matrix(normals), sp.csr_matrix(normals)),
    )
    drawn = {"areas": "drawn"}
    assert ground.field_with(both, places, normals, drawn, 1).variances() == pytest.approx([0.01] * 2)
    assert ground.field_with(both, places, normals, {}, 1).variances() == pytest.approx([0.26] * 2)
    for length, groups in ((0.0, 1), (4.0, 2)):
        facts = drawn | {"estimated": {"sigma_m": 0.2, "correlation_m": length}}
        found = ground.field_with(both, places, normals, facts, 2)
        assert len(found.groups) == groups
    assert found.variances() == pytest.approx([0.01 + 2 * 0.04] * 2)
    # cells are no finer than for a thirty-second of the extent, but errors are alike over their length
    assert (found.groups[1].correlation_m, found.groups[1].cell_m) == (4.0, pytest.approx(320 / 32 / 8))


# ---------------------------------------------------------------- moments of an epoch


def test_errors_between_nodes_of_a_chain_are_linear():
    found = epochs._interpolation(np.array([-1.0, 0.0, 0.5, 3.0, 9.0]), np.array([0.0, 1.0, 5.0])).toarray()
    shares = np.array([[1, 0, 0], [1, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0.5], [0, 0, 1]])
    np.testing.assert_allclose(found, np.kron(shares, np.eye(6)))


def test_covariances_at_an_arm_turned_and_split():
    rng = np.random.default_rng(6)
    root = rng.normal(0, 1, (2, 6, 6))
    cov = root @ np.swapaxes(root, 1, 2)
    arm = rng.normal(0, 3, (2, 3))
    cross = np.array([[[0, -z, y], [z, 0, -x], [-y, x, 0]] for x, y, z in arm])
    # a small rotation w moves the end of an arm by w x arm
    J = np.concatenate([np.tile(np.eye(3), (2, 1, 1)), -cross], axis=2)
    np.testing.assert_allclose(epochs._at_arm(cov, arm), J @ cov @ np.swapaxes(J, 1, 2))
    R = np.linalg.qr(rng.normal(0, 1, (2, 3, 3)))[0]
    big = np.array([np.kron(np.eye(2), each) for each in R])
    np.testing.assert_allclose(epochs._turned(R, cov), big @ cov @ np.swapaxes(big, 1, 2))
    rest, rotation, lever = epochs._split(cov)
    A, C = cov[:, 3:, 3:], cov[:, :3, 3:]
    np.testing.assert_allclose(lever, C @ np.linalg.inv(A))
    np.testing.assert_allclose(rest, cov[:, :3, :3] - C @ np.linalg.inv(A) @ np.swapaxes(C, 1, 2))
    np.testing.assert_array_equal(rotation, A)


def test_one_local_frame_in_another():
    own, common = (
        LocalFrame(lat_deg=51, lon_deg=13, h_ell_m=5),
        LocalFrame(lat_deg=51.2, lon_deg=13.1, h_ell_m=9),
    )
    turn, shift = epochs.between_frames(own, common)
    xyz = np.array([[10.0, -20, 3], [4, 5, 6]])
    np.testing.assert_allclose(
        xyz @ turn.T + shift, common.from_ecef(own.origin_ecef_m + xyz @ own.R_ecef_enu.T), atol=1e-6
    )
    assert not epochs.between_frames(own, own)[1].any()


def test_epochs_come_in_the_order_of_time_with_one_system_of_heights():
    a, b = an_epoch(start=0.0), an_epoch("b", start=1.5 * 86_400)
    epochs.check_order([a, b])
    with pytest.raises(InputError, match=r"'a' was surveyed 1\.5 days before 'b'.*Change their order"):
        epochs.check_order([b, a])
    with pytest.raises(InputError, match=r"'b' was surveyed at the same time as 'b'.*copy of the other"):
        epochs.check_order([a, b, b])
    with pytest.raises(InputError, match="'a' has heights 'ellipsoidal', 'c' 'NHN'"):
        epochs.check_order([a, an_epoch("c", heights="NHN", start=9.0)])
    water = [SimpleNamespace(water_m=np.array(w)) for w in ([1.0, 3.0], [], [2.0])]
    assert epochs.highest_water_m(water) == 3.0
    assert np.isnan(epochs.highest_water_m(water[1:2]))


# ---------------------------------------------------------------- registered distances


def pair_of(rng, k=6):
    cores = np.column_stack([rng.uniform(-9, 9, (k, 3))])
    normals = rng.normal(0, 1, (k, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    fields = [group("position", [0.02, 0.03, 0.04], rng.normal(0, 1, (k, 3))) for _ in range(2)]
    distance = rng.normal(0, 0.1, k)
    distance[3] = np.nan
    white = rng.uniform(0.01, 0.03, k)
    white[3] = np.nan
    n = np.full((k, 2), 9)
    n[3] = 0
    found = changes.Distances(cores, normals, np.ones(k), n, distance, white)
    return changes.Pair(
        cores=cores_of(cores, normals).assign(scale_m=1.0),
        epochs=(an_epoch(boat=True), an_epoch("b", boat=True)),
        found=found,
        field=changes.difference_of(*fields, common_mounts=False),
        white_m=white,
        scatter_m=np.full((k, 2), 0.01),
        several=np.zeros((k, 2)),
    )


def shared_of(pair):
    """Covariance (k, k) of the shared errors of its distances, from dense matrices."""
    total = 0.0
    for made, rows in zip(pair.field.groups, pair.field.rows, strict=True):
        full = np.einsum("iax,jbx->iajb", made.root, made.root).reshape([made.root.shape[0] * 3] * 2)
        total = total + rows.toarray() @ full @ rows.toarray().T
    return total


def test_variances_of_registered_distances_with_what_the_registration_takes_off():
    rng = np.random.default_rng(7)
    pair = pair_of(rng)
    design, S = rng.normal(0, 1, (6, 6)), rng.normal(0, 0.1, (6, 6))
    S[:, 3] = 0.0
    moved = Registration(rng.normal(0, 0.1, 6), np.eye(6), design, S, np.ones(6, bool), {})
    found = changes.registered_distances(pair, moved)
    left = np.eye(6) - design @ S
    shared, white = shared_of(pair), np.nan_to_num(pair.white_m) ** 2
    np.testing.assert_allclose(found.distance_m, pair.found.distance_m - design @ moved.parameters)
    np.testing.assert_allclose(found.sigma_field_m**2, np.diag(left @ shared @ left.T))
    noise = np.diag(left @ np.diag(white) @ left.T)
    np.testing.assert_allclose(found.sigma_registration_m**2, np.maximum(noise - white, 0.0), atol=1e-12)
    total = found.sigma_field_m**2 + pair.white_m**2 + found.sigma_registration_m**2
    np.testing.assert_allclose(found.sigma_m, np.sqrt(total))
    assert np.isnan(found.sigma_m[3])
    P = rng.normal(0, 1, (2, 6))
    by_field, by_noise = found.variances(P)
    np.testing.assert_allclose(by_field, np.diag(P @ left @ shared @ left.T @ P.T))
    np.testing.assert_allclose(by_noise, np.diag(P @ left @ np.diag(white) @ left.T @ P.T))


def test_variances_of_distances_whose_motion_is_known_apart():
    rng = np.random.default_rng(8)
    pair = pair_of(rng)
    root = rng.normal(0, 0.05, (6, 6))
    design = rng.normal(0, 1, (6, 6))
    facts = {"estimated": {"sigma_m": 0.05, "correlation_m": 1000.0}}
    moved = Registration(np.zeros(6), root @ root.T, design, np.zeros((6, 6)), np.ones(6, bool), facts)
    found = changes.registered_distances(pair, moved)
    own = np.sum(pair.found.normals**2, axis=1) * 2 * 0.05**2
    np.testing.assert_allclose(found.sigma_field_m**2, np.diag(shared_of(pair)) + own)
    apart = np.diag(design @ root @ root.T @ design.T)
    np.testing.assert_allclose(found.sigma_registration_m**2, apart)
    one = np.eye(6)[:1]
    np.testing.assert_allclose(found.variances(one)[0], found.sigma_field_m[:1] ** 2 + apart[:1])
    nothing = replace(moved, cov=np.zeros((6, 6)), facts={})
    assert changes.registered_distances(pair, nothing).pair.field is not None
    assert len(changes.registered_distances(pair, nothing).pair.field.groups) == len(pair.field.groups)


def test_bare_ground_and_noise_of_means():
    scatter = np.array([[0.01, 0.02], [0.02, 0.01], [0.041, 0.0], [0.04, 0.01], [np.nan, 0.01]])
    assert changes.is_bare(scatter).tolist() == [True, True, True, True, False]
    assert changes.is_bare(scatter[[0, 1, 1, 2, 3]]).tolist() == [True, True, True, False, True]
    assert changes.is_bare(np.array([[0.01, 0.01], [0.01, 0.021], [0.01, 0.0]])).tolist() == [
        True,
        False,
        True,
    ]
    cut = SimpleNamespace(std_m=np.array([0.2, 0.2, np.nan]), n=np.array([4, 100, 0]))
    own = np.array([0.05, 0.05, np.nan])
    found = changes.Measured(epoch=None, cut=cut, field=None, own_m=own, several=None).white_m
    np.testing.assert_allclose(found, [0.1, 0.05, np.nan])


def test_a_series_from_motions_that_are_known_apart(monkeypatch):
    """Two epochs of files, a year apart: heights without their motions, sigmas with those of the ground."""
    rng = np.random.default_rng(9)
    pair = pair_of(rng)
    k, places, normals = 6, pair.found.cores_m, pair.found.normals
    fields = [group("stated", [0.02, 0.03, 0.04], rng.normal(0, 1, (k, 3))) for _ in range(2)]
    along = rng.normal(0, 0.1, (2, k))
    std, n = np.full(k, 0.03), np.full(k, 9)
    n[2] = 3
    made = [
        changes.Measured(
            epoch=an_epoch(name, start=i * changes.YEAR_S),
            cut=SimpleNamespace(along_m=along[i], std_m=std, n=n, scale_m=None),
            field=fields[i],
            own_m=np.zeros(k),
            several=np.zeros(k),
        )
        for i, name in enumerate("ab")
    ]
    for each in made:
        each.epoch.water_m = np.array([0.25])
    parameters = rng.normal(0, 0.1, (2, 6))
    root = rng.normal(0, 0.01, (12, 12))
    facts = {"model": "rigid"}
    motions = ground.Motions(parameters, root @ root.T, np.ones(k, bool), facts)
    monkeypatch.setattr(changes, "measure_epoch", lambda cores, epoch, settings: made["ab".index(epoch.name)])
    monkeypatch.setattr(changes, "moved_apart", lambda *words: motions)
    monkeypatch.setattr(changes, "_pair", lambda cores, one, two, settings: pair)
    monkeypatch.setattr(
        changes, "register_pair", lambda pair, settings: SimpleNamespace(registered=lambda d: 2 * d)
    )
    products = rng.normal(0, 1, (1, k))
    lines = []
    monkeypatch.setattr(changes, "lines_of_bank", lambda *words: lines.append(words) or ("rows", products))
    settings = Deformation(least_in_cylinder=4)
    found = changes.series_of_epochs(pair.cores, [each.epoch for each in made], settings)
    along[:, 2] = np.nan
    H = np.column_stack([normals, np.cross(places - places.mean(axis=0), normals)])
    height = along - parameters @ H.T
    np.testing.assert_allclose(found.height_m, height - height[0], atol=1e-12)
    np.testing.assert_allclose(found.raw_m, along - along[0])
    np.testing.assert_allclose(np.diff(found.years), [1.0])
    np.testing.assert_allclose(found.line_m, np.nan_to_num(height - height[0]) @ products.T)
    known = np.isfinite(pair.found.distance_m)
    row = np.where(known, 1 / 5, 0.0)
    np.testing.assert_allclose(found.sigma_apart_m, [np.sqrt(row @ shared_of(pair) @ row)])
    cov = (root @ root.T).reshape(2, 6, 2, 6)
    for e in range(2):
        G = np.diag([0.02, 0.03, 0.04]) ** 2
        J = fields[e].rows[0].toarray()
        whole = J @ G @ J.T + np.diag(std**2 / n) + H @ cov[e, :, e] @ H.T
        np.testing.assert_allclose(found.sigma_m[e], np.sqrt(np.diag(whole)))
        sums = np.sqrt(np.diag(products @ whole @ products.T))
        np.testing.assert_allclose(found.line_sigma_m[e], sums)
    assert list(facts["parameters"][1].values()) == pytest.approx(parameters[1])
    sigma = np.sqrt(np.diag(root @ root.T))[6:]
    assert list(facts["sigmas"][1].values()) == pytest.approx(sigma)
    ((_, bare, _, height_m),) = lines
    assert bare.tolist() == [True, True, False, True, True, True]
    assert height_m == 0.75
    assert found.misclosure.largest_m == 0.0
    assert isinstance(found.network, Network)


# ---------------------------------------------------------------- core points


def test_cells_of_points_and_the_area_that_they_share():
    xyz = np.array([[0.1, 0.1, -0.1], [0.3, 0.5, -0.3], [0.2, 0.2, 0.4], [-1.2, 0.2, 0.2], [-1.4, 0.4, 0.4]])
    cells, mean, n = _cells(xyz, 0.5)
    assert cells.tolist() == [[-3, 0, 0], [0, 0, -1], [0, 0, 0], [0, 1, -1]]
    np.testing.assert_allclose(mean, [[-1.3, 0.3, 0.3], [0.1, 0.1, -0.1], [0.2, 0.2, 0.4], [0.3, 0.5, -0.3]])
    assert n.tolist() == [2, 1, 1, 1]
    normals = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, -1.0], [0.0, 0.6, 0.8], [0.0, 0.8, 0.6]])
    found = _areas(cells, np.array([2, 1, 3, 1]), normals, 0.5)
    # the second and third share their column by their points, the last one with the second, along north
    np.testing.assert_allclose(found, [0.25 / 0.8, 0.25 / 4, 0.25 / 0.8 * 3 / 4, 0.25 / 0.8 / 2])
    # two apart in one column are two surfaces; along the other axes alike
    for axis in range(3):
        two = np.zeros((3, 3), int)
        two[:, axis] = [0, 1, 3]
        one = np.zeros((3, 3))
        one[:, axis] = 1.0
        np.testing.assert_allclose(_areas(two, np.array([1, 3, 5]), one, 2.0), [1.0, 3.0, 4.0])


def test_along_the_bank_to_the_right_when_looking_from_the_river():
    """The river in the south: normals point there, and east is to the right."""
    x = np.linspace(-5, 5, 11)
    cores = np.column_stack([x, 90.0 + 0.1 * np.cos(x), 0 * x])
    south = np.tile([0.0, -0.8, 0.6], (11, 1))
    np.testing.assert_allclose(_along(cores, south), [1, 0], atol=0.02)
    np.testing.assert_allclose(_along(cores, -south), [-1, 0], atol=0.02)


def test_sight_to_the_scanner_of_the_epoch_or_of_another_or_as_stated():
    cores = np.array([[0.0, 0, 0], [10, 0, 0]])
    none = SimpleNamespace(scanner_m=np.empty((0, 3)))
    boat = SimpleNamespace(scanner_m=np.array([[1.0, -5, 1], [9.0, -5, 1]]))
    other = SimpleNamespace(scanner_m=boat.scanner_m + np.array([0.0, 1, 0]))
    settings = Deformation(towards=(0.0, 0.6, 0.8))
    np.testing.assert_allclose(_sight(cores, boat, [none, other], settings), [[1, -5, 1], [-1, -5, 1]])
    np.testing.assert_allclose(_sight(cores, none, [none, other], settings), [[1, -4, 1], [-1, -4, 1]])
    np.testing.assert_allclose(_sight(cores, none, [none], settings), [[0, 0.6, 0.8]] * 2)


# ---------------------------------------------------------------- epochs of files


@pytest.mark.parametrize("raster", [True, False])
def test_stated_errors_of_files(raster):
    """Shared over a length, or noise of each point; of a raster the height alone; a common one too."""
    xyz = np.array([[0.0, 0, 0], [0.1, 0, 0], [40.0, 0, 0]])
    axes = np.array([0.0, 0, 1]) if raster else np.ones(3)
    file = {"dsm": "a.tif"} if raster else {"clouds": ["a.laz"]}
    shared, node, white = _errors(xyz, Statement(**file, sigma_m=0.2, correlation_m=8.0), None, None)
    assert [g.name for g in shared] == [STATED]
    assert node.tolist() == [0, 0, 1]
    assert not white.any()
    np.testing.assert_allclose(shared[0].root, [0.2 * np.diag(axes)] * 2)
    assert (shared[0].correlation_m, shared[0].cell_m) == (8.0, 1.0)
    stated = Statement(**file, sigma_m=0.2, correlation_m=0.0, sigma_common_m=0.5)
    (own, common), node, white = _errors(xyz, stated, None, None)
    assert not own.root.any()
    assert own.correlation_m == 40.0
    np.testing.assert_allclose(white, np.tile(0.04 * axes, (3, 1)) @ np.eye(6)[[0, 3, 5]])
    assert (common.name, common.correlation_s) == (COMMON, np.inf)
    np.testing.assert_allclose(common.root, [0.5 * np.diag(axes)] * len(common.root))
    # bands: root mean square of the points of a cell, mean of what all share
    banded, all_of = np.array([0.1, 0.3, 0.4]), np.array([0.2, 0.4, np.nan])
    (own, common), _, white = _errors(xyz, Statement(**file, correlation_m=8.0), banded, all_of)
    np.testing.assert_allclose(own.root[:, 2, 2], [np.sqrt(0.05), 0.4])
    np.testing.assert_allclose(common.root[:, 2, 2], [0.3, 0.0])
    (unknown,), _, white = _errors(xyz, Statement(**file), None, None)
    assert (unknown.name, unknown.root.any(), white.any()) == (UNKNOWN, False, False)


def test_grids_that_files_and_campaigns_state():
    """What was assumed is told; two that differ are refused."""
    grid, path = CRS("EPSG:25833"), Path("a.xyz")
    both = CRS("EPSG:25833+7837")
    file = {"clouds": ["a.xyz"]}
    plain = Statement(**file)
    silent = "a.xyz states no system of heights: taken as ellipsoidal."
    assert _grid_of(None, plain, "EPSG:25833", path) == (
        grid, "ellipsoidal", ["a.xyz states no grid: taken as EPSG:25833.", silent],
    )  # fmt: skip
    assert _grid_of(grid, plain, "EPSG:25832", path) == (grid, "ellipsoidal", [silent])
    assert _grid_of(both, plain, "EPSG:25832", path) == (both, "DHHN2016 height", [])
    stated = Statement(**file, crs="EPSG:25833")
    assert _grid_of(None, stated, "EPSG:25832", path) == (grid, "ellipsoidal", [])
    assert _grid_of(grid, Statement(**file, crs="EPSG:25833+7837"), "x", path)[1:] == ("DHHN2016 height", [])
    with pytest.raises(InputError, match="heights DHHN2016 height, the campaign file DHHN92 height"):
        _grid_of(both, Statement(**file, crs="EPSG:25833+5783"), "x", path)
    own = LocalFrame(lat_deg=1.0, lon_deg=2.0, h_ell_m=3.0)
    assert _grid_of(own, stated, "x", path) == (own, "ellipsoidal", [])


def test_notes_of_a_pair_in_words():
    one, two = (SimpleNamespace(name=name, notes=(f"note {name}",), sigma_known=name == "a") for name in "ab")
    n = np.full((3, 2), 9)
    moved = {"would_be": {"east_m": 0.1, "north_m": -0.2, "up_m": 0.3}, "whole_stated": False}
    moved["sigma_as_a_whole_m"] = [1.0, 2.0, 0.0567]
    notes = notes_of_pair(one, two, n, moved)
    assert notes[:2] == ["a: note a", "b: note b"]
    assert "It suggests east +0.100 m, north -0.200 m, up +0.300 m" in notes[2]
    assert "hold 0.057 m of one error" in notes[2]
    assert notes[3].startswith("No sigma is stated of b. Without sigmas of both clouds")
    estimated = {"estimated": {"sigma_m": 0.0234, "correlation_m": 12.3}, "sigma": "estimated"}
    assert notes_of_pair(one, two, n, estimated)[2:] == [
        "No sigma is stated of b. Stable ground shows 0.023 m of an epoch, alike over 12 m, which counts "
        "instead."
    ]
    unknown = notes_of_pair(one, two, n, estimated | {"sigma": "unknown"})
    assert unknown[2].startswith("No sigma is stated of b. Without sigmas")


@pytest.mark.parametrize(
    ("ratio", "which"), [(19.0, None), (21.0, "first"), (1 / 19, None), (1 / 21, "second")]
)
def test_a_denser_cloud_is_told(ratio, which):
    n = np.array([[21 * 19 * 100 * ratio, 21 * 19 * 100], [0, 5]]).round().astype(int)
    notes = clouds.density_notes(n)
    assert len(notes) == (which is not None)
    if which:
        assert notes[0].startswith(f"The {which} cloud is 21 times as dense as the")
    assert clouds.density_notes(np.array([[0, 5]])) == []


def test_volumes_of_cells_behind_core_points():
    """Cells of 2 m behind two core points: the limit is 1.96 sigma; what is unseen has an area."""
    distance = np.array([9.0, 9.0, -0.5, -0.1, 0.3, 0.1, np.nan, 0.7])
    sigma = np.array([1.0, 1.0, 0.25, 0.1, 0.15, 0.1, np.nan, 0.1])
    own = np.nan_to_num(sigma**2)
    made = SimpleNamespace(
        distance_m=distance, sigma_m=sigma, variances=lambda P: (P**2 @ own, 0.01 * np.sum(P, axis=1) ** 2)
    )
    n = np.array([[9, 9], [9, 9], [9, 9], [9, 9], [9, 0], [2, 9]])
    use = np.array([True, True, True, True, False, False])
    table = differences._volumes(made, 2, use, n, 2.0).set_index("part")
    s2 = sigma[2:6] ** 2
    for part, cells in (
        ("net", [0, 1, 2, 3]),
        ("erosion", [0, 1]),
        ("deposition", [2, 3]),
        ("erosion beyond the level of detection", [0]),
        ("deposition beyond the level of detection", [2]),
    ):
        row = table.loc[part]
        assert (row.n_cells, row.area_m2) == (len(cells), 4.0 * len(cells))
        assert row.volume_m3 == pytest.approx(4 * distance[2:6][cells].sum())
        assert row.sigma_m3 == pytest.approx(4 * np.sqrt(s2[cells].sum() + 0.01 * len(cells) ** 2))
        assert row.high_m3 - row.volume_m3 == pytest.approx(norm.isf(0.025) * row.sigma_m3)
    assert table.loc["not seen in second", ["n_cells", "area_m2"]].tolist() == [1, 4]
    assert table.loc["too few points", ["n_cells", "area_m2"]].tolist() == [1, 4]
    assert np.isnan(table.loc["too few points", "volume_m3"])


def test_two_rasters_with_a_motion_and_their_errors(tmp_path, monkeypatch):
    """The height of the motion comes off; on drawn ground what is estimated there replaces what is stated."""
    corner, cell = np.array([500_000.0, 5_700_000.0]), np.ones(2)
    made = [
        Dsm(np.full((2, 3), z), corner, cell, CRS("EPSG:25833"), tmp_path / "x.tif") for z in (10.0, 11.0)
    ]
    monkeypatch.setattr(differences, "dsm_of", lambda stated: made[0 if stated.dsm == "a" else 1])
    cov = np.diag([9.0, 9.0, 0.04, 9, 9, 9])

    def found(facts, **stated):
        motion = Registration(
            np.array([5.0, 5, 0.25, 5, 5, 5]), cov, np.eye(6), np.eye(6), np.ones(1, bool), facts
        )
        statements = (Statement(dsm="a", **stated), Statement(dsm="b", **stated))
        return differences.difference_of_models(*statements, Deformation(), "EPSG:25833", motion)

    stated = {"sigma_m": 0.1, "correlation_m": 0.0, "sigma_common_m": 0.3}
    plain = found({}, **stated)
    np.testing.assert_allclose(plain.raster.height_m, 0.75)
    np.testing.assert_allclose(plain.sigma_m, np.sqrt(2 * (0.01 + 0.09) + 0.04))
    np.testing.assert_allclose(found({"areas": "drawn"}, **stated).sigma_m, np.sqrt(2 * 0.01 + 0.04))
    shown = {"areas": "drawn", "estimated": {"sigma_m": 0.5, "correlation_m": 3.0}}
    np.testing.assert_allclose(found(shown).sigma_m, np.sqrt(2 * 0.25 + 0.04))
    np.testing.assert_allclose(found({}).sigma_m, 0.2)
    cov[2, 2] = 0.0
    assert np.isnan(found({}).sigma_m).all()


def test_cells_of_the_map_that_hold_points(tmp_path):
    frame = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
    origin = np.floor(frame.to_map(np.zeros(3), CRS("EPSG:25833"))[:2])
    in_map = np.array([[0.25, 0.25, 300.0], [0.75, 0.5, 302.0], [3.5, 2.5, 310.0]])
    in_map[:, :2] += origin
    made = SimpleNamespace(name="a", xyz_m=frame.from_map(in_map, CRS("EPSG:25833")))
    everywhere = SimpleNamespace(contains=lambda xyz: np.ones(len(xyz), bool))
    grid, cells, middles = differences._cells(made, everywhere, frame, CRS("EPSG:25833"), 1.0)
    back = frame.to_map(middles, CRS("EPSG:25833"))
    back[:, :2] -= origin
    order = np.argsort(back[:, 0])
    np.testing.assert_allclose(back[order], [[0.5, 0.5, 301.0], [3.5, 2.5, 310.0]], atol=1e-6)
    rows, columns = np.divmod(cells[order], grid.columns)
    assert (np.diff(columns)[0], np.diff(rows)[0]) == (3, -2)
    nowhere = SimpleNamespace(contains=lambda xyz: np.zeros(len(xyz), bool))
    with pytest.raises(CoverageError, match="no point of 'a' lies in"):
        differences._cells(made, nowhere, frame, CRS("EPSG:25833"), 1.0)


def test_a_difference_of_epochs_has_its_cells_behind_the_core_points(monkeypatch):
    """Cylinders as large as the cells; a cell with too few points in either epoch has no height."""
    rng = np.random.default_rng(6)
    cores = pair_of(rng, 4).cores
    middles = np.array([[0.5, 3.5, 1.0], [2.5, 3.5, 1.1], [4.5, 1.5, 1.2]])
    grid = SimpleNamespace(rows=2, columns=3, west_m=100.0, north_m=200.0, cell_m=2.0, crs=CRS("EPSG:25833"))
    settings = Deformation(core_spacing_m=2.0, cylinder_radius_m=0.3, least_in_cylinder=4)
    asked, sums = [], []

    def measure(places, before, after, how):
        asked.append((len(places), how.cylinder_radius_m))
        return places

    distance, sigma = np.array([9.0, 9, 9, 9, 0.1, 0.2, 0.3]), np.array([9.0, 9, 9, 9, 0.01, 0.02, 0.03])
    n = np.array([[9, 9]] * 4 + [[4, 4], [3, 9], [9, 4]])

    def registered(pair, registration):
        sums.append(registration)
        return SimpleNamespace(
            distance_m=distance, sigma_m=sigma, variances=lambda P: (P**2 @ sigma**2, np.zeros(len(P)))
        )

    monkeypatch.setattr(differences, "_cells", lambda *words: (grid, np.array([0, 1, 5]), middles))
    monkeypatch.setattr(differences, "measure_pair", measure)
    monkeypatch.setattr(differences, "_joined", lambda a, b: SimpleNamespace(found=SimpleNamespace(n=n)))
    monkeypatch.setattr(differences, "registered_distances", registered)
    motion = Registration(np.zeros(6), np.eye(6), np.ones((4, 6)), np.ones((6, 4)), np.ones(4, bool), {})
    found = differences.difference_of_epochs(
        cores, None, None, motion, settings, None, frame=None, crs="EPSG:25833"
    )
    # a circle with the area of a cell
    assert asked == [(4, 0.3), (3, pytest.approx(np.sqrt(4.0 / np.pi)))]
    nan = np.nan
    np.testing.assert_allclose(found.raster.height_m, [[0.1, nan, nan], [nan, nan, 0.3]])
    np.testing.assert_allclose(found.sigma_m, [[0.01, nan, nan], [nan, nan, 0.03]])
    assert (found.raster.corner_m.tolist(), found.raster.cell_m.tolist()) == ([100.0, 200.0], [2.0, 2.0])
    assert found.volumes.set_index("part").loc["net", "volume_m3"] == pytest.approx(4.0 * 0.4)
    (moved,) = sums
    centre = cores[["east_m", "north_m", "up_m"]].to_numpy().mean(axis=0)
    arm = middles - centre
    zero = np.zeros(3)
    wanted = np.column_stack([zero, zero, zero + 1, arm[:, 1], -arm[:, 0], zero])
    np.testing.assert_allclose(moved.design, np.concatenate([np.ones((4, 6)), wanted]))
    np.testing.assert_array_equal(moved.weights, np.hstack([np.ones((6, 4)), np.zeros((6, 3))]))
    assert moved.stable.tolist() == [True] * 4 + [False] * 3
