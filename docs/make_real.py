"""Run the rows of docs/validation/real.yaml on recordings of other people, and write docs/validation/real.md.

.venv/bin/python docs/make_real.py                  # every row: an hour of one processor
.venv/bin/python docs/make_real.py --only river     # rows in whose words or tests this occurs
.venv/bin/python docs/make_real.py --page           # the page of what is recorded

Each row is held by tests. What became of each test, its numbers, date and commit stand in real.csv beside the
page, so that a row that is not run again keeps what it had.
"""

import argparse
import csv
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs/validation"
COLUMNS = ("test", "outcome", "why", "seconds", "date", "commit", "numbers")
Record = dict[str, dict[str, str]]
"""Rows of real.csv by the name of the test."""


def rows_of(plan: Mapping[str, Any], only: str = "") -> Iterator[Mapping[str, Any]]:
    """Rows in whose words or tests a text occurs; all without it."""
    for row in (row for section in plan["sections"] for row in section["rows"]):
        if only.lower() in " ".join([*row["cells"], *row["tests"]]).lower():
            yield row


def run_tests(tests: Sequence[str], workers: int, root: Path = ROOT) -> Record:
    """What becomes of the tests, those of a name with parameters one by one."""
    how = ["-n", str(workers), "--dist", "loadgroup"] if workers > 1 else []
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        words = [*how, "-q", "-o", "junit_family=xunit1", f"--junitxml={report}", *tests]
        run = subprocess.run([sys.executable, "-m", "pytest", *words], cwd=root, check=False)
        if run.returncode not in (0, 1):
            raise SystemExit(f"pytest ended with {run.returncode}: see above; nothing is recorded")
        described = ["git", "-C", str(root), "describe", "--always", "--dirty"]
        commit = subprocess.run(described, capture_output=True, text=True, check=False).stdout.strip()
        return outcomes(ElementTree.parse(report), f"{datetime.now(UTC):%Y-%m-%d}", commit)


def outcomes(report: ElementTree.ElementTree, date: str, commit: str) -> Record:
    """Tests of a report of pytest."""
    found = {}
    for case in report.iter("testcase"):
        name = f"{case.get('file')}::{case.get('name')}"
        trouble = next((each for each in case if each.tag in ("failure", "error", "skipped")), None)
        numbers = {p.get("name"): float(f"{float(p.get('value')):.9g}") for p in case.iter("property")}
        found[name] = {
            "test": name,
            "outcome": "passed" if trouble is None else "skipped" if trouble.tag == "skipped" else "failed",
            "why": "" if trouble is None else without_places(trouble.get("message", "")),
            "seconds": f"{float(case.get('time', 0)):.1f}",
            "date": date,
            "commit": commit,
            "numbers": json.dumps(numbers),
        }
    return found


def without_places(message: str) -> str:
    """The first line of what a test says, its paths from the recordings on: no machine is named."""
    text = message.splitlines()[0].replace(f"{os.environ.get('THALWEG_DATA', '')}/", "")
    return re.sub(r"(?<![\w.])/(?:[\w.+-]+/)+", "", text)


def of_row(row: Mapping[str, Any], record: Record) -> list[dict[str, str]]:
    """Records of a row's tests; a test that has none is as one that was never run."""
    missing = {"outcome": "skipped", "why": "not run yet", "numbers": "{}"}
    every = []
    for test in row["tests"]:
        own = [each for name, each in record.items() if test in (name, name.split("[")[0])]
        every += own or [missing]
    return every


def found_of(row: Mapping[str, Any], record: Record) -> str:
    """What a row found, in words; in bold if a test of it failed or did not run."""
    every = of_row(row, record)
    for outcome, words in (("failed", "fails"), ("skipped", "not run")):
        if bad := next((each for each in every if each["outcome"] == outcome), None):
            return f"**{words}**: {bad['why']}" if bad["why"] != "not run yet" else "**not run yet**"
    numbers = {k: v for each in every for k, v in json.loads(each["numbers"]).items()}
    numbers = {k: int(v) if v == int(v) else v for k, v in numbers.items()}
    return re.sub(r"(?<!\w)-(?=\d)", "−", row["found"].format(**numbers))


def page(plan: Mapping[str, Any], record: Record) -> str:
    """The whole page."""
    rows = list(rows_of(plan))
    good = sum(all(each["outcome"] == "passed" for each in of_row(row, record)) for row in rows)
    ran = [each for row in rows for each in of_row(row, record) if "date" in each]
    dates, commits = (sorted({each[key] for each in ran}) for key in ("date", "commit"))
    state = f"{good} of {len(rows)} rows hold, {len(ran)} tests"
    if ran:
        state += f" ({' to '.join(dict.fromkeys((dates[0], dates[-1])))}, commit {', '.join(commits)})"
    parts = [
        "# What was checked on real recordings\n",
        plan["head"],
        f"Written by `make real`: {state}. One row: `make real ONLY=river`.\n",
    ]
    for section in plan["sections"]:
        heads = [*section["columns"], "found", "test"]
        parts += [f"## {section['title']}\n", *([section["intro"]] if "intro" in section else [])]
        parts += [f"| {' | '.join(heads)} |\n|{' --- |' * len(heads)}"]
        for row in section["rows"]:
            cells = [*row["cells"], found_of(row, record), files_of(row["tests"])]
            parts[-1] += f"\n| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
        parts[-1] += "\n"
        parts += [section["notes"]] if "notes" in section else []
    return "\n".join([*parts, plan["tail"]])


def files_of(tests: Iterable[str]) -> str:
    """Files of tests, each once."""
    return ", ".join(f"`{name}`" for name in dict.fromkeys(test.split("::")[0] for test in tests))


def read_record(path: Path) -> Record:
    """What is recorded, if anything is."""
    if not path.is_file():
        return {}
    with path.open(newline="", encoding="utf-8") as stream:
        return {row["test"]: row for row in csv.DictReader(stream)}


def renewed(record: Record, found: Record) -> Record:
    """The record with the tests that ran; gone are other parameters that such a test had before."""
    again = {name.split("[")[0] for name in found}
    return {name: row for name, row in record.items() if name.split("[")[0] not in again} | found


def main() -> None:
    """Run, record, write."""
    parser = argparse.ArgumentParser(description="Run rows of docs/validation/real.yaml; write real.md.")
    parser.add_argument("--only", default="", help="rows in whose words or tests this occurs")
    parser.add_argument("--page", action="store_true", help="run nothing")
    parser.add_argument("--workers", type=int, default=1, help="tests at the same time")
    options = parser.parse_args()
    plan = yaml.safe_load((FOLDER / "real.yaml").read_text(encoding="utf-8"))
    record = read_record(FOLDER / "real.csv")
    if not options.page:
        tests = list(dict.fromkeys(test for row in rows_of(plan, options.only) for test in row["tests"]))
        if not tests:
            raise SystemExit(f"no row of docs/validation/real.yaml holds {options.only!r}")
        record = renewed(record, run_tests(tests, options.workers))
    wanted = {test for row in rows_of(plan) for test in row["tests"]}
    kept = [record[name] for name in sorted(record) if {name, name.split("[")[0]} & wanted]
    with (FOLDER / "real.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(kept)
    (FOLDER / "real.md").write_text(page(plan, record), encoding="utf-8")


if __name__ == "__main__":
    main()
