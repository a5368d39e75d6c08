"""The page on accuracy: its first sentence, its tables, its structure, and what it refuses."""

from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

from thalweg.accuracy import ComparisonSettings, by_range_table
from thalweg.accuracy.comparison_tables import statistics_table, verdicts
from thalweg.core import InputError
from thalweg.figures import Page, save
from thalweg.figures.accuracy import accuracy_page
from thalweg.figures.accuracy.distances import distance_histogram
from thalweg.figures.accuracy.page import _error_model, covered, explanation, limits, pivot, value_of, verdict
from thalweg.navigation.ins_gnss import ErrorModel, PriorErrors

SETTINGS = ComparisonSettings(correlation_s=0.2)


def spaced(text):
    """With plain spaces."""
    return text.replace("\N{NO-BREAK SPACE}", " ")


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
            "area": "a polygon of 5 corners",
            "border": "exclude",
            "correlation_s": 0.2,
            "outlier_nmads": 5.0,
            "reference_sigma_m": 0.005,
            "outlier_limits_sigmas": [-4.4, 5.6],
            "max_distance_m": 2.0,
            "survey_gps_s": [178_649_913.4, 178_650_513.4],
            "height_above_reference_m": 0.1,
            "coverage": {"reference_area_m2": 480.0, "without_points": 0.12, "without_reference": 0.4},
            "predicted_95": {
                "plan_median_m": 0.12,
                "plan_p95_m": 0.31,
                "height_median_m": 0.08,
                "height_p95_m": 0.19,
            },
            "counts": {
                "points": 30_000,
                "outside_area": 9_000,
                "a_new_count": 7,
                "compared": 20_000,
                "outliers": 300,
            },
            "verdicts": verdicts(statistics, by_range),
            "local_dependency": [
                {"registration": "as measured", "points": "all", "words": "it depends <on> the place"}
            ],
        },
        "statistics": statistics,
        "by_range": by_range,
        "registration": {
            "done": True,
            "words": "A motion of 30 mm takes it away.",
            "shift_m": axes,
            "sigma_shift_m": axes,
            "rotation_deg": axes,
            "sigma_rotation_deg": axes,
            "change": {"all": change | {"share_of_bias_removed": 0.31}},
        },
        "mesh_facts": {
            "method": "delaunay",
            "vertices": 549,
            "faces": 960,
            "area_m2": 480.0,
            "notes": ["Look here."],
            "ingest_losses": {"points_not_finite": 17},
            "ingest_notes": ["tls_1.laz states no CRS."],
            "median_edge_m": 0.085,
            "counts": {
                "read": 4_000,
                "outside_area": 3_000,
                "given": 1_000,
                "isolated": 12,
                "off_surface": 4,
                "spikes": 2,
                "long_faces": 5,
                "kept": 549,
            },
        },
    }


def test_the_verdict_comes_first_and_is_that_of_the_tables(found, made):
    kept = made.table.loc[made.table["used"] & ~made.table["outlier"], "distance_m"].to_numpy()
    sentences = [spaced(s) for s in verdict(found["facts"], found["statistics"])]
    out = 100 * (1 - len(kept) / made.table["used"].sum())
    assert f"Without the {out:.1f} % of them that are outliers" in sentences[0]
    assert f"an RMSE of {100 * np.sqrt(np.mean(kept**2)):.1f} cm" in sentences[0]
    assert f"lies {100 * kept.mean():.1f} cm in front of the reference" in sentences[0]
    assert sentences[1].startswith(
        "Its own sigmas predict 5.0 cm; distances are 1.2 times as large as predicted"
    )
    assert f"the mean offset, {1000 * kept.mean():+.0f} mm, is beyond 2 sigma" in sentences[2]
    assert "Of the outliers 100 % lie in front of the reference and 0 % behind it" in sentences[3]
    ratio = value_of(found["statistics"], "ratio", "all")
    assert f"predicted over observed {ratio:.2f}" in sentences[3]
    assert "rigid registration" in sentences[4]
    html = accuracy_page(**found, title="Test").html()
    read = Reader(html)
    first = {row[0]: row[1:] for row in read.tables[0][1:]}
    assert len(first) == 5
    assert first["RMSE of the distances, without outliers"][0].startswith(
        f"{100 * np.sqrt(np.mean(kept**2)):.1f}"
    )
    # distances are 1.2 times as large as predicted, beyond the band
    assert first["predicted by their standard deviations"][1] == "too optimistic"
    side = "in front of" if kept.mean() > 0 else "behind"
    assert first["mean distance"][1] == f"{side} the reference, beyond twice its standard deviation"
    assert html.index(" predicted: too optimistic.") < html.index("<table") < html.index("<h2")
    assert html.index("<h2>Statistics</h2>") < html.index("Without the")


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
    for words in ("Look here.", "tls_1.laz states no CRS.", "Lost while the reference was read"):
        assert words in read.text
    assert "not of a real boat" in read.text
    headings = "Statistics, By range, Distances and 3D errors, Spatial dependency, Registration, Data, Limits"
    assert ", ".join(read.headings) == headings
    assert page.html() == page.html()


def test_both_registrations_and_both_point_sets_stand_below_each_other(found, made):
    table = Reader(accuracy_page(**found).html()).tables[1]
    assert [row[:2] for row in table[1:]] == [
        ["as measured", "all"],
        ["as measured", "without outliers"],
        ["with registration", "all"],
        ["with registration", "without outliers"],
    ]
    heads = "n, mean / mm, median / mm, std / mm, NMAD / mm, RMSE / mm, 95 % of |d| below / mm"
    assert ", ".join(table[0][2:]) == heads
    d = made.table.loc[made.table["used"], "distance_m"].to_numpy()
    # three digits
    assert float(table[1][3]) == pytest.approx(1e3 * d.mean(), rel=5e-3)
    assert float(table[1][7]) == pytest.approx(1e3 * np.sqrt(np.mean(d**2)), rel=5e-3)
    assert int(table[1][2].replace("\N{NO-BREAK SPACE}", "")) == d.size


def test_everything_left_out_is_counted(found):
    read = Reader(spaced(accuracy_page(**found).html()))
    rows = {row[0]: " ".join(row[1:3]) for table in read.tables for row in table[1:]}
    expected = {
        "outside the area of interest": "9 000 30.0",
        "points of the reference": "4 000 100.0",
        "inside it": "1 000 25.0",
        "off the local surface": "4 0.1",
        "of the compared: outliers": "300 1.5",  # not of the whole cloud
        "triangles left out for a long edge": "5 –",  # no share of the points
    }
    assert {name: rows[name] for name in expected} == expected
    assert rows["a new count"].startswith("7 ")  # unknown ones are shown too
    assert rows["spikes of single points"].startswith("2 ")


def test_the_range_table_holds_every_class(found):
    read = Reader(accuracy_page(**found).html())
    (table,) = [t for t in read.tables if t[0][0] == "range / m"]
    kept = found["by_range"].query("registration == 'as measured' and points == 'without outliers'")
    assert [int(row[0]) for row in table[1:]] == kept["range_m"].tolist()
    assert [row[-1] for row in table[1:]] == ["yes" if inside else "no" for inside in kept["inside"]]
    outside = int((~kept["inside"].astype(bool)).sum())
    assert f"{outside} of {len(kept)} range classes are outside their band" in read.text
    assert "about 1.3 are expected there by chance" in read.text


def test_without_registration_it_says_why(found):
    found["registration"] = {"done": False, "words": "no registration was asked for"}
    statistics = found["statistics"]
    found["statistics"] = statistics[statistics["registration"] == "as measured"]
    read = Reader(accuracy_page(**found).html())
    assert "no registration was asked for" in read.text
    assert not any("registration" in words for words in verdict(found["facts"], found["statistics"]))


def test_the_truth_has_a_section_of_its_own(found, made, tmp_path):
    picture = tmp_path / "distance_histogram.png"
    save(distance_histogram(made.table), picture, dpi=50)
    truth = pd.DataFrame(
        {
            "quantity": ["n", "rmse", "n", "rmse"],
            "points": ["all", "all", "bare ground", "bare ground"],
            "value": [100.0, 1.5, 40.0, 0.09],
            "unit": ["1", "m", "1", "m"],
        }
    )
    html = accuracy_page(**found, pictures=[picture], truth=truth, twin=True).html()
    read = Reader(html)
    assert "Against the truth of the digital twin" in read.headings
    assert "Figures" not in read.headings
    (table,) = [t for t in read.tables if t[0][0] == "points" and "RMSE / mm" in t[0]]
    assert table[1:] == [["all", "100", "1\N{NO-BREAK SPACE}500"], ["bare ground", "40", "90"]]
    assert "digital twin" not in accuracy_page(**found, pictures=[picture], twin=False).html()


def test_the_explanation_and_the_limits_use_the_numbers(found):
    text = spaced(explanation(found["statistics"]))
    assert "the predicted 3D error is 8.5 cm" in text
    assert "58 % of the 3D error" in text  # 1 / sqrt(3)
    text = spaced(limits(found["facts"], found["statistics"], found["mesh_facts"]))
    n = value_of(found["statistics"], "independent_values")
    assert f"number of independent values is {n:.0f}" in text
    assert "distance over sigma is outside \N{MINUS SIGN}4.4 to +5.6" in text
    assert "median edge 8.5 cm" in text
    assert "left out: their distance depends" in text
    assert "kept: their distance" in limits(found["facts"] | {"border": "keep"}, found["statistics"])


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (0.9, "longer than assumed, and the bands are too narrow"),
        (0.22, "over 0.22 s (lag of 1/e), which agrees"),
        (0.05, "shorter than assumed"),
        (np.nan, "show no correlation time"),
    ],
)
def test_the_observed_correlation_stands_beside_the_assumed_one(found, seen, words):
    statistics = found["statistics"]
    statistics.loc[statistics["quantity"] == "observed_correlation", "value"] = seen
    text = limits(found["facts"], statistics)
    assert "0.2 s (accuracy.correlation_s)" in text
    assert words in text


def test_what_the_area_holds_is_said(found):
    text = spaced(covered(found["facts"]))
    for words in (
        "40 % of the polygon have no reference",
        "480 m², 12 % hold no compared point",
        "from 2017-05-12T18:44:55",
        "is not known here",
        "below 12.0 cm in plan and 8.0 cm in height",
        "below 31.0 cm and 19.0 cm for 95 % of them",
    ):
        assert words in text
    assert covered({}) == ""


def test_a_warning_comes_before_all_else(found):
    first = verdict(found["facts"] | {"warning": "the cloud lies 3.0 m below"}, found["statistics"])[0]
    assert first == "Caution: the cloud lies 3.0 m below."


def test_a_fitted_cloud_gets_no_verdict_on_its_sigmas(found):
    read = Reader(accuracy_page(**found).html())
    (ratios,) = [t for t in read.tables if "ratio" in t[0] and "values" in t[0]]
    assert [row[0] for row in ratios[1:]] == ["all", "without outliers"]
    (words,) = [t for t in read.tables if "sigmas" in t[0]]
    fitted = [row for row in words[1:] if row[0] == "with registration"]
    assert len(fitted) == 2
    assert all("cannot test its sigmas" in row[2] for row in fitted)


def test_a_registration_without_sigmas_is_shown(found):
    axes = dict.fromkeys(("east", "north", "up"))
    found["registration"] |= {"sigma_shift_m": axes, "sigma_rotation_deg": axes}
    read = Reader(accuracy_page(**found).html())
    (motion,) = [t for t in read.tables if t[0][0] == "motion"]
    assert [row[2] for row in motion[1:]] == ["–"] * 6


def test_quantities_that_are_not_there_make_no_column():
    table = pd.DataFrame({"points": ["all"], "quantity": ["rmse"], "value": [0.1], "unit": ["m"]})
    frame, units = pivot(table, ("points",), (("n", "n", "1", 1.0), ("rmse", "RMSE", "mm", 1e3)))
    assert list(frame.columns) == ["points", "RMSE"]
    assert units == {"RMSE": "mm"}


def test_statistics_of_nothing_are_refused(found):
    with pytest.raises(InputError, match="without compared points"):
        accuracy_page(**found | {"statistics": found["statistics"].iloc[:0]})


def test_the_page_says_who_tells_how_the_poses_err():
    times = {"position_time_s": 10.0, "attitude_time_s": 20.0, "spread": 2.0, "time_spread": 3.0}
    sigmas = {"sigma_position_m": np.full(3, 0.02), "sigma_attitude_rad": np.full(3, 1e-3)}
    prior = PriorErrors(white_share=0.25, **sigmas, **times)
    page = Page("Accuracy", "")
    _error_model(page, ErrorModel.of_prior(prior, note="no plane was seen again").report())
    text = page.html()
    assert "positions, slow part: factor" in text
    assert text.count("<td>prior</td>") == 8
    assert "not significant, not corrected" in text
    assert "no plane was seen again" in text
