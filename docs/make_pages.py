"""Fill the numbers of the twin into README.md and docs/*.md, from docs/validation.

.venv/bin/python docs/make_pages.py

Pages with such numbers are written as templates in docs/pages (Jinja). Here a column of the row with
these keys of docs/validation/outages.csv, with two decimals, and a parameter of the head of outage_study.md::

    {{ outages[60, "camera"].normalised | d(2) }} over {{ run.outage_study.parameters.seeds }} surveys

The keys of a table stand in config/studies. A row or paragraph with a number that is not recorded yet is
left out, and the command says how many. The packages of
docs/architecture.md, and which takes from which, are read from the source.
"""

import ast
import importlib.metadata
import math
import re
import runpy
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, StrictUndefined
from jinja2.meta import find_undeclared_variables
from packaging.requirements import Requirement

from thalweg.workflow.codehash import imported_modules

ROOT = Path(__file__).parents[1]
_validation = runpy.run_path(str(ROOT / "docs/make_validation.py"))


HEAD = ("version", "commit", "code", "date", "jobs", "wall_min", "cpu_min")
"""What only a run tells."""


class Pending:
    """Stands for what is not recorded yet, and for everything in it."""

    def __getattr__(self, name: str) -> "Pending":
        if name.startswith("__"):
            raise AttributeError(name)
        return self

    def __getitem__(self, key: Any) -> "Pending":
        return self

    def __iter__(self) -> Iterator[Any]:
        return iter(())

    def __mul__(self, factor: Any) -> "Pending":
        return self

    def __pow__(self, power: Any) -> "Pending":
        return self

    def __bool__(self) -> bool:
        return False

    def __str__(self) -> str:
        return "(waits for its record)"


class Row:
    """A row of a table: columns are attributes."""

    def __init__(self, table: str, values: dict[str, Any]) -> None:
        self._table, self._values = table, values

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self[name]

    def __getitem__(self, name: str) -> Any:
        if name not in self._values:
            raise ValueError(
                f"docs/validation/{self._table}.csv has no column '{name}': {list(self._values)}"
            )
        return self._values[name]


class Table:
    """A recorded table: rows by their keys."""

    def __init__(self, path: Path, keys: list[str]) -> None:
        self._name = path.stem
        found = pd.read_csv(path, keep_default_na=False, na_values=["nan", ""])
        records = [{str(k): v for k, v in row.items()} for row in found.to_dict("records")]
        self._rows = {tuple(str(row[key]) for key in keys): Row(path.stem, row) for row in records}
        if len(self._rows) != len(records):
            raise ValueError(f"{path}: the keys {keys} do not tell the rows apart")

    def __getitem__(self, key: Any) -> Row:
        wanted = tuple(str(k) for k in (key if isinstance(key, tuple) else (key,)))
        if wanted not in self._rows:
            raise ValueError(f"docs/validation/{self._name}.csv has no row {wanted}: {sorted(self._rows)}")
        return self._rows[wanted]

    def __iter__(self) -> Iterator[Row]:
        return iter(self._rows.values())

    def __len__(self) -> int:
        return len(self._rows)


def decimals(value: Any, digits: int = 0, scale: float = 1.0) -> str:
    """A number with so many decimals, after multiplication with ``scale`` (1000: metres in millimetres)."""
    if isinstance(value, Pending):
        return str(value)
    if not math.isfinite(value):
        raise ValueError(f"a number of a page is {value}")
    return f"{scale * float(value):.{digits}f}".replace("-", "\N{MINUS SIGN}")


def judged(value: Any, low: Any, high: Any, digits: int = 2) -> str:
    """A number with its band, in bold where it lies outside."""
    if isinstance(value, Pending):
        return str(value)
    text, band = decimals(value, digits), f"({decimals(low, digits)}–{decimals(high, digits)})"
    return f"{text} {band}" if low <= value <= high else f"**{text}** {band}"


def largest(table: Any, column: str) -> Any:
    """The largest size of a column."""
    return table if isinstance(table, Pending) else max(abs(row[column]) for row in table)


def packages(source: Path = ROOT / "src") -> dict[str, tuple[str, int]]:
    """What each package is for, by its own words, and its number of modules.

    A module that stands beside packages is one by itself.
    """
    found = {}
    doors = {door.parent: door for door in source.rglob("__init__.py")}
    beside = {folder.parent for folder in doors} - {source, source / "thalweg"}
    single = [p for folder in beside for p in folder.glob("*.py") if p.name != "__init__.py"]
    for place, file in [*doors.items(), *((p.with_suffix(""), p) for p in single)]:
        words = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").split("\n\n")[0]
        modules = 1 if file in single else 0 if place in beside else len(list(place.glob("*.py"))) - 1
        found[".".join(place.relative_to(source).parts)] = (" ".join(words.split()), modules)
    return dict(sorted(found.items()))


def package_graph(source: Path = ROOT / "src") -> str:
    """Which folder of `thalweg` takes from which, as Mermaid: no arrow where a longer way says the same."""
    above: dict[str, set[str]] = {}
    product = source / "thalweg"
    for path in product.rglob("*.py"):
        taken = {each.relative_to(product).parts[0] for each in imported_modules(path, source)}
        above.setdefault(path.relative_to(product).parts[0], set()).update(taken)
    folders = {name for name in above if (product / name).is_dir()}
    above = {name: (others & folders) - {name} for name, others in above.items() if name in folders}

    def reached(name: str) -> set[str]:
        return above[name].union(*(reached(other) for other in above[name]))

    lines = [
        f"    {other} --> {name}"
        for name in sorted(above)
        for other in sorted(above[name])
        if not any(other in reached(between) for between in above[name] - {other})
    ]
    return "\n".join(["```mermaid", "flowchart LR", *lines, "```"])


LICENCES = {"sbp": "MIT (by its repository)", "pyrtklib5": "MIT (by its file LICENSE)"}
"""Of packages whose metadata do not state one."""


def dependencies(root: Path = ROOT) -> list[tuple[str, str, str]]:
    """What library and large extras need: name, why (the remark in pyproject.toml), stated licence."""
    text = (root / "pyproject.toml").read_text(encoding="utf-8")
    text = text.split("\ndependencies = [")[1].split("\nall = [")[0]
    found = []
    for words, why in re.findall(r'(?m)^ +"([^"]+)", *# (.+)$', text):
        requirement = Requirement(words)
        if requirement.marker is not None and not requirement.marker.evaluate():
            continue
        told = importlib.metadata.metadata(requirement.name)
        classes = [each.split(" :: ")[-1] for each in told.get_all("Classifier", []) if "License ::" in each]
        stated = told["License-Expression"] or ", ".join(classes) or (told["License"] or "").split("\n")[0]
        found.append((requirement.name, why, LICENCES.get(requirement.name, stated)))
    return found


def pages(root: Path = ROOT) -> tuple[dict[Path, str], int]:
    """All pages by their place, filled, and how many numbers wait for a record and are left out.

    Raises
    ------
    ValueError : a reference names no row or column; the message names those there are.
    jinja2.UndefinedError : a reference names no table.
    """
    known: dict[str, Any] = {}
    runs: dict[str, Any] = {}
    folder = root / "docs/validation"
    for name, entry in _validation["studies"](root).items():
        path = folder / f"{name}.md"
        found = _validation["front_matter"](path) if path.exists() else {}
        runs[name] = dict.fromkeys(HEAD, Pending()) | entry | found
        for table, wanted in entry["tables"].items():
            path = folder / f"{table}.csv"
            known[table] = Table(path, wanted.get("keys", ["key"])) if path.exists() else Pending()
    timings = folder / "timings.csv"
    known["timings"] = Table(timings, ["campaign"]) if timings.exists() else Pending()
    known |= {"packages": packages, "package_graph": package_graph, "dependencies": dependencies}
    out, waiting, jinja = {}, 0, environment()
    for template in sorted((root / "docs/pages").glob("*.md")):
        target = root / template.name if template.name == "README.md" else root / "docs" / template.name
        text = template.read_text(encoding="utf-8")
        told = {"measured": measured(quoted(text, jinja, root), runs)}
        filled = jinja.from_string(text).render(known | {"run": runs} | told)
        out[target] = recorded(filled)
        waiting += filled.count(str(Pending()))
    return out, waiting


def environment() -> Environment:
    """Jinja with the filters of these pages."""
    made = Environment(
        undefined=StrictUndefined, keep_trailing_newline=True, trim_blocks=True, autoescape=False
    )
    made.filters |= {"d": decimals, "judged": judged, "largest": largest}
    return made


def quoted(text: str, jinja: Environment, root: Path = ROOT) -> list[str]:
    """Records that a template takes numbers from."""
    names = find_undeclared_variables(jinja.parse(text))
    of_runs = set(re.findall(r"\brun\.(\w+)", text))
    known = _validation["studies"](root)
    return [name for name, entry in known.items() if name in of_runs or names & set(entry["tables"])]


def measured(names: Iterable[str], runs: Mapping[str, Any]) -> str:
    """Of which code records are: ``version 1.0.0 (`bed_study`, `full`)``; those of 0.1.0 by commit, date."""
    of: dict[str, list[str]] = {}
    for name in names:
        run = runs[name]
        if isinstance(run["commit"], Pending):
            continue
        commits = "/".join(dict.fromkeys(each[:7] for each in run["commit"].split(", ")))
        older = f"{commits}, {run['date']}"
        code = older if isinstance(run["version"], Pending) else f"version {run['version']}"
        of.setdefault(code, []).append(f"`{name}`")
    return ", ".join(f"{code} ({', '.join(records)})" for code, records in sorted(of.items()))


def recorded(text: str) -> str:
    """A page without the rows, tables and paragraphs in which a number waits for its record."""
    blocks = []
    for block in text.split("\n\n"):
        if block.lstrip().startswith("|"):
            lines = [line for line in block.split("\n") if str(Pending()) not in line]
            if len([line for line in lines if line.startswith("|")]) > 2:
                blocks.append("\n".join(lines))
        elif str(Pending()) not in block:
            blocks.append(block)
    return "\n\n".join(blocks).rstrip("\n") + "\n"


if __name__ == "__main__":
    made, waits = pages()
    for place, text in made.items():
        place.write_text(text, encoding="utf-8")
        sys.stdout.write(f"{place.relative_to(ROOT)}\n")
    if waits:
        sys.stdout.write(f"{waits} numbers wait for their record and are left out\n")
