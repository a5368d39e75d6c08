"""The examples of `config/campaigns/examples`: one for each kind of recording, on real files."""

import json
import re
import shutil

import laspy
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.golden.kept_numbers import EXAMPLES, RECORDINGS, moved_since_kept, with_examples
from thalweg.cli import main
from thalweg.core import gps_from_unix, unix_from_gps
from thalweg.figures.front import LEADS
from thalweg.settings import load_campaign

pytestmark = [pytest.mark.workflow, pytest.mark.real]
WHOLE = tuple(name for name, made in RECORDINGS.items() if "index.html" in made)
"""Run to their front page. `soundings` is in test_subsets."""


@pytest.fixture(scope="module")
def examples(repository, tmp_path_factory, house_builder, data_dir):
    """A copy of the repository in which the examples ran."""
    house = house_builder(repository, tmp_path_factory.mktemp("examples"))
    campaign, targets = with_examples(house.root, data_dir)
    house.snakemake(*targets, "--config", f"campaign={campaign}")
    return house


def test_each_file_is_checked_and_says_what_it_gives(examples, capsys):
    files = sorted((examples.root / EXAMPLES).glob("*.yaml"))
    files = [file for file in files if file.stem != "sbet_photographs"]  # logs of the twin, in test_tiny
    assert len(files) == len(RECORDINGS) + 1
    assert main(["check-config", *map(str, files)]) == 0
    text = capsys.readouterr().out
    assert text.count(": ok. ") == text.count("\n  gives: ") == len(files)


@pytest.mark.parametrize("name", RECORDINGS)
def test_no_number_has_moved_unseen(examples, name):
    """Results of each example beside the tables that are kept (`tests/golden/kept_numbers.py`)."""
    assert moved_since_kept(examples.root / "results" / name) == []


@pytest.mark.parametrize("name", WHOLE)
def test_the_front_page_links_what_was_made(examples, name):
    folder = examples.root / "results" / name
    text = (folder / "index.html").read_text()
    pictures = list((folder / "figures").glob("*.png"))
    assert pictures
    for picture in pictures:
        assert f'href="figures/{picture.name}"' in text or picture.stem in LEADS
    for link in re.findall(r'href="([^"#]+)', text):
        assert (folder / link).exists(), link
    assert len(text) < 1_500_000


def test_photographs_by_control_points(examples, record_property):
    folder = examples.root / "results/photographs/photographs"
    facts = json.loads((folder / "orientation.json").read_text())
    assert facts["images"] == 5
    assert facts["check_points"]["points"] == 2
    control = pd.read_csv(folder / "control_points.csv").query("role == 'check'")
    for axis in ("east", "north", "up"):
        record_property(f"{axis}_mm", np.sqrt(np.square(control[f"without_{axis}_mm"]).mean()))
    cloud = laspy.read(folder / "points.laz")
    assert len(cloud.points) == len(pd.read_csv(folder / "points.csv")) > 1500
    assert 125 < np.median(cloud.z) < 175  # streets and roofs of Strasbourg
    page = (folder / "index.html").read_text()
    assert "photographs with a pose</td><td>5 of 5" in page
    assert "RMSE of 2 check points" in page


def test_photographs_by_positions_lie_where_dbat_has_them(examples):
    """The positions are DBAT's own projection centres with its standard deviations of 0.06 to 0.9 m."""
    own = pd.read_csv(examples.root / "results/photograph_positions/photographs/image_poses.csv")
    given = pd.read_csv(examples.root / EXAMPLES / "data/strasbourg/orientations.csv")
    for axis in "xyz":
        off = own[f"{axis}_m"] - given[axis]
        # an adjustment moves a position by less than it is known; measured at most 1.4
        assert (off.abs() < 2.0 * given[f"sigma_{axis}"]).all()
        assert (own[f"sigma_{axis}_m"] < 1.05 * given[f"sigma_{axis}"]).all()
    facts = json.loads(
        (examples.root / "results/photograph_positions/photographs/orientation.json").read_text()
    )
    assert facts["antenna_positions"] == {"source": "positions of the camera", "used": 5, "given": 5}


def test_finished_orientations_are_judged_by_surveyed_points(examples, record_property):
    """DBAT's own report: check points B4.6 and B3.11 differ by 0.136, 0.209, 0.339 m (root mean square)."""
    folder = examples.root / "results/finished_photographs/photographs"
    points = pd.read_csv(folder / "finished_points.csv").set_index("point")
    two = points.loc[["B4.6", "B3.11"], [f"without_{a}_mm" for a in ("east", "north", "up")]]
    rms = np.sqrt(np.square(two).mean()).to_numpy()
    for axis, value in zip(("east", "north", "up"), rms, strict=True):
        record_property(f"{axis}_mm", value)
    # points intersected from its poses alone; in DBAT's adjustment their marks took part: measured 9, 5, 25 %
    assert_allclose(rms, [136, 209, 339], rtol=0.35)
    assert (points["images"] >= 1).all()
    assert points.loc["B3.09", "reason"] == "a check point needs two images, it has 1"
    poses = pd.read_csv(folder / "finished.csv")
    given = pd.read_csv(examples.root / EXAMPLES / "data/strasbourg/orientations.csv")
    assert_allclose(poses[["x_m", "y_m", "z_m"]], given[["x", "y", "z"]], atol=2e-3)
    assert_allclose(poses["sigma_x_m"], given["sigma_x"], rtol=1e-6)


def test_a_fixed_camera_has_the_published_place(examples, record_property):
    """ICEpy4D: 151.65, 99.26, 91.48 m, 0.64 px; three pictures with three marks are refused."""
    poses = pd.read_csv(examples.root / "results/fixed_camera/orientation/fixed_camera.csv")
    row = poses.iloc[0]
    for name in ("rms_px", "x_m", "y_m", "z_m"):
        record_property(name, row[name])
    assert (row.x_m, row.y_m, row.z_m) == pytest.approx((151.65, 99.26, 91.48), abs=0.005)
    assert row.rms_px == pytest.approx(0.64, abs=0.006)
    assert poses["refused"].notna().tolist() == [False, True, True, True]
    page = (examples.root / "results/fixed_camera/orientation/fixed_camera.html").read_text()
    assert "pictures with a pose</td><td>1 of 4</td><td>3 refused" in page


def test_two_planes_are_ten_centimetres_apart(examples, record_property):
    """py4dgeo's M3C2 at nine core points: mean -0.100323 m; here cloud to mesh at 400 points."""
    facts = json.loads((examples.root / "results/cloud/accuracy/cloud.json").read_text())
    assert facts["without_outliers"]["bias_m"] == pytest.approx(-0.1003, abs=0.0006)
    moved = facts["registration"]
    record_property("bias_m", facts["without_outliers"]["bias_m"])
    record_property("up_m", moved["shift_m"]["up"])
    record_property("sigma_up_mm", 1e3 * moved["sigma_shift_m"]["up"])
    assert moved["shift_m"]["up"] == pytest.approx(0.1003, abs=0.0006)
    # white noise of 4.3 mm over 400 points: 0.22 mm
    assert 0.12e-3 < moved["sigma_shift_m"]["up"] < 0.4e-3
    assert len(moved["undetermined"]) == 3
    assert moved["f"] > 100 * moved["f_exceeded_in_5_percent"]


def test_raw_gnss_gives_a_trajectory(examples):
    folder = examples.root / "results/gnss"
    facts = json.loads((folder / "ingest/positions.integrity.json").read_text())
    assert facts["counts"]["positions"] == 400
    assert (folder / "orientation/trajectory.parquet").is_file()
    track = json.loads((folder / "orientation/track.geojson").read_text())
    assert sum(part["properties"]["epochs"] for part in track["features"]) >= 400
    assert "<LineString>" in (folder / "orientation/track.kml").read_text()
    assert 'href="orientation/track.kml"' in (folder / "index.html").read_text()
    assert "georeferenced soundings" in (folder / "index.html").read_text()


@pytest.mark.parametrize(("name", "decoded"), [("lidar", 73_486), ("lidar_without_pps", 700_400)])
def test_lidar_points_have_standard_deviations(examples, name, decoded):
    """Points decoded as by velodyne-decoder and by VeloView."""
    folder = examples.root / "results" / name / "lidar"
    counts = pd.read_csv(folder / "counts.csv").set_index("reason")["n"]
    assert counts.sum() == decoded
    assert counts["kept"] > 0.99 * decoded
    assert counts[["no_gps_time", "no_pose"]].sum() == 0
    with laspy.open(folder / "points.laz") as stream:
        assert "sigma_up" in stream.header.point_format.extra_dimension_names


def test_a_table_of_poses_carries_a_lidar(examples, capsys):
    """The same capture beside a TUM table instead of the SBET, as robots write it."""
    root, data = examples.root, examples.root / EXAMPLES / "data/lidar"
    t = gps_from_unix(1_453_364_282.0) + np.arange(-4.0, 6.0, 0.05)
    poses = np.zeros((len(t), 8))
    poses[:, 0], poses[:, 7] = unix_from_gps(t), 1.0
    np.savetxt(data / "poses.tum", poses, fmt="%.6f")
    text = (root / EXAMPLES / "lidar.yaml").read_text()
    text = text.replace("id: lidar", "id: lidar_tum").replace("position_source: sbet", "position_source: ins")
    text = text.replace(
        "  sbet: [data/lidar/standing.sbet]\n  gps_week: 1880", "  ins: [data/lidar/poses.tum]"
    )
    path = root / EXAMPLES / "lidar_tum.yaml"
    path.write_text(text)
    assert main(["check-config", str(path)]) == 2
    assert "not stated: body_axes, time_scale" in capsys.readouterr().err
    path.write_text(text.replace("ins: {", "ins: {body_axes: forward-left-up, time_scale: utc, "))
    try:
        assert main(["check-config", str(path)]) == 0
        target = "results/lidar_tum/lidar/points.laz"
        examples.snakemake(target, "--config", f"campaign={EXAMPLES}/lidar_tum.yaml")
    finally:
        path.unlink()
    counts = pd.read_csv(root / "results/lidar_tum/lidar/counts.csv").set_index("reason")["n"]
    assert counts.sum() == 73_486
    assert counts["kept"] > 0.99 * 73_486


@pytest.mark.parametrize(
    ("folder", "kind", "gives"),
    [
        ("strasbourg", "photographs", "poses of the photographs"),
        ("belvedere", "fixed_camera", "pose of the camera in each picture"),
        ("planes", "cloud", "distances from the reference"),
        ("piksi", "survey", "trajectory of the boat"),
    ],
)
def test_a_folder_of_files_becomes_a_campaign(examples, tmp_path, capsys, folder, kind, gives):
    """As a new user begins: recognised, written, checked."""
    logs = tmp_path / folder
    others = shutil.ignore_patterns("orientations.csv", "positions.csv")
    shutil.copytree(examples.root / EXAMPLES / "data" / folder, logs, ignore=others)
    assert main(["new-campaign", "mine", "--from-logs", str(logs), "--folder", str(tmp_path)]) == 0
    path = tmp_path / "mine.yaml"
    if kind == "survey":
        text = path.read_text().replace("lever_ics_m: CHANGE", "lever_ics_m: [0, 0, 0]")
        path.write_text(text)
    capsys.readouterr()
    assert main(["check-config", str(path)]) == 0
    assert gives in capsys.readouterr().out
    assert load_campaign(path).kind == kind


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("lidar", "ins: {sigma_position_m: [0.02, 0.02, 0.03]}", "", "none of them with sigmas"),
        ("lidar", "gps_week: 1880", "gps_week: 1879", "the streams have no common time"),
        (
            "lidar_without_pps",
            'clock: {first_packet_utc: "2026-05-12T12:00:00Z"}',
            "returns: all",
            "never gets GPS time",
        ),
        ("lidar_without_pps", "model: VLP-16", "model: HDL-32E", "that come every 1327 us"),
        (
            "photographs",
            "data/strasbourg/marks.csv",
            "data/belvedere/IMG_2637.csv",
            "marks of images that do not occur: IMG_2637",
        ),
    ],
)
def test_check_config_says_what_the_first_jobs_refuse(examples, capsys, name, old, new, words):
    path = examples.root / EXAMPLES / f"{name}.yaml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    try:
        assert main(["check-config", str(path)]) == 2
    finally:
        path.write_text(text)
    told = capsys.readouterr().err
    assert "what the first jobs would refuse" in told
    assert words in told
