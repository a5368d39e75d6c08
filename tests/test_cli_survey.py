"""`thalweg ppk` and `georeference`: tracks and clouds of other people's recordings, without a campaign."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import laspy
import numpy as np
import pandas as pd
import pytest

from thalweg.cli import main
from thalweg.core import gps_from_unix, unix_from_gps
from thalweg.ingest import LidarOptions
from thalweg.ingest.registry import lidar_reader

pytestmark = pytest.mark.real


@pytest.fixture(scope="module")
def words(data_dir):
    """The command but for its target: Septentrio rover, GEONET base 5.3 km away, published base position."""
    k = data_dir / "rinex_cssrlib_kinematic_2021"
    return [
        "ppk",
        str(k / "SEPT265G.21O"),
        *("--base", str(k / "3034265G.21O"), "--nav", str(k / "SEPT2650.21P")),
        *("--base-ecef", "-3959400.631", "3385704.533", "3667523.111"),
        *("--systems", "GPS", "GAL", "QZS"),
    ]


def test_a_track_with_its_page(words, tmp_path, capsys):
    assert main([*words, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "348 fixed, 12 float" in said
    assert "baseline 5.32 km" in said
    table = pd.read_csv(tmp_path / "positions.csv")
    assert len(table) == 360
    # at rest for 45 s at the published start; 24 mm is what the public solution leaves
    start = table[(table["fix"] == "fixed")].iloc[5]
    assert abs(start["lat_deg"] - 35.342058098) * 111_320 < 0.05
    assert abs(start["h_ell_m"] - 47.5515) < 0.06
    # 1 mm/km of 5.3 km stands in every sigma
    assert (table["sigma_east_m"] > 0.0053).all()
    assert table[table["fix"] == "fixed"]["sigma_up_m"].between(0.0106, 0.25).all()
    facts = json.loads((tmp_path / "ppk.json").read_text())
    assert facts["n_fixes_refused"] == {"baseline": 0, "duration": 0, "float": 0}
    lines = json.loads((tmp_path / "positions.geojson").read_text())["features"]
    assert {line["properties"]["fix"] for line in lines} == {"fixed", "float"}
    names = [e.text for e in ET.parse(tmp_path / "positions.kml").iter() if e.tag.endswith("name")]
    assert names[0] == "SEPT265G.21O"
    page = (tmp_path / "index.html").read_text()
    assert page.count("data:image/png") == 2
    assert "96.7 % of 360 epochs have fixed ambiguities" in page


def test_a_base_that_is_farther_than_trusted(words, tmp_path, capsys):
    head, *epochs = Path(words[1]).read_text().split("\n> ")
    rover = tmp_path / "rover.21O"
    rover.write_text("\n> ".join([head, *epochs[:60]]) + "\n")
    command = ["ppk", str(rover), *words[2:], "--trusted-baseline", "5", "--out", str(tmp_path / "out")]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert "0 fixed, 60 float" in said
    assert "48 fixes refused" in said
    assert "48 fixed epochs count as float: the baseline is longer" in said
    table = pd.read_csv(tmp_path / "out/positions.csv")
    assert (table["fix"] == "float").all()
    assert table["sigma_up_m"].median() > 0.05


CAPTURE = "vlp16_mrpt_gps/sample_velodyne_vlp16_gps.pcap"
"""0.4 s of a VLP-16 with GPS time."""
WITHOUT_GPS = "vlp16_veloview/vlp-16-test-90deg-1-50-frames.pcap"
BODY = ["--body-axes", "forward-right-down", "--time-scale", "utc", "--upside-down"]


def still(path: Path, first_gps_s: float, last_gps_s: float) -> Path:
    """Poses of a body at rest whose axes are those of the local frame, as a TUM table."""
    t = [float(unix_from_gps(s)) for s in np.arange(first_gps_s - 1.0, last_gps_s + 1.0, 0.1)]
    np.savetxt(path, np.column_stack([t, np.zeros((len(t), 6)), np.ones(len(t))]), fmt="%.6f")
    return path


def georeference(capture: Path, poses: Path, out: Path, *more: str) -> int:
    """The command for a lidar 0.1 m before and 0.2 m above the body's origin."""
    known = ["--sigma-position", "0.02", "--sigma-attitude", "0.1", "--origin", "51.05", "13.25", "200"]
    mount = ["--lever", "0.1", "0", "-0.2", "--angles", "0", "-90", "0", "--sigma-lever", "0.001"]
    words = ["georeference", str(capture), "--trajectory", str(poses), *BODY, *known, *mount, *more]
    return main([*words, "--out", str(out)])


def test_a_capture_and_a_table_of_poses_make_a_cloud(data_dir, tmp_path):
    reader = lidar_reader([data_dir / CAPTURE], LidarOptions())
    scan = reader.scan()
    poses = still(tmp_path / "poses.tum", scan.report.t_first_s, scan.report.t_last_s)
    out = tmp_path / "cloud.laz"
    assert georeference(data_dir / CAPTURE, poses, out, "--crs", "EPSG:25833") == 0
    facts = json.loads((tmp_path / "cloud.json").read_text())["points"]
    assert sum(facts.values()) == scan.n_points == 73_486
    block = next(iter(reader.points(scan.clock)))
    near = block.range_m >= 1.0
    # omega, kappa 0 and phi -90 degrees: z of the scanner points backwards along x of the body, x along z
    x, y, z = block.xyz_scs_m[near].astype(np.float64).T
    expected = np.column_stack([-z + 0.1, y, x - 0.2])
    with laspy.open(out) as file:
        points = file.read()
    n = min(len(expected), len(points))
    got = np.column_stack([points.x, points.y, points.z])
    assert np.abs(got[:n] - expected[:n]).max() < 1e-3
    # 2 cm of position, 0.1 and 0.2 degrees of attitude and mount over the range, millimetres of the beam
    turned = np.deg2rad(np.hypot(0.1, 0.2)) * np.asarray(points["range"])
    sigma = np.asarray(points["sigma_up"])
    assert (sigma > 0.02).all()
    assert (sigma < np.hypot(0.05, turned) + 0.01).all()
    with laspy.open(tmp_path / "cloud_map.laz") as file:
        assert file.header.parse_crs().to_epsg() == 25833


def test_a_lidar_without_gps_takes_the_time_of_its_first_packet(data_dir, tmp_path, capsys):
    start = float(gps_from_unix(1_600_000_000.0))
    poses = still(tmp_path / "poses.tum", start, start + 6.0)
    out = tmp_path / "cloud.laz"
    vlp = ("--model", "VLP-16")  # its old firmware names another model
    assert georeference(data_dir / WITHOUT_GPS, poses, out, *vlp) == 2
    assert "Give the time of the first packet (--first-packet)" in capsys.readouterr().err
    assert (
        georeference(data_dir / WITHOUT_GPS, poses, out, *vlp, "--first-packet", "2020-09-13T12:26:40") == 2
    )
    assert "names no zone" in capsys.readouterr().err
    assert (
        georeference(data_dir / WITHOUT_GPS, poses, out, *vlp, "--first-packet", "2020-09-13T12:26:40Z") == 0
    )
    with laspy.open(out) as file:
        times = np.asarray(file.read()["gps_time"])
    assert times.min() == pytest.approx(start, abs=0.01)
    assert json.loads((tmp_path / "cloud.json").read_text())["points"]["no_pose"] == 0


def test_a_trajectory_without_sigmas_is_refused(data_dir, tmp_path, capsys):
    poses = still(tmp_path / "poses.tum", 1e9, 1e9 + 1)
    words = [
        "georeference",
        str(data_dir / CAPTURE),
        "--trajectory",
        str(poses),
        *BODY,
        "--lever",
        "0",
        "0",
        "0",
    ]
    assert main([*words, "--origin", "51", "13", "200", "--out", str(tmp_path / "x.laz")]) == 2
    assert "standard deviation" in capsys.readouterr().err
    assert not (tmp_path / "x.laz").exists()
