"""Files that are not YAML, or YAML with traps."""

import pytest

from thalweg.core import ConfigError, documents, parse_yaml, read_mapping, read_yaml
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


def test_yaml_scalars_of_version_1_2(tmp_path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("a: 1e-3\nb: no\nc: 010\nd: [1, 2.5, -.5]\ne: {f: null}\n")
    data, lines = read_mapping(path)
    assert data == {"a": 1e-3, "b": "no", "c": 10, "d": [1, 2.5, -0.5], "e": {"f": None}}
    assert lines[("e", "f")] == 5


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        (b"a: 1\nb: 2\na: 3\n", "the key stands twice, in lines 1 and 3"),
        (b"a: [1\n", "not valid YAML"),
        (b"a: *b\n", "not valid YAML"),
        (b"\xff\xfe\x00", "is not UTF-8"),
        (b"a: \x07\n", "not valid YAML"),
        (b"- 1\n", "holds a list"),
        (b"", "the file is empty"),
        (
            b"a: &x [1, 1, 1, 1, 1, 1, 1, 1]\n"
            + b"b: &y [*x, *x, *x, *x, *x, *x, *x, *x]\n" * 1
            + b"c: &z [*y, *y, *y, *y, *y, *y, *y, *y, *y]\nd: &u [*z, *z, *z, *z, *z, *z]\n"
            + b"e: &v [*u, *u, *u, *u, *u, *u]\nf: [*v, *v, *v, *v]\n",
            "more than 100,000 values",
        ),
    ],
    ids=["twice", "bracket", "alias", "bytes", "control", "list", "empty", "bomb"],
)
def test_yaml_that_cannot_be_read(tmp_path, text: bytes, answer: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(text)
    with pytest.raises(ConfigError, match=answer) as error:
        read_mapping(path)
    assert "a.yaml" in str(error.value)


def test_no_such_yaml(tmp_path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        read_mapping(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="folder"):
        read_mapping(tmp_path)


def test_libyaml_and_python_read_every_file_of_the_repository_alike(repository) -> None:
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
def test_mistakes_are_told_in_the_words_of_pythons_parser(text: str) -> None:
    mistakes = parse_yaml(text).mistakes
    assert mistakes == documents._parsed(text, documents._Loader).mistakes
    assert mistakes
