"""Terrain models of a few cells and sections of four points, worked out by hand."""

from pathlib import Path

import laspy
import numpy as np
import pandas as pd
import pytest
import rasterio
from rasterio import Affine

from tests.fusion.conftest import FRAME, GRID
from thalweg.core import NMAD, CoverageError, Grid, InputError, LazWriter, LocalFrame, write_raster
from thalweg.fusion import Cloud, Dtm, Source, dtm_facts, join_clouds, read_cloud, seam_steps
from thalweg.fusion.clouds import Fit, cloud_of_bed
from thalweg.fusion.dtm import (
    Layer,
    _filled,
    _grid,
    _pooled,
    blend,
    cells_inside,
    interpolation_error,
    layer_of_bed,
    layer_of_cloud,
    membrane,
    read_bands,
)
from thalweg.fusion.measures import Section, _wetted, hydraulic_table, hypsometry, long_profile, volume_below
from thalweg.settings.sections import Fusion
from thalweg.surface import Motion

NAN = np.nan


def dtm(height_m: object, *, cell_m: float = 1.0, corner_m: object = (0.0, 0.0), **bands: object) -> Dtm:
    """A model with sigmas of 0.05 m and nothing common, as far as bands do not say other."""
    height = np.array(height_m, dtype=float)
    given = {
        "sigma_m": 0.05,
        "source": np.uint8(Source.BED),
        "distance_m": 0.0,
        "sigma_common_m": 0.0,
    } | bands
    full = {
        k: np.where(np.isfinite(height), v, 0 if k == "source" else NAN).astype(
            np.uint8 if k == "source" else float
        )
        for k, v in given.items()
    }
    return Dtm(height_m=height, corner_m=np.array(corner_m), cell_m=cell_m, crs=GRID, **full)


# ---------------------------------------------------------------- cells of a cloud


def cells(
    points: list[list[float]],
    shape: tuple[int, int],
    *,
    cell_m: float = 1.0,
    corner_m: object = (0.0, 0.0),
    up_m: object = 0.4,
    across_m: object = 0.3,
) -> Layer:
    n = len(points)
    cloud = Cloud(
        xyz_m=np.array(points),
        sigma_up_m=np.broadcast_to(up_m, n).astype(float),
        sigma_horizontal_m=np.broadcast_to(across_m, n).astype(float),
    )
    return layer_of_cloud(Source.LIDAR, cloud, np.array(corner_m), cell_m, shape)


def test_a_cell_is_the_mean_of_its_points():
    """North-west corner at 100, 200: rows go south, columns east; points outside count nowhere."""
    points = [[100.5, 199.5, 1.0], [101.5, 198.5, 3.0], [105.0, 197.0, 9.0], [99.9, 199.0, 50.0]]
    points += [[106.1, 199.0, 50.0], [101.0, 200.1, 50.0], [101.0, 195.9, 50.0]]
    found = cells(points, (2, 3), cell_m=2.0, corner_m=(100.0, 200.0), up_m=[0.1, 0.3, 0.2, 9, 9, 9, 9])
    assert found.height_m == pytest.approx(np.array([[2.0, NAN, NAN], [NAN, NAN, 9.0]]), nan_ok=True)
    # too few points to show their scatter: stated variances, whose mean is 0.05, count as new in each point
    sigma = np.array([[np.sqrt(0.05 / 2), NAN, NAN], [NAN, NAN, 0.2]])
    assert found.sigma_m == pytest.approx(sigma, nan_ok=True)
    zero = np.where(np.isfinite(sigma), 0.0, NAN)
    assert found.sigma_common_m == pytest.approx(zero, nan_ok=True)
    assert found.distance_m == pytest.approx(zero, nan_ok=True)


@pytest.mark.parametrize("north", [False, True])
def test_points_are_brought_to_the_middle_of_the_cell_along_the_slope(north):
    """On the plane z = x (or z = y) the second cell has the height 1.5; its sigma grows by the slope."""
    along = [(0.5, 0.5), (1.75, 1.75), (2.5, 2.5)]
    points = [[0.5, -3 + u, z] if north else [u, -0.5, z] for u, z in along]
    found = cells(points, (3, 1) if north else (1, 3))
    assert found.height_m.ravel()[1] == pytest.approx(1.5, abs=1e-12)
    assert found.sigma_m.ravel()[1] == pytest.approx(0.5)  # 0.4 up, 0.3 across on a slope of 1


def test_scatter_averages_and_what_is_shared_stays():
    """Four points in each of nine cells scatter by w^2 = 0.12: noise up to what is stated, else relief."""
    middles = [(c + 0.5, -r - 0.5) for r in range(3) for c in range(3)]
    points = [[e, n, dz] for e, n in middles for dz in (-0.3, 0.3, -0.3, 0.3)]
    white = 4 * 0.09 / 3
    for stated in (0.5, 0.1):
        found = cells(points, (3, 3), up_m=stated)
        expected = max(stated**2 - white, 0.0) + min(stated**2, white) / 4 + max(white - stated**2, 0.0)
        assert found.sigma_m[1, 1] ** 2 == pytest.approx(expected)


def test_scatter_is_pooled_over_three_by_three_cells():
    squares, freedom = np.zeros((5, 5)), np.ones((5, 5), dtype=np.int64)
    squares[2, 2] = 18.0
    found, free = _pooled(squares, freedom, np.full((5, 5), 7.0))
    assert (free[2, 2], free[0, 0]) == pytest.approx((9.0, 4.0))
    assert found[2, 2] == pytest.approx(2.0)
    assert found[2, 3] == pytest.approx(2.0)
    assert found[0, 0] == pytest.approx(7.0)  # four freedoms of nine are too few
    assert found[2, 0] == pytest.approx(0.0)
    assert _pooled(squares, 2 * freedom, squares)[0][2, 2] == pytest.approx(1.0)


# ---------------------------------------------------------------- clouds


def test_points_of_a_moved_cloud_carry_the_error_of_the_motion():
    """Shift sigmas 3, 4, 5 cm and 1 mrad about the vertical and about east, 20 m and 10 m from the centre."""
    fit = Fit(
        motion=Motion(centre_m=np.zeros(3), R=np.eye(3), shift_m=np.array([1.0, 2.0, 3.0])),
        cov=np.diag([0.03, 0.04, 0.05, 1e-3, 0.0, 2e-3]) ** 2,
        undetermined=(),
        overlap=pd.DataFrame(),
        facts={},
    )
    cloud = Cloud(
        xyz_m=np.array([[20.0, 10.0, 0.0]]), sigma_horizontal_m=np.array([0.1]), sigma_up_m=np.array([0.2])
    )
    found = fit.moved(cloud)
    assert found.xyz_m[0].tolist() == [21.0, 12.0, 3.0]
    east, north, up = 0.03**2 + (10 * 2e-3) ** 2, 0.04**2 + (20 * 2e-3) ** 2, 0.05**2 + (10 * 1e-3) ** 2
    assert found.sigma_horizontal_m[0] ** 2 == pytest.approx(0.1**2 + (east + north) / 2)
    assert found.sigma_up_m[0] ** 2 == pytest.approx(0.2**2 + up)


def test_cells_of_the_bed_are_points_with_their_width_as_sigma(tmp_path):
    """A cell of 2 m says nothing of where in it: 2 m / sqrt(12); both parts of the height's sigma count."""
    at = FRAME.to_map(np.zeros((1, 3)), GRID)[0]
    west, north = np.floor(at[:2])
    grid = Grid(west_m=west, north_m=north, cell_m=2.0, rows=1, columns=2, crs=GRID)
    bands = {
        "height_m": np.array([[NAN, 150.5]]),
        "sigma_m": np.array([[0.1, 0.3]]),
        "sigma_common_m": np.array([[0.1, 0.4]]),
        "distance_m": np.zeros((1, 2)),
    }
    write_raster(tmp_path / "bed.tif", grid, bands)
    found = cloud_of_bed(tmp_path / "bed.tif", FRAME)
    assert FRAME.to_map(found.xyz_m, GRID)[0] == pytest.approx([west + 3, north - 1, 150.5], abs=1e-6)
    assert found.sigma_up_m == pytest.approx([0.5])
    assert found.sigma_horizontal_m == pytest.approx([0.57735])


def test_joined_clouds_have_the_classes_of_asprs(tmp_path):
    """Bed and light sheet are water (9), the rest ground (2); the source is the point source."""
    one = Cloud(xyz_m=np.zeros((1, 3)), sigma_horizontal_m=np.array([0.02]), sigma_up_m=np.array([0.03]))
    empty = one.part(np.zeros(1, dtype=bool))
    sources = [Source.BED, Source.LIGHT_SHEET, Source.LIDAR, Source.SURROUNDINGS, Source.LIDAR]
    counts = join_clouds(tmp_path / "all.laz", [*((s, one) for s in sources), (Source.FILLED, empty)], FRAME)
    with laspy.open(tmp_path / "all.laz") as file:
        read = file.read()
    assert np.asarray(read.classification).tolist() == [9, 9, 2, 2, 2]
    assert np.asarray(read.point_source_id).tolist() == [1, 2, 3, 4, 3]
    assert np.asarray(read["sigma_horizontal"]) == pytest.approx(0.02)
    assert np.asarray(read["sigma_up"]) == pytest.approx(0.03)
    assert counts["banks by the lidar"] == 2
    assert len(counts) == 4


def test_sigmas_of_a_cloud_are_those_of_its_file(tmp_path):
    """East and north make one horizontal sigma; a height's alone stands for all axes; else what is told."""
    kinds = {
        "both": {"sigma_up": 0.05, "sigma_east": 0.03, "sigma_north": 0.01},
        "up": {"sigma_up": 0.05},
        "none": {},
    }
    expected = {"both": (0.02236, 0.05), "up": (0.05, 0.05), "none": (0.2, 0.2)}
    for name, sigmas in kinds.items():
        dimensions = dict.fromkeys(sigmas, ("u4", "standard deviation, m", 0.0001))
        with LazWriter(tmp_path / f"{name}.laz", FRAME, extra_dimensions=dimensions) as writer:
            writer.append(np.zeros((2, 3)), extra={key: np.full(2, value) for key, value in sigmas.items()})
        cloud = read_cloud([tmp_path / f"{name}.laz"], FRAME, GRID, sigma_m=0.2)
        assert cloud.sigma_horizontal_m == pytest.approx(expected[name][0], abs=1e-4)
        assert cloud.sigma_up_m == pytest.approx(expected[name][1])
    other = LocalFrame(lat_deg=50.0, lon_deg=13.0, h_ell_m=0.0)
    with pytest.raises(InputError, match="another origin"):
        read_cloud([tmp_path / "up.laz"], other, GRID, sigma_m=0.2)


# ---------------------------------------------------------------- blending


def two_layers(bed_m: float, lidar_m: float) -> Dtm:
    """Bed in columns 0 to 5, banks in 3 to 7, cells of 1 m."""
    x = np.arange(8)
    bed = np.where(x < 6, bed_m, NAN)[None]
    bank = np.where(x > 2, lidar_m, NAN)[None]
    layers = [
        Layer(source=s, height_m=h, sigma_m=h * 0 + sigma, sigma_common_m=h * 0 + c, distance_m=h * 0 + d)
        for s, h, sigma, c, d in ((Source.BED, bed, 0.1, 0.05, 2.0), (Source.LIDAR, bank, 0.2, 0.0, 0.0))
    ]
    return blend(layers, np.zeros(2), 1.0, GRID, blend_m=2.0)


def test_sources_fade_into_each_other():
    """Tapers 1, 2/3, 1/3 over three cells, 0.1 against 0.2 m: shares of the bed 36/37, 4/5, 4/13."""
    found = two_layers(1.0, 1.0)
    share = np.array([1, 1, 1, 36 / 37, 0.8, 4 / 13, 0, 0])
    assert found.height_m[0] == pytest.approx(1.0)
    assert found.sigma_m[0] == pytest.approx(share * 0.1 + (1 - share) * 0.2)  # errors are shared
    assert found.sigma_common_m[0] == pytest.approx(share * 0.05)
    assert found.distance_m[0] == pytest.approx(share * 2.0)
    bed, bank = int(Source.BED), int(Source.LIDAR)
    assert found.source[0].tolist() == [bed] * 5 + [bank] * 3


def test_sources_that_contradict_each_other_raise_the_sigma():
    found = two_layers(0.0, 1.0)
    assert found.height_m[0, 4] == pytest.approx(0.2)
    assert found.sigma_m[0, 4] == pytest.approx(0.4)  # 0.8 x 0.2^2 + 0.2 x 0.8^2
    assert found.sigma_m[0, 0] == pytest.approx(0.1)


# ---------------------------------------------------------------- gaps


def test_a_membrane_is_straight_between_borders_and_level_at_a_free_one():
    gap = np.array([[False, True, True, True, False]])
    assert membrane(np.array([[0.0, NAN, NAN, NAN, 4.0]]), gap)[0] == pytest.approx([0, 1, 2, 3, 4])
    free = membrane(np.array([[3.0, NAN, NAN, NAN, NAN]]), gap)[0]
    assert free == pytest.approx([3, 3, 3, 3, NAN], nan_ok=True)
    alone = membrane(np.array([[3.0, NAN, NAN, NAN, NAN]]), np.array([[False, True, False, True, True]]))[0]
    assert alone == pytest.approx([3, 3, NAN, NAN, NAN], nan_ok=True)


def test_errors_of_interpolation_by_distance():
    """0.01 x^2 along one axis of two: 0.01 d^2 / sqrt(2), at 1 to 16 cells, which 60 cells hold."""
    y, x = np.mgrid[:60, :60]
    distance, sigma = interpolation_error(0.01 * (x * 0.5) ** 2 + 0.0 * y, 0.5)
    assert distance == pytest.approx([0, 0.5, 1, 2, 4, 8])
    assert sigma == pytest.approx(0.01 * distance**2 / np.sqrt(2), rel=1e-9)
    assert interpolation_error(np.zeros((2, 2)), 0.5)[0].tolist() == [0.0]


def test_a_filled_cell_has_the_error_of_interpolation():
    x = np.mgrid[:40, :40][1] * 0.5
    height = 0.1 * x**2
    height[20, 20] = NAN
    water = ~np.isfinite(height)
    model = dtm(height, cell_m=0.5, distance_m=0.4, sigma_common_m=0.02)
    found = _filled(model, water, Fusion())
    assert found.height_m[20, 20] == pytest.approx(0.1 * 100 + 0.1 * 0.25 / 2)  # mean of the four about it
    assert found.sigma_m[20, 20] == pytest.approx(np.hypot(0.05, 0.1 * 0.25 / np.sqrt(2)), rel=1e-2)
    assert found.distance_m[20, 20] == pytest.approx(0.9)
    assert found.sigma_common_m[20, 20] == pytest.approx(0.02)
    assert found.source[20, 20] == int(Source.FILLED)
    assert found.source[20, 21] == int(Source.BED)
    assert found.sigma_m[20, 21] == pytest.approx(0.05)


def test_land_is_filled_on_request_and_so_far():
    row = dtm(np.array([[1.0, NAN, NAN, NAN]]))
    dry = np.zeros((1, 4), dtype=bool)
    assert _filled(row, dry, Fusion()) is row
    found = _filled(row, dry, Fusion(fill="interpolate", fill_m=2.0))
    assert found.height_m[0] == pytest.approx([1, 1, 1, NAN], nan_ok=True)
    # one height alone shows no error of interpolation: one metre a metre
    assert found.sigma_m[0, 1:3] == pytest.approx(np.hypot(0.05, [1.0, 2.0]))
    with pytest.raises(CoverageError, match="2 cells inside the water line"):
        _filled(dtm([[1.0, NAN, NAN, NAN]]), np.array([[False, False, True, True]]), Fusion())


def test_cells_inside_a_polygon_are_those_whose_centres_are():
    square = np.array([[11.4, 19.4], [13.6, 19.4], [13.6, 17.6], [11.4, 17.6]])
    found = cells_inside(square, np.array([10.0, 20.0]), 1.0, (3, 5))
    assert np.argwhere(found).tolist() == [[1, 1], [1, 2], [1, 3]]


# ---------------------------------------------------------------- the model


def test_heights_between_cells_are_bilinear_and_beside_gaps_the_nearest():
    model = dtm([[1.0, 2.0, NAN], [3.0, 4.0, 5.0]], cell_m=2.0, corner_m=(10.0, 20.0), sigma_common_m=0.01)
    places = np.array([[11.0, 19.0], [12.0, 18.0], [11.0, 18.5], [13.2, 18.8], [15.0, 17.0], [9.0, 19.0]])
    height, sigma = model.at(places)
    assert height == pytest.approx([1.0, 2.5, 1.5, 2.0, 5.0, NAN], nan_ok=True)
    assert sigma == pytest.approx([0.05] * 5 + [NAN], nan_ok=True)
    assert model.centres_m()[1, 2].tolist() == [15.0, 17.0]
    common = dtm([[1.0, 2.0], [3.0, 4.0]], sigma_common_m=np.array([[0.1, 0.2], [0.3, 0.4]]))
    assert common.at_common(np.array([[0.6, -1.2], [9.0, 9.0]])) == pytest.approx([0.3, 0.2])


def test_a_seam_is_the_step_beside_the_slopes():
    """Heights 0, 1, 3, 4: a step of 2 where both sides rise by 1; turned by a quarter the same."""
    row = {"sigma_m": np.array([[0.1, 0.2, 0.3, 0.4]]), "source": np.array([[1, 1, 2, 2]], np.uint8)}
    model = dtm([[0.0, 1.0, 3.0, 4.0]], **row)
    step, sigma, bend = seam_steps(model)
    assert bend == pytest.approx([0.0])
    assert step == pytest.approx([1.0])
    assert sigma**2 == pytest.approx([2.25 * (0.04 + 0.09) + 0.25 * (0.01 + 0.16)])
    facts = dtm_facts(model)
    assert (facts["cells"], facts["cell_m"], facts["heights"]) == (4, 1.0, "ellipsoidal")
    assert list(facts["by_source"].values()) == [2, 2]
    assert (facts["seam_cells"], facts["seam_above_two_sigma"]) == (1, 0.0)
    assert facts["median_sigma_m"] == pytest.approx(0.25)
    assert facts["seam_spread_m"] == pytest.approx(NMAD)
    three = {k: np.repeat(v, 3, axis=0) for k, v in row.items()}
    mixed = dtm([[0.0, 1.0, 4.0, 5.0], [0.0, 0.0, 0.0, 9.0], [0.0, 1.0, 2.0, 3.0]], **three)
    assert dtm_facts(mixed)["seam_above_two_sigma"] == pytest.approx(1 / 3)
    assert dtm_facts(mixed)["seam_and_bend_above_two_sigma"] == pytest.approx(2 / 3)
    high = dtm_facts(dtm([[0.0, 1.0, 4.0, 5.0], [0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.5, 3.5]], **three))
    assert high["seam_above_two_sigma"] == pytest.approx(1 / 3)  # steps of 2.0, 0.0 and 0.5 m
    assert high["seam_spread_m"] == pytest.approx(0.5 * NMAD)
    turned = dtm([[0.0], [1.0], [3.0], [4.0]], **{k: v.T for k, v in row.items()})
    assert seam_steps(turned)[0] == pytest.approx([1.0])
    # a bank of slope 1 beside a level bed: one bend, wherever it lies between the outer cells, is no step
    for at in (0.5, 1.0, 1.3, 1.5, 2.0, 2.5):
        toe = np.maximum(np.arange(4.0) - at, 0.0)
        toe_step, _, toe_bend = seam_steps(dtm([toe.tolist()], **row))
        assert abs(toe_step[0]) <= toe_bend[0] + 1e-12
        lifted = toe + 0.8 * (np.arange(4) > 1.5)
        step, _, bend = seam_steps(dtm([lifted.tolist()], **row))
        assert -0.2 < abs(step[0]) - bend[0] <= 0.8 + 1e-12
    assert seam_steps(dtm([[0.0, 0.0, 0.0, 1.0]], **row))[0] == pytest.approx([-0.5])
    even = dtm([[0.0, 1.0, 3.0, 4.0]])
    assert dtm_facts(even)["seam_cells"] == 0
    assert dtm_facts(even)["seam_spread_m"] == 0.0
    assert dtm_facts(even)["seam_above_two_sigma"] == 0.0


# ---------------------------------------------------------------- sections and volumes


def channel(**changes: object) -> Section:
    """A trapezium: 4 m wide at the banks, 2 m at the bed, 2 m deep."""
    given = {
        "s_m": 10.0,
        "n_m": np.array([-2.0, -1.0, 1.0, 2.0]),
        "places_m": np.zeros((4, 2)),
        "height_m": np.array([2.0, 0.1, 0.0, 2.0]),
        "sigma_m": np.full(4, 0.3),
        "sigma_common_m": np.full(4, 0.3),
        "level_m": 1.0,
        "left_m": 2.0,
        "right_m": -2.0,
    }
    return Section(**given | changes)


def test_a_trapezium_at_half_its_depth():
    """Area 2.5 m2, perimeter 2 + sqrt(5), width 3 m; the area falls by 1.5 m with each height of the bed."""
    n, z = np.array([0.0, 1.0, 3.0, 4.0]), np.array([2.0, 0.0, 0.0, 2.0])
    area, perimeter, width, weights = _wetted(n, z, 1.0)
    assert (area, perimeter, width) == pytest.approx((2.5, 2 + np.sqrt(5), 3.0))
    assert weights == pytest.approx([0, 1.5, 1.5, 0])
    assert _wetted(n, z, 2.0)[0] == pytest.approx(6.0)


def test_the_hydraulic_table_of_a_trapezium():
    section = channel(height_m=np.array([2.0, 0.0, 0.0, 2.0]))
    table = hydraulic_table(section, Fusion(sections={"levels": 4}))
    assert table["level_m"].tolist() == [0.5, 1.0, 1.5, 2.0]
    first = table.iloc[1]
    # a height error of 0.3 m that all share, over 3 m
    spread, perimeter = 0.9, 2 + np.sqrt(5)
    assert first["sigma_area_m2"] == pytest.approx(spread)
    assert first["low_area_m2"] == pytest.approx(2.5 - 1.959964 * spread, rel=1e-6)
    assert first["high_area_m2"] == pytest.approx(2.5 + 1.959964 * spread, rel=1e-6)
    assert first["radius_m"] == pytest.approx(2.5 / perimeter)
    assert first["sigma_radius_m"] == pytest.approx(spread / perimeter)
    assert first["low_radius_m"] == pytest.approx((2.5 - 1.959964 * spread) / perimeter, rel=1e-6)
    assert first["high_radius_m"] == pytest.approx((2.5 + 1.959964 * spread) / perimeter, rel=1e-6)
    assert first["width_m"] == pytest.approx(3.0)
    full = table.iloc[3]
    assert (full["area_m2"], full["width_m"]) == pytest.approx((6.0, 4.0))
    assert full["perimeter_m"] == pytest.approx(2 + 2 * np.sqrt(5))
    thick = hydraulic_table(channel(sigma_common_m=np.full(4, 30.0), sigma_m=np.full(4, 30.0)), Fusion())
    assert (thick["low_area_m2"] == 0).all()
    assert (thick["low_radius_m"] == 0).all()


def test_water_behind_a_ridge_does_not_count():
    """Beyond a crest of 1.2 m lies a hollow: at the level of 1 m the channel alone is wet."""
    section = channel(
        n_m=np.array([-2.0, -1.0, 1.0, 2.0, 3.0, 4.0]),
        height_m=np.array([2.0, 0.0, 0.0, 1.2, 0.5, 2.0]),
        sigma_m=np.full(6, 0.3),
        sigma_common_m=np.full(6, 0.3),
        places_m=np.zeros((6, 2)),
    )
    table = hydraulic_table(section, Fusion(sections={"levels": 4}))
    assert table["level_m"].iloc[1] == pytest.approx(1.0)
    assert table["width_m"].iloc[1] == pytest.approx(2 + 0.5 + 1 / 1.2)


def test_the_long_profile_of_a_trapezium():
    row = long_profile([channel()]).iloc[0]
    assert row["thalweg_n_m"] == 1.0
    assert row["thalweg_m"] == 0.0
    assert row["sigma_thalweg_m"] == 0.3
    # trapezia of 1.05, 0.1 and 1 m2 over 4 m
    assert row["mean_bed_m"] == pytest.approx((1.05 + 0.1 + 1.0) / 4)
    assert (row["s_m"], row["level_m"], row["width_m"]) == (10.0, 1.0, 4.0)
    beyond = channel(height_m=np.array([2.0, 0.1, 0.0, -9.0]), left_m=1.5)
    assert beyond.thalweg_m == 1.0
    assert channel(right_m=1.5).thalweg_m == 2.0
    assert channel(height_m=np.array([2.0, 0.1, NAN, 2.0])).thalweg_m == -1.0


def test_a_volume_of_two_cells():
    """1 and 2 m of water on 4 m2 each; 0.4 m of their own that correlate by 1/e, 0.3 m in common."""
    model = dtm([[-1.0, -2.0], [1.0, NAN]], cell_m=2.0, sigma_m=0.5, sigma_common_m=0.3)
    volume, sigma, area = volume_below(model, 0.0, np.ones((2, 2), bool), 2.0)
    assert (volume, area) == pytest.approx((12.0, 8.0))
    assert sigma == pytest.approx(4 * np.sqrt(2 * 0.16 * (1 + np.exp(-1)) + 0.6**2))
    alone = volume_below(model, 0.0, np.array([[True, False], [True, True]]), 2.0)
    assert alone == pytest.approx((4.0, 2.0, 4.0))


def test_the_hypsometry_of_three_cells():
    model = dtm([[0.0, 1.0, 3.0, 9.0]], cell_m=2.0, sigma_m=0.3, sigma_common_m=0.3)
    table = hypsometry(model, np.array([[True, True, True, False]]), Fusion(sections={"levels": 4}))
    assert table["level_m"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert table["volume_m3"].tolist() == pytest.approx([0.0, 4.0, 12.0, 20.0])
    assert table["area_m2"].tolist() == pytest.approx([0.0, 4.0, 8.0, 8.0])
    assert table["sigma_volume_m3"].tolist() == pytest.approx([0.0, 1.2, 2.4, 2.4])
    assert table["low_m3"].tolist() == pytest.approx(
        [0.0, 4 - 1.959964 * 1.2, 12 - 1.959964 * 2.4, 20 - 1.959964 * 2.4]
    )
    assert table["high_m3"].iloc[3] == pytest.approx(20 + 1.959964 * 2.4)
    with pytest.raises(CoverageError, match="no cell has a height"):
        hypsometry(dtm([[NAN, 1.0]]), np.array([[True, False]]), Fusion())


# ---------------------------------------------------------------- grids


def bed_file(path: Path, height_m: object, sigma_m: object, *, nodata: float = NAN) -> Path:
    """A bed of cells of 1 m whose north-west corner is at 10, 20."""
    height, sigma = np.array(height_m, dtype=float), np.array(sigma_m, dtype=float)
    bands = [height, sigma, 0 * height + 0.02, 0 * height + 0.7]
    with rasterio.open(
        path, "w", driver="GTiff", width=height.shape[1], height=height.shape[0], count=4, dtype="float64",
        crs=GRID.to_wkt(), transform=Affine(1.0, 0, 10.0, 0, -1.0, 20.0), nodata=nodata,
    ) as file:  # fmt: skip
        for i, band in enumerate(bands, start=1):
            file.write(np.where(np.isnan(band), nodata, band), i)
    return path


def test_a_bed_keeps_its_cells_on_its_own_grid_and_is_bilinear_on_another(tmp_path):
    """A cell counts if height and sigma are known; half a cell on lies the mean of two."""
    path = bed_file(tmp_path / "bed.tif", [[1.0, 2.0, NAN, 4.0]], [[0.1, 0.1, 0.1, NAN]], nodata=-9999.0)
    found = layer_of_bed(path, np.array([9.0, 20.0]), 1.0, (1, 5))
    assert found.source == Source.BED
    assert found.height_m[0] == pytest.approx([NAN, 1, 2, NAN, NAN], nan_ok=True)
    assert found.sigma_m[0] == pytest.approx([NAN, 0.1, 0.1, NAN, NAN], nan_ok=True)
    assert found.sigma_common_m[0] == pytest.approx([NAN, 0.02, 0.02, NAN, NAN], nan_ok=True)
    assert found.distance_m[0] == pytest.approx([NAN, 0.7, 0.7, NAN, NAN], nan_ok=True)
    path = bed_file(tmp_path / "two.tif", [[1.0, 2.0], [5.0, 6.0]], [[0.1, 0.1], [0.3, 0.3]])
    between = layer_of_bed(path, np.array([10.5, 19.5]), 1.0, (1, 1))
    assert between.height_m[0, 0] == pytest.approx(3.5)
    assert between.sigma_m[0, 0] == pytest.approx(0.2)
    with pytest.raises(InputError, match="a bed without heights"):
        layer_of_bed(bed_file(tmp_path / "none.tif", [[NAN]], [[0.1]]), np.array([10.0, 20.0]), 1.0, (1, 1))
    with pytest.raises(InputError, match="4 bands"):
        read_bands(path, 5)


def test_the_grid_of_a_model_continues_that_of_its_bed(tmp_path):
    """Three rows and four columns from 10, 20; water beyond them adds whole cells."""
    path = bed_file(tmp_path / "bed.tif", np.zeros((3, 4)), np.ones((3, 4)))
    inside = np.array([[11.0, 18.0], [13.0, 18.0], [12.0, 19.0]])
    corner, shape = _grid(path, {}, inside, 1.0)
    assert (corner.tolist(), shape) == ([10.0, 20.0], (3, 4))
    corner, shape = _grid(path, {}, inside, 0.5)
    assert (corner.tolist(), shape) == ([10.0, 20.0], (6, 8))
    beyond = np.array([[8.7, 18.0], [15.2, 16.1], [12.0, 20.4]])
    corner, shape = _grid(path, {}, beyond, 1.0)
    assert (corner.tolist(), shape) == ([8.0, 21.0], (5, 8))
    with pytest.raises(InputError, match="a model of"):
        _grid(path, {}, np.array([[1e5, 18.0], [12.0, -1e5], [12.0, 20.0]]), 1.0)


def test_levels_end_at_the_lower_bank():
    """One metre on the right bank, and nothing but the far bank beside the thalweg: levels up to 1 m."""
    for heights in ([1.0, 0.0, 3.0, 4.0], [4.0, 3.0, 0.0, 1.0]):
        table = hydraulic_table(channel(height_m=np.array(heights)), Fusion(sections={"levels": 4}))
        assert table["level_m"].tolist() == pytest.approx([0.25, 0.5, 0.75, 1.0])
