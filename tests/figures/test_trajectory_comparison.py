"""Figures and page on INS, camera and fused trajectory."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.accuracy.chain_samples import T0, three_chains, trajectory
from thalweg.accuracy import Chain, chains_by_range as by_range_of, chains_table, outage_table, range_facts
from thalweg.core import CoverageError, InputError
from thalweg.figures import number, save
from thalweg.figures.accuracy import centimetres
from thalweg.figures.solutions import Costs, computing_seconds, trajectory_comparison_page
from thalweg.figures.solutions.comparison import chain_histograms, chains_by_range
from thalweg.figures.solutions.page import (
    TWIN_NOTE,
    certainty,
    percent,
    range_words,
    runs_words,
    side_by_side,
    time_words,
)
from thalweg_lab.truth import chains_truth_table


def range_table(chains, *published):
    return by_range_of({chain.name: chain.by_range for chain in chains}, *published)


@pytest.fixture
def chains(rng):
    return three_chains(rng)


@pytest.fixture
def ranges(chains):
    at = np.linspace(1.0, 60.0, 60)
    return range_table(chains, {"ins": 50 + 2.6 * at, "camera": 20 + 4.6 * at}, at)


@pytest.fixture
def gaps(chains):
    """As `outage_table` makes it: the INS has no poses for 2 s, and the images are gone at 12 s."""
    found = [
        {"without": "positions", "begin_gps_s": T0 + 7.98, "end_gps_s": T0 + 10.0},
        {"without": "images", "begin_gps_s": T0 + 12.0, "end_gps_s": T0 + 15.0},
    ]
    return outage_table(found, {c.name: c.trajectory for c in chains})


@pytest.fixture
def control():
    return pd.DataFrame(
        {
            "point": ["A", "B", "C", "D"],
            "role": ["control", "control", "check", "control"],
            "images": [5, 4, 6, 0],
        }
    )


# ---------------------------------------------------------------- figures


def test_ranges_of_all_chains(ranges, look):
    figure = chains_by_range(ranges, outlier_nmads=5.0, title="Test", twin=True)
    words = look.texts(figure)
    for text in (
        "digital twin",
        "INS, achieved, n = ",
        "fused, predicted",
        "published curves cross between 11 and",
        "INS, T Table 3.1",
        "camera, P2 Table 1",
        "farther than 5 NMAD",
    ):
        assert text in words, text
    assert "here (dashed): at 16." in words


def test_two_chains_that_do_not_cross(chains, look):
    better = replace(chains[1], by_range=chains[2].by_range)
    words = look.texts(chains_by_range(range_table([chains[0], better])))
    assert "here INS and camera do not cross" in words


def test_histograms_are_normalised(chains, look):
    figure = chain_histograms([c.distances for c in chains], limit_m=2.0, title="Test")
    for each in chains:
        (bars,) = look.artists(figure, f"histogram-{each.name}")
        values, edges, _ = bars.get_data()
        # all distances are within 2 m: per cent per centimetre times centimetres
        assert np.sum(values * np.diff(edges)) == pytest.approx(100.0)
    assert "standard normal" not in look.texts(figure)
    assert "dotted: N(0, 1)" in look.texts(figure)


def test_nothing_to_draw_is_an_error(ranges):
    with pytest.raises(CoverageError, match="'table' is empty"):
        chains_by_range(ranges.iloc[:0])
    with pytest.raises(InputError, match="no chain"):
        chain_histograms([])


# ---------------------------------------------------------------- words


def test_how_certain_a_difference_is(chains):
    table = chains_table(chains)
    assert "is significant (with " in certainty(table, "fused", "ins")
    # the same with few independent values
    of_n = table["quantity"] == "independent_values"
    table.loc[of_n, ["ins", "camera", "fused"]] = 3.0
    assert "is not significant" in certainty(table, "fused", "ins")


def test_the_words_on_ranges_hold_theory_against_result(chains, ranges):
    facts = range_facts(ranges) | {"published_crossing_m": [12.6]}
    words = range_words(json.loads(json.dumps(facts)))
    assert "the fused trajectory in 26 classes (5 to 30 m)" in words
    assert "INS and camera change places at 16." in words
    assert "the camera being better nearer and the INS farther" in words
    assert (
        "published: between 11 and 13 m (the budgets recomputed: 12.6 m), camera nearer, INS farther" in words
    )
    won = {n: sum(b - a + 1 for a, b in facts["best_of_two"][n]) for n in ("ins", "camera")}
    assert sum(won.values()) == 26
    assert f"the INS is better in {won['ins']} classes, the camera in {won['camera']}" in words
    better = replace(chains[1], by_range=chains[2].by_range)
    words = range_words(range_facts(range_table([chains[0], better])))
    assert "By prediction the camera is the better of both at every range" in words


def test_the_decisive_numbers(chains, gaps, control):
    table = chains_table(chains)
    shown = side_by_side(table, Costs(control=control, images=21, seconds={"ins": 0.1}, outages=gaps))
    rows = shown.set_index("").map(lambda text: text.replace("\N{NO-BREAK SPACE}", " "))
    assert list(rows.columns) == ["INS", "camera", "fused"]
    assert rows.loc["points in the cloud"].tolist() == ["60 000", "6 000", "66 000"]
    assert rows.loc["control points"].tolist() == ["none", "2, and 1 that check", "2, and 1 that check"]
    assert rows.loc["poses where the INS has none", "INS"] == "–"
    without = rows.loc["position sigma without GNSS (1 gap)"]
    assert without["INS"] == "no pose"
    # 3D: root of three times the sigma of a coordinate
    assert without["fused"] == centimetres(3**0.5 * 0.02).replace("\N{NO-BREAK SPACE}", " ")
    assert rows.loc["computing time of its own steps"].tolist() == ["0.1 s", "–", "–"]
    bare = side_by_side(table, Costs())
    assert "control points" not in set(bare[""])


def test_small_words():
    assert [percent(x) for x in (0.0, 0.1234, 0.9997, 1.0, np.nan)] == [
        "0 %",
        "12.3 %",
        "more than 99.9 %",
        "100 %",
        "–",
    ]
    assert [time_words(s) for s in (0.0123, 85.4, 300.0, 9000.0)] == ["0.012 s", "85 s", "5 min", "2.5 h"]
    assert runs_words([[k, k] for k in range(0, 12, 2)]).endswith("6 m and 2 more runs)")
    assert [number(x) for x in (-1.234, 1234.4, np.nan)] == [
        "\N{MINUS SIGN}1.23",
        "1\N{NO-BREAK SPACE}234",
        "–",
    ]


def test_computing_time_is_that_of_the_records(tmp_path):
    for name, seconds in (("a.parquet", 1.5), ("b.npz", 2.0), ("masks", 10.0)):
        (tmp_path / f"{name}.meta.json").write_text(json.dumps({"wall_s": seconds}))
    found = computing_seconds(
        {
            "ins": [tmp_path / "a.parquet"],
            "camera": [tmp_path / "masks", tmp_path / "b.npz"],
            "fused": [tmp_path / "a.parquet", tmp_path / "by_hand.parquet"],
        }
    )
    assert found == {"ins": 1.5, "camera": 12.0}


# ---------------------------------------------------------------- page


def test_the_page_holds_all_chains(chains, ranges, control, gaps, tmp_path):
    picture = tmp_path / "chains_by_range.png"
    save(chains_by_range(ranges), picture, dpi=40)
    truth = chains_truth_table({c.name: c.trajectory for c in chains}, trajectory(), correlation_s=1.0)
    made = {
        "truth": truth,
        "costs": Costs(control=control, images=21, outages=gaps),
        "pictures": [picture],
        "captions": {"chains_by_range": "Sigmas & gaps"},
        "title": "Test",
        "twin": True,
    }
    page = trajectory_comparison_page(chains_table(chains), ranges, range_facts(ranges), **made)
    html = page.html()
    for words in (
        TWIN_NOTE[:40],
        "published, INS",
        "published, camera",
        "By range",
        "Against the truth of the digital twin",
        "Sigmas &amp; gaps",
        "nothing here is fitted",
        "Limits",
        "at which every trajectory has a pose",
        "1 gap without GNSS, 2.0 s in all",
        "1 gap without images",
    ):
        assert words in html, words
    assert html.index("Of 26 range classes") > html.index("By range")
    assert html.count("data:image/png;base64,") == 1
    assert "http" not in html
    assert "nan" not in html.lower().replace("base64", "")[:2000]
    assert ">nan<" not in html
    assert (
        html == trajectory_comparison_page(chains_table(chains), ranges, range_facts(ranges), **made).html()
    )


def test_a_real_survey_without_reference_and_truth(chains):
    bare = [Chain(name=c.name, counts=c.counts, trajectory=c.trajectory) for c in chains]
    none = pd.DataFrame({"range_m": []})
    html = trajectory_comparison_page(chains_table(bare), none, {"published_crossing_m": [12.6]}).html()
    assert "No reference surface judges" in html
    assert TWIN_NOTE not in html
    assert "By range" not in html
    assert ">nan<" not in html
