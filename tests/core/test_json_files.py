"""JSON between jobs: what it is stands in it, and anything else is refused with the cure."""

import json
from pathlib import Path

import pandas as pd
import pytest

from thalweg.core import InputError, final_path, parse_xml, read_json, read_marked, read_parquet, write_marked


def read(path):
    return read_marked(
        path, "mounts", kind="places", version=2, what="places of a boat", cure="Make it again"
    )


def test_a_file_gives_back_its_content_and_says_what_it_is(tmp_path):
    path = tmp_path / "new/m.json"
    write_marked(path, kind="places", version=2, content={"mounts": {"lidar": [0.1]}, "more": 1})
    assert read(path) == {"lidar": [0.1]}
    assert list(json.loads(path.read_text())) == ["kind", "version", "mounts", "more"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "file not found; expected places of a boat"),
        ("{", "no JSON .*; expected places of a boat"),
        ("[1]", "no places of a boat"),
        ('{"kind": "places", "version": 2}', "KeyError"),
        ('{"kind": "places", "version": 2, "mounts": 3}', "no places of a boat"),
        ('{"kind": "places", "version": 1, "mounts": {}}', "places, version 1; expected places, version 2"),
        ('{"kind": "clocks", "version": 2, "mounts": {}}', "clocks, version 2; expected places, version 2"),
        (b"\xff\xfe", "no JSON .*; expected places of a boat"),
    ],
)
def test_anything_else_is_refused(tmp_path, text, words):
    path = tmp_path / "m.json"
    if text is not None:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=words) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert str(caught.value).endswith("Make it again.")


def test_other_files_between_programs(tmp_path):
    """XML without document types, JSON with a mark of its encoding, Parquet; paths of files being written."""
    assert parse_xml("<a><b x='1'/></a>", "a.xml")[0].get("x") == "1"
    for text, words in (
        ("<a>", "no XML"),
        ("<!DOCTYPE a [<!ENTITY e 'x'>]><a>&e;</a>", r"it declares a document type \(a\)"),
        (b"<?xml version='1.0' encoding='none-such'?><a/>", "no XML"),
    ):
        with pytest.raises(InputError, match=words):
            parse_xml(text, "a.xml", "a track")
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"x": ' + b"7" * 300 + b"}")
    assert read_json(tmp_path / "a.json")["x"] == int("7" * 300)
    (tmp_path / "a.json").write_bytes(b"7" * 301)
    with pytest.raises(InputError, match="a number of 301 digits"):
        read_json(tmp_path / "a.json")
    pd.DataFrame({"x": [1.5, 2.5]}).to_parquet(tmp_path / "a.parquet")
    assert read_parquet(tmp_path / "a.parquet")["x"].tolist() == [1.5, 2.5]
    for _ in range(2):
        write_marked(tmp_path / "deep/er/m.json", kind="places", version=2, content={"mounts": {}})
    assert final_path(Path("results/.part-0a/x/.part-1/index.html")) == Path("results/x/index.html")
