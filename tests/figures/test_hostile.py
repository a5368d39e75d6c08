"""No text of data becomes a part of a page or a program, whichever field of whichever page it stands in."""

import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from pyproj import CRS

from tests.figures.browser import Browser
from thalweg.figures import Finding, Page, write_front_page
from thalweg.figures.catalogue import CATALOGUE, CONTROL, Entry, catalogue_page
from thalweg.figures.images import orientation_page
from thalweg.figures.viewer import View, write_viewer
from thalweg.ingest import IntegrityReport

HOSTILE = (
    "{{data}}\"' onload='window.ran=1' <script>window.ran=2</script><!--<script>"
    "<img src=x onerror=window.ran=3>"
    "</td></h1></title></style><svg/onload=window.ran=4> javascript:window.ran=5 \\u003c ${window.ran=6} ]]>"
)
HARMLESS = "x"
"""Pages have the same elements with either."""


def every_method(text, folder):
    """Each way to bring a text onto a page."""
    Image.new("RGB", (2, 2)).save(folder / "p.png")
    table = pd.DataFrame({text: [text, text], f"{text}2": [1.0, 2.0]})
    page = Page(text, text, [Finding(text, text, text, text)])
    page.section(text).text(f"{text}\n\n{text}").lines([text]).figure(folder / "p.png", text)
    page.section(text).pictures({text: folder / "p.png"}, {text: text}).links({text: (text, text)})
    with page.fold(text):
        page.thumbnails({text: (folder / "p.png", text)}).table(table, text, {text: text})
    return page


def photographs(text, folder):
    """Names of pictures, cameras (EXIF), points, notes."""
    number = dict.fromkeys(("images", "redundancy", "tie_points"), 3) | {"sigma0": 1.0, "marks_a_point": 3.0}
    facts = number | {
        "check_points": None, "model_frame": {}, "notes": [text, text],
        "sigma_position_model": {text: 1.0},
        "cameras": {text: {text: {"value": 1.0, "sigma": 0.1}}},
    }  # fmt: skip
    columns = [f"{s}without_{a}_mm" for s in ("", "sigma_") for a in ("east", "north", "up")]
    control = pd.DataFrame(
        [dict.fromkeys(columns, 1.0) | dict.fromkeys(("images", "rms_px", "normalised"), 1.0)
         | dict.fromkeys(("point", "role", "suspect", "reason"), text)]
    )  # fmt: skip
    images = pd.DataFrame({"image": [text], "camera": [text], "reason": [text]})
    return orientation_page(facts, images, control, {}, captions={}, title=text)


def catalogue(text, folder):
    """Titles and remarks of campaigns, and what they calibrated."""
    of = {"double": 1.0, "bool": True, "int64": 1}
    row = {each.name: of.get(str(each.type), text) for each in CATALOGUE}
    # names of figures have room for a word
    control = pd.DataFrame([{each.name: of.get(str(each.type), text[:9]) for each in CONTROL}])
    entry = Entry(row, {}, [], None, {}, {"index.html": text})
    return catalogue_page([entry], pd.DataFrame([row]), control)


PAGES = {each.__name__: each for each in (every_method, photographs, catalogue)}


def local_crs_called(name):
    """A coordinate system whose name is any text, as a cloud may state it."""
    quoted = name.replace('"', '""').replace("{", "(")  # else pyproj takes it for JSON
    return CRS.from_wkt(f'LOCAL_CS["{quoted}",UNIT["metre",1],AXIS["Easting",EAST],AXIS["Northing",NORTH]]')


def made_of(text, folder):
    """All pages with a text in each of their fields."""
    found = {}
    for name, make in PAGES.items():
        found[name] = folder / f"{name}.html"
        make(text, folder).write(found[name])
    found["front"] = folder / "front/index.html"
    (folder / "front").mkdir()
    table = pd.DataFrame({"quantity": [text], "value": [1.0], "unit": [text]})
    table.to_csv(folder / "front/summary.csv", index=False)
    report = IntegrityReport(stream=text, format=text, files=[text], model=text)
    report.lose(text, 1)
    report.write(folder / "front/lidar.integrity.json")
    results = [*list(found.values())[:2], folder / "front/summary.csv", folder / "front/lidar.integrity.json"]
    write_front_page(
        page=found["front"], title=text, twin=True, crs="EPSG:25833", results=results, lacking=[(text, text)],
        pictures=[folder / "p.png"], figures={"p": (text, text)},
    )  # fmt: skip
    points = np.random.default_rng(1).uniform(0, 9, (3000, 3))
    view = View(
        xyz_m=points, frame=local_crs_called(text), n_total=3000, image=np.zeros(3000, int),
        clouds=[text, "b"], extras={"cloud": (np.ones(3000), text), text: (np.arange(3000.0), text)},
    )  # fmt: skip
    panorama = {"name": text, "at": [0, 0, 0], "sigma": [1, 1, 1], "heading": 0.0, "utc": text}
    panorama["axes"] = np.eye(3).tolist()
    for name, panoramas in (("viewer", []), ("walk", [panorama])):
        write_viewer(
            view, folder / name, title=text, photographs={0: [text, text, text]}, panoramas=panoramas
        )
        found[name] = folder / name / "index.html"
    return found


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    return made_of(HOSTILE, tmp_path_factory.mktemp("hostile"))


class Elements(HTMLParser):
    """Elements with the names of their attributes, in order, and the texts of scripts."""

    def __init__(self, page):
        super().__init__()
        self.found = []
        self.scripts = []
        self.addresses = []
        self.feed(page.read_text(encoding="utf-8"))
        self.close()

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, *(name for name, _ in attrs)))
        self.addresses += [str(value) for name, value in attrs if name in ("href", "src")]

    def handle_comment(self, data):
        self.found.append(("comment", data))

    def handle_data(self, data):
        if self.cdata_elem == "script":
            self.scripts.append(data)


def test_a_hostile_text_gives_the_elements_of_a_harmless_one(hostile, tmp_path):
    for name, page in made_of(HARMLESS, tmp_path).items():
        harmless, found = Elements(page), Elements(hostile[name])
        assert "window.ran=2" in hostile[name].read_text(), name  # it is there, as text
        assert found.found == harmless.found, name
        for address in found.addresses:
            assert re.match(r"#|data:image/(png|webp);base64,|[^:]*$", address), (name, address)
        assert len(found.scripts) == len(harmless.scripts), name
        for script in found.scripts:
            (data,) = re.findall(r"(?m)^const DATA = .*;$", script)
            assert "window.ran=2" in data
            assert "<" not in data


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def test_no_script_of_a_hostile_text_runs(browser, hostile):
    for name, path in hostile.items():
        with browser.empty_page() as page:
            page.open(path)
            page.wait("document.readyState === 'complete'")
            if name in ("viewer", "walk"):
                page.wait("typeof settled !== 'undefined'")
            assert page.run("document.querySelector('h1').textContent").startswith(
                HOSTILE[:20] if name not in ("recordings", "catalogue") else ""
            )
            assert page.run("typeof window.ran") == "undefined", name
            assert page.run("document.querySelectorAll('svg, [onload], [onerror]').length") == 0, name


def test_pages_are_written_by_page_and_viewer_alone(repository):
    """What they do not escape nobody else writes."""
    tag = re.compile(r"</?(?:a|b|body|div|h\d|html|i|img|li|p|script|span|table|td|tr|ul)\b[^<]*>")
    files = [path for name in ("src", "workflow") for path in (repository / name).rglob("*.py")]
    writers = {path.relative_to(repository).as_posix() for path in files if tag.search(path.read_text())}
    assert writers <= {
        "src/thalweg/figures/page.py",
        "src/thalweg/figures/front.py",  # this and the next read headings of pages
        "src/thalweg/figures/catalogue.py",
        "src/thalweg/figures/viewer/page.py",
        "src/thalweg/workflow/codehash.py",  # `<script>` stands for a name
    }
