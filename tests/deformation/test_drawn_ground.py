"""Epochs without a trajectory: what is taken off on drawn ground, and how well it is known."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely

from tests.deformation.test_foreign_epochs import CRS_25833, FRAME, ORIGIN, ground, prepared
from tests.deformation.test_surfaces import a_tif
from thalweg.cli import main
from thalweg.core import ArrayF, GeometryError, InputError
from thalweg.deformation import (
    Compared,
    Epoch,
    compare_epochs,
    estimate_volumes,
    measure_pair,
    place_core_points,
    register_pair,
    series_of_epochs,
)
from thalweg.deformation.drawn_ground import field_with
from thalweg.deformation.field import ErrorField
from thalweg.deformation.foreign import ForeignEpoch, difference_of_models, notes_of_pair, with_drawn_areas
from thalweg.settings.sections import Deformation, Epoch as Statement
from thalweg.surface import Area
from thalweg_lab.studies.by_hand import all_pairs

EAST, NORTH = round(ORIGIN[0]), round(ORIGIN[1]) + 40
"""Corner of the rasters in the north-west; they reach 80 m to the east and 40 m to the south."""
SETTINGS = Deformation(core_spacing_m=4.0, scales_m=[6.0], cylinder_radius_m=3.0, reach_m=5.0)
PATCHES = [(2.0 + 13.0 * i, 30.0, 7.0 + 13.0 * i, 36.0) for i in range(6)]
"""West, south, east, north of six areas of 30 cells that are stable, metres from the south-west corner."""


def a_square(west: float, south: float, east: float, north: float) -> list[tuple[float, float]]:
    """Corners in the local frame."""
    in_map = np.array([(west, south), (east, south), (east, north), (west, north)])
    in_map += np.array([EAST, NORTH - 40])
    local = FRAME.from_map(np.column_stack([in_map, np.full(4, FRAME.h_ell_m)]), CRS_25833)
    return [(float(x), float(y)) for x, y in local[:, :2]]


def drawn(n: int = 6) -> Deformation:
    return SETTINGS.replace(stable=[a_square(*patch) for patch in PATCHES[:n]])


def heights(
    rng: np.random.Generator, lift_m: float, moved_m: float, of_patches: ArrayF | None = None
) -> ArrayF:
    """Rows from the north: ground that moved, but for the patches; all of it lifted, patches by their own."""
    row, col = np.indices((40, 80))
    z = 301.0 + 0.02 * col + rng.normal(0.0, 0.005, row.shape) + lift_m
    stable = np.zeros(row.shape, bool)
    for i, (west, south, east, north) in enumerate(PATCHES):
        here = (col >= west) & (col < east) & (row >= 40 - north) & (row < 40 - south)
        stable |= here
        z[here] += 0.0 if of_patches is None else of_patches[i]
    return np.where(stable, z, z + moved_m)


def two_models(
    folder: Path, after: ArrayF, **stated: Any
) -> tuple[tuple[Statement, Statement], tuple[ForeignEpoch, ForeignEpoch], pd.DataFrame]:
    """Statements, prepared epochs and core points of two rasters, the first of them unmoved."""
    both = []
    for name, z in (("a", heights(np.random.default_rng(0), 0.0, 0.0)), ("b", after)):
        both.append(str(a_tif(folder / f"{name}.tif", z, corner=(EAST, NORTH), cell=1.0)))
    days = ("2019-03-13", "2020-03-13")
    statements = [Statement(dsm=file, date_utc=day, **stated) for file, day in zip(both, days, strict=True)]
    one, two = (
        prepared(name, dsm=file, date_utc=day, **stated)
        for name, file, day in zip("ab", both, days, strict=True)
    )
    return (statements[0], statements[1]), (one, two), place_core_points([one, two], SETTINGS, Area())


def net_of(
    cores: pd.DataFrame, epochs: tuple[Epoch, Epoch], settings: Deformation
) -> tuple[dict[str, float], Compared]:
    pair = measure_pair(cores, *epochs, settings)
    table, found, _ = compare_epochs(cores, *epochs, register_pair(pair, settings), settings, 1)
    row = estimate_volumes(table, found, settings, 1)[0].set_index("what").loc["net"]
    return row.to_dict(), found


@pytest.mark.parametrize("stated", [{}, {"sigma_m": 0.02, "correlation_m": 10.0}])
def test_a_beach_that_moved_is_not_taken_off(tmp_path, stated):
    """Nine tenths went down by 20 cm: what most agrees on, and no motion of the survey."""
    _, epochs, cores = two_models(tmp_path, heights(np.random.default_rng(1), 0.0, -0.2), **stated)
    net, found = net_of(cores, epochs, SETTINGS)
    assert not found.registration.parameters.any()
    facts = found.registration.facts
    assert facts["model"] == "none"
    assert facts["would_be"]["up_m"] == pytest.approx(-0.2, abs=0.01)
    assert facts["sigma"] == ("stated" if stated else "unknown")
    true = -0.2 * (80 * 40 - 180)
    assert net["volume_m3"] == pytest.approx(true, rel=0.03)
    # the interval holds what a registration would have made of it
    assert net["high_m3"] > 0
    (told,) = [note for note in notes_of_pair(*epochs, found.pair.found.n, facts) if "Nothing is" not in note
               and "no offset was removed" in note]  # fmt: skip
    assert "It suggests east +0.000 m, north +0.000 m, up -0.200 m" in told
    (whole,) = [note for note in notes_of_pair(*epochs, found.pair.found.n, facts) if "leave_out" in note]
    assert whole.startswith("Nothing is left out of a and b by polygons (leave_out): water, breaking waves")


def test_a_stated_error_of_all_heights_takes_the_place_of_what_is_agreed_on(tmp_path):
    stated = {"sigma_m": 0.0, "correlation_m": 0.0, "sigma_common_m": 0.03}
    statements, epochs, cores = two_models(tmp_path, heights(np.random.default_rng(1), 0.0, -0.2), **stated)
    net, found = net_of(cores, epochs, SETTINGS)
    assert net["sigma_m3"] == pytest.approx(0.03 * np.sqrt(2.0) * net["area_m2"], rel=0.01)
    assert "sigma_common_m" in notes_of_pair(*epochs, found.pair.found.n, found.registration.facts)[-1]
    row = difference_of_models(*statements, SETTINGS, "EPSG:25833", found.registration).volumes.iloc[0]
    assert row["sigma_m3"] == pytest.approx(0.03 * np.sqrt(2.0) * 3200.0, rel=1e-6)
    # on drawn ground it is taken off with the rest
    by_ground, _ = net_of(cores, epochs, drawn())
    assert by_ground["sigma_m3"] < 0.3 * net["sigma_m3"]


def test_both_volumes_lose_the_height_of_drawn_ground(tmp_path):
    """The survey lies 8 cm high, areas by 2 cm more or less; nine tenths of the ground went down by 20 cm."""
    patches = 0.02 * np.array([1.0, -1.0, 0.5, -0.5, 1.0, -1.0])
    after = heights(np.random.default_rng(1), 0.08, -0.2, patches)
    statements, epochs, cores = two_models(tmp_path, after)
    settings = drawn()
    net, found = net_of(cores, epochs, settings)
    facts = found.registration.facts
    assert facts["parameters"]["up_m"] == pytest.approx(0.08, abs=0.005)
    told = ("height", "drawn", 6, "estimated")
    assert (facts["model"], facts["areas"], facts["n_areas"], facts["sigma"]) == told
    assert [each["places"] for each in facts["by_area"]] == pytest.approx([30] * 6, abs=8)
    by_east = sorted((each["east_m"], each["off_m"]) for each in facts["by_area"])
    assert [off for _, off in by_east] == pytest.approx(patches, abs=0.006)
    true = -0.2 * (80 * 40 - 180)
    assert net["volume_m3"] == pytest.approx(true, rel=0.03)
    # that of the motion, all over, and what an estimated error alike over some metres adds
    assert 1.0 < net["sigma_m3"] / (facts["sigmas"]["up_m"] * net["area_m2"]) < 1.3
    by_height = difference_of_models(*statements, settings, "EPSG:25833", found.registration).volumes.iloc[0]
    assert by_height["volume_m3"] == pytest.approx(true, abs=2.0 * by_height["sigma_m3"])
    assert by_height["sigma_m3"] == pytest.approx(net["sigma_m3"], rel=0.2)
    # draws and variances hold the motion too
    total = [np.nansum(each) for each in found.draws(200, 1)]
    variance = sum(found.variances(np.where(np.isfinite(found.distance_m), 1.0, 0.0)[None]))
    assert np.std(total) == pytest.approx(float(np.sqrt(variance[0])), rel=0.15)


def test_sigma_comes_from_areas_and_holds_its_interval(tmp_path):
    """Areas err by 3 cm each, of all of their cells: 180 cells are six errors."""
    rng = np.random.default_rng(20261128)
    _, epochs, cores = two_models(tmp_path, heights(rng, 0.0, 0.0))
    settings = drawn()
    within, sigmas = [], []
    for _ in range(60):
        z = heights(rng, 0.0, -0.2, rng.normal(0.0, 0.03, 6))
        second = replace(epochs[1], xyz_m=np.column_stack([epochs[1].xyz_m[:, :2], epochs[1].xyz_m[:, 2]]))
        second.xyz_m[:, 2] += z.ravel() - heights(np.random.default_rng(1), 0.0, 0.0).ravel()
        moved = register_pair(measure_pair(cores, epochs[0], second, settings), settings)
        sigma = moved.facts["sigmas"]["up_m"]
        sigmas.append(sigma)
        within.append(abs(moved.parameters[2]) < 1.96 * sigma)
    assert 52 <= sum(within) <= 60  # of 60 at 95 %
    # 3 cm / sqrt(6), widened for five degrees of freedom
    assert np.median(sigmas) == pytest.approx(0.03 / np.sqrt(6.0) * 2.571 / 1.96, rel=0.25)


def test_errors_that_ground_shows_are_alike_over_their_length_wherever_the_frame_begins():
    """One error for each of two epochs: places 2 m apart share it, places 60 m apart do not."""
    places = np.array([[0.0, 5000.0, 1.0], [2.0, 5000.0, 1.0], [60.0, 5000.0, 1.0]])
    facts = {"estimated": {"sigma_m": 0.02, "correlation_m": 10.0}}
    field = field_with(ErrorField((), ()), places, np.tile([0.0, 0.0, 1.0], (3, 1)), facts, 2)
    alone, near, far = field.combined(np.array([[1, 0, 0], [1, 1, 0], [1, 0, 1]])).variances() / (2 * 0.02**2)
    assert (alone, far) == pytest.approx((1.0, 2.0), rel=0.02)
    assert near == pytest.approx(2.0 + 2.0 * np.exp(-0.2), rel=0.05)  # in cells of an eighth of the length


def test_two_areas_without_a_stated_sigma_give_no_verdict(tmp_path):
    _, epochs, cores = two_models(tmp_path, heights(np.random.default_rng(1), 0.05, -0.2))
    facts = register_pair(measure_pair(cores, *epochs, drawn(2)), drawn(2)).facts
    assert facts["sigma"] == "unknown"
    assert facts["sigma_from"] == "the scatter of single places, as if all had one error"
    assert facts["sigmas"]["up_m"] > 0.004  # that of one place, not of sixty


def test_too_little_ground_and_a_large_height_are_refused(tmp_path):
    _, epochs, cores = two_models(tmp_path, heights(np.random.default_rng(1), 0.7, 0.0))
    pair = measure_pair(cores, *epochs, SETTINGS)
    with pytest.raises(GeometryError, match=r"'b' lies 0\.70 m off 'a' on stable ground"):
        register_pair(pair, drawn())
    tiny = SETTINGS.replace(stable=[a_square(5.0, 5.0, 7.0, 7.0)])
    with pytest.raises(GeometryError, match="has 4 places on stable ground") as told:
        register_pair(pair, tiny)
    assert told.value.where == "deformation.stable"
    assert told.value.cure


def test_a_network_of_two_is_the_pair(tmp_path):
    _, epochs, cores = two_models(tmp_path, heights(np.random.default_rng(1), 0.08, -0.2))
    for settings in (drawn(), SETTINGS):
        moved = register_pair(measure_pair(cores, *epochs, settings), settings)
        series = series_of_epochs(cores, list(epochs), settings)
        step = series.network.parameters[1] - series.network.parameters[0]
        assert step == pytest.approx(moved.parameters, abs=1e-9)
        cov = series.network.cov.reshape(2, 6, 2, 6)
        apart = cov[1, :, 1] + cov[0, :, 0] - cov[0, :, 1] - cov[1, :, 0]
        assert apart == pytest.approx(moved.cov, abs=1e-9)


def test_polygons_lines_and_points_of_a_file_are_stable_ground(tmp_path, caplog):
    shapes = [
        shapely.box(EAST, NORTH - 20, EAST + 8, NORTH - 10),
        shapely.LineString([(EAST + 20, NORTH - 5), (EAST + 30, NORTH - 5)]),
        shapely.Point(EAST + 50, NORTH - 9),
    ]
    kinds = ["road", "road", "other"]
    path = tmp_path / "ground.gpkg"
    gpd.GeoDataFrame({"kind": kinds}, geometry=shapes, crs=25833).to_file(path)
    settings = with_drawn_areas(SETTINGS.replace(stable=str(path)), FRAME, "EPSG:25833")
    areas = [shapely.Polygon(each) for each in settings.stable or []]
    width = np.sqrt(2.0) / 2.0 * 2.0 * 0.5  # a quarter of a cell of 4 m, over the root of two, to both sides
    half = 1.0 / np.sqrt(2.0)
    assert [area.area for area in areas] == pytest.approx(
        [80.0, 20.0 * half + np.pi * half**2, np.pi * half**2], rel=0.01
    )
    assert width == pytest.approx(half)
    east, north = FRAME.to_map(np.array([[*areas[2].centroid.coords[0], 0.0]]), CRS_25833)[0, :2]
    assert (east, north) == pytest.approx((EAST + 50, NORTH - 9), abs=0.01)
    some = with_drawn_areas(SETTINGS.replace(stable=f"{path}?kind=other"), FRAME, "EPSG:25833")
    assert len(some.stable or []) == 1
    (tmp_path / "bare.geojson").write_text(shapely.to_geojson(shapes[0]))
    with_drawn_areas(SETTINGS.replace(stable=str(tmp_path / "bare.geojson")), FRAME, "EPSG:25833")
    assert "bare.geojson states no coordinate system: taken for places in ETRS89" in caplog.text
    ring = shapely.box(0, 0, 9, 9).difference(shapely.box(3, 3, 6, 6))
    gpd.GeoDataFrame(geometry=[shapely.affinity.translate(ring, EAST, NORTH)], crs=25833).to_file(path)
    with pytest.raises(InputError, match="stable ground with a hole"):
        with_drawn_areas(SETTINGS.replace(stable=str(path)), FRAME, "EPSG:25833")


@pytest.mark.real
def test_what_is_taken_off_a_beach_is_what_its_transects_show(data_dir, tmp_path, monkeypatch):
    """Three of the nine surveys that docs/deformation.md has, as a stranger would set them up."""
    monkeypatch.chdir(tmp_path)
    folder, days = data_dir / "sandpyper_dsm", ("20181113", "20181211", "20190516")
    files = [folder / f"dsm_1m/mar_{day}_dsm_resampled_1m.tif" for day in days]
    epochs = [f"{file}@{day[:4]}-{day[4:6]}-{day[6:]}" for file, day in zip(files, days, strict=True)]
    assert main(["new-campaign", "beach", "--folder", ".", "--epochs", *epochs]) == 0
    text = Path("beach.yaml").read_text()
    for day in days:
        mask = f'["{folder}/clean/watermasks.gpkg?location=mar,raw_date={day}"]'
        text = text.replace("leave_out: CHANGE", f"leave_out: {mask}", 1)
    text = text.replace("stable: CHANGE", f"stable: {folder}/lod_transects/mar_lod_transects.gpkg")
    Path("beach.yaml").write_text(text.replace(": CHANGE", ": null") + "  resample: bilinear\n")
    assert main(["check-config", "beach.yaml"]) == 0
    pairs, held = all_pairs(Path("beach.yaml"))
    assert list(pairs["pair"]) == ["1-2", "1-3", "2-3"]
    # published: +0.037 m (n 101) of the first, -0.2 m of the pairs with the May survey
    assert pairs["median_m"].to_numpy() == pytest.approx([0.037, -0.155, -0.204], abs=0.003)
    assert ((pairs["taken_off_m"] - pairs["median_m"]).abs() < 3.0 * pairs["sigma_m"]).all()
    assert pairs["sigma_m"].between(0.01, 0.12).all()
    gap = (pairs["net_m3"] - pairs["net_without_m3"]).abs()
    assert (gap < 1.96 * pairs["sigma_without_m3"]).all()
    assert (gap > 1000.0).all()  # that much would be wrong without the ground
    assert ((held["off_m"] / held["sigma_m"]) ** 2).mean() < 2.0


def test_a_cloud_without_a_trajectory_keeps_its_shift_too(tmp_path):
    """A boat's rule, what most agrees on, is not that of clouds from elsewhere."""
    rng = np.random.default_rng(2)
    text = []
    for name, lift in (("a", 0.0), ("b", 0.1)):
        np.savetxt(tmp_path / f"{name}.xyz", FRAME.to_map(ground(rng, 4000, lift), CRS_25833), fmt="%.4f")
        text.append(str(tmp_path / f"{name}.xyz"))
    one, two = (
        prepared(name, clouds=[file], sigma_m=0.01, correlation_m=3.0)
        for name, file in zip("ab", text, strict=True)
    )
    settings = Deformation(core_spacing_m=1.0, scales_m=[1.5], cylinder_radius_m=0.8)
    cores = place_core_points([one, two], settings, Area())
    net, found = net_of(cores, (one, two), settings)
    assert net["volume_m3"] == pytest.approx(0.1 * net["area_m2"], rel=0.05)
    assert found.registration.facts["would_be"]["up_m"] == pytest.approx(0.1, abs=0.01)
