"""Epochs from elsewhere: files into the frame of all, stated errors in sigmas, and what is refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import CRS
from scipy.spatial.distance import cdist
from scipy.stats import chi2

from tests.deformation.test_changes import SETTINGS as BANK, bank, epoch
from tests.deformation.test_surfaces import a_package, a_tif
from tests.las_files import write_laz
from thalweg.core import (
    ArrayF,
    CoverageError,
    GeometryError,
    Grid,
    InputError,
    LocalFrame,
    ThalwegError,
    gps_from_unix,
    read_dsm,
    write_raster,
)
from thalweg.deformation import (
    check_order,
    compare_epochs,
    estimate_volumes,
    find_jumps,
    measure_pair,
    observe_visibility,
    place_core_points,
    register_pair,
    series_of_epochs,
)
from thalweg.deformation.core_points import CORE_POINTS
from thalweg.deformation.foreign import (
    ForeignEpoch,
    check_epoch_files,
    difference_of_epochs,
    difference_of_models,
    notes_of_pair,
    prepare_foreign_epoch,
    read_epoch,
)
from thalweg.deformation.foreign.differences import _as_cores
from thalweg.deformation.m3c2 import ColumnIndex
from thalweg.settings.sections import Deformation, Epoch
from thalweg.surface import Area

CRS_25833 = CRS.from_epsg(25833)
FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
ORIGIN = FRAME.to_map(np.zeros(3), CRS_25833)
EVERYWHERE = Area()
SETTINGS = Deformation(core_spacing_m=1.0, scales_m=[1.5], cylinder_radius_m=0.8, registration="none")


def ground(rng: np.random.Generator, n: int = 4000, lift_m: float = 0.0) -> ArrayF:
    """Points (n, 3) of 24 m x 16 m of sloping ground in the local frame, noise of 1 cm."""
    plan = rng.uniform(0.0, (24.0, 16.0), (n, 2))
    return np.column_stack([plan, 2.0 + 0.1 * plan[:, 0] + lift_m + rng.normal(0.0, 0.01, n)])


def a_laz(path: Path, local_m: ArrayF, crs: CRS | None = CRS_25833) -> Path:
    write_laz(path, [{"xyz_m": FRAME.to_map(local_m, CRS_25833)}], crs)
    return path


def prepared(name: str, area: Area = EVERYWHERE, **stated: Any) -> ForeignEpoch:
    stated = {"date_utc": "2019-03-13"} | stated
    return prepare_foreign_epoch(
        name, Epoch(**stated), frame=FRAME, crs="EPSG:25833", area=area, margin_m=1.0
    )


def told(error: type[ThalwegError], **stated: Any) -> ThalwegError:
    """The refusal of an epoch, which has all four parts."""
    with pytest.raises(error) as caught:
        prepared("first", **stated)
    assert all((caught.value.expected, caught.value.where, caught.value.cure))
    return caught.value


# ---------------------------------------------------------------- files


def test_all_kinds_of_files_lie_in_the_frame_of_all_epochs(tmp_path):
    local = ground(np.random.default_rng(1), 300)
    in_map = FRAME.to_map(local, CRS_25833)
    text = tmp_path / "a.xyz"
    np.savetxt(text, in_map, fmt="%.4f", header="x y z")
    laz = a_laz(tmp_path / "a.laz", local)
    for files in ([str(laz)], [str(text)]):
        one = prepared("first", clouds=files)
        assert one.xyz_m == pytest.approx(local, abs=1e-3)  # LAZ in millimetres
        assert one.start_gps_s == float(gps_from_unix(1552478400))  # noon of 13 March 2019, UTC
        assert not one.sigma_known
    assert prepared("first", clouds=[str(text)]).notes == (
        "a.xyz states no grid: taken as EPSG:25833.",
        "a.xyz states no system of heights: taken as ellipsoidal.",
    )
    both = prepared("first", clouds=[str(laz), str(text)])
    assert len(both.xyz_m) == 600
    near = Area(polygon_en_m=np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 5.0], [0.0, 5.0]]))
    part = prepared("first", near, clouds=[str(laz)])
    assert part.xyz_m[:, :2].max(axis=0) == pytest.approx([10.0, 6.0], abs=0.7)  # a metre of margin


def test_a_surface_model_has_a_point_a_cell_outside_of_its_masks(tmp_path):
    corner = (round(ORIGIN[0]) - 10.0, round(ORIGIN[1]) + 10.0)
    row, col = np.indices((20, 30))
    height = 302.0 + 0.1 * col + 0.05 * row
    height[0] = -10_000.0
    dsm = a_tif(tmp_path / "a.tif", height, corner=corner, cell=1.0)
    east, north = corner
    ring = [(east, north - 20), (east + 5, north - 20), (east + 5, north), (east, north), (east, north - 20)]
    water = a_package(tmp_path / "water.gpkg", [ring])
    one = prepared("first", dsm=str(dsm), leave_out=[f"{water}?day=20180727"], sigma_m=0.03, correlation_m=5)
    assert len(one.xyz_m) == 19 * 25
    assert one.notes == (
        "a.tif: 30 of 600 cells without a height (undeclared value -10000).",
        "a.tif: The file states no unit of heights: metres.",
        "a.tif: 100 of 600 points left out by polygons.",
        "a.tif states no system of heights: taken as ellipsoidal.",
    )
    assert FRAME.to_map(one.xyz_m, CRS_25833)[:, 2].min() == pytest.approx(302.55, abs=1e-3)
    # of a raster only the heights err
    assert one.report()["groups"][0]["sigma"] == pytest.approx([0.0, 0.0, 0.03])
    with pytest.raises(InputError, match="no column"):
        prepared("first", dsm=str(dsm), leave_out=[f"{water}?month=7"])


def test_a_bed_brings_the_sigmas_of_its_kriging(tmp_path):
    grid = Grid.around(ORIGIN[None, :2], 1.0, CRS_25833, margin_m=12.0)
    sigma = np.linspace(0.02, 0.2, grid.rows * grid.columns).reshape(grid.rows, grid.columns)
    bands = {"height_m": np.full(sigma.shape, 297.0), "sigma_m": sigma, "sigma_common_m": 0.03 + 0 * sigma}
    for name, lift in (("a", 0.0), ("b", 0.5)):
        raised = bands | {"height_m": bands["height_m"] + lift}
        write_raster(tmp_path / f"{name}.tif", grid, raised, tags={"heights": "ellipsoidal, metres"})
    bed = {"dsm": str(tmp_path / "a.tif")}
    assert "(in a campaign correlation_m)" in told(InputError, **bed).cure
    one = prepared("first", **bed, correlation_m=4.0)
    assert (one.heights, one.notes) == ("ellipsoidal", ())  # a tag of the raster says so
    places, normals = one.xyz_m, np.tile([0.0, 0.0, 1.0], (len(one.xyz_m), 1))
    index = ColumnIndex.of(one.xyz_m, 0.4)
    field = one.field(places, normals, index, radius_m=0.4, half_length_m=1.0)  # a cell each
    expected = np.hypot(sigma.ravel().astype(np.float32), np.float32(0.03))
    assert np.sqrt(field.variances()) == pytest.approx(expected, rel=0.05)  # cells of half a metre hold one
    holed = bands | {"sigma_m": np.where(np.arange(sigma.size).reshape(sigma.shape) < 7, np.nan, sigma)}
    write_raster(tmp_path / "holed.tif", grid, holed)
    holed_epoch = prepared("first", dsm=str(tmp_path / "holed.tif"), correlation_m=4.0)
    assert holed_epoch.notes == ("holed.tif: 7 cells without a standard deviation left out.",)
    assert len(holed_epoch.xyz_m) == sigma.size - 7
    # the terrain model of bed and banks has other names for the same bands
    renamed = {name.removesuffix("_m"): band for name, band in bands.items()} | {"source": 0 * sigma}
    write_raster(tmp_path / "dtm.tif", grid, renamed, tags={"heights": "DHHN2016 height"})
    model = read_dsm(tmp_path / "dtm.tif")
    assert model.frame is not None
    assert model.frame.sub_crs_list[1].to_epsg() == 7837
    assert model.sigma_m == pytest.approx(sigma, rel=1e-6)
    assert model.common_m == pytest.approx(np.full(sigma.shape, 0.03))
    # difference of both beds: each cell with both sigmas, the sum with what all cells share
    found = difference_of_models(
        Epoch(**bed, correlation_m=4.0),
        Epoch(dsm=str(tmp_path / "b.tif"), correlation_m=4.0),
        SETTINGS,
        "EPSG:25833",
    )
    assert found.raster.height_m == pytest.approx(np.full(sigma.shape, 0.5))
    assert found.sigma_m == pytest.approx(np.sqrt(2.0) * np.hypot(sigma, 0.03), rel=1e-6)
    alike = np.exp(-cdist(grid.centres_m(), grid.centres_m()) / 4.0)
    s = sigma.ravel()
    variance = 2.0 * (s @ alike @ s + (0.03 * s.size) ** 2)
    row = found.volumes.loc[0]
    assert row.volume_m3 == pytest.approx(0.5 * s.size)
    assert row.sigma_m3 == pytest.approx(np.sqrt(variance), rel=1e-6)


def test_an_epoch_is_read_as_it_was_written(tmp_path):
    laz = a_laz(tmp_path / "a.laz", ground(np.random.default_rng(1), 500))
    one = prepared("first", clouds=[str(laz)], sigma_m=0.02, correlation_m=6.0)
    one.write(tmp_path / "points.npz", tmp_path / "errors.json")
    back = read_epoch(tmp_path)
    assert isinstance(back, ForeignEpoch)
    assert back.report() == one.report()
    places = one.xyz_m[::50]
    index = ColumnIndex.of(one.xyz_m, 0.8)
    how = {"radius_m": 0.8, "half_length_m": 2.0}
    normals = np.tile([0.0, 0.6, 0.8], (len(places), 1))
    fields = [each.field(places, normals, index, **how) for each in (one, back)]
    assert fields[0].variances() == pytest.approx(fields[1].variances())
    assert np.sqrt(fields[0].variances()) == pytest.approx(np.full(len(places), 0.02), rel=0.1)


# ---------------------------------------------------------------- errors


def test_volumes_and_distances_err_as_stated(tmp_path):
    """Errors by a dense Cholesky root, so that nothing of the field under test makes them."""
    rng = np.random.default_rng(11)
    length, sigma = 5.0, 0.03
    stated = {"sigma_m": sigma, "correlation_m": length}
    truth = ground(rng, 1800)
    first = prepared("first", clouds=[str(a_laz(tmp_path / "a.laz", truth))], **stated)
    second = replace(first, name="second", start_gps_s=first.start_gps_s + 1e7)
    cores = place_core_points([first, second], SETTINGS, Area())
    root = np.linalg.cholesky(
        np.exp(-cdist(first.xyz_m[:, :2], first.xyz_m[:, :2]) / length) + 1e-9 * np.eye(1800)
    )
    pairs = 20
    net, alarms, cells, z_dod = [], [], [], []
    for pair in range(pairs):
        noisy = [
            replace(each, xyz_m=truth + sigma * root @ rng.standard_normal((1800, 3)))
            for each in (first, second)
        ]
        motion = register_pair(measure_pair(cores, *noisy, SETTINGS), SETTINGS)
        table, compared, _ = compare_epochs(cores, *noisy, motion, SETTINGS, 1)
        sums, _ = estimate_volumes(table, compared, SETTINGS, 1)
        row = sums[sums["what"] == "net"].iloc[0]
        net.append(row["volume_m3"] / row["sigma_m3"])
        alarms.append((table["p_value"] < 0.05).sum() / table["p_value"].notna().sum())
        if pair < 15:
            found = difference_of_epochs(
                cores, *noisy, motion, SETTINGS, Area(), frame=FRAME, crs="EPSG:25833"
            )
            cells.append(np.nanmean((found.raster.height_m / found.sigma_m) ** 2))
            z_dod.append(found.volumes.loc[0, "volume_m3"] / found.volumes.loc[0, "sigma_m3"])
    low, high = chi2.ppf([1e-3, 1 - 1e-3], pairs) / pairs
    assert low < np.mean(np.square(net)) < high
    assert 0.022 < np.mean(alarms) < 0.078
    # some twenty independent values in each of 15 pairs
    assert np.mean(cells) == pytest.approx(1.0, abs=0.25)
    low, high = chi2.ppf([1e-3, 1 - 1e-3], len(z_dod)) / len(z_dod)
    assert low < np.mean(np.square(z_dod)) < high


def test_without_a_sigma_the_limit_is_roughness_alone_and_says_so(tmp_path):
    rng = np.random.default_rng(3)
    first, second = (
        prepared(name, clouds=[str(a_laz(tmp_path / f"{name}.laz", ground(rng)))], date_utc=day)
        for name, day in (("first", "2019-03-13"), ("second", "2020-03-13"))
    )
    check_order([first, second])
    cores = place_core_points([first, second], SETTINGS, Area())
    assert (cores["normal_up"] > 0.9).all()  # towards (0, 0, 1): there is no scanner
    motion = register_pair(measure_pair(cores, first, second, SETTINGS), SETTINGS)
    table, compared, _ = compare_epochs(cores, first, second, motion, SETTINGS, 1)
    assert (table["sigma_field_m"].dropna() == 0).all()
    assert table["sigma_m"].median() == pytest.approx(table["sigma_white_m"].median())
    notes = notes_of_pair(first, second, compared.pair.found.n)
    assert notes[-1] == (
        "No sigma is stated of first and second. Without sigmas of both clouds the level of detection is "
        "that of roughness alone: errors that the points of a cloud share are in no limit, and what counts "
        "as significant may be theirs."
    )
    assert notes[0] == "first: first.laz states no system of heights: taken as ellipsoidal."
    lines = estimate_volumes(table, compared, SETTINGS, 1)[0].set_index("what")
    assert lines.loc["net", "sigma_m3"] > 0


def test_nobody_knows_what_an_epoch_of_files_could_have_seen(tmp_path):
    rng = np.random.default_rng(3)
    whole = ground(rng)
    part = whole[(whole[:, 0] < 12.0)]
    first, second = (
        prepared(name, clouds=[str(a_laz(tmp_path / f"{name}.laz", xyz))])
        for name, xyz in (("a", whole), ("b", part))
    )
    cores = place_core_points([first, second], SETTINGS, Area())
    pair = measure_pair(cores, first, second, SETTINGS)
    places = pair.found
    seen = observe_visibility(places.cores_m, places.normals, places.n, (first, second), SETTINGS)
    unseen = cores["east_m"] > 13.5
    assert (seen.loc[unseen, "reason_2"] == "no trajectory").all()
    assert seen["seen_1"].all()


def test_a_boat_and_a_cloud_from_elsewhere_are_compared_towards_the_boat(tmp_path):
    rng = np.random.default_rng(5)
    before = epoch(bank(rng, 20_000), name="boat", sigma_m=0.01, noise_m=0.01)
    after = prepared(
        "scanner",
        clouds=[str(a_laz(tmp_path / "b.laz", bank(rng, 20_000) + np.array([0.0, 0.1, 0.0])))],
        sigma_m=0.005,
        correlation_m=10.0,
    )
    for pair in ((before, after), (after, before)):
        cores = place_core_points(list(pair), BANK, Area())
        assert (cores["normal_north"] < 0).mean() > 0.95  # the boat lies in the south
    settings = BANK.replace(registration="none")
    cores = place_core_points([before, after], settings, Area())
    found = measure_pair(cores, before, after, settings)
    table, _, _ = compare_epochs(cores, before, after, register_pair(found, settings), settings, 1)
    # 10 cm to the north are 7 cm back along a normal of 45 degrees
    assert table["distance_m"].median() == pytest.approx(-0.1 * np.sqrt(0.5), abs=0.02)
    assert {"position", "stated"} <= {group.name for group in found.field.groups}


# ---------------------------------------------------------------- what is refused


def test_files_of_another_grid_place_or_height_are_refused(tmp_path):
    local = ground(np.random.default_rng(1), 400)
    laz = str(a_laz(tmp_path / "a.laz", local))
    assert "ETRS89 / UTM zone 33N" in told(InputError, clouds=[laz], crs="EPSG:25832").found
    with pytest.raises(InputError, match="the campaign file ETRS89 / UTM zone 32N"):
        check_epoch_files(Epoch(clouds=[laz], crs="EPSG:25832"), FRAME, "EPSG:25833")
    swapped = tmp_path / "swapped.xyz"
    np.savetxt(swapped, FRAME.to_map(local, CRS_25833)[:, [1, 0, 2]], fmt="%.3f")
    assert "swapped" in told(GeometryError, clouds=[str(swapped)]).found
    far = Area(polygon_en_m=np.array([[500.0, 0.0], [509.0, 0.0], [509.0, 5.0]]))
    with pytest.raises(CoverageError, match=r"their middle is at east 11\.4, north 8\.0"):
        prepared("first", far, clouds=[laz])
    # normal heights beside ellipsoidal ones
    one = prepared("first", clouds=[laz])
    other = prepared("second", clouds=[laz], crs="EPSG:25833+7837", date_utc="2020-01-01")
    assert other.heights == "DHHN2016 height"
    with pytest.raises(InputError, match="'ellipsoidal', 'second' 'DHHN2016 height'"):
        check_order([one, other])
    with pytest.raises(InputError, match="at the same time"):
        check_order([one, replace(one, name="copy")])


def test_values_that_may_be_no_heights_are_masked_or_refused(tmp_path):
    local = ground(np.random.default_rng(1), 400)
    in_map = FRAME.to_map(local, CRS_25833)
    path = tmp_path / "a.xyz"
    for value, n in ((-10_000.0, 30), (0.0, 9)):
        broken = in_map.copy()
        broken[:n, 2] = value
        np.savetxt(path, broken, fmt="%.3f")
        if value:
            one = prepared("first", clouds=[str(path)])
            assert len(one.xyz_m) == 370
            assert any("30 rows with -10000, which stands for no value" in note for note in one.notes)
    broken[:30, 2] = 0.0
    np.savetxt(path, broken, fmt="%.3f")
    one = prepared("first", clouds=[str(path)])  # far from all others
    assert len(one.xyz_m) == 370
    assert any("30 rows with 0, which stands for no value" in note for note in one.notes)
    assert len(prepared("first", clouds=[str(path)], nodata=0.0).xyz_m) == 370
    # in a cloud about zero a height of zero is one of many
    flat = in_map - [0.0, 0.0, np.median(in_map[:, 2])]
    flat[:12, 2] = 0.0
    np.savetxt(path, flat, fmt="%.3f")
    assert len(prepared("first", clouds=[str(path)]).xyz_m) == 400


def test_empty_files_and_epochs_without_a_date_are_refused(tmp_path):
    empty = tmp_path / "a.laz"
    write_laz(empty, [], CRS_25833)
    with pytest.raises(InputError, match="a cloud without points"):
        check_epoch_files(Epoch(clouds=[str(empty)]), FRAME, "EPSG:25833")
    told(InputError, clouds=[str(empty)])
    (tmp_path / "b.xyz").write_text("x y z\n")
    told(InputError, clouds=[str(tmp_path / "b.xyz")])
    laz = str(a_laz(tmp_path / "c.laz", ground(np.random.default_rng(1), 50)))
    assert told(InputError, clouds=[laz], date_utc=None).cure == "Write date_utc"


def test_a_density_of_a_hundred_to_one_is_told(tmp_path):
    rng = np.random.default_rng(8)
    first = prepared("a", clouds=[str(a_laz(tmp_path / "a.laz", ground(rng, 200_000)))])
    second = prepared("b", clouds=[str(a_laz(tmp_path / "b.laz", ground(rng, 2000)))])
    cores = place_core_points([first, second], SETTINGS, Area())
    pair = measure_pair(cores, first, second, SETTINGS)
    notes = notes_of_pair(first, second, pair.found.n)
    assert any("The first cloud is 9" in note or "The first cloud is 10" in note for note in notes)


def test_epochs_that_do_not_overlap_are_refused(tmp_path):
    rng = np.random.default_rng(8)
    first = prepared("a", clouds=[str(a_laz(tmp_path / "a.laz", ground(rng)))])
    second = replace(
        first, name="b", xyz_m=first.xyz_m + np.array([0.0, 0.0, 40.0])
    )  # normal as ellipsoidal heights
    cores = place_core_points([first, second], SETTINGS, Area())
    with pytest.raises(GeometryError, match="Check that both have the same coordinate system, heights"):
        measure_pair(cores, first, second, SETTINGS)


def test_surface_models_without_a_grid_take_that_of_the_campaign(tmp_path):
    corner = (round(ORIGIN[0]), round(ORIGIN[1]))
    for name, lift in (("a", 0.0), ("b", 0.25)):
        height = np.full((9, 9), 301.0 + lift)
        a_tif(tmp_path / f"{name}.tif", height, keys=(1024, 0, 1, 1), corner=corner, cell=1.0)
    first, second = (
        Epoch(dsm=str(tmp_path / f"{name}.tif"), sigma_m=0.1, correlation_m=0.0) for name in ("a", "b")
    )
    found = difference_of_models(first, second, SETTINGS, "EPSG:25833")
    assert found.raster.frame == CRS_25833
    row = found.volumes.loc[0]
    assert (row.volume_m3, row.sigma_m3) == pytest.approx((20.25, 0.1 * np.sqrt(2.0) * 9.0))
    assert read_dsm(tmp_path / "a.tif").frame is None


# ---------------------------------------------------------------- a real beach


def beach_epoch(data_dir: Path, day: str, **more: Any) -> Epoch:
    """A survey of Marengo as a campaign file states it, without the water of that day."""
    folder = data_dir / "sandpyper_dsm"
    return Epoch(
        dsm=str(folder / f"dsm_1m/mar_{day}_dsm_resampled_1m.tif"),
        date_utc=f"{day[:4]}-{day[4:6]}-{day[6:]}",
        correlation_m=20.0,
        leave_out=[f"{folder}/clean/watermasks.gpkg?location=mar,raw_date={day}"],
        **{"sigma_m": 0.02} | more,
    )


@pytest.mark.real
def test_the_beach_has_the_same_volumes_as_epochs_of_a_campaign(data_dir):
    """The figures of `test_volumes_of_the_beach_without_water`, from what a campaign file states."""
    first, second = (
        beach_epoch(data_dir, day, sigma_m=0.0213 / np.sqrt(2.0)) for day in ("20180727", "20180925")
    )
    row = difference_of_models(first, second, SETTINGS, "EPSG:32754").volumes.loc[0]
    assert (row.n_cells, row.volume_m3, row.sigma_m3) == pytest.approx((45_498, 6668.8, 192.2), abs=0.05)


@pytest.mark.real
def test_the_march_survey_of_the_beach_is_flagged_by_a_campaign(data_dir):
    place, map_crs = LocalFrame(lat_deg=-38.77, lon_deg=143.6648, h_ell_m=3.0), "EPSG:32754"
    settings = Deformation(
        core_spacing_m=4.0, scales_m=[4.0], cylinder_radius_m=2.5, reach_m=3.0, registration="none"
    )
    epochs = [
        prepare_foreign_epoch(
            day, beach_epoch(data_dir, day), frame=place, crs=map_crs, area=EVERYWHERE, margin_m=4.0
        )
        for day in ("20190205", "20190313", "20190516")
    ]
    check_order(epochs)
    assert "without a height (undeclared value -10000)" in epochs[0].notes[0]
    found = series_of_epochs(place_core_points(epochs, settings, EVERYWHERE), epochs, settings)
    # the mean of an area of some ten correlation lengths is known better than a place
    assert (found.sigma_apart_m < 0.015).all()
    (jump,) = find_jumps(found.raw_m, found.sigma_apart_m, limit=2.0)
    assert jump.flagged
    # cells of all surveys: +0.149 and -0.19 m where the water of each day is left out
    assert jump.before_m == pytest.approx(0.13, abs=0.03)
    assert jump.after_m == pytest.approx(-0.18, abs=0.03)
    assert found.misclosure.largest_m < 1e-9  # all distances are along the same normals


def test_cells_of_models_are_core_points_that_look_up():
    table = _as_cores(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), 0.5).fillna(-1)
    assert list(table.columns) == CORE_POINTS.names
    assert table.to_numpy().tolist() == [
        [0, 1, 1, 2, 3, 0, 0, 1, -1, 0.25, 0],
        [1, 1, 4, 5, 6, 0, 0, 1, -1, 0.25, 0],
    ]
