"""Clouds of others compared: files, frames, states, levels of detection, the command."""

from pathlib import Path

import numpy as np
import pandas as pd
import pye57
import pytest
from pyproj import CRS
from scipy.ndimage import binary_erosion

from tests.bands import band
from tests.las_files import write_laz
from thalweg.cli import main
from thalweg.core import ArrayF, GeometryError, InputError, LocalFrame, read_dsm, read_table
from thalweg.core.las import read_laz
from thalweg.core.raster import Grid, write_raster
from thalweg.deformation import CLOUD_TO_CLOUD, Comparison, cloud_to_cloud
from thalweg.deformation.compare import CHANGES, measure_distances
from thalweg.deformation.foreign import compare_clouds
from thalweg.deformation.foreign.clouds import Points, compare_with_surface, read_points, sigma_of_mean
from thalweg.deformation.foreign.surfaces import one_frame
from thalweg.settings.sections import ReferenceSettings

OPTIONS = Comparison(scales_m=(1.0,), radius_m=0.8, half_length_m=3.0)


def ground(seed: int, lift: float = 0.0) -> ArrayF:
    """A plane of 30 m x 20 m with noise of 1 cm; the part east of 20 m is lifted."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, (30.0, 20.0), (6000, 2))
    z = 0.1 * xy[:, 0] + rng.normal(0.0, 0.01, len(xy)) + np.where(xy[:, 0] > 20.0, lift, 0.0)
    return np.column_stack([xy[:, 0] + 440_000.0, xy[:, 1] + 5_640_000.0, z])


def a_file(path: Path, xyz: ArrayF, epsg: int | None = 25833) -> Path:
    write_laz(path, [{"xyz_m": xyz}], CRS.from_epsg(epsg) if epsg else None)
    return path


def test_erosion_and_deposition_are_found_where_they_are(tmp_path):
    before, after = a_file(tmp_path / "a.laz", ground(1)), a_file(tmp_path / "b.laz", ground(2, -0.08))
    table, frame, notes = compare_clouds(
        before, after, OPTIONS, core_every=20, sigma_m=(0.01, 0.01), sigma_registration_m=0.005
    )
    assert isinstance(frame, CRS)
    assert notes == []
    inner = table["east_m"].between(440_001, 440_018.5)
    lowered = table["east_m"].between(440_021.5, 440_029)
    # along a normal that leans by 5.7 degrees
    assert table.loc[lowered, "distance_m"].mean() == pytest.approx(-0.08 * np.cos(np.arctan(0.1)), abs=0.002)
    assert (table.loc[lowered, "state"] == "erosion").all()
    assert (table.loc[inner, "state"] == "no significant change").mean() > 0.95
    assert table["sigma_field_m"].dropna().to_numpy() == pytest.approx(0.01 * np.sqrt(2.0))
    assert table["sigma_registration_m"].dropna().to_numpy() == pytest.approx(0.005)
    total = np.sqrt(
        table["sigma_field_m"] ** 2 + table["sigma_white_m"] ** 2 + table["sigma_registration_m"] ** 2
    )
    assert table["sigma_m"].dropna().to_numpy() == pytest.approx(total.dropna().to_numpy())
    assert table["lod95_m"].dropna().to_numpy() == pytest.approx(
        1.959964 * total.dropna().to_numpy(), rel=1e-6
    )
    back, _, _ = compare_clouds(after, before, OPTIONS, core_every=20, sigma_m=(0.01, 0.01))
    assert (back.loc[back["east_m"].between(440_021.5, 440_029), "state"] == "deposition").all()


def test_white_noise_keeps_its_level_without_change(tmp_path):
    """Without shared errors roughness is all there is: 5 % of the core points, or no discovery."""
    before, after = a_file(tmp_path / "a.laz", ground(3)), a_file(tmp_path / "b.laz", ground(4))
    options = Comparison(scales_m=(2.0,), radius_m=0.5, half_length_m=3.0, control="none")
    table, _, notes = compare_clouds(before, after, options, core_every=5)
    assert "roughness alone" in notes[0]
    # some 400 cylinders stand apart: 5 % +- 1.1 %; normals of edges lean and add to it
    assert 0.025 < table["significant"].mean() < 0.085
    controlled, _, _ = compare_clouds(
        before, after, Comparison(scales_m=(2.0,), radius_m=0.5, half_length_m=3.0), core_every=5
    )
    assert controlled["significant"].mean() < 0.01


def test_places_that_an_epoch_has_not_seen_are_no_erosion(tmp_path):
    full, part = ground(1), ground(2)
    part = part[part[:, 0] < 440_015.0]
    before, after = a_file(tmp_path / "a.laz", full), a_file(tmp_path / "b.laz", part)
    table, _, _ = compare_clouds(before, after, OPTIONS, core_every=20, sigma_m=(0.01, 0.01))
    gone = table["east_m"] > 440_016.5
    assert (table.loc[gone, "state"] == "not seen in second").all()
    assert table.loc[gone, "distance_m"].isna().all()


@pytest.mark.parametrize("tiles", [3, 7])
def test_pieces_make_the_same_distances(tiles):
    place = np.array([440_000.0, 5_640_000.0, 0.0])
    before, after = ground(1) - place, ground(2, -0.08) - place
    after = after[after[:, 0] < 25.0]  # the last pieces have no points of the second epoch
    up = np.array([0.0, 0.0, 1.0])
    whole, parts = (
        measure_distances(before[::7], before, after, OPTIONS, towards=up, tiles=each) for each in (1, tiles)
    )
    assert (parts.n == whole.n).all()
    for name in ("normals", "scale_m", "distance_m", "roughness_m"):
        assert getattr(parts, name) == pytest.approx(getattr(whole, name), abs=1e-12, nan_ok=True)
    assert np.isnan(whole.distance_m).any()


def test_other_frames_and_clouds_apart_are_refused(tmp_path):
    before = a_file(tmp_path / "a.laz", ground(1))
    with pytest.raises(InputError, match=r"UTM zone 33N.*UTM zone 32N.*one coordinate system"):
        compare_clouds(before, a_file(tmp_path / "b.laz", ground(2), epsg=25832), OPTIONS)
    feet = a_file(tmp_path / "b.laz", ground(2), epsg=2225)
    with pytest.raises(InputError, match=r"coordinates in US survey foot; expected .* in metres"):
        compare_clouds(before, feet, OPTIONS)
    apart = a_file(tmp_path / "c.laz", ground(2) + np.array([0.0, 0.0, 45.0]))
    with pytest.raises(GeometryError, match=r"none of 120 core points has enough points of both epochs"):
        compare_clouds(before, apart, OPTIONS)


def test_single_points_have_no_sigma_and_no_verdict(tmp_path):
    """A cylinder with one point has no roughness: nothing is known of such a distance."""
    before, after = a_file(tmp_path / "a.laz", ground(1)), a_file(tmp_path / "b.laz", ground(2, 3.0)[::20])
    options = Comparison(scales_m=(2.0,), radius_m=0.8, half_length_m=5.0, least_points=1)
    table, _, _ = compare_clouds(before, after, options, core_every=5, sigma_m=(0.01, 0.01))
    single = (table["n_after"] == 1) & (table["n_before"] > 0)
    assert single.sum() > 50
    assert table.loc[single, "sigma_m"].isna().all()
    assert (table.loc[single, "state"] == "no sigma").all()
    assert not table.loc[single, "significant"].any()


@pytest.mark.parametrize("every", ["0", "-3", "some"])
def test_core_points_at_each_none_are_refused(every, tmp_path, capsys):
    before = a_file(tmp_path / "a.laz", ground(1))
    with pytest.raises(SystemExit):
        main(["compare-clouds", str(before), str(before), "-o", "x.csv", "--core-every", every])
    assert f"'{every}'; expected a whole number, 1 or more" in capsys.readouterr().err
    with pytest.raises(InputError, match="1 or more"):
        compare_clouds(before, before, OPTIONS, core_every=0)


def test_an_empty_cloud_is_refused(tmp_path):
    before, empty = a_file(tmp_path / "a.laz", ground(1)), tmp_path / "b.laz"
    empty.write_bytes(b"")
    with pytest.raises(InputError, match=r"b\.laz"):
        compare_clouds(before, empty, OPTIONS)


@pytest.mark.parametrize("head", ["", "x y z\n", "# cloud\nX,Y,Z\n"])
def test_tables_of_coordinates_are_read(tmp_path, head):
    mark = "," if "," in head else " "
    path = tmp_path / "points.xyz"
    path.write_text(head + f"1.5{mark}2{mark}3{mark}7\n4{mark}5{mark}6{mark}8\n")
    assert read_points(path).xyz_m.tolist() == [[1.5, 2.0, 3.0], [4.0, 5.0, 6.0]]
    path.write_text(head)
    with pytest.raises(InputError, match=r"the file is empty|no point"):
        read_points(path)


def test_the_command_writes_what_it_prints(tmp_path, capsys):
    before, after = a_file(tmp_path / "a.laz", ground(1)), a_file(tmp_path / "b.laz", ground(2, 0.3))
    words = [
        "compare-clouds",
        str(before),
        str(after),
        "--sigma-a",
        "0.01",
        "--sigma-b",
        "0.01",
        "--scales",
        "1,2",
    ]
    tables = []
    for suffix in ("csv", "parquet", "laz"):
        out = tmp_path / f"changes.{suffix}"
        assert main([*words, "-o", str(out)]) == 0
        printed = capsys.readouterr().out
        assert f"Wrote {out}" in printed
        assert "deposition: " in printed
        tables.append(out)
    csv = pd.read_csv(tables[0])
    parquet, _ = read_table(tables[1], CHANGES)
    pd.testing.assert_frame_equal(csv, parquet, check_dtype=False, rtol=1e-12)
    columns, header = read_laz(tables[2])
    assert columns["distance_m"] == pytest.approx(parquet["distance_m"].to_numpy(), nan_ok=True)
    assert header.extra_dimensions["lod95_m"][1] == "m"
    assert main([*words, "-o", str(tmp_path / "changes.txt")]) == 2
    assert "suffix '.txt'" in capsys.readouterr().err


def test_the_sigma_of_a_mean_is_that_of_all_pairs(tmp_path, capsys):
    before, after = a_file(tmp_path / "a.laz", ground(1)), a_file(tmp_path / "b.laz", ground(2))
    table, _, _ = compare_clouds(
        before, after, OPTIONS, core_every=10, sigma_m=(0.03, 0.04), sigma_registration_m=0.01
    )
    known = table.dropna(subset=["sigma_m"])
    place = known[["east_m", "north_m", "up_m"]].to_numpy()
    lag = np.linalg.norm(place[:, None] - place[None], axis=2)
    for length in (2.0, 8.0):
        field = 0.05**2 * np.exp(-lag / length).mean()
        found = sigma_of_mean(table, OPTIONS.radius_m, length)
        noise = (known["sigma_white_m"] ** 2).sum() / len(known) ** 2
        assert found**2 == pytest.approx(field + 0.01**2 + noise, rel=0.02)
    # the noise of the mean: clouds drawn anew, nothing shared
    drawn = []
    for seed in range(30, 42):
        one = a_file(tmp_path / "c.laz", ground(seed)), a_file(tmp_path / "d.laz", ground(seed + 100))
        again, _, _ = compare_clouds(*one, OPTIONS, core_every=10, sigma_m=(0.0, 0.0))
        drawn.append(again["distance_m"].mean() / sigma_of_mean(again, OPTIONS.radius_m, 1.0))
    low, high = band(len(drawn))
    assert low < np.mean(np.square(drawn)) < high
    words = ["compare-clouds", str(before), str(after), "-o", str(tmp_path / "e.csv"), "--scales", "1"]
    assert main([*words, "--sigma-a", "0.03", "--sigma-b", "0.04", "--correlation-m", "8"]) == 0
    assert "standard deviation of the mean of 0.0" in capsys.readouterr().out


def test_frames_are_one_if_they_are_equal(tmp_path):
    """Two local frames of one origin are one; of two origins, or beside a map grid, they are not."""
    here = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
    again = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
    other = LocalFrame(lat_deg=51.06, lon_deg=13.25, h_ell_m=300.0)
    one, same, else_, none = (
        Points(np.zeros((1, 3)), frame, tmp_path / name)
        for frame, name in ((here, "a"), (again, "b"), (other, "c"), (None, "d"))
    )
    assert one_frame([one, same]) == (here, [])
    found, notes = one_frame([one, none])
    assert found == here
    assert "d: taken as that of the other" in notes[0]
    assert one_frame([none, none])[0] is None
    for wrong in (else_, Points(np.zeros((1, 3)), CRS.from_epsg(25833), tmp_path / "e")):
        with pytest.raises(InputError, match="states a local frame"):
            one_frame([one, wrong])


def test_points_without_all_coordinates_are_left_out(tmp_path):
    path = tmp_path / "cloud.xyz"
    path.write_text("1 2 3\n4 5 nan\n6 7 8\n")
    found = read_points(path)
    assert found.xyz_m.tolist() == [[1, 2, 3], [6, 7, 8]]
    assert (found.frame, found.path) == (None, path)
    laz = a_file(tmp_path / "cloud.laz", ground(1)[:7])
    cloud = read_points(laz)
    assert (cloud.xyz_m.shape, cloud.path) == ((7, 3), laz)
    assert isinstance(cloud.frame, CRS)


@pytest.mark.parametrize(("share", "told"), [(15, False), (25, True)])
def test_from_twenty_times_the_density_on_it_is_told(tmp_path, share, told):
    """One cloud on a raster of 0.2 m, the other with every 15th or 25th of its points."""
    raster = np.stack(np.meshgrid(np.arange(0, 30, 0.2), np.arange(0, 20, 0.2)), axis=-1).reshape(-1, 2)
    dense = np.column_stack([raster + np.array([440_000.0, 5_640_000.0]), 0.01 * np.sin(7 * raster[:, 0])])
    thin = np.random.default_rng(1).permutation(dense)[: len(dense) // share]
    wide = Comparison(scales_m=(1.0,), radius_m=2.0, half_length_m=3.0)
    for first, second, word in ((dense, thin, "first"), (thin, dense, "second")):
        files = a_file(tmp_path / "a.laz", first), a_file(tmp_path / "b.laz", second)
        notes = compare_clouds(*files, wide, core_every=9, sigma_m=(0.01, 0.01))[2]
        assert any(f"The {word} cloud is" in note for note in notes) is told


def test_distances_to_nearest_points_and_to_their_plane(tmp_path, capsys):
    """By brute force; no change is no zero, and a lift is seen where it exceeds the spacing."""
    before, after = ground(1)[:3000], ground(2, 0.5)[:400]
    table = cloud_to_cloud(before, after, towards=np.array([0.0, 0.0, 1.0]))
    apart = np.linalg.norm(after[:, None] - before[None], axis=2)
    assert table["distance_m"].to_numpy() == pytest.approx(apart.min(axis=1), abs=1e-9)
    first = apart.argmin(axis=1)
    own = np.sort(np.linalg.norm(before[first][:, None] - before[None], axis=2), axis=1)[:, 1]
    assert table["spacing_m"].to_numpy() == pytest.approx(own, abs=1e-9)
    inner = table["east_m"].between(440_001, 440_018)
    lifted = table["east_m"].between(440_022, 440_029)
    assert table.loc[inner, "distance_m"].mean() > 0.1  # 0.45 m between points, and no change
    assert table.loc[inner, "plane_distance_m"].mean() == pytest.approx(0.0, abs=0.003)
    along = 0.5 * np.cos(np.arctan(0.1))
    assert table.loc[lifted, "plane_distance_m"].mean() == pytest.approx(along, abs=0.01)
    down = cloud_to_cloud(before, after, towards=np.array([0.0, 0.0, -1.0]))
    assert down.loc[lifted, "plane_distance_m"].mean() == pytest.approx(-along, abs=0.01)
    with pytest.raises(GeometryError, match="3 points in the first epoch"):
        cloud_to_cloud(before[:3], after, towards=np.array([0.0, 0.0, 1.0]))

    files = a_file(tmp_path / "a.laz", before), a_file(tmp_path / "b.laz", after)
    out = tmp_path / "nearest.parquet"
    words = ["compare-clouds", *map(str, files), "--method", "c2c", "-o", str(out), "--core-every", "2"]
    assert main(words) == 0
    assert "note: Points of the first cloud lie 0.2" in capsys.readouterr().out
    found = read_table(out, CLOUD_TO_CLOUD)[0]
    assert found[["east_m", "north_m", "up_m"]].to_numpy() == pytest.approx(after[::2], abs=0.001)
    assert main([*words, "--force", "--sigma-a", "0.01"]) == 2
    assert "Use --method m3c2" in capsys.readouterr().err


# ---------------------------------------------------------------- any cloud beside any reference


@pytest.mark.real
def test_a_surface_model_is_a_reference(data_dir):
    """Two epochs of the beach of Sandpyper: distances from the raster of the first, as libigl has them.

    libigl 2.6: mean of the sizes 0.424067 m, root mean square 0.648226 m, over 72,402 points three cells and
    more within both; CloudCompare 2.11: signed mean -0.037716 m, with another sign at one point in 5000.
    """
    folder = data_dir / "sandpyper_dsm" / "dsm_1m"
    first, second = (folder / f"mar_{day}_dsm_resampled_1m.tif" for day in ("20180727", "20180925"))
    table, frame, facts, notes = compare_with_surface(
        second, first, ReferenceSettings(sigma_m=0.03), max_distance_m=1000.0
    )
    assert frame is not None
    assert facts["counts"]["points"] == len(table) == 83_438
    assert "undeclared value -10000" in notes[0]
    before, after = read_dsm(first), read_dsm(second)
    both = np.isfinite(before.height_m) & np.isfinite(after.height_m)
    inside = binary_erosion(both, iterations=3)[np.isfinite(after.height_m)]
    d = table["distance_m"].to_numpy()[inside]
    assert len(d) == 72_402
    assert np.abs(d).mean() == pytest.approx(0.424067, abs=1e-6)
    assert np.sqrt(np.mean(d**2)) == pytest.approx(0.648226, abs=1e-6)
    assert d.mean() == pytest.approx(-0.038149, abs=1e-6)
    assert not table["at_border"].to_numpy()[inside].any()
    assert (table["sigma_reference_m"] == 0.03).all()


@pytest.mark.parametrize("suffix", ["e57", "pcd", "ply", "laz", "tif"])
def test_a_cloud_of_any_format_has_the_same_distances(tmp_path, suffix):
    """A slope of 1:10 and points 5 cm above it: 5 cm / sqrt(1.01) in each format, of cloud and reference."""
    frame = CRS.from_epsg(25833)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(20.5, 60.5), np.arange(60.5, 20.5, -1.0)))
    slope = np.column_stack([x, y, 100.0 + 0.1 * x])
    reference = as_file(tmp_path / f"reference.{suffix}", slope, frame)
    cloud = as_file(tmp_path / f"cloud.{suffix}", slope + np.array([0.0, 0.0, 0.05]), frame)
    settings = ReferenceSettings(cell_m=0.5, longest_edge_m=5.0, isolated_radius_m=5.0)
    table, _, facts, _ = compare_with_surface(cloud, reference, settings)
    used = table[table["used"]]
    assert facts["counts"]["points"] == 1600
    assert len(used) > 1300
    # steps of 1 mm (LAZ), 8 micrometres (single precision at 100 m) in both files
    tolerance = 1.1e-3 if suffix == "laz" else 3e-5
    np.testing.assert_allclose(used["distance_m"], 0.05 / np.sqrt(1.01), atol=tolerance)


def as_file(path: Path, points: np.ndarray, frame: CRS) -> Path:
    """Points (n, 3), a raster of 40 x 40 row by row, as a file of the suffix's format."""
    match path.suffix:
        case ".e57":
            with pye57.E57(str(path), mode="w") as file:
                file.write_scan_raw({f"cartesian{a}": points[:, k].copy() for k, a in enumerate("XYZ")})
        case ".pcd":
            head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
            rows = "\n".join(" ".join(map(repr, row)) for row in points.tolist())
            n = len(points)
            path.write_text(f"{head}WIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA ascii\n{rows}\n")
        case ".ply":
            head = "property double x\nproperty double y\nproperty double z\nend_header\n"
            rows = "\n".join(" ".join(map(repr, row)) for row in points.tolist())
            path.write_text(f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{head}{rows}\n")
        case ".laz":
            write_laz(path, [{"xyz_m": points}], frame)
        case ".tif":
            grid = Grid(west_m=20.0, north_m=61.0, cell_m=1.0, rows=40, columns=40, crs=frame)
            write_raster(path, grid, {"height": points[:, 2].reshape(40, 40)})
    return path
