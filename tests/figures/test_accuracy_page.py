"""The page on accuracy: its first sentence, its tables, its structure, and what it refuses."""

from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

from thalweg.accuracy.comparison import ComparisonSettings
from thalweg.accuracy.comparison_tables import by_range_table, statistics_table, verdicts
from thalweg.core.errors import InputError
from thalweg.figures.accuracy_page import accuracy_page, pivot
from thalweg.figures.accuracy_words import explanation, limits, value_of, verdict
from thalweg.figures.distance_histogram import distance_histogram
from thalweg.figures.style import save

SETTINGS = ComparisonSettings(correlation_s=0.2)


class Reader(HTMLParser):
    """Keeps headings, tables as lists of rows, text, links and unclosed elements."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.open, self.wrong, self.tables, self.headings, self.sources, self.links = [], [], [], [], [], []
        self.text = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        if tag not in {"meta", "img"}:
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in {"td", "th"}:
            self.tables[-1][-1].append("")
        if tag == "h2":
            self.headings.append("")
        self.sources += [found["src"]] if "src" in found else []
        self.links += [found["href"]] if "href" in found else []

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)

    def handle_data(self, data):
        self.text += data
        if {"td", "th"} & set(self.open):
            self.tables[-1][-1][-1] += data
        if self.open and self.open[-1] == "h2":
            self.headings[-1] += data


@pytest.fixture
def found(made):
    """What a comparison hands over, as measured and with an offset taken off."""
    moved = made.table.assign(distance_m=made.table["distance_m"] - 0.03)
    states = {"as measured": made.table, "with registration": moved}
    statistics = pd.concat([statistics_table(t, SETTINGS, s) for s, t in states.items()], ignore_index=True)
    by_range = pd.concat([by_range_table(t, SETTINGS, s) for s, t in states.items()], ignore_index=True)
    axes = {"east": 0.001, "north": -0.02, "up": 0.022}
    change = {
        f"{word}_{when}_m": value
        for word, before in (("bias", 0.03), ("median", 0.03), ("std", 0.05), ("rmse", 0.058), ("nmad", 0.05))
        for when, value in (("before", before), ("after", 0.7 * before))
    }
    return {
        "facts": {
            "area": "a polygon of 5 corners", "border": "exclude", "correlation_s": 0.2, "outlier_nmads": 5.0,
            "reference_sigma_m": 0.005, "outlier_limits_m": [-0.22, 0.28],
            "counts": {"points": 30_000, "outside_area": 9_000, "a_new_count": 7, "compared": 19_700},
            "verdicts": verdicts(statistics, by_range),
            "local_dependency": [
                {"registration": "as measured", "points": "all", "words": "it depends <on> the place"}
            ],
        },
        "statistics": statistics,
        "by_range": by_range,
        "registration": {
            "done": True, "words": "A motion of 30 mm takes it away.", "shift_m": axes, "sigma_shift_m": axes,
            "rotation_deg": axes, "sigma_rotation_deg": axes,
            "change": {"all": change | {"share_of_bias_removed": 0.31}},
        },
        "mesh_facts": {
            "method": "delaunay", "vertices": 549, "faces": 960, "area_m2": 480.0, "notes": ["Look here."],
            "counts": {"given": 1_000, "isolated": 12, "off_surface": 3, "long_faces": 5, "kept": 549},
        },
    }  # fmt: skip


def test_the_verdict_comes_first_and_is_that_of_the_tables(found, made):
    kept = made.table.loc[made.table["used"] & ~made.table["outlier"], "distance_m"].to_numpy()
    sentences = [s.replace("\N{NO-BREAK SPACE}", " ") for s in verdict(found["facts"], found["statistics"])]
    assert f"an RMSE of {100 * np.sqrt(np.mean(kept**2)):.1f} cm" in sentences[0]
    assert f"lies {100 * kept.mean():.1f} cm in front of the reference" in sentences[0]
    assert sentences[1].startswith(
        "Its own sigmas predict 5.0 cm: errors are 1.2 times larger than predicted"
    )
    assert len(sentences) == 4
    html = accuracy_page(**found, title="Test").html()
    assert html.index("Without outliers") < html.index("<h2")


def test_behind_the_reference_is_said(found):
    statistics = found["statistics"]
    mean = (statistics["quantity"] == "bias") & (statistics["points"] == "without outliers")
    statistics.loc[mean, "value"] = -0.06
    assert "6.0\N{NO-BREAK SPACE}cm behind the reference" in verdict(found["facts"], statistics)[0]


def test_the_page_is_whole_and_needs_nothing_from_elsewhere(found, made, tmp_path):
    picture = tmp_path / "distance_histogram.png"
    save(distance_histogram(made.table), picture, dpi=50)
    page = accuracy_page(
        **found, pictures=[picture], captions={"distance_histogram": "Bars & fits"}, title="Test", twin=True
    )
    read = Reader(page.html())
    assert not read.open
    assert not read.wrong
    assert all(source.startswith("data:image/png;base64,") for source in read.sources)
    assert len(read.sources) == 1
    assert all(link.startswith("#") for link in read.links)
    assert "Bars & fits" in read.text
    assert "it depends <on> the place" in read.text
    assert "Look here." in read.text
    assert "not of a real boat" in read.text
    assert read.headings == [
        "Statistics", "Figures", "By range", "Why distances are smaller than the 3D error", "By place",
        "Registration", "What was compared", "Limits",
    ]  # fmt: skip
    assert page.html() == page.html()


def test_both_registrations_and_both_point_sets_stand_below_each_other(found, made):
    table = Reader(accuracy_page(**found).html()).tables[0]
    assert [row[:2] for row in table[1:]] == [
        ["as measured", "all"], ["as measured", "without outliers"],
        ["with registration", "all"], ["with registration", "without outliers"],
    ]  # fmt: skip
    assert table[0][2:] == [
        "n",
        "mean / mm",
        "median / mm",
        "std / mm",
        "NMAD / mm",
        "RMSE / mm",
        "95 % below / mm",
    ]
    d = made.table.loc[made.table["used"], "distance_m"].to_numpy()
    assert float(table[1][3]) == pytest.approx(1e3 * d.mean(), rel=1e-3)
    assert float(table[1][7]) == pytest.approx(1e3 * np.sqrt(np.mean(d**2)), rel=1e-3)
    assert int(table[1][2].replace("\N{NO-BREAK SPACE}", "")) == d.size


def test_everything_left_out_is_counted(found):
    read = Reader(accuracy_page(**found).html())
    rows = {row[0]: row[1:] for table in read.tables for row in table[1:]}
    assert rows["outside the area of interest"] == ["9\N{NO-BREAK SPACE}000", "30"]
    assert rows["a new count"][0] == "7"  # unknown ones are shown too
    assert rows["off the local surface"] == ["3", "0.3"]
    assert rows["triangles left out for a long edge"] == ["5", "–"]  # no share of the points


def test_the_range_table_holds_every_class(found):
    read = Reader(accuracy_page(**found).html())
    (table,) = [t for t in read.tables if t[0][0] == "range / m"]
    kept = found["by_range"].query("registration == 'as measured' and points == 'without outliers'")
    assert [int(row[0]) for row in table[1:]] == kept["range_m"].tolist()
    assert [row[-1] for row in table[1:]] == ["yes" if inside else "no" for inside in kept["inside"]]
    outside = int((~kept["inside"]).sum())
    assert f"{outside} of {len(kept)} classes lie outside" in read.text


def test_without_registration_it_says_why(found):
    found["registration"] = {"done": False, "words": "no registration was asked for"}
    statistics = found["statistics"]
    found["statistics"] = statistics[statistics["registration"] == "as measured"]
    read = Reader(accuracy_page(**found).html())
    assert "no registration was asked for" in read.text
    assert len(verdict(found["facts"], found["statistics"])) == 3


def test_the_truth_has_a_section_of_its_own(found, made, tmp_path):
    picture = tmp_path / "error_versus_range.png"
    save(distance_histogram(made.table), picture, dpi=50)
    truth = pd.DataFrame({
        "quantity": ["n", "rmse", "n", "rmse"], "points": ["all", "all", "bare ground", "bare ground"],
        "value": [100.0, 1.5, 40.0, 0.09], "unit": ["1", "m", "1", "m"],
    })  # fmt: skip
    html = accuracy_page(**found, pictures=[picture], truth=truth, twin=True).html()
    read = Reader(html)
    assert "Against the truth of the digital twin" in read.headings
    assert "Figures" not in read.headings
    assert html.index("against-the-truth") < html.index("<img")
    (table,) = [t for t in read.tables if t[0][0] == "points" and "RMSE / mm" in t[0]]
    assert table[1:] == [["all", "100", "1500"], ["bare ground", "40", "90"]]


def test_the_explanation_and_the_limits_use_the_numbers(found):
    text = explanation(found["statistics"]).replace("\N{NO-BREAK SPACE}", " ")
    assert "predict 8.5 cm for all three components together, and 5.0 cm" in text
    assert "58 % of it" in text  # 1 / sqrt(3)
    text = limits(found["facts"], found["statistics"]).replace("\N{NO-BREAK SPACE}", " ")
    n = value_of(found["statistics"], "independent_values")
    assert f"worth {n:.0f} independent values" in text
    assert "\N{MINUS SIGN}22.0 cm to +28.0 cm" in text
    assert "left out: their distance" in text
    assert "kept: their distance" in limits(found["facts"] | {"border": "keep"}, found["statistics"])


def test_quantities_that_are_not_there_make_no_column():
    table = pd.DataFrame({"points": ["all"], "quantity": ["rmse"], "value": [0.1], "unit": ["m"]})
    frame, units = pivot(table, ("points",), (("n", "n", "1", 1.0), ("rmse", "RMSE", "mm", 1e3)))
    assert list(frame.columns) == ["points", "RMSE"]
    assert units == {"RMSE": "mm"}


def test_statistics_of_nothing_are_refused(found):
    with pytest.raises(InputError, match="without compared points"):
        accuracy_page(**found | {"statistics": found["statistics"].iloc[:0]})
