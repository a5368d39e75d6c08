"""Files and names from strangers: nothing in them runs, reads other files, or grows without bound."""

import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from snakemake.iocontainers import InputFiles, Log, OutputFiles, Params

from thalweg.calibration.markers import read_grey
from thalweg.cli import main
from thalweg.core import ConfigError, InputError, decode_picture, parse_xml, read_yaml
from thalweg.images.control import metashape_points
from thalweg.ingest.photos.exif import read_head
from thalweg.settings import load_campaigns
from thalweg.settings.messages import CampaignError
from thalweg.workflow import cluster, run_job

BILLION = (
    '<?xml version="1.0"?><!DOCTYPE document [<!ENTITY a "ha">'
    + "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefg", "bcdefgh", strict=True))
    + "]><document><markers>&h;</markers></document>"
)
OTHER_FILE = (
    '<!DOCTYPE document [<!ENTITY x SYSTEM "file:///etc/passwd">]><document><markers>&x;</markers></document>'
)


@pytest.mark.parametrize("name", ["; touch hacked", "$(touch hacked)", "../up", "a b", "`id`", "-rf", "a/b"])
def test_an_id_that_is_no_name_is_refused(tmp_path, name):
    """Ids are words of paths, of the comment of a job on a cluster, and of commands of Snakemake there."""
    file = tmp_path / "survey.yaml"
    file.write_text(f"campaign:\n  id: {name!r}\n")
    with pytest.raises(CampaignError, match=r"small letters, digits and underscores"):
        load_campaigns(str(file), tmp_path)
    assert list(tmp_path.iterdir()) == [file]


def test_names_of_logs_reach_no_shell(tmp_path, monkeypatch):
    """Not by a job, nor by the commands that are asked about a cluster."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("thalweg.workflow.job._start_log", lambda path: None)
    name = "a; touch hacked $(touch hacked) `touch hacked` '\" \n.pcap"
    (tmp_path / name).write_text("log")

    class Job:
        rule, threads = "copy", 1
        input = InputFiles(fromdict={"source": name})
        output = OutputFiles(fromdict={"target": f"out/{name}"})
        log = Log([])
        params = Params(fromdict={"code": "1"})

    def copy(*, source: Path, target: Path) -> None:
        target.write_text(source.read_text())

    run_job(copy, Job())
    assert (tmp_path / "out" / name).read_text() == "log"
    assert cluster.slurm("echo", name) == f"{name}\n"
    assert not list(tmp_path.rglob("hacked"))


def test_names_that_a_shell_would_read_go_to_no_cluster():
    """Snakemake's quotes around the inputs of a job let them through, as `tests/cluster/run` found."""
    cluster.refuse_shell(["a; touch hacked & | > .pcap", "raw/lidar 1 (2).pcap", "Sajó_#1,2=3+4~%@!.las"])
    for name in ("$(touch hacked)", "`id`", "it's", 'a"b', "a\\b", "a\nb", "$HOME"):
        with pytest.raises(InputError, match=r"1 files have names that a shell would read.*Rename"):
            cluster.refuse_shell(["good.pcap", name])


def test_the_source_starts_no_shell(repository):
    """Where a program is started its words are a list."""
    for path in sorted((repository / "src").rglob("*.py")):
        text = path.read_text()
        assert "shell=True" not in text, path
        assert "os.system" not in text, path
        assert "os.popen" not in text, path


def test_yaml_makes_no_objects(tmp_path):
    file = tmp_path / "a.yaml"
    file.write_text(f"campaign: !!python/object/apply:os.system ['touch {tmp_path}/hacked']\n")
    assert read_yaml(file).data == {"campaign": [f"touch {tmp_path}/hacked"]}  # plain words
    assert not (tmp_path / "hacked").exists()
    with pytest.raises((CampaignError, ConfigError)):
        load_campaigns(str(file), tmp_path)


@pytest.mark.parametrize("text", [BILLION, OTHER_FILE], ids=["grows", "reads another file"])
def test_xml_has_no_entities(tmp_path, text):
    file = tmp_path / "markers.xml"
    file.write_text(text)
    with pytest.raises(InputError, match=r"markers\.xml: no XML \(it declares a document type"):
        metashape_points(file, text, None)
    assert parse_xml("<document><a>1 &lt; 2</a></document>", "a.xml").findtext("a") == "1 < 2"


def test_xml_is_parsed_in_one_place(repository):
    for path in sorted((repository / "src").rglob("*.py")):
        if path.name != "documents.py":
            text = path.read_text()
            assert "ElementTree.parse(" not in text, path
            assert ".fromstring(" not in text, path


def picture(width: int, height: int, pixels: bytes) -> bytes:
    """PNG, one grey byte a pixel, whose head may promise more than there is."""

    def part(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + part(b"IHDR", head) + part(b"IDAT", zlib.compress(pixels)) + part(b"IEND", b"")
    )


def test_a_picture_that_unpacks_to_gigabytes_is_refused(tmp_path, capsys):
    file = tmp_path / "bomb.png"
    file.write_bytes(picture(40_000, 40_000, bytes(1000)))
    with pytest.raises(InputError, match="1600000000 pixels"):
        read_head(file)
    with pytest.raises(InputError, match="not a picture"):
        read_grey(file)
    assert main(["describe", str(file)]) == 2
    assert "1600000000 pixels" in capsys.readouterr().err
    good = np.frombuffer(picture(2, 1, b"\x00\x07\x09"), np.uint8)
    found = decode_picture(good, 0)
    assert found.tolist() == [[7, 9]]


def test_pictures_are_decoded_in_one_place(repository):
    for path in sorted((repository / "src/thalweg").rglob("*.py")):
        if path.name != "documents.py":
            assert "cv2.imdecode(" not in path.read_text(), path
            assert "cv2.imread(" not in path.read_text(), path


def test_arrays_run_no_code(tmp_path):
    """A pickle inside an archive of arrays would run when it is read."""

    class Hack:
        def __reduce__(self):
            return os.system, (f"touch {tmp_path}/hacked",)

    np.savez(tmp_path / "poses.npz", poses=np.array([Hack()], dtype=object))
    from thalweg.images.model import ImageBlock

    with pytest.raises(InputError):
        ImageBlock.read(tmp_path / "poses.npz")
    assert not (tmp_path / "hacked").exists()


def test_archives_are_not_unpacked_but_named(tmp_path, capsys):
    """However much is packed into one, none of it is."""
    file = tmp_path / "log.pcap.gz"
    file.write_bytes(b"\x1f\x8b\x08" + bytes(2000))
    assert main(["describe", str(file)]) == 2
    assert "gunzip" in capsys.readouterr().err
