"""Front page of a campaign, and pictures that have nothing to show."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pandas as pd
import pytest

from thalweg.core import InputError
from thalweg.figures import Page, empty_figure, front_page, new_figure, note_of, save


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A folder of results with a page, a picture and an empty picture."""
    folder = tmp_path / "results" / "survey"
    (folder / "figures").mkdir(parents=True)
    Page("Accuracy & more", "The cloud is fine. It is also <large>.").write(folder / "accuracy.html")
    save(new_figure(40.0, "A map", twin=False), folder / "figures" / "map.png", dpi=50)
    reason = "no point lies 2 to 25 m beside the track"
    empty = empty_figure("Sections", reason, twin=True)
    save(empty, folder / "figures" / "sections.png", dpi=50, note=reason)
    return folder


def made(folder: Path, pages: list[Path]) -> str:
    """The front page as text."""
    return front_page(
        folder / "index.html",
        title="Survey <1>",
        twin=True,
        products=[
            {"name": "cloud", "file": str(folder / "lidar" / "points.laz"), "made": True, "needs": ""},
            {"name": "riverbed", "file": "x", "made": False, "needs": "logs.depth"},
        ],
        pages=pages,
        pictures=[folder / "figures" / "map.png", folder / "figures" / "sections.png"],
        captions={"map": "Plan view.", "sections": "Sections across."},
        summary=pd.DataFrame({"quantity": ["points"], "value": [12.0], "unit": ["1"], "source": ["x"]}),
    ).html()


def test_it_links_pages_pictures_and_products(results: Path) -> None:
    text = made(results, [results / "accuracy.html"])
    assert '<a href="accuracy.html">Accuracy &amp; more</a>: The cloud is fine.</li>' in text
    assert '<a href="lidar/points.laz">cloud</a>' in text
    assert "riverbed" in text
    assert "logs.depth" in text
    assert 'href="figures/map.png"' in text
    assert "Plan view." in text
    assert "Digital twin" in text
    assert "Survey &lt;1&gt;" in text
    # an empty picture is named with its reason and not shown
    assert "figures/sections.png" not in text
    assert "no point lies 2 to 25 m beside the track" in text


def test_a_picture_keeps_its_reason(results: Path) -> None:
    assert note_of(results / "figures" / "map.png") is None
    assert "2 to 25 m" in (note_of(results / "figures" / "sections.png") or "")


def test_a_picture_with_nothing_to_show_stops_no_survey(
    repository: Path, tmp_path: Path, monkeypatch
) -> None:
    """The job of every picture: what its drawing function refuses becomes a panel with the reason."""

    def draw() -> None:
        raise InputError("no point lies on the bank", expected="one at least")

    drawing = ModuleType("drawing_of_nothing")
    monkeypatch.setattr(drawing, "draw", draw, raising=False)
    monkeypatch.setitem(sys.modules, "drawing_of_nothing", drawing)
    main = runpy.run_path(str(repository / "workflow/scripts/plot.py"))["main"]
    job = SimpleNamespace(output={}, input={}, params={}, threads=1, rule="draw_bank")
    main.__globals__["snakemake"] = job
    main(figure_png=tmp_path / "bank.png", draw="drawing_of_nothing:draw", shows="Bank", dpi=50)
    assert "no point lies on the bank" in (note_of(tmp_path / "bank.png") or "")


def test_a_page_of_others_is_refused(results: Path) -> None:
    (results / "other.html").write_text("<p>no heading</p>")
    with pytest.raises(InputError, match="without a heading"):
        made(results, [results / "other.html"])
