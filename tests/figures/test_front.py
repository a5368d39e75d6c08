"""Front page of a campaign: what it says of each kind, that its links lead somewhere, and how it looks."""

import base64
import json
import os
import re
import runpy
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType, SimpleNamespace
from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest
from PIL import Image, ImageDraw

from tests.figures.browser import Browser
from tests.figures.conftest import make_trajectory
from thalweg.core import InputError
from thalweg.figures import Finding, Page, empty_figure, new_figure, note_of, save, write_front_page
from thalweg.figures.front import LEADS
from thalweg.figures.products import MAP_FILES, OWN_FILES
from thalweg.ingest import Gap, IntegrityReport

TITLE = "Survey <1>"
WHOLE_BYTES = 1_500_000


def picture(path, n=500):
    """A scatter plot."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.new("RGB", (669, 550), "white")
    draw = ImageDraw.Draw(image)
    for x, y, tone in np.random.default_rng(n).uniform(0, 1, (n, 3)) * [669, 550, 200]:
        draw.rectangle((x, y, x + 3, y + 3), fill=(int(tone), 80, 200 - int(tone)))
    image.save(path)
    return path


def report(folder, stream, **facts):
    found = IntegrityReport(stream=stream, format="a format", files=["log"], t_first_s=0.0, t_last_s=100.0)
    for key, value in facts.items():
        setattr(found, key, value)
    found.write(folder / f"ingest/{stream}.integrity.json")


def of_boat(folder):
    """Everything that a boat gives."""
    of_soundings(folder)
    make_trajectory(n=200, invalid=(slice(50, 70),)).write(folder / "orientation/trajectory_fused.parquet")
    report(folder, "lidar", model="VLP-16", gaps=[Gap(t_start_s=1.0, duration_s=2.0)])
    report(folder, "camera", losses={"images": 3}, gaps=[Gap(t_start_s=1.0, duration_s=20.0)])
    names = ("n", "rmse", "predicted_rmse", "ratio", "ratio_low95", "ratio_high95")
    for name, ratio in (("accuracy/statistics.csv", 0.5), ("accuracy/by_fused/statistics.csv", 1.0)):
        rows = dict(zip(names, (1000, 0.05, 0.05 * ratio, ratio, 0.9, 1.1), strict=True))
        table = pd.DataFrame(rows.items(), columns=["quantity", "value"])
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        table.assign(registration="as measured", points="without outliers").to_csv(folder / name, index=False)
    for name in ("index", "trajectories"):
        Page(f"Accuracy & more: {TITLE}", "The cloud is fine. It is also <large>.").write(
            folder / f"accuracy/{name}.html"
        )
    for name, of in (("viewer", "Point cloud"), ("bathymetry", "Riverbed")):
        Page(f"{of}: {TITLE}").write(folder / name / "index.html")
    (folder / "bathymetry/validation.json").write_text(
        json.dumps({"rmse_m": 0.052, "bias_m": -0.011, "normalised_square": 1.0, "lines": 4})
    )
    (folder / "lidar").mkdir()
    counts = {"reason": ["kept", "too_near"], "n": [600, 400], "share": [0.6, 0.4]}
    pd.DataFrame(counts).to_csv(folder / "lidar/counts.csv", index=False)
    for name in ("lidar/points_map.laz", "bathymetry/bed.tif", "report.pdf", "lidar/points.laz"):
        (folder / name).write_bytes(bytes(3_210_000 if name.endswith(".laz") else 1200))
    picture(folder / "figures/map.png")
    reason = "no point lies 2 to 25 m beside the track"
    save(empty_figure("Sections", reason, twin=True), folder / "figures/sections.png", dpi=50, note=reason)


def of_soundings(folder):
    """An echo sounder alone."""
    path = make_trajectory(n=200, invalid=(slice(50, 70),))
    replace(path, cov_pose_wcs=path.cov_pose_wcs * 22500).write(folder / "orientation/trajectory.parquet")
    report(folder, "depth")
    (folder / "bathymetry").mkdir(exist_ok=True)
    (folder / "bathymetry/soundings.json").write_text(json.dumps({"pings": 300, "by_reason": {"": 291}}))
    for name in ("sounding_lines", "trajectory"):
        picture(folder / f"figures/{name}.png", 100)
    picture(folder / "figures/from_above.png")
    numbers = {"quantity": ["points"], "value": [12.0], "unit": ["1"], "source": ["x"]}
    pd.DataFrame(numbers).to_csv(folder / "summary.csv", index=False)


def of_change(folder):
    """Two epochs: the numbers are those of its page."""
    found = [Finding("volume of erosion", "−12.6 ± 0.6 m³", "not zero, at 95 %")]
    Page(f"Change of the bank: {TITLE}", "Ground was lost.", found * 9).write(
        folder / "deformation/index.html"
    )
    Page(f"Point cloud: {TITLE}").write(folder / "viewer/index.html")
    picture(folder / "figures/change_map.png")
    for name in ("dod_1-2.tif", "dod_2-3.tif", "volumes_1-2.csv"):
        (folder / "deformation" / name).write_bytes(b"x")


def of_photographs(folder):
    found = [Finding("photographs with a pose", "5 of 5"), Finding("sigma0", "1.02", "consistent")]
    Page(f"Photographs: {TITLE}", "All have poses.", found).write(folder / "photographs/index.html")
    (folder / "photographs/image_poses.csv").write_text("image\n")


def of_calibration(folder):
    Page(
        f"Calibration: {TITLE}", "", [Finding("lidar", "lever arm of 44.2 cm, rotation", "consistent")]
    ).write(folder / "calibration/index.html")
    report(folder, "ins")
    picture(folder / "figures/field_positions.png")
    (folder / "calibration/boat.yaml").write_text("x")


def of_nothing(folder):
    """Boards alone make neither page nor picture."""
    (folder / "calibration").mkdir()
    (folder / "calibration/board_camera_lidar.yaml").write_text("x")


KINDS = {each.__name__[3:]: each for each in (
    of_boat, of_soundings, of_change, of_photographs, of_calibration, of_nothing
)}  # fmt: skip


def front(tmp_path, kind, **more):
    """The front page of a campaign of that kind."""
    folder = tmp_path / "results" / kind
    folder.mkdir(parents=True)
    KINDS[kind](folder)
    write_front_page(
        results=[p for p in sorted(folder.rglob("*")) if p.suffix in {".html", ".json", ".csv", ".parquet"}],
        pictures=sorted(folder.rglob("*.png")),
        figures={"map": ("Survey", "Plan view."), "sections": ("Accuracy", "Sections across.")},
        **{"lacking": [], "title": TITLE, "twin": False, "crs": "EPSG:25833", **more},
        page=folder / "index.html",
    )
    return folder / "index.html"


class Outline(HTMLParser):
    """Links, and how much text, how many pictures and list items follow each heading."""

    def __init__(self, page):
        super().__init__()
        self.links = []
        self.ids = []
        self.parts = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.links += [found["href"]] if "href" in found else []
        self.ids += [found["id"]] if "id" in found else []
        if tag in ("h2", "h3", "summary"):
            self.parts.append([tag, 0])
        elif self.parts and tag in ("a", "img", "td", "li"):
            self.parts[-1][1] += 1


@pytest.mark.parametrize("kind", KINDS)
def test_every_link_leads_somewhere_and_no_section_is_empty(tmp_path, kind):
    page = front(tmp_path, kind)
    found = Outline(page)
    for link in found.links:
        if link.startswith("#"):
            assert link[1:] in found.ids, link
        else:
            assert (page.parent / unquote(link)).exists(), link
    for k, (tag, n) in enumerate(found.parts):
        groups = tag == "h2" and k + 1 < len(found.parts) and found.parts[k + 1][0] == "h3"
        assert n or groups, found.parts
    assert page.stat().st_size < WHOLE_BYTES
    assert "<script" not in page.read_text()
    assert not re.search(r'(src|href)="(?!data:)[^"]*//', page.read_text())


def words(page):
    """The page without its tags, spaces as one."""
    text = re.sub(r"<style>.*?</style>|<[^>]+>", " ", page.read_text(), flags=re.DOTALL)
    return " ".join(text.replace("&amp;", "&").split())


def test_a_survey_at_a_glance(tmp_path):
    text = words(front(tmp_path, "boat", twin=True, lacking=[("strip of the bed", "logs.light_sheet")]))
    for told in (
        "Survey &lt;1&gt; Digital twin: simulated instruments wrote these logs · 2017-05-12, 18:44:55 to",
        # from second to second: all poses of the wave are 130 m
        "UTC · track of 126 m · 51.0502° N, 13.2507° E · map EPSG:25833, ellipsoidal heights",
        # the best trajectory has a gap of 20 poses: from the last one before it to the first one after it
        "position of the boat, median 3D σ, all sensors 3.5 cm 1 gap, 2.1 s",
        "cloud to reference, RMSE, all sensors 5.0 cm predicted 5.0 cm: consistent",
        "cloud to reference, RMSE, INS and GNSS 5.0 cm predicted 2.5 cm: too optimistic",
        "riverbed, RMSE of 4 left-out lines 5.2 cm on average 1.1 cm too low; too few lines to judge",
        "points in the cloud 600 of 1 000 decoded",
        "soundings used 291 of 300 pings; the others with their reasons",
        "inputs without loss 1 of 3 of the others something is missing",
        # a fiftieth and a fifth of the time are missing
        "Lidar VLP-16 ▲ 1 gap, 2.0 s",
        "Camera a format ✖ 1 gap, 20.0 s; 3 images",
        "Echo sounder a format ✔ complete",
        "Accuracy & more : The cloud is fine.",
        "Point cloud by the best trajectory LAZ, EPSG:25833, 3.2 MB CloudCompare, QGIS, CAD",
        "Report of survey PDF, 1 kB to print and hand in",
        "Point cloud, GNSS LAZ, local frame, 3.2 MB CloudCompare",
        "Open in three dimensions: point cloud",
        "strip of the bed logs.light_sheet",
        "Sections across. no point lies 2 to 25 m beside the track",
    ):
        assert told in text, told
    page = (tmp_path / "results/boat/index.html").read_text()
    assert '<a class="lead" href="viewer/index.html"><img' in page
    assert 'href="figures/map.png"' in page
    assert "figures/sections.png" not in page  # it shows nothing
    for tone, name in (("unsure", "Lidar"), ("bad", "Camera"), ("good", "Echo sounder")):
        assert f'<li class="{tone}"><b>{name}</b>' in page


def test_each_kind_shows_the_numbers_of_its_page(tmp_path):
    text = words(front(tmp_path, "soundings"))
    assert "inputs without loss 1 of 1 nothing lost or damaged" in text
    assert "soundings used 291 of 300 pings; the others with their reasons" in text
    assert "median 3D σ, GNSS 5.2 m 1 gap, 2.1 s" in text
    text = words(front(tmp_path, "change"))
    assert text.count("volume of erosion −12.6 ± 0.6 m³ not zero, at 95 %") == 7  # of nine
    assert "Open in three dimensions: point cloud" in text
    assert text.count("Difference of heights, ") == text.count(" TIF, EPSG:25833") == 2
    page = (tmp_path / "results/change/index.html").read_text()
    assert '<a href="deformation/index.html">−12.6 ± 0.6\N{NO-BREAK SPACE}m³</a>' in page
    assert "sigma0 1.02 consistent" in words(front(tmp_path, "photographs"))
    text = words(front(tmp_path, "calibration", crs="local"))
    assert "lidar lever arm of 44.2 cm, rotation consistent" in text
    assert "INS a format ✔ complete" in text
    assert "map local" not in text
    assert "Enlarge" in text


def test_what_is_listed_is_what_campaigns_make(repository):
    """A file that no rule writes, or a picture that is none of ours, would never be shown."""
    rules = "".join(
        path.read_text()
        for path in [*(repository / "workflow/rules").glob("*.smk"),
                     repository / "src/thalweg/workflow/campaign_files.py"]
    )  # fmt: skip
    ours = (repository / "workflow/figures.yaml").read_text()
    assert [stem for stem in LEADS if f"\n  {stem}:\n" not in ours] == []
    names = [name for name, _, _ in (*MAP_FILES, *OWN_FILES)]
    assert len(set(names)) == len(names)
    written = {name: Path(name).name.partition("*")[0] for name in names}
    absent = [name for name, word in written.items() if word not in rules]
    assert absent == []


def test_a_picture_keeps_its_reason(tmp_path):
    save(new_figure(40.0, "A map"), tmp_path / "map.png", dpi=50)
    save(empty_figure("Sections", "no point", twin=True), tmp_path / "none.png", dpi=50, note="no point")
    assert note_of(tmp_path / "map.png") is None
    assert "no point" in (note_of(tmp_path / "none.png") or "")


def test_a_picture_with_nothing_to_show_stops_no_survey(repository, tmp_path, monkeypatch):
    """The job of every picture: what its drawing function refuses becomes a panel with the reason."""

    def draw():
        raise InputError("no point lies on the bank", expected="one at least")

    drawing = ModuleType("drawing_of_nothing")
    monkeypatch.setattr(drawing, "draw", draw, raising=False)
    monkeypatch.setitem(sys.modules, "drawing_of_nothing", drawing)
    main = runpy.run_path(str(repository / "workflow/scripts/plot.py"))["main"]
    job = SimpleNamespace(output={}, input={}, params={}, threads=1, rule="draw_bank")
    drawn = {"draw": "drawing_of_nothing:draw", "shows": "Bank", "dpi": 50, "titles": False}
    main(figure_file=tmp_path / "bank.png", **drawn, job=job)
    assert "no point lies on the bank" in (note_of(tmp_path / "bank.png") or "")


def test_a_page_of_others_is_refused(tmp_path):
    (tmp_path / "other.html").write_text("<p>no heading</p>")
    with pytest.raises(InputError, match="without a heading"):
        write_front_page(
            results=[tmp_path / "other.html"], pictures=[], figures={}, lacking=[], title="x", twin=False,
            crs="x", page=tmp_path / "index.html",
        )  # fmt: skip


def find_axe(repository):
    """The program of axe-core; the test is skipped where it is not."""
    path = Path(os.environ.get("THALWEG_AXE", repository / "node_modules/axe-core/axe.min.js"))
    if not path.is_file():
        pytest.skip("no axe-core: `npm install axe-core`, or THALWEG_AXE=.../axe.min.js")
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile"), (1280, 800)) as opened:
        yield opened


def test_it_is_read_at_once_on_a_telephone_by_keyboard_and_on_paper(tmp_path, browser):
    path = front(tmp_path, "boat")
    with browser.empty_page() as page:
        page.open(path)
        page.wait("document.readyState === 'complete' && document.links.length > 5")
        # without scrolling: the picture, all numbers, all recordings
        parts = "[...document.querySelectorAll('.lead, .findings, .streams')]"
        assert max(page.run(f"{parts}.map((each) => each.getBoundingClientRect().bottom)")) < 800
        wide = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        assert page.run(wide) <= 0
        # keys reach the links in order, and open what is folded
        page.call("Input.dispatchKeyEvent", type="keyDown", key="Tab", windowsVirtualKeyCode=9)
        assert page.run("document.activeElement.tagName") == "A"
        page.run("document.querySelector('summary').focus()")
        page.call("Input.dispatchKeyEvent", type="keyDown", key="Enter", text="\r", windowsVirtualKeyCode=13)
        assert page.run("document.querySelector('details').open")
        page.call(
            "Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=0.5, mobile=True
        )
        assert page.run("innerWidth") == 390
        assert page.run(wide) <= 0
        assert page.run(
            "document.images.length === [...document.images].filter((e) => e.naturalWidth).length"
        )
        # nothing is wider than the paper
        page.call("Emulation.setEmulatedMedia", media="print")
        page.call(
            "Emulation.setDeviceMetricsOverride", width=680, height=960, deviceScaleFactor=0.5, mobile=False
        )
        assert page.run(wide) <= 0
        assert page.run(
            "[...document.querySelectorAll('details td')].every((e) => e.getBoundingClientRect().height)"
        )
        made = base64.b64decode(page.call("Page.printToPDF", preferCSSPageSize=True)["data"])
        page.call("Emulation.setEmulatedMedia", media="")
        box = re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", made)
        assert [round(float(side)) for side in box.groups()] == pytest.approx([595, 842], abs=1)
        assert page.errors == []
        assert {url.partition(":")[0] for url in page.requests} <= {"file", "data"}


def test_a_wide_table_scrolls_on_a_screen_and_fits_on_paper(tmp_path, browser):
    table = pd.DataFrame([{f"a long name {k}": 1234.5678 for k in range(20)}])
    page_of = Page("Wide").section("One").table(table, "Many columns", {"a long name 3": "mm"})
    page_of.lines(["correlation " * 30]).write(tmp_path / "wide.html")
    wide = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    with browser.empty_page() as page:
        page.open(tmp_path / "wide.html")
        page.wait("document.readyState === 'complete' && document.querySelectorAll('table').length")
        for width, media in ((390, "screen"), (680, "print")):
            page.call("Emulation.setEmulatedMedia", media=media)
            page.call(
                "Emulation.setDeviceMetricsOverride",
                width=width,
                height=900,
                deviceScaleFactor=0.5,
                mobile=False,
            )
            assert page.run(wide) <= 0, media
        parts = "[...document.querySelectorAll('td, pre')].map((each) => each.getBoundingClientRect().right)"
        assert max(page.run(parts)) <= 680
        page.call("Emulation.setEmulatedMedia", media="")


def test_axe_finds_no_barrier(tmp_path, repository, browser):
    axe, path = find_axe(repository), front(tmp_path, "boat", twin=True, lacking=[("a", "b")])
    with browser.empty_page() as page:
        for name in ("index.html", "accuracy/index.html"):
            page.open(path.parent / name)
            page.wait(f"document.readyState === 'complete' && location.href.endsWith('boat/{name}')")
            page.run("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
            page.run(f"{axe};0")
            script = "axe.run().then((found) => found.violations.map((v) => `${v.id}: ${v.nodes[0].html}`))"
            assert page.run(script) == [], name
