"""Sentences are short enough to be read once: README, captions, documents; of pages: test_page_states."""

import pytest
import yaml

from tests.sentences import LONGEST, MEAN, lengths, of_html, of_markdown, too_long

DENSE, LONG = 28.5, 93
"""What the densest documents hold today, words a sentence on the average and in the longest: never more."""


def test_captions_are_short(repository):
    table = yaml.safe_load((repository / "workflow/figures.yaml").read_text(encoding="utf-8"))
    words = [
        row[key]
        for rows in table.values()
        for row in rows.values()
        for key in ("shows", "caption", "caption_of_files")
        if key in row
    ]
    assert too_long([each for part in words for each in of_html(f"<p>{part}</p>")]) == []


READ_FIRST = (
    *("README.md", "docs/faq.md", "docs/tutorial.md", "docs/pages/accuracy.md", "docs/bathymetry.md"),
    *("docs/deformation.md", "docs/images.md", "docs/light_sheet.md", "docs/howto/cluster.md"),
    "docs/howto/scale.md",
)


@pytest.mark.parametrize("name", READ_FIRST)
def test_what_newcomers_read_is_short(repository, name):
    assert too_long(of_markdown((repository / name).read_text(encoding="utf-8"))) == []


def test_documents_grow_no_longer_sentences(repository):
    found = {
        path.name: lengths(of_markdown(path.read_text(encoding="utf-8")))
        for path in (repository / "docs").rglob("*.md")
    }
    assert [name for name, (mean, longest) in found.items() if mean > DENSE or longest > LONG] == []


def test_a_long_sentence_is_seen():
    long = "word " * (LONGEST + 1) + "end. "
    assert len(too_long(of_html(f"<p>{long}</p><pre>{long}</pre><table><td>{long}</td></table>"))) == 1
    dense = "word " * int(MEAN) + "end. "
    assert too_long(of_markdown(f"# {long}\n\n```\n{long}\n```\n\n" + dense.capitalize() * 12)) == [
        "21.0 words a sentence on the average"
    ]
    assert too_long(of_html(f"<p>a: First of all things. b: {'word ' * 30} end.</p>")) == []
