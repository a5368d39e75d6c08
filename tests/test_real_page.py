"""The page of real recordings: what becomes of each row's tests stands there, and it follows its record."""

import re
import runpy
from typing import Any

import pytest
import yaml

TESTS = """
import pytest
def test_good(record_property):
    record_property("rms_m", -0.25)
    record_property("n", 29)
@pytest.mark.parametrize("k", [1, 2])
def test_each(k):
    assert k < 2, "two is | too many"
def test_away():
    pytest.skip("{folder}/boat/log.bin is not there")
"""


@pytest.fixture(scope="module")
def made(repository):
    return runpy.run_path(str(repository / "docs/make_real.py"))


def row(name: str, *tests: str) -> dict[str, Any]:
    found = "{n} lines, {rms_m:.2f} m, left-out ones" if name == "good" else "the same"
    return {"cells": [name, "somebody"], "found": found, "tests": [f"test_a.py::{t}" for t in tests]}


def test_what_becomes_of_rows(made, tmp_path, monkeypatch):
    """Numbers that tests hand over, the reason of a failure, of a skip, and a row that never ran."""
    monkeypatch.setenv("THALWEG_DATA", str(tmp_path / "data"))
    (tmp_path / "test_a.py").write_text(TESTS.replace("{folder}", str(tmp_path / "data")))
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    rows = [
        row("good", "test_good"),
        row("bad", "test_good", "test_each"),
        row("away", "test_away"),
        row("one", "test_each[1]"),
        row("never", "test_none"),
    ]
    columns = ["recording", "expected"]
    plan = {"head": "", "tail": "", "sections": [{"title": "All", "columns": columns, "rows": rows}]}
    tests = ["test_a.py::test_good", "test_a.py::test_each", "test_a.py::test_away"]
    record = made["run_tests"](tests, 1, tmp_path)
    assert sorted(record) == sorted(
        f"test_a.py::{t}" for t in ("test_away", "test_each[1]", "test_each[2]", "test_good")
    )
    text = made["page"](plan, record)
    cells = {
        line.split(" | ")[0].removeprefix("| "): line.split(" | ")[2]
        for line in text.splitlines()
        if " | " in line
    }
    assert cells["good"] == "29 lines, −0.25 m, left-out ones"
    assert cells["bad"].startswith("**fails**: AssertionError: two is / too many")
    assert cells["away"] == "**not run**: boat/log.bin is not there"
    assert cells["one"] == "the same"
    assert cells["never"] == "**not run yet**"
    assert "2 of 5 rows hold" in text
    once = {name: {} for name in ("test_a.py::test_each[3]", "test_b.py::test_other[1]")}
    assert [*made["renewed"](once, record)] == ["test_b.py::test_other[1]", *record]
    with pytest.raises(SystemExit, match="nothing is recorded"):
        made["run_tests"](["test_a.py::test_none"], 1, tmp_path)
    assert [each["cells"][0] for each in made["rows_of"](plan, "AWAY")] == ["away"]


def test_the_page_follows_its_rows_and_their_record(made, repository):
    folder = repository / "docs/validation"
    plan = yaml.safe_load((folder / "real.yaml").read_text(encoding="utf-8"))
    written = made["page"](plan, made["read_record"](folder / "real.csv"))
    assert (folder / "real.md").read_text(encoding="utf-8") == written, "run docs/make_real.py --page"
    named = {test.split("[")[0] for each in made["rows_of"](plan) for test in each["tests"]}
    assert len(named) > 60
    texts = {file: (repository / file).read_text() for file in {name.split("::")[0] for name in named}}
    lost = [
        name for name in named if not re.search(rf"def {name.split('::')[1]}\(", texts[name.split("::")[0]])
    ]
    assert lost == []
