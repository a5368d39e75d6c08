"""The ledger of all published items: every one stands in it, its verdict follows from what it points to."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from thalweg.budgets import long_table, read_budget
from thalweg.core import ConfigError
from thalweg.settings import load_campaign
from thalweg_lab.figures import write_ledger
from thalweg_lab.reproduction import (
    ITEMS,
    NOT_MATCHED,
    SIX,
    Results,
    ledger_counts,
    missing_items,
    parts_of,
    read_ledger,
    read_ledgers,
    read_pages,
    recorded,
    whole_ledger,
)
from thalweg_lab.reproduction.files import NAMES, Entry
from thalweg_lab.reproduction.ledger import FOUND, MISSED, Found, verdict_of
from thalweg_lab.reproduction.verdicts import COMPUTED, INPUT, MATCHED, NOT_REPRODUCIBLE, page_of

MOST_WAIVED = 30


@pytest.fixture(scope="module")
def entries(repository: Path) -> tuple[Entry, ...]:
    return read_ledgers(repository / "resources/published")


@pytest.fixture(scope="module")
def pages(repository: Path) -> dict[str, int]:
    return read_pages(repository / "resources/thesis_pages.yaml")


@pytest.fixture(scope="module")
def parts(repository: Path) -> dict[str, Any]:
    """Rules as docs/rules.md lists them, which another test keeps in step with the workflow."""
    rules = re.findall(r"^\| `(\w+)` \|", (repository / "docs/rules.md").read_text(), re.MULTILINE)
    return parts_of(rules, figures_of(repository))


def figures_of(repository: Path) -> dict[str, dict[str, Any]]:
    table = yaml.safe_load((repository / "workflow/figures.yaml").read_text())
    return {name: row for rows in table.values() for name, row in rows.items()}


@pytest.fixture(scope="module")
def results(entries, parts, repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Results:
    """What a fresh clone has: records, settings, computed numbers, and the tables of budgets."""
    folder = tmp_path_factory.mktemp("budgets")
    studies = {}
    for name in ("p2_table1", "t_table3_1", "p1_direct"):
        studies[f"budgets/{name}.csv"] = folder / f"{name}.csv"
        budget = read_budget(repository / f"resources/budgets/{name}.yaml")
        long_table(budget, None).to_csv(folder / f"{name}.csv", index=False)
    settings = {
        name: load_campaign(repository / f"config/campaigns/{name}.yaml").model_dump(mode="json")
        for name in ("full", "field", "mulde", "reach", "basin")
    }
    return Results(files={}, studies=studies, settings=settings, records=recorded(repository), parts=parts)


@pytest.fixture(scope="module")
def ledger(entries, results, pages) -> pd.DataFrame:
    return whole_ledger(entries, results, pages)


# ---------------------------------------------------------------- all items


def test_every_item_stands_in_the_ledger(entries, ledger) -> None:
    assert missing_items(entries) == []
    assert len(ITEMS) == 328 + 30 + 39
    assert set(ledger["id"]) == set(ITEMS)
    without = tuple(e for e in entries if "C138" not in e.rows)
    assert missing_items(without) == ["C138"]


def test_every_row_has_one_of_six_verdicts_and_a_reason(ledger) -> None:
    assert set(ledger["verdict"]) == set(SIX)
    for row in ledger.to_dict("records"):
        assert row["reason"], row
        assert re.search(r"\(p\. \d+\)$", row["source"]), row
    assert ledger[ledger["verdict"] == "open"]["id"].str.startswith("FW").all()
    assert (ledger["verdict"] == "waived").sum() <= MOST_WAIVED
    # misses first, then by item
    assert ledger["verdict"].map(SIX.index).is_monotonic_increasing
    for _, part in ledger.groupby("verdict"):
        assert part["id"].map(ITEMS.index).is_monotonic_increasing


def test_exact_numbers_that_are_missed_are_explained(ledger, entries) -> None:
    missed = ledger[(ledger["class"] == "A") & (ledger["verdict"] == NOT_MATCHED)]
    assert len(missed)
    for row in missed.to_dict("records"):
        (entry,) = (e for e in entries if row["id"] in e.rows and e.part == row["part"])
        assert entry.note, row
        assert entry.note.rstrip(".") in row["reason"]


def test_counts_add_up(ledger) -> None:
    counts = ledger_counts(ledger).set_index("class")
    assert counts.loc["all", "all"] == len(ledger)
    assert counts.drop(index="all")["all"].sum() == len(ledger)
    for verdict in SIX:
        assert counts.loc["all", verdict] == (ledger["verdict"] == verdict).sum()


def test_no_entry_of_the_tables_is_typed_twice(entries) -> None:
    """Cells come from the CSV of the budget: 17 rows and 16 rows at four distances."""
    assert sum(e.ours.name == "budgets/p2_table1.csv" and "influence" in e.quantity for e in entries) == 68
    assert sum(e.ours.name == "budgets/t_table3_1.csv" for e in entries) == 64


# ---------------------------------------------------------------- what entries point to


def test_rules_functions_and_figures_exist(entries, parts) -> None:
    named = [e for e in entries if e.ours.source in NAMES]
    assert {e.ours.source for e in named} == set(NAMES)
    for entry in named:
        for name in entry.ours.name.split(", "):
            assert parts[entry.ours.source](name), f"{entry.name}: no {entry.ours.source} {name}"
    for wrong in ({"rule": "georeference"}, {"function": "thalweg.lidar:gone"}, {"figure": "cloud"}):
        ((kind, name),) = wrong.items()
        assert not parts[kind](name)


def printed_figures(shows: str) -> set[str]:
    """``P3 Fig. 4`` and so on, of ``(P3 Fig. 4 and 7, P4 Fig. 9 to 11, Fig. 16b)``."""
    found: set[str] = set()
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


def test_each_figure_shows_what_its_row_says(entries, repository: Path) -> None:
    """A picture names the printed figure that it shows, or its entry is a sketch of the same thing."""
    assert printed_figures("x (P3 Fig. 4 and 7, P4 Fig. 9 to 11, T Fig. 3.3b)") == {
        *(f"P3 Fig. {i}" for i in (4, 7)),
        *(f"P4 Fig. {i}" for i in (9, 10, 11)),
        "T Fig. 3.3",
    }
    shows = {name: row["shows"] for name, row in figures_of(repository).items()}
    drawn = [e for e in entries if e.kind == "figure" and e.rule == "present"]
    assert len(drawn) > 50
    unnamed = {
        e.where
        for e in drawn
        if not any(e.where in printed_figures(shows[name]) for name in e.ours.name.split(", "))
    }
    # the sketch of a zigzag
    assert unnamed == {"P2 Fig. 1"}


def test_pages(pages) -> None:
    assert pages["P2 Fig. 15"] == 30
    assert page_of("P2 6.1.2, eq. 6", pages) == 27
    assert page_of("P3 Table 1", pages) == 40
    assert page_of("T 4.1, Figs. 4.1 and 4.2", pages) == 64
    assert page_of("P4 Fig. 20 d", pages) == 58
    with pytest.raises(ConfigError, match="no page of 'P9 1'"):
        page_of("P9 1", pages)


def test_records_take_the_place_of_results(results, entries, repository: Path, tmp_path: Path) -> None:
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
    assert verdict_of(entry, run.find(entry.ours))[0] == MISSED


def test_names_of_campaigns_are_put_before_paths_once(repository: Path, entries) -> None:
    alone = {e.name: e.ours for e in read_ledger(repository / "resources/published/light_sheet.yaml")}
    for entry in entries:
        if entry.name in alone and entry.ours.source == "file":
            assert entry.ours.name == f"basin/{alone[entry.name].name}"
    assert {e.ours.name.split("/")[0] for e in entries if e.ours.source == "file"} <= {
        *("basin", "full", "field", "sajo_change")
    }


# ---------------------------------------------------------------- numbers that need no run


@pytest.mark.parametrize(
    ("item", "part", "found", "tolerance", "verdict"),
    [
        # by hand: sqrt(30^2 / 3), 3 mrad of 30 m, erf, sqrt of the printed squares
        ("C053", "", 17.3205, 1e-4, MATCHED),
        ("C058", "footprint", 9.0, 1e-9, MATCHED),
        ("C056", "two sigmas", 95.4500, 1e-4, MATCHED),
        ("C202", "root 50 m", 250.01, 0.01, MATCHED),
        ("C218", "root 50 m", 182.15, 0.01, MATCHED),
        ("C033", "unknowns", 42, 0, MATCHED),
        ("C032", "unknowns", 41, 0, MATCHED),
        ("C046", "frames", 1021.02, 0.01, MATCHED),
        # identities to rounding
        ("C028", "", 0.0, 1e-9, MATCHED),
        ("C104", "", 0.0, 1e-12, MATCHED),
        ("C105", "", 0.0, 1e-9, MATCHED),
        ("C107", "", 0.0, 1e-12, MATCHED),
        ("C111", "", 0.0, 1e-12, MATCHED),
        ("C116", "", 0.0, 0.0, MATCHED),
        # misprints: 16 / 55.296 us; 0.067 deg; 229 mm / 23 ms / 50 m; 7 deg/s in 50 ns; 5.5 um 100 / 12
        ("E07", "", 289351.85, 0.01, MATCHED),
        ("E10", "", 1.16937, 1e-5, MATCHED),
        ("E12", "", 11.4093, 1e-4, MATCHED),
        ("E16", "", 3.0543e-4, 1e-8, MATCHED),
        ("E22", "", 0.0458333, 1e-6, MATCHED),
        ("E26", "root", 0.30916, 1e-5, MATCHED),
        ("E01", "", 10.2889, 1e-4, NOT_REPRODUCIBLE),
        ("E06", "", 14.9896, 1e-4, NOT_REPRODUCIBLE),
        # printed totals and cells that do not say what the text says
        ("C060", "theory", 2, 0, NOT_MATCHED),
        ("C314", "printed", 2, 0, NOT_MATCHED),
        ("C314", "angles", 4, 0, MATCHED),
        ("C310", "printed", 4, 0, MATCHED),
        # stored geometry and constants
        ("C263", "lever arm", 16.0, 0.01, INPUT),
        ("C009", "vertical view", 30.0, 1e-9, INPUT),
    ],
)
def test_computed_numbers(ledger, item: str, part: str, found: float, tolerance: float, verdict: str) -> None:
    (row,) = ledger[(ledger["id"] == item) & (ledger["part"] == part)].to_dict("records")
    assert float(row["found"]) == pytest.approx(found, abs=tolerance)
    assert row["verdict"] == verdict


# ---------------------------------------------------------------- verdicts turn


def one_of_each(entries: tuple[Entry, ...], ledger: pd.DataFrame) -> Iterator[Entry]:
    """An entry of each source and rule that is compared, with a number."""
    good = ledger[ledger["verdict"].isin([MATCHED, INPUT])]
    known = set(zip(good["id"], good["part"], strict=True))
    seen = set()
    for entry in entries:
        key = entry.ours.source, entry.rule, entry.kind
        compared = entry.rule in ("equal", "at most", "at least", "inside", "misprint", "same word")
        if compared and (entry.rows[0], entry.part) in known and key not in seen:
            seen.add(key)
            yield entry


def test_each_kind_of_number_turns_when_it_changes(
    entries, ledger, results, pages, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same entry with a found number far off, on the side that its rule forbids."""
    turned = []
    for entry in one_of_each(entries, ledger):
        off = {"at most": 1e9, "at least": -1e9}.get(entry.rule, 1e9)
        found: Any = "another word" if entry.rule == "same word" else off
        monkeypatch.setitem(
            COMPUTED, "off", lambda published, found=found, **_: Found(value=found, sigma=0.0)
        )
        other = replace(entry, ours=replace(entry.ours, source="computed", name="off"))
        assert set(whole_ledger((other,), results, pages)["verdict"]) == {NOT_MATCHED}, entry
        turned.append((entry.ours.source, entry.rule))
    assert {"computed", "setting", "file", "study"} <= {source for source, _ in turned}
    assert {"equal", "at most", "at least", "inside", "misprint", "same word"} <= {rule for _, rule in turned}


def test_files_settings_and_parts_that_change_turn_the_verdict(entries, results, pages) -> None:
    by_name = {e.name: e for e in entries}

    def verdict(name: str, changed: Results) -> str:
        return str(whole_ledger((by_name[name],), changed, pages)["verdict"].iloc[0])

    assert verdict("C025 std", results) == MATCHED
    content, path = results.records["field/timing/clock_stability.json"]
    jumped = {**results.records, "field/timing/clock_stability.json": ({**content, "std_s": 0.030}, path)}
    assert verdict("C025 std", replace(results, records=jumped)) == NOT_MATCHED
    assert verdict("C003 roll", results) == INPUT
    full = json.loads(json.dumps(results.settings["full"]))
    full["twin"]["ins"]["sigma_roll_deg"] = 0.3
    assert verdict("C003 roll", replace(results, settings={"full": full})) == NOT_MATCHED
    assert verdict("C041", results) == MATCHED
    without = {**results.parts, "rule": lambda name: name != "mask_images"}
    assert verdict("C041", replace(results, parts=without)) == NOT_MATCHED
    assert (
        verdict("C136", replace(results, parts={**results.parts, "figure": lambda _: False})) == NOT_MATCHED
    )
    table, path = results.records["full/accuracy/chains.csv"]
    worse = table.assign(camera=table["camera"] * 10)
    chains = {**results.records, "full/accuracy/chains.csv": (worse, path)}
    assert verdict("C051 RMSE", results) == MATCHED
    assert verdict("C051 RMSE", replace(results, records=chains)) == NOT_MATCHED
    assert verdict("C051 RMSE", replace(results, records={})) == NOT_REPRODUCIBLE


def test_a_printed_digit_that_changes_is_told(entries, ledger, results) -> None:
    """Every number that is compared to its last digit: one more or less in it, and the verdict turns."""
    good = ledger[ledger["verdict"].isin([MATCHED, INPUT])].drop_duplicates(["id", "part"])
    found = {(row["id"], row["part"]): row for row in good.to_dict("records")}
    told = 0
    for entry in entries:
        row = found.get((entry.rows[0], entry.part))
        exact = entry.rule == "equal" and entry.basis == "printed digits" and not entry.tolerance
        if row is None or not exact or not isinstance(entry.value, float):
            continue
        step = 2.0 * entry.half_unit or 1.0
        for other in (entry.value + step, entry.value - step):
            ours = Found(value=float(row["found"]))
            # exactly half a unit off, a number rounds both ways
            on_border = np.isclose(abs(ours.value - other), entry.half_unit)
            assert on_border or verdict_of(replace(entry, value=other), ours)[0] == MISSED, entry
            told += not on_border
    assert told > 60


NUMBER = re.compile(r"-?\d+(?:[ ,.]\d{3})*(?:[.,]\d+)?")
SCALES = (1.0, 1e6, 10.0, 0.1, 1e3, 1e-3)
"""Units of a value against those of its text: million, cm and mm, m and mm."""


def test_values_stand_in_their_printed_text(entries) -> None:
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
    ("ours", "verdict"), [(0.17, FOUND), (0.1749, FOUND), (0.18, MISSED), (0.25, MISSED), (0.16, MISSED)]
)
def test_a_misprint_is_confirmed_by_the_number_decided_on_alone(entries, ours: float, verdict: str) -> None:
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
    ],
)
def test_mistakes_in_a_ledger_are_told(tmp_path: Path, old: str, new: str, told: str) -> None:
    assert old in BAD
    path = tmp_path / "bad.yaml"
    path.write_text(BAD.replace(old, new))
    if not told:
        assert len(read_ledger(path)) == 3
        return
    with pytest.raises(ConfigError, match=re.escape(told)):
        read_ledger(path)


def test_two_files_must_not_have_one_name(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.yaml").write_text(BAD)
    with pytest.raises(ConfigError, match="'E26' stands twice"):
        read_ledgers(tmp_path)


# ---------------------------------------------------------------- page


def test_the_page_opens_with_the_misses_and_holds_all_items(ledger, tmp_path: Path) -> None:
    path = tmp_path / "ledger.html"
    ledger.to_csv(tmp_path / "ledger.csv", index=False)
    write_ledger(pd.read_csv(tmp_path / "ledger.csv"), path)
    html = path.read_text()
    assert html.index('id="not-matched"') < html.index('id="counts"') < html.index('id="matched-t"')
    missed = html[html.index('id="not-matched"') : html.index('id="counts"')]
    for row in ledger[ledger["verdict"] == NOT_MATCHED].to_dict("records"):
        assert row["id"] in missed, row
    for item in ITEMS:
        assert re.search(rf"\b{item}\b", html), item
    assert ">nan<" not in html
    # an item whose verdict turns goes to the top
    worse = ledger.assign(verdict=ledger["verdict"].where(ledger["id"] != "C053", NOT_MATCHED))
    write_ledger(worse, path)
    html = path.read_text()
    assert "C053" in html[html.index('id="not-matched"') : html.index('id="counts"')]
