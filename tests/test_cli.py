"""The command ``thalweg``."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.ingest.test_rinex import obs_3
from thalweg.cli import main
from thalweg.core import InputError
from thalweg.ingest import IntegrityReport, registry
from thalweg.settings.load import check_campaign, load_campaign


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder as working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def fill_levers(path: Path | str) -> None:
    """What a user does with the lines marked CHANGE."""
    text = Path(path).read_text()
    assert text.count("lever_ics_m: CHANGE") == 2
    Path(path).write_text(text.replace("lever_ics_m: CHANGE", "lever_ics_m: [0.1, 0.0, -0.4]"))


def test_new_campaign_lacks_only_its_files(here, capsys):
    assert main(["new-campaign", "saale_2", "--origin", "51.2", "11.9", "120"]) == 0
    path = Path("config/campaigns/saale_2.yaml")
    assert f"thalweg check-config {path}" in capsys.readouterr().out
    _, mistakes = check_campaign(path)
    # no lever arm of zero is taken in silence
    assert {"mounts.lidar.lever_ics_m", "mounts.antenna.lever_ics_m"} <= {m.dotted for m in mistakes}
    fill_levers(path)
    _, mistakes = check_campaign(path)
    assert {m.dotted for m in mistakes} == {"logs.lidar[0]", "logs.ins[0]", "logs.positions[0]"}
    assert all("file" in m.found for m in mistakes)
    text = path.read_text()
    assert text.startswith("# yaml-language-server: $schema=../schema.json\n")
    assert "crs: EPSG:32632" in text  # 11.9 degrees east lies in zone 32
    for name in ("raw/lidar/a.pcap", "raw/ins/a.anpp", "raw/gnss/boat.pos"):
        file = path.parent / name
        file.parent.mkdir(parents=True)
        file.write_bytes(b"x")
    assert load_campaign(path).campaign.origin.lon_deg == 11.9


@pytest.mark.parametrize(
    ("name", "fragment"),
    [("Saale", "cannot be the id"), ("1a", "cannot be the id"), ("there", "exists already")],
)
def test_new_campaign_refuses(here, capsys, name, fragment):
    Path("there.yaml").write_text("mine")
    assert main(["new-campaign", name, "--folder", "."]) == 2
    assert fragment in capsys.readouterr().err
    assert Path("there.yaml").read_text() == "mine"


def _put_logs(folder: Path) -> None:
    folder.mkdir()
    for name, content in {
        "a b.pcap": b"pcap",
        "boat.bin": b"anpp",
        "rover.sbp": b"sbp",
        "notes.txt": b"what",
        "base.obs": b"rinex" + b" " * 15 + b"O",
        "brdc.rnx": b"rinex" + b" " * 15 + b"N",
    }.items():
        (folder / name).write_bytes(content)


def _recognise(path: Path) -> str:
    word = path.read_bytes()[:5].decode().strip()
    if word == "what":
        raise InputError("unrecognised file", where=path)
    return {"pcap": "capture"}.get(word, word)


def test_new_campaign_from_logs(here, capsys, monkeypatch):
    """Files are sorted by their content; what is not known is named and left out."""
    monkeypatch.setattr(registry, "recognise", _recognise)
    _put_logs(here / "raw")
    assert main(["new-campaign", "mine", "--from-logs", "raw", "--folder", "."]) == 0
    said = capsys.readouterr()
    assert "left out" in said.err
    assert "notes.txt" in said.err
    fill_levers("mine.yaml")
    campaign = load_campaign("mine.yaml")
    assert campaign.orientation.position_source == "ppk"
    for stream, names in {
        "lidar": ["a b.pcap"],
        "ins": ["boat.bin"],
        "rover": ["rover.sbp"],
        "base": ["base.obs"],
        "nav": ["brdc.rnx"],
        "pos": [],
        "depth": [],
    }.items():
        assert campaign.log_files(stream) == [here / "raw" / name for name in names]


POS_HEAD = (
    "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
    "  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n"
)


def _solution(q: int, times_s: list[float]) -> str:
    """RTKLIB solution of 12 June 2024; quality 1 fixed, 2 float, 5 single."""
    rows = [
        f"2024/06/12 10:00:{t:06.3f}   {51 + t * 1e-6:.9f}   {13.75 + 1e-7 * t * t:.9f}   155.0000   {q}  12"
        "   0.0089   0.0067   0.0153   0.0012   0.0008  -0.0011   0.00   25.3\n"
        for t in times_s
    ]
    return POS_HEAD + "".join(rows)


def test_new_campaign_says_which_of_several_tracks_it_takes(here, capsys):
    """Events stay out; of three solutions the fixed one is taken; raw GNSS of another year is told."""
    raw = here / "raw"
    raw.mkdir()
    seconds = [float(k) for k in range(10, 40)]
    (raw / "rover.pos").write_text(_solution(1, seconds))
    (raw / "old_float.pos").write_text(_solution(2, seconds))
    (raw / "single.pos").write_text(_solution(5, seconds))
    (raw / "rover_events.pos").write_text(_solution(1, [12.4, 22.4, 32.4]))
    (raw / "rover.21O").write_text(obs_3(5))  # 2017
    assert main(["new-campaign", "mine", "--from-logs", "raw", "--folder", "."]) == 0
    said, text = capsys.readouterr().err, Path("mine.yaml").read_text()
    assert "  positions: [raw/rover.pos]" in text
    assert "position_source: pos" in text
    for sentence in (
        "left out, 3 times of events, interpolated on a track: rover_events.pos",
        "left out, of the same time as rover.pos, which has more fixed positions: old_float.pos, single.pos",
        "positions from pos: a finished solution before raw logs; these logs would also give ppk; CHANGE: "
        "the raw GNSS is of another time (2017-05-12), keep one of both",
    ):
        assert sentence in said
        assert f"  # {sentence}\n" in text
    (raw / "rover.pos").unlink()  # none is fixed: no third one is taken in silence
    assert main(["new-campaign", "other", "--from-logs", "raw", "--folder", "."]) == 0
    said, text = capsys.readouterr().err, Path("other.yaml").read_text()
    assert "left out, of the same time as " in said
    assert text.count(".pos]") == 1
    (raw / "old_float.pos").unlink()
    (raw / "single.pos").unlink()  # events without their track are no track: the raw GNSS is left
    assert main(["new-campaign", "third", "--from-logs", "raw", "--folder", "."]) == 0
    text = Path("third.yaml").read_text()
    assert "  # left out, 3 times of events, interpolated on a track: rover_events.pos\n" in text
    assert "  # positions: []" in text
    assert "position_source: ppk" in text


def test_new_campaign_lists_numbered_parts_in_their_order(here, monkeypatch):
    monkeypatch.setattr(registry, "recognise", _recognise)
    _put_logs(here / "raw")
    for k in (10, 2, 1):
        (here / "raw" / f"part_{k}.pcap").write_bytes(b"pcap ")
    assert main(["new-campaign", "mine", "--from-logs", "raw", "--folder", "."]) == 0
    fill_levers("mine.yaml")
    names = [path.name for path in load_campaign("mine.yaml").log_files("lidar")]
    assert names == ["a b.pcap", "part_1.pcap", "part_2.pcap", "part_10.pcap"]


def test_new_campaign_from_a_folder_without_logs(here, capsys, monkeypatch):
    monkeypatch.setattr(registry, "recognise", _recognise)
    Path("raw").mkdir()
    assert main(["new-campaign", "mine", "--from-logs", "raw", "--folder", "."]) == 2
    assert "no raw log was recognised" in capsys.readouterr().err
    assert main(["new-campaign", "mine", "--from-logs", "rax", "--folder", "."]) == 2
    assert "rax: no such folder" in capsys.readouterr().err
    assert not Path("mine.yaml").exists()


def test_check_config(repository, monkeypatch, capsys):
    monkeypatch.chdir(repository)
    assert main(["check-config", "tiny", "config/campaigns/demo.yaml"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0].startswith("tiny: ok. ")
    assert out[2].startswith("demo: ok. ")
    assert "digital twin" in out[0]


def test_check_config_lists_all_mistakes(here, capsys):
    main(["new-campaign", "mine", "--folder", "."])
    assert main(["check-config", "mine.yaml", "none.yaml"]) == 2
    said = capsys.readouterr().err
    assert "6 mistakes in the campaign settings" in said
    assert "Traceback" not in said


def _fake_describe(monkeypatch) -> None:
    def describe(path: Path, options: object = None) -> IntegrityReport:
        if path.name == "bad":
            raise InputError("the file is empty", where=path)
        return IntegrityReport(stream="lidar", format="pcap", files=[str(path)])

    monkeypatch.setattr(registry, "describe", describe)


def test_describe(monkeypatch, capsys):
    _fake_describe(monkeypatch)
    assert main(["describe", "one", "two"]) == 0
    assert "lidar: pcap\n  file      one\n" in capsys.readouterr().out


def test_describe_goes_on_after_a_bad_file(monkeypatch, capsys):
    _fake_describe(monkeypatch)
    assert main(["describe", "bad", "two"]) == 2
    said = capsys.readouterr()
    assert "bad: the file is empty." in said.err
    assert "two" in said.out


def test_describe_as_json(monkeypatch, capsys):
    import json

    _fake_describe(monkeypatch)
    assert main(["describe", "--json", "one"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == ["one"]
    assert main(["describe", "--json", "one", "bad", "two"]) == 2
    assert [r["files"] for r in json.loads(capsys.readouterr().out)] == [["one"], ["two"]]


def test_summary(here, capsys):
    folder = here / "mulde"
    (folder / "figures").mkdir(parents=True)
    (folder / "figures/survey_map.png").touch()
    (folder / "summary.csv").write_text(
        "quantity,value,unit,source\npositions used,99.5,%,x\nlidar points: written,1234567.0,1,y\n"
    )
    assert main(["summary", "mulde"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["positions", "used", "99.500", "%"] in lines
    assert ["lidar", "points:", "written", "1,234,567"] in lines
    # the front page first, and no more than five
    assert lines[-2:] == [["mulde/figures/survey_map.png"], ["mulde/summary.csv"]]
    for name in ("index.html", "accuracy/index.html", "bathymetry/index.html", "lidar/points.laz"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()
    assert main(["summary", "mulde"]) == 0
    out = capsys.readouterr().out
    assert "1 pictures, 1 clouds, 1 tables in mulde" in out
    named = out.split("Worth opening first:\n")[1].splitlines()
    assert named[0].strip() == "mulde/index.html"
    assert len(named) == 5
    assert main(["summary", "results/tiny"]) == 2
    assert "--config campaign=tiny" in capsys.readouterr().err


def test_schema(here, capsys):
    assert main(["schema"]) == 0
    assert capsys.readouterr().out.startswith('{\n  "$schema"')
    assert main(["schema", "--write"]) == 2
    assert "Run the command at the root of the repository" in capsys.readouterr().err
    assert main(["schema", "--write", "--folder", "."]) == 0
    assert {p.name for p in here.iterdir()} == {"schema.json", "defaults.yaml"}
    assert main(["schema", "--write", "--folder", "."]) == 0
    assert capsys.readouterr().out.endswith("All generated files are in step\n")


def test_wrong_words_show_the_usage(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["chek"])
    assert caught.value.code == 2
    assert "new-campaign" in capsys.readouterr().err


def test_module_and_closed_pipe():
    """`python -m thalweg schema | head -1` ends without complaint, with the exit code of success."""
    command = f"{sys.executable} -m thalweg schema | head -n 1; echo ${{PIPESTATUS[0]}}"
    out = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert out.stdout == "{\n0\n"
    assert out.stderr == ""


def test_check_config_looks_into_the_logs(here, capsys):
    """Lidar and INS swapped, an observation file as track: told before the first job, all at once."""
    raw = here / "raw"
    raw.mkdir()
    (raw / "scan.pcap").write_bytes(b"\xd4\xc3\xb2\xa1" + bytes(100))
    (raw / "boat.obs").write_bytes(
        b"     3.04           OBSERVATION DATA    M                   RINEX VERSION / TYPE\n"
    )
    (here / "mine.yaml").write_text(
        "campaign: {id: mine, title: x, crs: EPSG:25833, "
        "origin: {lat_deg: 51.0, lon_deg: 13.2, h_ell_m: 300.0}}\n"
        "logs: {lidar: [raw/boat.obs], ins: [raw/scan.pcap], positions: [raw/track.pos]}\n"
        "mounts: {lidar: {lever_ics_m: [0.1, 0.0, 0.1]}, antenna: {lever_ics_m: [0.1, 0.0, -0.4]}}\n"
    )
    (raw / "track.pos").write_bytes(b"Dear diary, today the river was high.")
    assert main(["check-config", "mine.yaml"]) == 2
    said = capsys.readouterr().err
    assert "logs.lidar: " in said
    assert re.search("holds a RINEX file; expected: .*network capture", said)
    assert re.search(
        r"holds a network capture \(pcap, pcapng\); expected: .*Advanced Navigation ANPP log", said
    )
    assert "logs.positions: " in said
    assert "unrecognised file" in said


def test_check_config_takes_sigmas_of_an_sbet(here, capsys):
    """An SMRMSG is known by plausible numbers; both are entered, and what neither holds is asked for."""
    raw = here / "raw"
    raw.mkdir()
    states = np.zeros((20, 17))
    states[:, 0] = 300_000.0 + np.arange(20) / 10
    states[:, 1:4] = np.deg2rad(51.0), np.deg2rad(13.2), 300.0
    states.tofile(raw / "sbet.out")
    np.column_stack([states[:, 0], np.full((20, 9), 0.02)]).tofile(raw / "smrmsg.out")
    (here / "mine.yaml").write_text(
        "campaign: {id: mine, title: x, crs: EPSG:25833, "
        "origin: {lat_deg: 51.0, lon_deg: 13.2, h_ell_m: 300.0}}\n"
        "logs: {sbet: [raw/sbet.out], smrmsg: [raw/smrmsg.out], gps_week: 2235}\n"
        "orientation: {position_source: sbet}\n"
    )
    assert main(["check-config", "mine.yaml"]) == 0, capsys.readouterr().err
    assert main(["new-campaign", "found", "--from-logs", "raw", "--folder", "."]) == 0
    text = Path("found.yaml").read_text()
    assert "  smrmsg: [raw/smrmsg.out]" in text
    assert "sigma_position_m" not in text
    Path("found.yaml").write_text(text.replace("gps_week: CHANGE", "gps_week: 2235"))
    assert main(["check-config", "found.yaml"]) == 0, capsys.readouterr().err
    (raw / "smrmsg.out").unlink()
    assert main(["new-campaign", "alone", "--from-logs", "raw", "--folder", "."]) == 0
    assert "  sigma_position_m: [0.03, 0.03, 0.05]  # CHANGE" in Path("alone.yaml").read_text()


def test_files_that_cannot_be_opened(here, capsys):
    long_name = "x" * 300
    assert main(["describe", long_name]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_budget_prints_and_writes_influences(tmp_path, capsys):
    file = Path(__file__).parents[1] / "resources/budgets/p2_table1.yaml"
    out = tmp_path / "influences.csv"
    assert main(["budget", str(file), "--distances", "5,30", "--csv", str(out)]) == 0
    said = capsys.readouterr().out
    assert "reconstructed, not published" in said
    assert "21.2" in said
    assert out.read_text().startswith("input,group,sigma,unit,provenance,source,distance_m,influence_mm")
    assert len(out.read_text().splitlines()) == 1 + 2 * 17
    assert main(["budget", str(file)]) == 0
    assert "250.6" in capsys.readouterr().out


def test_budget_refuses(tmp_path, capsys):
    assert main(["budget", "nowhere.yaml"]) == 2
    assert "nowhere.yaml: no such file" in capsys.readouterr().err
    (tmp_path / "a.yaml").write_text("title: x\nframes: {a: 1}\n")
    assert main(["budget", str(tmp_path / "a.yaml")]) == 2
    said = capsys.readouterr().err
    assert "inputs is missing" in said
    assert "frames.a: found 1" in said
    for text in ("5,-1", "a", "", "nan"):
        with pytest.raises(SystemExit):
            main(["budget", "a.yaml", "--distances", text])
        assert "expected distances in metres" in capsys.readouterr().err


@pytest.mark.real
def test_raw_gnss_of_a_folder_is_sorted_by_receiver(here, data_dir, capsys):
    """Two receivers in RINEX whose names tell nothing, and an SBP log beside what was made of it."""
    of = {"rinex_cssrlib_kinematic_2021": "RINEX", "sbp_piksi_rtk_2017": "SBP"}
    for name, kind in of.items():
        assert main(["new-campaign", kind.lower(), "--from-logs", str(data_dir / name), "--folder", "."]) == 0
        assert (
            main(["check-config", f"{kind.lower()}.yaml"]) == 0
        )  # of a receiver alone nothing is to be filled in
    said = capsys.readouterr()
    assert "of two receivers the one that moves less" in said.out
    assert "left out, RINEX beside the SBP log of the rover: piksi_rover.obs" in said.err
    car, still = load_campaign("rinex.yaml"), load_campaign("sbp.yaml")
    for campaign, rover, base in (
        (car, "SEPT265G.21O", "3034265G.21O"),
        (still, "2017-05-12-v1.1.26.sbp", "piksi_base.obs"),
    ):
        assert campaign.orientation.position_source == "ppk"
        assert [path.name for path in campaign.log_files("rover")] == [rover]
        assert [path.name for path in campaign.log_files("base")] == [base]
    assert car.campaign.crs == "EPSG:32654"  # from the place in the header
    # what PPK would refuse is refused before
    text = Path("sbp.yaml").read_text()
    Path("sbp.yaml").write_text(text.replace("rover: [", f"rover: [{car.log_files('rover')[0]}, "))
    assert main(["check-config", "sbp.yaml"]) == 2
    assert "all files of one kind" in capsys.readouterr().err


@pytest.mark.real
def test_surface_models_with_dates_become_a_campaign(data_dir, tmp_path, capsys, monkeypatch):
    """A beach of Sandpyper, twice: cells as wide as its points need; two grids are refused before any job."""
    monkeypatch.chdir(tmp_path)
    days = ("20180601", "20180621")
    files = [data_dir / f"sandpyper_dsm/dsm_1m/mar_{day}_dsm_resampled_1m.tif" for day in days]
    epochs = [f"{file}@{day[:4]}-{day[4:6]}-{day[6:]}" for file, day in zip(files, days, strict=True)]
    assert main(["new-campaign", "beach", "--folder", ".", "--epochs", *epochs]) == 0
    text = Path("beach.yaml").read_text()
    assert "  # the points of the first file are 1 m apart\n" in text
    assert "  core_spacing_m: 4\n" in text
    text = text.replace("leave_out: CHANGE", "leave_out: []").replace(": CHANGE", ": null")
    lines = data_dir / "sandpyper_dsm/lod_transects/mar_lod_transects.gpkg"
    text = text.replace("stable: null", f"stable: {lines}")
    Path("beach.yaml").write_text(text)
    assert main(["check-config", "beach.yaml"]) == 2
    assert "another grid: cells of" in capsys.readouterr().err
    Path("beach.yaml").write_text(f"{text}  resample: bilinear\n")
    assert main(["check-config", "beach.yaml"]) == 0
