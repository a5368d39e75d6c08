"""What the rules of a campaign take, without Snakemake: twins, real logs, calibrations, basins."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from thalweg.settings import Campaign, load_campaigns, with_calibrations
from thalweg.workflow import CampaignFiles
from thalweg_lab.campaign_files import (
    calibrated_boat,
    has_ledger,
    ledger_outputs,
    ledger_results,
    ledger_studies,
    ledger_table,
    n_images,
    rig_device,
    sheet_basin,
    twin_logs,
)


@pytest.fixture(scope="module")
def shipped(repository):
    """The campaigns of the repository and those that they name."""
    folder = repository / "config/campaigns"
    chosen = load_campaigns(["tiny", "field_tiny", "basin_tiny", "demo", "tiny_change"], folder)
    campaigns = with_calibrations(chosen, folder)
    return {name: CampaignFiles(name=name, campaigns=campaigns, twin_logs=twin_logs) for name in campaigns}


IDENTITY = {
    "id": "boat",
    "title": "t",
    "crs": "EPSG:25833",
    "origin": {"lat_deg": 51.0, "lon_deg": 13.0, "h_ell_m": 300.0},
}


def survey(**sections: object) -> CampaignFiles:
    """A campaign of real logs, whose files are not looked at."""
    campaign = Campaign.model_validate_json(json.dumps({"campaign": IDENTITY, **sections}))
    return CampaignFiles(name="boat", campaigns={"boat": campaign})


def names(files: list[str]) -> list[str]:
    return [name.removeprefix("results/boat/") for name in files]


def test_logs_of_a_twin_are_those_that_the_laboratory_writes(shipped):
    tiny = shipped["tiny"]
    assert tiny.is_twin()
    assert tiny.logs("lidar") == ["results/tiny/simulation/logs/lidar.pcap"]
    assert tiny.logs("clock_ties") == []
    assert len(tiny.logs("reference")) == 3
    assert tiny.has_time_lapse()
    # without the laboratory nobody knows where a twin writes
    alone = CampaignFiles(name="tiny", campaigns=tiny.campaigns)
    assert alone.logs("lidar") == []


def test_logs_of_a_survey_are_those_that_its_file_names():
    boat = survey(logs={"lidar": ["a.pcap"], "ins": ["a.anpp"], "gnss": {"rover": ["a.sbp"]}})
    assert not boat.is_twin()
    assert boat.logs("lidar") == ["a.pcap"]
    assert boat.log_option("gps_week") is None
    assert boat.best_chain() == "ins"
    assert boat.best_trajectory() == "results/boat/orientation/trajectory.parquet"
    assert boat.calibration_file() == []
    assert not boat.has_reference()
    with pytest.raises(KeyError):
        boat.logs("no_such_stream")


@pytest.mark.parametrize(
    ("source", "ins", "positions", "base"),
    [
        ("sbp", ["a.anpp"], ["a.sbp"], []),
        ("ppk", ["a.anpp"], ["a.sbp"], ["b.sbp"]),
        ("pos", ["a.anpp"], ["ppk.pos"], []),
        ("ins", ["a.anpp"], [], []),
        ("sbet", ["a.sbet"], [], []),
    ],
)
def test_the_position_source_decides_which_logs_are_read(source, ins, positions, base):
    gnss = {"rover": ["a.sbp"], "base": ["b.sbp"]}
    logs = {
        "lidar": ["a.pcap"],
        "ins": ["a.anpp"],
        "sbet": ["a.sbet"],
        "smrmsg": ["a.out"],
        "positions": ["ppk.pos"],
        "gnss": gnss,
    }
    boat = survey(logs=logs, orientation={"position_source": source})
    assert boat.ins_logs() == ins
    assert boat.position_logs() == positions
    assert boat.ppk_logs("base") == base
    assert boat.smrmsg_logs() == (["a.out"] if source == "sbet" else [])
    # INS states have one report, whichever file they are of
    assert names(boat.reports()) == [
        f"ingest/{stream}.integrity.json" for stream in ("lidar", "ins", "gnss", "positions")
    ]


@pytest.mark.parametrize("source", ["stated", "motion"])
def test_poses_come_before_the_time_of_a_lidar_that_the_motion_tells(source):
    """Else the poses wait for the common time axis, and that for the lidar's time: a circle."""
    boat = survey(logs={"lidar": ["a.pcap"], "ins": ["a.anpp"]}, lidar={"clock": {"source": source}})
    tells = source == "motion"
    told = boat.where(CampaignFiles.motion_tells_time, "orientation/trajectory_stated.parquet")
    assert names(told) == ["orientation/trajectory_stated.parquet"] * tells
    assert names(boat.streams_before_poses()) == ["timing/streams.csv"] * (not tells)


@pytest.mark.parametrize("lidar", [True, False])
def test_photographs_give_the_chains_without_a_lidar_too(lidar):
    logs = {"sbet": ["a.sbet"], "gps_week": 2157, "time_lapse": {"images": ["a.jpg"]}}
    boat = survey(
        logs=logs | ({"lidar": ["a.pcap"]} if lidar else {}), orientation={"position_source": "sbet"}
    )
    (row,) = (row for row in boat.products() if row.name == "camera trajectory; fused trajectory")
    assert row.made
    file = "accuracy/trajectories.html" if lidar else "orientation/trajectory_fused.parquet"
    assert names([row.file]) == [file]


def test_full_covariances_where_something_judges_them(shipped):
    logs = {"lidar": ["a.pcap"], "ins": ["a.anpp"]}
    plain = survey(logs=logs, georeferencing={"correlations": False})
    judged = survey(logs={**logs, "reference": ["a.laz"]}, georeferencing={"correlations": False})
    assert plain.georeferencing()["correlations"] is False
    assert judged.georeferencing()["correlations"] is True
    assert shipped["tiny"].georeferencing()["correlations"] is True
    assert "export_map" not in plain.georeferencing()
    # and what it was asked for stays what the campaign says
    assert judged.section("georeferencing", "correlations") is False


def test_parts_of_settings_leave_out_what_a_job_does_not_depend_on(shipped):
    tiny = shipped["tiny"]
    assert set(tiny.identity("id", "seed")) == {"id", "seed"}
    assert set(tiny.mounts("lidar")) == {"lidar"}
    whole = tiny.section("reference")
    assert tiny.without("reference", "sigma_m") == {k: v for k, v in whole.items() if k != "sigma_m"} != whole
    assert "sections" not in tiny.comparison()
    assert set(tiny.twin_parts("scene")) == {"size", "start_utc", "duration_s", "field", "scene"}
    assert tiny.section("images", "mapping", "parts") == tiny.campaign.images.mapping.parts
    with pytest.raises(KeyError):
        tiny.section("images", "mappnig")


@pytest.mark.parametrize(
    ("n", "stated", "jobs", "threads"),
    [
        (0, "auto", 1, 1),
        (32, "auto", 1, 1),
        (33, "auto", 2, 1),
        (250, "auto", 8, 1),
        (251, "auto", 8, 8),
        (1025, "auto", 16, 8),
        (1025, 3, 3, 3),
        (20, 3, 3, 1),
    ],
)
def test_images_and_their_pairs_are_dealt_out_by_their_number(shipped, tmp_path, n, stated, jobs, threads):
    """Of a twin as it will take them; of a survey as they lie in folders and below."""
    of_parts = {"parts": stated}
    (tmp_path / "below").mkdir()
    for k in range(n):
        (tmp_path / ("below" if k % 2 else "") / f"{k}.JPG").touch()
    (tmp_path / "readme.txt").touch()
    real = survey(
        logs={"time_lapse": {"images": [str(tmp_path)]}}, images={"features": of_parts, "mapping": of_parts}
    )
    twin = replace(
        shipped["tiny"],
        campaigns={"tiny": shipped["tiny"].campaign.model_copy(update={"images": real.campaign.images})},
        twin_images=lambda _: n,
    )
    for files in (real, twin):
        assert (files.n_parts("features"), files.n_parts("mapping")) == (jobs, jobs)
        assert len(files.feature_parts()) == len(files.pair_parts()) == jobs
        assert files.mapper_threads() == threads
    assert n_images(shipped["tiny"].campaign) > 0 == n_images(shipped["basin_tiny"].campaign)


def test_a_survey_takes_clock_lens_and_boat_of_its_calibration(shipped):
    demo = shipped["demo"]
    assert demo.calibration_campaign() == "field_small"
    assert demo.calibration_file() == ["results/field_small/calibration/boat.yaml"]
    assert demo.camera_clock() == ["results/field_small/timing/camera_clock.yaml"]
    assert demo.clock_stability() == ["results/field_small/timing/clock_stability.json"]
    assert demo.calibrated_interior() == ["results/field_small/calibration/camera.yaml"]
    assert demo.known_interior() == ["results/demo/orientation/camera_start.yaml"]
    assert calibrated_boat(demo) == ["results/field_small/simulation/truth/mounts.json"]
    # a file in its place is taken as it is, and no clock comes with it
    boat = survey(logs={"lidar": ["a.pcap"], "ins": ["a.anpp"]}, mounts={"calibration": "own/boat.yaml"})
    assert boat.calibration_file() == ["own/boat.yaml"]
    assert boat.calibration_campaign() is None
    assert boat.camera_clock() == []
    assert calibrated_boat(boat) == []


def test_the_calibration_itself_has_the_clock_that_its_logs_allow(shipped):
    field = shipped["field_tiny"]
    assert field.has_kinematic_clock()
    assert field.camera_clock() == ["results/field_tiny/timing/camera_clock.yaml"]
    assert field.tied_images() == []
    given = {
        "field": ["f.yaml"],
        "run_images": ["i"],
        "position_images": ["p"],
        "position_scans": ["s"],
        "clock_ties": ["t.csv"],
    }
    tied = survey(logs={"lidar": ["a.pcap"], "ins": ["a.anpp"], "calibration": given})
    assert not tied.has_kinematic_clock()
    assert names(tied.camera_clock()) == ["timing/camera_clock_ties.yaml"]
    assert names(tied.tied_images()) == ["timing/image_times_ties.parquet"]
    assert "calibration/camera_lidar.yaml" in names(tied.final_outputs())
    assert not any("truth" in name for name in tied.final_outputs())


def test_the_longest_list_of_outputs_is_the_demo(shipped):
    outputs = shipped["demo"].final_outputs()
    assert len(set(outputs)) == len(outputs)
    assert {name.split("/")[1] for name in outputs} == {"demo"}
    for name in (
        "lidar/points.laz", "summary.csv", "accuracy/index.html",
        "accuracy/trajectories.html", "lidar/by_fused/points.laz", "triangulation/strip/bed.laz",
        "report.pdf", "survey.qgz", "survey.gpkg",
    ):  # fmt: skip
        assert f"results/demo/{name}" in outputs


def test_strips_are_a_chain_where_they_are_asked_for(shipped):
    demo, tiny = shipped["demo"], shipped["tiny"]
    assert tiny.aligned_strips() == []
    made = ["orientation/strips.html", "lidar/by_strips/points.laz", "accuracy/by_strips/statistics.csv"]
    assert demo.aligned_strips() == [f"results/demo/{name}" for name in made]
    assert set(demo.aligned_strips()) <= set(demo.final_outputs())
    assert (
        demo.trajectory_of_lidar("by_strips/") == "results/demo/orientation/trajectory_strips_lidar.parquet"
    )
    assert demo.trajectory_of_lidar("by_fused/") == demo.trajectory("fused")
    assert demo.mounts_of_chain("by_strips/") == "results/demo/orientation/mounts_strips.json"
    assert "by overlapping strips" in demo.page_names()
    assert "by overlapping strips" not in tiny.page_names()
    assert len(demo.page_names()) == len(demo.page_clouds())
    assert demo.windows("by_strips/", "points", ".las") == []


def test_strips_place_what_is_placed_where_they_are_to():
    """Bed, colours and pages take the corrected trajectory; strips themselves begin from the sensors."""
    logs = {"lidar": ["a.pcap"], "ins": ["a.anpp"]}
    for more, sensors, others in (
        ({}, "trajectory", ["by INS"]),
        (
            {"time_lapse": {"images": ["a.jpg"]}},
            "trajectory_fused",
            ["by INS", "by camera", "by all sensors"],
        ),
    ):
        boat = survey(logs=logs | more, strips={"use": True})
        assert names([boat.best_trajectory(), boat.best_errors(), *boat.best_points()]) == [
            "orientation/trajectory_strips.parquet",
            "orientation/errors_strips.npz",
            "lidar/by_strips/points.laz",
        ]
        assert names([boat.trajectory_of_sensors()]) == [f"orientation/{sensors}.parquet"]
        assert boat.page_names() == ["by overlapping strips", *others]
        assert len(set(boat.page_clouds())) == len(boat.page_names())
        assert set(boat.best_points()) <= set(boat.final_outputs())
        assert boat.best_points() == [boat.best_cloud()]
    beside = survey(logs=logs, strips={"adjust": True})
    assert names([beside.best_trajectory()]) == ["orientation/trajectory.parquet"]
    assert beside.page_names() == ["by INS", "by overlapping strips"]


def test_what_is_handed_over_is_made(shipped):
    """Files of the report and of the project for QGIS are outputs; some campaigns have no report."""
    for name in ("demo", "tiny_change"):
        files = shipped[name]
        assert {*files.delivered(), *files.map_rasters(), *files.map_clouds()} <= set(files.final_outputs())
        assert len(files.delivered()) >= 4
    assert "results/tiny_change/deformation/dod_1-2.tif" in shipped["tiny_change"].map_rasters()
    assert not shipped["field_small"].has_report()
    assert "results/field_small/report.pdf" not in shipped["field_small"].final_outputs()


def test_a_survey_without_reference_and_images_has_no_pages_of_them():
    found = survey(logs={"lidar": ["a.pcap"], "ins": ["a.anpp"]}).final_outputs()
    assert "lidar/points.laz" in names(found)
    assert not [name for name in found if "/accuracy/" in name or "by_" in name.split("/")[-2]]


def test_steps_of_the_camera_are_those_of_who_oriented_the_images(shipped):
    own = shipped["tiny"].chain_steps()["camera"]
    assert "results/tiny/orientation/sfm/features_0.npz" in own
    logs = {
        "lidar": ["a.pcap"],
        "ins": ["a.anpp"],
        "time_lapse": {"images": ["a.jpg"], "orientations": ["p.parquet"]},
    }
    boat = survey(logs=logs)
    assert names(boat.chain_steps()["camera"]) == [
        f"orientation/{name}.parquet"
        for name in ("image_poses_finished", "image_poses_timed", "trajectory_camera")
    ]
    assert names([boat.oriented_images()]) == ["orientation/image_poses_finished.parquet"]
    assert boat.control_reports() == []
    assert not boat.images_hold_positions()
    assert boat.of_compared_chains("statistics.csv") == []


def test_a_rig_may_be_the_camera_that_orients_the_boat(shipped):
    """Its files, stamps, clock and mount go the way of the camera's; colours take the poses of its block."""
    tiny = shipped["tiny"]
    assert not tiny.is_by_rig()
    assert tiny.rig_poses() == ["results/tiny/panorama/poses.parquet"]
    assert tiny.rig_mount() == {}
    images = tiny.campaign.images.model_copy(update={"source": "rig"})
    campaign = tiny.campaign.model_copy(update={"images": images})
    rigged = replace(tiny, campaigns={**tiny.campaigns, "tiny": campaign})
    assert rigged.stamped_images() == ["results/tiny/simulation/logs/rig"]
    assert rigged.stamp_option("utc_offset") == "+02:00"
    assert rigged.stated_clock()["offset_s"] == 0.62
    assert rigged.rig_mount()["lever_ics_m"] == [-0.25, 0.1, -0.9]
    assert rigged.oriented_images() == "results/tiny/orientation/image_poses_rig.parquet"
    assert rigged.chain_steps()["camera"][0] == rigged.oriented_images()
    assert rigged.best_chain() == "fused"
    assert rigged.rig_poses() == ["results/tiny/orientation/image_poses_fused.parquet"]
    assert rigged.colour_images() == rigged.known_interior() == rigged.control_reports() == []
    assert not rigged.orients_images()
    made = rigged.final_outputs()
    assert "results/tiny/lidar/coloured.laz" in made
    assert "results/tiny/lidar/colour_check.csv" not in made
    # without a calibration of the rig the camera stays what it was
    logs = {"lidar": ["a.pcap"], "ins": ["a.anpp"], "time_lapse": {"images": ["a.jpg"]}}
    assert survey(logs=logs, images={"source": "rig"}).stamped_images() == ["a.jpg"]


def test_a_rig_is_calibrated_with_the_boat(shipped):
    """The room of the calibration campaign; its device is that of the survey."""
    demo, yard = shipped["demo"], shipped["field_small"]
    assert demo.logs("rig_field_images") == yard.logs("rig_images") == []
    assert demo.rig_calibration() == ["results/field_small/calibration/rig.yaml"]
    assert demo.has_panoramas()
    assert not yard.has_panoramas()
    assert set(demo.rig_calibration()) < set(yard.final_outputs())
    assert rig_device(demo) == rig_device(yard)
    assert rig_device(demo)["seed"] == 21


def test_the_page_of_a_survey_holds_the_clouds_of_all_chains(shipped):
    """The best one in colour, then the others; of a change its places."""
    tiny = shipped["tiny"]
    assert tiny.page_clouds() == [
        f"results/tiny/lidar/{name}" for name in ("coloured.laz", "points.laz", "by_camera/points.laz")
    ]
    assert tiny.page_names() == ["by all sensors", "by INS", "by camera"]
    alone = survey(logs={"lidar": ["a.pcap"], "ins": ["a.anpp"]})
    assert names(alone.page_clouds()) == ["lidar/points.laz"]
    assert alone.page_names() == ["by INS"]
    change = shipped["tiny_change"]
    assert change.page_clouds() == ["results/tiny_change/deformation/changes_1-2.laz"]
    assert change.page_names() == ["tiny_before to tiny_after"]
    assert change.page_path() == []


def test_lines_on_the_grid_object_are_short_pieces_in_as_many_levels(shipped):
    """What the calibration changes of the campaign's lines stands in the campaign file, too."""
    basin = shipped["basin_tiny"]
    lines = basin.section("light_sheet", "lines")
    assert basin.sheet_lines("panels") == lines
    found = basin.sheet_lines("calibration")
    assert found == lines | {"lines": 2, "link_gap_rows": 0, "least_rows": 5, "largest_rows": 7}
    pieces = {"least_rows": 9}
    own = survey(logs={"lidar": ["a.pcap"]}, light_sheet={"calibration": {"levels": 3, "pieces": pieces}})
    assert own.sheet_lines("calibration")["lines"] == 3
    assert own.sheet_lines("calibration")["least_rows"] == 9


def test_scans_of_a_basin(shipped):
    basin = shipped["basin_tiny"]
    assert basin.scan_names() == ["stepped", "wreck"]
    assert basin.sheet_series() == ["calibration", "panels", "stepped", "wreck"]
    assert basin.sheet_images("calibration") == basin.logs("grid_images")
    assert basin.sheet_images("wreck") == basin.scan_logs("wreck", "images") == basin.logs("wreck")
    assert basin.scan_levels("wreck") is None
    assert len(basin.scan_levels("stepped") or []) == 3
    # as a surveyor hands them in; a scan without a reference is compared with nothing
    scans = {"hull": {"images": ["h"], "reference": ["h.ply"]}, "keel": {"images": ["k"]}}
    own = survey(logs={"light_sheet": {"grid_images": ["g"], "scans": scans}})
    assert own.scan_names() == ["hull", "keel"]
    assert own.compared_scans() == ["hull"]
    assert own.sheet_series() == ["calibration", "hull", "keel"]
    assert not has_ledger(own)
    assert ledger_outputs(own) == []


def test_the_ledger_reads_what_the_basin_makes(shipped, repository, tmp_path, monkeypatch):
    basin = shipped["basin_tiny"]
    assert has_ledger(basin)
    assert ledger_table(basin) == ["results/basin_tiny/triangulation/ledger.csv"]
    found = ledger_results(basin, repository)
    assert len(found) == len(set(found)) > 5
    assert any("/wreck/" in name for name in found)
    monkeypatch.chdir(tmp_path)
    assert ledger_studies(repository) == {}
    written = yaml.safe_load((repository / "config/studies/multi_line_study.yaml").read_text())
    study = Path(written["tables"]["multi_line"]["file"])
    study.parent.mkdir(parents=True)
    study.write_text("a\n1\n")
    assert set(ledger_studies(repository)) <= {study.as_posix()}


def test_a_boat_carries_the_sensor_of_its_basin(shipped):
    demo = shipped["demo"]
    assert demo.sheet_on_board() == ["results/basin_small/triangulation/sensor.yaml"]
    assert demo.sheet_design() == demo.sheet_on_board()
    assert set(sheet_basin(demo)) == {"seed", "twin"}
    assert set(sheet_basin(demo)["twin"]) == {"size", "light_sheet"}
    assert shipped["basin_tiny"].sheet_design() == shipped["basin_tiny"].logs("sheet_sensor")
    with pytest.raises(KeyError):
        sheet_basin(shipped["tiny"])


def test_targets_are_parts_of_a_campaign(shipped):
    demo = shipped["demo"]
    assert "results/demo/lidar/by_fused/points.laz" in demo.target("lidar")
    assert "results/demo/ingest/camera.integrity.json" in demo.target("ingest")
    assert "results/demo/orientation/trajectory_camera.parquet" in demo.target("images")
    for part in ("lidar", "accuracy"):
        assert set(demo.target(part)) < set(demo.final_outputs())
        assert {name.split("/")[2] for name in demo.target(part)} == {part}
    # a basin has neither streams nor a boat
    assert {part: len(shipped["basin_tiny"].target(part)) for part in ("ingest", "lidar", "images")} == {
        "ingest": 0,
        "lidar": 0,
        "images": 0,
    }


@pytest.mark.parametrize(
    ("seconds", "on_cluster", "length_s", "n"),
    [
        ("auto", False, 7200.0, 0),  # one part: the jobs of a laptop are as ever
        ("auto", True, 7200.0, 4),
        ("auto", True, 1700.0, 0),
        (900, False, 7201.0, 9),
        (900, False, math.nan, 0),  # an Ouster
    ],
)
def test_a_log_is_cut_where_that_is_asked_for(seconds, on_cluster, length_s, n):
    logs = {"lidar": ["/logs/a.pcap", "/logs/b.pcap"], "ins": ["/logs/ins.anpp"]}
    mounts = {"lidar": {"phi_deg": -90.0, "lever_ics_m": [-0.35, 0.0, -0.25]}}
    asked = []

    def measured(files, options):
        asked.append((files, options["data_port"]))
        return length_s

    files = replace(
        survey(logs=logs, mounts=mounts, scatter={"seconds": seconds}),
        log_length_s=measured,
        on_cluster=on_cluster,
    )
    parts = files.windows("fused", "points", ".las")
    assert names(parts) == [f"lidar/windows/fused_points_{k}.las" for k in range(n)]
    # a log that stays whole is not opened
    assert asked == ([] if seconds == "auto" and not on_cluster else [(logs["lidar"], 2368)])
    if n:
        length = 1800.0 if seconds == "auto" else seconds
        assert files.window("2") == {"index": 2, "count": n, "seconds": length}


def test_parts_of_a_shapefile_are_inputs_too(tmp_path):
    """A bank whose side is exchanged in the .dbf is traced again."""
    for end in ("shp", "dbf", "prj"):
        (tmp_path / f"banks.{end}").touch()
    boat = survey(logs={"depth": ["a.nmea"], "bank_lines": [str(tmp_path / "banks.shp")]})
    assert [Path(file).name for file in boat.drawn("bank_lines")] == ["banks.shp", "banks.dbf", "banks.prj"]
    assert names(boat.mapped("bathymetry/soundings.csv")) == ["bathymetry/soundings.csv"]
    assert names(survey(logs={"lidar": ["a.pcap"]}).mapped("fusion/dtm.tif")) == []
