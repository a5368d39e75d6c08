"""Good campaigns: what comes out of them."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.settings.conftest import in_order
from thalweg.cli import main
from thalweg.settings import load_campaign, load_campaigns, natural_order
from thalweg.settings.messages import CampaignError

SHIPPED = sorted((Path(__file__).resolve().parents[2] / "config" / "campaigns").glob("*.yaml"))


def test_good_campaign(write, survey):
    campaign = load_campaign(write())
    assert campaign.id == "good"
    assert campaign.twin is None
    assert campaign.log_files("lidar") == [survey / "raw/lidar_1.pcap", survey / "raw/lidar_2.pcap"]
    assert campaign.log_files("rover") == campaign.log_files("sbp") == [survey / "raw/rover.sbp"]
    assert campaign.log_files("base") == []
    assert campaign.georeferencing.max_range_m == 120.0
    with pytest.raises(KeyError):
        campaign.log_files("radar")


def test_plain_values_are_those_of_json(write):
    """Snakemake compares params by their printed form: only text, numbers, lists and dicts may occur."""
    plain = load_campaign(write()).plain()
    assert json.loads(json.dumps(plain)) == plain
    assert plain["mounts"]["antenna"]["lever_ics_m"] == [0.1, 0.0, -0.45]
    assert plain["mounts"]["lidar"]["sigma_omega_deg"] == 0.018  # Table 3.1 of the thesis
    assert plain["ins"]["sigma_heading_deg"] == 0.2
    assert plain["ins"]["sigma_position_m"] is None


def test_patterns_home_and_absolute_paths(write, survey, monkeypatch):
    monkeypatch.setenv("HOME", str(survey))
    files = f"""
        logs.lidar: ["raw/lidar_?.pcap"]
        logs.ins: [~/raw/boat.anpp]
        logs.positions: [{survey}/raw/ppk.pos]
        logs.depth: ["**/*.nmea"]
    """
    monkeypatch.chdir("/")
    campaign = load_campaign(write(files))
    assert [p.name for p in campaign.log_files("lidar")] == ["lidar_1.pcap", "lidar_2.pcap"]
    assert campaign.log_files("ins") == [survey / "raw/boat.anpp"]
    assert campaign.log_files("pos") == [survey / "raw/ppk.pos"]
    assert campaign.log_files("depth") == [survey / "raw/echo.nmea"]


@pytest.mark.parametrize("text", ["raw/../camera.txt", "camera.txt", "~/camera.txt"])
def test_the_interior_of_a_camera_is_found_from_the_campaign_file(text, write, survey, monkeypatch):
    """Its path holds from every folder, and it is an input of a rule like any file."""
    (survey / "camera.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n")
    monkeypatch.setenv("HOME", str(survey))
    path = write({"calibration.boat_camera.interior": text})
    monkeypatch.chdir(path.parent.parent)
    campaign = load_campaign(f"{path.parent.name}/{path.name}")
    assert campaign.log_files("ins") == [survey / "raw/boat.anpp"]
    assert campaign.calibration.boat_camera.interior == str(survey / "camera.txt")
    assert campaign.plain()["calibration"]["boat_camera"]["interior"] == str(survey / "camera.txt")


def test_brackets_in_a_real_name_are_no_pattern(write, survey):
    (survey / "boat [1].anpp").write_bytes(b"x")
    campaign = load_campaign(write("logs.ins: ['boat [1].anpp']"))
    assert campaign.log_files("ins") == [survey / "boat [1].anpp"]


def test_rinex_is_no_sbp(write, survey):
    for name in ("boat.21o", "boat.obs"):
        (survey / name).write_bytes(b"x")
    campaign = load_campaign(write("logs.gnss.rover: [boat.21o, boat.obs, raw/rover.sbp]"))
    assert campaign.log_files("sbp") == [survey / "raw/rover.sbp"]
    assert len(campaign.log_files("rover")) == 3


def test_ppk_and_sbet_campaigns(write):
    ppk = """
        orientation.position_source: ppk
        logs.gnss: {rover: [raw/rover.sbp], base: [raw/base.sbp], base_from: sbp}
        logs.positions: <removed>
    """
    assert load_campaign(write(ppk)).logs.gnss.base_from == "sbp"
    sbet = """
        orientation.position_source: sbet
        logs.sbet: [raw/base.sbp]
        logs.gps_week: 2157
        logs.ins: <removed>
        mounts.antenna: <removed>
    """
    assert load_campaign(write(sbet)).logs.gps_week == 2157


def test_compound_crs_and_proj_definitions(write):
    for crs in ("EPSG:25833+7837", "+proj=utm +zone=33 +ellps=GRS80 +units=m +no_defs"):
        assert load_campaign(write({"campaign.crs": crs})).campaign.crs == crs


def test_choice_of_campaigns(write, survey):
    write()
    second = write("campaign.id: second", name="second.yaml")
    assert list(load_campaigns("good", survey)) == ["good"]
    assert list(load_campaigns(["second", "good"], survey)) == ["second", "good"]
    assert list(load_campaigns(str(second), survey)) == ["second"]
    assert list(load_campaigns("./good.yaml", survey)) == ["good"]


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        ("god", "no campaign 'god' ... one of good ... Did you mean good?"),
        ("good,second", "no campaign 'good,second' ... --config campaign=\"[good,second]\""),
        (None, "found None ... Known ids: good"),
        (2021, "found 2021 ... the id of a campaign"),
        ([], "found []"),
        (["good", "good"], "'good' is chosen twice ... Remove one"),
        (["good", "sub/good.yaml"], "two files have the id 'good' ... Rename one"),
        ("absent/good.yaml", "absent/good.yaml: no such file"),
    ],
)
def test_bad_choices(choice, words, write, survey):
    text = write().read_text().replace("raw/", "../raw/")
    (survey / "sub").mkdir()
    (survey / "sub" / "good.yaml").write_text(text)
    with pytest.raises(CampaignError, match=in_order(words)):
        load_campaigns(choice, survey)


def test_mistakes_of_several_files_come_together(write, survey):
    write("georeferencing.max_range_m: -1")
    write("{campaign.id: two, lidar.model: x}", name="two.yaml")
    with pytest.raises(CampaignError) as caught:
        load_campaigns(["good", "two", "three"], survey)
    assert len(caught.value.mistakes) == 3
    assert [m.file.name for m in caught.value.mistakes if m.file] == ["good.yaml", "two.yaml"]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_shipped_campaigns_load(path):
    campaign = load_campaign(path)
    assert campaign.id == path.stem
    assert path.read_text().startswith("# yaml-language-server: $schema=../schema.json\n")


def test_shipped_choice_is_a_shipped_campaign(repository):
    import yaml

    choice = yaml.safe_load((repository / "config" / "config.yaml").read_text())
    assert list(choice) == ["campaign"]
    assert choice["campaign"] in {path.stem for path in SHIPPED}
    assert {path.stem for path in SHIPPED} >= {"tiny", "demo", "mulde"}


def test_import_is_light():
    """Every job parses the Snakefile, which imports this: no numerics until a CRS is to be checked."""
    code = (
        "import sys, thalweg.settings.load, thalweg.cli;"
        "heavy = {'numpy', 'pandas', 'pyproj', 'scipy', 'pyarrow', 'numba', 'open3d', 'matplotlib'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_a_pattern_lists_numbered_parts_in_their_order(write, survey):
    (survey / "raw2").mkdir()
    for k in (10, 9, 1, 2, 100):
        (survey / f"raw2/part_{k}.pcap").write_bytes(b"x")
    campaign = load_campaign(write("logs.lidar: [raw2/*.pcap]"))
    assert [p.stem for p in campaign.log_files("lidar")] == [f"part_{k}" for k in (1, 2, 9, 10, 100)]


def test_natural_order_of_names():
    names = "a/x2 a/x10 a/x a/X1 a10/x a2/x a/07 a/7 a/lidar.pcap1 a/lidar.pcap"
    found = sorted(map(Path, names.split()), key=natural_order)
    expected = "a/07 a/7 a/X1 a/lidar.pcap a/lidar.pcap1 a/x a/x2 a/x10 a2/x a10/x"
    assert " ".join(map(str, found)) == expected


def test_a_pattern_names_campaigns(write, tmp_path, monkeypatch):
    """A whole season in one run, in the order of names; what is no campaign file is no mistake."""
    good = write()
    season = tmp_path / "season"
    season.mkdir()
    for name in ("b", "a"):
        text = good.read_text().replace("id: good", f"id: {name}").replace("raw/", f"{good.parent}/raw/")
        (season / f"{name}.yaml").write_text(text)
    (season / "notes.txt").write_text("sunny")
    monkeypatch.chdir(tmp_path)
    assert list(load_campaigns("season/*", tmp_path)) == ["a", "b"]
    assert list(load_campaigns(["season/b*", str(season / "a.yaml")], tmp_path)) == ["b", "a"]
    monkeypatch.chdir("/")
    assert list(load_campaigns("season/*", tmp_path)) == ["a", "b"]
    with pytest.raises(CampaignError, match=r"no campaign file matches 'winter/\*'.*the shell must not"):
        load_campaigns("winter/*", tmp_path)


def test_a_link_out_of_the_survey_is_named(write, survey, tmp_path, capsys):
    """It is followed, as people keep logs on other disks; `check-config` says where it leads."""
    file = write()
    away = tmp_path / "disk"
    away.mkdir()
    log = survey / "raw/lidar_1.pcap"
    log.rename(away / "lidar_1.pcap")
    log.symlink_to(away / "lidar_1.pcap")
    other = survey / "raw/lidar_2.pcap"
    other.rename(other.with_name("kept.pcap"))
    other.symlink_to("kept.pcap")
    main(["check-config", str(file)])
    said = capsys.readouterr().err
    assert f"{log} is a link out of its folder, to {away / 'lidar_1.pcap'}" in said
    assert "lidar_2.pcap is a link" not in said
