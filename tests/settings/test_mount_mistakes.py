"""``mounts.calibration``: what it names is looked into before the first job."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.settings.conftest import in_order
from thalweg.cli import main
from thalweg.core import Rigid, rotation_opk
from thalweg.core.calibration import Calibration, Source, lever_block, pose_block, write_calibration
from thalweg.settings import load_campaigns, mount_sources, with_calibrations
from thalweg.settings.load import check_campaign, load_campaign
from thalweg.settings.messages import CampaignError
from thalweg.settings.sections import is_calibration_path

IDENTITY = "title: x, crs: EPSG:25833, origin: {lat_deg: 51.0, lon_deg: 13.2, h_ell_m: 300.0}"


BOAT = "calibration: boat.yml\n"
ANTENNA = "antenna: {lever_ics_m: [0.1, 0.0, -0.4]}\n"


def write_boat(path: Path, *names: str, lever_m: tuple[float, float, float] = (-0.35, 0.0, -0.25)) -> Path:
    """A calibration with a lidar, an antenna or another block."""
    pose = Rigid(R=rotation_opk(0, -np.pi / 2, 0), shift_m=np.array(lever_m), cov=np.eye(6) * 1e-6)
    parts = []
    for name in names:
        block = pose_block(name, pose)[0] if name in {"lidar", "camera_lidar"} else lever_block(name, lever_m)
        cov = np.eye(len(block.labels)) * 1e-6
        parts.append(
            Calibration(title="boat", blocks=(block,), cov=cov, source=Source(run="yard", method="cones"))
        )
    whole = Calibration.merged(parts, title="boat", source=Source(run="yard", method="cones"))
    write_calibration(path, whole)
    return path


@pytest.fixture
def campaigns(tmp_path):
    """Writes a campaign of the twin into a folder of campaigns and gives its path."""

    def write(name, mounts="", size="tiny"):
        path = tmp_path / f"{name}.yaml"
        rows = "".join(f"\n  {row}" for row in mounts.splitlines())
        path.write_text(
            f"campaign: {{id: {name}, {IDENTITY}}}\ntwin: {{size: {size}}}\nmounts:{rows or ' {}'}\n"
        )
        return path

    write("yard", "lidar: {lever_ics_m: [-0.35, 0.0, -0.25]}", size="field")
    return write


def mistake(path: Path) -> str:
    """The only mistake of a campaign, at the line of its setting."""
    with pytest.raises(CampaignError) as caught:
        load_campaigns(path.stem, path.parent)
    (found,) = caught.value.mistakes
    rows = path.read_text().splitlines()
    assert "calibration:" in rows[found.line - 1]
    assert str(found).startswith(f"{path}:{found.line}: mounts.calibration: ")
    assert found.expected
    assert found.cure
    return str(found)


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        ("yrd", "there is no campaign 'yrd' ... a calibration campaign (yard) ... Did you mean yard?"),
        ("elsewhere", "there is no campaign ... Name a campaign with a calibration field"),
        ("river", "'river' surveys a river ... a calibration campaign (yard)"),
        ("survey", "the campaign names itself ... Remove the line"),
        ("yard", ""),
    ],
)
def test_a_campaign_that_is_named(campaigns, chosen, words):
    campaigns("river")
    path = campaigns("survey", f"calibration: {chosen}")
    if not words:
        found = with_calibrations(load_campaigns("survey", path.parent), path.parent)
        assert list(found) == ["yard", "survey"]
        return
    assert re.search(in_order(words), mistake(path))
    # without the folder of all campaigns nothing is known about others
    assert chosen == "survey" or check_campaign(path)[0] is not None


def test_mistakes_of_the_calibration_campaign_are_told_with_the_setting(campaigns):
    bad = campaigns("bad_yard", "lidar: {lever_ics_m: [-350.0, 0.0, 0.0]}", size="field")
    path = campaigns("survey", "calibration: bad_yard")
    with pytest.raises(CampaignError) as caught:
        load_campaigns("survey", path.parent)
    first, second = caught.value.mistakes
    assert (first.file, first.dotted) == (path, "mounts.calibration")
    assert "'bad_yard' has mistakes of its own" in first.found
    assert (second.file, second.dotted) == (bad, "mounts.lidar.lever_ics_m")


def test_calibrations_of_calibrations_come_first_and_never_in_a_circle(campaigns):
    campaigns("later_yard", "calibration: yard", size="field")
    path = campaigns("survey", "calibration: later_yard")
    found = with_calibrations(load_campaigns("survey", path.parent), path.parent)
    assert list(found) == ["yard", "later_yard", "survey"]
    second = campaigns("yard", "calibration: later_yard", size="field")
    with pytest.raises(CampaignError) as caught:
        load_campaigns("survey", path.parent)
    (told,) = caught.value.mistakes
    assert "in a circle: survey -> later_yard -> yard -> later_yard" in told.found
    assert (told.file, told.line) == (second, len(second.read_text().splitlines()))


def test_a_calibration_without_a_run_places_nothing(campaigns, tmp_path):
    for name in ("cones.yml", "shot.png", "shot2.png", "shot.pcap"):
        (tmp_path / name).write_text("x")
    logs = "field: [cones.yml], reference_images: [shot.png]"
    logs += ", position_scans: [shot.pcap], position_images: [shot2.png]"
    (tmp_path / "stand.yaml").write_text(
        f"campaign: {{id: stand, {IDENTITY}}}\nlogs: {{calibration: {{{logs}}}}}"
    )
    assert load_campaign(tmp_path / "stand.yaml").is_calibration
    assert "no dynamic run" in mistake(campaigns("survey", "calibration: stand"))


BROKEN = {
    "none.yaml": (None, "no such file ... a calibration file at"),
    "folder.d/": ("/", "this is a folder ... boat.yaml"),
    "cut.json": ('{"thalweg_calibration": 1, "blocks": {', "1 mistake: line 1: not valid YAML"),
    "cut.yaml": ("thalweg_calibration: 1\nblocks: [", "not valid YAML ... Correct "),
    "bytes.yaml": (b"\xff\xfe", "is not UTF-8"),
    "river.yaml": ("campaign: {id: river}\n", "no calibration file ... write its id, calibration: river"),
    "mounts.json": ('{"kind": "thalweg mounts"}', "no calibration file ... name the calibration that they"),
    "cones.yml": ("thalweg_field: 1\n", "no calibration file ... boat.yaml"),
    "chain.yml": ("cam0: {}\n", "no calibration file ... thalweg import-calibration"),
    "matrix.txt": ("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "no calibration file ... import-calibration"),
    "few.yml": ("thalweg_calibration: 1\ntitle: x\n", "holds 2 mistakes ... source ... thalweg describe"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_file_that_is_named(campaigns, tmp_path, name):
    content, words = BROKEN[name]
    if content == "/":
        (tmp_path / name).mkdir()
    elif content is not None:
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    told = mistake(campaigns("survey", f"calibration: {name}"))
    assert f"mounts.calibration: {name}" in told
    assert re.search(in_order(words), told)


def test_what_a_calibration_file_must_place(campaigns, tmp_path):
    write_boat(tmp_path / "boat.yml", "lidar", "antenna")
    path = campaigns("survey", BOAT)
    chosen = load_campaigns("survey", path.parent)["survey"].mounts.calibration
    assert chosen == str(tmp_path / "boat.yml")
    write_boat(tmp_path / "boat.yml", "lidar")
    told = mistake(path)
    assert "holds the blocks lidar, and the campaign states no place of the antenna" in told
    # where the campaign has it, nothing lacks
    campaigns("survey", BOAT + ANTENNA)
    assert load_campaigns("survey", path.parent)
    # but not both: one of them would be dropped without a word
    campaigns("survey", BOAT + ANTENNA + "lidar: {phi_deg: -90.0}")
    with pytest.raises(CampaignError, match=r"mounts\.lidar: both mounts\.calibration .* and mounts\.lidar"):
        load_campaigns("survey", path.parent)
    write_boat(tmp_path / "boat.yml", "camera_lidar")
    assert "none of them is a place on the boat" in mistake(campaigns("survey", BOAT))


def test_a_boat_in_millimetres_is_told_at_the_setting(campaigns, tmp_path):
    write_boat(tmp_path / "boat.yml", "lidar", "antenna", lever_m=(-350.0, 0.0, -250.0))
    told = mistake(campaigns("survey", BOAT))
    assert "holds 2 mistakes" in told
    assert "a lever arm of (-350, 0, -250) m" in told
    assert "Are these millimetres? Then write (-0.35, 0, -0.25)" in told


def test_a_campaign_that_is_calibrated_by_another_states_no_places(campaigns):
    path = campaigns("survey", "calibration: yard\necho_sounder: {lever_ics_m: [0.2, 0.0, 0.3]}")
    with pytest.raises(CampaignError, match=r"mounts\.echo_sounder: both mounts\.calibration \(yard\)"):
        load_campaigns("survey", path.parent)


def test_ids_and_paths_are_told_apart():
    assert not any(is_calibration_path(text) for text in ("yard", "Yard"))
    assert all(is_calibration_path(text) for text in ("boat.yaml", "boat.json", "../boat", "~/b.yml"))


def test_sources_of_the_places(campaigns, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_boat(tmp_path / "boat.yml", "lidar", "echo_sounder")
    campaigns("survey", BOAT + ANTENNA)
    found = load_campaigns("survey", tmp_path)["survey"]
    assert mount_sources(found) == {
        "lidar": "boat.yml, run yard",
        "camera": "",
        "antenna": "the campaign file",
        "echo_sounder": "boat.yml, run yard",
    }
    campaigns("other", "calibration: yard")
    found = load_campaigns("other", tmp_path)["other"]
    assert set(mount_sources(found).values()) == {"the calibration campaign yard"}
    assert main(["check-config", str(tmp_path / "survey.yaml"), str(tmp_path / "other.yaml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == (
        "  places of the sensors: lidar, echo_sounder from boat.yml, run yard; camera not stated, values by "
        "default; antenna from the campaign file"
    )
    assert lines[3].endswith("lidar, camera, antenna, echo_sounder from the calibration campaign yard")


def test_the_command_names_a_calibration_that_does_not_exist(campaigns, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    path = campaigns("survey", "calibration: yrd")
    assert main(["check-config", path.name]) == 2
    said = capsys.readouterr().err
    assert "survey.yaml:" in said
    assert "Did you mean yard?" in said
