"""The terrain model: watertight, without steps, with sigmas that hold."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from rasterio import Affine

from tests.bands import band
from tests.fusion.conftest import FRAME, GRID, HALF_WIDTH_M, LEVEL_UP_M, bed_up_m
from thalweg.core import CoverageError, InputError
from thalweg.fusion import Cloud, Dtm, River, Source, build_dtm, dtm_facts
from thalweg.fusion.dtm import Layer, cells_inside, contradictions, layer_of_cloud, loose_patches, membrane
from thalweg.settings.sections import Fusion, Vertical

CELL_M = 0.5


def truth_m(river, places):
    """Ellipsoidal heights of the formulas."""
    s, n, _ = river.to_flow(places)
    local = np.column_stack([river.flow.to_map(s, n), bed_up_m(s, n)])
    return FRAME.to_map(local, GRID)[:, 2], n


def write_bed(path, river, rng, *, margin_m=0.3, noise_m=0.03, cell_m=CELL_M, shift_m=0.0):
    outline = river.outline_m()
    west, north = np.floor(outline[:, 0].min()), np.ceil(outline[:, 1].max())
    shape = (int((north - outline[:, 1].min()) / cell_m) + 1, int((outline[:, 0].max() - west) / cell_m) + 1)
    east, up = np.meshgrid(
        west + (np.arange(shape[1]) + 0.5) * cell_m, north - (np.arange(shape[0]) + 0.5) * cell_m
    )
    places = np.column_stack([east.ravel(), up.ravel()])
    height, n = truth_m(river, places)
    s = river.to_flow(places)[0]
    inside = (np.abs(n) < HALF_WIDTH_M - margin_m) & (s > 0.1) & (s < river.flow.length_m - 0.1)
    height = np.where(inside, height + rng.normal(0, noise_m, len(height)), np.nan)
    bands = [height, np.full(len(height), noise_m), np.full(len(height), 0.01), np.full(len(height), 0.4)]
    with rasterio.open(
        path, "w", driver="GTiff", width=shape[1], height=shape[0], count=4, dtype="float32",
        crs=GRID.to_wkt(), transform=Affine(cell_m, 0, west + shift_m, 0, -cell_m, north), nodata=np.nan,
    ) as file:  # fmt: skip
        for i, band in enumerate(bands, start=1):
            file.write(np.where(inside, band, np.nan).reshape(shape).astype("f4"), i)
    return path


def bank_cloud(river, rng, n=60_000, noise_m=0.02, gap=None):
    s = rng.uniform(0, river.flow.length_m, n)
    off = rng.uniform(HALF_WIDTH_M + 0.2, HALF_WIDTH_M + 8, n) * rng.choice([-1, 1], n)
    if gap is not None:
        keep = ~((s > gap[0]) & (s < gap[1]) & (off > 0))
        s, off = s[keep], off[keep]
    up = bed_up_m(s, off) + rng.normal(0, noise_m, len(s))
    xyz = np.column_stack([river.flow.to_map(s, off), up])
    return Cloud(xyz_m=xyz, sigma_horizontal_m=np.full(len(s), 0.02), sigma_up_m=np.full(len(s), noise_m))


@pytest.fixture
def river(arc, banks):
    return River(flow=arc, banks=banks, frame=FRAME, crs=GRID)


def test_the_model_is_watertight_and_has_no_seam(river, rng, tmp_path):
    bed = write_bed(tmp_path / "bed.tif", river, rng, margin_m=1.5)
    found = build_dtm(bed, {Source.LIDAR: bank_cloud(river, rng)}, river.outline_m(), FRAME, Fusion())
    places = found.centres_m().reshape(-1, 2)
    height, n = truth_m(river, places)
    s = river.to_flow(places)[0]
    inside = (np.abs(n) < HALF_WIDTH_M - 0.1) & (s > 0.5) & (s < river.flow.length_m - 0.5)
    model = found.height_m.ravel()
    assert np.isfinite(model[inside]).all()
    assert not np.isfinite(model[np.abs(n) > HALF_WIDTH_M + 9]).any()
    error = (model - height)[inside]
    assert np.abs(np.median(error)) < 0.02
    facts = dtm_facts(found)
    assert facts["seam_cells"] > 100
    assert facts["seam_above_two_sigma"] < 0.05
    assert {"bed from soundings", "banks by the lidar", "interpolated over a gap"} == set(facts["by_source"])
    # One observation: medians of 0.93 for the bed and 0.53 for the banks. The guards are `bed_study` and
    # `consistency_river_study`.
    for source in (Source.BED, Source.LIDAR):
        here = (found.source.ravel() == int(source)) & np.isfinite(model)
        squares = ((model - height)[here] / found.sigma_m.ravel()[here]) ** 2
        assert 0.4 < np.median(squares) / 0.455 < 1.5


@pytest.mark.parametrize("offset_m", [0.0, 0.1, 0.3, 1.0])
def test_clouds_that_lie_apart_contradict_each_other(river, rng, tmp_path, offset_m):
    """The model between them has no step, whatever the offset: the layers tell it."""
    bed = write_bed(tmp_path / "bed.tif", river, rng, margin_m=0.0)
    own, other = bank_cloud(river, rng), bank_cloud(river, rng)
    other = replace(other, xyz_m=other.xyz_m + np.array([0.0, 0.0, offset_m]))
    clouds = {Source.LIDAR: own, Source.SURROUNDINGS: other}
    facts = dtm_facts(build_dtm(bed, clouds, river.outline_m(), FRAME, Fusion()))
    (found,) = facts["contradictions"].values()
    assert list(facts["contradictions"]) == ["banks by the lidar less cloud of the surroundings"]
    assert found["cells"] > 3000
    assert found["median_m"] == pytest.approx(-offset_m, abs=0.005)
    if offset_m:
        assert found["above_two_sigma"] > 0.95
    else:
        assert found["above_two_sigma"] < 0.1


def test_a_difference_of_layers_is_told_with_both_sigmas():
    def layer(source, height, sigma):
        height = np.array([height])
        zero = np.zeros_like(height)
        return Layer(
            source=source, height_m=height, sigma_m=zero + sigma, sigma_common_m=zero, distance_m=zero
        )

    bed = layer(Source.BED, [1.0, 2.0, np.nan, 4.0], 0.3)
    bank = layer(Source.LIDAR, [np.nan, 1.1, 3.0, 2.9], 0.4)
    assert contradictions([bed, bank, layer(Source.SURROUNDINGS, [np.nan] * 4, 0.1)]) == {
        "bed from soundings less banks by the lidar": {
            "cells": 2,
            "median_m": pytest.approx(1.0),
            "spread_m": pytest.approx(0.1 * 1.4826, rel=1e-4),
            "above_two_sigma": 0.5,  # 0.9 and 1.1 m beside twice 0.5 m
        }
    }


def test_crowns_and_roofs_behind_the_bank_are_no_ground():
    """Rows of cells of 1 m: water, a bank of slope 1, a terrace; then a hill, a roof, a crown far away."""
    height = np.full((60, 40), np.nan)
    height[1:10] = np.arange(9.0)[:, None]
    height[10, :] = 12.0  # a wall of 4 m on the bank has no slope, 40 m2
    height[20:24, 0:30] = 7.0  # 120 m2 of a hill
    height[30:34, 0:20] = 9.0  # a roof of 80 m2
    height[40, 5] = 11.0
    water = np.zeros(height.shape, bool)
    water[0] = True
    loose = loose_patches(height, water, 1.0)
    true = np.zeros_like(loose)
    true[10, :], true[30:34, 0:20], true[40, 5] = True, True, True
    assert (loose == true).all()
    # cells two apart hang together, cells three apart do not; a slope of 1.1 does not
    for apart, step, found in ((2, 2.0, 0), (3, 0.0, 1), (2, 2.2, 1), (1, 1.0, 0), (1, 1.1, 1)):
        row = np.full((1, 8), np.nan)
        row[0, 2], row[0, 2 + apart] = 0.0, step
        assert loose_patches(row, np.arange(8)[None] == 0, 1.0).sum() == found
    fine = np.full((1, 9), np.nan)
    fine[0, [4, 8]] = 0.0  # a metre from the water, and from each other, in cells of 0.25 m
    assert not loose_patches(fine, np.arange(9)[None] == 0, 0.25).any()


def test_crowns_behind_the_bank_leave_no_height_and_are_counted(river, rng, tmp_path):
    bed = write_bed(tmp_path / "bed.tif", river, rng)
    bank = bank_cloud(river, rng)
    middle = np.array([*river.flow.to_map(40.0, HALF_WIDTH_M + 14)[0], LEVEL_UP_M + 6.0])
    crown = middle + rng.uniform(-1.5, 1.5, (400, 3))
    points = Cloud(
        xyz_m=np.vstack([bank.xyz_m, crown]),
        sigma_horizontal_m=np.full(len(bank.xyz_m) + 400, 0.02),
        sigma_up_m=np.full(len(bank.xyz_m) + 400, 0.02),
    )
    alone, found = (
        build_dtm(bed, {Source.LIDAR: cloud}, river.outline_m(), FRAME, Fusion()) for cloud in (bank, points)
    )
    assert dtm_facts(alone)["banks_not_ground_for_certain"] == 0
    assert 20 < dtm_facts(found)["banks_not_ground_for_certain"] < 70
    assert np.isfinite(found.height_m).sum() == np.isfinite(alone.height_m).sum()


def test_clouds_say_nothing_where_the_bed_is_under_water(river, rng, tmp_path):
    """Plants that stand in the water, and its surface, are no bed."""
    bed = write_bed(tmp_path / "bed.tif", river, rng, margin_m=0.0)
    dry = bank_cloud(river, rng)
    s, n = rng.uniform(5, 75, 3000), rng.uniform(-HALF_WIDTH_M, HALF_WIDTH_M, 3000)
    surface = np.column_stack([river.flow.to_map(s, n), np.full(3000, LEVEL_UP_M)])
    wet = Cloud(xyz_m=surface, sigma_horizontal_m=np.full(3000, 0.02), sigma_up_m=np.full(3000, 0.02))
    clouds = {Source.LIDAR: dry, Source.SURROUNDINGS: wet}
    outline = river.outline_m()
    alone, both = (build_dtm(bed, of, outline, FRAME, Fusion()) for of in ({Source.LIDAR: dry}, clouds))
    under = cells_inside(outline, both.corner_m, both.cell_m, both.height_m.shape) & (
        both.source == Source.BED
    )
    assert under.sum() > 3000
    corner = np.rint((alone.corner_m - both.corner_m) * (1, -1) / CELL_M).astype(int)
    assert (corner == 0).all()
    np.testing.assert_allclose(both.height_m[under], alone.height_m[under], atol=1e-9)


@pytest.mark.parametrize("seconds", [0.0, 40.0])
def test_a_shared_error_of_the_pose_stays_in_the_sigma(rng, seconds):
    """Scatter of plants as large as the stated sigma: without the pose's part it passes for noise.

    Errors of poses last 8 s; a mean over 40 s takes off what it takes off.
    """
    size, sigma, pose = 30, 0.03, 0.02
    squares = {"told": [], "not": []}
    t = np.linspace(0.0, seconds, 81)
    root = np.linalg.cholesky(np.exp(-np.abs(t[:, None] - t) / 8.0) + 1e-9 * np.eye(81))
    for _ in range(40):
        xy = rng.uniform(0, size * CELL_M, (20_000, 2))
        when = rng.integers(0, 81, len(xy))
        up = (pose * root @ rng.standard_normal(81))[when] + rng.normal(0, sigma, len(xy))
        points = Cloud(
            xyz_m=np.column_stack([xy, up]),
            sigma_horizontal_m=np.full(len(xy), 0.02),
            sigma_up_m=np.full(len(xy), sigma),
            pose=np.column_stack([np.full((len(xy), 2), pose**2), t[when] / 8.0]),
        )
        for name, of in (("told", points), ("not", replace(points, pose=None))):
            layer = layer_of_cloud(Source.LIDAR, of, np.array([0.0, size * CELL_M]), CELL_M, (size, size))
            squares[name].append(np.nanmean((layer.height_m / layer.sigma_m) ** 2))
    low, high = band(40)  # one error of pose a draw, which all cells share
    # a mean over 40 s takes off more than is told: squares of 0.61 and 0.43 with two draws
    assert low * (1.0 if seconds == 0.0 else 0.7) < np.mean(squares["told"]) < high
    assert np.mean(squares["not"]) > 1.5 * np.mean(squares["told"])


def test_gaps_on_land_stay_or_are_filled_and_named(river, rng, tmp_path):
    bed = write_bed(tmp_path / "bed.tif", river, rng)
    clouds = {Source.LIDAR: bank_cloud(river, rng, gap=(30, 34))}
    empty = build_dtm(bed, clouds, river.outline_m(), FRAME, Fusion())
    place = river.to_map([32.0], [HALF_WIDTH_M + 3])
    assert np.isnan(empty.at(place)[0])
    full = build_dtm(bed, clouds, river.outline_m(), FRAME, Fusion(fill="interpolate"))
    height, sigma = full.at(place)
    assert abs(height[0] - truth_m(river, place)[0][0]) < 4 * sigma[0]
    filled = full.source == int(Source.FILLED)
    assert filled.sum() > (empty.source == int(Source.FILLED)).sum()
    assert (full.distance_m[filled] > 0).all()
    assert np.nanmax(full.distance_m[filled & (full.source == 5)]) < 8


def test_a_model_is_read_as_it_was_written(river, rng, tmp_path):
    bed = write_bed(tmp_path / "bed.tif", river, rng)
    vertical = Vertical(name="DHHN2016", separation_m=45.0, sigma_separation_m=0.05)
    clouds = {Source.LIDAR: bank_cloud(river, rng)}
    ellipsoidal = build_dtm(bed, clouds, river.outline_m(), FRAME, Fusion())
    found = build_dtm(bed, clouds, river.outline_m(), FRAME, Fusion(vertical=vertical))
    assert np.nanmax(np.abs(found.height_m + 45.0 - ellipsoidal.height_m)) < 1e-9
    assert np.nanmin(found.sigma_m) >= 0.05
    found.write(tmp_path / "dtm.tif")
    again = Dtm.read(tmp_path / "dtm.tif")
    assert again.vertical == "DHHN2016"
    np.testing.assert_allclose(again.height_m, found.height_m, rtol=0, atol=1e-4)
    assert (again.source == found.source).all()
    with rasterio.open(tmp_path / "dtm.tif") as file:
        assert file.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert file.descriptions[:4] == ("height", "sigma", "source", "distance")


@pytest.mark.parametrize("ending", ["tif", "gtx"])
def test_a_grid_of_a_geoid_gives_each_cell_its_separation(river, rng, tmp_path, ending):
    """A geoid that rises to the north and is curved within the millimetre; GTX by its published layout."""
    lon, lat = np.arange(13.0, 13.6, 0.05), np.arange(50.8, 51.4, 0.05)
    undulation = 44.0 + 20.0 * (lat[:, None] - 51.0) - 0.5 * (lon - 13.0) + 0.1 * (lat[:, None] - 51.0) ** 2
    path = tmp_path / f"geoid.{ending}"
    if ending == "gtx":
        head = np.array([lat[0], lon[0], 0.05, 0.05], ">f8").tobytes()
        size = np.array(undulation.shape, ">i4").tobytes()
        path.write_bytes(head + size + undulation.astype(">f4").tobytes())
    else:
        with rasterio.open(
            path, "w", driver="GTiff", width=len(lon), height=len(lat), count=1, dtype="float32",
            crs="EPSG:4258", transform=Affine(0.05, 0, lon[0] - 0.025, 0, -0.05, lat[-1] + 0.025),
        ) as file:  # fmt: skip
            file.write(undulation[::-1].astype("f4"), 1)
    bed, clouds = write_bed(tmp_path / "bed.tif", river, rng), {Source.LIDAR: bank_cloud(river, rng)}
    outline, named = river.outline_m(), Fusion(vertical=Vertical(name="EVRF", sigma_separation_m=0.02))
    plain = build_dtm(bed, clouds, outline, FRAME, Fusion())
    found = build_dtm(bed, clouds, outline, FRAME, named, geoid=path)
    known = np.isfinite(found.height_m)
    east, north = Transformer.from_crs(GRID, 4258, always_xy=True).transform(*found.centres_m()[known].T)
    true = 44.0 + 20.0 * (north - 51.0) - 0.5 * (east - 13.0) + 0.1 * (north - 51.0) ** 2
    assert np.ptp(true) > 0.005
    np.testing.assert_allclose((plain.height_m - found.height_m)[known], true, rtol=0, atol=2e-4)
    assert found.sigma_common_m[known].min() >= 0.02
    found.write(tmp_path / "dtm.tif")
    again = Dtm.read(tmp_path / "dtm.tif")
    assert (again.vertical, again.separation) == ("EVRF", found.separation)
    low = River(flow=river.flow, banks=river.banks, frame=FRAME, crs=GRID, separation=found.separation)
    assert river.level_m(40.0) - low.level_m(40.0) == pytest.approx(np.median(true), abs=0.002)
    far = outline + np.array([90_000.0, 0.0])
    with pytest.raises(InputError, match="no value at"):
        build_dtm(
            write_bed(tmp_path / "far.tif", river, rng, shift_m=90_000.0), {}, far, FRAME, named, geoid=path
        )


def test_water_that_no_bed_reaches_is_refused(river, rng, tmp_path):
    bed = write_bed(tmp_path / "bed.tif", river, rng)
    far = river.outline_m() + np.array([400.0, 0.0])
    with pytest.raises(CoverageError, match="inside the water line"):
        build_dtm(bed, {}, far, FRAME, Fusion())
    with pytest.raises(InputError, match="file not found"):
        build_dtm(tmp_path / "none.tif", {}, far, FRAME, Fusion())


def test_a_membrane_keeps_planes(rng):
    y, x = np.mgrid[:30, :40]
    plane = 2.0 * x + 3.0 * y
    gap = np.zeros(plane.shape, bool)
    gap[10:20, 12:30] = True
    found = membrane(np.where(gap, np.nan, plane), gap)
    assert found == pytest.approx(plane)
