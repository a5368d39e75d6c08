"""Series, states of changes, patches, visibility and files of epochs: small cases worked out by hand."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS
from scipy.stats import norm

from tests.las_files import write_laz
from thalweg.core import Dsm, GeometryError, InputError, LocalFrame, read_table
from thalweg.deformation import compare, drawn_ground, epochs, series, visibility, volumes
from thalweg.deformation.field import ErrorGroup
from thalweg.deformation.foreign import SurfaceDifference, clouds, surfaces, write_difference
from thalweg.deformation.foreign.epochs import place_of_file
from thalweg.deformation.foreign.surfaces import VOLUMES, volume_table
from thalweg.deformation.m3c2 import Cylinders
from thalweg.settings.sections import Deformation

UP = np.array([0.0, 0.0, 1.0])


# ---------------------------------------------------------------- series


def fitted(t, y, sigma, columns):
    """Parameters, covariance and sum of squares of independent heights, from the normal equations."""
    A = np.column_stack([np.ones_like(t), t - t.mean(), *columns])
    P = np.diag(1 / sigma**2)
    Q = np.linalg.inv(A.T @ P @ A)
    x = Q @ A.T @ P @ y
    return x, Q, (y - A @ x) @ P @ (y - A @ x)


def test_sums_of_squares_and_probabilities_of_a_series():
    """Five epochs leave a step two places in time, four leave none, two no trend."""
    t = np.array([0.0, 0.5, 1.5, 2.0, 4.0])
    y = np.array(
        [[0.1, 0.3, 0.2, 0.55, 0.5], [0.1, 0.3, np.nan, 0.55, 0.5], [0.1, np.nan, np.nan, 1, np.nan]]
    )
    sigma = np.array([0.1, 0.2, 0.1, 0.1, 0.3])
    found = series.fit_series(t, y.T, sigma)
    for place in (0, 1):
        at = np.isfinite(y[place])
        x, Q, chi2 = fitted(t[at], y[place, at], sigma[at], [])
        row = found.loc[place]
        assert (row.trend_m_a, row.sigma_trend_m_a) == pytest.approx((x[1], np.sqrt(Q[1, 1])))
        assert row.chi2_trend == pytest.approx(chi2)
        assert row.sigma_trend_common_m_a == 0.0
    ratios = {}
    for e in (1, 2):
        x, Q, _ = fitted(t, y[0], sigma, [np.arange(5) > e])
        ratios[e] = abs(x[2]) / np.sqrt(Q[2, 2])
    best = max(ratios, key=ratios.get)
    assert found["step_after_epoch"].tolist() == [best, -1, -1]
    assert found["p_step"][0] == pytest.approx(min(1.0, 2 * 2 * norm.sf(ratios[best])))
    assert found["p_step"][1:].isna().all()
    assert found["n_epochs"].tolist() == [5, 4, 2]
    assert found.loc[2, ["trend_m_a", "sigma_trend_m_a", "chi2_trend"]].isna().all()
    # common errors count in the sum of squares too
    common = np.diag([0.3, 0.1, 0.2, 0.4, 0.1]) ** 2
    whole = series.fit_series(t, y.T, sigma, common)
    x, Q, chi2 = fitted(t, y[0], np.sqrt(sigma**2 + np.diag(common)), [])
    assert whole["chi2_trend"][0] == pytest.approx(chi2)
    for times, common in ((t[:4], None), (t, np.eye(4)), (np.zeros(5), None)):
        with pytest.raises(InputError, match="three or more ascending times"):
            series.fit_series(times, y.T, sigma, common)
    with pytest.raises(InputError, match="2 epochs"):
        series.fit_series(t[:2], y.T[:2], sigma[:2])
    with pytest.raises(InputError, match="1 heights without a standard deviation"):
        series.fit_series(t, y.T, np.array([[0.1, 0.1, 0.1]] * 4 + [[0.0, 0.1, np.nan]]))


def test_an_epoch_jumps_where_both_medians_and_most_places_return():
    """Medians of all places that both epochs saw; the share of those that all three saw."""
    height = np.zeros((3, 10))
    height[1] = 0.2
    height[1, 6:] = -0.1
    height[2, 5] = 0.4  # goes up and stays
    jump = series.find_jumps(height, np.array([0.1, 0.1]))[0]
    assert (jump.epoch, jump.n, jump.before_m, jump.after_m) == (1, 10, 0.2, pytest.approx(-0.05))
    assert jump.share == 0.5
    assert not jump.flagged
    height[2, 5] = 0.0
    height[2, 9] = np.nan
    jump = series.find_jumps(height, np.array([0.1, 0.1]))[0]
    assert (jump.n, jump.after_m, jump.share) == (9, -0.2, pytest.approx(6 / 9))
    assert jump.flagged
    # six of ten are not most of them, and both steps must exceed the limit
    height[2, 9] = 0.0
    assert series.find_jumps(height, np.array([0.1, 0.1]))[0].share == 0.6
    assert not series.find_jumps(height, np.array([0.1, 0.1]))[0].flagged
    height[1, 6] = 0.2
    for sigmas, limit, flagged in (
        ((0.1, 0.1), 1.9, True),
        ((0.1, 0.1), 2.0, False),
        ((0.19, 0.3), 1.0, False),
        ((0.3, 0.19), 1.0, False),
    ):
        assert series.find_jumps(height, np.array(sigmas), limit=limit)[0].flagged == flagged
    with pytest.raises(InputError, match="2 epochs and 1 sigmas"):
        series.find_jumps(height[:2], np.ones(1))
    height[1, :5] = height[2, 5:] = np.nan
    with pytest.raises(GeometryError, match="both epochs 1 and 2"):
        series.find_jumps(height, np.ones(2))


def test_misclosures_of_places_with_all_changes():
    steps = np.array([[0.1, 0.2, np.nan], [0.3, -0.4, 0.1]])
    found = series.closure(steps, np.array([0.3, 0.1, 0.2]))
    assert (found.n, found.mean_m) == (2, pytest.approx(-0.1))
    assert (found.rms_m, found.largest_m) == (pytest.approx(np.sqrt(0.05)), pytest.approx(0.3))
    with pytest.raises(GeometryError, match="in all epochs"):
        series.closure(steps, np.full(3, np.nan))


# ---------------------------------------------------------------- what a comparison says


def distances(distance, roughness, n):
    k = len(distance)
    return compare.Distances(
        np.arange(3.0 * k).reshape(k, 3), np.tile([0.6, 0.0, 0.8], (k, 1)), np.full(k, 1.5), np.array(n),
        np.array(distance), np.array(roughness),
    )  # fmt: skip


def test_states_and_parts_of_sigma_of_changes():
    """All nine states; the larger of roughness and predicted noise counts, and one of none is known."""
    nan = np.nan
    found = distances(
        [nan, nan, nan, nan, 0.9, 0.5, -0.5, 0.1, 0.3],
        [nan, nan, nan, nan, nan, 0.1, 0.1, 0.1, nan],
        [[4, 4], [4, 5], [5, 4], [5, 5], [5, 5], [5, 9], [9, 5], [5, 5], [5, 5]],
    )
    white = np.array([nan, nan, nan, nan, 0.0, 0.05, 0.2, nan, 0.1])
    table = compare.judge_changes(
        found,
        compare.Comparison(control="none", level=0.05),
        sigma_field_m=np.full(9, 0.03),
        sigma_white_m=white,
        sigma_registration_m=0.04,
    )
    assert table["state"].tolist() == [
        "not seen", "not seen in first", "not seen in second", "no normal", "no sigma",
        "deposition", "erosion", "no significant change", "deposition",
    ]  # fmt: skip
    own = np.array([0.1, 0.2, 0.1, 0.1])
    sigma = np.sqrt(own**2 + 0.05**2)
    at = [5, 6, 7, 8]
    assert table["sigma_white_m"].tolist() == pytest.approx([nan] * 5 + own.tolist(), nan_ok=True)
    assert table["sigma_m"].tolist() == pytest.approx([nan] * 5 + sigma.tolist(), nan_ok=True)
    assert table["sigma_field_m"].tolist() == pytest.approx([nan] * 4 + [0.03] * 5, nan_ok=True)
    assert table["sigma_registration_m"].tolist() == pytest.approx([nan] * 4 + [0.04] * 5, nan_ok=True)
    p = 2 * norm.sf(np.abs(found.distance_m[at]) / sigma)
    assert table["p_value"][at].tolist() == pytest.approx(p)
    assert table["lod95_m"][at].tolist() == pytest.approx(1.959963985 * sigma)
    assert table["significant"].tolist() == [False] * 5 + [True, True, False, True]
    assert table[["n_before", "n_after"]].to_numpy().tolist() == found.n.tolist()
    assert table[["east_m", "north_m", "up_m"]].to_numpy().tolist() == found.cores_m.tolist()
    assert table.loc[3, ["normal_east", "normal_north", "normal_up"]].tolist() == [0.6, 0.0, 0.8]
    assert table["scale_m"].tolist() == [1.5] * 9
    # of four p values the largest q is that of the largest p, and those below wait for their rank
    q = p[np.argsort(p)] * 4 / np.arange(1, 5)
    q = np.minimum.accumulate(q[::-1])[::-1]
    assert np.sort(table["q_value"][at]).tolist() == pytest.approx(q)
    level = float(np.sort(p)[2] * 4 / 3 - 1e-9)
    fdr = compare.judge_changes(
        found,
        compare.Comparison(control="fdr", level=level),
        sigma_field_m=np.full(9, 0.03),
        sigma_white_m=white,
        sigma_registration_m=np.full(9, 0.04),
    )
    assert fdr["significant"].sum() == 2


@pytest.mark.parametrize(
    "words",
    [
        {"scales_m": ()},
        {"scales_m": (1.0, 0.0)},
        {"radius_m": -1.0},
        {"half_length_m": np.inf},
        {"control": "bonferroni"},
        {"level": 0.0},
        {"level": 1.0},
        {"least_points": 0},
    ],
)
def test_comparisons_that_cannot_be(words):
    with pytest.raises(InputError):
        compare.Comparison(**words)


def test_a_distance_without_points_of_both_says_what_is_amiss():
    """Sparse points of one place want wider cylinders, clouds elsewhere a look at their coordinates."""
    plan = np.stack(np.meshgrid(np.arange(0.0, 12.0, 0.5), np.arange(0.0, 12.0, 0.5)), axis=-1).reshape(-1, 2)
    ground = np.column_stack([plan, np.zeros(len(plan))])
    cores = np.array([[3.0, 3.0, 0.0], [6.0, 6.0, 0.0], [9.0, 3.0, 0.0]])
    options = compare.Comparison(scales_m=(1.2,), radius_m=0.8, half_length_m=2.0, least_points=3)
    both = compare.measure_distances(cores, ground, ground + 0.25 * UP, options, towards=UP)
    assert both.distance_m == pytest.approx([0.25] * 3)
    # points of the second epoch about one of the core points are enough
    part = compare.measure_distances(cores, ground, ground[plan[:, 0] > 7] + 0.0, options, towards=UP)
    assert np.isfinite(part.distance_m).tolist() == [False, False, True]
    with pytest.raises(GeometryError, match="clouds that overlap"):
        compare.measure_distances(cores, ground, ground + 9.0 * UP, options, towards=UP)
    beside = ground + 0.1 * UP
    beside = beside[np.linalg.norm(plan[:, None] - cores[:, :2], axis=2).min(axis=1) > 1.0]
    with pytest.raises(GeometryError, match="cylinders that hold enough points"):
        compare.measure_distances(cores, ground, beside, options, towards=UP)
    with pytest.raises(GeometryError, match="for a normal"):
        compare.measure_distances(cores, ground[::60], ground, replace_options(options, 0.1), towards=UP)


def test_roughness_of_a_distance_is_that_of_both_means():
    cores = np.zeros((1, 3))
    one, two = (
        Cylinders(np.array([n]), np.array([at]), np.array([std]))
        for n, at, std in ((9, 0.5, 0.3), (4, 0.8, 0.4))
    )
    found = compare.distances_along(cores, np.array([UP]), np.ones(1), one, two)
    assert found.distance_m == pytest.approx([0.3])
    assert found.roughness_m == pytest.approx([np.sqrt(0.09 / 9 + 0.16 / 4)])
    assert found.n.tolist() == [[9, 4]]


def replace_options(options, scale):
    return compare.Comparison((scale,), options.radius_m, options.half_length_m, options.least_points)


# ---------------------------------------------------------------- classes and objects


def test_plants_free_space_and_objects_are_no_measured_change():
    """Seven places 10 m apart: plants by scatter or echoes, free space by the surface it is seen from."""
    settings = Deformation(core_spacing_m=0.5)
    rough = settings.classes.vegetation_roughness_m
    k = 8
    places = np.column_stack([10.0 * np.arange(k), np.zeros((k, 2))])
    first, second = "not seen in first", "not seen in second"
    table = pd.DataFrame(
        {
            "state": ["erosion", "erosion", "erosion", second, second, first, first, second],
            "distance_m": [-0.5, -0.5, -0.5] + [np.nan] * 5,
            "east_m": places[:, 0], "north_m": 0.0, "up_m": 0.0,
        }
    )  # fmt: skip
    free = "free space"
    seen = pd.DataFrame(
        {
            "reason_1": ["", "", "", "", "", free, free, free],
            "reason_2": ["", "", "", free, free, "", "", "water"],
        }
    )
    scatter = np.full((k, 2), 0.01)
    scatter[0, 1] = rough * 1.01
    scatter[2, 0] = rough
    several = np.zeros((k, 2))
    several[1, 1], several[2, 0] = 0.31, 0.3
    several[3] = 0.9  # of an unmeasured place it tells nothing
    cores = pd.DataFrame({"surface": [1, 1, 1, 1, 2, 1, 2, 1], "area_m2": np.full(k, 2.0)})
    pair = SimpleNamespace(
        scatter_m=scatter, several=several, cores=cores, bare=np.ones(k, bool),
        found=SimpleNamespace(cores_m=places),
    )  # fmt: skip
    out, patches = volumes.classify_changes(table, SimpleNamespace(pair=pair), seen, settings)
    assert out["state"].tolist() == [
        "vegetation", "vegetation", "erosion", "erosion", second, first, "deposition", second,
    ]  # fmt: skip
    assert patches["what"].tolist() == ["erosion", "erosion", "deposition"]
    assert patches["volume_m3"].tolist() == [-1.0, 0.0, 0.0]
    assert patches["mean_distance_m"].isna().tolist() == [False, True, True]
    assert table["state"][0] == "erosion"


def test_a_short_patch_with_sharp_edges_is_an_object():
    """Two places of a boulder among ten about it; three of these with a sharp edge are enough."""
    settings = Deformation(core_spacing_m=0.5)
    ring = [[x, y, 0.0] for x in (-0.6, 0.0, 0.5, 1.1) for y in (-0.6, 0.6)] + [[-0.6, 0, 0], [1.1, 0, 0]]
    places = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], *ring, [9.0, 0.0, 0.0]])
    patch = np.array([4, 4] + [-1] * 11)
    rough = np.zeros(13, bool)
    rough[[2, 3]] = rough[12] = True
    assert not volumes._is_object(places, rough, patch, 4, settings)
    rough[4] = True
    assert volumes._is_object(places, rough, patch, 4, settings)
    # the places of the patch itself do not count, nor does a single one make an object
    assert not volumes._is_object(places, np.arange(13) < 2, patch, 4, settings)
    assert not volumes._is_object(places, rough, np.r_[4, np.full(12, -1)], 4, settings)
    longer = places.copy()
    longer[0, 2] = settings.classes.object_m
    assert not volumes._is_object(longer, np.ones(13, bool), patch, 4, settings)
    longer[1, 0] = 0.0
    assert volumes._is_object(longer, np.ones(13, bool), patch, 4, settings)
    # what lies more than two and a half spacings away is not around it
    far = places.copy()
    far[2:12] += [0.0, 30.0, 0.0]
    assert not volumes._is_object(far, np.ones(13, bool), patch, 4, settings)


# ---------------------------------------------------------------- what an epoch could have seen


def test_reasons_for_what_was_not_seen():
    """The strongest counts: water up to 10 cm above it, then range, angle, and what stands in the way."""
    settings = Deformation(core_spacing_m=0.5, cylinder_radius_m=0.4)
    limits = settings.visibility
    far, angle = limits.max_range_m, np.deg2rad(limits.max_incidence_deg)
    boat = np.array([[0.0, 0.0, 2.0]])
    cores = np.array([[0.0, 10, 1.09], [0, 10, 1.11], [0, far + 0.5, 2.0], [0, far - 0.5, 2.0],
                      [0, 10, 2.0], [0, 10, 2.0], [0, -10, 2.0]])  # fmt: skip
    towards = np.array([0.0, -1.0, 0.0])
    turned = [np.array([0.0, -np.cos(angle + s * 0.01), np.sin(angle + s * 0.01)]) for s in (1, -1)]
    normals = np.array([towards, towards, towards, towards, *turned, -towards])
    wall = np.stack(np.meshgrid([0.0], np.array([-5.0]), np.arange(0.0, 4.0, 0.1)), axis=-1).reshape(-1, 3)
    made = SimpleNamespace(
        scanner_m=boat, water_m=np.array([1.0]), xyz_m=wall, moment=np.zeros(len(wall), int), groups=()
    )
    found = visibility._reasons(cores, normals, made, settings)
    assert found.tolist() == [
        "water", "not swept", "range", "not swept", "incidence", "not swept", "occlusion",
    ]  # fmt: skip
    n = np.full((7, 2), settings.least_in_cylinder)
    n[2:, 0] -= 1
    files = SimpleNamespace(scanner_m=np.empty((0, 3)))
    table = visibility.observe_visibility(cores, normals, n, (made, files), settings)
    assert table["seen_1"].tolist() == [True, True] + [False] * 5
    assert table["reason_1"].tolist() == ["", "", *found[2:]]
    assert table["reason_2"].tolist() == [""] * 7
    table = visibility.observe_visibility(cores, normals, n[:, ::-1], (made, files), settings)
    assert table["reason_2"].tolist() == ["", ""] + ["no trajectory"] * 5
    assert not table["beams_through_2"].any()


def test_beams_that_passed_through_a_place():
    """Within half a radius of the core, ended clear behind it; three of them outrank all other reasons."""
    settings = Deformation(core_spacing_m=0.5, cylinder_radius_m=0.4)
    core, normal = np.array([[0.0, 10.0, 0.0]]), np.array([[0.0, -1.0, 0.0]])

    def through(ends, groups=(), core=core, normal=normal):
        ends = np.array(ends, float)
        starts = np.column_stack([ends[:, 0], np.zeros(len(ends)), ends[:, 2]])
        made = SimpleNamespace(
            scanner_m=starts, xyz_m=ends, moment=np.arange(len(ends)), groups=groups, water_m=np.full(9, -9.0)
        )
        return int(visibility.beams_through(core, normal, made, settings)[0])

    assert through([[0.0, 12.0, 0.0]]) == 1
    assert through([[0.19, 12.0, 0.0], [0.21, 12.0, 0.0]]) == 1
    # clear is the radius of a cylinder
    assert through([[0.0, 10.39, 0.0], [0.0, 10.41, 0.0]]) == 1
    assert through([[0.0, 12.0, 0.0]], normal=-normal) == 0
    sigma = 0.5  # three of them, times the root of two
    shared = ErrorGroup.from_sigmas("position", np.zeros(1), np.full(3, sigma), np.inf)
    clear = 3 * np.sqrt(2) * sigma
    assert through([[0.0, 10 + clear - 0.01, 0.0], [0.0, 10 + clear + 0.01, 0.0]], (shared,)) == 1
    turning = ErrorGroup.from_sigmas("attitude", np.zeros(1), np.full(3, sigma), np.inf)
    assert through([[0.0, 10.41, 0.0]], (turning,)) == 1
    reach = settings.visibility.max_range_m
    assert through([[0.0, 4 * reach - 1, 0.0], [0.0, 4 * reach + 1, 0.0]]) == 1


# ---------------------------------------------------------------- errors that points share


def test_the_stated_error_of_an_epoch_is_a_mean_square_over_its_moments():
    sigmas = np.array([[0.1, 0.2, 0.0], [0.1, 0.4, 0.0], [0.1, 0.9, 0.6]])
    moments = ErrorGroup.from_sigmas("position", np.arange(3.0), sigmas, 5.0)
    common = ErrorGroup.from_sigmas("common", np.zeros(1), np.array([0.0, 0.0, 0.5]), np.inf)
    wanted = np.sqrt((sigmas**2).mean(axis=0) + np.array([0.0, 0.0, 0.25]))
    assert drawn_ground._stated_m(SimpleNamespace(groups=(moments, common))) == pytest.approx(wanted)


def test_what_an_epoch_of_a_boat_says_of_itself():
    """Its kind without its points: heights of the ellipsoid, known errors, a trajectory."""
    made = object.__new__(epochs.Epoch)
    assert (made.heights, made.notes, made.sigma_known) == ("ellipsoidal", (), True)
    assert not made.is_raster


# ---------------------------------------------------------------- files of epochs

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)


def test_grid_and_origin_of_a_campaign_are_those_of_its_first_file(tmp_path):
    """The median of the points in four digits of a degree, and metres; a stated origin wins."""
    local = np.array([[100.0, 200.0, 7.4], [90.0, 150.0, 7.4], [900.0, 999.0, 99.0]])
    for code in (25833, 32633):
        crs = CRS.from_epsg(code)
        path = tmp_path / f"{code}.laz"
        write_laz(path, [{"xyz_m": FRAME.to_map(local, crs)}], crs)
        assert place_of_file(path) == (f"EPSG:{code}", (51.0518, 13.2514, 307))
    assert place_of_file(path, (51.0, 13.0, 4.5)) == ("EPSG:32633", (51.0, 13.0, 4.5))
    local_file = tmp_path / "local.laz"
    write_laz(local_file, [{"xyz_m": local}], FRAME)
    assert place_of_file(local_file) == ("EPSG:32633", (51.05, 13.25, 300.0))
    assert place_of_file(local_file, (-51.0, 20.0, 4.5)) == ("EPSG:32734", (-51.0, 20.0, 4.5))
    text = tmp_path / "a.xyz"
    np.savetxt(text, FRAME.to_map(local, CRS.from_epsg(25833)), fmt="%.3f", header="x y z")
    with pytest.raises(InputError, match="no grid is stated") as caught:
        place_of_file(text)
    assert caught.value.where == str(text)
    assert place_of_file(text, (51.0, 13.0, 4.5)) == ("EPSG:32633", (51.0, 13.0, 4.5))


def test_columns_that_count_are_no_coordinates(tmp_path):
    """Numbers of points, or rows and columns of a scan, before three columns of coordinates."""

    def read(rows):
        path = tmp_path / "a.xyz"
        path.write_text("".join(" ".join(map(str, row)) + "\n" for row in rows))
        return clouds.read_points(path).xyz_m

    place = [[500.25 + i, 600.5 + i, 3.125] for i in range(4)]
    with pytest.raises(InputError, match="4 columns without names, of which the first counts") as caught:
        read([[i, *row] for i, row in enumerate(place, 1)])
    assert "such as number, x, y, z" in caught.value.cure
    with pytest.raises(InputError, match="5 columns without names, of which the first two count") as caught:
        read([[i // 2, i % 2, *row] for i, row in enumerate(place)])
    assert "such as row, column, x, y, z" in caught.value.cure
    # whole metres that do not rise are east, as are all columns that are whole
    assert read([[500 - i, *row] for i, row in enumerate(place)])[0].tolist() == [500.0, 500.25, 600.5]
    assert read([[500 + i, 600, 3] for i in range(4)])[:, 0].tolist() == [500.0, 501.0, 502.0, 503.0]
    # two whole columns of large numbers are coordinates, and so are whole numbers before two others
    assert len(read([[500_000 + i, 5_700_000, 3.5, 0.25, 0.75] for i in range(4)])) == 4
    assert len(read([[500 + i, 600.5, 3.25] for i in range(4)])) == 4


def test_two_points_have_a_spacing(tmp_path):
    (tmp_path / "two.xyz").write_text("1000 2.5 3\n1003 6.5 3\n")
    assert clouds.point_spacing_m(tmp_path / "two.xyz") == pytest.approx(5.0)


def test_volumes_are_written_without_numbers_of_rows(tmp_path):
    rows = [("net", 3, 12.0, -1.5, 0.25), ("erosion", 1, 4.0, -2.0, 0.5)]
    found = SurfaceDifference(None, None, volume_table(rows), [])
    write_difference(tmp_path / "v.csv", found)
    write_difference(tmp_path / "v.parquet", found)
    back = pd.read_csv(tmp_path / "v.csv")
    assert back.columns.tolist() == list(VOLUMES.names)
    assert back.iloc[:, :4].to_numpy().tolist() == [list(row[:4]) for row in rows]
    pd.testing.assert_frame_equal(read_table(tmp_path / "v.parquet", VOLUMES)[0], found.volumes)


@pytest.mark.parametrize(("off", "told"), [(0.5e-6, False), (1.5e-6, True)])
def test_rasters_a_millionth_of_a_cell_apart_are_told(off, told):
    crs = CRS.from_epsg(25833)
    before, after = (
        Dsm(np.full((3, 4), z), np.array([100.0 + x, 50.0]), np.ones(2), crs, Path("a.tif"))
        for z, x in ((1.0, 0.0), (2.0, off))
    )
    found = surfaces.difference_of_surfaces(before, after)
    assert any("count as the same" in note for note in found.notes) == told
    assert replace(found.raster, path=Path()).height_m == pytest.approx(np.ones((3, 4)))


def test_points_of_the_reference_itself_want_no_registration(tmp_path):
    rng = np.random.default_rng(1)
    plan = rng.uniform(0, 10, (400, 2))
    path = tmp_path / "a.xyz"
    np.savetxt(path, np.column_stack([plan, 0.1 * plan[:, 0]]), fmt="%.6f")
    for asked in (False, True):
        table, _, facts, _ = clouds.compare_with_surface(path, path, {}, registration=asked)
        assert not table["distance_m"].any()
        assert facts["counts"]["points_of_the_reference"] == 400
        assert ("registration" in facts) == asked
