"""Files that are not YAML, or YAML with traps."""

from typing import Annotated, Literal

import pytest
from pydantic import Field, model_validator

from thalweg.core import ConfigError, documents, number_in_words, parse_yaml, read_mapping, read_yaml
from thalweg.core.documents import (
    Mistake,
    Name,
    Part,
    Text,
    checked,
    did_you_mean,
    one_of,
    refuse,
    validated,
    wrong,
)
from thalweg.settings.load import load_campaign
from thalweg.settings.messages import CampaignError

BROKEN = [
    ("campaign:\n\tid: x\n", 2, "Replace the tab by spaces"),
    ("campaign:\n  id: x\n  id: y\n", 3, "the key stands twice, in lines 2 and 3"),
    ("a: 1\nlidar: {}\nlidar: {}\n", 3, "Remove one of them or join"),
    ("title: Mulde: May\n", 1, "Put text that holds a colon in quotes"),
    ("a: [1, 2\nb: 3\n", 2, "Close the bracket or quote"),
    ('a: "open\nb: 3\n', 3, "Close the bracket or quote"),
    ("a: *unknown\n", 1, "Put text that begins with *, & or ! in quotes"),
    ("a: !!python/object:os.system x\n", 1, "Put text that begins with *, & or ! in quotes"),
    ("a: @home\n", 1, "Put text that begins with @"),
    ("a: 1\n---\nb: 2\n", 2, "one document in one file"),
    ("a: 1\n  b: 2\n", 2, "quotes, and indent keys of one section equally"),
    ("a:\n  - 1\n b: 2\n", 3, "Check indentation"),
    ("a: \x07\n", 1, "Remove the character"),
]


@pytest.mark.parametrize(("text", "line", "fragment"), BROKEN)
def test_broken_yaml_names_line_and_cure(text, line, fragment):
    mistakes = parse_yaml(text).mistakes
    assert len(mistakes) == 1
    assert mistakes[0].line == line
    assert fragment in str(mistakes[0])


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"", "the file is empty"),
        (b"# only a comment\n", "the file is empty"),
        (b"- a\n- b\n", "found ['a', 'b']; expected a campaign: sections with keys"),
        (b"just text\n", "found 'just text'"),
        (b"campaign:\n  title: M\xfcnchen\n", ":2: byte 0xfc is not UTF-8"),
        (b"\xff\xfe\x00\x01", "not UTF-8"),
        (b"\x00\x01\x02", "not valid YAML"),
        (b"a: &x [1, *x]\n", "cannot be read"),
        (b"a: 1\nb: !!bool maybe\n", "line 2 calls 'maybe' bool"),
        (b"a: !!timestamp soon\n", "line 1 calls 'soon' timestamp"),
        (b"campaign: {seed: 1" + b"0" * 400 + b"}\n", "a number of 401 digits"),
        (
            b"b0: &b0 {a: 1}\n"
            + b"".join(
                b"b%d: &b%d {<<: [%s]}\n" % (k, k, b",".join([b"*b%d" % (k - 1)] * 9)) for k in range(1, 12)
            ),
            "more than 100,000 values, through merges (<<) of merges",
        ),
    ],
)
def test_files_that_are_no_campaign(tmp_path, content, fragment):
    path = tmp_path / "x.yaml"
    path.write_bytes(content)
    with pytest.raises(CampaignError) as caught:
        load_campaign(path)
    assert fragment in str(caught.value)


def test_missing_campaign_file_names_the_nearest(tmp_path):
    (tmp_path / "mulde.yaml").write_text("a: 1\n")
    with pytest.raises(CampaignError, match=r"no such file\. Did you mean .*mulde\.yaml\?"):
        load_campaign(tmp_path / "muldee.yaml")
    with pytest.raises(CampaignError, match="this is a folder"):
        load_campaign(tmp_path)


def test_scalars_are_those_of_yaml_1_2():
    """YAML 1.1 reads these as text, false, minutes, octal and a date."""
    data = parse_yaml("a: 1e-3\nb: no\nc: 12:30\nd: 010\ne: 2021-05-12\nf: .5\ng: ~\nh: -.inf\n").data
    assert data == {
        "a": 0.001,
        "b": "no",
        "c": "12:30",
        "d": 10,
        "e": "2021-05-12",
        "f": 0.5,
        "g": None,
        "h": float("-inf"),
    }


def test_aliases_and_merges():
    document = parse_yaml("x: &lever [1, 2, 3]\ny: *lever\nz: &m {a: 1}\nw: {<<: *m, b: 2}\n")
    assert document.data["y"] == [1, 2, 3]
    assert document.data["w"] == {"a": 1, "b": 2}
    assert not document.mistakes


def test_a_chain_of_aliases_is_refused():
    """Ten aliases of ten aliases ... would fill the memory."""
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    document = parse_yaml("\n".join(rows))
    assert "more than 100,000 values" in str(document.mistakes[0])


def test_lines_of_nested_values(tmp_path):
    path = tmp_path / "x.yaml"
    path.write_text("# head\na:\n  b:\n    - 1\n    - c: 2\n")
    document = read_yaml(path)
    assert document.line(("a",)) == 2
    assert document.line(("a", "b", 0)) == 4
    assert document.line(("a", "b", 1, "c")) == 5
    assert document.line(("a", "b", 1, "absent", "deeper")) == 5
    assert document.line(("q",)) == 2  # the first key of the file


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        (b"a: 1\nb: 2\na: 3\n", "the key stands twice, in lines 1 and 3"),
        (b"\xff\xfe\x00", "is not UTF-8"),
        (b"- 1\n", "holds a list"),
        (b"", "the file is empty"),
    ],
    ids=["twice", "bytes", "list", "empty"],
)
def test_yaml_that_cannot_be_read(tmp_path, text, answer):
    path = tmp_path / "a.yaml"
    path.write_bytes(text)
    with pytest.raises(ConfigError, match=answer) as error:
        read_mapping(path)
    assert "a.yaml" in str(error.value)


def test_no_such_yaml(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        read_mapping(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="folder"):
        read_mapping(tmp_path)


def test_libyaml_and_python_read_every_file_of_the_repository_alike(repository):
    texts = [
        p.read_text() for folder in ("config", "resources") for p in (repository / folder).rglob("*.yaml")
    ]
    assert len(texts) > 50
    for text in [*texts, "a: [1, {b: 010, c: 1e-3}]\n# x\nd: &n {e: no}\nf: {<<: *n}\n"]:
        quick, slow = (
            documents._parsed(text, documents._QuickLoader),
            documents._parsed(text, documents._Loader),
        )
        assert repr(quick) == repr(slow)  # values, their kinds, lines
        assert not slow.mistakes


@pytest.mark.parametrize("text", ["a:\tb\n", "a: [1\n", "a: 1\na: 2\n", "a: *b\n"])
def test_mistakes_are_told_in_the_words_of_pythons_parser(text):
    mistakes = parse_yaml(text).mistakes
    assert mistakes == documents._parsed(text, documents._Loader).mistakes
    assert mistakes


# ---------------------------------------------------------------- documents as their models


class Sensor(Part):
    """An entry of the document below."""

    kind: Annotated[str, one_of(("lidar", "camera"))]
    offset_s: float = Field(default=0.0, ge=-5, le=5)
    rate_hz: float = Field(default=1.0, ge=0)
    rows: Literal[16, 32] = 16
    title: Text = "none"


class Boat(Part):
    """A document as a user writes it."""

    thalweg_boat: Literal[1]
    name: Name
    sensors: list[Sensor] = Field(min_length=1)
    places: dict[str, Sensor] = Field(default_factory=dict)
    alone: float = Field(default=0.0, description="a length in metres")

    @model_validator(mode="after")
    def _other_names(self):
        refuse(
            [
                wrong(f"two {s.kind}s", "one of each", "Leave one out", at=("sensors", k))
                for k, s in enumerate(self.sensors)
                if k and s.kind == self.sensors[0].kind
            ]
        )
        return self


BOAT = "thalweg_boat: 1\nname: Elbe\nsensors:\n  - kind: lidar\n    title: a\n      b\n"


def test_a_document_becomes_its_model():
    found = checked(
        Boat, parse_yaml(BOAT + "alone: 2.5\nplaces:\n  bow: {kind: camera, rows: }\n"), what="boat"
    )
    assert (found.name, found.sensors[0].title, found.alone) == ("Elbe", "a b", 2.5)
    assert (found.places["bow"].kind, found.places["bow"].rows) == ("camera", 16)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (BOAT + "alone: two\n", 7, "alone: found 'two'; expected a length in metres."),
        (BOAT + "alone: .nan\n", 7, "alone: found nan; expected a length in metres."),
        (BOAT + "length: 2\n", 7, "length: unknown key; expected one of thalweg_boat, name, sensors, places"),
        (BOAT + "sensor: 2\n", 7, "alone. Did you mean sensors?"),
        (BOAT + "    offset_s: 6\n", 7, "sensors[0].offset_s: found 6; expected a number from -5 to 5."),
        (BOAT + "    offset_s: -6\n", 7, "sensors[0].offset_s: found -6; expected a number from -5 to 5."),
        (BOAT + "    rate_hz: -1\n", 7, "sensors[0].rate_hz: found -1; expected a number of at least 0."),
        (BOAT + "    rows: 17\n", 7, "sensors[0].rows: found 17; expected 16 or 32."),
        (BOAT + "    title: 3\n", 7, ""),
        (BOAT + "  - kind: sonar\n", 7, "sensors[1].kind: found 'sonar'; expected one of: lidar; camera."),
        (BOAT + "  - kind: lidar\n", 7, "sensors[1]: two lidars; expected one of each. Leave one out."),
        (BOAT + "places: [1]\n", 7, "places: found [1]; expected keys with values."),
        (BOAT + "places:\n  bow: {kind: lidar, rows: x}\n", 8, "places.bow.rows: found 'x'; expected 16"),
        (BOAT + "places:\n  bow:\n    kind: lidar\n    kin: 1\n", 10, "places.bow.kin: unknown key"),
        ("thalweg_boat: 1\nname: ''\nsensors: []\n", 2, "name: found ''; expected a text."),
        ("thalweg_boat: 1\nname: a\nsensors: []\n", 3, "sensors: found []; expected at least one entry."),
        ("thalweg_boat: 1\nname: a\nsensors: 3\n", 3, "sensors: found 3; expected a list, each entry"),
        ("thalweg_boat: 1\nname: a\n", 1, "sensors is missing; expected the key sensors."),
        ("thalweg_boat: 1\nname: a\nsensors:\n  - {}\n", 4, "kind is missing; expected the key kind."),
        ("thalweg_boat: 2\nname: a\nsensors: [{kind: lidar}]\n", 1, "thalweg_boat: found 2; expected 1."),
        ("", 1, "nothing stands here; expected a boat that begins with thalweg_boat: 1."),
        ("- 1\n", 1, "no keys with values; expected a boat that begins with thalweg_boat: 1."),
        ("name: [1\n", 2, ""),
    ],
)  # fmt: skip
def test_each_mistake_in_a_document_stands_at_its_line(text, line, words):
    document = parse_yaml(text)
    found, mistakes = validated(Boat, document, what="boat")
    assert found is None
    assert mistakes[0].line == line
    assert words in str(mistakes[0])
    with pytest.raises(ConfigError) as caught:
        checked(Boat, document, what="boat", cure="Read on")
    assert str(caught.value).startswith(f"{len(mistakes)} mistake")
    assert str(caught.value).endswith(" Read on.")


def test_all_mistakes_are_told_in_the_order_of_the_file():
    text = "thalweg_boat: 1\nname: 3\nsensors: [{kind: sonar}]\nlong: 2\n"
    with pytest.raises(ConfigError) as caught:
        checked(Boat, parse_yaml(text), what="boat")
    head, *rows = str(caught.value).splitlines()
    assert head == "3 mistakes in the boat"
    assert [row.split(":")[0] for row in rows] == ["  line 2", "  line 3", "  line 4"]
    one = Mistake(path=("logs", "lidar", 1), found="no file", expected="a pcap", cure="Look?", line=7)
    assert str(one) == "line 7: logs.lidar[1]: no file; expected a pcap. Look?"


@pytest.mark.parametrize(
    ("node", "words"),
    [
        ({"type": "integer", "minimum": 0.0, "maximum": 2.5}, "a whole number from 0 to 2.5"),
        ({"minimum": 1, "exclusiveMaximum": 4.0}, "a number of at least 1 below 4"),
        ({"exclusiveMinimum": 0.25, "maximum": 3}, "a number above 0.25 up to 3"),
    ],
)
def test_limits_of_a_number_in_words(node, words):
    assert number_in_words(node) == words


def test_names_that_are_meant():
    """The same meaning before the same letters, in any case, and of two meanings the likelier one."""
    for name, known, meant in (
        ("GPS", ["antenna", "gnss", "gbs"], "gnss"), ("gps", ["antenna", "ins"], "antenna"),
        ("lidra", ["lidar", "ins"], "lidar"), ("x", ["a"], ""),
        ("camera", ["time_lapse", "images"], "images"),
        ("name", ["names", "id"], "id"),
    ):  # fmt: skip
        assert did_you_mean(name, known) == (f"Did you mean {meant}?" if meant else "")
