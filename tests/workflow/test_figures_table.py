"""The table of all pictures: what it gives to the rules, and how its mistakes are told."""

import inspect
import re
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import get_origin, get_type_hints

import pytest
from matplotlib.figure import Figure as Drawing

from tests.workflow.test_campaign_files import survey
from thalweg.core import ConfigError, read_yaml
from thalweg.settings import load_campaigns, with_calibrations
from thalweg.workflow import CampaignFiles, read_figures
from thalweg.workflow.figures import Figures, rows_of
from thalweg_lab.campaign_files import twin_logs

GOOD = """\
survey:
  map:
    shows: A map.
    draw: pkg.maps:draw_map
    inputs:
      points: lidar/points.laz
      reports: =reports
      clouds: =logs(reference)
    settings: {factor: 2.5}
    when: has_reference
    page: accuracy
    category: Survey
    caption: >-
      Words
      below.
scan:
  scan_setup:
    shows: A scan.
    draw: pkg.maps:draw_map
    inputs: {points: "triangulation/{scan}/points.parquet", mesh: =scan_logs(reference)}
    when: [is_compared]
    page: scans
    category: Light sheet
    file: figures/setup_of_{scan}.png
    caption: A scan.
  photo:
    shows: Another rule makes it.
    page: scans
    category: Light sheet
    file: triangulation/{scan}/photo.png
    caption: A photo.
study:
  tables:
    shows: A study.
    draw: pkg.maps:draw_map
    inputs: {parts: [one.csv, resources/two.csv]}
    category: Studies
    caption: A study.
"""

SURVEY = survey(logs={"lidar": ["a.pcap"], "ins": ["a.anpp"]})
REFERENCED = survey(logs={"lidar": ["a.pcap"], "ins": ["a.anpp"], "reference": ["a.laz"]})
BASIN = survey(
    logs={
        "light_sheet": {
            "grid_images": ["g"],
            "scans": {"keel": {"images": ["k"]}, "hull": {"images": ["h"], "reference": ["h.ply"]}},
        }
    }
)


@pytest.fixture
def read(tmp_path):
    """Reads a text as a table beside a package with one drawing function."""
    (tmp_path / "pkg").mkdir()
    (tmp_path / "pkg/__init__.py").touch()
    (tmp_path / "pkg/maps.py").write_text("def draw_map(*, points):\n    return None\n")

    def table(text):
        (tmp_path / "figures.yaml").write_text(text)
        return read_figures(tmp_path / "figures.yaml", source=tmp_path)

    return table


def test_a_row_gives_its_rule_what_it_needs(read):
    by_name = {row.name: row for row in read(GOOD).rows}
    row = by_name["map"]
    assert (row.rule, row.path) == ("plot_map", "results/{campaign}/figures/map.png")
    assert row.log() == "logs/{campaign}/figures/plot_map.log"
    assert row.log("pdf") == "logs/{campaign}/figures/plot_map.pdf.log"
    inputs = row.input_files({"boat": REFERENCED})
    of_boat = SimpleNamespace(campaign="boat", scan="hull")
    assert inputs["points"] == "results/{campaign}/lidar/points.laz"
    assert inputs["reports"](of_boat) == REFERENCED.reports()
    assert inputs["clouds"](of_boat) == ["a.laz"]
    params = row.params({"boat": REFERENCED})
    assert {k: v(of_boat) for k, v in params.items() if callable(v)} == {
        "title": "t",
        "dpi": 200,
        "titles": True,
        "twin": False,
    }
    assert params["factor"] == 2.5
    assert row.memory_mb == [2000]
    assert row.caption == "Words below."
    scan = by_name["scan_setup"]
    assert scan.path == "results/{campaign}/figures/setup_of_{scan}.png"
    assert scan.log() == "logs/{campaign}/figures/plot_scan_setup_{scan}.log"
    assert scan.input_files({"boat": BASIN})["mesh"](of_boat) == ["h.ply"]
    assert scan.params({"boat": BASIN})["scan"](of_boat) == "hull"
    study = by_name["tables"]
    assert study.path == "results/reproduction/figures/tables.png"
    assert study.log() == "logs/reproduction/plot_tables.log"
    first, second = study.input_files({})["parts"]
    assert first == "results/reproduction/one.csv"
    # what is shipped stands in the repository, wherever the results are
    assert Path(second).is_absolute()
    assert Path(second).parts[-2:] == ("resources", "two.csv")
    assert study.params({}) == {"dpi": 200, "titles": True}


def test_pictures_are_kept_in_the_formats_that_are_asked_for(read):
    boat = survey(logs={"lidar": ["a.pcap"], "reference": ["a.laz"]}, figures={"formats": ["pdf", "svg"]})
    kept = ["results/boat/figures/map.png", "results/boat/figures/map.pdf", "results/boat/figures/map.svg"]
    assert read(GOOD).files_to_keep(boat) == kept
    assert read(GOOD).files_to_keep(REFERENCED) == kept[:1] == read(GOOD).files(boat)
    photographs = [name for name in read(GOOD).files_to_keep(BASIN) if "photo" in name]
    assert all(name.endswith(".png") for name in photographs), "another rule makes them"


def test_campaigns_and_pages_ask_for_the_pictures_that_apply(read):
    table = read(GOOD)
    assert table.files(REFERENCED) == ["results/boat/figures/map.png"]
    assert table.files(SURVEY) == []
    assert table.files(REFERENCED, "strip") == []
    # the photograph has no condition; scan by scan, in the order of the table
    assert [name.removeprefix("results/boat/") for name in table.files(BASIN, "scans")] == [
        "triangulation/keel/photo.png",
        "figures/setup_of_hull.png",
        "triangulation/hull/photo.png",
    ]
    assert table.captions("accuracy", "scans") == {
        "map": "Words below.",
        "scan_setup": "A scan.",
        "photo": "A photo.",
    }
    assert [row.name for row in table.drawn()] == ["map", "scan_setup", "tables"]


@pytest.mark.parametrize(
    ("old", "new", "line", "answers"),
    [
        ("    caption: A study.\n", "", 33, ["study.tables.caption", "missing", "Add the line `caption: …`"]),
        ("=reports", "=report", 7, ["survey.map.inputs.reports", "no method report ", "campaign_files"]),
        ("=logs(reference)", "=name", 8, ["survey.map.inputs.clouds", "no method name "]),
        ("when: has_reference", "when: has_refs", 10, ["survey.map.when", "no method has_refs "]),
        ("[is_compared]", "[is_compared, has_more]", 21, ["scan.scan_setup.when", "no method has_more"]),
        ("factor: 2.5", "factor: =name", 9, ["survey.map.settings.factor", "no method name "]),
        ("factor: 2.5", "factor: accuracy.factor", 9, ["survey.map.settings.factor", "no setting "]),
        ("pkg.maps:draw_map", "pkg.map:draw_map", 4, ["survey.map.draw", "no module pkg.map"]),
        ("pkg.maps:draw_map", "pkg.maps:map", 4, ["survey.map.draw", "pkg.maps defines no map"]),
        ("pkg.maps:draw_map", "pkg.maps", 4, ["survey.map.draw", "'pkg.maps'"]),
        ("page: accuracy", "pages: accuracy", 11, ["survey.map.pages", "unknown key", "one of shows, draw"]),
        ("study:", "studies:", 32, ["studies", "'basin', 'scan', 'change' or 'study'"]),
        ("    file: triangulation/{scan}/photo.png\n", "", 26, ["scan.photo", "neither draw nor file"]),
        ("  photo:\n", "  scan_setup:\n", 26, ["the key stands twice"]),
        ("  photo:\n", "  photo: 7\n  more:\n", 26, ["scan.photo", "found 7"]),
    ],
)  # fmt: skip
def test_a_mistake_is_told_with_line_and_cure(read, old, new, line, answers):
    assert old in GOOD
    with pytest.raises(ConfigError) as caught:
        read(GOOD.replace(old, new, 1))
    text = str(caught.value)
    assert f"figures.yaml:{line}: " in text
    for answer in answers:
        assert answer in text


def test_all_mistakes_are_told_at_once(read):
    with pytest.raises(ConfigError) as caught:
        read(GOOD.replace("=reports", "=report").replace("    caption: A scan.\n", ""))
    assert len(str(caught.value).splitlines()) == 2


# ---------------------------------------------------------------- the table of the repository


@pytest.fixture(scope="module")
def rows(repository):
    found, mistakes = rows_of(read_yaml(repository / "workflow/figures.yaml"))
    assert mistakes == []
    return found


def test_captions_of_files_speak_of_no_boat_and_no_river(rows):
    """A campaign of surface models: nobody sailed, and what is compared may be a beach."""
    table = Figures(rows)
    ours, theirs = table.captions("deformation"), table.captions("deformation", of_files=True)
    assert list(ours) == list(theirs)
    assert any("boat" in words for words in ours.values())
    assert [name for name, words in theirs.items() if re.search(r"\b(boat|river)", words)] == []


def test_every_row_gives_what_its_function_takes(rows):
    assert len(rows) > 50
    for row in rows:
        if row.draw is None:
            continue
        module, name = row.draw.split(":")
        function = getattr(import_module(module), name)
        parameters = inspect.signature(function).parameters
        of_campaign = {"title", "twin"} if row.kind != "study" else set()
        given = {*row.inputs, *row.settings}
        offered = given | of_campaign | ({"scan"} if row.kind == "scan" else set())
        asked = {key for key, each in parameters.items() if each.default is each.empty}
        assert given <= set(parameters), row.name
        assert asked <= offered, row.name
        hints = get_type_hints(function)
        assert hints["return"] is Drawing, row.name
        for key, value in row.inputs.items():
            one = isinstance(value, str) and not value.startswith("=")
            assert not (one and get_origin(hints[key]) in (list, Sequence)), (row.name, key)


def test_names_files_and_drawings_of_rows_are_their_own(rows, repository):
    assert len({row.name for row in rows}) == len({row.path for row in rows}) == len(rows)
    text = "".join(p.read_text() for p in (repository / "src").rglob("figures/**/*.py"))
    written = set(re.findall(r"(?m)^def (draw_\w+)\([^()]*\) -> Figure:", text))
    assert written <= {row.draw.split(":")[1] for row in rows if row.draw}


def test_settings_of_rows_are_keys_of_campaign_files(rows, repository):
    defaults = read_yaml(repository / "config/schema.json").data
    for row in rows:
        for key in row.settings.values():
            node = defaults
            asked = isinstance(key, str) and not key.startswith("=")
            for part in key.split(".") if asked else ():
                while "$ref" in node:
                    node = defaults["$defs"][node["$ref"].rsplit("/", 1)[1]]
                assert part in node["properties"], (row.name, key)
                node = node["properties"][part]


def test_what_the_shipped_campaigns_show(repository):
    """The lists that stood in the rules: which pictures a survey, a calibration and a basin have."""
    folder = repository / "config/campaigns"
    campaigns = with_calibrations(
        load_campaigns(["tiny", "demo", "field_tiny", "basin_tiny", "full", "tiny_change"], folder), folder
    )
    of = {n: CampaignFiles(name=n, campaigns=campaigns, twin_logs=twin_logs) for n in campaigns}
    table = read_figures(repository / "workflow/figures.yaml")

    def names(campaign, page=None):
        return [Path(name).stem for name in table.files(of[campaign], page)]

    reference = ["distance_map", "cross_sections", "distance_histogram", "distance_by_range"]
    images = ["mask_view", "image_positions", "frames_by_image"]
    assert names("tiny", "accuracy") == reference
    assert names("tiny", "trajectories") == ["chain_histograms", "chains_by_range", *images]
    assert set(names("full")) - set(names("tiny")) == {"bed_strip"}
    bed = ["sounding_lines", "bed_map", "bed_sections"]
    bed += ["bed_left_out", "terrain_model", "long_profile"]
    assert names("tiny", "bathymetry") == bed
    assert names("tiny")[0] == "from_above"  # it leads the front page
    assert len(names("tiny")) == 28
    # the rig of the demo was calibrated with its boat
    own = ["rig_residuals", "rig_field"]
    assert set(names("tiny")) - set(names("demo")) == set(own)
    assert set(own) < set(names("field_small"))
    assert names("field_tiny") == names("field_tiny", "calibration")
    assert names("field_tiny", "calibration")[-3:] == ["clock_offset", "clock_stability", "synthetic_view"]
    assert len(names("field_tiny")) == 9
    assert set(names("basin_tiny")) - set(names("basin_tiny", "light_sheet")) == set(
        names("basin_tiny", "scans")
    )
    assert names("basin_tiny", "scans")[-1] == "orthophoto"
    assert len(names("basin_tiny", "scans")) == 12
    assert names("tiny_change") == names("tiny_change", "deformation")
    assert names("tiny_change")[:3] == ["epochs_from_above", "epochs_together", "change_map"]
    assert len(names("tiny_change")) == 9
    (row,) = [row for row in table.rows if row.name == "change_map"]
    changes = row.input_files(of)["changes"](SimpleNamespace(campaign="tiny_change"))
    assert changes == ["results/tiny_change/deformation/changes_1-2.parquet"]
    boards = survey(logs={"calibration": {"display": ["d"], "board_images": ["b"]}})
    assert table.files(boards) == []
