"""The viewer: what the tree holds, and what a browser makes of the folder from disk."""

import base64
import importlib
import json
import re
import zlib
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from PIL import Image
from pyproj import CRS
from scipy.spatial.transform import Rotation

from tests.figures.browser import Browser
from tests.figures.conftest import make_trajectory
from thalweg.cli import main
from thalweg.core import InputError, LazWriter, LocalFrame, frame_of, write_table
from thalweg.figures.viewer import View, read_view, read_views, write_survey_viewer, write_viewer
from thalweg.figures.viewer.page import grid_of
from thalweg.lidar import COLOUR_DIMENSIONS
from thalweg.panorama import PANORAMAS

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
SPACING_M = 0.25
START_S = 178_649_913.4  # 2017-05-12T18:44:55.4 UTC, the example of core.timescales


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def hills():
    """A waved surface (n, 3), 160 m wide, a point every 25 cm: 410,881 points."""
    x, y = np.meshgrid(*[np.arange(-80, 80.1, SPACING_M)] * 2)
    return np.stack([x, y, 4 * np.sin(x / 12) + 3 * np.cos(y / 9)], axis=-1).reshape(-1, 3)


def whole_view(xyz):
    """Hills with all quantities; red where north is positive, blue elsewhere."""
    n = len(xyz)
    return View(
        xyz_m=xyz,
        frame=FRAME,
        n_total=n,
        rgb=np.where(xyz[:, 1:2] > 0, [200, 30, 30], [30, 30, 200]).astype(np.uint8),
        coloured=xyz[:, 0] > -70,
        intensity=np.arange(n) % 60_000,
        sigma_m=np.tile([0.01, 0.02, 0.03], (n, 1)),
        range_m=np.hypot(*xyz[:, :2].T),
        t_gps_s=START_S + np.linspace(0, 100, n),
    )


def decoded(folder, key):
    """Points (n, 3) of a node's file, and the facts of the page."""
    facts = json.loads(re.search(r"const DATA = (.*);", (folder / "index.html").read_text())[1])
    name, letters = re.fullmatch(
        r'thalwegNode\("(\d*)","(.*)"\)\n', (folder / f"nodes/r{key}.js").read_text()
    ).groups()
    assert name == key
    n = facts["nodes"][key][0]
    planes = (
        np.frombuffer(zlib.decompress(base64.b64decode(letters)), np.uint8)[: 6 * n]
        .reshape(3, 2, n)
        .astype(int)
    )
    corner, size = np.array(facts["corner"]), facts["size"]
    for digit in key:
        size /= 2
        corner = corner + size * (int(digit) >> np.arange(3) & 1)
    return corner + (planes[:, 0] + 256 * planes[:, 1] + 0.5).T / 65536 * size, facts


def test_a_single_point_and_points_at_one_place_are_clouds_too(tmp_path):
    for n in (1, 20_000):
        xyz = np.tile([[412_000.25, 5_651_000.5, 150.0]], (n, 1))
        assert write_viewer(View(xyz_m=xyz, frame=None, n_total=n), tmp_path, title="x") == 1
        place, facts = decoded(tmp_path, "")
        assert place == pytest.approx(xyz[:1], abs=1e-6)
        assert facts["columns"] == []


def test_the_files_hold_the_points(tmp_path):
    xyz = hills()
    assert write_viewer(whole_view(xyz), tmp_path, title="a < b", trajectory=make_trajectory()) == len(xyz)
    page = (tmp_path / "index.html").read_text()
    assert "<h1>a &lt; b</h1>" in page
    assert "digital twin" not in page
    assert not re.findall(r"https?://", page)
    facts = decoded(tmp_path, "")[1]
    assert {path.stem for path in (tmp_path / "nodes").iterdir()} == {f"r{key}" for key in facts["nodes"]}
    found = np.vstack([decoded(tmp_path, key)[0] for key in facts["nodes"]])
    order, expected = (np.lexsort(np.round(place[:, :2] / SPACING_M).T) for place in (found, xyz))
    # half a step of 1 / 65536 of the root's edge
    assert np.abs(found[order] - xyz[expected]).max() <= facts["size"] / 65536 / 2 + 1e-9
    assert sum(place is None for place in facts["track"]) == 10
    size = sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    assert size / len(xyz) < 20  # so that the viewer of a million and a half points has at most 30 MB
    write_viewer(View(xyz_m=xyz[:100], frame=FRAME, n_total=100), tmp_path, title="x", twin=True)
    assert [path.name for path in (tmp_path / "nodes").iterdir()] == ["r.js"]
    assert "digital twin" in (tmp_path / "index.html").read_text()


def test_what_cannot_be_shown_is_refused(tmp_path):
    degrees = View(xyz_m=np.ones((2, 3)), frame=CRS.from_epsg(4326), n_total=2)
    with pytest.raises(InputError, match="a cloud in degrees"):
        write_viewer(degrees, tmp_path, title="x")
    with pytest.raises(InputError, match="not finite"):
        write_viewer(View(xyz_m=np.full((2, 3), np.nan), frame=None, n_total=2), tmp_path, title="x")


def test_the_command_shows_clouds_of_anybody(tmp_path, capsys):
    xyz = hills()[::7]
    with LazWriter(tmp_path / "a.laz", FRAME) as writer:
        # 8-bit colours where 16 bits belong, as some programs write them
        writer.append(
            xyz, rgb=np.full((len(xyz), 3), 200, np.uint16), intensity=np.full(len(xyz), 7, np.uint16)
        )
    assert main(["view", str(tmp_path / "a.laz"), "-o", str(tmp_path / "v"), "--points", "5000"]) == 0
    said = capsys.readouterr().out
    assert "5,000 of 58,698 points" in said
    assert "no standard deviations, no times" in said
    view = read_view(tmp_path / "a.laz")
    assert (view.rgb == 200).all()
    assert view.t_gps_s is None
    few = read_view(tmp_path / "a.laz", 1000)  # each 15th
    assert len(few.xyz_m) == -(-len(xyz) // 15)
    assert few.n_total == len(xyz)
    (tmp_path / "b.xyz").write_text("1 2 3\n4 5 6\n")
    assert main(["view", str(tmp_path / "b.xyz"), "-o", str(tmp_path / "w")]) == 0
    assert "2 of 2 points" in capsys.readouterr().out
    assert main(["view", str(tmp_path / "c.laz"), "-o", str(tmp_path / "w")]) == 2
    assert main(["view", str(tmp_path / "b.xyz"), "-o", str(tmp_path / "w"), "--points", "0"]) == 2


def test_clouds_of_several_chains_are_told_apart(tmp_path, capsys):
    """Times that one of them lacks are shown of none; a cloud in another frame is refused."""
    xyz, intensity = hills()[::40], np.arange(len(hills()[::40]), dtype=np.uint16)
    for name, off, more in (("ins", 0.0, {"t_gps_s": START_S + intensity}), ("camera", 0.5, {})):
        with LazWriter(tmp_path / f"{name}.laz", FRAME) as writer:
            writer.append(xyz + np.array([0, 0, off]), intensity=intensity, **more)
    both = [str(tmp_path / f"{name}.laz") for name in ("ins", "camera")]
    assert main(["view", *both, "-o", str(tmp_path / "v")]) == 0
    assert "<h1>ins.laz, camera.laz</h1>" in (tmp_path / "v/index.html").read_text()
    view = read_views([Path(path) for path in both])
    assert (view.extras["cloud"][0] == np.repeat([1, 2], len(xyz))).all()
    assert_allclose(view.xyz_m[len(xyz) :] - xyz, np.tile([0, 0, 0.5], (len(xyz), 1)), atol=2e-3)
    assert (view.intensity == np.tile(intensity, 2)).all()
    assert view.t_gps_s is None
    assert decoded(tmp_path / "v", "")[1]["extras"] == ["cloud"]
    with LazWriter(tmp_path / "far.laz", LocalFrame(lat_deg=50.0, lon_deg=13.0, h_ell_m=0.0)) as writer:
        writer.append(xyz)
    assert main(["view", both[0], str(tmp_path / "far.laz"), "-o", str(tmp_path / "w")]) == 2
    assert "far.laz: a cloud in the frame" in capsys.readouterr().err
    assert main(["view", *both, "--quantity", "cloud", "-o", str(tmp_path / "w")]) == 2


def test_the_page_of_a_survey_shows_clouds_of_other_chains_when_asked(browser, tmp_path):
    """The first cloud, in its colours, takes half of the points; a click tells which cloud a point is of."""
    xyz = hills().reshape(641, 641, 3)[::4, ::4].reshape(-1, 3)
    flat = np.column_stack([xyz[:, :2], np.zeros(len(xyz))])
    with LazWriter(tmp_path / "a.laz", FRAME, extra_dimensions=COLOUR_DIMENSIONS) as writer:
        writer.append(
            flat,
            rgb=np.tile(np.array([200, 30, 30], np.uint8), (len(xyz), 1)),
            extra=dict.fromkeys(COLOUR_DIMENSIONS, np.ones(len(xyz))),
        )
    for name, up in (("b", 6.0), ("c", -6.0)):
        with LazWriter(tmp_path / f"{name}.laz", FRAME) as writer:
            writer.append(flat + np.array([0, 0, up]))
    files = [tmp_path / f"{name}.laz" for name in "abc"]
    view = read_views(files, 20_000, names=["A", "B", "C"], lead=0.5)
    shares = np.bincount(view.extras["cloud"][0].astype(int))[1:] / 20_000
    assert shares == pytest.approx([0.5, 0.25, 0.25], abs=0.02)
    assert view.n_total == 3 * len(xyz)
    assert (view.coloured == (view.extras["cloud"][0] == 1)).all()
    write_survey_viewer(
        points=files, names=["A", "B", "C"], trajectory=[], gains=[], images=[], rig_images=[], table=[],
        page=tmp_path / "v/index.html", nodes=tmp_path / "v/nodes", title="Hills", twin=False,
    )  # fmt: skip
    with browser.empty_page() as page:

        def red():
            """Share of the view that is red."""
            page.wait("typeof settled !== 'undefined' && settled")
            page.screenshot(tmp_path / "a.png")
            picture = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)[60:560, 270:790]
            return float((picture[..., 0] > picture[..., 2] + 40).mean())

        def clicked():
            page.click(500, 300)
            found = page.run("document.getElementById('found').textContent")
            page.call("Input.dispatchKeyEvent", type="keyDown", key="Escape")
            return re.search(r"(?m)^cloud (.*)$", found)[1].strip()

        page.open(tmp_path / "v/index.html", "#at=0,0,0&look=0,90,60&colour=rgb")
        assert red() > 0.95
        assert clicked() == "A"
        page.run("document.getElementsByName('cloud')[1].click()")
        assert red() < 0.4
        assert clicked() == "B"
        assert "&clouds=3" in page.run("location.hash")
        page.run("for (const k of [0, 1, 2]) document.getElementsByName('cloud')[k].click()")
        page.wait("settled")
        assert clicked() == "C"
        # coloured by cloud all of them are seen
        page.run("setColour('cloud')")
        page.wait("settled")
        assert page.run("[...document.getElementsByName('cloud')].map((box) => box.checked)") == [True] * 3
        assert clicked() == "B"
        page.open(tmp_path / "v/index.html", "#at=0,0,0&look=0,90,60.5&colour=height&clouds=4")
        page.wait("typeof settled !== 'undefined' && settled && camera.far === 60.5")
        assert clicked() == "C"
        assert page.errors == []


def test_extra_dimensions_become_colours(browser, tmp_path, capsys):
    """Distances of two epochs: limits alike on both sides of zero, NaN where nothing was measured."""
    xyz = hills()[::40]
    n = len(xyz)
    d = np.linspace(-0.1, 0.3, n)
    d[:100] = np.nan
    dimensions = {f"more_{k}": ("f4", "a ratio") for k in range(3)} | {
        "distance_m": ("f4", "second less first, m")
    }
    with LazWriter(tmp_path / "a.laz", FRAME, extra_dimensions=dimensions) as writer:
        writer.append(xyz, extra={name: np.arange(n) for name in dimensions} | {"distance_m": d})
    view = read_view(tmp_path / "a.laz")
    assert list(view.extras) == ["distance_m", "more_0", "more_1"]
    assert [unit for _, unit in view.extras.values()] == ["m", "", ""]
    out = ["-o", str(tmp_path / "v"), "--force"]
    assert main(["view", str(tmp_path / "a.laz"), "--quantity", "distance_m", *out]) == 0
    facts = decoded(tmp_path / "v", "")[1]
    assert facts["extras"] == ["distance_m"]
    low, high = facts["limits"]["distance_m"]
    assert high == pytest.approx(0.297, abs=0.002)  # 99 % of the points
    assert low == -high
    capsys.readouterr()
    assert main(["view", str(tmp_path / "a.laz"), "--quantity", "change", *out]) == 2
    assert "quantities change; expected 3 at most of more_0" in capsys.readouterr().err
    with browser.empty_page() as page:
        page.open(tmp_path / "v/index.html", "#at=0,0,0&look=0,90,150&colour=distance_m")
        page.wait("typeof settled !== 'undefined' && settled")
        k = n // 2 + int(np.argmin(np.hypot(*xyz[n // 2 : n // 2 + 2000, :2].T)))
        page.click(*page.run(f"onScreen({xyz[k].tolist()})"))
        words = page.run("document.getElementById('found').textContent")
        assert float(re.search(r"distance_m (-?[\d.]+) m", words)[1]) == pytest.approx(d[k], abs=0.003)
        page.screenshot(tmp_path / "a.png")
        picture = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)[:, 260:]
        # more than zero is red in the north, less is blue in the south
        more, less = (picture[..., i] > picture[..., 2 - i] + 30 for i in (0, 2))
        assert more[60:200].mean() > 0.1 > 0.001 > more[450:].mean()
        assert less[520:].mean() > 0.03 > 0.001 > less[60:200].mean()
        assert page.errors == []


def test_a_browser_opens_it_from_disk(browser, tmp_path):
    xyz = hills()
    write_viewer(whole_view(xyz), tmp_path / "v", title="Hills", twin=True, trajectory=make_trajectory())
    with browser.empty_page() as page:
        page.open(tmp_path / "v/index.html", "#at=0,0,0&look=0,60,60&colour=rgb")
        page.wait("typeof settled !== 'undefined' && settled")
        picture = tmp_path / "a.png"
        page.screenshot(picture)
        colours = np.asarray(Image.open(picture).convert("RGB")).astype(int)[:, 260:]
        red, blue = colours[..., 0] > colours[..., 2] + 40, colours[..., 2] > colours[..., 0] + 40
        # looking north from 60 degrees above: the north half in the upper part, and hardly any gap
        assert red[:290].mean() > 0.9
        assert blue[340:].mean() > 0.9
        # a point that is not hidden: the one that is nearest to the middle of the view
        wanted = xyz[np.argmin(np.linalg.norm(xyz - [6.0, 5.0, 4 * np.sin(0.5) + 3 * np.cos(5 / 9)], axis=1))]
        x, y = page.run(f"onScreen({wanted.tolist()})")
        page.click(x, y)
        words = page.run("document.getElementById('found').textContent")
        found = [float(re.search(rf"{name} (-?[\d.]+) m", words)[1]) for name in ("east", "north", "up")]
        assert np.linalg.norm(np.array(found) - wanted) <= SPACING_M
        assert re.search(r"up .* ± 0.03[01] m", words)
        assert "2017-05-12 18:4" in words
        assert "colour 200 30 30" in words
        page.click(x, y + 90)
        words = page.run("document.getElementById('found').textContent")
        d, level, height = (
            float(re.search(rf"^{name} (-?[\d.]+) m", words, re.M)[1])
            for name in ("distance", "level distance", "height difference")
        )
        assert d == pytest.approx(np.hypot(level, height), abs=0.002)
        assert 5 < d < 20
        # sigma of a height difference of two points of 3 cm each, in steps of 4.6 %
        assert float(re.search(r"height difference .* ± ([\d.]+) m", words)[1]) == pytest.approx(
            0.0424, rel=0.05
        )
        for name in ("sigma", "range"):
            page.run(f"setColour('{name}')")
            page.wait("settled")
        page.call("Input.dispatchKeyEvent", type="keyDown", key="t", text="t")
        page.wait("settled")
        assert "look=0.00,90.00" in page.run("location.hash")
        assert "colour=range" in page.run("location.hash")
        assert page.run("document.querySelector('.mark').textContent") == "digital twin"
        page.set_pixels(1.0)
        page.run("redraw()")
        page.wait("settled")
        # by a clock that says how long a frame takes, fewer points are drawn while the view moves, or more
        # (that the view rests after 180 ms comes too early on a busy machine)
        page.run("var next = () => new Promise(requestAnimationFrame), later = setTimeout")
        page.run("void (setTimeout = () => 1)")
        drawn = []
        for ms in (100, 10):
            page.run(f"var clock = 0; performance.now = () => clock += {ms}")
            page.run("(async () => { for (let k = 0; k < 8; k++) { turn(1, 0); await next(); } })()")
            drawn.append(page.run("drawn.reduce((sum, node) => sum + node.n, 0)"))
        page.run("void (setTimeout = later)")
        page.run("turn(1, 0)")
        page.wait("settled")
        assert drawn[0] < 60_000
        assert drawn[1] > 1.5 * drawn[0]
        assert page.errors == []
        assert all(url.startswith("file://") for url in page.requests)
        assert len(page.requests) > 5


def test_no_text_of_the_data_becomes_a_program(browser, tmp_path):
    """Titles that look like parts of the page, names of files that begin a comment or end a script."""
    hostile = "{{data}} <script>document.title='run'</script><!--<script>"
    view = View(
        xyz_m=hills()[::20],
        frame=FRAME,
        n_total=20_544,
        image=np.zeros(20_545, int),
        clouds=[hostile, "b"],
        extras={"cloud": (np.ones(20_545), "<u>"), hostile: (np.arange(20_545.0), "<u>")},
    )
    write_viewer(view, tmp_path / "v", title=hostile, photographs={0: [hostile, hostile]})
    with browser.empty_page() as page:
        page.open(tmp_path / "v/index.html")
        page.wait("typeof settled !== 'undefined' && settled")
        assert page.run("document.querySelector('h1').textContent") == hostile
        assert page.run("document.title") == hostile
        assert page.run("document.querySelectorAll('u').length") == 0
        assert page.errors == []


def test_a_missing_file_of_the_folder_is_told(browser, tmp_path):
    write_viewer(View(xyz_m=hills()[::20], frame=FRAME, n_total=20_544), tmp_path / "v", title="x")
    (tmp_path / "v/nodes/r.js").unlink()
    with browser.empty_page() as page:
        page.open(tmp_path / "v/index.html")
        page.wait("document.getElementById('state')?.textContent.includes('copy')")
        assert "copy the whole folder" in page.run("document.getElementById('state').textContent")


SIDES = {"north": (220, 40, 40), "east": (40, 200, 40), "south": (40, 40, 220), "west": (220, 220, 40)}


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """Three panoramas along the hills, their middles to the east, each side of the world in its colour."""
    tmp_path, start = tmp_path_factory.mktemp("walk"), make_trajectory()
    azimuth = (np.arange(1024) + 0.5) / 1024 * 360 - 180 + 90
    sides = np.array(list(SIDES.values()))[np.round(azimuth / 90).astype(int) % 4]
    picture = np.tile(sides[None], (512, 1, 1)).astype(np.uint8)
    picture[:40] = 255
    (tmp_path / "pictures").mkdir()
    (tmp_path / "raw").mkdir()
    (tmp_path / "camera").mkdir()
    Image.fromarray(picture[:10, :10]).save(tmp_path / "camera/P 0.JPG")
    rows = {name: [] for name in PANORAMAS.names}
    for k in range(3):
        Image.fromarray(picture).save(tmp_path / f"pictures/R {k}.jpg", quality=95)
        Image.fromarray(picture[:100, :200]).save(tmp_path / f"raw/R {k}.JPG")
        row = dict.fromkeys(PANORAMAS.names, 0.0) | {
            "panorama": f"R {k}.jpg", "image": f"R {k}.JPG", "mode": "depth", "width_px": 1024,
            "seam_places": 1, "t_gps_s": START_S + k, "north_m": 6.0 * k, "up_m": 8.0, "heading_deg": 90.0,
            **{f"sigma_{a}_m": 0.02 for a in ("east", "north", "up")},
            # x right: south, y down, z to the middle: east
            **dict(zip(("qx", "qy", "qz", "qw"), Rotation.from_matrix(
                np.transpose([[0, -1, 0], [0, 0, -1], [1, 0, 0]])).as_quat(), strict=True)),
        }  # fmt: skip
        for name in rows:
            rows[name].append(row[name])
    write_table(tmp_path / "panoramas.parquet", frame_of(PANORAMAS, rows), PANORAMAS, {})
    start.write(tmp_path / "trajectory.parquet")
    xyz = hills()[::4]
    with LazWriter(tmp_path / "c.laz", FRAME, extra_dimensions=COLOUR_DIMENSIONS) as writer:
        writer.append(
            xyz,
            rgb=np.full((len(xyz), 3), 100, np.uint8),
            extra=dict.fromkeys(("n_views", "colour_sigma", "age_s"), np.ones(len(xyz)))
            | {"image": np.where(xyz[:, 1] > 0, 4, -1)},
        )
    (tmp_path / "gains.csv").write_text("image,number\nfront/R 0.JPG,3\nback/R 1.JPG,4\n")
    for name, views in (("viewer", {}), ("panorama", {"pictures": tmp_path / "pictures"})):
        folder = tmp_path / name
        write_survey_viewer(
            points=[tmp_path / "c.laz"],
            trajectory=[tmp_path / "trajectory.parquet"],
            gains=[tmp_path / "gains.csv"],
            images=[tmp_path / "camera"],
            rig_images=[tmp_path / "raw"],
            table=[tmp_path / "panoramas.parquet"],
            page=folder / "index.html",
            nodes=folder / "nodes",
            title="Hills",
            twin=True,
            **views | ({"views": folder / "views"} if views else {}),
        )
    return tmp_path


def test_a_walk_from_panorama_to_panorama(walk, browser, tmp_path):
    with browser.empty_page() as page:

        def shown(at):
            """The side of the world whose colour a pixel has."""
            page.screenshot(tmp_path / "a.png")
            value = np.asarray(Image.open(tmp_path / "a.png").convert("RGB"))[at[1], at[0]].astype(int)
            away = {side: np.abs(value - colour).max() for side, colour in SIDES.items()}
            assert min(away.values()) < 20, value
            return min(away, key=lambda side: away[side])

        def key(text):
            page.call("Input.dispatchKeyEvent", type="keyDown", key=text, text=text)
            page.wait("settled")

        page.open(walk / "panorama/index.html")
        page.wait("typeof settled !== 'undefined' && settled")
        page.run("setColour('height'); $('cover').value = 0")
        # it begins in the first one, towards its middle
        assert page.run("[inside.name, camera.turn]") == ["R 0", 90]
        for heading, side in enumerate(SIDES):
            page.run(f"camera.turn = {90 * heading}; moved()")
            page.wait("settled")
            assert shown((500, 280)) == side
        # the picture lies where the eye sees a direction: the border of north and east is at 45 degrees
        page.run("camera.turn = 30; camera.tilt = -10; moved()")
        page.wait("settled")
        x, y = page.run("onScreen(inside.at.map((v, i) => v + 10 * [Math.SQRT1_2, Math.SQRT1_2, 0.1][i]))")
        assert [shown((round(x) + dx, round(y))) for dx in (-8, 8)] == ["north", "east"]
        # the eye turns to the left and upwards
        key_to = {"ArrowLeft": (25, -10), "ArrowUp": (25, -15)}
        for name, (turned, tilted) in key_to.items():
            page.call("Input.dispatchKeyEvent", type="keyDown", key=name)
            assert page.run("[camera.turn, camera.tilt]") == pytest.approx([turned, tilted])
        # an arrow to the next one, six metres north; then keys, and the map
        page.run("camera.turn = 0; camera.tilt = 0; moved()")
        page.wait("settled")
        assert page.run("[$('before').hidden, $('after').hidden, $('after').textContent]") == [
            True, False, "▲ 6.0 m",
        ]  # fmt: skip
        corner = "(({ x, y }) => [x, y])($('%s').getBoundingClientRect())"
        page.click(*np.add(page.run(corner % "after"), 12))
        page.wait("settled && inside.name === 'R 1'")
        key("n")
        assert page.run("location.hash").startswith("#panorama=R%202&look=0.00,0.00,75")
        key("p")
        key("p")
        assert page.run("inside.name") == "R 0"
        page.click(*np.add(page.run(corner % "map"), page.run("mapped()(places[2].at)")))
        page.wait("settled && inside.name === 'R 2'")
        assert "R 2, 2017-05-12 18:44:57.4 UTC, place ± 0.035 m" in page.run("$('state').textContent")
        # points over the panorama: grey where they cover it, and to be measured
        page.run("setColour('rgb'); $('cover').value = 1; camera.tilt = 30; moved()")
        page.wait("settled")
        page.screenshot(tmp_path / "b.png")
        below = np.asarray(Image.open(tmp_path / "b.png").convert("RGB")).astype(int)[300:500, 300:600]
        assert (np.ptp(below, axis=2) < 12).mean() > 0.6
        page.click(450, 330)
        words = page.run("$('found').textContent")
        assert re.search(r"north [\d.]+ m", words)
        assert "photograph back/R 1.JPG" in words
        key("i")
        assert page.run("inside") is None
        assert page.run("location.hash").startswith("#at=0.000,12.000,8.000")
        assert page.errors == []
        assert all(url.startswith(("file://", "blob:")) for url in page.requests)


def test_a_walk_needs_no_lidar_and_wide_panoramas_are_reduced(walk, tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.import_module("thalweg.figures.viewer.page"), "_WALK_PX", 512)
    folder = tmp_path / "alone"
    write_survey_viewer(
        points=[], trajectory=[walk / "trajectory.parquet"], gains=[], images=[], rig_images=[],
        table=[walk / "panoramas.parquet"], pictures=walk / "pictures", page=folder / "index.html",
        nodes=folder / "nodes", views=folder / "views", title="x", twin=False,
    )  # fmt: skip
    place, facts = decoded(folder, "")
    assert place[np.argsort(place[:, 1])] == pytest.approx(
        np.array([[0, 6.0 * k, 8] for k in range(3)]), abs=1e-3
    )
    assert [each["name"] for each in facts["panoramas"]] == ["R 0", "R 1", "R 2"]
    letters = re.search(r'"([^"]{100,})"', (folder / "views/R 1.js").read_text())[1]
    assert Image.open(BytesIO(base64.b64decode(letters))).size == (512, 256)


def test_a_point_leads_to_its_photograph_and_panorama(walk, browser, tmp_path):
    with browser.empty_page() as page:
        page.open(walk / "viewer/index.html", "#at=0,5,4&look=0,60,30&colour=rgb")
        page.wait("typeof settled !== 'undefined' && settled")
        page.click(450, 300)
        links = page.run("[...document.querySelectorAll('#found a')].map((a) => [a.textContent, a.href])")
        place = page.run("picked[0].place")
        assert [words for words, _ in links] == ["photograph back/R 1.JPG", "panorama of its time"]
        assert links[0][1] == (walk / "raw/R 1.JPG").as_uri()
        page.call("Page.navigate", url=links[0][1])
        page.wait("document.images.length === 1 && document.images[0].naturalWidth === 200")
        page.call("Page.navigate", url=links[1][1])
        page.wait("typeof settled !== 'undefined' && settled")
        assert page.run("inside.name") == "R 1"
        # it looks to the point
        assert page.run(f"onScreen({place})") == pytest.approx([450, 300], abs=0.5)
        # no photograph shows points of the south
        page.open(walk / "viewer/index.html", "#at=0,-9,4&look=0,60,30&colour=rgb")
        page.wait("typeof settled !== 'undefined' && settled && camera.at[1] === -9")
        page.click(450, 300)
        assert page.run("document.querySelectorAll('#found a').length") == 0
        assert page.errors == []


@pytest.mark.parametrize(
    ("share", "extras", "colour"),
    [
        (0.6, {}, "rgb"),
        (0.4, {}, "height"),
        (0.4, {"distance_m": 0.7}, "distance_m"),
        (0.4, {"distance_m": 0.1, "more": 1.0}, "height"),
        (None, {}, "height"),
    ],
)
def test_it_begins_with_the_colour_that_most_points_have(tmp_path, share, extras, colour):
    xyz = hills()[::40]
    place = np.arange(len(xyz)) / len(xyz)
    # ten times as many points in one place, all of them known, tell no more of the cloud
    xyz, place = (
        np.vstack([xyz, np.tile(xyz[:1], (10 * len(xyz), 1))]),
        np.append(place, np.zeros(10 * len(xyz))),
    )
    view = View(
        xyz_m=xyz, frame=FRAME, n_total=len(xyz),
        rgb=None if share is None else np.full((len(xyz), 3), 90, np.uint8),
        coloured=None if share is None else place < share,
        extras={name: (np.where(place < known, place, np.nan), "m") for name, known in extras.items()},
    )  # fmt: skip
    write_viewer(view, tmp_path, title="x")
    assert decoded(tmp_path, "")[1]["colour"] == colour


def test_a_click_gives_the_map_grid_and_further_ones_an_area(browser, tmp_path):
    xyz = hills()[::4]
    folder = tmp_path / "results/a/viewer"
    view = View(xyz_m=xyz, frame=FRAME, n_total=len(xyz), sigma_m=np.full((len(xyz), 3), 0.03))
    write_viewer(view, folder, title="x", grid=grid_of(view, "EPSG:25833"))
    with browser.empty_page() as page:
        page.open(folder / "index.html", "#at=0,0,0&look=0,90,150&colour=height")
        page.wait("typeof settled !== 'undefined' && settled")
        for place in ([0.0, 0.0, 0.0], [-79.0, 60.0, 5.0], [80.0, -80.0, -7.0]):
            expected = FRAME.to_map(np.array(place), CRS.from_epsg(25833))
            assert page.run(f"onGrid({place})") == pytest.approx(expected.tolist(), abs=1e-4)
        page.click(450, 300)
        words = page.run("$('found').textContent")
        assert re.search(
            r"ETRS89 / UTM zone 33N \(EPSG:25833\):\n  easting 377\d{3}\.\d{3} m ± 0\.03\d m\n  northing",
            words,
        )
        for x, y in ((500, 300), (500, 350)):
            for kind in ("mousePressed", "mouseReleased"):
                page.call(
                    "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1, modifiers=8
                )
        a, b, c = np.array(page.run("picked.map((point) => point.place)"))[:, :2]
        area = abs(np.linalg.det([b - a, c - a])) / 2
        words = page.run("$('found').textContent")
        assert float(re.search(r"level area ([\d.]+) m²", words)[1]) == pytest.approx(area, abs=0.006)
        # a square of 10 m whose corners are known to 10 cm: by the law of errors sqrt(2) m²
        page.run(
            "picked = [[0, 0], [10, 0], [10, 10], [0, 10]].map(([x, y]) => "
            "({ place: [x, y, 3], sigma: [0.1, 0.1, 0.5] })); report()"
        )
        assert "length of the line 30.000 m\nlevel area 100.00 m² ± 1.41 m²" in page.run(
            "$('found').textContent"
        )
        # above the plane of three of its corners: means of cells of the same points
        corners = [[-30, -20, 1.0], [30, -20, 4.0], [30, 40, 4.0], [-30, 40, 1.0]]
        found = page.run(f"volumes({corners}, 3600)")
        inside = xyz[(np.abs(xyz[:, 0]) < 30) & (np.abs(xyz[:, 1] - 10) < 30)]
        above = inside[:, 2] - (2.5 + inside[:, 0] / 20)
        cells = pd.Series(above).groupby(list(np.floor((inside[:, :2] + [30, 20]) / np.sqrt(3.6)).T)).mean()
        assert found["share"] > 0.99
        for sign, name in ((1, "above"), (-1, "below")):
            assert found[name] == pytest.approx(3.6 * (sign * cells).clip(lower=0).sum(), rel=0.02)
        assert page.run("volumes([[0, 0, 0], [5, 5, 0], [9, 9, 0]], 1)") is None
        page.click(450, 300)
        assert page.run("picked.length") == 1
        assert (
            page.run("document.querySelector('.back a').href") == (tmp_path / "results/a/index.html").as_uri()
        )
        assert page.errors == []


def test_the_panel_folds_on_a_telephone(browser, tmp_path):
    xyz = hills()[::40]
    write_viewer(View(xyz_m=xyz, frame=FRAME, n_total=len(xyz)), tmp_path, title="Hills")
    with browser.empty_page() as page:
        page.call(
            "Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=0.5, mobile=True
        )
        page.open(tmp_path / "index.html")
        page.wait("typeof settled !== 'undefined' && settled")
        height = "document.querySelector('aside').getBoundingClientRect().height"
        assert page.run(height) < 844 / 8
        page.run("$('panel').open = true")
        assert 844 / 4 < page.run(height) <= 0.6 * 844 + 1
        assert page.run("document.documentElement.scrollWidth") == 390
        assert page.errors == []


def test_what_is_clipped_is_not_drawn_and_not_found(browser, tmp_path):
    xyz = hills().reshape(641, 641, 3)[::2, ::2].reshape(-1, 3)
    write_viewer(View(xyz_m=xyz, frame=FRAME, n_total=len(xyz)), tmp_path / "v", title="x")
    low, high = xyz[:, 2].min(), xyz[:, 2].max()
    with browser.empty_page() as page:

        def drawn():
            page.wait("typeof settled !== 'undefined' && settled")
            page.screenshot(tmp_path / "a.png")
            picture = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")).astype(int)[60:560, 270:790]
            ground = (20, 24, 28) if page.run("dark()") else (244, 245, 246)
            return (np.abs(picture - ground) > 6).any(axis=2)

        # from above, 60 m high and wide
        page.open(tmp_path / "v/index.html", "#at=0,0,0&look=0,90,64.4&colour=height")
        assert drawn().mean() > 0.95
        page.call("Input.dispatchKeyEvent", type="keyDown", key="c", text="c")
        left = drawn()
        half = page.run("cut[3]")
        rows = np.flatnonzero(left.any(axis=1)) + 60
        metres = 2 * np.tan(np.deg2rad(25)) * 64.4 / 600
        # a band across the view through the middle
        assert rows.mean() == pytest.approx(299.5, abs=3)
        assert np.ptp(rows) * metres == pytest.approx(2 * half, abs=4 * metres + 0.5)
        assert "&cut=0.000,0.000,0.000,0.644" in page.run("location.hash")
        page.click(450, 150)
        assert page.run("picked.length") == 0
        limits = f"{low + 2:.3f},{high - 2:.3f}"
        page.open(tmp_path / "v/index.html", f"#at=0,0,0&look=0,90,64.5&colour=height&heights={limits}")
        page.wait("camera.far === 64.5 && !cut")
        seen = xyz[(np.abs(xyz[:, :2]) < 25).all(axis=1), 2]
        share = np.mean((seen > low + 2) & (seen < high - 2))
        assert drawn().mean() == pytest.approx(share, abs=0.06)
        assert page.errors == []
