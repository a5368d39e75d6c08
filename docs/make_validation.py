"""Write docs/validation: tables of studies and campaigns of the twin, with how they were made.

.venv/bin/python docs/make_validation.py consistency_study     # what the last run of a rule left in results/
.venv/bin/python docs/make_validation.py --state              # which records are of older code or other sizes

What there is to record stands in config/studies. Commit, date, parameters and times are those that the
jobs wrote beside their results (``<output>.meta.json``): nothing is typed.
"""

import argparse
import atexit
import datetime
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "src"))

from thalweg.core import InputError  # noqa: E402
from thalweg.workflow import code_version  # noqa: E402
from thalweg_lab.studies import batches  # noqa: E402

NOT_SIZES = {"code", "campaign"}
"""Parameters of rules that say nothing of a study's size."""


def studies(root: Path = ROOT) -> dict[str, dict[str, Any]]:
    """Files of config/studies by name: parameters, tables, words."""
    folder = root / "config/studies"
    return {p.stem: yaml.safe_load(p.read_text(encoding="utf-8")) for p in sorted(folder.glob("*.yaml"))}


def record(name: str, entry: Mapping[str, Any], results: Path, folder: Path) -> list[Path]:
    """Write tables and page of one study.

    Parameters
    ----------
    name : of the study.
    entry : see config/studies.
    results : folder in which Snakemake ran: paths of tables are relative to it.
    folder : docs/validation.

    Raises
    ------
    InputError : a result or its provenance is absent, or its parameters are not those of the entry.
    """
    jobs, tables = [], {}
    for table, wanted in entry["tables"].items():
        source = results / wanted["file"]
        if not source.is_file():
            raise InputError(
                "no result to record", where=source, expected=f"run {command(name, entry)} first"
            )
        jobs.append(json.loads(source.with_name(source.name + ".meta.json").read_text(encoding="utf-8")))
        tables[table] = read(source, wanted)
    for job in jobs:
        found = {k: job["params"].get(k) for k in entry.get("parameters", {})}
        if found != entry.get("parameters", {}):
            raise InputError(
                f"{job['output']} was made with {found}",
                expected=f"{entry['parameters']} as config/studies says: run {command(name, entry)} again",
            )
    if "campaign" in entry:  # the whole chain counts, not the last job alone
        folders = [results / "results" / each for each in entry["campaign"]]
        found = [p for folder in folders for p in sorted(folder.rglob("*.meta.json"))]
        jobs_of_chain = [json.loads(p.read_text(encoding="utf-8")) for p in found]
    else:  # and the surveys of a study, a job each
        of_surveys = [results / f"{each}.meta.json" for job in jobs for each in job.get("inputs", ())]
        jobs += [json.loads(p.read_text(encoding="utf-8")) for p in of_surveys if p.is_file()]
        jobs_of_chain = jobs
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for target, source in entry.get("pictures", {}).items():
        written.append(folder.parents[1] / target)
        take_picture(results / source, written[-1])
    for table, rows in tables.items():
        written.append(folder / f"{table}.csv")
        rows.to_csv(written[-1], index=False, float_format="%.6g", lineterminator="\n")
    written.append(folder / f"{name}.md")
    head = {
        "command": command(name, entry),
        "version": ", ".join(sorted({job["thalweg"] for job in jobs})),
        "commit": ", ".join(sorted({str(job["commit"]) for job in jobs})),
        "code": {job["rule"]: job["code"] for job in jobs},
        "parameters": dict(entry.get("parameters", {})),
        "date": max(job["written_utc"] for job in jobs)[:10],
        **times(jobs_of_chain),
    }
    written[-1].write_text(page(name, entry, head, tables), encoding="utf-8")
    return written


def take_picture(source: Path, target: Path) -> None:
    """Copy a figure of the results, as JPEG where the target is one.

    Raises
    ------
    InputError : there is no such figure.
    """
    if not source.is_file():
        raise InputError("no figure to take", where=source)
    if source.suffix == target.suffix:
        shutil.copyfile(source, target)
    else:
        Image.open(source).convert("RGB").save(target, quality=88)


def read(source: Path, wanted: Mapping[str, Any]) -> pd.DataFrame:
    """A table of results: rows and columns that are asked for, or the picked values of a JSON file.

    Raises
    ------
    InputError : a column or key is absent.
    """
    if source.suffix == ".json":
        content = json.loads(source.read_text(encoding="utf-8"))
        return pd.DataFrame([(key, _picked(content, path, source)) for key, path in wanted["pick"].items()],
                            columns=["key", "value"])  # fmt: skip
    found = pd.read_csv(source, keep_default_na=False, na_values=["", "nan", "NaN"])
    columns = wanted.get("columns", list(found.columns))
    absent = [c for c in [*columns, *wanted["keys"], *wanted.get("where", {})] if c not in found.columns]
    if absent:
        raise InputError(f"no columns {absent}", where=source, expected=f"of {list(found.columns)}")
    for column, values in wanted.get("where", {}).items():
        found = found[found[column].isin(values)]
    return found[columns]


def _picked(content: Any, path: str, source: Path) -> Any:
    for part in path.split("."):
        try:
            content = content[int(part) if isinstance(content, list) else part]
        except (KeyError, IndexError, ValueError, TypeError) as error:
            raise InputError(f"no '{part}' of {path}", where=source) from error
    return content


def command(name: str, entry: Mapping[str, Any]) -> str:
    """What makes a study's record."""
    return entry.get("command", f"make study NAME={name}")


def times(jobs: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Minutes of wall and processor of jobs; each job counts once, however many outputs it has."""
    distinct = {(j["rule"], j["written_utc"], j["wall_s"]): j for j in jobs}.values()
    cpu = [j.get("cpu_s") for j in distinct]
    return {
        "jobs": len(distinct),
        "wall_min": round(sum(j["wall_s"] for j in distinct) / 60, 1),
        "cpu_min": "not measured" if None in cpu else round(sum(cpu) / 60, 1),
    }


def page(
    name: str, entry: Mapping[str, Any], head: Mapping[str, Any], tables: Mapping[str, pd.DataFrame]
) -> str:
    """The page of a study: how it was made, what was simulated and known, tables."""
    lines = [
        "---",
        yaml.safe_dump(dict(head), sort_keys=False, allow_unicode=True).strip(),
        "---",
        f"# {name}",
        "",
    ]
    written = "Written by `docs/make_validation.py`. A result of the digital twin, not of a river."
    lines += [f"{written} T and P1 to P4: [bibliography](../bibliography.md).", ""]
    lines += [f"**What one run is.** {' '.join(entry['survey'].split())}", ""]
    lines += [f"**What the processing knew.** {' '.join(entry['known'].split())}"]
    for table, rows in tables.items():
        lines += ["", f"## [{table}.csv]({table}.csv)", "", markdown(rows)]
    return "\n".join(lines) + "\n"


def markdown(rows: pd.DataFrame, most: int = 60) -> str:
    """A table for people, four digits; beyond ``most`` rows the CSV alone has them."""
    texts = [["" if pd.isna(v) else f"{v:.4g}" if isinstance(v, float) else str(v) for v in row]
             for row in rows.head(most).itertuples(index=False)]  # fmt: skip
    lines = ["| " + " | ".join(map(str, rows.columns)) + " |", "|" + " --- |" * len(rows.columns)]
    lines += ["| " + " | ".join(row) + " |" for row in texts]
    return "\n".join([*lines, *([f"\nand {len(rows) - most} more rows"] if len(rows) > most else [])])


def front_matter(path: Path) -> dict[str, Any]:
    """How a recorded study was made."""
    return yaml.safe_load(path.read_text(encoding="utf-8").split("---\n")[1])


def now(rule: str, name: str, entry: Mapping[str, Any], root: Path) -> str | None:
    """Version of the code behind a rule today; None if there is no such rule any more."""
    scripts = root / "workflow/scripts"
    if "study" in entry and rule in (name, "rows_of_study"):
        script = "rows_of_study" if rule == "rows_of_study" else "results_of_study"
        return code_version(script, entry["study"], scripts=scripts, source=root / "src")
    return (
        code_version(rule, scripts=scripts, source=root / "src")
        if (scripts / f"{rule}.py").exists()
        else None
    )


@cache
def tree_at(commit: str, root: Path) -> Path | None:
    """Code of a commit in a temporary folder; None if the history here does not hold it."""
    archive = ["git", "-C", str(root), "archive", commit, "src", "workflow/scripts"]
    made = subprocess.run(archive, capture_output=True, check=False)
    if made.returncode:
        return None
    place = Path(tempfile.mkdtemp(prefix="thalweg-code-"))
    atexit.register(shutil.rmtree, place)
    subprocess.run(["tar", "-x", "-C", str(place)], input=made.stdout, check=True)
    return place


def changed_rules(name: str, entry: Mapping[str, Any], root: Path = ROOT) -> list[str]:
    """Rules of a record whose code is another one today.

    Code is measured as it is today at the commit of the record too, so that another measure
    (`thalweg.workflow.code_version`) makes no record old. What was made with changes that were not
    committed (a commit with ``+``), or is not in the history here, is judged by the version that it wrote.
    """
    head = front_matter(root / f"docs/validation/{name}.md")
    today = {rule: now(rule, name, entry, root) for rule in head["code"]}
    older = [rule for rule, code in head["code"].items() if today[rule] not in (code, None)]
    trees = [None if "+" in each else tree_at(each, root) for each in head["commit"].split(", ")]

    def same(rule: str) -> bool:
        try:
            return all(tree is not None and now(rule, name, entry, tree) == today[rule] for tree in trees)
        except InputError:  # a module that had another name
            return False

    return [rule for rule in older if not same(rule)]


def first_jobs(entry: Mapping[str, Any]) -> list[str]:
    """The first job of each kind of survey of a study; none of a campaign."""
    if "study" not in entry:
        return []
    jobs = batches(entry)
    return list({batch.kind: name for name, batch in reversed(jobs.items())}.values())


def commit_here(root: Path = ROOT) -> str:
    """Commit of the checkout, seven digits."""
    command = ["git", "-C", str(root), "rev-parse", "--short=7", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def confirm(name: str, entry: Mapping[str, Any], root: Path = ROOT) -> None:
    """Write into the page of a study that the code which is here finds the same in its first survey."""
    path = root / f"docs/validation/{name}.md"
    _, head, text = path.read_text(encoding="utf-8").split("---\n", 2)
    known = yaml.safe_load(head)
    known["code"] = {rule: now(rule, name, entry, root) for rule in known["code"]}
    known["first_survey_as_before"] = f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d}, {commit_here(root)}"
    head = yaml.safe_dump(known, sort_keys=False, allow_unicode=True)
    path.write_text(f"---\n{head}---\n{text}", encoding="utf-8")


def state(root: Path = ROOT) -> list[str]:
    """One line a study: not recorded, of older code, or in step."""
    lines = []
    for name, entry in studies(root).items():
        path = root / f"docs/validation/{name}.md"
        if not path.exists():
            lines.append(f"{name}: not recorded yet")
            continue
        head, older = front_matter(path), changed_rules(name, entry, root)
        lines.append(
            f"{name}: {head['date']}, {head['commit'][:7]}, "
            + (f"code of {', '.join(older)} changed since" if older else "code as now")
        )
    return lines


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", help="names of files in config/studies")
    parser.add_argument("--results", type=Path, default=ROOT, help="where Snakemake ran, if not here")
    parser.add_argument("--state", action="store_true", help="say which records are in step with the code")
    asked = parser.parse_args()
    known = studies()
    for each in asked.names:
        if each not in known:
            sys.exit(f"no study '{each}': config/studies has {', '.join(known)}")
        try:
            print(
                "\n".join(str(p) for p in record(each, known[each], asked.results, ROOT / "docs/validation"))
            )
        except (InputError, OSError) as problem:
            sys.exit(str(problem))
    if asked.state:
        print("\n".join(state()))
