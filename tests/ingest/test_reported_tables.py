"""Tables, clouds and NMEA logs with traits of public bug reports: the right value, or why not."""

import numpy as np
import pytest
from pyproj import CRS

from thalweg.bathymetry import read_soundings
from thalweg.core import InputError
from thalweg.deformation import Comparison
from thalweg.deformation.foreign import compare_clouds
from thalweg.ingest.clouds import read_cloud

pytestmark = pytest.mark.real


@pytest.fixture
def reports(data_dir):
    folder = data_dir / "reports_logs"
    if not folder.is_dir():
        pytest.skip("no reports_logs beside the recordings")
    return folder


@pytest.mark.parametrize(
    ("name", "n", "low", "high"),
    [
        ("csv_with_bom_and_crlf/excel_utf8.csv", 210, -3.04, -0.49),
        ("decimal_comma/excel_all_rows.csv", 210, -3.04, -0.49),
        ("decimal_comma/excel_some_rows_whole.csv", 210, -3.0, -0.5),
        ("depth_units_in_names/WaterDepthFt.csv", 210, -3.04, -0.49),
        ("depth_units_in_names/depth_cm.csv", 210, -3.04, -0.49),
        ("soundings_nodata_9999/depth_-9999.csv", 190, -3.04, -0.49),
        ("soundings_nodata_9999/height_-9999.csv", 190, 96.96, 99.51),
    ],
)
def test_soundings(reports, name, n, low, high):
    """Numbers of soundings, and their range as the table in metres has it; feet are rounded to 3 mm."""
    found = read_soundings(
        reports / name, CRS(32633), column=None, depth=None, level_m=None, line_column="line", sigma_m=0.02
    )
    assert len(found.height_m) == n
    assert (found.height_m.min(), found.height_m.max()) == pytest.approx((low, high), abs=0.01)


@pytest.mark.parametrize(
    ("folder", "before", "after", "mean_m"),
    [
        ("text_columns_by_name", "fid_x_y_z_before.csv", "fid_x_y_z_after.csv", -0.0966),
        ("text_columns_by_name", "northing_easting_before.csv", "northing_easting_after.csv", -0.0966),
        ("las_heights_in_feet", "before.laz", "after.laz", -0.0966),
        ("las_withheld_points", "before.laz", "after.laz", -0.0955),
    ],
)
def test_changes_of_clouds(reports, folder, before, after, mean_m):
    table, _, _ = compare_clouds(reports / folder / before, reports / folder / after, Comparison())
    assert table["distance_m"].mean() == pytest.approx(mean_m, abs=2e-4)
    assert table["north_m"].median() == pytest.approx(5_650_007, abs=10.0)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("decimal_comma/comma_before.txt", "decimal commas in a table that commas separate"),
        ("text_in_degrees/lon_lat_before.xyz", "look like degrees"),
    ],
)
def test_clouds_that_are_refused(reports, name, words):
    path = reports / name
    with pytest.raises(InputError, match=words) as told:
        compare_clouds(path, path, Comparison())
    assert told.value.cure


def test_scan_without_rotation(reports):
    cloud = read_cloud(reports / "e57_zero_quaternion" / "scan.e57")
    assert len(cloud.points) == 500
    assert np.median(cloud.points, axis=0) == pytest.approx([412_000, 5_650_000, 150], abs=20.0)
    assert any("which is no rotation" in note for note in cloud.report.notes)


@pytest.mark.parametrize(
    ("name", "words"),
    [("all_zero.laz", "All times are 0"), ("week_values_standard_flag.laz", "unstated GPS week")],
)
def test_times_of_clouds_that_are_none(reports, name, words):
    cloud = read_cloud(reports / "las_times_that_are_none" / name)
    assert cloud.t_gps_s is None
    assert any(words in note for note in cloud.report.notes)
