"""The ledger of published numbers: its file, the fetching of values, and verdicts."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from thalweg.core import ConfigError, InputError
from thalweg_lab.reproduction import (
    NO_RESULT,
    NOT_MATCHED,
    VERDICTS,
    Results,
    counts,
    distinct,
    judged,
    markdown,
    read_ledger,
    sentence,
)
from thalweg_lab.reproduction.files import Ours, SigmaOf
from thalweg_lab.reproduction.ledger import (
    ABOVE,
    BELOW,
    BY_DEFINITION,
    COULD_FAIL,
    FAILED,
    INPUT,
    NOT_REPRODUCIBLE,
    REPRODUCED,
    THERE,
    WEAKEST_FIRST,
    Found,
    could_fail,
    count,
    ours_words,
    verdict_of,
    verdict_words,
    why_words,
)

NOWHERE = Results({}, {}, None)


@pytest.fixture(scope="module")
def ledger(repository):
    return read_ledger(repository / "resources/published/light_sheet.yaml")


@pytest.fixture(scope="module")
def alone(ledger):
    """Without any result: what is computed, and all else named."""
    return judged(ledger, NOWHERE).set_index("name")


def changed(part, **values):
    """A part of a ledger with other values."""
    return part.model_copy(update=values)


ONE = """
thalweg_ledger: 1
sections:
- title: "P3 3: panel"
  entries:
  - {rows: [C286], part: std, where: P3 3.1.2, quantity: standard deviation, printed: 0.21 mm, value: 0.21,
     unit: mm, half_unit: 0.005, kind: statistic on the twin, rule: at most, basis: goal, why: a bound,
     ours: {file: panels.csv, near: {depth_mm: [128.9, 0.5]}, column: std_mm, n: n}}
  - {rows: [C245], where: P4 6.1, quantity: sigma, printed: 0.15 px, value: 0.15, unit: px, half_unit: 0.005,
     kind: input constant, rule: equal, basis: printed digits, put_in: constant, why: a constant,
     ours: {file: facts.json, key: [image, 0, sigma_px]}}
  - {rows: [C082], where: P4 4, quantity: lens, printed: Powell lens, value: powell, kind: input constant,
     rule: same word, put_in: setting, why: a word, ours: {setting: laser.profile}}
  - {rows: [C084], where: T 4.2.1, quantity: plane, printed: 0.32 mm, value: 0.32, unit: mm, half_unit: 0.005,
     kind: statistic on the twin, rule: equal, basis: sampling error, why: digits and sampling,
     ours: {study: lines.csv, where: {model: regular}, column: rmse, take: mean, sigma: scatter}}
  - {rows: [C231], where: P4 T1, quantity: power, printed: 40 mW, kind: input constant, rule: not checkable,
     why: not published, ours: {none: nothing}}
"""


@pytest.fixture
def small(tmp_path):
    """Five entries and their results, all of which match."""
    (tmp_path / "ledger.yaml").write_text(ONE)
    pd.DataFrame({"depth_mm": [128.912, 72.7], "std_mm": [0.2, 0.9], "n": [1024, 5]}).to_csv(
        tmp_path / "panels.csv", index=False
    )
    (tmp_path / "facts.json").write_text(json.dumps({"image": [{"sigma_px": 0.15}]}))
    pd.DataFrame({"model": ["regular", "regular", "diode"], "rmse": [0.30, 0.35, 9.0]}).to_csv(
        tmp_path / "lines.csv", index=False
    )
    results = Results(
        {name: tmp_path / name for name in ("panels.csv", "facts.json")},
        {"lines.csv": tmp_path / "lines.csv"},
        {"laser": {"profile": "powell"}},
    )
    return read_ledger(tmp_path / "ledger.yaml"), results


def test_each_entry_says_why_and_no_match_is_made_to_fit(ledger):
    for entry in ledger:
        assert entry.why, entry
        if entry.basis == "printed digits" and entry.tolerance:
            # only where three printed numbers make one: 3 (0.005) + 0.005, 3 (0.05) + 0.05
            assert entry.ours.extra["formula"] == "3 * of"
            assert entry.tolerance == pytest.approx(4 * entry.half_unit)
        if entry.basis == "identity":
            assert entry.tolerance <= 1e-4
        if entry.basis == "sampling error":
            assert entry.ours.sigma or entry.ours.sigma_of


def test_the_small_ledger_matches(small):
    table = judged(*small)
    assert table["verdict"].tolist() == [BELOW, INPUT, INPUT, REPRODUCED, NOT_REPRODUCIBLE]
    assert {verdict: n for verdict, n in count(table).items() if n} == {
        BELOW: 1,
        INPUT: 2,
        REPRODUCED: 1,
        NOT_REPRODUCIBLE: 1,
    }
    # 0.2 of a bound of 0.21
    assert_allclose(table["of_bound"], [0.2 / 0.21, *[np.nan] * 4])
    assert [verdict_words(row) for row in table.to_dict("records")][:2] == [
        "below a bound: 95.2 % of it",
        "input: a constant of the stored instrument",
    ]
    assert table["n"].iloc[0] == 1024
    assert_allclose(table["sigma"].iloc[3], np.std([0.30, 0.35], ddof=1))
    assert_allclose(table["difference"].iloc[0], -0.01)


@pytest.mark.parametrize(
    ("rule", "value", "ours", "verdict", "missed_by"),
    [
        ("equal", 1.0, 1.05, REPRODUCED, np.nan),
        ("equal", 1.0, 1.051, NOT_MATCHED, 0.001),
        ("equal", 1.0, 0.949, NOT_MATCHED, -0.001),
        ("at most", 1.0, -50.0, BELOW, np.nan),
        ("at most", 1.0, 1.06, NOT_MATCHED, 0.01),
        ("at least", 1.0, 0.95, ABOVE, np.nan),
        ("at least", 1.0, 0.9, NOT_MATCHED, -0.05),
        ("inside", (1.0, 2.0), 2.05, REPRODUCED, np.nan),
        ("present", None, 7.0, THERE, np.nan),
        ("inside", (1.0, 2.0), 2.1, NOT_MATCHED, 0.05),
        ("inside", (1.0, 2.0), 0.8, NOT_MATCHED, -0.15),
        ("equal", 1.0, float("nan"), NO_RESULT, np.nan),
        ("equal", 1.0, "a word", NO_RESULT, np.nan),
        ("equal", 1.0, None, NO_RESULT, np.nan),
        ("not checkable", 1.0, 1.0, NOT_REPRODUCIBLE, np.nan),
    ],
)
def test_rules(small, rule, value, ours, verdict, missed_by):
    entry = changed(small[0][1], rule=rule, value=value, half_unit=0.05, put_in="")
    found = verdict_of(entry, Found(value=ours, absent="" if ours is not None else "gone"))
    assert found[0] == verdict
    assert_allclose(found[2], missed_by, atol=1e-12)


def numbers(**columns):
    """A table as of `judged` with the columns that counting needs."""
    n = len(columns["verdict"])
    filled = {"rows": ["C068"] * n, "printed": ["a"] * n, "value": [1.0] * n, "of_bound": [np.nan] * n}
    return pd.DataFrame(filled | {"put_in": [""] * n, "rule": ["equal"] * n} | columns)


def test_a_printed_number_counts_once_with_its_weakest_verdict():
    assert set(WEAKEST_FIRST) == set(VERDICTS)
    table = numbers(
        verdict=[REPRODUCED, NOT_MATCHED, BELOW, BELOW, INPUT, REPRODUCED],
        rows=["C250 C072", "C250", "C251", "C251", "C252", "C252"],
        of_bound=[np.nan, 1.2, 0.9, 0.1, np.nan, np.nan],
        put_in=["", "", "", "", "fitted", ""],
    )
    found = distinct(table)
    assert found["verdict"].tolist() == [NOT_MATCHED, BELOW, INPUT]
    # of two sigmas below one bound the one that is nearer to it
    assert found["of_bound"].tolist()[1] == 0.9
    # another value or another text is another number
    assert len(distinct(table.assign(value=range(6)))) == 6
    assert len(distinct(table.assign(printed=list("abcdef")))) == 6


def test_counts_and_the_sentence_agree_and_add_up():
    """A number that was put in or waits for a run could not fail, even where it is not matched."""
    table = numbers(
        verdict=[
            *(REPRODUCED, INPUT, BY_DEFINITION, BELOW, BELOW, ABOVE, THERE),
            *(NOT_MATCHED, NOT_MATCHED, NOT_MATCHED, NOT_REPRODUCIBLE, NO_RESULT),
        ],
        printed=list("abcdefghijkl"),
        of_bound=[*[np.nan] * 3, 0.2, 0.3, *[np.nan] * 7],
        rule=[
            *(*["equal"] * 3, *["at most"] * 2, "at least", "present"),
            *("equal", "equal", "present", "not checkable", "equal"),
        ],
        put_in=["", "setting", "definition", *[""] * 5, "setting", "", "", ""],
    )
    assert could_fail(table).tolist() == [True, False, False, True, True, True, False, True, *[False] * 4]
    assert sentence(table) == (
        "5 of 12 could have failed by a number: 1 did, 1 are reproduced, 2 are below a bound (2 of them "
        "below a third of it), 1 are above a bound. The others: 2 not matched (put in otherwise, or "
        "printed numbers that contradict each other), 1 by definition, 1 there, 1 input, 1 no result yet, "
        "1 not reproducible"
    )
    n = counts(table).set_index("what")
    assert (n["distinct"] == n["entries"]).all()
    assert n.loc[list(VERDICTS), "distinct"].sum() == n.loc["all", "distinct"] == 12
    assert n.loc[[COULD_FAIL, FAILED, "below a third of a bound"], "entries"].tolist() == [5, 1, 2]


def test_sampling_error_needs_a_sigma(small):
    assert verdict_of(small[0][3], Found(value=0.32))[0] == NO_RESULT
    assert judged((changed(small[0][3], ours=changed(small[0][3].ours, sigma="binomial")),), small[1])[
        "reason"
    ].iloc[0]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"file": "gone.csv"}, "gone.csv is not there"),
        ({"column": ["rms"]}, "no column 'rms'"),
        ({"near": {"depth_mm": (50.0, 0.5)}}, "no row with depth_mm within 0.5 of 50"),
        ({"near": {}}, "2 numbers"),
        ({"n": "count"}, "no column 'count'"),
        ({"file": None, "setting": "laser.power"}, "no laser.power"),
        ({"file": None, "study": "slow.csv"}, "snakemake results/reproduction/slow.csv"),
        ({"file": None, "none": "not measured"}, "not measured"),
        ({"file": "facts.json", "key": ["image", 1, "sigma_px"], "column": []}, "no image.1.sigma_px"),
    ],
)
def test_what_is_absent_is_named(small, change, told):
    entry = changed(small[0][0], ours=changed(small[0][0].ours, **change))
    (row,) = judged((entry,), small[1]).to_dict("records")
    assert row["verdict"] == NO_RESULT
    assert told in why_words(row)
    assert told in markdown(judged((entry,), small[1]), title="x", twin=True)


def test_a_campaign_that_is_no_twin_has_no_settings(small):
    results = Results({}, {}, None)
    (row,) = judged((small[0][2],), results).to_dict("records")
    assert (row["verdict"], row["reason"]) == (NO_RESULT, "the campaign is no twin")


def test_a_damaged_result_is_an_error(small, tmp_path):
    (tmp_path / "facts.json").write_text("{")
    with pytest.raises(InputError, match=r"facts\.json: cannot be read"):
        judged(*small)


TAKEN = pd.DataFrame(
    {"a": [3.0, -4.0, np.nan], "b": [1.0, 2.0, 2.0], "word": ["one mode", "one mode", "two"]}
)


@pytest.mark.parametrize(
    ("more", "value"),
    [
        ({"take": "mean"}, -0.5),
        ({"take": "median"}, -0.5),
        ({"take": "sum"}, -1.0),
        ({"take": "least"}, -4.0),
        ({"take": "largest"}, 3.0),
        ({"take": "largest size"}, 4.0),
        ({"take": "rms"}, np.sqrt(12.5)),
        ({"take": "count"}, 2.0),
        ({"take": "largest", "times": 10.0}, 30.0),
        ({"take": "largest", "over": "b"}, 3.0),
        ({"take": "rms", "column": ["a", "b"]}, np.sqrt(34 / 5)),
        ({"take": "one", "where": {"b": 1.0}}, 3.0),
        ({"column": ["word"], "near": {"a": (0.0, 9.0)}, "words": {"one": 1.0, "two": 2.0}}, 1.0),
        ({"take": "largest", "against": "t.csv"}, 1.0),
        ({"take": "largest", "against_where": {"b": 2.0}}, -0.75),
    ],
)
def test_several_numbers_become_one(tmp_path, more, value):
    TAKEN.to_csv(tmp_path / "t.csv", index=False)
    ours = changed(Ours(file="t.csv", column="a"), **more)
    found = Results({"t.csv": tmp_path / "t.csv"}, {}, None).find(ours)
    assert found.value == pytest.approx(value), found


def test_sigmas(tmp_path):
    TAKEN.to_csv(tmp_path / "t.csv", index=False)
    results = Results({"t.csv": tmp_path / "t.csv"}, {}, None)
    ours = Ours(file="t.csv", where={"b": 1.0}, column="a")
    assert results.find(changed(ours, sigma="b", times=2.0)).sigma == 2.0
    assert results.find(changed(ours, sigma="unit")).sigma == 1.0
    # mean of independent rows: sqrt((1 + 4 + 4) / 3) / sqrt(3)
    assert results.find(changed(ours, sigma_of=SigmaOf(file="t.csv", column="b"))).sigma == pytest.approx(1.0)
    share = changed(ours, column=["b"], take="mean", sigma="binomial", n="b", over="b")
    assert results.find(share).sigma == 0.0
    assert "no share" in results.find(changed(share, where={}, over="")).absent


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("thalweg_ledger: 1", "thalweg_ledger: 2", "thalweg_ledger: found 2; expected 1"),
        ("rule: equal, basis: printed digits", "rule: near, basis: printed digits", "found 'near'"),
        ("kind: input constant, rule: equal", "kind: constant, rule: equal", "found 'constant'"),
        ("why: a constant,", "", "why is missing"),
        ("value: 0.15,", "value: many,", "a number for the rule 'equal'"),
        ("value: 0.15,", "value: .nan,", "a number for the rule 'equal'"),
        ("half_unit: 0.005,\n     kind: input constant", "kind: input constant", "half_unit is missing"),
        ("[C245]", "[245]", "a list such as [C286]"),
        ("[C245]", "[C082]", "'C082' stands twice"),
        ("key: [image, 0, sigma_px]", "column: sigma_px", "which number of a .json"),
        ("file: facts.json", "file: /facts.json", "a path below the results"),
        ("file: facts.json", "files: facts.json", "one of file, study"),
        ("take: mean, sigma: scatter", "take: mean", "no sigma"),
        ("take: mean", "take: best", "found 'best'"),
        ("basis: goal", "basis: goal, tolerance: 0.1", "tolerance and basis do not fit"),
        ("value: powell", "value: 3", "a word"),
        ("part: std,", "part: std, colour: red,", "unknown key"),
        ("put_in: constant, ", "", "put_in is missing: its kind is 'input constant'"),
        ("put_in: setting, ", "", "put_in is missing: its number comes from a setting of the twin"),
        ("put_in: setting, ", "put_in: constant, ", "found 'constant' for a setting of the twin"),
        ("put_in: constant, ", "put_in: guess, ", "found 'guess'"),
        ("put_in: constant, ", "put_in: arithmetic, ", "found 'arithmetic' for the kind 'input constant'"),
        (
            "basis: goal, why: a bound",
            "basis: goal, put_in: constant, why: a bound",
            "for the kind 'statistic",
        ),
        (
            "rule: not checkable,\n     why",
            "rule: not checkable, put_in: constant,\n     why",
            "no put_in where nothing is compared",
        ),
        (
            "{file: facts.json, key: [image, 0, sigma_px]}",
            "{computed: arithmetic, with: {formula: of, of: C286 std}}",
            "found 'constant' for the function arithmetic",
        ),
        (
            "study: lines.csv, where: {model: regular}, column: rmse",
            "study: chain_study_goals.csv, where: {chain: ins}, column: found_m",
            "put_in is missing: its number comes from chain_study_goals.csv",
        ),
    ],
)
def test_a_bad_ledger_is_told_with_its_line(tmp_path, old, new, told):
    assert old in ONE
    path = tmp_path / "ledger.yaml"
    path.write_text(ONE.replace(old, new, 1))
    with pytest.raises(ConfigError) as error:
        read_ledger(path)
    assert told in str(error.value)
    assert re.search(r"line \d+", str(error.value))


def test_missing_and_empty_ledgers(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        read_ledger(tmp_path / "none.yaml")
    (tmp_path / "empty.yaml").write_text("")
    with pytest.raises(ConfigError, match="expected a ledger that begins with thalweg_ledger: 1"):
        read_ledger(tmp_path / "empty.yaml")


def test_an_unknown_function_is_an_error(small):
    entry = changed(small[0][0], ours=Ours(computed="magic"))
    with pytest.raises(InputError, match="magic"):
        judged((entry,), NOWHERE)


# ---------------------------------------------------------------- page


def test_what_is_shown_says_twin_units_and_amounts(ledger, alone):
    text = markdown(judged(ledger, NOWHERE), title="Basin", twin=True)
    assert "**digital twin**" in text
    assert "not matched: off by +0.102 mm" in text
    assert "each counted once, 16 of 192 could have failed by a number: 3 did, 5 are reproduced, " in text
    assert "| all | 192 | 212 |" in text
    assert "input: a constant of the stored instrument" in text
    assert "below a bound: " in text
    assert "snakemake results/reproduction/multi_line_models.csv" in text
    assert "digital twin" not in markdown(alone.reset_index().head(1), title="Basin", twin=False)
    row = {"ours": "0.25", "sigma": 0.01, "n": 12.0, "unit": "mm"}
    assert ours_words(row) == "0.25 +- 0.01 mm, n = 12"
    assert ours_words(row | {"ours": "powell"}) == "powell"
