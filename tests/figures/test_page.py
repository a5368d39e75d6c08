"""The page: valid, self-contained, escaped, the same bytes twice."""

import base64
import re
from html.parser import HTMLParser
from io import BytesIO

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from thalweg.core import InputError
from thalweg.figures import Finding, Page, save
from thalweg.figures.page import SOURCES
from thalweg.figures.survey.maps import survey_map

VOID = {"meta", "img", "br", "link", "hr", "input"}


class Checker(HTMLParser):
    """Keeps the stack of open elements and everything that a browser would fetch."""

    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.open, self.errors, self.links, self.images, self.ids = [], [], [], [], []
        self.text, self.tags = "", []

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        self.ids += [found["id"]] if "id" in found else []
        self.links += [found[k] for k in ("href", "action", "data", "poster") if k in found]
        self.images += [found["src"]] if "src" in found else []

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.errors.append(tag)

    def handle_data(self, data):
        self.text += data


def check(html):
    checker = Checker()
    checker.feed(html)
    checker.close()
    assert not checker.errors
    assert not checker.open
    return checker


@pytest.fixture
def table():
    return pd.DataFrame(
        {
            "stream": ["lidar", "<ins> & co"],
            "n": [1_234_567, 3],
            "rate_hz": [753.512345, np.nan],
            "locked": [True, False],
        }
    )


@pytest.fixture
def page(trajectory, table):
    page = Page("Logs & <people>", "What other people recorded.")
    page.section("Lidar").text("First.\n\nSecond <b>third</b>.").figure(
        survey_map(trajectory), 'a "map" <n>', dpi=50
    )
    return page.section("Lidar").table(table, "Streams & rates", {"rate_hz": "Hz"}).lines(["a  <b>", "c"])


def test_page_is_well_formed_and_self_contained(page):
    html = page.html()
    found = check(html)
    assert html.startswith("<!DOCTYPE html>")
    assert "script" not in found.tags
    assert "link" not in found.tags
    assert all(link.startswith("#") for link in found.links)
    assert all(image.startswith("data:image/png;base64,") for image in found.images)
    for word in ("http://", "https://", "url(", "@import"):
        assert word not in html


def test_contents_point_to_sections_of_the_same_name(page):
    found = check(page.html())
    assert found.ids == ["lidar", "lidar-2"]
    assert found.links == []


def test_text_is_escaped(page):
    html = page.html()
    text = check(html).text
    for words in ("Logs & <people>", "Second <b>third</b>.", "<ins> & co", "a  <b>\nc", 'a "map" <n>'):
        assert words in text
    assert "<people>" not in html
    assert html.count("<p>") == 3


def test_table_numbers_and_units(page):
    text = check(page.html()).text
    for words in ("1\N{NO-BREAK SPACE}234\N{NO-BREAK SPACE}567", "753.5", "–", "yes", "no", "rate_hz / Hz"):
        assert words in text
    assert "nan" not in text.lower()


def test_png_file_is_embedded_unchanged(tmp_path, trajectory):
    path = tmp_path / "map.png"
    save(survey_map(trajectory), path, dpi=50)
    (image,) = check(Page("x").figure(path, "map").html()).images
    assert base64.b64decode(image.partition(",")[2]) == path.read_bytes()


def test_same_page_gives_same_bytes(tmp_path, trajectory, table):
    for name in ("a", "b"):
        page = Page("Logs").section("One").figure(survey_map(trajectory), "map", dpi=50).table(table, "t")
        page.write(tmp_path / "deep" / f"{name}.html")
    a, b = ((tmp_path / "deep" / f"{name}.html").read_bytes() for name in "ab")
    assert a == b


def test_bad_parts_are_refused(tmp_path, table):
    with pytest.raises(InputError, match=r"absent\.png: file not found"):
        Page("x").figure(tmp_path / "absent.png", "c")
    text = tmp_path / "text.png"
    text.write_text("no picture")
    with pytest.raises(InputError, match="not a PNG file"):
        Page("x").figure(text, "c")
    with pytest.raises(InputError, match=r"units for columns \['speed'\]"):
        Page("x").table(table, "c", {"speed": "m/s"})


def test_cards_link_their_evidence_and_carry_the_tone_of_their_verdict():
    found = [Finding("RMSE", "4.0 cm", "consistent", "accuracy/index.html"), Finding("n", "7")]
    html = Page("x", "", found).html()
    check(html)
    link = '<a href="accuracy/index.html">4.0\N{NO-BREAK SPACE}cm</a>'
    assert f'<tr class="good"><td>RMSE</td><td>{link}</td><td>consistent</td>' in html
    assert '<tr class=""><td>n</td><td>7</td><td></td></tr>' in html


def test_a_fold_holds_what_was_added_within():
    page = Page("x")
    with page.fold("All <numbers>"):
        page.text("within")
    inside = re.search(r"<details>(.*?)</details>", page.text("after").html(), re.DOTALL)[1]
    assert "<summary>All &lt;numbers&gt;</summary>" in inside
    assert "within" in inside
    assert "after" not in inside


def test_thumbnails_are_small_copies_that_open_the_large_picture(tmp_path):
    Image.effect_noise((1400, 700), 60).save(tmp_path / "large.png")
    found = check(Page("x").thumbnails({"figures/large.png": (tmp_path / "large.png", "Map")}).html())
    assert found.links == ["figures/large.png"]
    code = base64.b64decode(found.images[0].partition("base64,")[2])
    with Image.open(BytesIO(code)) as small:
        assert small.size == (400, 200)
    assert len(code) < 60_000  # noise is the worst of pictures


def test_pages_among_results_lead_back_to_the_front_page(tmp_path):
    for name, back in (("a/index.html", None), ("a/b/page.html", "../"), ("a/b/c/page.html", "../../")):
        Page("x").write(tmp_path / "results" / name)
        links = check((tmp_path / "results" / name).read_text()).links
        assert links == ([] if back is None else [f"{back}index.html"])
    Page("x").write(tmp_path / "elsewhere/page.html")
    assert check((tmp_path / "elsewhere/page.html").read_text()).links == []


def test_empty_table_and_section_without_letters():
    page = Page("x").section("§§").text("a").section("§§").table(pd.DataFrame({"a": []}), "nothing")
    assert check(page.html()).ids == ["section", "section-2"]


def test_a_page_explains_the_short_names_that_it_uses(repository):
    text = (
        Page("Errors", "As P2 eq. 9 has it")
        .text("The heading counts most (T 3.1.2); T and P5 are names.")
        .html()
    )
    assert [name for name in SOURCES if f"<small>{name}: Sardemann, H." in text] == ["T", "P2"]
    assert "<small>" not in Page("Temperatures", "T is the temperature, P5 a point").html()
    listed = (repository / "docs/bibliography.md").read_text()
    for name, source in SOURCES.items():
        row = next(line for line in listed.splitlines() if line.startswith(f"| {name} |"))
        assert source.split("): ")[1].split(".")[0].lower() in row.replace("*", "").lower(), name
        assert source.split("doi:")[-1].rstrip(".") in row or name == "T"
