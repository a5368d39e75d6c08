"""The ledger of all published items: every one stands in it, its verdict follows from what it points to."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from thalweg.budgets import long_table, read_budget
from thalweg.core import ConfigError
from thalweg.settings import load_campaign
from thalweg_lab.campaign_files import records
from thalweg_lab.figures import write_ledger
from thalweg_lab.reproduction import (
    ITEMS,
    NO_RESULT,
    NOT_MATCHED,
    VERDICTS,
    Results,
    by_class,
    headlines,
    missing_items,
    parts_of,
    read_ledger,
    read_ledgers,
    read_pages,
    recorded,
    sentence,
    told,
    whole_ledger,
)
from thalweg_lab.reproduction.files import NAMES, Ours
from thalweg_lab.reproduction.ledger import (
    ABOVE,
    BELOW,
    BY_DEFINITION,
    INPUT,
    NOT_REPRODUCIBLE,
    REPRODUCED,
    THERE,
    Found,
    could_fail,
    verdict_of,
)
from thalweg_lab.reproduction.verdicts import COMPUTED

MOST_WAIVED = 30
MET = (REPRODUCED, BELOW, ABOVE, BY_DEFINITION, INPUT)
NAMED = pd.read_csv(Path(__file__).parents[2] / "resources/published/headlines.csv")
"""What stands at the head of the page."""


@pytest.fixture(scope="module")
def entries(repository):
    return read_ledgers(repository / "resources/published")


@pytest.fixture(scope="module")
def pages(repository):
    return read_pages(repository / "resources/thesis_pages.yaml")


@pytest.fixture(scope="module")
def parts(repository):
    """Rules as docs/rules.md lists them, which another test keeps in step with the workflow."""
    rules = re.findall(r"^\| `(\w+)` \|", (repository / "docs/rules.md").read_text(), re.MULTILINE)
    return parts_of(rules, figures_of(repository))


def figures_of(repository):
    table = yaml.safe_load((repository / "workflow/figures.yaml").read_text())
    return {name: row for rows in table.values() for name, row in rows.items()}


@pytest.fixture(scope="module")
def results(entries, parts, repository, tmp_path_factory):
    """What a fresh clone has: records, settings, computed numbers, and the tables of budgets."""
    folder = tmp_path_factory.mktemp("budgets")
    studies = {}
    for name in ("p2_table1", "t_table3_1", "p1_direct"):
        studies[f"budgets/{name}.csv"] = folder / f"{name}.csv"
        budget = read_budget(repository / f"resources/budgets/{name}.yaml")
        long_table(budget).to_csv(folder / f"{name}.csv", index=False)
    settings = {
        name: load_campaign(repository / f"config/campaigns/{name}.yaml").model_dump(mode="json")
        for name in ("full", "field", "mulde", "reach", "basin")
    }
    return Results(
        files={}, studies=studies, settings=settings, records=recorded(records(repository)), parts=parts
    )


@pytest.fixture(scope="module")
def ledger(entries, results, pages):
    return whole_ledger(entries, results, pages)


# ---------------------------------------------------------------- all items


def test_every_item_stands_in_the_ledger(entries, ledger):
    assert missing_items(entries) == []
    assert len(ITEMS) == 328 + 30 + 39
    assert len(ledger) == len(entries)
    assert set(" ".join(ledger["rows"]).split()) == set(ITEMS)
    without = tuple(e for e in entries if "C138" not in e.rows)
    assert missing_items(without) == ["C138"]


def test_every_row_has_a_verdict_and_a_reason(ledger):
    assert set(ledger["verdict"]) <= set(VERDICTS)
    for row in ledger.to_dict("records"):
        assert row["reason"], row
        assert re.search(r"\(p\. \d+\)$", row["where"]), row
    assert ledger[ledger["verdict"] == "open"]["rows"].str.startswith("FW").all()
    assert (ledger["verdict"] == "waived").sum() <= MOST_WAIVED
    # misses first, then by item
    assert ledger["verdict"].map(VERDICTS.index).is_monotonic_increasing
    for _, part in ledger.groupby("verdict"):
        assert part["rows"].str.split().str[0].map(ITEMS.index).is_monotonic_increasing


def test_exact_numbers_that_are_missed_are_explained(ledger):
    missed = ledger[(ledger["kind"] == "exact") & (ledger["verdict"] == NOT_MATCHED)]
    assert len(missed)
    assert (missed["note"] != "").all(), missed["name"].tolist()


def test_what_could_fail_was_not_put_in(ledger, entries):
    """Cells of the tables that are a sigma itself, arithmetic, and fitted geometry are no findings."""
    by_name = {e.name: e for e in entries}
    for row in ledger[could_fail(ledger)].to_dict("records"):
        assert not by_name[row["name"]].put_in
        assert by_name[row["name"]].ours.source not in NAMES, row
    cells = ledger[ledger["source"].str.contains("p2_table1.csv: influence|t_table3_1.csv: influence")]
    assert cells["verdict"].value_counts().to_dict() == {BY_DEFINITION: 72, INPUT: 60}
    assert (ledger[ledger["kind"] == "figure"]["verdict"].isin([THERE, "waived"])).all()


def test_page_table_words_and_docs_count_alike(ledger, entries, repository, tmp_path):
    """A row of ledger.csv is an entry; the page has it once, and every count is of these rows."""
    counts = by_class(ledger).set_index("verdict")
    assert counts.loc["all", "all"] == len(ledger) == len(entries)
    assert (counts.loc["all"] == counts.loc[list(VERDICTS)].sum()).all()
    assert (counts["all"] == counts.drop(columns="all").sum(axis=1)).all()
    for verdict in VERDICTS:
        assert counts.loc[verdict, "all"] == (ledger["verdict"] == verdict).sum()
    assert counts.loc["could have failed", "all"] == could_fail(ledger).sum()
    said = f"{could_fail(ledger).sum()} of {len(ledger)} could have failed by a number: "
    assert sentence(ledger).startswith(f"{said}{counts.loc['of these failed', 'all']} did, ")
    html = written(ledger, tmp_path)
    assert said in html
    for verdict in VERDICTS:
        section = html.partition(f'<h2 id="{verdict.replace(" ", "-")}">')[2].partition("<h2")[0]
        shown = section.count("<tr><td")
        assert shown == counts.loc[verdict, "all"], verdict
    # docs count the same rows, whatever was run when they were written
    recorded_counts = pd.read_csv(repository / "docs/validation/ledger_verdicts.csv").set_index("verdict")
    assert recorded_counts.loc["all"].to_dict() == counts.loc["all"].to_dict()
    assert f"Of {len(ledger)} rows " in (repository / "docs/ledger.md").read_text()
    assert said.strip() in " ".join(told(ledger, headlines(ledger, NAMED)).split())


def test_what_was_not_run_is_named_above_the_counts(ledger, entries, results, pages, tmp_path):
    """In a clone the campaign `basin` is not there; with its results nothing waits for it."""
    waiting = ledger[ledger["command"] == "snakemake --config campaign=basin"]
    assert set(waiting["verdict"]) == {NO_RESULT}
    line = f"snakemake --config campaign=basin for {len(waiting)} rows"
    html, text = written(ledger, tmp_path), told(ledger, headlines(ledger, NAMED))
    assert html.index(line) < html.index("could have failed") < html.index('id="counts"')
    assert text.index(line) < text.index("could have failed")
    without = ledger.assign(command="")
    assert "Not run" not in told(without, headlines(ledger, NAMED))
    assert "Not run here" not in written(without, tmp_path)


def test_no_entry_of_the_tables_is_typed_twice(entries):
    """Cells come from the CSV of the budget: 17 rows and 16 rows at four distances."""
    assert sum(e.ours.name == "budgets/p2_table1.csv" and "influence" in e.quantity for e in entries) == 68
    assert sum(e.ours.name == "budgets/t_table3_1.csv" for e in entries) == 64


# ---------------------------------------------------------------- what entries point to


def test_rules_functions_and_figures_exist(entries, parts):
    named = [e for e in entries if e.ours.source in NAMES]
    assert {e.ours.source for e in named} == set(NAMES)
    for entry in named:
        for name in entry.ours.name.split(", "):
            assert parts[entry.ours.source](name), f"{entry.name}: no {entry.ours.source} {name}"
    for wrong in ({"rule": "georeference"}, {"function": "thalweg.lidar:gone"}, {"figure": "cloud"}):
        ((kind, name),) = wrong.items()
        assert not parts[kind](name)


def printed_figures(shows):
    """``P3 Fig. 4`` and so on, of ``(P3 Fig. 4 and 7, P4 Fig. 9 to 11, Fig. 16b)``."""
    found = set()
    paper, last = "", 0
    for match in re.finditer(
        r"\b(T|P[1-4]) |Fig\. ([\d.]+)[a-f]?|(?:and|to|,) ([\d.]+)[a-f]?\b|\bto (?=\d)", shows
    ):
        if match.group(1):
            paper = match.group(1)
            continue
        number = (match.group(2) or match.group(3) or "").rstrip(".")
        if not number:
            continue
        if match.group(0).startswith("to") and "." not in number:
            found |= {f"{paper} Fig. {i}" for i in range(last, int(number) + 1)}
        found.add(f"{paper} Fig. {number}")
        last = int(number) if "." not in number else 0
    return found


def test_each_figure_shows_what_its_row_says(entries, repository):
    """A picture names the printed figure that it shows, or its entry is a sketch of the same thing."""
    assert printed_figures("x (P3 Fig. 4 and 7, P4 Fig. 9 to 11, T Fig. 3.3b)") == {
        *(f"P3 Fig. {i}" for i in (4, 7)),
        *(f"P4 Fig. {i}" for i in (9, 10, 11)),
        "T Fig. 3.3",
    }
    shows = {name: row["shows"] for name, row in figures_of(repository).items()}
    # a study may draw the picture: its question names the figure
    for study in (repository / "config/studies").glob("*.yaml"):
        shows[study.stem] = yaml.safe_load(study.read_text()).get("question", "")
    drawn = [e for e in entries if e.kind == "figure" and e.rule == "present"]
    assert len(drawn) > 50
    unnamed = {
        e.where
        for e in drawn
        if not any(e.where in printed_figures(shows[name]) for name in e.ours.name.split(", "))
    }
    # the sketch of a zigzag
    assert unnamed == {"P2 Fig. 1"}


def test_records_take_the_place_of_results(results, entries, repository, tmp_path):
    """A table, a picked JSON, and the run's own file before both."""
    tables = results.records
    assert isinstance(tables["full/accuracy/chains.csv"][0], pd.DataFrame)
    clock, path = tables["field/timing/camera_clock.json"]
    assert path.as_posix() == "docs/validation/field_clock.csv"
    entry = next(e for e in entries if e.name == "C024")
    found = results.find(entry.ours)
    assert found.value == pytest.approx(clock["sigma_offset_s"])
    assert found.file == "docs/validation/field_clock.csv"
    own = tmp_path / "clock.json"
    own.write_text(json.dumps({"sigma_offset_s": 0.007}))
    run = replace(results, files={entry.ours.name: own}, _read={})
    assert (run.find(entry.ours).value, run.find(entry.ours).file) == (0.007, own.as_posix())
    assert verdict_of(entry, run.find(entry.ours))[0] == NOT_MATCHED


# ---------------------------------------------------------------- numbers that need no run


@pytest.mark.parametrize(
    ("name", "found", "tolerance", "verdict"),
    [
        # by hand: sqrt(30^2 / 3), 3 mrad of 30 m, erf, sqrt of the printed squares
        ("C053", 17.3205, 1e-4, BY_DEFINITION),
        ("C058 footprint", 9.0, 1e-9, BY_DEFINITION),
        ("C056 two sigmas", 95.4500, 1e-4, BY_DEFINITION),
        ("C202 root 50 m", 250.01, 0.01, BY_DEFINITION),
        ("C218 root 50 m", 182.15, 0.01, BY_DEFINITION),
        ("C033 unknowns", 42, 0, BY_DEFINITION),
        ("C032 unknowns", 41, 0, BY_DEFINITION),
        ("C046 frames", 1021.02, 0.01, BY_DEFINITION),
        # identities to rounding
        ("C028", 0.0, 1e-9, REPRODUCED),
        ("C104", 0.0, 1e-12, REPRODUCED),
        ("C105", 0.0, 1e-9, REPRODUCED),
        ("C107", 0.0, 1e-12, REPRODUCED),
        ("C111", 0.0, 1e-12, REPRODUCED),
        ("C052", 0.0, 0.0, REPRODUCED),
        # misprints: 16 / 55.296 us; 0.067 deg; 229 mm / 23 ms / 50 m; 7 deg/s in 50 ns; 5.5 um 100 / 12
        ("E07", 289351.85, 0.01, REPRODUCED),
        ("E10", 1.16937, 1e-5, BY_DEFINITION),
        ("E12", 11.4093, 1e-4, BY_DEFINITION),
        ("E16", 3.0543e-4, 1e-8, BY_DEFINITION),
        ("E22", 0.0458333, 1e-6, BY_DEFINITION),
        ("E26 root", 0.30916, 1e-5, BY_DEFINITION),
        ("E01", 10.2889, 1e-4, NOT_REPRODUCIBLE),
        ("E06", 14.9896, 1e-4, NOT_REPRODUCIBLE),
        # printed totals and cells that do not say what the text says
        ("C060 theory", 2, 0, NOT_MATCHED),
        ("C314 printed", 2, 0, NOT_MATCHED),
        ("C314 angles", 4, 0, BY_DEFINITION),
        ("C310 printed", 4, 0, BY_DEFINITION),
        # stored geometry and constants
        ("C263 lever arm", 16.0, 0.01, INPUT),
        ("C009 vertical view", 30.0, 1e-9, INPUT),
        # the light sheet
        ("C070 vector form", 0.0, 1e-12, REPRODUCED),
        # (n1/n2)^2 under the root of the misprint, by hand: |v| = 1.0564 at 30 degrees
        ("C070 as printed", 1.0564, 1e-4, NOT_REPRODUCIBLE),
        ("C067 one tilt", 0, 0, REPRODUCED),
        ("C067 two tilts", 1, 0, REPRODUCED),
        # |(220.554, 2.730, -47.378)|
        ("C282", 225.602, 1e-3, NOT_MATCHED),
        # feasibility study: 51.3 and 193.3 mm from the dry face; P4 246.5, 217.8, 81.6
        ("C283 least depth", 51.3, 0.1, NOT_MATCHED),
        ("C283 largest depth", 193.3, 0.1, NOT_MATCHED),
        ("C291 depth", 246.5, 0.1, NOT_MATCHED),
        ("C291 width in x", 217.8, 0.1, NOT_MATCHED),
        ("C225 Table 1", 174.0, 0.01, INPUT),
        ("C229 shorter", 0.085, 0.0005, NOT_REPRODUCIBLE),
        ("C229 longer", 0.097, 0.0005, NOT_REPRODUCIBLE),
        ("C285 thickness", 6.2, 1e-9, BY_DEFINITION),
        ("C303 opening", 23.8, 1e-9, BY_DEFINITION),
        ("C083 15 lines", 90, 0, BY_DEFINITION),
        ("C083 6 lines", 36, 0, BY_DEFINITION),
        ("C084 joint", 7, 0, BY_DEFINITION),
        ("C237 stepped counted", 99.11, 0.01, BY_DEFINITION),
        # 4587 of 4656 are 98.5 %, printed 98: cut
        ("C243 stepped counted", 98.52, 0.01, NOT_MATCHED),
        ("C276 ratio", 10.714, 0.001, BY_DEFINITION),
        # camera z is the counter-example
        ("C320", 1, 0, NOT_MATCHED),
        # one free direction in each published set of unknowns
        ("C224 sigma of laser kappa", 1, 0, NOT_REPRODUCIBLE),
        ("C253 sigma of phi", 1, 0, NOT_REPRODUCIBLE),
        # IAPWS between 15 and 25 degrees
        ("C254 index", 0.000906, 1e-6, REPRODUCED),
        ("C076", 34.6, 0.1, BY_DEFINITION),
        # the far end of the survey was chosen for it
        ("C302 2019", 15.0, 0.1, INPUT),
        ("C302 2021", 19.0, 0.1, INPUT),
    ],
)
def test_computed_numbers(ledger, name, found, tolerance, verdict):
    (row,) = ledger[ledger["name"] == name].to_dict("records")
    assert float(row["ours"]) == pytest.approx(found, abs=tolerance)
    assert row["verdict"] == verdict


# ---------------------------------------------------------------- verdicts turn


def one_of_each(entries, ledger):
    """An entry of each source and rule that is compared, with a number."""
    known = set(ledger.loc[ledger["verdict"].isin(MET), "name"])
    seen = set()
    for entry in entries:
        key = entry.ours.source, entry.rule, entry.kind
        compared = entry.rule in ("equal", "at most", "at least", "inside", "misprint", "same word")
        if compared and entry.name in known and key not in seen:
            seen.add(key)
            yield entry


def test_each_kind_of_number_turns_when_it_changes(entries, ledger, results, pages, monkeypatch):
    """The same entry with a found number far off, on the side that its rule forbids."""
    turned = []
    for entry in one_of_each(entries, ledger):
        off = {"at most": 1e9, "at least": -1e9}.get(entry.rule, 1e9)
        found = "another word" if entry.rule == "same word" else off
        monkeypatch.setitem(
            COMPUTED, "off", lambda published, found=found, **_: Found(value=found, sigma=0.0)
        )
        other = entry.model_copy(update={"ours": Ours(computed="off")})
        assert set(whole_ledger((other,), results, pages)["verdict"]) == {NOT_MATCHED}, entry
        turned.append((entry.ours.source, entry.rule))
    assert {"computed", "setting", "file", "study"} <= {source for source, _ in turned}
    assert {"equal", "at most", "at least", "inside", "misprint", "same word"} <= {rule for _, rule in turned}


def test_files_settings_and_parts_that_change_turn_the_verdict(entries, results, pages):
    by_name = {e.name: e for e in entries}

    def verdict(name, changed):
        return str(whole_ledger((by_name[name],), changed, pages)["verdict"].iloc[0])

    assert verdict("C025 std", results) == REPRODUCED
    content, path = results.records["field/timing/clock_stability.json"]
    jumped = {**results.records, "field/timing/clock_stability.json": ({**content, "std_s": 0.030}, path)}
    assert verdict("C025 std", replace(results, records=jumped)) == NOT_MATCHED
    assert verdict("C003 roll", results) == INPUT
    full = json.loads(json.dumps(results.settings["full"]))
    full["twin"]["ins"]["sigma_roll_deg"] = 0.3
    assert verdict("C003 roll", replace(results, settings={"full": full})) == NOT_MATCHED
    assert verdict("C041", results) == THERE
    without = {**results.parts, "rule": lambda name: name != "mask_images"}
    assert verdict("C041", replace(results, parts=without)) == NOT_MATCHED
    assert (
        verdict("C136", replace(results, parts={**results.parts, "figure": lambda _: False})) == NOT_MATCHED
    )
    table, path = results.records["full/accuracy/chains.csv"]
    worse = table.assign(camera=table["camera"] * 10)
    chains = {**results.records, "full/accuracy/chains.csv": (worse, path)}
    assert verdict("C051 RMSE", results) == BELOW
    assert verdict("C051 RMSE", replace(results, records=chains)) == NOT_MATCHED
    assert verdict("C051 RMSE", replace(results, records={})) == NO_RESULT


NUMBER = re.compile(r"-?\d+(?:[ ,.]\d{3})*(?:[.,]\d+)?")
SCALES = (1.0, 1e6, 10.0, 0.1, 1e3, 1e-3)
"""Units of a value against those of its text: million, cm and mm, m and mm."""


def test_values_stand_in_their_printed_text(entries):
    """A digit that is changed in one of both is told, where the value is printed as such."""
    checked, elsewhere = 0, set()
    for entry in entries:
        printed_digits = entry.basis in ("printed digits", "sampling error") and entry.half_unit > 0
        if not printed_digits or not isinstance(entry.value, float) or entry.kind == "figure":
            continue
        texts = [t.replace(" ", "") for t in NUMBER.findall(entry.printed)]
        # a comma parts thousands or decimals
        numbers = {float(t.replace(",", "")) for t in texts}
        numbers |= {float(t.replace(",", ".")) for t in texts if t.count(",") == 1 and "." not in t}
        if any(np.isclose(entry.value, n * s, rtol=1e-12) for n in numbers for s in SCALES):
            checked += 1
        else:
            elsewhere.add(entry.name)
    # "4/3 sensor" and "10 times the size of the TLS spot" name their numbers by other ones
    assert elsewhere == {"C279 sensor x", "C279 sensor y", "C058 reference"}
    assert checked > 200


@pytest.mark.parametrize(
    ("ours", "verdict"),
    [
        (0.17, BY_DEFINITION),
        (0.1749, BY_DEFINITION),
        (0.18, NOT_MATCHED),
        (0.25, NOT_MATCHED),
        (0.16, NOT_MATCHED),
    ],
)
def test_a_misprint_is_confirmed_by_the_number_decided_on_alone(entries, ours, verdict):
    entry = next(e for e in entries if e.name == "E26")
    assert (entry.value, entry.decided) == (0.18, 0.17)
    assert verdict_of(entry, Found(value=ours))[0] == verdict


BAD = """
thalweg_ledger: 1
sections:
- title: "E"
  entries:
  - {rows: [E26], where: P4 6.6, quantity: largest, printed: "0.18", value: 0.18, unit: mm, half_unit: 0.005,
     decided: 0.17, kind: exact, rule: misprint, basis: printed digits, why: sections count,
     ours: {file: basin/a.csv, column: b}}
  - {rows: [FW01], where: P1 2.3, quantity: idea, printed: words, kind: procedure only, rule: open,
     why: not done, ours: {none: not done}}
  - {rows: [C041], where: P2 6.1, quantity: masks, printed: words, kind: procedure only, rule: present,
     why: a part, ours: {rule: mask_images}}
"""


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("decided: 0.17, ", "", "decided, of misprints alone"),
        ("rule: misprint", "rule: equal", "decided, of misprints alone"),
        ("[FW01]", "[C301]", "open for future work"),
        ("rule: open", "rule: waived", ""),
        ("ours: {none: not done}", "ours: {rule: mask_images}", "none, with a reason"),
        ("rule: present", "rule: equal, value: 1, basis: goal", "present: a rule is there or not"),
        ("[C041]", "[X41]", "X41"),
        ("kind: exact", "kind: exact, put_in: setting", "found 'setting' for the kind 'exact'"),
        ("basis: printed digits", "basis: direction", "found direction for the rule 'misprint'"),
    ],
)
def test_mistakes_in_a_ledger_are_told(tmp_path, old, new, told):
    assert old in BAD
    path = tmp_path / "bad.yaml"
    path.write_text(BAD.replace(old, new))
    if not told:
        assert len(read_ledger(path)) == 3
        return
    with pytest.raises(ConfigError, match=re.escape(told)):
        read_ledger(path)


def test_two_files_must_not_have_one_name(tmp_path):
    for name in ("a", "b"):
        (tmp_path / f"{name}.yaml").write_text(BAD)
    with pytest.raises(ConfigError, match="'E26' stands twice"):
        read_ledgers(tmp_path)


# ---------------------------------------------------------------- page


def written(ledger, folder):
    """The page from the file, as anybody may make it."""
    ledger.to_csv(folder / "ledger.csv", index=False)
    write_ledger(pd.read_csv(folder / "ledger.csv"), headlines(ledger, NAMED), folder / "ledger.html")
    return (folder / "ledger.html").read_text()


def test_the_page_opens_with_what_could_fail_and_the_headlines(ledger, tmp_path):
    html = written(ledger, tmp_path)
    at = [html.index(f'id="{part}"') for part in ("headlines", "counts", "not-matched", "reproduced")]
    assert at == sorted(at)
    assert html.index("could have failed by a number") < at[0]
    for item in ITEMS:
        assert re.search(rf"\b{item}\b", html), item
    assert ">nan<" not in html
    # a number that turns goes to the misses
    worse = ledger.assign(verdict=ledger["verdict"].where(ledger["name"] != "C053", NOT_MATCHED))
    html = written(worse, tmp_path)
    assert "C053" in html[html.index('id="not-matched"') : html.index('id="reproduced"')]


def test_headlines_show_both_sides_of_a_result(ledger, repository):
    """The RMSE of all points stands beside the one without outliers, which is a bound that is met."""
    shown = headlines(ledger, NAMED)
    assert 20 <= len(shown) <= 35
    by_name = shown.set_index(NAMED["entry"])
    chains = pd.read_csv(repository / "docs/validation/full_chains.csv").set_index(["of", "quantity"])
    rmse_cm = 100 * chains["camera"].xs("rmse", level="quantity")
    share = f"{100 * rmse_cm['without outliers'] / 14:.3g} %"
    assert by_name.loc["C051 RMSE", "verdict"] == f"below a bound: {share} of it"
    assert by_name.loc["C051 all points", "verdict"] == f"not matched: off by +{rmse_cm['all'] - 14:.0f} cm"
    assert by_name.loc["C051 all points", ["printed", "ours"]].tolist() == [
        "14 cm",
        f"{rmse_cm['all']:.4g} cm",
    ]
    assert by_name["why"].str.len().min() > 10
    with pytest.raises(ConfigError, match="no entry C999"):
        headlines(ledger, NAMED.assign(entry="C999"))


@pytest.mark.parametrize(
    ("ours", "sigma", "verdict"),
    [(-0.5, 0.2, REPRODUCED), (-0.5, 0.3, NOT_MATCHED), (0.5, 0.2, NOT_MATCHED), (-0.5, np.nan, REPRODUCED)],
)
def test_a_direction_counts_beyond_two_sigmas(entries, ours, sigma, verdict):
    entry = next(e for e in entries if e.name == "C312 narrow beam")
    assert (entry.rule, entry.value, entry.basis) == ("at most", 0.0, "direction")
    assert verdict_of(entry, Found(value=ours, sigma=sigma))[0] == verdict
    # a bound that is printed as a number is no direction
    bound = entry.model_copy(update={"basis": "goal"})
    assert verdict_of(bound, Found(value=-0.5, sigma=sigma))[0] == BELOW


def test_a_record_takes_the_place_of_a_study_that_was_not_made(repository, tmp_path):
    files = records(repository)
    assert not [path.name for path in files if path.name.startswith("ledger_")]
    found = recorded(files)
    content, path = found["multi_line_models.csv"]
    assert path.as_posix() == "docs/validation/multi_line_models.csv"
    assert content.equals(pd.read_csv(repository / path))
    (tmp_path / "waves.csv").write_text("key,value\nheight,0.25\n")
    (tmp_path / "study.yaml").write_text(
        "tables:\n  waves: {file: results/full/waves.json, pick: {height: of.1.height_m}}\n"
        "  absent: {file: results/reproduction/absent.csv}\n"
    )
    picked = recorded([tmp_path / "waves.csv", tmp_path / "study.yaml"])
    assert [*picked] == ["full/waves.json"]
    assert picked["full/waves.json"][0] == {"of": {1: {"height_m": 0.25}}}
