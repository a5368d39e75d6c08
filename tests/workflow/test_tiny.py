"""The tiny campaign from raw bytes to pictures: results, idempotence, and exactly the right reruns."""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pandas as pd
import pytest
import yaml
from pyproj import CRS
from scipy.stats import chi2

from tests.bands import band
from tests.golden.kept_numbers import moved_since_kept
from tests.workflow.conftest import House, rule_names
from thalweg.cli import main
from thalweg.core import LocalFrame, Rigid, Trajectory, iter_laz, laz_header, read_table
from thalweg.ingest import GNSS_POSITION, LidarOptions
from thalweg.ingest.ppk.trust import covariance_enu
from thalweg.ingest.registry import lidar_reader, recognise
from thalweg.lidar import CORRELATIONS, SIGMAS, LogSettings, georeference_log
from thalweg.settings import load_campaign
from thalweg.settings.sections import Filters, LidarAccuracy
from thalweg.workflow import CampaignFiles, Measured, fitted, per_rule, read_costs
from thalweg_lab.instruments import LIDAR_SHOTS, EchoKind
from thalweg_lab.river import BARE_GROUND, Scene
from thalweg_lab.truth import TrueReturns, Truth, compare_cloud
from thalweg_lab.voyage import read_true_mounts

pytestmark = pytest.mark.workflow

BASE = "results/tiny"


OF_DISTANCES = {
    "plot_distance_map",
    "plot_cross_sections",
    "plot_distance_histogram",
    "plot_distance_by_range",
}
"""Pictures of the comparison with the reference."""

OF_CHAINS = {"compare_chains", "plot_chain_histograms", "plot_chains_by_range", "trajectory_comparison_page"}
"""The same for the trajectories by INS, camera and all sensors."""

OF_BED = {
    "plot_sounding_lines",
    "plot_bed_map",
    "plot_bed_sections",
    "plot_bed_left_out",
    "plot_terrain_model",
    "plot_long_profile",
}
"""Pictures of the riverbed."""

OF_IMAGES = {
    "plot_mask_view",
    "plot_image_positions",
    "plot_frames_by_image",
    "plot_coloured_detail",
    "plot_colour_check",
}
"""Pictures of the images and of what they give."""

OF_RIG = {"plot_rig_residuals", "plot_rig_field"}
"""Pictures of the calibration of the rig, which rests on no survey."""


def dry_run(house, campaign: str) -> str:
    """What Snakemake says it would do."""
    run = house.snakemake("--dry-run", "--config", f"campaign={campaign}")
    return run.stdout + run.stderr


def planned(house) -> set[str]:
    """Rules of the tiny campaign that a dry run would execute."""
    return counted(dry_run(house, "tiny"))


def counted(text: str) -> set[str]:
    """Rules in Snakemake's table of jobs, without those that follow from every picture."""
    table = re.search(r"(?ms)^job\s+count\n-.*?\n(.*?)^total", text)
    if table is None:
        assert "Nothing to be done" in text
        return set()
    rules = {line.split()[0] for line in table.group(1).splitlines() if line.strip()} - {"all"}
    return rules - {"front_page", "survey_report"} or rules


def edited(house, module: str, addition: str):
    """Append a statement to a module, and give back a function that undoes it."""
    path = house.root / "src/thalweg" / module
    before = path.read_text()
    path.write_text(before + addition)
    return lambda: path.write_text(before)


def test_everything_promised_is_there(tiny_house):
    base = tiny_house.root / BASE
    for name in (
        "lidar/points.laz",
        "lidar/points_map.laz",
        "lidar/points_map.copc.laz",
        "lidar/coloured.laz",
        "calibration/rig.yaml",
        "panorama/panoramas.parquet",
        "panorama/index.html",
        "viewer/index.html",
        "timing/streams.csv",
        "summary.csv",
        "index.html",
        "ingest/reference.laz",
        "bathymetry/soundings.parquet",
        "bathymetry/soundings.csv",
        "bathymetry/bed.tif",
        "fusion/dtm.tif",
        "fusion/river.json",
    ):
        assert (base / name).stat().st_size > 0, name
        assert (base / f"{name}.meta.json").is_file(), name
    for picture in ("survey_map", "streams_in_time", "cloud_overview", "cloud_detail", "distance_histogram"):
        assert (base / f"figures/{picture}.png").stat().st_size > 20_000, picture


def test_no_number_has_moved_unseen(tiny_house):
    assert moved_since_kept(tiny_house.root / "results/tiny") == []


def test_the_cloud_is_what_the_conventions_say(tiny_house):
    with laspy.open(tiny_house.root / BASE / "lidar/points.laz") as reader:
        header = reader.header
        assert str(header.version) == "1.4"
        assert header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
        assert header.parse_crs() is not None
        assert header.scales.max() <= 0.001
        names = set(header.point_format.dimension_names)
        assert {"range", "ring", "gps_time", "intensity", "return_number", *SIGMAS, *CORRELATIONS} <= names
        points = reader.read()
    assert len(points) > 200_000
    assert set(np.unique(points["ring"])) == set(range(16))
    reported = pd.read_csv(tiny_house.root / BASE / "lidar/counts.csv").set_index("reason")["n"]
    assert reported["kept"] == len(points)


def test_the_map_cloud_lies_on_the_map(tiny_house):
    with laspy.open(tiny_house.root / BASE / "lidar/points_map.laz") as reader:
        assert reader.header.parse_crs().to_epsg() == 25833
        assert 3e5 < reader.header.mins[0] < 6e5
        assert 5.5e6 < reader.header.mins[1] < 5.9e6
        first = reader.read_points(100)
        found = np.stack([first.x, first.y, first.z], axis=1)
    best = tiny_house.root / BASE / "lidar/by_fused/points.laz"
    frame, places = laz_header(best).frame, next(iter_laz(best))["xyz_m"][:100]
    np.testing.assert_allclose(found, frame.to_map(places, CRS(25833)), atol=2e-3)


def test_the_bank_is_recovered_at_the_level_of_the_injected_noise(tiny_house):
    """Two-sided: worse is an error of the chain, better means that truth leaked in or sigmas are padded."""
    table = pd.read_csv(tiny_house.root / BASE / "accuracy/truth_statistics.csv")
    ground = table[table["points"] == "bare ground"].set_index("quantity")["value"]
    ratio = ground["rmse"] / ground["predicted_rmse"]
    # One observation: errors of attitude and position are correlated over a second, and 25 s hold some 25
    # independent squares. The guard is `consistency_study`, of 40 surveys.
    low, high = np.sqrt(band(25))
    assert low < ratio < high
    assert ground["consistent_low95"] < 1 < ground["consistent_high95"]
    # a bias is no part of the prediction: its bound is what 12 independent pose errors leave as a mean
    assert abs(ground["bias"]) < 2 * ground["predicted_rmse"] / np.sqrt(12)
    assert (
        ground["share_of_points"] > 0.3
    )  # the rest are trees, bushes, stones, and footprints across an edge


def test_the_cloud_agrees_with_the_reference_as_its_sigmas_say(tiny_house):
    """From terrestrial scans and boat to a verdict, two-sided; plants are outliers and counted as such."""
    base = tiny_house.root / BASE / "accuracy"
    table = pd.read_csv(base / "statistics.csv").set_index(["registration", "points", "quantity"])["value"]
    inside, everything = table["as measured"]["without outliers"], table["as measured"]["all"]
    assert everything["n"] > inside["n"] > 100_000
    assert inside["ratio_low95"] < inside["ratio"] < inside["ratio_high95"]
    # what a distance sees is less than the error in three dimensions, and that is said beside it
    assert 1.2 < inside["predicted_rmse_3d"] / inside["predicted_rmse"] < 2.5
    assert everything["rmse"] > 1.5 * inside["rmse"]
    registered = table["with registration"]["without outliers"]
    assert abs(registered["bias"]) < abs(inside["bias"]) + 0.001
    classes = pd.read_csv(base / "by_range.csv")
    first = classes[(classes["registration"] == "as measured") & (classes["points"] == "without outliers")]
    assert first["n"].sum() == inside["n"]
    assert len(first) > 25
    page = (base / "index.html").read_text()
    assert "digital twin" in page
    assert page.count("data:image/png") == 4
    assert 'href="../index.html"' in page
    front = (base.parent / "index.html").read_text()
    assert len(front) < 1_500_000  # it loads nothing but itself
    assert [link for link in re.findall(r'href="([^"#]+)', front) if not (base.parent / link).exists()] == []


def test_the_processing_needs_no_truth(tiny_house):
    """All results were made while the folder of the truth was away; judges, pictures and pages came after."""
    after = counted((tiny_house.root / "judged.log").read_text())
    judges = {rule for rule in after if rule.endswith("_with_truth")}
    of = ("with_truth", "chains_with_truth", "riverbed_with_truth", "dtm_with_truth", "rig_with_truth")
    assert judges == {f"compare_{name}" for name in of}
    shown = {rule for rule in after if rule.startswith("plot_") or rule.endswith("_page")}
    assert after - judges - shown == {"summarise", "export_layers", "gis_project"}


def test_the_bed_is_as_good_as_its_sigmas_say(tiny_house):
    truth = pd.read_csv(tiny_house.root / BASE / "accuracy/truth_riverbed.csv").set_index("measure")["value"]
    # soundings with a noise of 2 cm, each of its own
    low, high = band(291)
    assert low < truth["soundings: mean of squared error over variance"] < high
    assert truth["soundings: root mean square error, m"] < 0.03
    # One observation: a bed of 60 m between four lines, some six independent places from each to the next.
    # The guard is `bed_study`, of 40 rivers.
    low, high = band(4 * 6)
    assert low < truth["bed: mean of squared error over variance"] < high
    assert truth["bed: root mean square error, m"] < 0.12
    assert truth["banks: root mean square error, m"] < 0.3
    found = json.loads((tiny_house.root / BASE / "bathymetry/validation.json").read_text())
    assert found["lines"] == 4
    assert found["rmse_m"] < 0.12
    methods = pd.read_csv(tiny_house.root / BASE / "bathymetry/methods.csv").set_index("method")["rmse_m"]
    assert methods["kriging"] < methods["inverse distance, elliptical"]
    assert methods["kriging"] < 0.5 * methods["triangles"]


def test_the_terrain_model_is_as_good_as_its_sigmas_say(tiny_house):
    truth = pd.read_csv(tiny_house.root / BASE / "accuracy/truth_dtm.csv").set_index("measure")["value"]
    square = "mean of squared error over variance"
    # One observation each: the bed as above, banks with the errors of pose of 25 s. The guards are
    # `bed_study` and `consistency_river_study`.
    low, high = band(4 * 6)
    assert low < truth[f"bed from soundings: {square}"] < high
    low, high = band(25)
    assert low < truth[f"banks by the lidar, within 5 m of the bed: {square}"] < high
    # crowns and roofs gave 1.1 to 1.5 m; four seeds without them 0.08 to 0.13 m
    assert truth["banks by the lidar, farther away: root mean square error, m"] < 0.3
    assert truth["steps at seams: share outside 95 %"] < 0.05
    facts = json.loads((tiny_house.root / BASE / "fusion/dtm.json").read_text())
    assert facts["seam_and_bend_above_two_sigma"] < 0.05
    pings = pd.read_csv(tiny_house.root / BASE / "accuracy/truth_soundings.csv")
    low, high = band(291)  # as above
    assert low < pings.loc[0, "normalised_square"] < high


def test_rig_and_panorama_are_as_good_as_their_sigmas_say(tiny_house):
    truth = pd.read_csv(tiny_house.root / BASE / "accuracy/truth_rig.csv").set_index("measure")["value"]
    square = "mean of squared error over variance"
    assert abs(truth["base: error, mm"]) < 0.3
    assert truth["relative rotation: error, deg"] < 0.02
    # One observation of each: six numbers between the lenses, eight of each lens, six of each of three poses.
    # The guard is `rig_study`, of 20 rigs.
    for what, n in (("relative orientation", 6), ("interiors", 16), ("poses", 18)):
        low, high = band(n)
        assert low < truth[f"{what}: {square}"] < high, what
    # what is truly seen from the middle of the rig, tile by tile
    assert truth["panorama: median of the other shifts, px"] < 0.5
    assert abs(truth["panorama: common shift down, px"]) < 1.0
    assert truth["colours: share of visible points that have one"] >= 0.97
    assert truth["colours: median error of a patch, of 255"] <= 6.0


def test_all_streams_share_one_axis(tiny_house):
    streams = pd.read_csv(tiny_house.root / BASE / "timing/streams.csv").set_index("stream")
    assert set(streams.index) == {"lidar", "ins", "gnss", "depth", "positions"}
    assert streams["synchronised"].all()
    assert (streams["duration_s"] > 15).all()


def test_provenance_names_inputs_and_code(tiny_house):
    record = json.loads((tiny_house.root / BASE / "lidar/points.laz.meta.json").read_text())
    assert record["rule"] == "georeference_lidar"
    assert re.fullmatch(r"[0-9a-f]{12}", record["code"])
    assert f"{BASE}/simulation/logs/lidar.pcap" in record["inputs"]
    assert not any(Path(name).is_absolute() for name in record["inputs"])


def test_requests_hold_and_waste_nothing(tiny_house, tmp_path):
    """What rules state, which is for longer campaigns too, and what `thalweg costs --write` finds."""
    jobs = read_costs(tiny_house.root / "results/tiny")
    assert jobs["rule"].nunique() > 90
    stated = per_rule(jobs)
    assert stated.loc[stated["remark"] != "", ["rule", "remark", "used_memory"]].to_dict("records") == []
    measured, asked = Measured(fitted(jobs)), []
    for rule, input_mb in zip(jobs["rule"], jobs["input_mb"], strict=True):
        with (tmp_path / "inputs").open("wb") as file:
            file.truncate(int(input_mb * 1e6))
        inputs = [str(tmp_path / "inputs")]
        asked.append((measured.memory_mb(rule, inputs, 1, 0, 0), measured.minutes(rule, inputs, 1, 0, 0)))
    again = per_rule(jobs.assign(asked_mb=[a for a, _ in asked], asked_min=[b for _, b in asked]))
    assert again.loc[again["remark"] != "", ["rule", "remark", "used_memory"]].to_dict("records") == []
    assert again["used_memory"].between(0.25, 1.0).all()


def test_a_second_call_has_nothing_to_do(tiny_house):
    assert planned(tiny_house) == set()


def test_an_edit_reruns_exactly_the_rules_that_use_it(tiny_house):
    of_streams = {"plot_streams_in_time"}
    of_clouds = {
        "plot_survey_map",
        "plot_trajectory",
        "plot_from_above",
        "plot_cloud_overview",
        "plot_cloud_detail",
        "plot_footprints",
        "plot_removed_points",
        "plot_reference_view",
    }
    pictures = of_streams | of_clouds | OF_DISTANCES | OF_IMAGES | OF_BED
    pictures |= {"plot_chain_histograms", "plot_chains_by_range"} | OF_RIG
    undo = edited(tiny_house, "figures/style.py", "\n_edited = 1\n")
    assert planned(tiny_house) == pictures | {
        "accuracy_page",
        "gis_project",
        "trajectory_comparison_page",
        "bathymetry_page",
        "viewer_page",
        "walk_page",
    }
    undo()
    undo = edited(tiny_house, "navigation/ins_gnss/trajectory.py", "\n_edited = 1\n")
    # a comment elsewhere adds nothing to what this edit reruns
    undo_comment = edited(tiny_house, "ingest/nmea/reader.py", "\n# why, not what\n")
    after_trajectory = {
        "build_trajectory",
        "estimate_pose_errors",
        "georeference_lidar",
        "export_map",
        "export_copc",
        "mesh_reference",
        "compare_with_reference",
        "compare_with_truth",
        "accuracy_page",
        "summarise",
        "time_report",
    }
    # where the camera roughly was comes from the trajectory, and all of the images' orientation follows
    after_prediction = {
        "predict_images",
        "mask_images",
        "extract_features",
        "match_features",
        "join_matches",
        "map_images",
        "measure_control_points",
        "adjust_images",
        "time_images",
        "camera_trajectory",
        "fuse_trajectory",
        "compare_chains_with_truth",
    }
    after_fusion = {
        "check_colours",
        "colour_points",
        "viewer_page",
        "walk_page",
        "place_rig_images",
        "make_panoramas",
        "compare_rig_with_truth",
        "locate_soundings",
        "trace_river",
        "krige_bed",
        "validate_bed",
        "build_dtm",
        "measure_river",
        "export_layers",
        "gis_project",
        "compare_riverbed_with_truth",
        "compare_dtm_with_truth",
        "bathymetry_page",
    }
    clouds = of_clouds | OF_DISTANCES | OF_CHAINS | OF_IMAGES | OF_BED | after_fusion
    assert planned(tiny_house) == after_trajectory | after_prediction | clouds
    undo()
    undo_comment()


def test_the_log_tells_what_the_job_did(tiny_house):
    text = (tiny_house.root / "logs/tiny/lidar/georeference_lidar.log").read_text()
    assert "rule georeference_lidar done" in text
    assert (tiny_house.root / "benchmarks/tiny/lidar/georeference_lidar.jsonl").stat().st_size > 0


def test_the_report_is_one_page(tiny_house):
    tiny_house.snakemake("--config", "campaign=tiny", "--report", "report.html")
    page = (tiny_house.root / "report.html").read_text()
    pictures = ("survey_map", "streams_in_time", "cloud_overview", "removed_points")
    assert all(picture in page for picture in pictures)
    assert not re.findall(r"<(?:script|img|link)[^>]+(?:src|href)=[\"']https?://", page)
    assert len(page) > 500_000


BOAT = """\
campaign:
  id: boat
  title: the tiny twin's logs as a surveyor would hand them in
  crs: EPSG:25833
  origin: {{lat_deg: 51.05, lon_deg: 13.25, h_ell_m: 300.0}}
logs:
  lidar: [{logs}/lidar.pcap]
  ins: [{logs}/ins.anpp]
  gnss: {{rover: [{logs}/rover.sbp]}}
  depth: [{logs}/*.nmea]
mounts:
  lidar: {{phi_deg: -90.0, lever_ics_m: [-0.350, 0.000, -0.250]}}
  antenna: {{lever_ics_m: [0.100, 0.000, -0.450]}}
  echo_sounder: {{lever_ics_m: [0.200, 0.000, 0.300]}}
{camera}
orientation: {{position_source: {source}}}
{more}
georeferencing: {{export_map: false}}
"""


def examples(root: Path) -> dict[str, Any]:
    """Functions of the script that makes the examples ready."""
    return runpy.run_path(str(root / "config/campaigns/examples/prepare.py"))


OF_SOURCE = {
    # its accuracy page is planned: `tiny` has run its rules, and tests/figures/test_accuracy_page writes one
    # without a twin; `make test-slow` makes the whole survey
    "sbp": ("lidar/points.laz", "figures/cloud_detail.png", "orientation/trajectory_fused.parquet"),
    "ins": ("lidar/points.laz", "bathymetry/soundings.csv"),
    # planned alone: a lidar by an SBET is in test_examples, images by an SBET below
    "sbet": (),
}
"""What is made of the survey by each source of positions: what depends on them. The rest is planned."""


def write_survey(house: House, source: str, more: str = "") -> None:
    """The campaign file ``boat_<source>``: the twin's logs as files, with positions of one source."""
    logs = house.root / BASE / "simulation/logs"
    text, camera = BOAT, ""
    if source == "sbp":
        # estimated in `tiny` from positions of this kind, and for those of the INS below
        text = text.replace("{source}}}", "{source}, error_model: {{estimate: false}}}}")
        text = text.replace("  depth:", "  reference: [{logs}/tls_*.laz]\n  depth:")
        area = "[[-35, -7], [0, -10], [35, -8], [35, -18], [0, -21], [-35, -18]]"
        more += f"accuracy: {{area: {{polygon: {area}, min_height_m: 0.15, max_height_m: 4.0}}}}\n"
    if source != "ins":
        # images that another program has oriented: here the twin's own adjustment
        poses = house.root / BASE / "orientation/image_poses.parquet"
        text = text.replace(
            "  depth:",
            f"  time_lapse: {{{{images: [{{logs}}/time_lapse/*.jpg], orientations: [{poses}]}}}}\n  depth:",
        )
        own = yaml.safe_load((house.root / "config/campaigns/tiny.yaml").read_text())
        camera = f"  camera: {json.dumps(own['mounts']['camera'])}"
        if source == "sbet":  # the on-board positions scatter too much to hold the velocities of an SBET
            own["images"].setdefault("cloud", {})["motion"] = "trajectory"
        more += f"images: {json.dumps(own['images'])}"
    if source == "sbet":
        write_sbet = examples(house.root)["write_sbet"]
        week = write_sbet(house.root / BASE / "ingest/ins_states.parquet", house.root / "boat.sbet")
        text = text.replace(
            "  ins: [{logs}/ins.anpp]", f"  sbet: [{house.root}/boat.sbet]\n  gps_week: {week}"
        )
        more += "\nins: {sigma_position_m: [0.6, 0.6, 1.0]}"
    text = text.replace("id: boat", f"id: boat_{source}")
    campaign = text.format(logs=logs, source=source, more=more, camera=camera)
    (house.root / f"config/campaigns/boat_{source}.yaml").write_text(campaign)


@pytest.fixture(scope="module")
def surveys(tiny_house):
    """A house in which the survey was processed by each source of positions, in one call."""
    for source in OF_SOURCE:
        write_survey(tiny_house, source)
    targets = (f"results/boat_{source}/{name}" for source, names in OF_SOURCE.items() for name in names)
    campaigns = ",".join(f"boat_{source}" for source in OF_SOURCE)
    tiny_house.snakemake("--config", f"campaign=[{campaigns}]", "--", *targets)
    return tiny_house


@pytest.mark.parametrize("source", OF_SOURCE)
def test_logs_of_a_survey_go_the_same_way(surveys, source):
    """The branch of real campaigns: files named in the campaign file, no twin, no truth, other positions."""
    base = surveys.root / f"results/boat_{source}"
    made = {json.loads(path.read_text())["rule"] for path in base.rglob("*.meta.json")}
    rest = dry_run(surveys, f"boat_{source}")
    rules = made | counted(rest)
    assert not any(rule.endswith("_with_truth") for rule in rules)
    assert {"georeference_lidar", "locate_soundings", "plot_cloud_detail"} <= rules
    assert ("accuracy_page" in rules) == (source == "sbp")  # the one with a reference
    # an SBET states no fix: its sigmas are what its positions count by, for the images too
    for name, rule in (
        ("orientation/trajectory_fused.parquet", "fuse_trajectory"),
        ("accuracy/trajectories.html", "trajectory_comparison_page"),
    ):
        assert (rule in rules) == (source != "ins"), name
    assert (base / "orientation/trajectory_fused.parquet").is_file() == (source == "sbp")
    assert re.search(r"(?m)^front_page +1$", rest)
    if not OF_SOURCE[source]:
        return
    summary = json.loads((base / "orientation/trajectory.json").read_text())
    assert summary["n_nodes_valid"] > 1000
    assert summary["n_positions_used"] > 200
    with laspy.open(base / "lidar/points.laz") as reader:
        n = reader.header.point_count
    with laspy.open(surveys.root / BASE / "lidar/points.laz") as reader:
        assert n == pytest.approx(reader.header.point_count, rel=0.01)


def check_chains(base: Path) -> None:
    """Points of the clouds by INS, camera and all sensors."""
    chains = pd.read_csv(base / "accuracy/chains.csv")
    (cloud,) = chains[(chains["of"] == "shots of the lidar") & (chains["quantity"] == "in_cloud")].to_dict(
        "records"
    )
    # 25 frames of 0.1 s in 25 s, and no more points than shots by any chain
    assert 0.05 < cloud["camera"] / cloud["ins"] < 0.15
    assert cloud["fused"] == pytest.approx(cloud["ins"], rel=0.02)


def test_clouds_by_three_trajectories_hold_what_they_can(tiny_house):
    check_chains(tiny_house.root / BASE)


@pytest.mark.slow
def test_a_survey_of_logs_has_a_front_page(surveys):
    """The rest of it: pictures and clouds by three trajectories, which `tiny` makes of the same points."""
    surveys.snakemake("--config", "campaign=boat_sbp")
    base = surveys.root / "results/boat_sbp"
    check_chains(base)
    for page in ("index.html", "accuracy/index.html", "accuracy/trajectories.html"):
        assert "digital twin" not in (base / page).read_text()
    assert len(list((base / "figures").glob("*.png"))) > 20


def test_windows_of_a_long_log_change_no_byte(surveys):
    """Whole and in three windows, as their jobs make them."""
    base = surveys.root / "results/boat_ins/lidar"
    names = ("points.laz", "removed.parquet", "counts.csv")
    whole = [(base / name).read_bytes() for name in names]
    assert not (base / "windows").exists()
    write_survey(surveys, "ins", "scatter: {seconds: 9}")
    run = surveys.snakemake("--config", "campaign=boat_ins", "--", "results/boat_ins/lidar/points.laz")
    jobs = re.findall(r"^(?:count_neighbours|georeference_window) +(\d+)$", run.stdout + run.stderr, re.M)
    assert jobs == ["3"] * 2
    assert [(base / name).read_bytes() for name in names] == whole
    assert not list((base / "windows").glob("*.las"))


def test_an_sbet_and_photographs_give_the_chains_of_camera_and_all_sensors(tiny_house, capsys):
    """No lidar, no GNSS: an SBET states no fix; its standard deviations are what counts."""
    root, base = tiny_house.root, tiny_house.root / BASE
    path = root / "config/campaigns/examples/sbet_photographs.yaml"
    examples(root)["sbet_photographs"](base, path.parent / "data/sbet_photographs")
    assert main(["check-config", str(path)]) == 0
    text = path.read_text()
    sbet = path.parent / "data/sbet_photographs/boat.sbet"
    whole = sbet.read_bytes()
    records = np.frombuffer(whole).reshape(-1, 17).copy()
    records[:, 4:7] += np.random.default_rng(1).normal(0.0, 2.0, (len(records), 3))
    sbet.write_bytes(records.tobytes())  # noise for velocities, as some programs write
    path.write_text(text.replace("  cloud: {motion: trajectory}\n", ""))
    assert main(["check-config", str(path)]) == 2
    assert "INS states have a velocity; expected" in capsys.readouterr().err
    sbet.write_bytes(whole)
    path.write_text(text)
    products = CampaignFiles(
        name="sbet_photographs", campaigns={"sbet_photographs": load_campaign(path)}
    ).products()
    assert {row.name for row in products if row.made} == {
        "trajectory of the boat",
        "report of survey, PDF",
        "project for QGIS",
        "track, soundings, river for a GIS",
        "camera trajectory; fused trajectory",
    }
    tiny_house.snakemake("--config", f"campaign={path}")
    results = root / "results/sbet_photographs"
    for row in products:
        assert (root / row.file).is_file() == row.made, row.name
    true = Trajectory.read(base / "simulation/truth/trajectory.parquet")
    fused = Trajectory.read(results / "orientation/trajectory_fused.parquet")
    use = fused.valid
    position, _, inside = true.at(fused.t_gps_s[use])
    off = (fused.position_wcs_m[use] - position)[inside] / fused.sigma_position_m[use][inside]
    # One observation: 25 s hold two errors of GNSS of each of three axes, which last 10 s. The guard is
    # `prior_study`, of six voyages of two minutes.
    low, high = band(3 * 2)
    assert low < np.mean(off**2) < high
    assert 'href="orientation/trajectory_fused.parquet"' in (results / "index.html").read_text()


def test_raw_observations_of_the_twin_are_solved(tiny_house):
    """The twin's receiver and base in raw observations, PPK, and the boat's poses: position_source ppk."""
    root = tiny_house.root
    own = yaml.safe_load((root / "config/campaigns/tiny.yaml").read_text())
    campaign = {key: own[key] for key in ("campaign", "twin", "mounts")}
    campaign["campaign"]["id"] = "tiny_ppk"
    campaign["orientation"] = {"position_source": "ppk", "accept_fixes": "auto"}
    campaign["twin"]["gnss"] = {"shadow": True}
    path = root / "config/campaigns/tiny_ppk.yaml"
    path.write_text(yaml.safe_dump(campaign))
    base = root / "results/tiny_ppk"
    # the same voyage: what does not rest on positions is that of tiny
    truth = [f"simulation/truth/{name}" for name in ("scene.npz", "mounts.json", "trajectory.parquet")]
    read = [f"ingest/{name}.integrity.json" for name in ("lidar", "ins", "gnss", "depth")]
    for name in (*truth, *read, "ingest/ins_states.parquet", "ingest/lidar.clock.json"):
        (base / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(root / BASE / name, base / name)
    stated = "results/tiny_ppk/orientation/trajectory_stated.parquet"
    made = "simulate_raw_gnss", "read_positions", "collect_mounts", "align_streams", "build_trajectory"
    tiny_house.snakemake(stated, "--config", "campaign=tiny_ppk", "--allowed-rules", *made)
    path.unlink()
    facts = json.loads((base / "simulation/truth/raw_gnss_effects.json").read_text())
    assert facts["dimmed"] > 0
    true = Trajectory.read(base / "simulation/truth/trajectory.parquet")
    lever = read_true_mounts(base / "simulation/truth/mounts.json")["antenna"]["lever_ics_m"]
    table, _ = read_table(base / "ingest/positions.parquet", GNSS_POSITION)
    assert (table["fix"] == "fixed").mean() > 0.5
    frame = LocalFrame(**own["campaign"]["origin"])
    place = frame.from_geodetic(table["lat_deg"], table["lon_deg"], table["h_ell_m"])
    position, rotation, inside = true.at(table["t_gps_s"].to_numpy())
    off = (place - position - rotation @ np.asarray(lever))[inside]
    fixed = (table["fix"] == "fixed").to_numpy()[inside]
    assert np.abs(off[fixed]).max() < 0.10  # one wavelength is 0.19 m
    cov = covariance_enu(table)[inside]
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(cov), off)
    # multipath lasts 40 s: the voyage is one observation of three axes
    low, high = chi2.ppf([0.005, 0.995], 3)
    assert low < nees.mean() < high
    # and so are the poses: float for the first two seconds, fixed from there on
    poses = Trajectory.read(root / stated)
    position, _, inside = true.at(poses.t_gps_s)
    off, sigma = (poses.position_wcs_m - position)[inside], poses.sigma_position_m[inside]
    known = sigma[:, 2] < 0.1
    assert known.mean() > 0.9
    assert np.sqrt(np.mean(off[known] ** 2)) < 0.03
    assert low < np.mean(np.sum((off / sigma) ** 2, axis=1)) < high
    shutil.rmtree(base)


def test_a_campaign_is_written_from_a_folder_of_logs(tiny_house):
    logs = tiny_house.root / BASE / "simulation/logs"
    run = subprocess.run(
        [
            sys.executable,
            "-m",
            "thalweg",
            "new-campaign",
            "found",
            "--from-logs",
            str(logs),
            "--origin",
            "51.05",
            "13.25",
            "300",
        ],
        cwd=tiny_house.root,
        env=tiny_house.environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    text = (tiny_house.root / "config/campaigns/found.yaml").read_text()
    (tiny_house.root / "config/campaigns/found.yaml").unlink()
    for name in ("lidar.pcap", "ins.anpp", "rover.sbp", "ppk.pos", "echo.nmea", "tls_1.laz"):
        assert name in text, name
    assert recognise(tiny_house.root / BASE / "orientation/image_poses.parquet") == "image_poses"
    assert "left out" in run.stderr  # the provenance files beside the logs are no logs, and that is said


@pytest.mark.parametrize(("sideways_error_m", "consistent"), [(0.0, True), (0.10, False)])
def test_with_the_true_poses_the_lidar_noise_remains(tiny_house, tmp_path, sideways_error_m, consistent):
    """Time, decoding, mount and interpolation add nothing to the beam; 10 cm of lever arm are seen."""
    simulation = tiny_house.root / BASE / "simulation"
    log, options = [simulation / "logs/lidar.pcap"], LidarOptions()
    true = Trajectory.read(simulation / "truth/trajectory.parquet")
    reach = Scene.read(simulation / "truth/scene.npz")
    mount = Rigid.from_mount(read_true_mounts(simulation / "truth/mounts.json")["lidar"])
    shots, _ = read_table(simulation / "truth/lidar_shots.parquet", LIDAR_SHOTS)
    mount = mount.with_cov(np.zeros((6, 6)))
    assumed = replace(mount, shift_m=mount.shift_m + np.array([0.0, sideways_error_m, 0.0]))
    settings = LogSettings(
        mount=assumed,
        beam=LidarAccuracy(),
        filters=Filters(),
        min_range_m=0.5,
        max_range_m=100.0,
        correlations=True,
    )
    reader = lidar_reader(log, options)
    georeference_log(reader, reader.scan().clock, true, settings, tmp_path / "points.laz")
    statistics, _ = compare_cloud(
        tmp_path / "points.laz",
        estimated=true,
        mount=assumed,
        truth=Truth(
            trajectory=true,
            mount=mount,
            surface=reach.caster(),
            bare_ground=BARE_GROUND[reach.material],
            divergence_rad=0.003,
        ),
        returns=TrueReturns.from_table(shots, {int(k): k.name for k in EchoKind}),
        bare_materials=BARE_GROUND,
        vertical_corrections=True,
        correlation_s=1.0,
    )
    ground = statistics[statistics["points"] == "bare ground"].set_index("quantity")["value"]
    # Poses and mount are exact: predicted is the beam alone. The NMAD of n = 50,000 normalised errors is
    # known to 0.6 %; spots that graze a bump widen the tails (0.7 % beyond 3 sigma), not the middle. The beam
    # and the weak echo err otherwise than stated (`twin.effects.misstated`): 5 % here, where 3 % would do.
    assert (abs(ground["normalised_nmad"] - 1) < 0.06) == consistent


def test_filters_take_what_they_should_and_leave_the_rest(tiny_house):
    """Scored against the truth of single shots: ghosts and the own boat go, surfaces stay."""
    scores = pd.read_csv(tiny_house.root / BASE / "accuracy/filter_scores.csv").set_index("kind")
    assert set(scores.index) == {"SURFACE", "MIXED", "GHOST", "HULL"}
    assert (scores["n"] > 500).all()
    kept = scores["share_kept"]
    assert kept["SURFACE"] > 0.99  # the water beside the boat and single leaves far away are surfaces too
    assert kept["HULL"] < 0.001
    # ghosts of what stands less than some decimetre above the water lie within the margin below it, and stay
    assert kept["GHOST"] < 0.13


def test_a_change_of_one_instrument_leaves_the_others_alone(tiny_house):
    """Jobs of the twin name the parts they need: a finer terrestrial scan does not sail the boat again."""
    campaign = tiny_house.root / "config/campaigns/tiny.yaml"
    text = campaign.read_text()
    try:
        campaign.write_text(text.replace("  size: tiny\n", "  size: tiny\n  tls: {spacing_m: 0.06}\n"))
        of_reference = {"simulate_tls", "read_reference", "plot_reference_view", "mesh_reference"}
        comparing = {"compare_with_reference", "accuracy_page", "summarise"}
        assert planned(tiny_house) == of_reference | comparing | OF_DISTANCES | OF_CHAINS
        campaign.write_text(text.replace("accuracy: #", "accuracy:\n  sections: {count: 2} #"))
        assert planned(tiny_house) == {"plot_cross_sections", "accuracy_page"}
        campaign.write_text(text + "\nreference: {sigma_m: 0.01}\n")
        assert planned(tiny_house) == comparing | OF_DISTANCES | OF_CHAINS
        campaign.write_text(text + "\nlidar_accuracy: {footprint_share: 0.25}\n")
        again = planned(tiny_house)
        assert {"georeference_lidar", "export_map", "compare_with_truth", "plot_cloud_overview"} <= again
        assert not any(rule.startswith(("simulate_", "read_", "scan_")) for rule in again)
        assert "build_trajectory" not in again
    finally:
        campaign.write_text(text)


# ---------------------------------------------------------------- rules one by one

QUICK = {"validate_bed"}
"""What `make test` runs alone; `make test-slow` all rules."""


def stamps(folder: Path) -> dict[str, tuple[int, int]]:
    """Each file of a folder with its size and time."""
    return {
        path.relative_to(folder).as_posix(): (path.stat().st_size, path.stat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.is_file()
    }


def within(name: str, outputs: set[str]) -> bool:
    """Whether a file is one of these, or lies in a folder that is one."""
    return not outputs.isdisjoint([name, *(parent.as_posix() for parent in Path(name).parents)])


@pytest.mark.parametrize(
    "rule",
    [
        pytest.param(rule, marks=() if rule in QUICK else pytest.mark.slow)
        for rule in sorted(rule_names(House(Path(__file__).parents[2])))
    ],
)
def test_a_rule_alone_makes_its_results_again_and_nothing_else(tiny_house, tmp_path, repository, rule):
    """From what the others left, with no other rule allowed; files compared by value."""
    base = tiny_house.root / BASE
    records = [json.loads(path.read_text()) for path in sorted(base.rglob("*.meta.json"))]
    own = [record for record in records if record["rule"] == rule]
    if not own:
        pytest.skip("makes nothing of this campaign")
    made = [record["output"] for record in own]
    if not all(
        (tiny_house.root / name).exists() for record in own for name in [record["output"], *record["inputs"]]
    ):
        pytest.skip("takes or makes files that a run removes")
    shutil.copytree(base, tmp_path / "all", copy_function=os.link)  # results are replaced, never overwritten
    before = stamps(base)
    tiny_house.snakemake(made[0], "--force", "--config", "campaign=tiny", "--allowed-rules", rule)
    after = stamps(base)
    renewed = {name for name, stamp in after.items() if before.get(name) != stamp}
    for name in renewed:
        for tree, source in (("before", tmp_path / "all"), ("after", base)):
            (tmp_path / tree / name).parent.mkdir(parents=True, exist_ok=True)
            if (source / name).is_file():
                os.link(source / name, tmp_path / tree / name)
    shutil.rmtree(base)
    (tmp_path / "all").rename(base)  # as if nothing had happened, for the tests after this one
    assert before.keys() == after.keys()
    names = {name.removeprefix(f"{BASE}/") for name in made}
    assert renewed
    assert {name for name in renewed if not within(name.removesuffix(".meta.json"), names)} == set()
    golden = runpy.run_path(str(repository / "tests/golden/compare.py"))
    different = list(golden["differences"](tmp_path / "before", tmp_path / "after", tolerance=1e-9))
    assert not different, different
