"""Photographs and the tables beside them are known by their content, and a new campaign lists them."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from thalweg.cli import main
from thalweg.core import InputError
from thalweg.ingest.registry import describe, recognise

XML = (
    '<?xml version="1.0"?>\n<document version="1.5.0"><chunk><cameras>\n'
    '<camera id="0" label="a"/></cameras>{}</chunk></document>'
)
TEXTS = {
    "control_points": "id,east_m,north_m,up_m\nA,1,2,3\n",
    "marks": "image;point;x_px;y_px\na.jpg;A;1;2\n",
    "gcp_list": "EPSG:25833\n377316.9 5656829.8 302.5 100 200 a.jpg A\n",
    "metashape_markers": XML.format("<markers><marker id='0' label='A'/></markers>"),
    "metashape_cameras": XML.format(""),
    "orientations": "# image, x, y, z, omega, phi, kappa\nimage,x,y,z,omega,phi,kappa\na.jpg,1,2,3,4,5,6\n",
    "image_times": "file,time_utc\na.jpg,2021-05-12T09:00:00Z\n",
}


@pytest.mark.parametrize("kind", TEXTS)
def test_tables_are_known_and_described(tmp_path, kind):
    path = tmp_path / "whatever.bin"
    path.write_text(TEXTS[kind])
    assert recognise(path) == kind
    text = "\n".join(describe(path).lines())
    assert "logs.time_lapse" in text


def test_metashape_reference_pane(tmp_path):
    path = tmp_path / "markers.txt"
    path.write_text(
        '#CoordinateSystem: PROJCS["x"]\n#Label,X/East,Y/North,Z/Altitude,Accuracy_(m)\nA,1,2,3,0.1\n'
    )
    assert recognise(path) == "control_points"


@pytest.mark.parametrize("ending", ["jpg", "png", "tif"])
def test_photographs_are_known_and_described(tmp_path, ending):
    path = tmp_path / f"R20210512_085950687.{ending}"
    Image.fromarray(np.zeros((12, 16, 3), np.uint8)).save(path)
    anonymous = tmp_path / "x"
    anonymous.write_bytes(path.read_bytes())
    assert recognise(anonymous) == "photograph"
    text = "\n".join(describe(path).lines())
    assert "16 x 12 pixels" in text
    assert "from name" in text


def test_a_photograph_with_the_time_of_its_last_change_only(tmp_path):
    exif = Image.Exif()
    exif[0x0132] = "2021:05:20 12:00:00"
    Image.new("RGB", (16, 12)).save(tmp_path / "a.jpg", exif=exif)
    assert "read as UTC, of the last change of the file" in "\n".join(describe(tmp_path / "a.jpg").lines())


@pytest.mark.parametrize("text", ["a,b,c\n1,2,3\n", "name,value\nx,1\n", "hello\n"])
def test_other_tables_are_not_taken_for_control_points(tmp_path, text):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(InputError, match="unrecognised file"):
        recognise(path)


TRACK = (
    "% program   : RTKLIB\n"
    "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
    "  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio\n"
    "2017/05/12 18:45:13.400   50.000000000   13.000000000   200.0000   1  11   0.0030   0.0020   0.0060"
    "  -0.0010   0.0015  -0.0025   0.40   12.3\n"
)
"""With a track photographs are those of a boat."""


def _logs(folder: Path) -> None:
    (folder / "raw" / "photos").mkdir(parents=True)
    (folder / "raw" / "masks").mkdir()
    for k in (2, 10, 1):
        Image.fromarray(np.zeros((8, 8), np.uint8)).save(
            folder / "raw" / "photos" / f"IMG_{k}.JPG", format="JPEG"
        )
        Image.fromarray(np.zeros((8, 8), np.uint8)).save(folder / "raw" / "masks" / f"IMG_{k}.JPG.png")


def test_a_new_campaign_knows_photographs_and_control_points(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    _logs(tmp_path)
    (tmp_path / "raw" / "targets.csv").write_text(TEXTS["control_points"])
    (tmp_path / "raw" / "gcp_list.txt").write_text(TEXTS["gcp_list"])
    (tmp_path / "raw" / "ppk.pos").write_text(TRACK)
    assert main(["new-campaign", "mine", "--from-logs", "raw", "--folder", "."]) == 0
    assert "folder with 3 photographs" in capsys.readouterr().out
    written = yaml.safe_load((tmp_path / "mine.yaml").read_text())
    assert written["logs"]["time_lapse"] == {
        "images": ["raw/photos"],
        "control_points": ["raw/gcp_list.txt", "raw/targets.csv"],
        "marks": ["raw/gcp_list.txt"],
        "masks": ["raw/masks"],
    }
    assert written["mounts"]["camera"]["omega_deg"] == -90.0
    assert "images" not in written


def test_without_control_points_the_antenna_takes_their_place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _logs(tmp_path)
    (tmp_path / "raw" / "ppk.pos").write_text(TRACK)
    assert main(["new-campaign", "mine", "--from-logs", "raw", "--folder", "."]) == 0
    written = yaml.safe_load((tmp_path / "mine.yaml").read_text())
    assert written["images"]["adjustment"]["antenna"] == {"use": True}
