"""Files that are not YAML, or YAML with traps."""

import pytest

from thalweg.config.load import load_campaign
from thalweg.config.mistakes import CampaignError
from thalweg.config.yaml_lines import parse_yaml, read_yaml

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
    ("a: 1\n---\nb: 2\n", 2, "one campaign in one file"),
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


def test_duplicate_key_does_not_hide_other_mistakes(write):
    path = write()
    path.write_text(path.read_text().replace("  seed: 5\n", "  seed: 5\n  seed: 6\n  crs_: x\n"))
    with pytest.raises(CampaignError) as caught:
        load_campaign(path)
    assert [m.dotted for m in caught.value.mistakes] == ["campaign.seed", "campaign.crs_"]


def test_scalars_are_those_of_yaml_1_2():
    """YAML 1.1 reads these as text, false, minutes, octal and a date."""
    data = parse_yaml("a: 1e-3\nb: no\nc: 12:30\nd: 010\ne: 2021-05-12\nf: .5\ng: ~\nh: -.inf\n").data
    assert data == {
        "a": 0.001, "b": "no", "c": "12:30", "d": 10, "e": "2021-05-12", "f": 0.5, "g": None,
        "h": float("-inf"),
    }  # fmt: skip


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


def test_fuzz_campaign_files(write, rng, fuzz_count):
    """Whatever stands in the file: a campaign or a list of mistakes, never another error."""
    path = write()
    good = path.read_bytes()
    words = [*b"* &a !!int [ { : - ~ .nan 1e999 << |".split(), b"\t", b"\x00", b": "]
    loaded = unplaced = 0
    for _ in range(fuzz_count):
        data = bytearray(good)
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(0, len(data) - 1))
            match rng.integers(0, 5):
                case 0:
                    data[at] ^= 1 << int(rng.integers(0, 8))
                case 1:
                    del data[at + 2 : at + int(rng.integers(3, 30))]
                case 2:
                    data[at:at] = words[int(rng.integers(0, len(words)))]
                case 3:
                    data[at:at] = data[at : at + int(rng.integers(1, 60))]
                case _:
                    del data[at + 2 :]
        path.write_bytes(bytes(data))
        try:
            load_campaign(path)
            loaded += 1
        except CampaignError as error:
            placed = sum(str(path) in str(mistake) for mistake in error.mistakes)
            unplaced += len(error.mistakes) - placed if placed else 1
    assert loaded < fuzz_count
    assert unplaced == 0, "each mistake names its file"
