"""Make every record of docs/validation again with the code that is here, and say what changed.

.venv/bin/python docs/release_check.py --cores 2                 # all; again: goes on where it stopped
.venv/bin/python docs/release_check.py --only ins_lidar_study    # one
.venv/bin/python docs/release_check.py --profile profiles/slurm  # further words are Snakemake's

Short records come first, those with ledgers, which read the others, last. A record whose code has not
changed since is left as it is, with its line of the table. So is a study of older code whose first job (of
each kind of survey) finds the numbers that it found before (docs/validation/first_surveys), and its page says
so: most changes of code touch no number of a study. One that fails is told, and the next one begins. The
table (docs/validation/release.md, written after each record) has a line for each: date, commit, minutes of
the processor, verdicts (rows that reach their goal or lie inside their band), and how many printed numbers
are others than before.
"""

import argparse
import datetime
import runpy
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

ROOT = Path(__file__).parents[1]
MADE: Final = "made again"
SAME: Final = "first survey as before"
validation = runpy.run_path(str(ROOT / "docs/make_validation.py"))
numbers = runpy.run_path(str(ROOT / "tests/golden/kept_numbers.py"))

OTHERS: Final = {
    "timings": ["docs/make_timings.py", "tiny", "demo"],
    "mulde_quarter": ["docs/make_timings.py", "mulde_quarter"],
    "real": ["docs/make_real.py", "--workers", "2"],
    "mutants": ["tests/mutants/run.py", "--count", "150", "--minutes", "70"],  # 95 % of draws within 7 %
    "benchmarks": ["-m", "pytest", "tests/benchmarks", "-m", "slow", "-s"],
}
"""Records that no file of config/studies describes: words for Python."""
VERDICTS: Final = ("met", "consistent", "inside", "right")
"""Columns of tables that say whether a row reaches its goal, or lies inside its band."""


def order(studies: Mapping[str, Mapping[str, Any]], root: Path = ROOT) -> list[str]:
    """Names of records, the shortest first; at the end the two with ledgers, which read the others."""

    def minutes(name: str) -> float:
        page = root / f"docs/validation/{name}.md"
        taken = validation["front_matter"](page)["cpu_min"] if page.exists() else None
        return float(taken) if isinstance(taken, int | float) else 0.0

    return sorted(studies, key=lambda name: (name == "ledger", name == "basin", minutes(name), name))


def words(name: str, entry: Mapping[str, Any]) -> list[str]:
    """Targets and settings of Snakemake that make a record's results."""
    if "campaign" not in entry:
        return [name, *entry.get("pictures", {}).values()]
    targets = ["all", "reproduce"] if name == "ledger" else ["all"]
    return [*targets, "--config", f"campaign=[{','.join(entry['campaign'])}]"]


def verdict(tables: Mapping[str, pd.DataFrame]) -> str:
    """How many rows with a verdict hold, over all tables; empty if none has one."""
    found = [table[c].astype(bool) for table in tables.values() for c in VERDICTS if c in table]
    return f"{sum(int(each.sum()) for each in found)} of {sum(map(len, found))}" if found else ""


def changed_digits(before: Mapping[str, pd.DataFrame], after: Mapping[str, pd.DataFrame]) -> str:
    """How many printed numbers are others, or that a table has other rows."""
    changed, n = 0, 0
    for name, table in after.items():
        old = before.get(name)
        if old is None or old.shape != table.shape or list(old) != list(table):
            return f"{name}.csv has other rows or columns"
        texts = [
            frame.map(lambda v: f"{v:.4g}" if isinstance(v, float) else str(v)) for frame in (old, table)
        ]
        changed += int((texts[0] != texts[1]).to_numpy().sum())
        n += table.size
    return f"{changed} of {n}"


def tables(name: str, entry: Mapping[str, Any], root: Path = ROOT) -> dict[str, pd.DataFrame]:
    """Recorded tables, as far as they are there."""
    paths = [root / f"docs/validation/{table}.csv" for table in entry["tables"]]
    return {path.stem: pd.read_csv(path) for path in paths if path.is_file()}


def first_numbers(name: str, jobs: Sequence[str], root: Path = ROOT) -> pd.DataFrame:
    """Count, mean and standard deviation of each column that some jobs of a study found."""
    folder = root / f"results/reproduction/{name}"
    files = [path.relative_to(folder).as_posix() for job in jobs for path in (folder / job).glob("*.parquet")]
    return numbers["numbers_of"](folder, files)


def check(name: str, entry: Mapping[str, Any], snakemake: Sequence[str], root: Path = ROOT) -> dict[str, Any]:
    """Make one record again if its code has changed, and its first survey with it: its line of the table."""
    page, kept = (root / f"docs/validation/{each}" for each in (f"{name}.md", f"first_surveys/{name}.csv"))
    before, state, first = tables(name, entry, root), MADE, validation["first_jobs"](entry)

    def run(targets: Sequence[str]) -> int:
        command = [sys.executable, "-m", "snakemake", *targets, *snakemake]
        return subprocess.run(command, cwd=root, check=False).returncode

    def first_survey_as_before() -> bool:
        if run([f"results/reproduction/{name}/{job}" for job in first]):
            return False
        then = pd.read_csv(kept, index_col=["file", "value"], keep_default_na=False)
        then["share"] = numbers["SHARE"]
        moved = [*numbers["moved"](then, first_numbers(name, first, root))]
        for line in moved:
            print(f"{name}: {line}", flush=True)
        return not moved

    if page.exists() and not validation["changed_rules"](name, entry, root):
        state = "as recorded"
    elif page.exists() and kept.exists() and first_survey_as_before():
        state = SAME
        validation["confirm"](name, entry, root)
    else:
        if code := run(words(name, entry)):
            return {"record": name, "state": f"failed ({code})"}
        try:
            validation["record"](name, entry, root, root / "docs/validation")
        except (OSError, validation["InputError"]) as error:
            return {"record": name, "state": f"not recorded: {error}"}
    absent = bool(first) and (state == MADE or not kept.exists())
    if absent and not run([f"results/reproduction/{name}/{job}" for job in first]):
        kept.parent.mkdir(exist_ok=True)
        first_numbers(name, first, root).to_csv(kept, float_format="%.10g")
    head, after = validation["front_matter"](page), tables(name, entry, root)
    return {
        "record": name,
        "state": state,
        "date": head["date"],
        "commit": ", ".join(each[:7] for each in head["commit"].split(", ")),
        "cpu_min": head["cpu_min"],
        "verdict": verdict(after),
        "changed": changed_digits(before, after) if state == MADE else "",
    }


def other(name: str, last: Mapping[str, Any], root: Path = ROOT) -> dict[str, Any]:
    """Run one of `OTHERS`, unless library and workflow are those of its last line: its line of the table."""
    same = ["git", "diff", "--quiet", str(last.get("commit", "")), "--", "src", "workflow"]
    if last.get("commit") and subprocess.run(same, cwd=root, check=False).returncode == 0:
        return {"record": name, "state": "as recorded"}
    commit = validation["commit_here"](root)
    code = subprocess.run([sys.executable, *OTHERS[name]], cwd=root, check=False).returncode
    return {
        "record": name,
        "state": {0: MADE, 1: f"{MADE}, a goal is missed"}.get(code, f"failed ({code})"),
        "date": f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d}",
        "commit": commit,
    }


def kept(line: dict[str, Any], last: dict[str, Any]) -> dict[str, Any]:
    """The last line of a record that is as recorded, as it says what its run changed; else the new one."""
    if line["state"] == SAME:
        return line | {"changed": last.get("changed", "")}
    known = line["state"] == "as recorded" and str(last.get("state")).startswith((MADE, SAME))
    return last if known else line


def main() -> int:
    """0 if every record is of the code that is here, and reaches its goal."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these records")
    asked, snakemake = parser.parse_known_args()
    studies = validation["studies"]()
    if unknown := set(asked.only or ()) - {*studies, *OTHERS}:
        sys.exit(f"no record {', '.join(unknown)}: there are {', '.join([*studies, *OTHERS])}")
    if not {"--cores", "-c", "--jobs", "-j", "--profile"} & {each.partition("=")[0] for each in snakemake}:
        snakemake += ["--cores", "all"]
    path = ROOT / "docs/validation/release.csv"
    table = pd.read_csv(path, dtype=str, keep_default_na=False) if path.exists() else pd.DataFrame()
    rows = {str(line["record"]): {str(k): v for k, v in line.items()} for line in table.to_dict("records")}
    for name in [each for each in [*order(studies), *OTHERS] if not asked.only or each in asked.only]:
        print(f"== {name}", flush=True)
        last = rows.pop(name, {})
        rows[name] = kept(
            check(name, studies[name], snakemake) if name in studies else other(name, last), last
        )
        table = pd.DataFrame(rows.values()).fillna("")
        table.to_csv(path, index=False)
        days = sorted({*table["date"]} - {""})
        head = f"# Release check\n\nWritten by `make release-check`, {days[0]} to {days[-1]}.\n\n"
        path.with_suffix(".md").write_text(f"{head}{validation['markdown'](table)}\n", encoding="utf-8")
    print(path.with_suffix(".md").read_text(encoding="utf-8"))
    return int(not table["state"].isin([MADE, SAME, "as recorded"]).all())


if __name__ == "__main__":
    sys.exit(main())
